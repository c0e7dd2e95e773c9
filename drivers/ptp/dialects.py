"""Dialects of PTP: what the standard and each maker use to set an exposure and to take a picture.

This module has the form of a dialect, and the standard's (ISO 15740), which alone is published;
the dialects of the makers are in `camctl.drivers.ptp.makers`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from fractions import Fraction

from camctl.drivers.ptp.codes import Op, Prop
from camctl.drivers.ptp.dials import Scale, hundredths, iso, ten_thousandths

#: In the parameters of a step that closes the shutter: stands for the transaction that opened it.
OPENING_TRANSACTION = -1


class Source(Enum):
    """The operation by which a camera describes its properties."""

    EACH_PROPERTY = "one by one, 0x1014"
    EOS_EVENTS = "records of Canon's event poll, 0x9116"
    SONY_LIST = "Sony's list of all properties, 0x9209"
    PANASONIC = "Panasonic's descriptions of properties of 32-bit codes, 0x9108"


@dataclass(frozen=True)
class Hold:
    """How long a pressed button is held: until a property says that the lens has focused.

    Attributes:
        code: of this property
        found: its numbers once the lens has focused
        mode: the property of the focus mode, and its number for manual focus, which needs no wait
        longest_s: the button is let go then at the latest, s
    """

    code: int
    found: frozenset[int]
    mode: tuple[int, int]
    longest_s: float


@dataclass(frozen=True)
class Step:
    """One operation of a fixed sequence.

    Attributes:
        operation: its code
        parameters: of the operation
        data: sent with it; None: there is no data phase
        is_optional: left out where the camera does not list the operation; its refusal is ignored
        busy_at: (property, number): the step is over when the property has another number ..
        fails_at: .. and this number means that the camera cannot focus
        hold: what is waited for after it
        polls: the camera's events are asked for after it
        undo: steps that take it back where a later step of the sequence fails
    """

    operation: int
    parameters: tuple[int, ...] = ()
    data: bytes | None = None
    is_optional: bool = False
    busy_at: tuple[int, int] | None = None
    fails_at: int | None = None
    hold: Hold | None = None
    polls: bool = False
    undo: tuple[Step, ...] = ()


@dataclass(frozen=True)
class Preset:
    """A property that is set when the camera is opened, if the camera supports it.

    Attributes:
        code: of the property
        number: its value; the value with which the camera is used
        refusal: (what, hint) of the error if the camera keeps another value; None: it may
    """

    code: int
    number: int
    refusal: tuple[str, str] | None = None


@dataclass(frozen=True)
class Dialect:
    """The standard's or one maker's use of PTP.

    Attributes:
        name: "standard", or the maker in lower case
        needs: operations that a camera must support to use this dialect
        source: how properties are described
        times, gains, f_numbers: properties for this control, in order of preference
        program: the property of the mode dial, and its numbers for manual exposure; no numbers:
            they are not known
        battery: the property of the charge in per cent
        modes: what the mode dial is at, by the number of its property
        lens: the property with the name of the lens; or four, in hundredths: its shortest and
            longest focal length, mm, and its largest aperture at both
        lens_warning: a property that is 1 where the lens is not in working position, and the
            response code with this meaning
        unlisted: operations that the camera has and does not list
        unreliable: operations that it lists and that do not work
        opening: operations after the session is open
        control: the operation by which the computer takes over what the mode dial decides, used if
            the shutter time cannot be set; with the parameter 0 it gives that back
        closing: operations before the session is closed
        startup_s: how long after the opening the camera takes no picture
        hidden: operations that list properties which the device information leaves out:
            (operation, parameters, bytes of a code)
        tried: properties that are read even if nothing lists them
        presets: single shots, no automatic ISO, pictures to the card, control by the computer
        releases: ways to take a picture, in order of preference; the camera must support all
            operations of the one used
        retries: response codes to a release after which the next way with the same operation is
            used; after "operation not supported" it is the next way whatever its operation
        kept_on: the operation that keeps the camera from switching itself off
        acknowledged: events that are answered by an operation with the event's parameter
        bulb: number of the shutter property for bulb, if it must be set to that
        bulb_opens, bulb_closes: operations that open and close the shutter in a bulb exposure
        aborts: operations that end an exposure that the camera times
        ready: the operation that is answered "busy" until the camera is ready
        polled: the operation that returns events, if they are not sent over the interrupt pipe
        memory: handle of a picture that waits in the camera's memory and not on its card
        lists_objects: True if the camera lists the objects of all cards; some do not answer
        listed_times: shutter numbers of cameras that list none ..
        is_stepped: .. and whether these are reached by steps up and down only
    """

    name: str
    needs: frozenset[int]
    source: Source
    times: tuple[Scale, ...]
    gains: tuple[Scale, ...]
    f_numbers: tuple[Scale, ...]
    program: tuple[int, frozenset[int]]
    battery: int
    releases: tuple[tuple[Step, ...], ...]
    modes: Mapping[int, str] = field(default_factory=lambda: MODES)
    lens: tuple[int, ...] = ()
    lens_warning: tuple[int, int] | None = None
    unlisted: frozenset[int] = frozenset()
    unreliable: frozenset[int] = frozenset()
    opening: tuple[Step, ...] = ()
    control: Step | None = None
    closing: tuple[Step, ...] = ()
    startup_s: float = 0.0
    hidden: tuple[tuple[int, tuple[int, ...], int], ...] = ()
    tried: frozenset[int] = frozenset()
    presets: tuple[Preset, ...] = ()
    retries: frozenset[int] = frozenset()
    kept_on: int | None = None
    acknowledged: tuple[tuple[int, int], ...] = ()
    bulb: int | None = None
    bulb_opens: tuple[Step, ...] = ()
    bulb_closes: tuple[Step, ...] = ()
    aborts: tuple[Step, ...] = ()
    ready: int | None = None
    polled: int | None = None
    memory: int | None = None
    lists_objects: bool = True
    listed_times: tuple[int, ...] = ()
    is_stepped: bool = True


MODES: dict[int, str] = dict(
    enumerate(("M", "P", "A", "S", "creative", "action", "portrait"), start=1)
)
"""Of property 500E: ISO 15740, 13.4.14; the makers add theirs from 0x8000 on."""
UNIT_S, PERCENT = Fraction(1, 10_000), Fraction(1, 100)  # of 500D, s; of 5007 and 500F
EXPOSURE_TIME = Scale(Prop.EXPOSURE_TIME, ten_thousandths, UNIT_S)
F_NUMBER = Scale(Prop.F_NUMBER, hundredths, PERCENT)
EXPOSURE_INDEX = Scale(Prop.EXPOSURE_INDEX, iso, PERCENT)
MANUAL = (Prop.EXPOSURE_PROGRAM, frozenset({1}))
SINGLE_SHOTS = Preset(Prop.STILL_CAPTURE_MODE, 1)
INITIATE = (Step(Op.INITIATE_CAPTURE, (0, 0)),)

STANDARD = Dialect(
    name="standard",
    needs=frozenset(),
    source=Source.EACH_PROPERTY,
    times=(EXPOSURE_TIME,),
    gains=(EXPOSURE_INDEX,),
    f_numbers=(F_NUMBER,),
    program=MANUAL,
    battery=Prop.BATTERY_LEVEL,
    presets=(SINGLE_SHOTS,),
    releases=(INITIATE,),
    bulb_opens=(Step(Op.INITIATE_OPEN_CAPTURE, (0, 0)),),
    bulb_closes=(Step(Op.TERMINATE_OPEN_CAPTURE, (OPENING_TRANSACTION,)),),
)
