"""What a virtual PTP camera is like: its configuration and the settings on its dials."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from sim.devices.still_body import CARD_BYTES

# The dial of a camera with thirds of a stop, as it is labelled; seconds.
_PARTS_OF_SECOND = (
    *(8000, 5000, 3200, 2500, 2000, 1600, 1250, 1000, 800, 640, 500, 400, 320, 250, 200, 160, 125),
    *(100, 80, 60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3),
)
_TENTHS = (4, 5, 6, 8, 10, 13, 16, 20, 25, 30, 40, 50, 60, 80, 100, 130, 150, 200, 250, 300)
DIAL_S = (
    *(Fraction(1, part) for part in _PARTS_OF_SECOND),
    *(Fraction(tenths, 10) for tenths in _TENTHS),
)


_LARGEST = 0xFFFF  # numerator and denominator go over the wire in 16 bits each


def _fraction(value: object) -> object:
    if isinstance(value, str | int):
        return Fraction(value)
    if isinstance(value, float):
        return Fraction(value).limit_denominator(_LARGEST)
    return value


def _fits(value: Fraction) -> Fraction:
    if not 0 < value.numerator <= _LARGEST or value.denominator > _LARGEST:
        raise ValueError(f"a shutter time of {value} s is not a fraction of numbers up to 65535")
    return value


def _several(value: object) -> object:
    return (value,) if isinstance(value, str) else value


Seconds = Annotated[Fraction, BeforeValidator(_fraction), AfterValidator(_fits)]


class PtpConfig(BaseModel):
    """What a virtual PTP camera is like; all but what it looks at, which is the exposer's.

    Attributes:
        serial: its serial number
        vendor: whose properties and operations it has; none: the standard's alone
        files: kinds that it can make; several are chosen between by property 5004, and
            "dng+jpeg" makes both of one exposure
        delay_s: from the end of an exposure until its file is there
        overlap: files can be fetched and properties set while it exposes; else it is busy
        object_bytes: files are padded to this size
        card_bytes: what its card holds
        quality: of JPEGs
        zlp: "always": a transfer of a multiple of the packet size ends with an empty packet;
            "never": it does not
        split_header: the header of a data phase comes as a transfer of its own
        folder_event: the folder is announced as a new object too
        event_order: events come "after" the response, "before" it, or "never"
        times: shutter times, seconds or "1/60"
        time_form: whether property 500D has a list ("enum") or 1..600000 ("range")
        isos: sensitivities; 100 is gain 1
        f_numbers: 100 f; the first that is widest has all the light; none: the lens is not ours
        bulb: exposures as long as the host wants
        mode: of the dial: "manual" or "auto", where the shutter time is not the host's to set
        absolute: Sony: a shutter time can be set and need not be stepped to
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    serial: str = Field(default="PTP0001", min_length=1, max_length=32)
    vendor: Literal["none", "nikon", "canon", "sony"] = "none"
    files: Annotated[
        tuple[Literal["jpeg", "tiff", "dng", "dng+jpeg"], ...], BeforeValidator(_several)
    ] = Field(default=("jpeg",), min_length=1)
    delay_s: float = Field(default=0.0, ge=0, le=60)
    overlap: bool = True
    object_bytes: int = Field(default=0, ge=0, le=CARD_BYTES)
    card_bytes: int = Field(default=CARD_BYTES, ge=0, le=2**40)
    quality: int = Field(default=95, ge=1, le=100)
    zlp: Literal["always", "never"] = "always"
    split_header: bool = False
    folder_event: bool = False
    event_order: Literal["after", "before", "never"] = "after"
    times: tuple[Seconds, ...] = Field(default=DIAL_S, min_length=1)
    time_form: Literal["enum", "range"] = "enum"
    isos: tuple[Annotated[int, Field(ge=1, le=0xFFFF)], ...] = (100, 200, 400, 800)
    f_numbers: tuple[Annotated[int, Field(ge=1, le=0xFFFF)], ...] = (280, 400, 560, 800)
    bulb: bool = False
    mode: Literal["manual", "auto"] = "manual"
    absolute: bool = True


# Property 5004: what each number stands for is the maker's own; these are Nikon's, and Sony's.
COMPRESSIONS = {"jpeg": 2, "tiff": 3, "dng": 4, "dng+jpeg": 7}
SONY_COMPRESSIONS = {"jpeg": 0x03, "tiff": 0x04, "dng": 0x10, "dng+jpeg": 0x13}


def kinds_of(choice: str) -> tuple[str, ...]:
    """Return the files that one of `PtpConfig.files` makes."""
    return tuple(choice.split("+"))


@dataclass(frozen=True)
class Identity:
    """Who a camera says it is, on USB and in its device info."""

    vendor_id: int
    product_id: int
    make: str
    model: str
    extension: int = 0
    extension_version: int = 0


@dataclass
class WireFaults:
    """What is wrong with the cable and the firmware at the moment.

    Attributes:
        busy: operations that are answered Device_Busy; -1: all of them
        is_hanging: operations are not answered
        stalls: operations that stall the bulk endpoints
        truncations: objects of which half is sent ..
        answers_truncated: .. and a response after it, as if nothing had happened
        garbage: replies that are rubbish
        unplug_after: bytes of the next object after which the plug is pulled; -1: none
    """

    busy: int = 0
    is_hanging: bool = False
    stalls: int = 0
    truncations: int = 0
    answers_truncated: bool = False
    garbage: int = 0
    unplug_after: int = -1


class WireVerbs:
    """Verbs that set `faults`."""

    faults: WireFaults

    def do_busy(self, count: int = 5) -> None:
        """Answer the next operations, or all (-1), Device_Busy."""
        self.faults.busy = count

    def do_hang(self) -> None:
        """Answer no operation."""
        self.faults.is_hanging = True

    def do_stall(self, count: int = 1) -> None:
        """Stall instead of doing the next operations."""
        self.faults.stalls = count

    def do_truncate(self, count: int = 1, answers: bool = False) -> None:
        """Send half of the next objects, and after that nothing, or a response."""
        self.faults.truncations, self.faults.answers_truncated = count, answers

    def do_garbage(self, count: int = 1) -> None:
        """Reply rubbish."""
        self.faults.garbage = count
