"""What the steps of a camera's gain do, which V4L2 does not tell and a person may know."""

from __future__ import annotations

import re
from dataclasses import dataclass

from camctl.errors import UsageError
from drivers.v4l2_offers import ControlRange

_MOST_STEPS = 4096
_MOST_GAIN = 1e4


@dataclass(frozen=True)
class GainUnit:
    """What one step of a gain register adds.

    Attributes:
        is_decibel: `step` is in dB (20 log10 of the linear gain); else it is linear
        step: what each step above the lowest adds
    """

    is_decibel: bool
    step: float

    def gain(self, steps: int) -> float:
        """Return the linear gain `steps` above the lowest, which is 1."""
        added = self.step * steps
        return 10 ** min(added / 20, 300) if self.is_decibel else 1 + added


def parse_gain(text: str) -> GainUnit:
    """Return the unit that "linear:STEP" or "db:STEP" names; raises `UsageError`."""
    match = re.fullmatch(r"(linear|db):(\d*\.?\d+(?:e-?\d+)?)", text.strip().lower(), re.ASCII)
    if match is None or not 0 < float(match[2]) <= _MOST_GAIN:
        raise UsageError(
            f"a gain of '{text}'",
            hint="say what one step of the camera's gain adds: linear:0.0625 or db:0.1",
        )
    return GainUnit(match[1] == "db", float(match[2]))


def registers(control: ControlRange, unit: GainUnit) -> dict[float, int]:
    """Return the linear gains of a camera, ascending, and the register value of each.

    The lowest value is called gain 1.  Values that give absurd gains are left out.
    """
    steps = min((control.maximum - control.minimum) // control.step, _MOST_STEPS)
    gains = [(unit.gain(number), number) for number in range(steps + 1)]
    return {
        gain: control.minimum + number * control.step for gain, number in gains if gain < _MOST_GAIN
    }
