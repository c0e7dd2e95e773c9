"""The simulated camera: the contract of every camera, its faults, and its frames."""

from __future__ import annotations

import numpy as np
import pytest
from steady_camera import (
    INTERVAL_S,
    check_exposure,
    expected_dn,
    lines,
    open_steady,
    works,
)

from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraTimeoutError,
    RefusedSettingError,
)
from camctl.interface.camera import Camera, Frame
from camctl.interface.clock import RealClock
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SILENCE_S, Faults, SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.sim.streaming_device import QUEUE
from camctl.testing.conformance import CameraConformance


class LatenessClock(RealClock):
    """Real time that measures how late its user was: all the time that it was not meant to sleep.

    That is the time of computing, and the time that a busy machine adds.
    """

    def __init__(self) -> None:
        self._start_s = self.now()
        self._asleep_s = 0.0

    @property
    def late_s(self) -> float:
        return self.now() - self._start_s - self._asleep_s

    def sleep_until(self, deadline_s: float) -> None:
        self._asleep_s += max(0.0, deadline_s - self.now())
        super().sleep_until(deadline_s)


@pytest.mark.serial
class TestRealTimeConforms(CameraConformance):
    """In virtual time cameras of all kinds conform in `tests/testing/test_conformance.py`."""

    interval_s = 0.02
    longest_s = 2.0  # longer ones are shot in virtual time, there

    def open_camera(self) -> Camera:
        sensor = load_sensor("machine-vision").model_copy(
            update={"frame_interval_s": self.interval_s}
        )
        return SimulatedCamera(load_scene("ramp", (40, 60)), sensor, clock=LatenessClock())

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.004)

    def test_constant_delay_costs_n_plus_d_frames(self, camera: Camera) -> None:
        """More slots may be used only if the machine was late meanwhile.

        A slot is wasted if the camera was late for all of it.  If that lasts for more slots than
        there are buffers, a frame is lost, and up to d + 1 settings are written again.
        """
        assert isinstance(camera, SimulatedCamera)
        assert isinstance(camera.clock, LatenessClock)
        delay = camera.sensor.delay_frames
        settings = self.times(camera, [1, 0.5, 1, 0.5, 1, 0.5])
        late_s, slots = camera.clock.late_s, camera.device.upcoming
        stamps_s = [frame.timestamp_s for frame in self.shoot(camera, settings)]
        slots = camera.device.upcoming - slots
        late_slots = int((camera.clock.late_s - late_s) / self.interval_s)
        allowed = late_slots * (1 + (delay + 1) / QUEUE)
        # The slot in which the list arrives may end before the first setting is written.
        assert slots <= len(settings) + delay + 1 + allowed
        assert stamps_s[-1] - stamps_s[0] <= (len(settings) - 1 + allowed + 0.5) * self.interval_s


def test_camera_opens_again_with_a_new_stream() -> None:
    with open_steady() as camera:
        (first,) = camera.shoot(lines(10))
        camera.close()
        camera.close()
        with camera.open():
            assert camera.device.upcoming == 0
            (again,) = camera.shoot(lines(10))
    assert np.array_equal(first.pixels, again.pixels)


def test_device_clamps_silently_and_the_camera_refuses() -> None:
    with open_steady() as camera:
        _, applied = camera.device.write(ExposureSetting(1e6, 99.0))
        assert applied == ExposureSetting(camera.sensor.times.nearest(60.0), 4.0)
        before = camera.clock.now()
        good = lines(10)[0]
        with pytest.raises(RefusedSettingError, match="time_s"):
            camera.shoot([good, ExposureSetting(1e6)])
        with pytest.raises(RefusedSettingError, match="gain"):
            camera.shoot([good, ExposureSetting(good.time_s, 1.4)])
        with pytest.raises(RefusedSettingError):
            camera.preview(ExposureSetting(1e6))
        assert camera.clock.now() == before


def test_two_frames_with_one_setting_have_different_noise() -> None:
    with SimulatedCamera(load_scene("ramp", (30, 40)), load_sensor("phone")) as camera:
        setting = ExposureSetting(camera.controls.time_s.nearest(0.01))
        first, second = camera.shoot([setting, setting])
        assert not np.array_equal(first.pixels, second.pixels)


