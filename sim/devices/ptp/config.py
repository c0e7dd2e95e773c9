"""The options, the identity and the faults of a virtual PTP camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from camctl.errors import UsageError
from camctl.interface.controls import Layout
from camctl.sim.devices.common import Controllable, DeviceConfig, VirtualSensor, as_tuple
from camctl.sim.devices.ptp.body_facts import BodyFacts, load_body, manners_of
from camctl.sim.devices.still_body import CARD_BYTES

# The labels of a shutter dial in thirds of a stop, seconds.
_PARTS_OF_SECOND = (
    *(8000, 5000, 3200, 2500, 2000, 1600, 1250, 1000, 800, 640, 500, 400, 320, 250, 200, 160, 125),
    *(100, 80, 60, 50, 40, 30, 25, 20, 15, 13, 10, 8, 6, 5, 4, 3),
)
_TENTHS = (4, 5, 6, 8, 10, 13, 16, 20, 25, 30, 40, 50, 60, 80, 100, 130, 150, 200, 250, 300)
DIAL_S = (
    *(Fraction(1, part) for part in _PARTS_OF_SECOND),
    *(Fraction(tenths, 10) for tenths in _TENTHS),
)
_LARGEST_TERM = 0xFFFF  # numerator and denominator of a shutter time have 16 bits each

# Property 5004: its numbers are the maker's own; these are Nikon's and Sony's.
COMPRESSIONS = {"jpeg": 2, "tiff": 3, "dng": 4, "dng+jpeg": 7}
SONY_COMPRESSIONS = {"jpeg": 0x03, "tiff": 0x04, "dng": 0x10, "dng+jpeg": 0x13}


def _parse_time(value: object) -> object:
    if isinstance(value, str | int):
        return Fraction(value)
    if isinstance(value, float):
        return Fraction(value).limit_denominator(_LARGEST_TERM)
    return value


def _check_time(value: Fraction) -> Fraction:
    if not 0 < value.numerator <= _LARGEST_TERM or value.denominator > _LARGEST_TERM:
        raise ValueError(f"shutter time {value} s is not a fraction of numbers from 1 to 65535")
    return value


_ShutterTime = Annotated[Fraction, BeforeValidator(_parse_time), AfterValidator(_check_time)]


class PtpConfig(DeviceConfig):
    """The options of a virtual PTP camera.

    Attributes:
        serial: serial number
        vendor: the maker whose properties and operations it has; none: the standard's only
        files: the compression settings; property 5004 selects one of several, and "dng+jpeg"
            writes two files per exposure
        delay_s: from the end of an exposure until its files are on the card
        noise_reduction: a dark exposure of the same time follows each exposure
        overlap: during an exposure files can be read and properties set; else the camera is busy
        object_bytes: files shorter than this are padded
        quality: of JPEGs
        zlp: "always": a transfer of whole packets ends with an empty packet; "never": it does not
        split_header: the header of a data phase is sent as a transfer of its own
        folder_event: the folder of a picture is announced as a new object, too
        event_order: events are sent "after" or "before" the response, or "never"
        times: shutter times, seconds or "1/60"
        time_form: allowed values of property 500D: a list ("enum") or 1..600000 ("range")
        isos: sensitivities; 100 is gain 1
        f_numbers: apertures in hundredths, the widest lets all the light through; none: the host
            cannot set the aperture
        bulb: exposures that the host begins and ends
        mode: of the dial: "manual", or "auto", where the host cannot set the shutter time;
            "recorded": as the facts of `body` have it
        absolute: Sony: the shutter time can be set, not only stepped
        body: name of a recorded body, see `camctl.sim.devices.ptp.body_facts`; its maker, its
            properties and its behaviour replace the defaults
        access: to the card: 0 read and write, 1 read-only, 2 read-only with deletion
        reuses_names: a new picture takes the lowest free number and handle
        unlisted: operations that the camera has and does not list
        crashes_on: operations after which the camera does not answer any more
        auto_iso: Nikon: the camera chooses the sensitivity until property D054 is set to 0
        hides_properties: Nikon: only operation 90CA lists the maker's properties
        parameters_9207: Nikon: how many parameters operation 9207 takes
        needs_focus: Nikon: operation 9207 without focusing is refused
        needs_control: Nikon: the shutter time can be set after operation 90C2 (1) only
        states_size: property 5003 states the size of the pictures
        empty_polls: Canon: so many first event polls return nothing
        needs_output: Canon: it takes pictures once property D1B0 is 8 (live picture to the host)
        remote_mode: Canon: the number that operation 9114 must have; 0: it is not needed
        step_s: Sony: a step of a dial takes effect after so long, and another one before is lost
        startup_s: Sony: so long after the handshake the camera takes no picture
    """

    serial: str = Field(default="PTP0001", min_length=1, max_length=32)
    vendor: Literal["none", "nikon", "canon", "sony", "fuji", "olympus", "panasonic"] = "none"
    files: Annotated[
        tuple[Literal["jpeg", "tiff", "dng", "dng+jpeg"], ...], BeforeValidator(as_tuple)
    ] = Field(default=("jpeg",), min_length=1)
    delay_s: float = Field(default=0.0, ge=0, le=60)
    noise_reduction: bool = False
    overlap: bool = True
    object_bytes: int = Field(default=0, ge=0, le=CARD_BYTES)
    quality: int = Field(default=95, ge=1, le=100)
    zlp: Literal["always", "never"] = "always"
    split_header: bool = False
    folder_event: bool = False
    event_order: Literal["after", "before", "never"] = "after"
    times: tuple[_ShutterTime, ...] = Field(default=DIAL_S, min_length=1)
    time_form: Literal["enum", "range"] = "enum"
    isos: tuple[Annotated[int, Field(ge=1, le=0xFFFF)], ...] = (100, 200, 400, 800)
    f_numbers: tuple[Annotated[int, Field(ge=1, le=0xFFFF)], ...] = (280, 400, 560, 800)
    bulb: bool = False
    mode: Literal["manual", "auto", "recorded"] = "manual"
    absolute: bool = True
    body: str | None = None
    access: Literal[0, 1, 2] = 0
    reuses_names: bool = False
    unlisted: tuple[int, ...] = ()
    crashes_on: tuple[int, ...] = ()
    auto_iso: bool = False
    hides_properties: bool = False
    parameters_9207: Literal[1, 2] = 2
    needs_focus: bool = False
    needs_control: bool = False
    states_size: bool = False
    empty_polls: int = Field(default=0, ge=0)
    needs_output: bool = False
    remote_mode: int = Field(default=1, ge=0)
    step_s: float = Field(default=0.0, ge=0, le=60)
    startup_s: float = Field(default=0.0, ge=0, le=60)

    @model_validator(mode="before")
    @classmethod
    def _has_manners_of_body(cls, options: Any) -> Any:
        if isinstance(options, dict) and options.get("body"):
            return {**manners_of(options["body"]), **options}
        return options

    @property
    def facts(self) -> BodyFacts | None:
        """The facts of `body`."""
        return load_body(self.body) if self.body else None

    def load_picture_sensor(self) -> VirtualSensor:
        """Return the sensor, which must be able to give the files that the camera saves.

        Raises:
            UsageError, DataError: scene, sensor or files are invalid
        """
        sensor = self.load_sensor()
        if "dng" in "+".join(self.files) and sensor.layout is Layout.RGB:
            raise UsageError(
                "an RGB sensor has no raw file", hint="use jpeg or tiff, or a Bayer sensor"
            )
        return sensor

    def identity(self, generic: Identity) -> Identity:
        """Return the identity of `body`, with the USB numbers of its maker's virtual camera."""
        facts = self.facts
        if facts is None:
            return generic
        return replace(generic, make=facts.make, model=facts.model, extension=facts.extension)


