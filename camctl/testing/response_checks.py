"""Checks of the response to its ends, and of what is added to the light, by many samples' means."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.errors import RefusedSettingError
from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import ExposureSetting
from camctl.model.sensor import CLIPPING_SIGMAS, JPEG_BLOCK_ERROR, SensorModel
from camctl.testing.light_checks import LightChecks, steps_noise
from camctl.testing.suite import QUANTISATION, STANDARD_ERRORS, UNUSABLE

# Frames whose mean tells the light of each sample: its noise is half of that of one.
_KNOWN = 4
# Brightness, as shares of white, to which half of the samples are brought; the first ones where
# `range_length` allows fewer.
_SHARES = (0.95, 0.03, 0.008, 0.9, 0.015, 0.004, 0.06, 0.002)
# Where the response bends unseen by a comparison of middle brightness.
_DARK, _BRIGHT = 0.05, 0.85
# Median brightness of frames in which each dark code is looked for, as shares of white; samples
# whose light is in the middle half of a code, of which so many show it at least once.
_CODE_SHARES, _CODE_SAMPLES = (0.003, 0.004, 0.006, 0.008, 0.01, 0.013, 0.017, 0.02), 200
# Groups of samples of one light: their width, and how many samples a mean needs.
_WIDTH, _LEAST = 1.1, 24
# A line through the groups needs this range of light; factors of the middle time that have one.
_LEAST_RANGE = 1.5
_LADDER = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
# So many samples tell what is added to 0.1 % of white where their noise is 5 %; of small frames
# several are shot, to this number, and fewer where `run_length` is small.
_ENOUGH, _MOST_FRAMES = 20_000, 16

_Floats = NDArray[np.float64]


class _Known(NamedTuple):
    """What is known of the samples, from several frames of one setting.

    Attributes:
        setting: theirs
        light: mean of each sample, full scale is 1
        usable: which samples are well exposed
        sigma: standard deviation of the light of one sample at `typical`, between frames
        reach: the same, where frames repeat their noise: what neighbouring samples scatter
        typical: median of the light
    """

    setting: ExposureSetting
    light: _Floats
    usable: NDArray[np.bool_]
    sigma: float
    reach: float
    typical: float


class _Group(NamedTuple):
    """Samples of nearly one light in a frame.

    Attributes:
        expected: mean of their light by what is known
        found: by the frame
        error: standard error of the difference
    """

    expected: float
    found: float
    error: float


class ResponseChecks(LightChecks):
    """Checks of brightness that no comparison of well exposed frames uses."""

    def test_the_response_holds_near_black_and_near_white(self, camera: Camera) -> None:
        """The stated response is the true one below 5 % and above 85 % of white, too."""
        known = self._known(camera)
        time, middle = camera.controls.time_s, known.setting
        times_s = [
            time.nearest(middle.time_s * share / known.typical)
            for share in _SHARES[: self.range_length]
        ]
        settings = [
            replace(middle, time_s=time_s)
            for time_s in dict.fromkeys(times_s)
            if time_s <= max(self.longest_s, middle.time_s)
        ]
        sensor = self._sensor(camera)
        frames = self.shoot(camera, settings)
        compared = sum([self._check_ends(camera, sensor, known, frame) for frame in frames])
        if not compared:
            pytest.skip("no times bring the samples near black or near white")

    def test_no_dark_code_is_missing(self, camera: Camera) -> None:
        """Samples of the light of a code below 5 % of white show it: none is left out."""
        known, sensor = self._known(camera), self._sensor(camera)
        time, middle = camera.controls.time_s, known.setting
        times_s = [
            time.nearest(middle.time_s * share * sensor.full / known.typical)
            for share in _CODE_SHARES[: self.range_length]
        ]
        frames: list[Frame] = []
        for time_s in dict.fromkeys(times_s):
            with suppress(RefusedSettingError):  # by bodies whose library steps their dial past it
                frames += self.shoot(camera, [replace(middle, time_s=time_s)])
        if frames and self.is_lossy(camera, frames[0]):
            pytest.skip("a JPEG file does not keep single codes")
        codes = np.flatnonzero((sensor.light > 0) & (sensor.light < _DARK * sensor.full))
        codes = codes[codes > sensor.black]
        right, shown = np.zeros(codes.size, int), np.zeros(codes.size, int)
        for frame in frames:
            light = known.light * (frame.applied.exposure / middle.exposure)
            for place, code in enumerate(codes):
                inside = np.abs(light - sensor.light[code]) < sensor.gap[code] / 4
                right[place] += np.count_nonzero(inside & known.usable)
                shown[place] += np.count_nonzero(frame.pixels == code)
        compared = right >= _CODE_SAMPLES
        if not compared.any():
            pytest.skip("no samples have the light of dark codes")
        missing = codes[compared & (shown == 0)]
        assert not missing.size, f"no sample has the dark code {missing[0]}"

    def test_nothing_is_added_to_the_light(self, camera: Camera) -> None:
        """The light of two frames is proportional: no frame has more in bright and dark parts."""
        known = self._known(camera)
        sensor = self._sensor(camera)
        settings = [
            setting
            for setting in dict.fromkeys(self.times(camera, _LADDER))
            if setting.time_s <= max(self.longest_s, known.setting.time_s)
            and setting.exposure < known.setting.exposure * 0.9 * sensor.full / known.typical
        ]
        each = min(
            _MOST_FRAMES,
            math.ceil(self.run_length / _MOST_FRAMES),
            math.ceil(_ENOUGH / np.count_nonzero(known.usable)),
        )
        frames = self.shoot(camera, [setting for setting in settings for _ in range(each)])
        sets = [frames[first : first + each] for first in range(0, len(frames), each)]
        compared = 0
        for pair in itertools.pairwise(sets):
            usable = [self.usable(camera, frame) for same in pair for frame in same]
            both = known.usable & np.all(usable, axis=0)
            seen = [
                np.mean([self._seen(camera, sensor, frame) for frame in same], axis=0)
                for same in pair
            ]
            found = _added(seen, _groups(known.light, both))
            if found is None:
                continue
            added, error, light = found
            first, second = (same[0].applied for same in pair)
            allowed = (
                QUANTISATION * sensor.level * (second.exposure / first.exposure - 1)
                + STANDARD_ERRORS * error
                + self.response_tolerance(camera) / 4 * light
                + _rounding(sensor, known, light)
                + _rounding(sensor, known, light * first.exposure / second.exposure)
                * (second.exposure / first.exposure)
            )
            compared += 1
            assert abs(added) <= allowed, (
                f"from {first} to {second} {added / sensor.full:.2%} of white are added to all "
                "samples"
            )
        if not compared:
            pytest.skip("no two frames have a range of light in common")

    def _check_ends(self, camera: Camera, sensor: SensorModel, known: _Known, frame: Frame) -> int:
        """Check the groups of a frame near the ends of the range; return how many there are."""
        seen = self._seen(camera, sensor, frame)
        light = known.light * (frame.applied.exposure / known.setting.exposure)
        # The darkest and the brightest group hold the samples that noise has brought there.
        groups = [_group(light, seen, part) for part in _groups(light, known.usable)[1:-1]]
        # Errors of times are no errors of the response: samples of middle brightness show them.
        middle = [g for g in groups if 0.2 * sensor.full < g.expected < 0.8 * sensor.full]
        if middle:
            factor = float(np.median([group.found / group.expected for group in middle]))
            if abs(factor - 1) <= self.light_tolerance:
                groups = [g._replace(expected=g.expected * factor) for g in groups]
        compared = 0
        for group in groups:
            if _DARK * sensor.full < group.expected < _BRIGHT * sensor.full:
                continue
            reach = CLIPPING_SIGMAS * _scaled(known.reach, sensor, known, group.expected)
            is_cut = sensor.black == 0 and group.expected <= reach + sensor.level
            if is_cut or group.expected + reach >= sensor.full:
                continue
            compared += 1
            step = sensor.step(np.array([group.expected]))
            rounding = _rounding(sensor, known, group.expected)
            if self.is_lossy(camera, frame):
                rounding = max(rounding, JPEG_BLOCK_ERROR * float(step[0]))
            allowed = (
                self.response_tolerance(camera) * group.expected
                + STANDARD_ERRORS * group.error
                + max(QUANTISATION * float(step[0]), rounding)
            )
            assert abs(group.found - group.expected) <= allowed, (
                f"{frame.applied}: samples of {group.expected / sensor.full:.2%} of the light of "
                f"white show {group.found / sensor.full:.2%}"
            )
        return compared

    def _known(self, camera: Camera) -> _Known:
        """Shoot frames at the middle setting, and return what they tell of the samples."""
        sensor, (middle,) = self._sensor(camera), self.times(camera, [1])
        frames = self.shoot(camera, [middle] * _KNOWN)
        light = np.array([self._seen(camera, sensor, frame) for frame in frames])
        usable = np.all([self.usable(camera, frame) for frame in frames], axis=0)
        if usable.sum() < _LEAST:
            pytest.fail(UNUSABLE)
        sigma = float(np.sqrt(light[:, usable].var(axis=0, ddof=1).mean()))
        mean = light.mean(axis=0)
        planes = camera.controls.layout.planes(mean)
        reach = sigma or max(steps_noise(plane) for plane in planes)
        return _Known(middle, mean, usable, sigma, reach, float(np.median(mean[usable])))

    def _sensor(self, camera: Camera) -> SensorModel:
        return SensorModel(camera.controls.levels, camera.controls.black)

    def _seen(self, camera: Camera, sensor: SensorModel, frame: Frame) -> _Floats:
        """Return the light of each sample, without that of a dark current which is stated."""
        controls, light = camera.controls, sensor.light[np.minimum(frame.pixels, sensor.white)]
        if controls.noise is not None:
            (noise,) = controls.frame_noise([frame.applied])
            light = light - noise.dark_levels * sensor.level
        return np.asarray(light, np.float64)


def _rounding(sensor: SensorModel, known: _Known, light: float) -> float:
    """Return the largest error of rounding that samples of one light have in common.

    It is uniform, up to 3^0.5 of its standard deviation.
    """
    variance = np.array([_scaled(known.sigma, sensor, known, light) ** 2])
    return float(np.sqrt(3 * sensor.rounding(np.array([light]), variance)[1])[0])


def _scaled(sigma: float, sensor: SensorModel, known: _Known, light: float) -> float:
    """Return the standard deviation of a sample's light at another light than the known one.

    That of photons goes with the root of the light, that of compression with the response.
    """
    steps = sensor.step(np.array([light, known.typical]))
    factor = max((light / known.typical) ** 0.5, float(steps[0] / steps[1]))
    return float(sigma * factor)


def _groups(light: _Floats, usable: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Return the places of samples of nearly one light, from the darkest on."""
    places = np.flatnonzero(usable & (light > 0))
    number = np.floor(np.log(light.reshape(-1)[places]) / np.log(_WIDTH)).astype(int)
    groups = [places[number == each] for each in np.unique(number)]
    return [group for group in groups if group.size >= _LEAST]


