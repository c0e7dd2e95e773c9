"""Each frame has the exposure that it states: late controls, lost frames and other irregularities.

All of it in virtual time, on a model of the kernel.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np
import pytest
from sampling import some
from v4l2_bench import TICKS, exposures, open_streaming, save_delay, settings
from v4l2_model import Model, ticks_of

from camctl.interface.camera import Camera
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import ExposureSetting
from camctl.testing.conformance import CameraConformance

pytestmark = pytest.mark.usefixtures("own_profiles")


class TestConformanceUnknownDelay(CameraConformance):
    def open_camera(self) -> Camera:
        self.model = Model()
        return open_streaming(self.model)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.02)

    def open_second(self, camera: Camera) -> Camera:
        return open_streaming(self.model)

    def unplug(self, camera: Camera) -> None:
        self.model.unplugged = True

    def silence(self, camera: Camera) -> None:
        self.model.frozen = True
        self.model.waiting.clear()

    def in_force(self, camera: Camera) -> ExposureSetting:
        return ExposureSetting(self.model.ticks / 10_000)


class TestConformance(TestConformanceUnknownDelay):
    def open_camera(self) -> Camera:
        save_delay(2)
        return super().open_camera()


@pytest.mark.parametrize("delay", range(-1, 6))
def test_n_exposures_take_n_plus_d_frames(delay: int) -> None:
    save_delay(delay)
    for lateness_s in (0.002, 0.03, 0.065, 0.095, 0.13):
        model = Model(delay=delay, lateness_s=lateness_s)
        with open_streaming(model) as camera:
            before = len(model.used)
            frames = list(camera.shoot(settings(TICKS)))
            assert exposures(frames) == list(TICKS), lateness_s
            # The frame that was being exposed when the first setting was written does not count.
            used = [slot for slot in model.used[before:] if slot > model.written_in[0]]
            assert len(used) == len(TICKS) + delay, lateness_s
            stamps = [frame.timestamp_s for frame in frames]
            assert np.diff(stamps) == pytest.approx(np.full(len(TICKS) - 1, 0.1)), lateness_s


@pytest.mark.parametrize("delay", range(-1, 6))
def test_late_consumer_gets_no_old_frame(delay: int) -> None:
    save_delay(delay)
    for pause_s in (0.04, 0.09, 0.35, 1.0, 7.77):
        model = Model(delay=delay)
        with open_streaming(model) as camera:
            shown = []
            for frame in camera.shoot(settings(TICKS)):
                shown.append(ticks_of(frame.pixels))
                model.clock.sleep_until(model.clock.now() + pause_s)
            assert shown == list(TICKS), pause_s


@pytest.mark.parametrize("pause_s", [0.05, 0.5, 60.0, 3600.03])
def test_frames_waiting_in_buffers_are_discarded(pause_s: float) -> None:
    save_delay(2)
    model = Model()
    with open_streaming(model) as camera:
        list(camera.shoot(settings([40])))
        model.clock.sleep_until(model.clock.now() + pause_s)
        requested_s = model.clock.now()
        (frame,) = camera.shoot(settings([20]))
        assert ticks_of(frame.pixels) == 20
        assert frame.timestamp_s - frame.applied.time_s > requested_s


@pytest.mark.parametrize("count", some([1, 2, 3], every=3))
def test_lost_frames_are_taken_again(count: int) -> None:
    save_delay(2)
    for first in range(4, 20):
        model = Model(lose=set(range(first, first + count)))
        with open_streaming(model) as camera:
            frames = list(camera.shoot(settings(TICKS)))
            assert exposures(frames) == list(TICKS), first
            assert [frame.index for frame in frames] == list(range(len(TICKS))), first


def test_losing_an_unneeded_frame_costs_one_slot() -> None:
    """No setting can be written in the slot after a lost frame; nothing is taken again."""
    save_delay(3)
    model = Model(delay=3)
    with open_streaming(model) as camera:
        model.lose = {model.slot + 2}  # while the first setting is on its way
        began_s = model.clock.now()
        frames = list(camera.shoot(settings(TICKS)))
        assert exposures(frames) == list(TICKS)
        slots = (frames[-1].timestamp_s - began_s) / 0.1
        assert slots <= len(TICKS) + 3 + 2


@pytest.mark.parametrize(
    ("fault", "delay"), some(product(("flag", "damage", "lose", "skip"), (0, 1, 2, 5)), every=5)
)
def test_a_frame_that_cannot_be_used_costs_one_slot(fault: str, delay: int) -> None:
    """Flagged by the driver, too short, lost by the driver, or never sent by the camera.

    Its setting is written again, so near the end of the list the delay passes once more; the last
    setting stays in force, so that the next frame has it.  That a frame did not arrive is seen when
    the next one does, which costs a second slot.  After a frame that the camera did not send, the
    next one looks like one that is late by a whole slot: all settings on their way are written
    again.
    """
    save_delay(delay)
    for place in range(len(TICKS)):
        model = Model(delay=delay)
        with open_streaming(model) as camera:
            frames = camera.shoot(settings(TICKS))
            model.advance()
            first = model.slot + 1 + delay
            getattr(model, fault).add(first + place)
            assert exposures(frames) == list(TICKS), place
            slots = model.used[-1] - model.written_in[0]
        seen = 1 if fault in ("flag", "damage") else 2
        remaining = len(TICKS) - 1 - place
        # A frame arrives in the slot after its own: a write then is in force delay + 2 slots later.
        expected = max(seen, delay + 1 + seen - remaining) if remaining else 1
        if fault == "skip":
            expected = delay + 3
        assert slots - len(TICKS) - delay == expected, place


def test_erroneous_frame_is_not_summed() -> None:
    """The driver flags it and delivers all its bytes, of another exposure."""

    class Mixed(Model):
        def packed(self, ticks: int) -> bytes:
            spoilt = self.used[-1] in self.flag
            return super().packed(ticks * (1 + spoilt))

    save_delay(2)
    with open_streaming(Mixed(flag=set(range(7, 30, 3)))) as camera:
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)


@pytest.mark.parametrize("counts", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_sequence_numbers_make_late_timestamps_certain(counts: bool, seed: int) -> None:
    """Timestamps that are late by up to 0.45 slots are ambiguous without sequence numbers."""
    save_delay(2)
    random = np.random.default_rng(seed)
    late = set(random.integers(6, 40, 6).tolist())
    model = Model(jitter_s=lambda slot: 0.045 * (slot in late), counts=counts)
    with open_streaming(model) as camera:
        before = len(model.used)
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)
        if counts:
            assert len(model.used) - before <= len(TICKS) + 3


def test_sequence_numbers_begin_again_at_zero() -> None:
    save_delay(2)
    model = Model()
    model.sequence = 2**32 - 9
    with open_streaming(model) as camera:
        before = len(model.used)
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)
        assert len(model.used) - before <= len(TICKS) + 3


@pytest.mark.parametrize("seed", some(range(20), every=2))
def test_no_wrong_frame_with_all_irregularities_together(seed: int) -> None:
    """Lost and damaged frames, jitter, slow controls, and a consumer that pauses at random."""
    random = np.random.default_rng(seed)
    delay = int(random.integers(0, 6))
    save_delay(delay)
    model = Model(
        delay=delay,
        lateness_s=float(random.uniform(0, 0.12)),
        jitter_s=lambda slot: float(random.uniform(0, 0.01)),
        lose=set(random.integers(8, 90, 8).tolist()),
        damage=set(random.integers(8, 90, 8).tolist()),
        write_s=float(random.uniform(0, 0.02)),
    )
    ticks: list[int] = random.choice(TICKS, 25).tolist()
    with open_streaming(model) as camera:
        shown = []
        for frame in camera.shoot(settings(ticks)):
            shown.append(ticks_of(frame.pixels))
            if random.random() < 0.3:
                model.clock.sleep_until(model.clock.now() + float(random.exponential(0.2)))
        assert shown == ticks


class SlowClock(VirtualClock):
    """Every look at it takes 7 ms, as on a busy computer."""

    def now(self) -> float:
        self.sleep_until(super().now() + 0.007)
        return super().now()


def test_busy_computer() -> None:
    save_delay(2)
    model = Model()
    model.clock = SlowClock(1000.0)
    pauses_s: Sequence[float] = np.arange(0, 0.1, 0.003).tolist()
    with open_streaming(model) as camera:
        for pause_s in pauses_s:
            assert exposures(camera.shoot(settings(TICKS[:3]))) == list(TICKS[:3])
            model.clock.sleep_until(model.clock.now() + pause_s)
