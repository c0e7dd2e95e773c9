"""What a virtual CoolPix is like, and what can be wrong with its line."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from sim.devices.sierra.registers import SHUTTER_US
from sim.devices.still_body import CARD_BYTES


class SierraConfig(BaseModel):
    """What a virtual CoolPix is like; all but what it looks at, which is the exposer's.

    Attributes:
        serial: its serial number
        line: "pty", a device node, or "memory": a line inside this process
        link: a symbolic link to keep at the host's end of a pseudo-terminal
        files: kinds that it can make, jpeg or tiff; register 1 chooses
        delay_s: from the end of an exposure until its file is on the card
        times_us: shutter times, microseconds
        speed_limit: the fastest speed that it takes, bits a second
        is_paced: bytes take the time that they would on a real line
        silence_s: after so long it ends the session and goes back to 19,200 bits a second
        card_bytes: what its card holds
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    serial: str = Field(default="CP990001", min_length=1, max_length=32, pattern=r"^[ -~]+$")
    line: str = "pty"
    link: str | None = None
    files: Annotated[
        tuple[Literal["jpeg", "tiff"], ...],
        BeforeValidator(lambda value: (value,) if isinstance(value, str) else value),
    ] = Field(default=("jpeg", "tiff"), min_length=1)
    delay_s: float = Field(default=0.0, ge=0, le=60)
    times_us: tuple[Annotated[int, Field(ge=1, le=0x7FFF_FFFF)], ...] = Field(
        default=SHUTTER_US, min_length=1
    )
    speed_limit: int = 115200
    is_paced: bool = False
    silence_s: float = Field(default=5.0, gt=0)
    card_bytes: int = Field(default=CARD_BYTES, ge=0, le=0x7FFF_FFFF)


@dataclass
class LineFaults:
    """What is wrong with the line and the firmware at the moment.

    Attributes:
        naks: packets that are answered NAK
        garbage: answers that are rubbish
        truncations: data packets of which half is sent
        is_hanging: nothing is answered
        has_no_speed: a speed change is refused
    """

    naks: int = 0
    garbage: int = 0
    truncations: int = 0
    is_hanging: bool = False
    has_no_speed: bool = False
