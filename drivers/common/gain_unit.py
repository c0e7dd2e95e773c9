"""The option `gain`: what the values of a camera's gain control mean."""

from __future__ import annotations

import re
from dataclasses import dataclass

#: Linear gains from here on are not offered: no sensor has them.
GAIN_LIMIT = 1e4
#: Decades of gain up to which 10 ** decades is computed: a float overflows above 308.
_MOST_DECADES = 300


@dataclass(frozen=True)
class GainUnit:
    """What one step of a gain control adds.

    Attributes:
        is_decibel: `step` is in dB (20 log10 of the linear gain); else it is linear
        step: what each step above the lowest adds
    """

    is_decibel: bool
    step: float

    def gain(self, steps: float) -> float:
        """Return the linear gain `steps` above the lowest, which is 1."""
        added = self.step * steps
        return 10 ** min(added / 20, _MOST_DECADES) if self.is_decibel else 1 + added


def parse_gain(value: object) -> object:
    """Return the `GainUnit` of "linear:STEP" or "db:STEP", and any other object as it is.

    Raises:
        ValueError: a text that is neither
    """
    if not isinstance(value, str):
        return value
    match = re.fullmatch(r"(linear|db):(\d*\.?\d+(?:e-?\d+)?)", value.strip().lower(), re.ASCII)
    if match is None or not 0 < float(match[2]) <= GAIN_LIMIT:
        raise ValueError(
            "give what one step of the camera's gain adds, such as linear:0.0625 or db:0.1"
        )
    return GainUnit(match[1] == "db", float(match[2]))
