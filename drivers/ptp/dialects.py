"""Dialects of PTP as tables: which property is the shutter, what numbers mean, what releases it.

Only the standard is published (ISO 15740).  The makers' rows were put together from what others
have found out about their cameras, and **have not been tried on a real body**; every camera that
uses one says so in its notes.

What the numbers mean:

- 500D counts units of 1e-4 s.  Times of less than 5 units are left out, since rounding to the unit
  is then more than 10 % of the time (1/8000 s reads as 1 unit, 20 % short).
- Nikon's D100 and Sony's D20D are fractions, numerator in the upper 16 bits.
- Canon's codes are eighths of a stop: 2^((0x38 - code) / 8) s, f/2^((code - 8) / 16),
  ISO 100 x 2^((code - 0x48) / 8).

Fractions and decimals are taken by their word.  Many cameras with a mechanical shutter label in
round numbers what are powers of two (1/60 is 1/64 s, 30 s is 32 s: P. Debevec and J. Malik,
"Recovering High Dynamic Range Radiance Maps from Photographs", 1997, section 2.1, measured it so);
others mean the number that they say.  Which it is cannot be asked over PTP, so nothing is corrected
here, and the notes say so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from fractions import Fraction

from drivers.ptp.codes import Op, Prop

#: As a parameter of a step that closes the shutter: the transaction that opened it.
OPENING_TRANSACTION = -1


class Source(Enum):
    """Where a camera tells what its properties are and can be."""

    ASKED = "one by one, 0x1014"
    EOS_EVENTS = "records of Canon's event poll, 0x9116"
    SONY_LIST = "Sony's list of all properties, 0x9209"


@dataclass(frozen=True)
class Scale:
    """What the numbers of one property mean.

    Attributes:
        code: the property
        decode: number to SI value (s, linear gain with ISO 100 as 1, f-number); None for numbers
            that are no such value, such as bulb or automatic
        unit: SI value of 1, where numbers are simply multiples of it
    """

    code: int
    decode: Callable[[int], float | None]
    unit: Fraction | None = None


@dataclass(frozen=True)
class Step:
    """One operation of a fixed sequence; `data` goes with it where it is not None."""

    operation: int
    parameters: tuple[int, ...] = ()
    data: bytes | None = None


@dataclass(frozen=True)
class Dialect:
    """One way of speaking PTP.

    Attributes:
        name: "standard", or the maker in small letters
        needs: operations that a camera must have to be spoken to so
        source: where properties are described
        times, gains, f_numbers: properties that can be this control, the best first
        program: the property with the mode dial, and its numbers for manual exposure
        battery: the property with the charge in per cent
        opening: operations after the session is open
        presets: properties to set then, where the camera can: single shots, no automatic ISO, onto
            the card
        releases: ways to take a picture, the best first; one whose operations are all there is used
        bulb: number of the shutter property that means bulb, where it must be set to that
        bulb_opens, bulb_closes: what opens and closes the shutter then
        ready: the operation that is answered "busy" until the camera is done
        polled: the operation that brings events, where they do not come by themselves
        memory: handle of a picture that waits in the camera's memory rather than on its card
        times_s: shutter numbers of cameras that can step through them but do not list them
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
    times_s: tuple[int, ...] = ()


_FIRST_SPECIAL = 0xFFFFFFF0  # bulb, time, x-sync
_LEAST_UNITS = 5


def ten_thousandths(number: int) -> float | None:
    """Return seconds of property 500D.

    >>> ten_thousandths(166)
    0.0166
    """
    if not _LEAST_UNITS <= number < _FIRST_SPECIAL:
        return None
    return number / 10_000


def ratio(number: int) -> float | None:
    """Return seconds of a fraction, numerator in the upper 16 bits.

    >>> ratio(1 << 16 | 60) == 1 / 60
    True
    """
    if number >= _FIRST_SPECIAL or not (number >> 16 and number & 0xFFFF):
        return None
    return float(Fraction(number >> 16, number & 0xFFFF))


def eos_time(code: int) -> float | None:
    """Return seconds of Canon's code; 0x0C is bulb, 0x10 the longest.

    >>> eos_time(0x38), eos_time(0x68)
    (1.0, 0.015625)
    """
    return 2.0 ** ((0x38 - code) / 8) if 0x10 <= code <= 0xA8 else None


def eos_f_number(code: int) -> float | None:
    """Return the f-number of Canon's code.

    >>> eos_f_number(0x08), eos_f_number(0x28)
    (1.0, 4.0)
    """
    return 2.0 ** ((code - 8) / 16) if 1 <= code <= 0x78 else None


