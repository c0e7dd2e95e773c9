"""The simulated camera: no old frame, no wasted slot, and faults as hardware has them."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.camera import Camera, Frame, PreviewingCamera, StreamingCamera
from camctl.clock import Clock, RealClock, VirtualClock
from camctl.controls import ExposureSetting
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
)
from camctl.testing.conformance import CameraConformance
from sim.camera import SILENCE_S, Faults, SimulatedCamera
from sim.scenes.scene import Scene, load_scene
from sim.sensors.sensor import Sensor, load_sensor, sensor_names
from sim.streaming_device import QUEUE

INTERVAL_S = 0.03125  # a binary fraction: virtual time adds up exactly
LIGHT = 100_000.0


class BusyClock(VirtualClock):
    """Virtual time in which each look at the clock takes some time, as computing does."""

    def __init__(self, step_s: float) -> None:
        super().__init__()
        self._step_s = step_s

    def now(self) -> float:
        self.sleep_until(super().now() + self._step_s)
        return super().now()


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


def steady_sensor(delay: int = 2, jitter: int = 0) -> Sensor:
    """A noise-free 12-bit sensor: its pixels show each millisecond of exposure."""
    return load_sensor("ideal-12").model_copy(
        update={
            "delay_frames": delay,
            "delay_jitter_frames": jitter,
            "frame_interval_s": INTERVAL_S,
            "line_s": 2.0**-10,
            "time_minimum_s": 2.0**-10,
            "gain_maximum": 4.0,
            "gain_step": 1.0,
        }
    )


def open_steady(
    delay: int = 2,
    jitter: int = 0,
    *,
    clock: Clock | None = None,
    faults: Faults | None = None,
    seed: int = 0,
) -> SimulatedCamera:
    scene = Scene("flat", np.full((2, 3), LIGHT))
    return SimulatedCamera(
        scene, steady_sensor(delay, jitter), clock=clock, faults=faults, seed=seed
    )


def lines(*counts: int) -> list[ExposureSetting]:
    return [ExposureSetting(count * 2.0**-10) for count in counts]


def expected_dn(camera: SimulatedCamera, setting: ExposureSetting) -> int:
    electrons = LIGHT * camera.sensor.quantum_efficiency * setting.time_s
    return min(4095, int(electrons * setting.gain / camera.sensor.electrons_per_dn))


def check_exposure(camera: SimulatedCamera, frame: Frame) -> None:
    """Check by its pixels that a frame has the exposure `applied`; an old frame has another."""
    assert frame.applied == frame.requested
    assert abs(int(frame.pixels[0, 0]) - expected_dn(camera, frame.applied)) <= 1


class TestStandardConforms(CameraConformance):
    def open_camera(self) -> Camera:
        return SimulatedCamera(load_scene("ramp", (40, 60)), load_sensor("standard"), seed=3)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.02)


class TestPhoneConforms(TestStandardConforms):
    def open_camera(self) -> Camera:
        return SimulatedCamera(load_scene("ball", (40, 60)), load_sensor("phone"), seed=3)


class TestVaryingDelayConforms(TestStandardConforms):
    def open_camera(self) -> Camera:
        return SimulatedCamera(load_scene("ball", (40, 60)), load_sensor("consumer"), seed=3)

    def test_constant_delay_costs_n_plus_d_frames(self, camera: Camera) -> None:
        """The delay is not constant, and reported so; another test counts the frames."""
        assert camera.controls.delay_frames is None


@pytest.mark.serial
class TestRealTimeConforms(TestStandardConforms):
    interval_s = 0.02
    longest_s = 2.0  # longer ones are shot in virtual time, by the classes above

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


def test_camera_previews_and_streams() -> None:
    with open_steady() as camera:
        assert isinstance(camera, PreviewingCamera)
        assert isinstance(camera, StreamingCamera)


def test_camera_opens_again_with_a_new_stream() -> None:
    with open_steady() as camera:
        (first,) = camera.shoot(lines(10))
        camera.close()
        camera.close()
        with camera.open():
            assert camera.device.upcoming == 0
            (again,) = camera.shoot(lines(10))
    assert np.array_equal(first.pixels, again.pixels)


@pytest.mark.parametrize("name", sensor_names())
def test_every_sensor_makes_a_camera(name: str) -> None:
    with SimulatedCamera(load_scene("room", (20, 30)), load_sensor(name)) as camera:
        setting = ExposureSetting(camera.controls.time_s.nearest(0.01))
        (frame,) = camera.shoot([setting])
        assert frame.pixels.shape[:2] == (20, 30)


@given(st.integers(0, 5), st.lists(st.integers(1, 200), min_size=1, max_size=9))
def test_n_exposures_take_exactly_n_plus_d_slots(delay: int, counts: list[int]) -> None:
    with open_steady(delay) as camera:
        camera.preview(lines(20)[0])
        slots, start_s = camera.device.upcoming, camera.clock.now()
        frames = list(camera.shoot(lines(*counts)))
        assert camera.device.upcoming - slots == len(counts) + delay
        # The first d slots have the setting before, each other one its own exposure.
        needed = delay * INTERVAL_S + sum(max(INTERVAL_S, n * 2.0**-10) for n in counts)
        assert camera.clock.now() - start_s == needed
        assert frames[-1].timestamp_s == camera.clock.now()
        for frame in frames:
            check_exposure(camera, frame)
        assert camera.frames_lost == 0


@given(st.integers(0, 3), st.integers(1, 3), st.integers(1, 6), st.integers(0, 50))
def test_varying_delay_settles_for_each_exposure(
    delay: int, jitter: int, n: int, seed: int
) -> None:
    with open_steady(delay, jitter, seed=seed) as camera:
        assert camera.controls.delay_frames is None
        slots = camera.device.upcoming
        for frame in camera.shoot(lines(*range(10, 10 + n))):
            check_exposure(camera, frame)
        assert camera.device.upcoming - slots == n * (delay + jitter + 1)


def test_varying_delay_has_all_values_in_its_range() -> None:
    delays = set()
    with open_steady(1, 2) as camera:
        for count in range(10, 40):
            setting = lines(count)[0]
            upcoming, _ = camera.device.write(setting)
            while (buffer := camera.device.dequeue(1.0)) is not None:
                dn = int(camera.device.read_out(buffer)[0, 0])
                if abs(dn - expected_dn(camera, setting)) <= 1:
                    break
            assert buffer is not None
            delays.add(buffer.sequence - upcoming)
    assert delays == {1, 2, 3}


@pytest.mark.parametrize("seed", range(12))
def test_second_of_two_writes_in_one_slot_wins(seed: int) -> None:
    with open_steady(1, 3, seed=seed) as camera:
        (first, second) = lines(10, 30)
        camera.device.write(first)
        upcoming, _ = camera.device.write(second)
        for _ in range(12):
            buffer = camera.device.dequeue(1.0)
            assert buffer is not None
            dn = int(camera.device.read_out(buffer)[0, 0])
            if buffer.sequence >= upcoming + 1 + 3:
                assert abs(dn - expected_dn(camera, second)) <= 1


@st.composite
def calls(draw: st.DrawFn) -> tuple[str, list[int], list[float], int]:
    """A call, its exposures, the consumer's pauses after each frame, and when it cancels."""
    kind = draw(st.sampled_from(["shoot", "preview"]))
    counts = draw(st.lists(st.integers(1, 60), min_size=1, max_size=6))
    pauses = [draw(st.sampled_from([0.0, 0.0, 0.004, 0.03125, 0.1, 0.7])) for _ in counts]
    return kind, counts, pauses, draw(st.integers(1, len(counts)))


