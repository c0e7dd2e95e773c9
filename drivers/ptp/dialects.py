"""Dialects of PTP as tables: the properties of the exposure, and the operations that take pictures.

The standard alone is published (ISO 15740).  The makers' tables were put together from what others
have found out about their cameras, and **have not been tried on a real body**; a camera that uses
one says so in its notes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction

from drivers.ptp.codes import Op, Prop
from drivers.ptp.dials import (
    Scale,
    eos_f_number,
    eos_gain,
    eos_time,
    hundredths,
    iso,
    ratio,
    sony_iso,
    ten_thousandths,
)

#: In the parameters of a step that closes the shutter: stands for the transaction that opened it.
OPENING_TRANSACTION = -1


class Source(Enum):
    """The operation by which a camera describes its properties."""

    EACH_PROPERTY = "one by one, 0x1014"
    EOS_EVENTS = "records of Canon's event poll, 0x9116"
    SONY_LIST = "Sony's list of all properties, 0x9209"


@dataclass(frozen=True)
class Step:
    """One operation of a fixed sequence; `data` is sent with it unless it is None."""

    operation: int
    parameters: tuple[int, ...] = ()
    data: bytes | None = None


@dataclass(frozen=True)
class Dialect:
    """The standard's or one maker's use of PTP.

    Attributes:
        name: "standard", or the maker in lower case
        needs: operations that a camera must support to use this dialect
        source: how properties are described
        times, gains, f_numbers: properties for this control, in order of preference
        program: the property of the mode dial, and its numbers for manual exposure
        battery: the property of the charge in per cent
        opening: operations after the session is open
        presets: properties and values to set after that if the camera supports them: single shots,
            no automatic ISO, pictures to the card
        releases: ways to take a picture, in order of preference; the camera must support all
            operations of the one used
        bulb: number of the shutter property for bulb, if it must be set to that
        bulb_opens, bulb_closes: operations that open and close the shutter in a bulb exposure
        ready: the operation that is answered "busy" until the camera is ready
        polled: the operation that returns events, if they are not sent over the interrupt pipe
        memory: handle of a picture that waits in the camera's memory and not on its card
        stepped_times: shutter numbers of cameras that step through them without listing them
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
    opening: tuple[Step, ...] = ()
    presets: tuple[tuple[int, int], ...] = ()
    bulb: int | None = None
    bulb_opens: tuple[Step, ...] = ()
    bulb_closes: tuple[Step, ...] = ()
    ready: int | None = None
    polled: int | None = None
    memory: int | None = None
    stepped_times: tuple[int, ...] = ()


_UNIT_S, _PERCENT = Fraction(1, 10_000), Fraction(1, 100)
_EXPOSURE_TIME = Scale(Prop.EXPOSURE_TIME, ten_thousandths, _UNIT_S)
_F_NUMBER = Scale(Prop.F_NUMBER, hundredths, _PERCENT)
_EXPOSURE_INDEX = Scale(Prop.EXPOSURE_INDEX, iso, _PERCENT)
_MANUAL = (Prop.EXPOSURE_PROGRAM, frozenset({1}))
_SINGLE_SHOTS = (Prop.STILL_CAPTURE_MODE, 1)
_UNSPECIFIED = 0xFFFFFFFF  # the parameter that libgphoto2 sends
_INITIATE = (Step(Op.INITIATE_CAPTURE, (0, 0)),)

STANDARD = Dialect(
    name="standard",
    needs=frozenset(),
    source=Source.EACH_PROPERTY,
    times=(_EXPOSURE_TIME,),
    gains=(_EXPOSURE_INDEX,),
    f_numbers=(_F_NUMBER,),
    program=_MANUAL,
    battery=Prop.BATTERY_LEVEL,
    presets=(_SINGLE_SHOTS,),
    releases=(_INITIATE,),
    bulb_opens=(Step(Op.INITIATE_OPEN_CAPTURE, (0, 0)),),
    bulb_closes=(Step(Op.TERMINATE_OPEN_CAPTURE, (OPENING_TRANSACTION,)),),
)

NIKON = Dialect(
    name="nikon",
    needs=frozenset({Op.NIKON_READY}),
    source=Source.EACH_PROPERTY,
    times=(Scale(Prop.NIKON_EXPOSURE_TIME, ratio), _EXPOSURE_TIME),
    gains=(_EXPOSURE_INDEX,),
    f_numbers=(_F_NUMBER,),
    program=_MANUAL,
    battery=Prop.BATTERY_LEVEL,
    presets=(_SINGLE_SHOTS, (Prop.NIKON_ISO_AUTO, 0)),
    releases=(
        # Without autofocus, to the card.
        (Step(Op.NIKON_CAPTURE_TO, (_UNSPECIFIED, 0)),),
        _INITIATE,
        (Step(Op.NIKON_CAPTURE, (_UNSPECIFIED,)),),
    ),
    bulb=0xFFFFFFFF,
    bulb_opens=(Step(Op.NIKON_CAPTURE_TO, (_UNSPECIFIED, 0)),),
    bulb_closes=(Step(Op.NIKON_TERMINATE_CAPTURE, (0, 0)),),
    ready=Op.NIKON_READY,
    polled=Op.NIKON_EVENTS,
    memory=0xFFFF0001,
)

