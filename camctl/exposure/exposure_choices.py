"""The settings that a camera has, shutter times and gains, and the exposures that they give."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError, UsageError
from camctl.model.noise import FrameNoise, NoiseModel
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.response.desired import DesiredResponse

MAX_SETTINGS = 200_000
"""Settings of one control, at most: bounds memory."""

MAX_PRODUCTS = 4_000_000
"""Pairs of a time and a gain, at most: 100 MB while they are sorted."""

SETTING_LIMITS = 1e-12, 1e12
"""Of a shutter time, in seconds or relative, and of a gain: no camera comes near them."""

SAME = 1e-9
"""Relative difference up to which two exposures, times, or steps of a grid are the same."""


@dataclass(frozen=True, eq=False)
class SettingsGrid:
    """The settings of a camera, and the limits on sets of them.

    Attributes:
        times: (S,) true exposure times or relative exposures, any order
        gains: gains that combine with each time
        base: smallest and largest value of the shortest exposure, in the unit of `times`
        total_limit: largest sum of the exposures, in the unit of `times`; infinite: no limit
    """

    times: ArrayLike
    gains: ArrayLike = (1.0,)
    base: tuple[float, float] | None = None
    total_limit: float = math.inf

    @cached_property
    def exposures(self) -> FloatArray:
        """The different products time x gain, (S,) float64 ascending.

        Products that agree to `SAME` count as one.

        Raises:
            UsageError: one of the lists is empty, or there are more than `MAX_PRODUCTS` pairs
            DataError: a setting is beyond `SETTING_LIMITS`
        """
        low, high = SETTING_LIMITS
        times, gains = (np.ravel(np.asarray(v, np.float64)) for v in (self.times, self.gains))
        for values in (times, gains):
            if values.size == 0:
                raise UsageError("the list of settings is empty", hint="give one setting or more")
            wrong = values[~((values >= low) & (values <= high))]
            if wrong.size:
                raise DataError(f"invalid setting {wrong[0]:g}: expected {low:g} to {high:g}")
        if times.size * gains.size > MAX_PRODUCTS:
            raise UsageError(
                f"too many pairs of a time and a gain ({times.size * gains.size:,}): expected at "
                f"most {MAX_PRODUCTS:,}",
                hint="give fewer times or fewer gains",
            )
        products = np.sort((times[:, np.newaxis] * gains).ravel())
        new = np.concatenate([[True], np.diff(np.log(products)) > SAME])
        return np.asarray(products[new])


def stepped(minimum: float, maximum: float, step: float) -> FloatArray:
    """Return the settings from `minimum` to `maximum` in equal steps, (S,) float64 ascending.

    Raises:
        UsageError: the values are out of range, or give more than 200,000 settings
    """
    if not (0 < minimum <= maximum < math.inf and 0 < step < math.inf):
        raise UsageError(
            f"invalid settings {minimum:g} to {maximum:g} in steps of {step:g}: "
            "expected 0 < minimum <= maximum and a step above 0"
        )
    steps = (maximum - minimum) / step * (1 + 1e-12) + 1e-9
    if not steps < MAX_SETTINGS:
        raise UsageError(
            f"too many settings ({steps + 1:.12g}): expected at most {MAX_SETTINGS}",
            hint="choose a larger step",
        )
    return np.asarray(minimum + step * np.arange(math.floor(steps) + 1))


MAX_CHOICES = 600
"""Exposures of a list that a search chooses from, at most; longer lists are thinned out."""

MAX_BASES = 12
"""Shortest exposures that are tried on a list, at most."""


class Shot(NamedTuple):
    """One exposure of a set.

    Attributes:
        exposure: time x gain relative to the shortest of the set
        time: shutter time, in the unit of `AvailableExposures`
        gain: linear gain
    """

    exposure: float
    time: float
    gain: float


Shots: TypeAlias = tuple[Shot, ...]
"""A set of exposures, ascending."""


@dataclass(frozen=True)
class Rated:
    """A set of exposures with its effective levels, noise included.

    `time` is what `TimeCosts.total` counts, in the unit of `AvailableExposures`.
    """

    shots: Shots
    levels: float
    time: float


@dataclass(frozen=True)
class TimeCosts:
    """What is counted as time: an exposure of shutter time t takes factor x max(t, least) + extra.

    The last one, which is the largest, takes `waiting` frames less.  By default shutter time alone
    is counted.

    Attributes:
        factor: how many frames each exposure takes
        least: shortest time of a frame, such as the frame interval of a stream
        extra: further time of each exposure
        fixed: further time of each set
        waiting: how many of the frames of an exposure pass before the next one alone
    """

    factor: float = 1.0
    least: float = 0.0
    extra: float = 0.0
    fixed: float = 0.0
    waiting: float = 0.0

    def each(self, times: FloatArray) -> FloatArray:
        """Return what exposures of these shutter times take, without the time of their set."""
        return self.factor * np.maximum(times, self.least) + self.extra

    def saved(self, times: FloatArray) -> FloatArray:
        """Return what exposures of these shutter times take less as the last one."""
        return self.waiting * np.maximum(times, self.least)

    def total(self, times: Sequence[float]) -> float:
        """Return what a set takes, ascending in exposure, without its fixed time."""
        array = np.array(times, dtype=np.float64)
        return math.fsum([*self.each(array), *-self.saved(array[-1:])])

    def shutter(self, total: float, n: int = 1) -> float:
        """Return the longest sum of n shutter times that take `total`; less where some are short.

        All but the last are as short as a frame then where others wait for them.  `total` is
        without the fixed time.
        """
        others = (n - 1) * self.least if self.waiting else 0.0
        left = total - n * self.extra - self.factor * others
        return others + left / (self.factor - self.waiting)

    def in_unit(self, unit: float) -> TimeCosts:
        """Return the same for another unit of time."""
        least, extra, fixed = self.least / unit, self.extra / unit, self.fixed / unit
        return TimeCosts(self.factor, least, extra, fixed, self.waiting)


@dataclass(frozen=True, eq=False)
class AvailableExposures:
    """The shutter times and gains to choose from.

    Attributes:
        times: (S,) times that can be set, any order; None: any time
        gains: gains that combine with each time
        shortest, longest: the shortest and the longest time, where any can be set
        step: distance of two times that can be set then; 0: none.  Sets of cameras whose noise
            dithers the quantiser are found without it
        base: for a list, smallest and largest product time x gain of the shortest exposure, which
            decides the light that just saturates; None: any.  Where any time can be set the
            shortest exposure is time 1 at the smallest gain
        unit_s: seconds in the unit of time; 0: unknown, and the dark current is left out
        costs: what is counted as the time of a set

    Raises:
        UsageError: a list is empty, or the limits exclude the shortest exposure
        DataError: a setting is not a positive, finite number
    """

    times: ArrayLike | None = None
    gains: tuple[float, ...] = (1.0,)
    shortest: float = 0.0
    longest: float = math.inf
    step: float = 0.0
    base: tuple[float, float] | None = None
    unit_s: float = 0.0
    costs: TimeCosts = TimeCosts()

    def __post_init__(self) -> None:
        for values in (self.gains, [1.0] if self.times is None else self.times):
            numbers = np.ravel(np.asarray(values, dtype=np.float64))
            if numbers.size == 0:
                raise UsageError("the list of settings is empty", hint="give one setting or more")
            wrong = numbers[~(np.isfinite(numbers) & (numbers > 0))]
            if wrong.size:
                raise DataError(f"invalid setting {wrong[0]:g}: expected a positive, finite number")
        if not self.shortest <= 1 <= self.longest and self.times is None:
            raise UsageError(
                f"invalid limits {self.shortest:g} and {self.longest:g} of the times: expected the "
                "shortest exposure, 1, between them"
            )

    def in_steps(self, shots: Shots, limit: float) -> Shots:
        """Return a set of a time at most `limit` with its times in the steps that can be set."""
        step = self.step
        if not step or self.times is not None:
            return shots
        gain = np.array([shot.gain for shot in shots])
        place = (np.array([shot.time for shot in shots]) - 1) / step
        if np.all(np.abs(place - np.round(place)) * step <= SAME * (1 + step * place)):
            return shots
        low, high = (self.shortest - 1) / step, (self.longest - 1) / step
        for number in (np.round(place), np.floor(place + SAME)):
            time = 1 + step * np.clip(number, math.ceil(low - SAME), math.floor(high + SAME))
            rows = zip(time * gain / min(self.gains), time, gain, strict=True)
            shots = tuple(sorted(Shot(float(e), float(t), float(g)) for e, t, g in rows))
            if self.costs.total([shot.time for shot in shots]) <= limit * (1 + SAME):
                break
        return shots

    def duration(self, time: float) -> str:
        """Return the time of a set, given without its fixed time in this unit, as text."""
        time += self.costs.fixed
        return f"{time * self.unit_s:.4g} s" if self.unit_s else f"{time:.4g} x the shortest"


@dataclass(frozen=True, eq=False)
class AccuracyProblem:
    """What is photographed with which camera.

    Attributes:
        response: the response of the real camera
        desired: the desired response; its E = 1 is full scale of the shortest exposure
        noise: the noise of the camera
        available: the shutter times and gains to choose from
        black: the black level of the camera, DN
    """

    response: CameraResponse
    desired: DesiredResponse
    noise: NoiseModel
    available: AvailableExposures = AvailableExposures()
    black: int = 0

    @property
    def reach(self) -> float:
        """The longest exposure that can be of use: it shows the darkest light in few levels."""
        levels = self.response.levels
        return 1 / (self.desired.e_min or float(levels[levels > 0][0]) / 16)

    @property
    def identity(self) -> tuple[object, ...]:
        """Everything that decides which sets are best, but for the costs of time."""
        available = self.available
        times = None if available.times is None else np.ravel(available.times).tolist()
        return (
            self.response.fingerprint,
            self.desired.key,
            self.desired.dynamic_range,
            self.noise,
            self.black,
            times,
            (available.gains, available.shortest, available.longest, available.base),
            available.step,
            available.unit_s,
        )

    def frame_noise(self, shot: Shot) -> FrameNoise:
        """Return the noise of a frame with this exposure."""
        time_s = shot.time * self.available.unit_s
        return self.noise.frame(gain=shot.gain, time_s=time_s, black=self.black)


def bases(problem: AccuracyProblem) -> list[float]:
    """Return the products time x gain that may be the shortest exposure, the largest first.

    Raises:
        UsageError: no setting can be the shortest exposure
    """
    available = problem.available
    if available.times is None:
        return [min(available.gains)]
    times = np.unique(np.asarray(available.times, dtype=np.float64))
    products = np.unique(times[:, np.newaxis] * np.unique(available.gains))
    low, high = (0.0, math.inf) if available.base is None else available.base
    allowed = products[(products >= low * (1 - SAME)) & (products <= high * (1 + SAME))]
    if not allowed.size:
        raise UsageError(
            f"no setting between {low:g} and {high:g} can be the shortest exposure",
            hint=f"the settings go from {products.min():.6g} to {products.max():.6g}",
        )
    different = allowed[np.append(True, np.diff(np.log(allowed)) > SAME)]
    places = np.unique(np.linspace(0, different.size - 1, MAX_BASES).astype(np.intp))
    return [float(base) for base in different[places][::-1]]