@given(
    st.integers(0, 4),
    st.sampled_from([0, 0, 2]),
    st.sampled_from([0.0, 1e-5, 1e-3]),
    st.lists(calls(), min_size=1, max_size=5),
)
@settings(max_examples=150)
def test_no_old_frame_whatever_the_caller_does(
    delay: int, jitter: int, step_s: float, calls: list[tuple[str, list[int], list[float], int]]
) -> None:
    """Pauses, previews and cancelled sequences, at any point of a slot."""
    with open_steady(delay, jitter, clock=BusyClock(step_s)) as camera:
        for kind, counts, pauses, stop in calls:
            if kind == "preview":
                check_exposure(camera, camera.preview(lines(counts[0])[0]))
                continue
            with closing(camera.shoot(lines(*counts))) as frames:
                ends_s = set()
                for index, (frame, pause_s) in enumerate(zip(frames, pauses, strict=True)):
                    check_exposure(camera, frame)
                    assert frame.requested == lines(counts[index])[0]
                    assert frame.index == index
                    # A setting whose frame was lost is shot again after those behind it.
                    assert frame.timestamp_s not in ends_s
                    ends_s.add(frame.timestamp_s)
                    if index + 1 == stop:
                        break
                    camera.clock.sleep_until(camera.clock.now() + pause_s)


def test_prompt_consumer_wastes_no_slot_if_it_starts_within_a_slot() -> None:
    """As in real time: the call begins within a slot, and each frame arrives a moment late."""
    with open_steady(3, clock=BusyClock(1e-5)) as camera:
        slots = camera.device.upcoming
        for frame in camera.shoot(lines(*range(10, 20))):
            check_exposure(camera, frame)
        # The slot that was being exposed at the call has to end first.
        assert camera.device.upcoming - slots <= 10 + 3 + 1


