"""The simulated camera: no stale frame, no wasted slot, and faults as hardware has them."""

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
    """Virtual time in which looking at the clock takes a little of it, as computing does."""

    def __init__(self, step_s: float) -> None:
        super().__init__()
        self._step_s = step_s

    def now(self) -> float:
        self.sleep_until(super().now() + self._step_s)
        return super().now()


def steady_sensor(delay: int = 2, jitter: int = 0) -> Sensor:
    """A noise-free 12-bit sensor: each millisecond more shows in the pixels of flat light."""
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


def check_truth(camera: SimulatedCamera, frame: Frame) -> None:
    """The pixels were exposed as `applied` says: a stale frame would show another brightness."""
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


class TestJitteringConsumerConforms(TestStandardConforms):
    def open_camera(self) -> Camera:
        return SimulatedCamera(load_scene("ball", (40, 60)), load_sensor("consumer"), seed=3)

    def test_constant_delay_costs_n_plus_d_frames(self, camera: Camera) -> None:
        """Its delay is not constant, and it says so; what settling costs is checked below."""
        assert camera.controls.delay_frames is None


class TestRealTimeConforms(TestStandardConforms):
    def open_camera(self) -> Camera:
        fast = load_sensor("machine-vision").model_copy(update={"frame_interval_s": 0.005})
        return SimulatedCamera(load_scene("ramp", (40, 60)), fast, clock=RealClock())

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.004)


def test_it_is_a_previewing_camera() -> None:
    with open_steady() as camera:
        assert isinstance(camera, PreviewingCamera)


@pytest.mark.parametrize("name", sensor_names())
def test_every_sensor_makes_a_camera(name: str) -> None:
    with SimulatedCamera(load_scene("room", (20, 30)), load_sensor(name)) as camera:
        setting = ExposureSetting(camera.controls.time_s.nearest(0.01))
        (frame,) = camera.shoot([setting])
        assert frame.pixels.shape[:2] == (20, 30)


@given(st.integers(0, 5), st.lists(st.integers(1, 200), min_size=1, max_size=9))
def test_n_exposures_cost_exactly_n_plus_d_slots(delay: int, counts: list[int]) -> None:
    with open_steady(delay) as camera:
        camera.preview(lines(20)[0])
        slots, start_s = camera.device.upcoming, camera.clock.now()
        frames = list(camera.shoot(lines(*counts)))
        assert camera.device.upcoming - slots == len(counts) + delay
        # Stale slots are as long as the setting before; each other one as its own exposure.
        needed = delay * INTERVAL_S + sum(max(INTERVAL_S, n * 2.0**-10) for n in counts)
        assert camera.clock.now() - start_s == needed
        assert frames[-1].timestamp_s == camera.clock.now()
        for frame in frames:
            check_truth(camera, frame)
        assert camera.frames_lost == 0


@given(st.integers(0, 3), st.integers(1, 3), st.integers(1, 6), st.integers(0, 50))
def test_a_jittering_delay_is_settled_for_each_exposure(
    delay: int, jitter: int, n: int, seed: int
) -> None:
    with open_steady(delay, jitter, seed=seed) as camera:
        assert camera.controls.delay_frames is None
        slots = camera.device.upcoming
        for frame in camera.shoot(lines(*range(10, 10 + n))):
            check_truth(camera, frame)
        assert camera.device.upcoming - slots == n * (delay + jitter + 1)


def test_the_delay_of_a_jittering_camera_does_jitter() -> None:
    landed = set()
    with open_steady(1, 2) as camera:
        for count in range(10, 40):
            setting = lines(count)[0]
            upcoming, _ = camera.device.write(setting)
            while (buffer := camera.device.dequeue(1.0)) is not None:
                dn = int(camera.device.read_out(buffer)[0, 0])
                if abs(dn - expected_dn(camera, setting)) <= 1:
                    break
            assert buffer is not None
            landed.add(buffer.sequence - upcoming)
    assert landed == {1, 2, 3}


@pytest.mark.parametrize("seed", range(12))
def test_of_two_writes_in_one_slot_the_later_one_stays(seed: int) -> None:
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
def errands(draw: st.DrawFn) -> tuple[str, list[int], list[float], int]:
    """A call, its exposures, the consumer's pauses after each frame, and where it gives up."""
    kind = draw(st.sampled_from(["shoot", "preview"]))
    counts = draw(st.lists(st.integers(1, 60), min_size=1, max_size=6))
    pauses = [draw(st.sampled_from([0.0, 0.0, 0.004, 0.03125, 0.1, 0.7])) for _ in counts]
    return kind, counts, pauses, draw(st.integers(1, len(counts)))


