"""Checks of single samples and equal settings: what ratios of light over a picture do not show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from camctl.interface.camera import Camera
from camctl.testing.light_checks import LightChecks
from camctl.testing.suite import UNUSABLE

# Equal settings in a row; a camera without noise sends the same picture each time.
_EQUAL = 12
# Of a bit that the samples have, this share of them has it set at least, and not set.
_LEAST_BIT_SHARE = 0.05
# Of a bit, the codes of the samples cover so many periods, and so many codes are there at least.
_PERIODS, _LEAST_CODES = 8, 16
# The middle 90 % of the samples cover codes.
_COVERED = (5, 95)
# Where the irradiance should be this many times the irradiance of white, a sample is white.
_SURELY_WHITE, _WHITE_SHARE = 1.5, 0.98
# The border is one part in so many of the picture's side; it needs so many samples; beside the
# middle it may change by this share, and by so many standard errors.
_BORDER, _LEAST_BORDER, _SHADING, _STANDARD_ERRORS = 12, 50, 0.02, 5.0
# A time stamp may be later than the arrival of its frame by this, s: rounding alone.
_EPSILON_S = 1e-6
# Requests, which come at other times within a frame, and the least share of a time that lasts.
_REQUESTS, _LEAST_TIME = 8, 0.98


class SampleChecks(LightChecks):
    """Checks by single samples, by gains and by settings that do not change."""

    def test_equal_settings_in_a_row_have_frames_of_their_own(self, camera: Camera) -> None:
        """A frame is not sent again because its setting is the one before."""
        frames = self.shoot(camera, self.times(camera, [1] * _EQUAL))
        different = len({frame.pixels.tobytes() for frame in frames})
        assert different in (1, _EQUAL), f"{_EQUAL - different} frames are copies of others"
        if different == 1:  # only a camera without noise may do this, with others between, too
            apart = self.shoot(camera, self.times(camera, [1, 0.5] * 3))[::2]
            assert len({frame.pixels.tobytes() for frame in apart}) == 1, "frames are copies"
        assert len({frame.timestamp_s for frame in frames}) == _EQUAL

    def test_time_stamps_are_not_later_than_the_frames(self, camera: Camera) -> None:
        """An exposure has ended when its frame is here."""
        for frame in camera.shoot(self.times(camera, [1, 0.5, 1, 0.5])):
            late_s = frame.timestamp_s - camera.clock.now()
            assert late_s <= _EPSILON_S, f"frame {frame.index} is stamped {late_s:.3g} s too late"

    def test_time_stamps_are_not_earlier_than_the_exposures(self, camera: Camera) -> None:
        """A frame that was asked for has been exposed since then, after its control delay."""
        controls = camera.controls
        delay = controls.delay_frames or 0
        for setting in self.times(camera, [1, 0.5] * (_REQUESTS // 2)):
            least_s = camera.clock.now() + max(delay, 0) * controls.frame_interval_s * _LEAST_TIME
            if delay >= 0:  # else the exposure that runs has it
                least_s += setting.time_s * _LEAST_TIME
            (frame,) = self.shoot(camera, [setting])
            early_s = least_s - frame.timestamp_s
            assert early_s <= _EPSILON_S, (
                f"{setting}: its frame is stamped {early_s:.3g} s too early"
            )

    def test_white_is_exact_at_every_gain(self, camera: Camera) -> None:
        """Samples that must be saturated have the stated white level, or more."""
        controls, middle = camera.controls, self.times(camera, [1])[0]
        gains = [*controls.gain.near(controls.gain.minimum, 1)]
        gains += [controls.gain.nearest(float(g)) for g in (2.0, 4.0, controls.gain.maximum)]
        (known,) = self.shoot(camera, [middle])
        if self.is_lossy(camera, known):
            pytest.skip("a JPEG file does not keep white exactly")
        light = np.where(self.usable(camera, known), self.irradiance(camera, known), 0.0)
        limit_s = min(controls.time_s.maximum, self.longest_s)
        compared = 0
        for gain in dict.fromkeys(gains):
            time_s = controls.time_s.nearest(min(16 * middle.exposure / gain, limit_s))
            (frame,) = self.shoot(camera, [replace(middle, time_s=time_s, gain=gain)])
            factor = frame.applied.exposure / known.applied.exposure
            must = light * factor > _SURELY_WHITE
            compared += int(must.sum())
            if must.any():
                share = float((frame.pixels[must] >= frame.white).mean())
                assert share >= _WHITE_SHARE, (
                    f"at gain {gain:g} {1 - share:.1%} of the samples that must be white are below "
                    f"{frame.white}"
                )
        if not compared:
            pytest.skip("no sample can be made white")

    def test_every_bit_of_the_samples_is_used(self, camera: Camera) -> None:
        """No bit of the stated depth is always the same."""
        frames = self.shoot(camera, self.times(camera, [1, 0.9, 0.75, 0.6, 0.5]))
        used = [frame.pixels[self.usable(camera, frame)] for frame in frames]
        samples = np.concatenate([each.reshape(-1) for each in used])
        low, high = np.percentile(samples, _COVERED)
        bits = [
            bit for bit in range(camera.controls.bits) if high - low >= _PERIODS * 2 ** (bit + 1)
        ]
        if np.unique(samples).size < _LEAST_CODES or not bits:
            pytest.skip("the frames have too few codes")
        for bit in bits:
            share = float((samples >> bit & 1).mean())
            assert _LEAST_BIT_SHARE < share < 1 - _LEAST_BIT_SHARE, (
                f"bit {bit} is set in {share:.1%} of the samples"
            )

    def test_gains_do_not_change_the_shading(self, camera: Camera) -> None:
        """Frames of one exposure show the same picture at every gain, to its border."""
        settings = self.over_range(camera, "gain")
        if len(settings) < 2:
            pytest.skip("gain of the camera has one setting")
        first, *others = self.shoot(camera, settings)
        compared = 0
        for other in others:
            both = self.usable(camera, first) & self.usable(camera, other)
            border = np.ones(both.shape[:2], np.bool_)
            width = max(1, min(border.shape) // _BORDER)
            border[width:-width, width:-width] = False
            border = border.reshape(*border.shape, *[1] * (both.ndim - 2))
            outer, inner = both & border, both & ~border
            if min(outer.sum(), inner.sum()) < _LEAST_BORDER:
                continue
            ratio = self.irradiance(camera, other) / np.maximum(
                self.irradiance(camera, first), np.finfo(float).tiny
            )
            error = float(ratio[inner].std() / np.sqrt(outer.sum()) / ratio[inner].mean())
            change = float(ratio[outer].mean() / ratio[inner].mean()) - 1
            compared += 1
            assert abs(change) <= _SHADING + _STANDARD_ERRORS * error, (
                f"from {first.applied} to {other.applied} the border changes by {change:.1%}"
            )
        assert compared, UNUSABLE