def test_late_consumer_loses_the_oldest_frames() -> None:
    with open_steady() as camera:
        camera.preview(lines(10)[0])
        camera.clock.sleep_until(camera.clock.now() + 20 * INTERVAL_S)
        first = camera.device.dequeue(1.0)
        assert first is not None
        assert camera.frames_lost == 20 - QUEUE
        assert first.sequence == 3 + 20 - QUEUE


def test_gain_and_time_are_set_together() -> None:
    bracket = [ExposureSetting(t * 2.0**-10, g) for t, g in ((9, 1.0), (9, 4.0), (30, 2.0))]
    with open_steady() as camera:
        for frame in camera.shoot(bracket):
            check_exposure(camera, frame)


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


def test_same_seed_gives_the_same_frames() -> None:
    def pictures(seed: int) -> list[np.ndarray]:
        scene = load_scene("ball", (30, 40))
        with SimulatedCamera(scene, load_sensor("webcam"), seed=seed) as camera:
            times = [camera.controls.time_s.nearest(t) for t in (0.01, 0.02)]
            return [f.pixels for f in camera.shoot([ExposureSetting(t) for t in times])]

    assert all(np.array_equal(a, b) for a, b in zip(pictures(4), pictures(4), strict=True))
    assert not np.array_equal(pictures(4)[0], pictures(5)[0])


def test_two_frames_with_one_setting_have_different_noise() -> None:
    with SimulatedCamera(load_scene("ramp", (30, 40)), load_sensor("phone")) as camera:
        setting = ExposureSetting(camera.controls.time_s.nearest(0.01))
        first, second = camera.shoot([setting, setting])
        assert not np.array_equal(first.pixels, second.pixels)


def works(camera: SimulatedCamera) -> bool:
    frames = list(camera.shoot(lines(15, 25)))
    for frame in frames:
        check_exposure(camera, frame)
    return len(frames) == 2


def test_one_sequence_at_a_time() -> None:
    with open_steady() as camera:
        frames = camera.shoot(lines(10, 20, 30))
        next(frames)
        with pytest.raises(CameraBusyError, match="finish or close"):
            camera.shoot(lines(10))
        with pytest.raises(CameraBusyError):
            camera.preview(lines(10)[0])
        frames.close()
        assert works(camera)


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
    camera.device.thaw()
    assert len(list(camera.shoot(lines(10, 20)))) == 2


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


@pytest.mark.serial
def test_sequence_in_real_time() -> None:
    clock = LatenessClock()
    with open_steady(1, clock=clock) as camera:
        start_s = clock.now()
        for frame in camera.shoot(lines(10, 20, 10)):
            check_exposure(camera, frame)
            assert frame.timestamp_s <= clock.now()
        assert clock.now() - start_s >= 4 * INTERVAL_S
        assert camera.frames_lost <= int(clock.late_s / INTERVAL_S)


@pytest.mark.parametrize("delay", range(6))
@pytest.mark.parametrize("step_s", [0.0, 0.001])
def test_after_a_step_frame_d_is_the_first_with_the_new_exposure(delay: int, step_s: float) -> None:
    clock = BusyClock(step_s) if step_s else VirtualClock()
    with open_steady(delay, clock=clock) as camera:
        assert isinstance(camera, StreamingCamera)
        short, long = lines(5, 20)
        for before, after in ((short, long), (long, short), (short, long)):
            frames = camera.step(before, after, 8)
            seen = [int(frame.pixels[0, 0]) for frame in frames]
            old, new = expected_dn(camera, before), expected_dn(camera, after)
            assert seen == pytest.approx([old] * delay + [new] * (8 - delay), abs=1)
            assert [frame.index for frame in frames] == list(range(8))
            assert {frame.applied for frame in frames} == {after}
            stamps = np.diff([frame.timestamp_s for frame in frames])
            assert stamps == pytest.approx(INTERVAL_S)
        assert works(camera)


@given(st.integers(0, 3), st.integers(0, 4), st.integers(0, 99))
@settings(max_examples=25)
def test_step_with_varying_delay_takes_effect_within_its_range(
    delay: int, jitter: int, seed: int
) -> None:
    with open_steady(delay, jitter, seed=seed) as camera:
        short, long = lines(5, 20)
        frames = camera.step(short, long, 10)
        has_it = [abs(int(f.pixels[0, 0]) - expected_dn(camera, long)) <= 1 for f in frames]
        first = has_it.index(True)
        assert delay <= first <= delay + jitter
        assert has_it == [False] * first + [True] * (10 - first)


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


def test_step_does_not_skip_a_lost_frame() -> None:
    short, long = lines(5, 20)
    late = BusyClock(3 * QUEUE * INTERVAL_S)
    with (
        open_steady(clock=late) as camera,
        pytest.raises(CameraProtocolError, match="frames are lost, damaged, or"),
    ):
        camera.step(short, long, 3)


def test_mode_states_format_size_and_rate() -> None:
    with open_steady() as camera:
        assert camera.mode == "mono12-3x2-32"
