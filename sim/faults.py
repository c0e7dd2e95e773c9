"""Faults of the simulated hardware, for tests: as Python, as JSON, or as the text of an option."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

from camctl.errors import UsageError, unknown_name


@dataclass(frozen=True)
class Faults:
    """Faults of the simulated hardware.

    Frames are counted from 0 over all that `shoot` and `step` return.

    Attributes:
        unplug_after: the cable is pulled after this number of frames
        freeze_after: the stream stops after this number of frames
        busy_calls: number of first calls of `shoot`, `step` or `preview` that find the camera busy
        wrong_exposure: frame number to the factor by which its exposure differs from `applied`
        late_frames: frames by which a new exposure takes effect later than the control delay that
            the camera states, as after a change of firmware
        stated_late: the exposure that the camera states of a frame is that of so many frames before
        shutter_offset_s: every exposure is longer than stated by this time, s
        dropped_frames: before these frames the stream loses one, and its number is missing
        repeated_frames: these frames have the pixels of the frame before
        corrupt_frames: the lower half of these frames is random
        truncated_frames: these frames end within a line, and are 0 from there on
        shifted_frames: these frames lack a part of a line, and what follows is shifted
        doubled_frames: these frames have some lines twice, and lack the last ones
        green_frames: packets of these frames are lost: green blocks, black ones in a grey frame
        broken_jpegs: these frames were sent as JPEG files with a wrong byte
        delayed_frames: frame number to the seconds that it arrives late
        clock_jumps: frame number to the seconds by which the camera's clock is changed before it
        longest_exposure_s: longer exposures last only so long, which the camera does not report
    """

    unplug_after: int | None = None
    freeze_after: int | None = None
    busy_calls: int = 0
    wrong_exposure: Mapping[int, float] = field(default_factory=dict)
    late_frames: int = 0
    stated_late: int = 0
    shutter_offset_s: float = 0.0
    dropped_frames: Sequence[int] = ()
    repeated_frames: Sequence[int] = ()
    corrupt_frames: Sequence[int] = ()
    truncated_frames: Sequence[int] = ()
    shifted_frames: Sequence[int] = ()
    doubled_frames: Sequence[int] = ()
    green_frames: Sequence[int] = ()
    broken_jpegs: Sequence[int] = ()
    delayed_frames: Mapping[int, float] = field(default_factory=dict)
    clock_jumps: Mapping[int, float] = field(default_factory=dict)
    longest_exposure_s: float | None = None

    def __post_init__(self) -> None:
        if not all(factor > 0 for factor in self.wrong_exposure.values()):
            raise ValueError(
                "invalid factor of a wrong exposure: expected a number above 0, such as 1e-6 of a "
                "shutter that does not open"
            )
        if self.shutter_offset_s < 0:
            raise ValueError("invalid time by which exposures are longer: expected seconds >= 0")
        if self.longest_exposure_s is not None and not self.longest_exposure_s > 0:
            raise ValueError("invalid longest exposure: expected seconds > 0")

    def clock_offset_s(self, number: int) -> float:
        """Return by how much the camera's clock is wrong at a frame, s."""
        return sum(jump for first, jump in self.clock_jumps.items() if first <= number)

    def light(self, number: int, time_s: float) -> float:
        """Return the exposure of a frame over the one that the camera states, `time_s`."""
        light = self.wrong_exposure.get(number, 1.0) * (1 + self.shutter_offset_s / time_s)
        if self.longest_exposure_s is not None:
            light *= min(1.0, self.longest_exposure_s / time_s)
        return light

    def damages(self, number: int) -> list[str]:
        """Return the kinds of damage, of `camctl.sim.damage.DAMAGES`, that a frame has."""
        return [kind for kind, key in _DAMAGED.items() if number in getattr(self, key)]

    def unused(self, frames: int) -> list[str]:
        """Return the faults of frames that a camera did not come to, as the text has them.

        Args:
            frames: that it has returned
        """
        after = {name: getattr(self, key) for name, key in _AFTER.items()}
        found = [f"{name}@{first}" for name, first in after.items() if first is not None]
        for name, key in (_LISTED | _BY_FRAME).items():
            found += [f"{name}@{number}" for number in getattr(self, key)]
        return [fault for fault in found if int(fault.partition("@")[2]) >= frames]


_AFTER = {"unplug": "unplug_after", "freeze": "freeze_after"}
_DAMAGED = {
    "corrupt": "corrupt_frames",
    "truncate": "truncated_frames",
    "shift": "shifted_frames",
    "double": "doubled_frames",
    "green": "green_frames",
    "jpeg": "broken_jpegs",
}
_LISTED = {"drop": "dropped_frames", "repeat": "repeated_frames", **_DAMAGED}
_BY_FRAME = {"wrong": "wrong_exposure", "late": "delayed_frames", "jump": "clock_jumps"}
_EVERYWHERE: dict[str, tuple[str, type[int] | type[float]]] = {
    "busy": ("busy_calls", int),
    "delay": ("late_frames", int),
    "stated": ("stated_late", int),
    "longer": ("shutter_offset_s", float),
    "clamp": ("longest_exposure_s", float),
}
FAULT_FORMS = (
    *(f"{name}@FRAME" for name in (*_AFTER, *_LISTED)),
    *(f"{name}@FRAME=NUMBER" for name in _BY_FRAME),
    *(f"{name}=NUMBER" for name in _EVERYWHERE),
)
"""How each fault is written."""


def fault_fields(value: object) -> object:
    """Return what pydantic can read as `Faults`: a text such as "unplug@3,wrong@1=0.5" as a dict.

    Raises:
        UsageError: an unknown fault, which pydantic would ignore; a text that is not of this form
    """
    if isinstance(value, str):
        return _parsed(value)
    if isinstance(value, Mapping):
        known = [each.name for each in fields(Faults)]
        for name in value:
            if name not in known:
                raise unknown_name("fault", str(name), known)
    return value


def _parsed(text: str) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for part in text.split(","):
        head, has_value, number = part.strip().partition("=")
        name, has_frame, frame = head.partition("@")
        form = (bool(has_frame), bool(has_value))
        try:
            if name in _AFTER and form == (True, False):
                found[_AFTER[name]] = _frame(frame)
            elif name in _LISTED and form == (True, False):
                found.setdefault(_LISTED[name], []).append(_frame(frame))
            elif name in _BY_FRAME and form == (True, True):
                found.setdefault(_BY_FRAME[name], {})[_frame(frame)] = _finite(number)
            elif name in _EVERYWHERE and form == (False, True):
                key, kind = _EVERYWHERE[name]
                found[key] = _frame(number) if kind is int else _finite(number)
            else:
                raise ValueError
        except ValueError:
            raise UsageError(
                f"invalid fault '{part.strip()}'", hint="known are " + ", ".join(FAULT_FORMS)
            ) from None
    return found


def _frame(text: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 10):
        raise ValueError
    return int(text)


def _finite(text: str) -> float:
    value = float(text)
    if not abs(value) <= 1e9:
        raise ValueError
    return value