@given(
    st.integers(0, 4),
    st.sampled_from([0, 0, 2]),
    st.sampled_from([0.0, 1e-5, 1e-3]),
    st.lists(errands(), min_size=1, max_size=5),
)
@settings(max_examples=150)
def test_a_stale_frame_is_never_handed_over(
    delay: int, jitter: int, step_s: float, calls: list[tuple[str, list[int], list[float], int]]
) -> None:
    """Whatever pauses, previews and cancellations come between, wherever in a slot they fall."""
    with open_steady(delay, jitter, clock=BusyClock(step_s)) as camera:
        for kind, counts, pauses, stop in calls:
            if kind == "preview":
                check_truth(camera, camera.preview(lines(counts[0])[0]))
                continue
            with closing(camera.shoot(lines(*counts))) as frames:
                last_s = -1.0
                for index, (frame, pause_s) in enumerate(zip(frames, pauses, strict=True)):
                    check_truth(camera, frame)
                    assert frame.requested == lines(counts[index])[0]
                    assert frame.index == index
                    assert frame.timestamp_s > last_s
                    last_s = frame.timestamp_s
                    if index + 1 == stop:
                        break
                    camera.clock.sleep_until(camera.clock.now() + pause_s)


def test_a_consumer_that_keeps_up_wastes_no_slot_wherever_it_starts() -> None:
    """As in real time: a call begins within a slot, and each frame is a moment late."""
    with open_steady(3, clock=BusyClock(1e-5)) as camera:
        slots = camera.device.upcoming
        for frame in camera.shoot(lines(*range(10, 20))):
            check_truth(camera, frame)
        # The slot that was under way when the call came has to end first.
        assert camera.device.upcoming - slots <= 10 + 3 + 1


def test_a_late_consumer_loses_the_oldest_frames_and_is_told() -> None:
    with open_steady() as camera:
        camera.preview(lines(10)[0])
        camera.clock.sleep_until(camera.clock.now() + 20 * INTERVAL_S)
        first = camera.device.dequeue(1.0)
        assert first is not None
        assert camera.frames_lost == 20 - QUEUE
        assert first.sequence == 3 + 20 - QUEUE


def test_gain_is_set_with_time() -> None:
    bracket = [ExposureSetting(t * 2.0**-10, g) for t, g in ((9, 1.0), (9, 4.0), (30, 2.0))]
    with open_steady() as camera:
        for frame in camera.shoot(bracket):
            check_truth(camera, frame)


def test_the_device_clamps_silently_but_the_driver_refuses() -> None:
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


def test_same_seed_same_pictures() -> None:
    def pictures(seed: int) -> list[np.ndarray]:
        scene = load_scene("ball", (30, 40))
        with SimulatedCamera(scene, load_sensor("webcam"), seed=seed) as camera:
            times = [camera.controls.time_s.nearest(t) for t in (0.01, 0.02)]
            return [f.pixels for f in camera.shoot([ExposureSetting(t) for t in times])]

    assert all(np.array_equal(a, b) for a, b in zip(pictures(4), pictures(4), strict=True))
    assert not np.array_equal(pictures(4)[0], pictures(5)[0])


def test_two_frames_of_one_setting_have_different_noise() -> None:
    with SimulatedCamera(load_scene("ramp", (30, 40)), load_sensor("phone")) as camera:
        setting = ExposureSetting(camera.controls.time_s.nearest(0.01))
        first, second = camera.shoot([setting, setting])
        assert not np.array_equal(first.pixels, second.pixels)


def still_works(camera: SimulatedCamera) -> bool:
    frames = list(camera.shoot(lines(15, 25)))
    for frame in frames:
        check_truth(camera, frame)
    return len(frames) == 2


def test_only_one_shot_at_a_time() -> None:
    with open_steady() as camera:
        frames = camera.shoot(lines(10, 20, 30))
        next(frames)
        with pytest.raises(CameraBusyError, match="finish or close"):
            camera.shoot(lines(10))
        with pytest.raises(CameraBusyError):
            camera.preview(lines(10)[0])
        frames.close()
        assert still_works(camera)


def test_two_streams_that_wait_to_be_started_cannot_both_run() -> None:
    with open_steady() as camera:
        first, second = camera.shoot(lines(10, 20)), camera.shoot(lines(10, 20))
        next(first)
        with pytest.raises(CameraBusyError):
            next(second)
        assert len(list(first)) == 1
        assert still_works(camera)


def frames_until(camera: SimulatedCamera, kind: type[Exception], match: str) -> list[Frame]:
    got: list[Frame] = []
    frames = camera.shoot(lines(10, 20, 30, 40))

    def drain() -> None:
        for frame in frames:
            check_truth(camera, frame)
            got.append(frame)

    with pytest.raises(kind, match=match):
        drain()
    return got