def _group(light: _Floats, seen: _Floats, places: NDArray[np.intp]) -> _Group:
    """Return what a frame shows of some samples."""
    expected, found = light.reshape(-1)[places], seen.reshape(-1)[places]
    error = float((found - expected).std() / np.sqrt(places.size))
    return _Group(float(expected.mean()), float(found.mean()), error)


def _added(
    seen: Sequence[_Floats], groups: Sequence[NDArray[np.intp]]
) -> tuple[float, float, float] | None:
    """Return what is added to the light of the second frame: by a line through the groups.

    Returns:
        what is added, its standard error, and the mean light of the second frame; None where the
        groups have no range of light
    """
    if len(groups) < 3:
        return None
    parts = [_group(seen[0], seen[1], group) for group in groups]
    x, y, weight = (
        np.array(column)
        for column in (
            [part.expected for part in parts],
            [part.found for part in parts],
            [group.size for group in groups],
        )
    )
    if x.max() < _LEAST_RANGE * x.min():
        return None
    middle = float((weight * x).sum() / weight.sum())
    spread = float((weight * np.square(x - middle)).sum())
    slope = float((weight * (x - middle) * y).sum()) / spread
    level = float((weight * y).sum() / weight.sum())
    # The noise of a sample in both frames; what groups scatter counts, too, if it is more.
    rest = y - level - slope * (x - middle)
    noise = [seen[1].reshape(-1)[group] - slope * seen[0].reshape(-1)[group] for group in groups]
    own = float(np.mean(np.concatenate([each - each.mean() for each in noise]) ** 2))
    variance = max(own, float((weight * rest**2).sum() / (len(groups) - 2)))
    error = np.sqrt(variance * (1 / weight.sum() + middle**2 / spread))
    return level - slope * middle, float(error), level
