"""How much a frame can change when a set of effects is left out together: a certain bound.

The noise is bounded (``|z| <= largest_noise()``), so that this is no matter of probability.  In the
order of the light's way, with S the set left out:

1. *Light.*  Each effect of lens and motion is an average of light with weights >= 0 and sum 1, so
   that an error before it does not grow; the shifts of those in S add up to ``alpha``.
2. *Factors.*  Those that stay multiply ``alpha`` by at most their largest product; those in S
   change the light by at most the share R, the largest of their product - 1.
3. *Mean.*  ``d = (electrons for one photon a second) alpha + (shifts of dark signal, lag, ...)``.
4. *Photon noise* of mean m is ``m + s z + a (z^2 - 1)`` with ``a = m / (6 m + 0.2)`` and
   ``s^2 = m - 2 a^2``.  s^2 grows with a slope between 0.5 and 1, and a is concave, so that for an
   absolute shift d above the smallest mean v

       ``|s2 - s1| <= min(sqrt d, d / (2 s(v)))``,  ``|a2 - a1| <= a(v + d) - a(v)``

   and for a relative one, since m / s(m) grows with m up to the largest mean m,

       ``|s2 - s1| <= R m / (s(m) + s((1 - R) m))``,  ``|a2 - a1| <= min(1/6, -ln(1 - R) / 24)``.
5. *Well.*  Cutting does not let an error grow; blooming does, by 1 + its share: a sample gets its
   own error and its neighbours' as far as these reach the well.
6. *Reading* adds its bounded noises, *gain* and the slope of the *ADC* multiply, the bow adds.
7. *Rounding* in float32 is counted for each operation in which the two frames can differ.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sim.effects import EFFECTS
from sim.effects.charge import dark_e, hottest_e
from sim.effects.optics import roundings
from sim.effects.record import LARGEST, Change, Shot

_ULP = 2.0**-23  # twice the unit of rounding: two frames
_MOST_BELOW_ZERO = LARGEST**2 / 4 + 1 / 6  # of m - z s - a, where s <= sqrt m and a <= 1/6
_OPERATIONS, _ADC_OPERATIONS = 24, 6  # on a tile of electrons, and from there to brightness


def _skew(mean: float) -> float:
    return mean / (6 * mean + 0.2)


def _deviation(mean: float) -> float:
    return math.sqrt(mean - 2 * _skew(mean) ** 2)


def _noise(mean: float) -> float:
    """Return the largest photon noise of a mean."""
    return LARGEST * _deviation(mean) + (LARGEST**2 - 1) * _skew(mean)


def absolute_shift(shift: float, least: float) -> float:
    """Return most that photon noise of means from `least` up changes when they shift by `shift`."""
    if shift <= 0:
        return 0.0
    spread = math.sqrt(shift)
    if least > 0:
        spread = min(spread, shift / (2 * _deviation(least)))
    return LARGEST * spread + (LARGEST**2 - 1) * (_skew(least + shift) - _skew(least))


def relative_shift(share: float, most: float) -> float:
    """Return most that photon noise of means up to `most` changes when they do by `share`."""
    if share <= 0 or most <= 0:
        return 0.0
    low = _deviation((1 - share) * most) if share < 1 else 0.0
    spread = share * most / (_deviation(most) + low)
    skew = min(1 / 6, -math.log1p(-share) / 24) if share < 1 else 1 / 6
    return LARGEST * spread + (LARGEST**2 - 1) * skew


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds for one exposure."""

    shot: Shot

    @cached_property
    def changes(self) -> dict[str, Change]:
        """What each effect of the table changes that sensor and scene have at all."""
        return {e.name: e.change(self.shot) for e in EFFECTS if e.present(self.shot)}

    @cached_property
    def single(self) -> dict[str, float]:
        """The bound in DN of leaving out each effect alone; infinite if it never is."""
        return {name: self.joint((name,)) for name in self.changes}

    @cached_property
    def _factors(self) -> dict[str, Change]:
        """The changes with a factor of their own."""
        return {name: change for name, change in self.changes.items() if not change.within}

    @cached_property
    def _largest_mean(self) -> float:
        """Largest mean before photon noise, whatever is left out, electrons."""
        light = self._unit * self.shot.statistics.most
        for change in self._factors.values():
            light *= 1 + change.more
        extra = dark_e(self.shot) + hottest_e(self.shot)
        if "smear" in self.changes:
            extra += self.changes["smear"].mean_e
        return light + extra

    @cached_property
    def _unit(self) -> float:
        """Electrons for one photon a second, lag included."""
        shot = self.shot
        return shot.electrons_per_photon_s * (1 + shot.sensor.pixels.lag * shot.lag_ratio)

    @cached_property
    def _smallest_light(self) -> float:
        light = self.shot.electrons_per_photon_s * self.shot.statistics.least
        for change in self._factors.values():
            light *= 1 - change.less
        return light * (1 - 1e-5)  # rounded

    @cached_property
    def peak_e(self) -> float:
        """Largest charge before the well, electrons."""
        peak = self._largest_mean
        if "photon noise" in self.changes:
            peak += _noise(peak)
        if "cosmic rays" in self.changes and self.shot.cosmic[0].size:
            peak += float(self.shot.cosmic[1].max())
        return peak * (1 + 1e-5)

    @cached_property
    def _per_electron(self) -> float:
        """Largest slope of brightness, DN an electron, but for the ADC's bow."""
        sensor = self.shot.sensor
        if sensor.response is None:
            return self.shot.gain / sensor.electrons_per_dn
        gap = float(np.diff(sensor.response.levels).min())
        return self.shot.gain / sensor.full_scale_e / gap if gap > 0 else math.inf

    @cached_property
    def _rounding_e(self) -> float:
        sensor = self.shot.sensor
        largest = min(self.peak_e, 2 * sensor.full_well_e)
        return (_OPERATIONS + roundings(self.shot)) * _ULP * largest

    def joint(self, left_out: Collection[str]) -> float:
        """Return the bound in DN, before the ADC, of leaving out these effects together."""
        shot, sensor = self.shot, self.shot.sensor
        changes = self.changes
        gone = [changes[name] for name in left_out if name in changes]
        if any(change.never for change in gone):
            return math.inf
        below_well = self.peak_e <= sensor.full_well_e
        if not below_well and any(change.only_below_well for change in gone):
            return math.inf
        if all(change.is_nothing or change.only_below_well for change in gone):
            return 0.0
        stay_more, more, less = 1.0, 1.0, 1.0
        for name, change in changes.items():
            if name not in left_out:
                stay_more *= 1 + change.more if name in self._factors else 1
            elif not change.within or change.within not in left_out:
                more *= 1 + change.more
                less *= 1 - change.less
        share = max(more - 1, 1 - less)
        shift = self._unit * stay_more * sum(change.light for change in gone)
        shift += sum(change.mean_e for change in gone)
        most = self._unit * stay_more * shot.statistics.most
        charge = shift + share * most
        if any(change.is_noise for change in gone):
            charge += _noise(self._largest_mean)
        elif "photon noise" in changes:
            least = self._smallest_light
            if "dark current" in changes and "dark current" not in left_out:
                least += dark_e(shot)
            charge += absolute_shift(shift, least) + relative_shift(share, most)
        charge += self._rounding_e
        if "blooming" in changes and not below_well:
            charge *= 1 + sensor.pixels.blooming
        # Whatever came before, the well holds no more, and noise takes no more from nothing.
        charge = min(charge, sensor.full_well_e + _MOST_BELOW_ZERO)
        charge += sum(change.read_e for change in gone)
        brightness = charge * self._per_electron
        top = 2**sensor.bits
        if "ADC non-linearity" in changes and "ADC non-linearity" not in left_out:
            brightness *= 1 + 4 * sensor.read_out.nonlinearity_dn / (top - sensor.black)
        bow = sum(change.dn for change in gone)
        return float(brightness + bow + _ADC_OPERATIONS * _ULP * top)
