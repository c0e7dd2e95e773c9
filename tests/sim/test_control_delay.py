"""The control delay of the simulated camera: no old frame, and no wasted slot."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from steady_camera import (
    INTERVAL_S,
    check_exposure,
    expected_dn,
    lines,
    open_steady,
    works,
)

from camctl.errors import (
    CameraProtocolError,
)
from camctl.interface.camera import Frame, StreamingCamera
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import Sensor, load_sensor
from camctl.sim.streaming_device import QUEUE


class BusyClock(VirtualClock):
    """Virtual time in which each look at the clock takes some time, as computing does."""

    def __init__(self, step_s: float) -> None:
        super().__init__()
        self._step_s = step_s

    def now(self) -> float:
        self.sleep_until(super().now() + self._step_s)
        return super().now()


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
        assert camera.device.lost == 0


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
@settings(max_examples=settings().max_examples * 3 // 2)
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
        assert camera.device.lost == 20 - QUEUE
        assert first.sequence == 3 + 20 - QUEUE


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


def test_step_does_not_skip_a_lost_frame() -> None:
    short, long = lines(5, 20)
    late = BusyClock(3 * QUEUE * INTERVAL_S)
    with (
        open_steady(clock=late) as camera,
        pytest.raises(CameraProtocolError, match="frames are lost, damaged, or"),
    ):
        camera.step(short, long, 3)


@pytest.mark.parametrize(("time", "gain"), [(-1, 2), (0, -1), (0, 5), (2, 0), (3, 3), (5, 2)])
def test_what_was_set_before_a_list_is_not_taken_for_its_own(time: int, gain: int) -> None:
    """A list changes one control alone while the other, which is later, is still on its way."""
    changes = {"delay_frames": time, "gain_delay_frames": gain, "gain_maximum": 8.0}
    model = Sensor.model_validate({**load_sensor("ideal-12").model_dump(), **changes})
    with SimulatedCamera(load_scene("tile-floor", (30, 40)), model) as camera:

        def setting(time_s: float, gain: float) -> ExposureSetting:
            return ExposureSetting(camera.controls.time_s.nearest(time_s), gain)

        def shoot(*settings: ExposureSetting) -> list[Frame]:
            return list(camera.shoot(settings))

        def check(frames: list[Frame]) -> None:
            light = [float(frame.pixels.mean()) / frame.applied.exposure for frame in frames]
            assert light == pytest.approx([light[0]] * len(light), rel=0.05)

        rest = setting(camera.controls.frame_interval_s / 2, 1)
        frames = shoot(setting(0.002, 4), setting(0.002, 1), setting(0.1, 1))[:2]
        frames += shoot(rest, replace(rest, gain=2.0))[1:]  # after a long one it rests
        with closing(camera.shoot([setting(0.002, 1), setting(0.002, 4)])) as cancelled:
            next(cancelled)
        frames += shoot(setting(0.002, 1), setting(0.004, 1))
        cycle = camera.cycle([setting(0.002, 4), setting(0.004, 4)])
        frames += islice(cycle, 8)
        cycle.exchange([setting(0.004, 2), setting(0.002, 2)])
        frames += islice(cycle, 8)
        cycle.close()
        check(frames)