def eos_gain(code: int) -> float | None:
    """Return the gain of Canon's ISO code; 0 is automatic.

    >>> eos_gain(0x48), eos_gain(0x58)
    (1.0, 4.0)
    """
    return 2.0 ** ((code - 0x48) / 8) if 0x28 <= code <= 0xB8 else None


def hundredths(number: int) -> float | None:
    """Return the f-number of property 5007.

    >>> hundredths(280)
    2.8
    """
    return number / 100 if 0 < number < 0xFFFE else None


def iso(number: int) -> float | None:
    """Return the gain of an ISO number, ISO 100 being 1; FFFF and the like are automatic.

    >>> iso(400)
    4.0
    """
    return number / 100 if 0 < number < 0xFF00 else None


def sony_iso(number: int) -> float | None:
    """Return the gain of Sony's ISO number.

    FFFFFF is automatic; the upper byte stands for exposures averaged in the camera, which are
    another thing.
    """
    return number / 100 if 0 < number < 0xFFFFFF else None


_UNIT_S, _PERCENT = Fraction(1, 10_000), Fraction(1, 100)
_EXPOSURE_TIME = Scale(Prop.EXPOSURE_TIME, ten_thousandths, _UNIT_S)
_F_NUMBER = Scale(Prop.F_NUMBER, hundredths, _PERCENT)
_EXPOSURE_INDEX = Scale(Prop.EXPOSURE_INDEX, iso, _PERCENT)
_MANUAL = (Prop.EXPOSURE_PROGRAM, frozenset({1}))
_SINGLE_SHOTS = (Prop.STILL_CAPTURE_MODE, 1)
_EVERYTHING = 0xFFFFFFFF
_INITIATE = (Step(Op.INITIATE_CAPTURE, (0, 0)),)

STANDARD = Dialect(
    name="standard",
    needs=frozenset(),
    source=Source.ASKED,
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
    source=Source.ASKED,
    times=(Scale(Prop.NIKON_EXPOSURE_TIME, ratio), _EXPOSURE_TIME),
    gains=(_EXPOSURE_INDEX,),
    f_numbers=(_F_NUMBER,),
    program=_MANUAL,
    battery=Prop.BATTERY_LEVEL,
    presets=(_SINGLE_SHOTS, (Prop.NIKON_ISO_AUTO, 0)),
    releases=(
        # Without autofocus, onto the card.
        (Step(Op.NIKON_CAPTURE_TO, (_EVERYTHING, 0)),),
        _INITIATE,
        (Step(Op.NIKON_CAPTURE, (_EVERYTHING,)),),
    ),
    bulb=0xFFFFFFFF,
    bulb_opens=(Step(Op.NIKON_CAPTURE_TO, (_EVERYTHING, 0)),),
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
    presets=((Prop.EOS_DESTINATION, 2),),  # the card
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
_PRESS = (
    Step(Op.SONY_CONTROL, _FOCUS, _PRESSED),
    Step(Op.SONY_CONTROL, _SHUTTER, _PRESSED),
)
_LET_GO = (
    Step(Op.SONY_CONTROL, _SHUTTER, _RELEASED),
    Step(Op.SONY_CONTROL, _FOCUS, _RELEASED),
)

# Thirds of a stop as Sony writes them: tenths of a second from 0.4 s on, else one over a number.
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
    releases=((*_PRESS, *_LET_GO),),
    bulb=0,
    bulb_opens=_PRESS,
    bulb_closes=_LET_GO,
    memory=0xFFFFC001,
    times_s=(
        *(tenths << 16 | 10 for tenths in _SONY_TENTHS),
        *(1 << 16 | parts for parts in _SONY_PARTS),
    ),
)

# The makers' own, tried in this order before the standard; found by what a camera calls itself,
# since the vendor extension is Microsoft's (MTP) on many of them.
_MAKERS: Mapping[str, Dialect] = {"nikon": NIKON, "canon": CANON_EOS, "sony": SONY}
# Vendor extensions of DeviceInfo.
_EXTENSIONS: Mapping[int, Dialect] = {0x0A: NIKON, 0x0B: CANON_EOS, 0x11: SONY}


def dialect_of(extension: int, make: str, operations: frozenset[int]) -> Dialect:
    """Return how to speak to a camera that says this of itself."""
    by_name = next((d for name, d in _MAKERS.items() if name in make.lower()), None)
    dialect = by_name or _EXTENSIONS.get(extension, STANDARD)
    return dialect if dialect.needs <= operations else STANDARD
