"""Upper bound on how much a frame changes if a set of effects is left out together.

The noise is bounded (``|z| <= largest_noise()``), so that the bound is certain and not only likely.
With S the set of effects left out, in the order in which light goes through them:

1. *Light.*  Each effect of lens and motion is an average of light with weights >= 0 and sum 1, so
   that a difference before it does not grow; the changes of the effects in S add up to ``alpha``.
2. *Factors.*  Effects that run multiply ``alpha`` by at most their largest product; effects in S
   change the light by at most the share R, the largest distance of their product from 1.
3. *Mean.*  ``d = (electrons for one photon a second) alpha + (changes by dark signal, lag, ...)``.
4. *Photon noise* of mean m is ``m + s z + a (z^2 - 1)`` with ``a = m / (6 m + 0.2)`` and
   ``s^2 = m - 2 a^2``.  s^2 grows with a slope between 0.5 and 1, and a is concave, so that for an
   absolute change d above the smallest mean v

       ``|s2 - s1| <= min(sqrt d, d / (2 s(v)))``,  ``|a2 - a1| <= a(v + d) - a(v)``

   and for a relative one, since m / s(m) grows with m up to the largest mean m,

       ``|s2 - s1| <= R m / (s(m) + s((1 - R) m))``,  ``|a2 - a1| <= min(1/6, -ln(1 - R) / 24)``.
   z is at most 4.325.  Where whole electrons are counted it is at most 6.34, and counts differ
   from the formula by `COUNT_ERROR_E` more.  A change of nothing but rounding flips one count.
5. *Well.*  Clipping does not enlarge a difference.  Blooming does, at most by the number of rows:
   it moves charge along a column, and can move all differences of the column to one sample.
6. *Reading* adds its bounded noises, *gain* and the slope of the *ADC* multiply, the bow adds.
   Where light fills the reset level, too, its change is added, at most a full well.
7. *Rounding* in float32 is counted for each operation in which the two frames can differ.  Before
   photon noise it is a share of the sample's mean, since light is multiplied by factors and
   averaged with weights >= 0, and dark current is added; where DCNU takes dark current away again
   it is that share of the whole dark current.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from camctl.sim.effects import EFFECTS
from camctl.sim.effects.lens import rounding_count
from camctl.sim.effects.record import LARGEST_NOISE, Change, Shot, Stage
from camctl.sim.photon_counts import COUNT_ERROR_E, LARGEST_COUNT_NOISE

_ULP = 2.0**-23  # twice the unit of rounding in float32, for the two frames
_TILE_OPERATIONS, _ADC_OPERATIONS = 24, 6  # roundings of charge, and from charge to brightness
_TRANSFORM_ROUNDING = 1e-12  # relative to the brightest light: Fourier transforms of diffraction
_ROUNDING_MARGIN = 1e-5  # relative: more than all float32 roundings of a sample's light together
_FLIPPED_E = 1.0  # by a change of the mean that is less than the distance of two counts
_LARGEST_SHARE = 1e30  # instead of an infinite one, whose product with no light is not a number

_BEFORE_NOISE = frozenset(effect.name for effect in EFFECTS if effect.stage < Stage.CHARGE)
"""Effects that change the mean of photon noise."""

_MOST_BELOW_ZERO_E = LARGEST_NOISE**2 / 4 + 1 / 6
"""How far below 0 photon noise can take the charge: the least ``m + z s - a`` for ``s <= sqrt m``
and ``a <= 1/6``."""


def _skew(mean: float) -> float:
    return mean / (6 * mean + 0.2)


def _deviation(mean: float) -> float:
    return math.sqrt(mean - 2 * _skew(mean) ** 2)


def _largest_photon_noise(mean: float, limit: float = LARGEST_NOISE) -> float:
    return limit * _deviation(mean) + (limit**2 - 1) * _skew(mean)


def absolute_shift(shift: float, least: float, limit: float = LARGEST_NOISE) -> float:
    """Return by how much photon noise changes at most if its mean rises by `shift` electrons.

    `least` is the smallest mean before the rise, electrons; `limit` is the largest abs(z).
    """
    if shift <= 0:
        return 0.0
    spread = math.sqrt(shift)
    if least > 0:
        spread = min(spread, shift / (2 * _deviation(least)))
    return limit * spread + (limit**2 - 1) * (_skew(least + shift) - _skew(least))


def relative_shift(share: float, most: float, limit: float = LARGEST_NOISE) -> float:
    """Return by how much photon noise changes at most if its mean changes by the share `share`.

    `most` is the largest mean, electrons; `limit` is the largest abs(z).
    """
    if share <= 0 or most <= 0:
        return 0.0
    low = _deviation((1 - share) * most) if share < 1 else 0.0
    spread = share * most / (_deviation(most) + low)
    skew = min(1 / 6, -math.log1p(-share) / 24) if share < 1 else 1 / 6
    return limit * spread + (limit**2 - 1) * skew


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds for the exposure `shot`."""

    shot: Shot

    @cached_property
    def changes(self) -> dict[str, Change]:
        """The `Change` of each effect that sensor and scene have, by its name."""
        return {e.name: e.change(self.shot) for e in EFFECTS if e.present(self.shot)}

    @cached_property
    def changes_nothing(self) -> frozenset[str]:
        """The effects that change no bit of this frame."""
        return frozenset(
            name
            for name, change in self.changes.items()
            if not change.never
            and (change.nothing or (change.only_below_well and self._is_below_well))
        )

    @cached_property
    def single(self) -> dict[str, float]:
        """Bound of leaving out each effect alone, DN; infinite if it is never left out."""
        return {name: self.joint((name,)) for name in self.changes}

    @cached_property
    def own(self) -> dict[str, float]:
        """As `single`, without the streaks of charge that end elsewhere; see `joint`."""
        if not self.overflows:
            return self.single
        return {name: self.joint((name,), moves_streaks=False) for name in self.changes}

    @cached_property
    def _factors(self) -> dict[str, Change]:
        """The changes that have a factor of their own."""
        return {name: change for name, change in self.changes.items() if not change.within}

    @cached_property
    def _has_photon_noise(self) -> bool:
        return any(change.is_noise for change in self.changes.values())

    @property
    def _noise_limit(self) -> float:
        """Largest abs(z) of the photon noise."""
        return LARGEST_COUNT_NOISE if self.shot.counts_photons else LARGEST_NOISE

    @property
    def _count_error_e(self) -> float:
        """By how much whole photon noise differs from the formula, electrons."""
        return COUNT_ERROR_E if self.shot.counts_photons else 0.0

    @cached_property
    def _largest_mean_e(self) -> float:
        """Largest mean charge before photon noise, whatever is left out."""
        light = self._electrons_per_photon_s * self.shot.statistics.most
        for change in self._factors.values():
            light *= 1 + change.more
        # What an effect repeats is in the electrons for one photon a second.
        return light + sum(c.mean_e for c in self.changes.values() if not c.repeats)

    @cached_property
    def _electrons_per_photon_s(self) -> float:
        """Electrons for one photon a second, including electrons that effects repeat."""
        repeated = sum(change.repeats for change in self.changes.values())
        return self.shot.electrons_per_photon_s * (1 + repeated)

    @cached_property
    def _smallest_light_e(self) -> float:
        """Smallest mean charge of light alone."""
        light = self.shot.electrons_per_photon_s * self.shot.statistics.least
        for change in self._factors.values():
            light *= 1 - change.less
        return light * (1 - _ROUNDING_MARGIN)

    @cached_property
    def peak_e(self) -> float:
        """Largest charge before the well, electrons."""
        peak = self._largest_mean_e
        if self._has_photon_noise:
            peak += _largest_photon_noise(peak, self._noise_limit) + self._count_error_e
        peak += sum(change.hit_e for change in self.changes.values())
        return peak * (1 + _ROUNDING_MARGIN)

    @property
    def _is_below_well(self) -> bool:
        return self.peak_e <= self.shot.sensor.full_well_e

    @property
    def overflows(self) -> bool:
        """Whether charge can flow out of full wells into others."""
        flows = any(change.spreads for change in self.changes.values())
        return flows and self.peak_e > self.shot.sensor.full_well_e

    @cached_property
    def _overexposed_e(self) -> float:
        """Mean charge from which every sample fills its well, whatever its photon noise."""
        well = self.shot.sensor.full_well_e * (1 + _ROUNDING_MARGIN) + self._count_error_e
        if not self._has_photon_noise:
            return well
        # x - z sqrt x >= well + 1/6, solved for sqrt x.
        z = self._noise_limit
        return ((z + math.sqrt(z * z + 4 * (well + 1 / 6))) / 2) ** 2

    @cached_property
    def _dn_per_electron(self) -> float:
        """Largest slope of brightness over charge, without the ADC's bow."""
        sensor = self.shot.sensor
        if sensor.response is None:
            return self.shot.gain / sensor.electrons_per_dn
        gap = float(np.diff(sensor.response.levels).min())
        return self.shot.gain / sensor.full_scale_e / gap if gap > 0 else math.inf

    @cached_property
    def _rounding_share(self) -> float:
        """Rounding of a sample's charge, relative to the largest intermediate result."""
        return (_TILE_OPERATIONS + rounding_count(self.shot)) * _ULP

    @cached_property
    def _cancelled_e(self) -> float:
        """Charge that one effect adds to the mean and another one may take away."""
        if not any(change.least_e < 0 for change in self.changes.values()):
            return 0.0
        return sum(change.mean_e for change in self.changes.values())

    @cached_property
    def _rounding_e(self) -> float:
        largest = min(self.peak_e, 2 * self.shot.sensor.full_well_e) + self._cancelled_e
        return self._rounding_share * largest + _TRANSFORM_ROUNDING * self.peak_e

    def joint(self, left_out: Collection[str], *, moves_streaks: bool = True) -> float:
        """Return the bound of leaving out these effects together, in DN before the ADC.

        Without `moves_streaks` it is the bound where no charge overflows: blooming adds nothing.
        """
        sensor, changes = self.shot.sensor, self.changes
        # In the order of the effects: a set's order, and so a sum's last bit, varies by process.
        gone = [change for name, change in changes.items() if name in left_out]
        stay = [change for name, change in changes.items() if name not in left_out]
        if not moves_streaks:
            stay = [replace(change, spreads=0.0) for change in stay]
        if any(change.never for change in gone):
            return math.inf
        if not self._is_below_well and any(change.only_below_well for change in gone):
            return math.inf
        if self.changes_nothing.issuperset(name for name in left_out if name in changes):
            return 0.0
        charge = self._charge_e(left_out, gone, stay)
        if not self._is_below_well:
            charge *= 1 + sum(change.spreads for change in stay)
        # Whatever came before, the well holds no more, and noise takes no more from nothing.
        charge = min(charge, sensor.full_well_e + _MOST_BELOW_ZERO_E)
        charge += self._reset_e(left_out, gone, stay)
        charge += sum(change.read_e for change in gone) + self._rounding_e
        brightness = charge * self._dn_per_electron
        for change in stay:
            brightness *= 1 + change.slope
        bow = sum(change.dn for change in gone)
        return float(brightness + bow + _ADC_OPERATIONS * _ULP * 2**sensor.bits)

    def _factor_shares(self, left_out: Collection[str]) -> tuple[float, float]:
        """Return the largest product of the factors that stay, and R of item 2."""
        stay_more, more, less = 1.0, 1.0, 1.0
        for name, change in self.changes.items():
            if name not in left_out:
                stay_more *= 1 + change.more if name in self._factors else 1
            elif not change.within or change.within not in left_out:
                more *= 1 + change.more
                less *= 1 - change.less
        return stay_more, min(max(more - 1, 1 - less), _LARGEST_SHARE)

    def _reset_e(self, left_out: Collection[str], gone: list[Change], stay: list[Change]) -> float:
        """Return by how much the charge of reset levels changes: item 6 of the derivation."""
        taken = sum(change.resets for change in stay)
        if taken == 0:
            return 0.0
        well = self.shot.sensor.full_well_e
        stay_more, share = self._factor_shares(left_out)
        light = sum(change.light for change in gone) + share * self.shot.statistics.most
        shift = taken * self.shot.electrons_per_photon_s * stay_more * light
        return min(shift, well) + _TILE_OPERATIONS * _ULP * well

    def _charge_e(self, left_out: Collection[str], gone: list[Change], stay: list[Change]) -> float:
        """Return the bound in electrons before the well: items 1 to 4 of the derivation."""
        stay_more, share = self._factor_shares(left_out)
        per_photon_s = self._electrons_per_photon_s * stay_more
        shift = per_photon_s * sum(change.light for change in gone)
        shift += sum(change.mean_e for change in gone)
        most = per_photon_s * self.shot.statistics.most
        if share < 1 and not any(change.spreads for change in stay):
            # More light than this fills the well with and without the effects.
            most = min(most, (self._overexposed_e + shift) / (1 - share))
        charge = shift + share * most
        if any(change.is_noise for change in gone):
            noise = _largest_photon_noise(self._largest_mean_e, self._noise_limit)
            return charge + noise + self._count_error_e
        before = _BEFORE_NOISE.intersection(left_out, self.changes)
        if before <= self.changes_nothing:
            return charge
        if self._has_photon_noise:
            least = self._smallest_light_e + sum(change.least_e for change in stay)
            least += sum(min(change.least_e, 0.0) for change in gone)
            is_rounding = charge == 0
            shift += self._rounding_share * self._cancelled_e
            if self.shot.sensor.lens.diffraction:
                shift += _TRANSFORM_ROUNDING * self._largest_mean_e
            charge += absolute_shift(shift, max(least, 0.0), self._noise_limit)
            charge += relative_shift(share, most, self._noise_limit)
            charge += relative_shift(self._rounding_share, self._largest_mean_e, self._noise_limit)
            if self.shot.counts_photons:
                charge += _FLIPPED_E if is_rounding else COUNT_ERROR_E
        return charge + self._rounding_e
