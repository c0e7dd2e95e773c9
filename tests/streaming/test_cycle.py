"""Endless streams over a list of exposures: no frame of a wrong exposure, and none too few."""

from __future__ import annotations

from itertools import islice
from random import Random

import pytest
from cycle_stream import CycleStream, brightness

from camctl.errors import RefusedSettingError, UsageError
from camctl.interface.controls import ExposureSetting
from camctl.interface.cycle import CyclingCamera, FrameCycle
from camctl.sim.camera import SimulatedCamera
from camctl.sim.faults import Faults
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.streaming import ControlDelay, DelayOrigin, ExposureCycle, FrameStamp, Written

A, B, C = (ExposureSetting(time_s) for time_s in (1.0, 4.0, 12.0))


def constant(delay: int) -> ControlDelay:
    return ControlDelay(delay, delay, DelayOrigin.GUARANTEED)


@pytest.mark.parametrize("delay", [-1, 0, 1, 2, 5])
def test_each_frame_after_the_delay_is_one_of_the_cycle(delay: int) -> None:
    stream = CycleStream(delay)
    cycle = ExposureCycle(stream, constant(delay), None, [A, B, C])
    shots = [shot for shot, _ in islice(cycle.shots(), 30)]
    assert [shot.index for shot in shots] == [0, 1, 2] * 10
    assert [shot.data[1] for shot in shots] == [A, B, C] * 10
    assert stream.received == 30 + max(delay, 0)


def test_a_changed_list_follows_without_a_gap() -> None:
    stream = CycleStream(2)
    cycle = ExposureCycle(stream, constant(2), None, [A, B, C])
    shots = cycle.shots()
    before = [shot for shot, _ in islice(shots, 4)]
    number = cycle.exchange([B, A])
    after = [shot for shot, _ in islice(shots, 12)]
    assert number == 1
    found = [(shot.place.plan, shot.index) for shot in [*before, *after] if shot.place]
    first = found.index((1, 0))
    assert found[:first] == [(0, k % 3) for k in range(first)]
    assert first % 3 == 0
    assert found[first:] == [(1, k % 2) for k in range(16 - first)]
    assert [shot.data[0] for shot in after] == list(range(after[0].data[0], after[0].data[0] + 12))


@pytest.mark.parametrize("seed", range(6))
def test_no_frame_has_a_wrong_exposure(seed: int) -> None:
    random = Random(seed)
    delay = random.randint(-1, 4)
    stream = CycleStream(
        delay, random, lost=0.05, damaged=0.02, uncertain=0.01, missed=0.1, spanning=0.05
    )
    cycle = ExposureCycle(stream, constant(delay), None, [A, B, C])
    lists = {0: [A, B, C]}
    shots = cycle.shots()
    for k in range(2_000):
        if random.random() < 0.02:
            settings = random.sample([A, B, C], random.randint(1, 3))
            lists[cycle.exchange(settings)] = settings
        shot, requested = next(shots)
        assert shot.place is not None
        assert shot.data[1] == shot.applied == requested == lists[shot.place.plan][shot.index], k
    assert stream.received < 2 * 2_000


def test_a_delay_that_varies_settles_at_each_exposure() -> None:
    stream = CycleStream(1)
    delay = ControlDelay(0, 3, DelayOrigin.MEASURED)
    cycle = ExposureCycle(stream, delay, brightness, [A, B, C])
    shots = [shot for shot, _ in islice(cycle.shots(), 9)]
    assert [shot.data[1] for shot in shots] == [A, B, C] * 3
    assert stream.received > 9 * 2


class TwoDelays(CycleStream):
    """A shutter time takes effect after one frame, a gain after three."""

    def __init__(self) -> None:
        super().__init__(0)
        self._written = [(-10, A)]

    def next_frame(self) -> FrameStamp:
        time_s = [each.time_s for slot, each in self._written if slot + 1 <= self.slot][-1]
        gain = [each.gain for slot, each in self._written if slot + 3 <= self.slot][-1]
        self._past.append(ExposureSetting(time_s, gain))
        return super().next_frame()

    def write(self, setting: ExposureSetting) -> Written:
        self._written.append((self.slot, setting))
        return Written(setting, self.slot, self.slot)


@pytest.mark.parametrize("seed", range(2))
def test_no_frame_has_the_time_of_a_list_and_the_gain_of_the_one_before(seed: int) -> None:
    """In each list one control changes, whose delay is constant."""
    random = Random(seed)
    delay = ControlDelay(1, 3, DelayOrigin.MEASURED, time=(1, 1), gain=(3, 3))
    times = [ExposureSetting(time_s, 2.0) for time_s in (1.0, 2.0, 4.0)]
    gains = [ExposureSetting(3.0, gain) for gain in (1.0, 1.5, 4.0)]
    cycle = ExposureCycle(TwoDelays(), delay, brightness, times)
    shots, lists = cycle.shots(), {0: times}
    for _ in range(400):
        if random.random() < 0.05:
            settings = random.sample(random.choice([times, gains]), 2)
            lists[cycle.exchange(settings)] = settings
        shot, _ = next(shots)
        assert shot.place is not None
        assert shot.data[1] == shot.applied == lists[shot.place.plan][shot.index]
    assert len({each[0].gain for each in lists.values()}) > 1


