"""Checks of long sequences, of a device that disappears, and of a second program."""

from __future__ import annotations

import itertools
from contextlib import closing

import numpy as np
import pytest

from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraTimeoutError,
)
from camctl.interface.camera import Camera
from camctl.testing.suite import CameraSuite


class FaultChecks(CameraSuite):
    """Checks of what happens late, rarely, or when something fails."""

    def test_long_sequences_have_the_right_frames(self, camera: Camera) -> None:
        """Every frame of a long list has its own exposure, and none is sent twice."""
        settings = self.times(camera, [1, 0.5, 0.25])
        pattern = list(itertools.islice(itertools.cycle(settings), self.run_length))
        frames = self.shoot(camera, pattern)
        assert [frame.index for frame in frames] == list(range(self.run_length))
        assert [frame.requested for frame in frames] == pattern
        assert len({frame.timestamp_s for frame in frames}) == self.run_length
        for setting in dict.fromkeys(settings):
            same = [frame for frame in frames if frame.requested == setting]
            light = np.array([self.light(camera, frame) for frame in same])
            usual = np.median(light)
            wrong = np.flatnonzero(
                np.abs(light - usual)
                > self.light_tolerance * usual + 1.0 / camera.controls.levels.M
            )
            assert not wrong.size, (
                f"frames {[same[i].index for i in wrong]} differ from the others of "
                f"{setting.time_s:g} s"
            )
            copies = len(same) - len({frame.pixels.tobytes() for frame in same})
            # A camera without noise sends the same picture each time.
            assert copies in (0, len(same) - 1), f"{copies} frames are copies of others"

    def test_applied_is_what_the_device_itself_states(self, camera: Camera) -> None:
        """`applied` agrees with the device's own settings, read in another way."""
        for factor in (1, 0.25, 2):
            (frame,) = self.shoot(camera, self.times(camera, [factor]))
            actual = self.in_force(camera)
            tolerance = max(camera.controls.tolerance, 1e-9)
            assert frame.applied.time_s == pytest.approx(actual.time_s, rel=tolerance)
            assert frame.applied.gain == pytest.approx(actual.gain, rel=tolerance)

    def test_unplugged_camera_raises_an_error_of_one_line(self, camera: Camera) -> None:
        """A camera that is disconnected during a sequence is an error, not a frame."""
        with closing(camera.shoot(self.times(camera, [1] * 6))) as frames:
            next(frames)
            self.unplug(camera)
            with pytest.raises(CameraDisconnectedError) as error:
                list(frames)
        assert "\n" not in str(error.value)
        with pytest.raises(CameraError):
            self.shoot(camera, self.times(camera, [1]))

    def test_silent_camera_raises_an_error_after_a_limited_time(self, camera: Camera) -> None:
        """A camera that answers nothing any more does not keep its caller waiting for ever."""
        with closing(camera.shoot(self.times(camera, [1] * 6))) as frames:
            next(frames)
            self.silence(camera)
            before_s = camera.clock.now()
            with pytest.raises((CameraTimeoutError, CameraDisconnectedError)) as error:
                list(frames)
        assert "\n" not in str(error.value)
        assert camera.clock.now() - before_s <= self.silence_s

    def test_second_opener_does_not_disturb_the_first(self, camera: Camera) -> None:
        """A second opener is refused with an error; the first camera still works."""
        settings = self.times(camera, [1, 0.25])
        before = [self.light(camera, frame) for frame in self.shoot(camera, settings)]
        with pytest.raises(CameraError) as error:
            self.open_second(camera).close()
        assert "\n" not in str(error.value)
        after = [self.light(camera, frame) for frame in self.shoot(camera, settings)]
        assert after == pytest.approx(before, rel=self.light_tolerance, abs=0.01)