def test_two_sequences_created_together_do_not_both_run() -> None:
    with open_steady() as camera:
        first, second = camera.shoot(lines(10, 20)), camera.shoot(lines(10, 20))
        next(first)
        with pytest.raises(CameraBusyError):
            next(second)
        assert len(list(first)) == 1
        assert works(camera)


def frames_until(camera: SimulatedCamera, kind: type[Exception], match: str) -> list[Frame]:
    got: list[Frame] = []
    frames = camera.shoot(lines(10, 20, 30, 40))

    def drain() -> None:
        for frame in frames:
            check_exposure(camera, frame)
            got.append(frame)

    with pytest.raises(kind, match=match):
        drain()
    return got


@pytest.mark.parametrize("after", [0, 1, 3])
def test_unplugged_camera(after: int) -> None:
    camera = open_steady(faults=Faults(unplug_after=after))
    assert len(frames_until(camera, CameraDisconnectedError, "unplugged; plug it in")) == after
    with pytest.raises(CameraDisconnectedError):
        list(camera.shoot(lines(10)))
    camera.close()


@pytest.mark.parametrize("after", [0, 2])
def test_frozen_camera_times_out_after_silence(after: int) -> None:
    camera = open_steady(faults=Faults(freeze_after=after))
    frames_until(camera, CameraTimeoutError, "no frame .* for 5 s")
    silent_since = camera.clock.now() - SILENCE_S
    assert 0 <= silent_since <= 10 * INTERVAL_S


def test_exposure_longer_than_the_time_out() -> None:
    with open_steady() as camera:
        (frame,) = camera.shoot([ExposureSetting(camera.sensor.times.nearest(4 * SILENCE_S))])
        assert frame.timestamp_s > 4 * SILENCE_S


def test_camera_that_is_busy_at_first() -> None:
    with open_steady(faults=Faults(busy_calls=2)) as camera:
        with pytest.raises(CameraBusyError):
            camera.shoot(lines(10))
        with pytest.raises(CameraBusyError):
            camera.preview(lines(10)[0])
        assert works(camera)


def test_wrong_exposure_shows_only_in_the_pixels_of_one_frame() -> None:
    with open_steady(faults=Faults(wrong_exposure={1: 0.5})) as camera:
        camera.preview(lines(10)[0])
        frames = [*camera.shoot(lines(20, 20)), *camera.shoot(lines(20, 20))]
        right = expected_dn(camera, frames[0].applied)
        assert [f.applied for f in frames] == [frames[0].applied] * 4
        seen = [int(f.pixels[0, 0]) for f in frames]
        assert seen == pytest.approx([right, right / 2, right, right], abs=1)


def test_closed_camera_yields_no_frame() -> None:
    camera = open_steady()
    frames = camera.shoot(lines(10, 20))
    next(frames)
    camera.close()
    with pytest.raises(CameraDisconnectedError, match="the simulated camera is not open"):
        next(frames)
    with pytest.raises(CameraDisconnectedError):
        camera.preview(lines(10)[0])
    camera.close()


def test_step_raises_the_errors_of_shoot() -> None:
    short, long = lines(5, 20)
    with open_steady() as camera:
        with pytest.raises(RefusedSettingError):
            camera.step(short, ExposureSetting(1e9), 3)
        frames = camera.shoot(lines(5, 10))
        next(frames)
        with pytest.raises(CameraBusyError):
            camera.step(short, long, 3)
    with pytest.raises(CameraDisconnectedError):
        camera.step(short, long, 3)
    for faults, kind in (
        (Faults(unplug_after=0), CameraDisconnectedError),
        (Faults(freeze_after=0), CameraTimeoutError),
    ):
        with open_steady(faults=faults) as camera, pytest.raises(kind):
            camera.step(short, long, 3)


def test_mode_states_format_size_and_rate() -> None:
    with open_steady() as camera:
        assert camera.mode == "mono12-3x2-32"