CANON_EOS = Dialect(
    name="canon",
    needs=frozenset({Op.EOS_SET_PROPERTY, Op.EOS_EVENTS, Op.EOS_REMOTE_MODE}),
    source=Source.EOS_EVENTS,
    times=(Scale(Prop.EOS_SHUTTER, eos_time),),
    gains=(Scale(Prop.EOS_ISO, eos_gain),),
    f_numbers=(Scale(Prop.EOS_APERTURE, eos_f_number),),
    program=(Prop.EOS_PROGRAM, frozenset({3, 4})),  # manual, bulb
    battery=Prop.BATTERY_LEVEL,
    opening=(Step(Op.EOS_REMOTE_MODE, (1,)), Step(Op.EOS_EVENT_MODE, (1,))),
    presets=((Prop.EOS_DESTINATION, 2),),  # pictures to the card
    releases=(
        (Step(Op.EOS_RELEASE),),
        (Step(Op.EOS_RELEASE_ON, (3, 0)), Step(Op.EOS_RELEASE_OFF, (3,))),
    ),
    bulb=0x0C,
    bulb_opens=(Step(Op.EOS_BULB_START),),
    bulb_closes=(Step(Op.EOS_BULB_END),),
    polled=Op.EOS_EVENTS,
)

_PRESSED, _RELEASED = (2).to_bytes(2, "little"), (1).to_bytes(2, "little")
_FOCUS, _SHUTTER = (Prop.SONY_BUTTON_FOCUS,), (Prop.SONY_BUTTON_SHUTTER,)
_PRESS_BUTTONS = (
    Step(Op.SONY_CONTROL, _FOCUS, _PRESSED),
    Step(Op.SONY_CONTROL, _SHUTTER, _PRESSED),
)
_RELEASE_BUTTONS = (
    Step(Op.SONY_CONTROL, _SHUTTER, _RELEASED),
    Step(Op.SONY_CONTROL, _FOCUS, _RELEASED),
)

# Sony's shutter times in thirds of a stop: n/10 s from 0.4 s on, 1/n s below.
_SONY_TENTHS = (300, 250, 200, 150, 130, 100, 80, 60, 50, 40, 32, 25, 20, 16, 13, 10, 8, 6, 5, 4)
_SONY_PARTS = (
    *(3, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320, 400),
    *(500, 640, 800, 1000, 1250, 1600, 2000, 2500, 3200, 4000, 5000, 6400, 8000),
)

SONY = Dialect(
    name="sony",
    needs=frozenset({Op.SONY_CONNECT, Op.SONY_CONTROL, Op.SONY_PROPERTIES}),
    source=Source.SONY_LIST,
    times=(Scale(Prop.SONY_SHUTTER, ratio),),
    gains=(Scale(Prop.SONY_ISO, sony_iso, _PERCENT),),
    f_numbers=(_F_NUMBER,),
    program=_MANUAL,
    battery=Prop.SONY_BATTERY,
    opening=(
        Step(Op.SONY_CONNECT, (1, 0, 0)),
        Step(Op.SONY_CONNECT, (2, 0, 0)),
        Step(Op.SONY_INFO, (0xC8,)),
        Step(Op.SONY_CONNECT, (3, 0, 0)),
    ),
    releases=((*_PRESS_BUTTONS, *_RELEASE_BUTTONS),),
    bulb=0,
    bulb_opens=_PRESS_BUTTONS,
    bulb_closes=_RELEASE_BUTTONS,
    memory=0xFFFFC001,
    stepped_times=(
        *(tenths << 16 | 10 for tenths in _SONY_TENTHS),
        *(1 << 16 | parts for parts in _SONY_PARTS),
    ),
)

# By a word of the maker's name, tried before the vendor extension, which is Microsoft's (MTP) on
# many of their cameras.
_MAKERS: Mapping[str, Dialect] = {"nikon": NIKON, "canon": CANON_EOS, "sony": SONY}
# By the vendor extension in DeviceInfo.
_EXTENSIONS: Mapping[int, Dialect] = {0x0A: NIKON, 0x0B: CANON_EOS, 0x11: SONY}


def dialect_of(extension: int, make: str, operations: frozenset[int]) -> Dialect:
    """Return the dialect for a camera with this vendor extension, maker and operations."""
    by_name = next((d for name, d in _MAKERS.items() if name in make.lower()), None)
    dialect = by_name or _EXTENSIONS.get(extension, STANDARD)
    return dialect if dialect.needs <= operations else STANDARD
