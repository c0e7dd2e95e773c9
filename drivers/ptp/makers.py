"""The makers' dialects of PTP as tables, and which of them a camera speaks.

Put together from what others have found out about their cameras (the bodies that libgphoto2 has
recorded, and its handling of them); **not tried on a real body by this project**.  A camera that
uses one says so in its notes.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from camctl.drivers.ptp.codes import NIKON_LENS, Event, Op, Prop
from camctl.drivers.ptp.dialects import (
    EXPOSURE_INDEX,
    EXPOSURE_TIME,
    F_NUMBER,
    INITIATE,
    MANUAL,
    MODES,
    PERCENT,
    SINGLE_SHOTS,
    STANDARD,
    Dialect,
    Hold,
    Preset,
    Source,
    Step,
)
from camctl.drivers.ptp.dials import (
    Scale,
    eos_f_number,
    eos_gain,
    eos_time,
    fuji_time,
    hundredths,
    iso,
    panasonic_time,
    ratio,
    sony_iso,
    tenths,
)
from camctl.drivers.ptp.maker_datasets import pack_eos_property

_AUTOMATIC_ISO = (
    "chooses its sensitivity itself",
    "switch automatic ISO off in its menu, and set its ISO to a number",
)
_WITHOUT_FOCUSING, _WITH_FOCUSING = 0xFFFFFFFF, 0xFFFFFFFE  # first parameter of 9207
_TO_CARD = 0  # second one

_NIKON_SCENES = (
    *("auto", "portrait", "landscape", "close-up", "sports", "night portrait"),
    *("night landscape", "children", "auto without flash"),
)
_EOS_MODES = (
    *("P", "Tv", "Av", "M", "B", "A-DEP", "DEP", "C1", "lock", "auto", "night portrait"),
    *("sports", "portrait", "landscape", "close-up", "auto without flash", "C2", "C3"),
)
_SONY_MODES = {0x8000: "intelligent auto", 0x8001: "superior auto", 0x8050: "film"}

NIKON = Dialect(
    name="nikon",
    needs=frozenset({Op.NIKON_READY}),
    source=Source.EACH_PROPERTY,
    times=(Scale(Prop.NIKON_EXPOSURE_TIME, ratio), EXPOSURE_TIME),
    gains=(EXPOSURE_INDEX,),
    f_numbers=(F_NUMBER,),
    program=MANUAL,
    battery=Prop.BATTERY_LEVEL,
    modes=MODES | dict(enumerate(_NIKON_SCENES, start=0x8010)),
    lens=(
        Prop.NIKON_SHORTEST_FOCAL,
        Prop.NIKON_LONGEST_FOCAL,
        Prop.NIKON_APERTURE_AT_SHORTEST,
        Prop.NIKON_APERTURE_AT_LONGEST,
    ),
    lens_warning=(Prop.NIKON_RETRACTABLE_LENS, NIKON_LENS),
    # Most bodies list their own properties, the exact time and automatic ISO among them, here only.
    hidden=((Op.NIKON_PROPERTY_CODES, (), 2), (Op.NIKON_CODES, (0xD,), 4)),
    tried=frozenset({Prop.NIKON_EXPOSURE_TIME, Prop.NIKON_ISO_AUTO}),
    control=Step(Op.NIKON_CAMERA_MODE, (1,), is_optional=True),
    presets=(SINGLE_SHOTS, Preset(Prop.NIKON_ISO_AUTO, 0, _AUTOMATIC_ISO)),
    releases=(
        (Step(Op.NIKON_CAPTURE_TO, (_WITHOUT_FOCUSING, _TO_CARD)),),
        (Step(Op.NIKON_CAPTURE_TO, (_WITH_FOCUSING, _TO_CARD)),),  # Nikon 1
        (Step(Op.NIKON_CAPTURE_TO, (_WITHOUT_FOCUSING,)),),  # D3X
        INITIATE,
        (Step(Op.NIKON_CAPTURE, (_WITHOUT_FOCUSING,)),),
    ),
    retries=frozenset({0x2006, 0xA004}),  # a parameter is not supported; invalid status
    bulb=0xFFFFFFFF,
    bulb_opens=(Step(Op.NIKON_CAPTURE_TO, (_WITHOUT_FOCUSING, _TO_CARD)),),
    bulb_closes=(Step(Op.NIKON_TERMINATE_CAPTURE, (0, 0)),),
    aborts=(Step(Op.NIKON_TERMINATE_CAPTURE, (0, 0)),),
    ready=Op.NIKON_READY,
    polled=Op.NIKON_EVENTS,
    memory=0xFFFF0001,
)

_EVENT_MODE = Step(Op.EOS_EVENT_MODE, (1,))
_EOS_HALF_OFF, _EOS_FULL_OFF = (Step(Op.EOS_RELEASE_OFF, (1,)),), (Step(Op.EOS_RELEASE_OFF, (2,)),)

CANON_EOS = Dialect(
    name="canon",
    needs=frozenset({Op.EOS_SET_PROPERTY, Op.EOS_EVENTS, Op.EOS_REMOTE_MODE}),
    source=Source.EOS_EVENTS,
    times=(Scale(Prop.EOS_SHUTTER, eos_time),),
    gains=(Scale(Prop.EOS_ISO, eos_gain),),
    f_numbers=(Scale(Prop.EOS_APERTURE, eos_f_number),),
    program=(Prop.EOS_PROGRAM, frozenset({3, 4})),  # manual, bulb
    battery=Prop.BATTERY_LEVEL,
    modes=dict(enumerate(_EOS_MODES)),
    lens=(Prop.EOS_LENS_NAME,),
    opening=(Step(Op.EOS_REMOTE_MODE, (1,)), _EVENT_MODE),
    presets=(Preset(Prop.EOS_DESTINATION, 2),),  # pictures to the card
    releases=(
        # Half press, which focuses, then full press; both are let go.
        (
            Step(Op.EOS_RELEASE_ON, (1, 0), polls=True, undo=_EOS_HALF_OFF),
            Step(Op.EOS_RELEASE_ON, (2, 0), undo=_EOS_FULL_OFF),
            *_EOS_FULL_OFF,
            *_EOS_HALF_OFF,
        ),
        (Step(Op.EOS_RELEASE),),
    ),
    kept_on=Op.EOS_KEEP_ON,
    bulb=0x0C,
    bulb_opens=(Step(Op.EOS_BULB_START),),
    bulb_closes=(Step(Op.EOS_BULB_END),),
    polled=Op.EOS_EVENTS,
)


def _u16(number: int) -> bytes:
    return number.to_bytes(2, "little")


_PRESSED, _RELEASED = _u16(2), _u16(1)  # states of a button
_FOCUS, _SHUTTER = (Prop.SONY_BUTTON_FOCUS,), (Prop.SONY_BUTTON_SHUTTER,)
_LET_GO = (
    Step(Op.SONY_CONTROL, _SHUTTER, _RELEASED),
    Step(Op.SONY_CONTROL, _FOCUS, _RELEASED),
)
_PRESS_BUTTONS = (
    Step(Op.SONY_CONTROL, _FOCUS, _PRESSED, undo=_LET_GO[1:]),
    Step(Op.SONY_CONTROL, _SHUTTER, _PRESSED, undo=_LET_GO[:1]),
)
# Let go before the lens has focused, they take no picture: libgphoto2 waits a second at most.
_FOCUSED = Hold(Prop.SONY_FOCUS_STATE, frozenset({2, 3}), (Prop.FOCUS_MODE, 1), 1.0)
_PRESS_AND_HOLD = (_PRESS_BUTTONS[0], replace(_PRESS_BUTTONS[1], hold=_FOCUSED))

# Times in thirds of a stop: n/10 s from 0.4 s on, 1/n s below.
_TENTHS = (300, 250, 200, 150, 130, 100, 80, 60, 50, 40, 32, 25, 20, 16, 13, 10, 8, 6, 5, 4)
_PARTS = (
    *(3, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 50, 60, 80, 100, 125, 160, 200, 250, 320, 400),
    *(500, 640, 800, 1000, 1250, 1600, 2000, 2500, 3200, 4000, 5000, 6400, 8000),
)

SONY = Dialect(
    name="sony",
    needs=frozenset({Op.SONY_CONNECT, Op.SONY_CONTROL, Op.SONY_PROPERTIES}),
    source=Source.SONY_LIST,
    times=(Scale(Prop.SONY_SHUTTER, ratio, set_by=Prop.SONY_SHUTTER_SET),),
    gains=(Scale(Prop.SONY_ISO, sony_iso, set_by=Prop.SONY_ISO_SET),),
    # Their ranges name numbers that the lens does not have: without a list the aperture stays.
    f_numbers=(Scale(Prop.F_NUMBER, hundredths),),
    program=MANUAL,
    battery=Prop.SONY_BATTERY,
    modes=MODES | _SONY_MODES,
    opening=(
        Step(Op.SONY_CONNECT, (1, 0, 0)),
        Step(Op.SONY_CONNECT, (2, 0, 0)),
        Step(Op.SONY_INFO, (0xC8,)),
        Step(Op.SONY_CONNECT, (3, 0, 0)),
    ),
    presets=(Preset(Prop.SONY_PRIORITY, 1),),
    releases=((*_PRESS_AND_HOLD, *_LET_GO),),
    bulb=0,
    bulb_opens=_PRESS_BUTTONS,
    bulb_closes=_LET_GO,
    memory=0xFFFFC001,
    lists_objects=False,
    listed_times=(*(n << 16 | 10 for n in _TENTHS), *(1 << 16 | n for n in _PARTS)),
)

_FUJI_SHUTTER = (Prop.FUJI_BUTTON,)
_FUJI_LET_GO = (
    Step(Op.SET_PROPERTY, _FUJI_SHUTTER, _u16(0x0004)),
    Step(Op.INITIATE_CAPTURE, (0, 0)),
)

FUJI = Dialect(
    name="fuji",
    needs=frozenset({Op.INITIATE_CAPTURE, Op.SET_PROPERTY}),
    source=Source.EACH_PROPERTY,
    times=(Scale(Prop.EXPOSURE_TIME, fuji_time),),
    gains=(EXPOSURE_INDEX,),
    f_numbers=(F_NUMBER,),
    program=MANUAL,
    battery=Prop.BATTERY_LEVEL,
    tried=frozenset({Prop.EXPOSURE_TIME, Prop.FUJI_PRIORITY}),
    presets=(Preset(Prop.FUJI_PRIORITY, 2),),  # the computer has priority over the dials
    releases=(
        (
            # Half press, and wait for the focus; then full press.
            Step(Op.SET_PROPERTY, _FUJI_SHUTTER, _u16(0x0200), undo=_FUJI_LET_GO),
            Step(Op.INITIATE_CAPTURE, (0, 0), busy_at=(Prop.FUJI_FOCUS_STATE, 1), fails_at=3),
            Step(Op.SET_PROPERTY, _FUJI_SHUTTER, _u16(0x0304)),
            Step(Op.INITIATE_CAPTURE, (0, 0)),
        ),
    ),
    closing=(Step(Op.SET_PROPERTY, (Prop.FUJI_PRIORITY,), _u16(1), is_optional=True),),
)

OLYMPUS = Dialect(
    name="olympus",
    needs=frozenset({Op.OLYMPUS_CAPTURE, Op.SET_PROPERTY}),
    source=Source.EACH_PROPERTY,
    times=(Scale(Prop.OLYMPUS_SHUTTER, ratio),),
    gains=(Scale(Prop.OLYMPUS_ISO, iso, PERCENT),),
    f_numbers=(Scale(Prop.OLYMPUS_APERTURE, tenths),),
    program=(Prop.OLYMPUS_PROGRAM, frozenset()),
    battery=Prop.BATTERY_LEVEL,
    modes={},
    opening=(Step(Op.SET_PROPERTY, (Prop.OLYMPUS_CONTROL_MODE,), _u16(1), is_optional=True),),
    releases=((Step(Op.OLYMPUS_CAPTURE, (3,)), Step(Op.OLYMPUS_CAPTURE, (6,))),),
)

PANASONIC = Dialect(
    name="panasonic",
    needs=frozenset({Op.PANASONIC_GET, Op.PANASONIC_SET, Op.PANASONIC_CAPTURE}),
    source=Source.PANASONIC,
    times=(Scale(Prop.PANASONIC_SHUTTER, panasonic_time),),
    gains=(Scale(Prop.PANASONIC_ISO, iso, PERCENT),),
    f_numbers=(Scale(Prop.PANASONIC_APERTURE, tenths),),
    program=(0, frozenset()),
    battery=Prop.BATTERY_LEVEL,
    unlisted=frozenset({Op.PANASONIC_DESCRIPTION}),
    opening=(Step(Op.PANASONIC_OPEN, (0x0001_0001,)),),
    closing=(Step(Op.PANASONIC_CLOSE, is_optional=True),),
    releases=((Step(Op.PANASONIC_CAPTURE, (0x0300_0011,)),),),
    acknowledged=((Event.PANASONIC_PROGRESS, Op.PANASONIC_ACKNOWLEDGE),),
    listed_times=(*(n * 100 | 1 << 31 for n in _TENTHS), *(n * 1000 for n in _PARTS)),
    is_stepped=False,
)

# By a word of the maker's name, tried before the vendor extension, which is Microsoft's (MTP) on
# many of their cameras.
_MAKERS: Mapping[str, Dialect] = {
    "nikon": NIKON,
    "canon": CANON_EOS,
    "sony": SONY,
    "fuji": FUJI,
    "olympus": OLYMPUS,
    "omsystem": OLYMPUS,
    "om digital": OLYMPUS,
    "panasonic": PANASONIC,
}
# By the vendor extension in DeviceInfo.
_EXTENSIONS: Mapping[int, Dialect] = {
    0x0A: NIKON,
    0x0B: CANON_EOS,
    0x0E: FUJI,
    0x11: SONY,
    0x1C: PANASONIC,
}

_NIKON_1_LIVE_VIEW = Step(Op.NIKON_LIVE_VIEW, is_optional=True)
_CONTROLLED = Step(Op.NIKON_CAMERA_MODE, (1,), is_optional=True)
_NIKON_REMOTE = frozenset({Op.NIKON_EVENTS, Op.NIKON_READY, Op.NIKON_CAPTURE_TO})
# One press for half and full.
_CANON_WITHOUT_MIRROR: dict[str, Any] = {
    "releases": (
        (
            Step(Op.EOS_RELEASE_ON, (3, 0), undo=(Step(Op.EOS_RELEASE_OFF, (3,)),)),
            Step(Op.EOS_RELEASE_OFF, (3,)),
        ),
        (Step(Op.EOS_RELEASE),),
    )
}
_CANON_COMPACT: dict[str, Any] = {
    **_CANON_WITHOUT_MIRROR,
    "opening": (Step(Op.EOS_REMOTE_MODE, (0x15,)), _EVENT_MODE),
}
# The live picture to the computer: without it EOS M bodies take no pictures.
_CANON_M: dict[str, Any] = {
    **_CANON_WITHOUT_MIRROR,
    "opening": (
        *_CANON_COMPACT["opening"],
        Step(Op.EOS_EVENT_MODE, (2,)),
        Step(Op.EOS_SET_PROPERTY, data=pack_eos_property(Prop.EOS_OUTPUT, 8), is_optional=True),
    ),
    "startup_s": 1.0,
}

# Models that differ from their maker's others: (dialect, pattern of the whole model, differences).
_MODELS: tuple[tuple[Dialect, str, Mapping[str, Any]], ...] = (
    # 90CA ends the session of these, and their events by 90C7 do not work.
    (
        NIKON,
        "V1|J1|J2|S1",
        {
            "unreliable": frozenset({Op.NIKON_PROPERTY_CODES, Op.NIKON_EVENTS}),
            "opening": (_NIKON_1_LIVE_VIEW,),
        },
    ),
    (
        NIKON,
        "J[345]|S2|V[23]|AW1",
        {
            "unlisted": frozenset({Op.NIKON_CAPTURE_TO, Op.NIKON_CAMERA_MODE}),
            "opening": (_CONTROLLED, _NIKON_1_LIVE_VIEW),
        },
    ),
    # These do not list what they have of Nikon's operations.
    (NIKON, r"D3[01]\d\d", {"unlisted": frozenset({Op.NIKON_READY})}),
    (NIKON, r"D32\d\d", {"unlisted": _NIKON_REMOTE}),
    (
        NIKON,
        r"D3[345]\d\d|COOLPIX A",
        {"unlisted": _NIKON_REMOTE | {Op.NIKON_PROPERTY_CODES, Op.NIKON_TERMINATE_CAPTURE}},
    ),
    (CANON_EOS, r"Canon EOS M6 Mark II", _CANON_WITHOUT_MIRROR),
    (
        CANON_EOS,
        r"Canon PowerShot (SX540 HS|G5 X)",
        {**_CANON_WITHOUT_MIRROR, "opening": (Step(Op.EOS_REMOTE_MODE, (0x11,)), _EVENT_MODE)},
    ),
    (
        CANON_EOS,
        r"Canon PowerShot SX600 HS",
        {**_CANON_WITHOUT_MIRROR, "opening": (_EVENT_MODE,)},
    ),
    (CANON_EOS, r"Canon EOS M50m2", _CANON_COMPACT),
    (CANON_EOS, r"Canon (EOS M|PowerShot).*", _CANON_M),
    # They take no picture in the first seconds.
    (
        SONY,
        r"ZV-E10|ZV-1|DSC-RX100M7|DSC-RX0M2|ILCE-(7RM4A?|7M[345]|7SM3|9M2|1|7C)",
        {"startup_s": 3.0},
    ),
)


def dialect_of(extension: int, make: str, operations: frozenset[int], model: str = "") -> Dialect:
    """Return the dialect for a camera with this vendor extension, maker, operations and model."""
    by_name = next((d for name, d in _MAKERS.items() if name in make.lower()), None)
    dialect = by_name or _EXTENSIONS.get(extension, STANDARD)
    for maker, pattern, differences in _MODELS:
        if maker is dialect and re.fullmatch(pattern, model.strip()):
            dialect = replace(dialect, **differences)
            break
    return dialect if dialect.needs <= operations | dialect.unlisted else STANDARD
