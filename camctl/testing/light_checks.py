"""Checks of the light in the frames: that every frame has the exposure that it states."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import Control, ExposureControls, ExposureSetting
from camctl.model.quantiles import NORMAL_MAD
from camctl.testing.suite import QUANTISATION, UNUSABLE, CameraSuite

# Neighbouring settings of a check over a whole range differ by about this factor.
_STEP = 2.0
# Where the irradiance should be this many times the irradiance of white, a sample must be
# saturated.
_SURELY_WHITE = 1.5
_LEAST_WHITE_SHARE = 0.98
# How far below white a saturated sample may lie beside a dark one in a JPEG file.
_LOSS = 0.04
# Pictures are compared in so many blocks in each direction; blocks of a still scene may differ by
# this share, between two settings and with the same one, and by this many standard errors.
_BLOCKS = 4
_BLOCK_TOLERANCE, _SAME_TOLERANCE, _STANDARD_ERRORS = 0.015, 0.004, 6.0
# Neighbouring settings that are compared differ by this factor at least, and must be distinguished.
_APART = 1.15


class LightChecks(CameraSuite):
    """Checks by the pixels, which a driver that reports wrong settings cannot pass."""

    # ---- ratios over the whole range

    @pytest.mark.parametrize("control", ["time_s", "gain", "f_number"])
    def test_light_follows_the_control_over_its_whole_range(
        self, camera: Camera, control: str
    ) -> None:
        """From one end of a control to the other, the light follows the stated settings.

        The other controls compensate as far as they can, so that most frames are neither black nor
        white.  Where a frame must be white, it is.
        """
        settings = self.over_range(camera, control)
        if len(settings) < 2:
            pytest.skip(f"{control} of the camera has one setting")
        frames = self.shoot(camera, settings)
        if (aperture := camera.controls.f_number) is not None:
            # It stays where it was set, also after the camera was closed.
            widest = replace(self.times(camera, [1])[0], f_number=aperture.minimum)
            self.shoot(camera, [widest])
        compared = 0
        for first, second in itertools.pairwise(frames):
            compared += self.check_light(camera, first, second)
            for known, other in ((first, second), (second, first)):
                self._check_white(camera, known, other)
        assert compared, UNUSABLE

    def over_range(self, camera: Camera, control: str) -> list[ExposureSetting]:
        """Return settings from one end of a control to the other, of similar exposure.

        The middle setting of the suite is among them.
        """
        controls = camera.controls
        own: Control | None = getattr(controls, control)
        if own is None:
            return []
        middle = self.times(camera, [1])[0]
        if controls.f_number is not None:
            # The widest: that is where a camera's aperture stands before it is set.
            middle = replace(middle, f_number=controls.f_number.minimum)
        limit = self.longest_s if control == "time_s" else None
        values = _spread(own, limit, self.range_length)
        return [
            _compensated(replace(middle, **{control: value}), control, controls, middle)
            for value in values
        ]

    def _check_white(self, camera: Camera, known: Frame, other: Frame) -> None:
        """Check that samples of `other` are saturated where `known` says that they must be."""
        factor = other.applied.exposure / known.applied.exposure
        light = np.where(self.usable(camera, known), self.irradiance(camera, known), 0.0)
        must = light * factor > _SURELY_WHITE
        if must.any():
            loss = _LOSS if self.is_lossy(camera, other) else 0.0
            least = other.white - loss * (other.white - other.black)
            white = float((other.pixels[must] >= least).mean())
            assert white >= _LEAST_WHITE_SHARE, (
                f"{other.applied}: {1 - white:.1%} of the samples that should be white are not"
            )

    def test_neighbouring_times_differ_in_light(self, camera: Camera) -> None:
        """A camera does not set a coarser time than the one that it states."""
        control, middle = camera.controls.time_s, self.times(camera, [1])[0]
        near = [t for t in control.near(middle.time_s, 9) if t <= self.longest_s]
        ladder = [near[0]]
        for time_s in near[1:]:
            if time_s >= ladder[-1] * _APART:
                ladder.append(time_s)
        if len(ladder) < 2:
            pytest.skip("the shutter times near the middle are too close to be distinguished")
        frames = self.shoot(camera, [replace(middle, time_s=t) for t in ladder])
        pairs = list(itertools.pairwise(frames))
        compared = sum([self.check_light(camera, *pair) for pair in pairs])
        assert compared, UNUSABLE

    # ---- time

    def test_long_exposures_last_as_long_as_they_state(self, camera: Camera) -> None:
        """A time that is cut short silently shows on the clock, even if every frame is white."""
        control, gain = camera.controls.time_s, camera.controls.gain.minimum
        limit_s = min(control.maximum, self.longest_s)
        for time_s in control.between(control.minimum, limit_s, 200)[-1:]:
            before_s = camera.clock.now()
            short = control.nearest(min(time_s, self.middle_s(camera)))
            first, second = self.shoot(
                camera, [ExposureSetting(short, gain), ExposureSetting(time_s, gain)]
            )
            tolerance = 1 - max(camera.controls.tolerance, 0.02)
            assert second.timestamp_s - first.timestamp_s >= time_s * tolerance
            assert camera.clock.now() - before_s >= time_s * tolerance

    # ---- what the pictures show

    def test_frames_show_the_same_picture(self, camera: Camera) -> None:
        """Frames of a still scene agree in every part of the picture, whatever their exposure."""
        frames = self.shoot(camera, self.times(camera, [1, 1, 0.5, 1, 1, 0.5, 0.5, 1]))
        for index, frame in enumerate(frames[1:], 1):
            worst = self.worst_block(camera, frames[0], frame)
            assert worst is None or worst <= 1, (
                f"frame {index} shows another picture than frame 0: {worst:.1f} times the tolerance"
            )

    def worst_block(self, camera: Camera, first: Frame, second: Frame) -> float | None:
        """Return the largest difference of two frames in a block, in units of what is allowed."""
        compared = self.compare(camera, first, second)
        if compared is None:
            return None
        layout = camera.controls.layout
        is_same = first.applied == second.applied
        tolerance = _SAME_TOLERANCE if is_same else _BLOCK_TOLERANCE
        worst: float | None = None
        light = [self.irradiance(camera, frame) for frame in (first, second)]
        light[1] = light[1] / compared.ratio
        both = self.usable(camera, first) & self.usable(camera, second)
        level = np.diff(np.asarray(camera.controls.levels.gaps[0])).max()  # irradiance of a level
        for a, b, usable in zip(*(layout.planes(x) for x in (*light, both)), strict=True):
            noise = steps_noise(b - a)
            for block in _blocks(a.shape[0], a.shape[1]):
                count = int(usable[block].sum())
                if count < 8:
                    continue
                one, two = a[block][usable[block]].mean(), b[block][usable[block]].mean()
                allowed = (
                    tolerance * one
                    + _STANDARD_ERRORS * noise / np.sqrt(count)
                    + QUANTISATION * level * max(1.0, 1 / compared.ratio)
                )
                found = abs(two - one) / allowed
                worst = found if worst is None else max(worst, found)
        return worst


def _spread(control: Control, limit: float | None, most: int) -> list[float]:
    """Return settings of a control from one end to the other, evenly in their logarithm."""
    low = control.minimum
    high = control.maximum if limit is None else min(control.maximum, max(limit, low))
    count = min(most, max(2, round(np.log(high / low) / np.log(_STEP)) + 1))
    found = {control.nearest(float(value)) for value in np.geomspace(low, high, count)}
    return sorted(value for value in found if value <= high * (1 + 1e-9))


def _compensated(
    setting: ExposureSetting, fixed: str, controls: ExposureControls, middle: ExposureSetting
) -> ExposureSetting:
    """Return a setting whose other controls bring its exposure as near to `middle` as they can."""
    for name in ("time_s", "gain", "f_number"):
        control: Control | None = getattr(controls, name)
        if name == fixed or control is None:
            continue
        missing = middle.exposure / setting.exposure
        now = getattr(setting, name)
        requested = now * (missing**-0.5 if name == "f_number" else missing)
        setting = replace(setting, **{name: control.nearest(requested)})
    return setting


def steps_noise(difference: NDArray[np.float64]) -> float:
    """Return the standard deviation of the noise in a difference, without what varies slowly."""
    steps = np.diff(difference, axis=1)
    return float(np.median(np.abs(steps)) / NORMAL_MAD / np.sqrt(2))


def _blocks(rows: int, columns: int) -> list[tuple[slice, slice]]:
    """Return the blocks of a picture."""
    down = np.linspace(0, rows, min(_BLOCKS, rows) + 1).astype(int)
    across = np.linspace(0, columns, min(_BLOCKS, columns) + 1).astype(int)
    return [
        (slice(top, bottom), slice(left, right))
        for top, bottom in itertools.pairwise(down)
        for left, right in itertools.pairwise(across)
    ]
