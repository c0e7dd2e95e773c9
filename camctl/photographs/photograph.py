"""What one photograph states of its exposure: labels of dials, and corrections from pixels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime

import numpy as np

from camctl.errors import DataError
from camctl.evidence.patches import LightScale, Patches
from camctl.evidence.ratios import comparable_frames, estimate_ratios
from camctl.interface.controls import ExposureSetting

#: Stated times that are labels of a dial agree with one of these to this relative difference.
_SAME_LABEL = 0.015
#: Labels of dials in thirds and halves of a stop, s and 1/s.
_LABELS = (
    *(1, 1.3, 1.5, 1.6, 2, 2.5, 3, 3.2, 4, 5, 6, 8, 10, 13, 15, 20, 25, 30, 40, 45, 50, 60, 80, 90),
    *(100, 125, 160, 180, 200, 250, 320, 350, 400, 500, 640, 750, 800, 1000, 1250, 1500, 1600),
    *(2000, 2500, 3000, 3200, 4000, 5000, 6000, 6400, 8000, 10000, 12800, 16000, 32000),
)
_TENTHS = (0.3, 0.4, 0.5, 0.6, 0.7, 0.8)
_LONGEST_LABEL_S = 60.0
#: Exposures are corrected by up to this factor, and a correction above the second number is named.
MOST_CORRECTED, _NOTABLE = 1.3, 0.03


@dataclass(frozen=True)
class Photograph:
    """One photograph, as its file or its user states it.

    Attributes:
        name: of its file
        time_s: shutter time, s
        gain: linear gain, 1 for ISO 100
        f_number: f-number; None where it is not stated
        taken_at: when it was taken; None where that is not stated
        iso: ISO speed as stated; None where it is not
        flash_fired: whether the flash did; None where it is not stated
    """

    name: str
    time_s: float
    gain: float = 1.0
    f_number: float | None = None
    taken_at: datetime | None = None
    iso: float | None = None
    flash_fired: bool | None = None

    @property
    def setting(self) -> ExposureSetting:
        """Time, gain and f-number."""
        return ExposureSetting(self.time_s, self.gain, self.f_number)

    @property
    def exposure(self) -> float:
        """Exposure, which is time x gain / f-number^2, in arbitrary but constant units."""
        return self.setting.exposure


def is_dial_label(time_s: float) -> bool:
    """Return whether a stated time is a label of a dial, such as 1/60, 1/15 or 30.

    >>> is_dial_label(1 / 60), is_dial_label(1 / 47)
    (True, False)
    """
    if not 0 < time_s <= _LONGEST_LABEL_S:
        return False
    labels = (*_LABELS, *_TENTHS) if time_s >= 0.3 else _LABELS
    value = time_s if time_s >= 0.3 else 1 / time_s
    return any(math.isclose(value, label, rel_tol=_SAME_LABEL) for label in labels)


def true_time_s(label_s: float) -> float:
    """Return the true time of a dial's label: a power of two in thirds or halves of a stop.

    Debevec and Malik (1997), section 2.1, measured it so.

    >>> 1 / true_time_s(1 / 60), true_time_s(30), round(true_time_s(1 / 90) * 90.5, 3)
    (64.0, 32.0, 1.0)
    """
    stops = math.log2(label_s)
    thirds, halves = round(3 * stops) / 3, round(2 * stops) / 2
    return math.exp2(halves if abs(stops - halves) < abs(stops - thirds) / 3 else thirds)


def true_f_number(label: float) -> float:
    """Return the true f-number of a label: a power of two in sixths.

    >>> round(true_f_number(5.6), 3), round(true_f_number(11), 3), true_f_number(8)
    (5.657, 11.314, 8.0)
    """
    return math.exp2(round(6 * math.log2(label)) / 6)


def with_true_exposures(photographs: Sequence[Photograph]) -> list[Photograph] | None:
    """Return photographs with the true times and f-numbers of their labels.

    None: not all times are labels, so that they are taken as they are.
    """
    if not all(is_dial_label(each.time_s) for each in photographs):
        return None
    return [
        replace(
            each,
            time_s=true_time_s(each.time_s),
            f_number=None if each.f_number is None else true_f_number(each.f_number),
        )
        for each in photographs
    ]


def corrected_exposures(
    photographs: Sequence[Photograph], patches: Sequence[Patches], scale: LightScale
) -> tuple[list[Photograph], list[str]]:
    """Return photographs with exposures estimated from their pixels, and what was changed.

    Shutters are not exact, and film is less sensitive in long exposures.  An exposure is changed
    where the stated one lies outside the 95 % interval of the estimate, by `MOST_CORRECTED` at
    most: what differs by more has a wrong label.
    """
    result, facts = list(photographs), list[str]()
    shown = sorted(comparable_frames(patches, scale))
    stated = [photographs[k].exposure for k in shown]
    try:
        found = estimate_ratios([patches[k] for k in shown], stated, scale)
    except DataError:
        return result, facts
    # The unit is that of one with as many above as below: two that contradict are not averaged.
    factors = np.array(found.exposures) / stated
    unit = float(np.sort(factors)[(factors.size - 1) // 2])
    for k, position in enumerate(shown):
        photograph, factor = photographs[position], float(factors[k]) / unit
        is_stated = found.low[k] <= stated[k] * unit <= found.high[k]
        if is_stated or abs(math.log(factor)) > math.log(MOST_CORRECTED):
            continue
        result[position] = replace(photograph, time_s=photograph.time_s * factor)
        if abs(factor - 1) > _NOTABLE:
            facts.append(f"{photograph.name} {factor:.2f}")
    if not facts:
        return result, facts
    return result, [f"exposures in the pixels, over those stated: {', '.join(facts)}"]
