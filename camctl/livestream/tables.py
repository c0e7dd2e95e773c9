"""What each value of a sum says: light, its standard deviation, a mask, the desired response.

In a cycle the sum of the last n frames always has the same exposures, so that one table serves all
results.  The exact table is the posterior of `camctl.model.inverse`; it takes up to seconds for
cameras of many levels.  Until it is there, and while two lists of exposures are mixed, one without
the prior takes its place, in milliseconds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import posterior_of
from camctl.model.light import deviation_of_sums, light_of_sums
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.desired import DesiredResponse
from camctl.model.sensor import SensorModel
from camctl.model.step_posterior import FrameSet
from camctl.pictures.render import DARK, FULL_CODE, GOOD, SATURATED

#: Sets of exposures whose tables are kept: two lists of 16 and all that is mixed of them.
_KEPT_TABLES = 34


@dataclass(frozen=True, eq=False)
class SumTable:
    """Arrays (top + 1,), by the value of the sum, black included.

    Attributes:
        E: light, 1 = what saturates an exposure of 1
        irradiance: float32, the same in the unit of the results
        sd: float32, its standard deviation: infinite where every frame is saturated, NaN where the
            noise is not known
        mask: uint8, see `camctl.pictures.render`
        code: uint16, the desired response, 0 to `FULL_CODE`
        below: bool, whether the light is below the desired range, or none is shown
        is_exact: whether it is the posterior
    """

    E: FloatArray
    irradiance: NDArray[np.float32]
    sd: NDArray[np.float32]
    mask: NDArray[np.uint8]
    code: NDArray[np.uint16]
    below: NDArray[np.bool_]
    is_exact: bool


@dataclass(frozen=True)
class ExposureSet:
    """The exposures of a window, and what is wanted of it.

    Attributes:
        settings: of the frames
        base: the exposure that light E = 1 just saturates
        desired: the desired response over E; what it depends on is compared
    """

    settings: tuple[ExposureSetting, ...]
    base: float
    desired: DesiredResponse = field(compare=False)
    response: tuple[str, float] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "response", (self.desired.key, self.desired.dynamic_range))


class KeptTables:
    """The tables of the last sets of exposures; its caller holds a lock, as `make_exact` says."""

    def __init__(self) -> None:
        self._found: dict[ExposureSet, tuple[SumTable, ...]] = {}

    def get(
        self, controls: ExposureControls, wanted: ExposureSet, *, is_exact: bool
    ) -> tuple[SumTable, ...]:
        """Return the tables of a set, which are made where there are none."""
        if wanted not in self._found:
            self._keep(wanted, sum_tables(controls, wanted, is_exact=is_exact))
        return self._found[wanted]

    def make_exact(
        self, controls: ExposureControls, wanted: ExposureSet, lock: AbstractContextManager[object]
    ) -> None:
        """Make the exact tables of a set, without the lock, which is taken to keep them."""
        with lock:
            found = self._found.get(wanted)
        if found is None or not found[0].is_exact:
            exact = sum_tables(controls, wanted, is_exact=True)
            with lock:
                self._keep(wanted, exact)

    def clear(self) -> None:
        """Forget all: noise or camera have changed."""
        self._found.clear()

    def _keep(self, wanted: ExposureSet, found: tuple[SumTable, ...]) -> None:
        if wanted not in self._found and len(self._found) >= _KEPT_TABLES:
            del self._found[next(iter(self._found))]
        self._found[wanted] = found


def sum_tables(
    controls: ExposureControls, wanted: ExposureSet, *, is_exact: bool
) -> tuple[SumTable, ...]:
    """Return the table of a window; three where R, G and B have responses of their own."""
    exposures = tuple(controls.exposure(each) / wanted.base for each in wanted.settings)
    scale = 1 / (wanted.base * (controls.sensitivity or 1.0))
    noise = controls.frame_noise(wanted.settings)
    found: dict[str, SumTable] = {}
    for real in controls.responses or (controls.levels,):
        if real.fingerprint not in found:
            make = _exact if is_exact else _quick
            E, deviation, u = make(real, controls.black, exposures, noise, wanted.desired)
            if controls.noise is None:
                deviation[:] = np.nan
            full = float(real.levels[-1]) / min(exposures)
            unlit = len(exposures) * controls.black
            found[real.fingerprint] = _table(
                (E, deviation, u), full, unlit, scale, wanted.desired.e_min, is_exact
            )
    return tuple(found[real.fingerprint] for real in controls.responses or (controls.levels,))


def _exact(
    real: CameraResponse,
    black: int,
    exposures: Sequence[float],
    noise: Sequence[FrameNoise],
    desired: DesiredResponse,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    inverse = posterior_of(EffectiveCamera.of(real, exposures), desired, noise).inverse
    return inverse.E.copy(), inverse.deviation.copy(), inverse.u


def _quick(
    real: CameraResponse,
    black: int,
    exposures: Sequence[float],
    noise: Sequence[FrameNoise],
    desired: DesiredResponse,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    frames = FrameSet(real, black, tuple(exposures), tuple(noise))
    sensor = SensorModel(real, black)
    E = light_of_sums(frames, sensor)
    return E, deviation_of_sums(frames, sensor, E), desired.u(E)


def _table(
    found: tuple[FloatArray, FloatArray, FloatArray],
    full: float,
    unlit: int,
    scale: float,
    darkest: float,
    is_exact: bool,
) -> SumTable:
    """Return the table of light, deviation and desired response.

    Args:
        found: these three
        full: light that saturates every frame
        unlit: largest sum without light
        scale: of the unit of the results
        darkest: light of the desired range
        is_exact: see `SumTable`
    """
    E, deviation, u = found
    is_known = not np.isnan(deviation).all()
    mask = np.full(E.size, GOOD, np.uint8)
    mask[deviation >= E] = DARK
    mask[: unlit + 1] = DARK
    mask[-1] = SATURATED
    E[-1], deviation[-1] = full, math.inf if is_known else math.nan
    return SumTable(
        E,
        (E * scale).astype(np.float32),
        (deviation * scale).astype(np.float32),
        mask,
        np.rint(u * FULL_CODE).astype(np.uint16),
        (darkest > E) | (np.arange(E.size) <= unlit),
        is_exact,
    )
