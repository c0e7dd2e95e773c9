"""Facts of real bodies, from data files: codes, types, choices, and access to the card.

`docs/read_body_dumps.py` wrote the files from the summaries of real cameras that libgphoto2 has
recorded.  What a summary does not say is assumed here.
"""

from __future__ import annotations

import json
import re
from functools import cache
from importlib import resources
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, ConfigDict

from camctl.errors import unknown_name
from camctl.sim.devices.ptp.protocol import Operation, Property, Type

MAKERS = ("nikon", "canon", "sony", "fuji", "olympus", "panasonic", "pentax")
_READING = frozenset({0x1014, 0x1015})  # operations that read properties
_BASIC = _READING | frozenset(range(0x1001, 0x100C)) | {0x1016}  # and of session, card, objects
# Operations of the ways to take pictures that a summary names instead of listing its operations.
_CAPTURES: dict[str, tuple[int, ...]] = {
    "Generic Image Capture": (0x100E,),
    "Open Capture": (0x101C, 0x1018),
    "Nikon Capture": (0x90C0, 0x90C1, 0x90C2, 0x90C7, 0x90C8),
    "Nikon Capture 1": (0x90C0, 0x90C1, 0x90C2, 0x90C7, 0x90C8),
    "Nikon Capture 2": (0x90C7, 0x90C8),
    "Nikon Capture 3": (0x90C7, 0x90C8, 0x9207, 0x920C),
    "Canon EOS Capture": (0x910F, 0x9110, 0x9114, 0x9115, 0x9116, 0x9125, 0x9126, 0x9127),
    "Canon EOS Capture 2": (0x9128, 0x9129, 0x9110, 0x9114, 0x9115, 0x9116, 0x9127),
    "Sony Capture": (0x9201, 0x9202, 0x9205, 0x9207, 0x9209),
}
_OLYMPUS_REMOTE = 0xFFFD  # libgphoto2's number for Olympus bodies that it controls
DIALS = frozenset(
    {0x5007, 0x500D, 0x500F, 0xD100, 0xD101, 0xD102, 0xD103, 0xD20D, 0xD21E, 0xD002, 0xD007, 0xD01C}
)
# Properties that a summary leaves out, since they are read by operations of the maker.
_BEHIND_OPERATIONS = frozenset({0xD101, 0xD102, 0xD103, 0xD20D, 0xD21E})


def _codes(value: object) -> object:
    return tuple(int(word, 16) for word in value.split()) if isinstance(value, str) else value


def _by_code(value: object) -> object:
    return (
        {int(code, 16): fact for code, fact in value.items()} if isinstance(value, dict) else value
    )


_Codes = Annotated[tuple[int, ...], BeforeValidator(_codes)]


class PropertyFact(BaseModel):
    """A property as it was recorded."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    type: Type
    writable: bool
    value: int
    choices: tuple[int, ...] = ()
    range: tuple[int, int, int] | None = None


class BodyFacts(BaseModel):
    """What is known of one body.

    Attributes:
        source: name of the recorded summary
        make, model, version, extension: of its device information
        operations: that it lists; none: its summary does not say ..
        captures: .. but names the ways in which it takes pictures
        listed: properties that its information or the maker's operations list; none:
            its summary does not say
        hidden: properties that only a maker's operation lists
        access: access to its card, ISO 15740 section 5.5.3; None: not recorded
        properties: those that matter for an exposure, by code
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    source: str
    make: str
    model: str
    version: str
    extension: int
    operations: _Codes
    captures: tuple[str, ...]
    listed: _Codes
    hidden: _Codes
    access: int | None
    properties: Annotated[dict[int, PropertyFact], BeforeValidator(_by_code)]

    @property
    def all_operations(self) -> frozenset[int]:
        """Its operations, with those without which its properties could not have been read.

        Of a summary without a list, those that its ways of capture need.
        """
        captures = list(self.captures)
        if Property.SONY_SHUTTER in self.properties:  # it was recorded under remote control
            captures.append("Sony Capture")
        found = _BASIC.union(*(_CAPTURES.get(capture, ()) for capture in captures))
        if self.operations:
            read = _READING if self.properties else frozenset()
            remote = _CAPTURES["Sony Capture"] if "Sony Capture" in captures else ()
            return read.union(self.operations, remote)
        if self.hidden:
            found |= {Operation.NIKON_GET_VENDOR_CODES}
        if self.extension == _OLYMPUS_REMOTE or Property.OLYMPUS_SHUTTER in self.properties:
            found |= {Operation.OLYMPUS_CAPTURE}
        return found

    def may_have(self, code: int) -> bool:
        """Return whether the body may have a property whose description was not recorded."""
        if code in _BEHIND_OPERATIONS:
            return True
        return code in self.listed if self.listed else not DIALS.intersection(self.properties)


@cache
def bodies() -> dict[str, tuple[str, dict[str, Any]]]:
    """Return maker and recorded facts of all bodies by name."""
    folder = resources.files("camctl.sim.devices") / "bodies"
    return {
        name: (maker, facts)
        for maker in MAKERS
        for name, facts in json.loads((folder / f"{maker}.json").read_text("utf-8")).items()
    }


@cache
def load_body(name: str) -> BodyFacts:
    """Return the facts of a body.

    Raises:
        UsageError: there is none of this name
    """
    if name not in bodies():
        raise unknown_name("camera body", name, bodies())
    return BodyFacts.model_validate(bodies()[name][1])


# What bodies do beside, as libgphoto2 handles it: (maker, pattern of the model, options of the
# virtual camera), all that match.
_REMOTE_NIKON = (0x90C2, 0x90C7, 0x90C8, 0x9207)
_MANNERS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("nikon", ".*", {"overlap": False}),
    ("nikon", r"[JV]\d|S[12]|AW1", {"needs_focus": True}),
    ("nikon", r"V1|J[12]|S1", {"crashes_on": (0x90CA,)}),
    ("nikon", r"J5", {"unlisted": (0x9207,)}),
    ("nikon", r"D3[01]\d\d", {"unlisted": (0x90C8,)}),
    ("nikon", r"D32\d\d", {"unlisted": _REMOTE_NIKON}),
    ("nikon", r"D3[345]\d\d|COOLPIX A", {"unlisted": (*_REMOTE_NIKON, 0x90CA)}),
    ("canon", ".*", {"empty_polls": 2}),
    ("canon", r"Canon EOS M(?!6 Mark II).*|Canon PowerShot.*", {"remote_mode": 0x15}),
    ("canon", r"Canon EOS M([35]|10|6)|Canon PowerShot (SX720 HS|G9 X)", {"needs_output": True}),
    ("canon", r"Canon PowerShot (SX540 HS|G5 X)", {"remote_mode": 0x11}),
    ("canon", r"Canon PowerShot SX600 HS", {"remote_mode": 0}),
    ("sony", ".*", {"step_s": 0.2}),
    ("sony", r"SLT-.*|ILCA-.*", {"step_s": 0.7}),
    (
        "sony",
        r"ZV-.*|DSC-RX100M7|DSC-RX0M2|ILCE-(7RM4A?|7M[345]|7SM3|9M2|1|7C)",
        {"startup_s": 3.0},
    ),
)


def manners_of(name: str) -> dict[str, Any]:
    """Return the options of the virtual camera that is this body, its maker included."""
    maker, model = bodies().get(name, ("none", {}))[0], load_body(name).model
    options: dict[str, Any] = {"vendor": "none" if maker == "pentax" else maker}
    for of_maker, pattern, manners in _MANNERS:
        if of_maker == maker and re.fullmatch(pattern, model):
            options |= manners
    return options
