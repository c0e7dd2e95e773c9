"""What is set once when a GenICam camera is opened: options, trigger, frame rate, chunk data."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from camctl.drivers.common.gain_unit import GainUnit, parse_gain
from camctl.drivers.genicam.controls import ExposureControl
from camctl.drivers.genicam.port import CHUNKS, FeatureError, Kind, Limits, OpenDevice
from camctl.errors import UsageError
from camctl.findings import Finding, note
from camctl.interface.backends import BackendOptions, LowerCase
from camctl.interface.controls import ExposureSetting

LEAST_FPS = 15.0
"""Frames a second of a free run, at least, unless others are asked for: as of V4L2 cameras."""


class GenicamOptions(BackendOptions):
    """Options of a GenICam camera.

    Attributes:
        library: aravis or viva; "auto": the first of them that is installed
        format: an entry of the camera's PixelFormat, or "auto" for the most bits
        trigger: "software": each frame is released; "off": free run; "auto": software if possible
        fps: frames a second of a free run; None: the fewest from 15 on, because no exposure is
            longer than the interval between frames
        bits: bits that the samples of a 16-bit format use, the upper ones; None: by the first frame
        black: brightness without light, DN; None: 0
        white: brightness from which a sample counts as saturated, DN; None: the largest; it is less
            where the pixels are full before the converter is
        black_level: value for the camera's BlackLevel; None: as it is
        gain: what the values of the gain add; None: dB where the camera says so
        chunks: "auto": exposures that the camera states are compared; "off"
        sequencer: "on": a list of exposures is uploaded and taken without a pause
        response: one of `model.response.camera.RESPONSES`
    """

    library: Annotated[Literal["auto", "aravis", "viva"], LowerCase] = "auto"
    format: Annotated[str, LowerCase] = "auto"
    trigger: Annotated[Literal["auto", "software", "off"], LowerCase] = "auto"
    fps: float | None = Field(default=None, gt=0, le=10_000, allow_inf_nan=False)
    bits: int | None = Field(default=None, ge=9, le=16)
    black: int | None = Field(default=None, ge=0)
    white: int | None = Field(default=None, ge=1)
    black_level: float | None = Field(default=None, allow_inf_nan=False)
    gain: Annotated[GainUnit | None, BeforeValidator(parse_gain)] = None
    chunks: Annotated[Literal["auto", "off"], LowerCase] = "auto"
    sequencer: Annotated[Literal["on", "off"], LowerCase] = "off"
    response: Annotated[str, LowerCase] = "linear"


def choose_trigger(device: OpenDevice, name: str, requested: str) -> bool:
    """Turn all triggers off, and the software trigger on where it is used; return whether.

    Raises:
        UsageError: it is requested, and the camera has none
    """
    if device.kind("AcquisitionMode") is Kind.ENUMERATION:
        device.write("AcquisitionMode", "Continuous")
    if device.kind("TriggerMode") is None:
        return _without_trigger(name, requested)
    selectors: Sequence[str] = ("",)
    if device.kind("TriggerSelector") is Kind.ENUMERATION:
        selectors = device.entries("TriggerSelector")
    for each in selectors:
        if each:
            device.write("TriggerSelector", each)
        with suppress(FeatureError):  # not every trigger can be turned on at all
            device.write("TriggerMode", "Off")
    if requested == "off":
        return False
    if device.kind("TriggerSoftware") is None or not {"FrameStart", ""} & set(selectors):
        return _without_trigger(name, requested)
    if selectors[0]:
        device.write("TriggerSelector", "FrameStart")
    if "Software" not in device.entries("TriggerSource"):
        return _without_trigger(name, requested)
    device.write("TriggerSource", "Software")
    device.write("TriggerMode", "On")
    if device.kind("AcquisitionFrameRateEnable") is Kind.BOOLEAN:
        with suppress(FeatureError):
            device.write("AcquisitionFrameRateEnable", False)
    return True


def _without_trigger(name: str, requested: str) -> bool:
    if requested == "software":
        raise UsageError(
            f"{name} has no software trigger",
            hint="leave it out: frames are taken from a free run then",
            remedies={"option:trigger": "off"},
        )
    return False


def choose_rate(
    device: OpenDevice, exposure: ExposureControl, name: str, fps: float | None
) -> float:
    """Set the frame rate of a free run and return it.

    Raises:
        UsageError: the camera does not offer it
    """
    exposure.write(ExposureSetting(exposure.times().minimum, exposure.gains.minimum))
    for switch in ("AcquisitionFrameRateEnable", "AcquisitionFrameRateEnabled"):
        if device.kind(switch) is Kind.BOOLEAN:
            device.write(switch, True)
    rate = "AcquisitionFrameRate"
    if device.kind(rate) is None:
        return fps or 2 * LEAST_FPS
    limits: Limits = device.limits(rate)
    wanted = LEAST_FPS if fps is None else fps
    if fps is not None and not limits.minimum <= fps <= limits.maximum:
        raise UsageError(
            f"{name} does not offer {fps:g} frames a second",
            hint=f"it offers {limits.minimum:g} to {limits.maximum:g}",
        )
    device.write(rate, min(max(wanted, limits.minimum), limits.maximum))
    return float(device.read(rate))


def turn_chunks_on(device: OpenDevice) -> list[Finding]:
    """Let frames state their exposures, where they can; return what is wrong with that."""
    if device.kind("ChunkModeActive") is None:
        return []
    try:
        device.write("ChunkModeActive", True)
        offered = device.entries("ChunkSelector")
        for each in CHUNKS:
            if each in offered:
                device.write("ChunkSelector", each)
                device.write("ChunkEnable", True)
    except FeatureError as error:
        return [note(f"the camera's chunk data are not used: {error}")]
    return []