def test_stated_exposures_are_used_once_the_pixels_agree() -> None:
    stream = CycleStream(2, Random(1), lost=0.1, missed=0.1, states=0)
    cycle = ExposureCycle(stream, ControlDelay.of(None), brightness, [A, B, C])
    shots = cycle.shots()
    for _ in range(20):
        next(shots)
    assert cycle.is_stated
    before = stream.received
    some = [shot for shot, _ in islice(shots, 300)]
    assert all(shot.data[1] == shot.applied == [A, B, C][shot.index] for shot in some)
    assert stream.received - before < 310


def test_stated_exposures_of_the_frame_before_are_not_used() -> None:
    stream = CycleStream(2, states=1)
    cycle = ExposureCycle(stream, constant(2), brightness, [A, B, C])
    shots = [shot for shot, _ in islice(cycle.shots(), 60)]
    assert not cycle.is_stated
    assert all(shot.data[1] == [A, B, C][shot.index] for shot in shots)


@pytest.mark.parametrize("before", [1, 2, 3])
def test_an_exposure_before_the_list_does_not_keep_the_others_from_being_used(before: int) -> None:
    stream = CycleStream(before, states=0)
    cycle = ExposureCycle(stream, ControlDelay.of(None), brightness, [B, C])  # it begins with A
    list(islice(cycle.shots(), 30))
    assert cycle.is_stated


def test_a_darker_frame_of_a_longer_stated_exposure_is_a_contradiction() -> None:
    """Two of three exposures saturate."""
    stream = CycleStream(2, states=1)
    settings = [A, ExposureSetting(20.0), ExposureSetting(40.0)]
    cycle = ExposureCycle(stream, constant(2), brightness, settings)
    shots = [shot for shot, _ in islice(cycle.shots(), 60)]
    assert not cycle.is_stated
    assert all(shot.data[1] == settings[shot.index] for shot in shots)


def test_saturated_frames_show_nothing() -> None:
    stream = CycleStream(-1, states=0)
    settings = [ExposureSetting(20.0), ExposureSetting(40.0)]
    cycle = ExposureCycle(stream, constant(-1), brightness, settings)
    list(islice(cycle.shots(), 40))
    assert not cycle.is_stated


@pytest.mark.parametrize(("late", "is_used"), [(0, True), (1, False)])
@pytest.mark.parametrize("is_unknown", [False, True])
def test_the_simulated_camera_states_its_exposures_or_those_of_other_frames(
    late: int, is_used: bool, is_unknown: bool
) -> None:
    """It applies settings a frame later than it says: what frames state is then the truth."""
    faults = Faults(stated_late=late, late_frames=is_used)
    scene = load_scene("ramp", (24, 32), usual=(24, 32))
    sensor = load_sensor("webcam")
    with SimulatedCamera(
        scene, sensor, faults=faults, states=True, is_unknown=is_unknown
    ) as camera:
        settings = [ExposureSetting(camera.controls.time_s.nearest(t)) for t in (1e-3, 4e-3, 16e-3)]
        cycle = camera.cycle(settings)
        list(islice(cycle, 24))
        before = camera.device.upcoming
        frames = list(islice(cycle, 30))
        taken = camera.device.upcoming - before
        cycle.close()
    assert cycle._cycle.is_stated == is_used
    if is_used or not is_unknown:
        assert taken <= 31
    means = [[f.pixels.mean() for f in frames if f.applied == each] for each in settings]
    assert all(means)
    assert max(means[0]) < min(means[1])
    assert max(means[1]) < min(means[2])


def simulated(faults: Faults) -> SimulatedCamera:
    scene = load_scene("ramp", (24, 32), usual=(24, 32))
    return SimulatedCamera(scene, load_sensor("webcam"), faults=faults)


def test_the_simulated_camera_repeats_a_list() -> None:
    with simulated(Faults(dropped_frames=[4])) as camera:
        assert isinstance(camera, CyclingCamera)
        settings = [ExposureSetting(camera.controls.time_s.nearest(t)) for t in (1e-3, 4e-3, 16e-3)]
        cycle: FrameCycle = camera.cycle(settings)
        frames = list(islice(cycle, 9))
        with pytest.raises(UsageError):
            cycle.exchange([])
        with pytest.raises(RefusedSettingError):
            cycle.exchange([ExposureSetting(1e3)])
        cycle.close()
        cycle.close()
        assert len(list(camera.shoot(settings[:1]))) == 1
    numbers = [frame.place.number for frame in frames if frame.place]
    lost = set(range(numbers[0], numbers[-1])) - set(numbers)
    assert len(lost) == 1
    # No setting was written in the slot of the lost frame: the one before it is repeated later.
    assert [frame.index for frame in frames] == [0, 1, 2, 0, 2, 0, 0, 1, 2]
    means = [[f.pixels.mean() for f in frames if f.index == k] for k in range(3)]
    assert max(means[0]) < min(means[1])
    assert max(means[1]) < min(means[2])
