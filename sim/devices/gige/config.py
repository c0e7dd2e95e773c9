"""The options of a virtual GigE Vision camera."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

from camctl.sim.devices.common import DeviceConfig, as_tuple


class GigeConfig(DeviceConfig):
    """The options of a virtual GigE Vision camera.

    Attributes:
        serial: serial number
        ip: its address, one of this machine; GigE Vision has one control port, so that each camera
            needs its own
        fps: frames a second, at most
        delay: control delay, frames; -1: a setting acts on the running frame
        gain_delay: of the gain; None: as of the exposure time
        jitter: up to so many frames are added to the delay at random
        readout_s: from the end of an exposure until its frame is sent
        has_trigger, has_chunks: there are software triggers, and chunk data
        chunk_delay: frames by which exposure and gain in the chunk data are late
        sets: of the sequencer; 0: there is none
        lead: frames before the sequencer's first step that have its first set, too many
        loss: probability with which a packet is lost
        resend: lost packets are sent again when asked
        refused: features that cannot be written
        time_step_us: exposure times are rounded to this silently, us
        ticks_per_s: of its time stamps; 0: it has none
        automatic: after power-on exposure, gain and gamma change the picture by themselves
    """

    serial: str = Field(default="GIGE0001", min_length=1, max_length=15, pattern=r"^[ -~]+$")
    ip: str = Field(default="127.0.0.1", pattern=r"^127\.\d+\.\d+\.\d+$")
    fps: float = Field(default=50.0, ge=1, le=1000)
    delay: int = Field(default=0, ge=-1, le=8)
    gain_delay: int | None = Field(default=None, ge=-1, le=8)
    jitter: int = Field(default=0, ge=0, le=8)
    readout_s: float = Field(default=0.001, ge=0, le=1)
    has_trigger: bool = True
    has_chunks: bool = True
    chunk_delay: int = Field(default=0, ge=0, le=2)
    sets: int = Field(default=16, ge=0, le=64)
    lead: int = Field(default=0, ge=0, le=8)
    loss: float = Field(default=0.0, ge=0, le=0.5)
    resend: bool = True
    refused: Annotated[tuple[str, ...], BeforeValidator(as_tuple)] = ()
    time_step_us: float = Field(default=1.0, gt=0, le=1000)
    ticks_per_s: int = Field(default=1_000_000_000, ge=0, le=2_000_000_000)
    automatic: bool = True