@pytest.mark.parametrize("after", [0, 1, 3])
def test_unplugged(after: int) -> None:
    camera = open_steady(faults=Faults(unplug_after=after))
    assert len(frames_until(camera, CameraDisconnectedError, "unplugged; plug it in")) == after
    with pytest.raises(CameraDisconnectedError):
        list(camera.shoot(lines(10)))
    camera.close()


@pytest.mark.parametrize("after", [0, 2])
def test_frozen_is_told_after_silence_not_after_total_time(after: int) -> None:
    camera = open_steady(faults=Faults(freeze_after=after))
    frames_until(camera, CameraTimeoutError, "no frame .* for 5 s")
    silent_since = camera.clock.now() - SILENCE_S
    assert 0 <= silent_since <= 10 * INTERVAL_S
    camera.device.thaw()
    assert len(list(camera.shoot(lines(10, 20)))) == 2


def test_an_exposure_longer_than_the_time_out_is_no_silence() -> None:
    with open_steady() as camera:
        (frame,) = camera.shoot([ExposureSetting(camera.sensor.times.nearest(4 * SILENCE_S))])
        assert frame.timestamp_s > 4 * SILENCE_S


def test_busy_at_first() -> None:
    with open_steady(faults=Faults(busy_calls=2)) as camera:
        with pytest.raises(CameraBusyError):
            camera.shoot(lines(10))
        with pytest.raises(CameraBusyError):
            camera.preview(lines(10)[0])
        assert still_works(camera)


def test_a_wrong_exposure_shows_in_the_pixels_alone_and_once() -> None:
    with open_steady(faults=Faults(wrong_exposure={1: 0.5})) as camera:
        camera.preview(lines(10)[0])
        frames = [*camera.shoot(lines(20, 20)), *camera.shoot(lines(20, 20))]
        right = expected_dn(camera, frames[0].applied)
        assert [f.applied for f in frames] == [frames[0].applied] * 4
        seen = [int(f.pixels[0, 0]) for f in frames]
        assert seen == pytest.approx([right, right / 2, right, right], abs=1)


def test_a_closed_camera_hands_over_nothing() -> None:
    camera = open_steady()
    frames = camera.shoot(lines(10, 20))
    next(frames)
    camera.close()
    with pytest.raises(CameraDisconnectedError, match="closed"):
        next(frames)
    with pytest.raises(CameraDisconnectedError):
        camera.preview(lines(10)[0])
    camera.close()


def test_real_time_takes_its_time() -> None:
    clock = RealClock()
    with open_steady(1, clock=clock) as camera:
        start_s = clock.now()
        for frame in camera.shoot(lines(10, 20, 10)):
            check_truth(camera, frame)
            assert frame.timestamp_s <= clock.now()
        assert clock.now() - start_s >= 4 * INTERVAL_S
        assert camera.frames_lost == 0


@pytest.mark.parametrize("delay", range(6))
@pytest.mark.parametrize("step_s", [0.0, 0.001])
def test_after_a_step_frame_d_is_the_first_that_has_it(delay: int, step_s: float) -> None:
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
        assert still_works(camera)


@given(st.integers(0, 3), st.integers(0, 4), st.integers(0, 99))
@settings(max_examples=25)
def test_a_jittering_step_lands_within_its_jitter(delay: int, jitter: int, seed: int) -> None:
    with open_steady(delay, jitter, seed=seed) as camera:
        short, long = lines(5, 20)
        frames = camera.step(short, long, 10)
        has_it = [abs(int(f.pixels[0, 0]) - expected_dn(camera, long)) <= 1 for f in frames]
        landed = has_it.index(True)
        assert delay <= landed <= delay + jitter
        assert has_it == [False] * landed + [True] * (10 - landed)


def test_a_step_is_refused_and_fails_as_a_shot_does() -> None:
    with open_steady() as camera:
        with pytest.raises(RefusedSettingError):
            camera.step(lines(5)[0], ExposureSetting(1e9), 3)
        frames = camera.shoot(lines(5, 10))
        next(frames)
        with pytest.raises(CameraBusyError):
            camera.step(*lines(5, 20), 3)
    with pytest.raises(CameraDisconnectedError):
        camera.step(*lines(5, 20), 3)
    for faults, kind in (
        (Faults(unplug_after=0), CameraDisconnectedError),
        (Faults(freeze_after=0), CameraTimeoutError),
    ):
        with open_steady(faults=faults) as camera, pytest.raises(kind):
            camera.step(*lines(5, 20), 3)


def test_a_step_does_not_pass_over_a_lost_frame() -> None:
    late = BusyClock(3 * QUEUE * INTERVAL_S)
    with open_steady(clock=late) as camera, pytest.raises(CameraProtocolError, match="lost a"):
        camera.step(*lines(5, 20), 3)


def test_the_mode_names_format_size_and_rate() -> None:
    with open_steady() as camera:
        assert camera.mode == "mono12-3x2-32"