def file_formats(compression: str) -> tuple[str, ...]:
    """Return the formats of the files that one of `PtpConfig.files` writes."""
    return tuple(compression.split("+"))


@dataclass(frozen=True)
class Identity:
    """A camera's identity in its USB descriptors and its device info."""

    vendor_id: int
    product_id: int
    make: str
    model: str
    extension: int = 0
    extension_version: int = 0


@dataclass
class WireFaults:
    """Faults of the cable and of the protocol.

    Attributes:
        busy: so many operations are answered Device_Busy; -1: all of them
        is_hanging: operations are not answered
        stalls: so many operations stall the bulk endpoints
        truncations: of so many objects only half is sent ..
        answers_truncated: .. and then a response, as if the object were complete
        garbage: so many replies are random bytes
        unplug_after: bytes of the next object after which the camera is unplugged; None: it is not
    """

    busy: int = 0
    is_hanging: bool = False
    stalls: int = 0
    truncations: int = 0
    answers_truncated: bool = False
    garbage: int = 0
    unplug_after: int | None = None


class WireFaultCommands(Controllable):
    """Control commands that set `WireFaults`."""

    faults: WireFaults

    def do_busy(self, count: int = 5) -> None:
        """Answer the next `count` operations, or all (-1), with Device_Busy."""
        self.faults.busy = count

    def do_hang(self) -> None:
        """Answer no operation."""
        self.faults.is_hanging = True

    def do_stall(self, count: int = 1) -> None:
        """Stall instead of executing the next `count` operations."""
        self.faults.stalls = count

    def do_truncate(self, count: int = 1, answers: bool = False) -> None:
        """Send half of the next `count` objects; then a response if `answers`, else nothing."""
        self.faults.truncations, self.faults.answers_truncated = count, answers

    def do_garbage(self, count: int = 1) -> None:
        """Send random bytes instead of the next `count` replies."""
        self.faults.garbage = count

    def do_unplug(self, after_bytes: int | None = None) -> None:
        """Unplug the camera; with `after_bytes`, once so much of the next object has been sent."""
        self.faults.unplug_after = after_bytes
        if after_bytes is None:
            self.detach()
