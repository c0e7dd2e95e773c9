"""Each frame has the exposure that it states: late controls, lost frames and other irregularities.

All of it in virtual time, on a model of the kernel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from v4l2_model import PATH, Model, ticks_of

from camctl.calibration.delay import measure_delay
from camctl.camera import Camera, CameraInfo, Frame
from camctl.captures.request import CaptureRequest
from camctl.captures.sequencer import capture
from camctl.clock import VirtualClock
from camctl.controls import ExposureSetting
from camctl.errors import (
    CameraDisconnectedError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
)
from camctl.profile import DelayRecord, Profile, save_profile
from camctl.testing.conformance import CameraConformance
from drivers.v4l2.abi import ControlId
from drivers.v4l2.camera import V4l2Camera, V4l2Options

#: Exposures of a list of settings, x 100 us.
TICKS = (40, 10, 160, 20, 80, 40, 320, 11)


@pytest.fixture(autouse=True)
def profiles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def save_delay(frames: int | None, smallest: int = 0, largest: int = 0) -> None:
    """Store a measured delay in the profile of the model: `frames`, or the bounds without it."""
    record = DelayRecord(
        frames=frames,
        smallest=smallest if frames is None else frames,
        largest=largest if frames is None else frames,
        trials=12,
        measured_at="2026-01-01T00:00:00",
    )
    info = CameraInfo(f"v4l2:{PATH}", "uvcvideo", "A webcam", "", "v4l2")
    save_profile(
        Profile(
            driver=info.driver,
            make=info.make,
            model=info.model,
            serial=info.serial,
            delays={"yuyv-8x6-10": record},
        )
    )


def open_model(model: Model) -> V4l2Camera:
    options = V4l2Options(response="linear", fps=10)
    camera = V4l2Camera(PATH, options, kernel=model, clock=model.clock)
    return camera.open()


def settings(ticks: Iterable[int]) -> list[ExposureSetting]:
    return [ExposureSetting(each / 10_000) for each in ticks]


def exposures(frames: Iterable[Frame]) -> list[int]:
    """Return the exposures that the pixels show, x 100 us."""
    return [ticks_of(frame.pixels) for frame in frames]


class TestConformanceUnknownDelay(CameraConformance):
    def open_camera(self) -> Camera:
        self.model = Model()
        return open_model(self.model)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.02)

    def open_second(self, camera: Camera) -> Camera:
        return open_model(self.model)

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


@pytest.mark.parametrize("lateness_s", [0.002, 0.03, 0.065, 0.095, 0.13])
@pytest.mark.parametrize("delay", range(6))
def test_n_exposures_take_n_plus_d_frames(delay: int, lateness_s: float) -> None:
    save_delay(delay)
    model = Model(delay=delay, lateness_s=lateness_s)
    with open_model(model) as camera:
        before = len(model.used)
        frames = list(camera.shoot(settings(TICKS)))
        assert exposures(frames) == list(TICKS)
        # The frame that was being exposed when the first setting was written does not count.
        used = [slot for slot in model.used[before:] if slot > model.written_in[0]]
        assert len(used) == len(TICKS) + delay
        stamps = [frame.timestamp_s for frame in frames]
        assert np.diff(stamps) == pytest.approx(np.full(len(TICKS) - 1, 0.1))


def test_applied_setting_is_the_one_read_back() -> None:
    save_delay(2)
    with open_model(Model()) as camera:
        for frame, ticks in zip(camera.shoot(settings(TICKS)), TICKS, strict=True):
            assert frame.applied == ExposureSetting(ticks / 10_000)
            assert frame.requested == frame.applied


@pytest.mark.parametrize("delay", range(6))
@pytest.mark.parametrize("pause_s", [0.04, 0.09, 0.35, 1.0, 7.77])
def test_late_consumer_gets_no_old_frame(delay: int, pause_s: float) -> None:
    save_delay(delay)
    model = Model(delay=delay)
    with open_model(model) as camera:
        shown = []
        for frame in camera.shoot(settings(TICKS)):
            shown.append(ticks_of(frame.pixels))
            model.clock.sleep_until(model.clock.now() + pause_s)
        assert shown == list(TICKS)


@pytest.mark.parametrize("pause_s", [0.05, 0.5, 60.0, 3600.03])
def test_frames_waiting_in_buffers_are_discarded(pause_s: float) -> None:
    save_delay(2)
    model = Model()
    with open_model(model) as camera:
        list(camera.shoot(settings([40])))
        model.clock.sleep_until(model.clock.now() + pause_s)
        requested_s = model.clock.now()
        (frame,) = camera.shoot(settings([20]))
        assert ticks_of(frame.pixels) == 20
        assert frame.timestamp_s - frame.applied.time_s > requested_s


@pytest.mark.parametrize("first", range(4, 20))
@pytest.mark.parametrize("count", [1, 2, 3])
def test_lost_frames_are_taken_again(first: int, count: int) -> None:
    save_delay(2)
    model = Model(lose=set(range(first, first + count)))
    with open_model(model) as camera:
        frames = list(camera.shoot(settings(TICKS)))
        assert exposures(frames) == list(TICKS)
        assert [frame.index for frame in frames] == list(range(len(TICKS)))


def test_losing_an_unneeded_frame_costs_one_slot() -> None:
    """No setting can be written in the slot after a lost frame; nothing is taken again."""
    save_delay(3)
    model = Model(delay=3)
    with open_model(model) as camera:
        model.lose = {model.slot + 2}  # while the first setting is on its way
        began_s = model.clock.now()
        frames = list(camera.shoot(settings(TICKS)))
        assert exposures(frames) == list(TICKS)
        slots = (frames[-1].timestamp_s - began_s) / 0.1
        assert slots <= len(TICKS) + 3 + 2


@pytest.mark.parametrize("fault", ["flag", "damage", "lose", "skip"])
@pytest.mark.parametrize("delay", [0, 1, 2, 5])
@pytest.mark.parametrize("place", range(len(TICKS)))
def test_a_frame_that_cannot_be_used_costs_one_slot(fault: str, delay: int, place: int) -> None:
    """Flagged by the driver, too short, lost by the driver, or never sent by the camera.

    Its setting is written again, so near the end of the list the delay passes once more; the last
    setting stays in force, so that the next frame has it.  That a frame did not arrive is seen when
    the next one does, which costs a second slot.  After a frame that the camera did not send, the
    next one looks like one that is late by a whole slot: all settings on their way are written
    again.
    """
    save_delay(delay)
    model = Model(delay=delay)
    with open_model(model) as camera:
        frames = camera.shoot(settings(TICKS))
        model.advance()
        first = model.slot + 1 + delay
        getattr(model, fault).add(first + place)
        assert exposures(frames) == list(TICKS)
        slots = model.used[-1] - model.written_in[0]
    seen = 1 if fault in ("flag", "damage") else 2
    remaining = len(TICKS) - 1 - place
    # A frame arrives in the slot after its own, so a write then is in force delay + 2 slots later.
    expected = max(seen, delay + 1 + seen - remaining) if remaining else 1
    if fault == "skip":
        expected = delay + 3
    assert slots - len(TICKS) - delay == expected


def test_erroneous_frame_is_not_summed() -> None:
    """The driver flags it and delivers all its bytes, of another exposure."""

    class Mixed(Model):
        def packed(self, ticks: int) -> bytes:
            spoilt = self.used[-1] in self.flag
            return super().packed(ticks * (1 + spoilt))

    save_delay(2)
    with open_model(Mixed(flag=set(range(7, 30, 3)))) as camera:
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)


@pytest.mark.parametrize("counts", [True, False])
@pytest.mark.parametrize("seed", range(6))
def test_sequence_numbers_make_late_timestamps_certain(counts: bool, seed: int) -> None:
    """Timestamps that are late by up to 0.45 slots are ambiguous without sequence numbers."""
    save_delay(2)
    random = np.random.default_rng(seed)
    late = set(random.integers(6, 40, 6).tolist())
    model = Model(jitter_s=lambda slot: 0.045 * (slot in late), counts=counts)
    with open_model(model) as camera:
        before = len(model.used)
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)
        if counts:
            assert len(model.used) - before <= len(TICKS) + 3


def test_sequence_numbers_begin_again_at_zero() -> None:
    save_delay(2)
    model = Model()
    model.sequence = 2**32 - 9
    with open_model(model) as camera:
        before = len(model.used)
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)
        assert len(model.used) - before <= len(TICKS) + 3


def test_only_damaged_frames_are_an_error() -> None:
    save_delay(2)
    model = Model(damage=set(range(1000)))
    with (
        open_model(model) as camera,
        pytest.raises(CameraProtocolError, match="frames are lost, damaged, or"),
    ):
        list(camera.shoot(settings(TICKS)))


@pytest.mark.parametrize("seed", range(12))
def test_jitter_of_timestamps_costs_no_slots(seed: int) -> None:
    save_delay(2)
    random = np.random.default_rng(seed)
    model = Model(jitter_s=lambda slot: float(random.uniform(0, 0.015)))
    with open_model(model) as camera:
        before = len(model.used)
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)
        assert len(model.used) - before <= len(TICKS) + 3


@pytest.mark.parametrize("seed", range(20))
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
    with open_model(model) as camera:
        shown = []
        for frame in camera.shoot(settings(ticks)):
            shown.append(ticks_of(frame.pixels))
            if random.random() < 0.3:
                model.clock.sleep_until(model.clock.now() + float(random.exponential(0.2)))
        assert shown == ticks


@pytest.mark.parametrize("write_s", [0.04, 0.09, 0.12, 0.2])
def test_write_that_ends_in_the_next_slot(write_s: float) -> None:
    """It is not known in which slot such a write takes effect."""
    save_delay(1)
    model = Model(delay=1, write_s=write_s)
    with open_model(model) as camera:
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)


def test_frame_rate_lower_than_announced_is_noted() -> None:
    save_delay(2)
    model = Model(announced_s=0.1, interval_s=0.2)
    with open_model(model) as camera:
        assert camera.controls.frame_interval_s == pytest.approx(0.2)
        note = "the camera announces 10 frames a second and sends 5"
        assert note in camera.controls.notes
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)


@pytest.mark.parametrize("interval_s", [0.05, 0.0667, 0.12, 0.2])
def test_frame_rate_other_than_announced(interval_s: float) -> None:
    save_delay(1)
    model = Model(delay=1, announced_s=0.1, interval_s=interval_s, lateness_s=0.001)
    with open_model(model) as camera:
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)
        assert camera.controls.time_s.maximum <= min(0.1, interval_s) + 1e-9
        assert camera.controls.frame_interval_s == pytest.approx(interval_s)


@pytest.mark.parametrize(
    "offsets_s", [(0.03, 0.015, 0, 0), (0.09, 0.07, 0.05, 0.03), (0.5, 0, 0, 0)]
)
def test_irregular_first_frames_are_not_another_rate(offsets_s: tuple[float, ...]) -> None:
    save_delay(2)
    offset_s = dict(enumerate(offsets_s, start=1))
    model = Model(jitter_s=lambda slot: offset_s.get(slot, 0.0))
    with open_model(model) as camera:
        assert camera.controls.frame_interval_s == 0.1
        assert not any("announces" in note for note in camera.controls.notes)
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)


def test_second_list_after_a_cancelled_one() -> None:
    save_delay(3)
    with open_model(Model(delay=3)) as camera:
        with closing(camera.shoot(settings([160, 80, 40]))) as frames:
            assert ticks_of(next(frames).pixels) == 160
        assert exposures(camera.shoot(settings([20, 40]))) == [20, 40]


class TestSettling:
    @pytest.mark.parametrize("delay", range(6))
    def test_without_a_measured_delay(self, delay: int) -> None:
        model = Model(delay=delay)
        with open_model(model) as camera:
            assert camera.controls.delay_frames is None
            note = (
                "control delay not measured: the stream settles after each exposure; run camctl "
                f"calibrate delay --camera v4l2:{PATH}"
            )
            assert note in camera.controls.notes
            assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)

    @pytest.mark.parametrize("seed", range(5))
    def test_with_a_delay_that_is_not_constant(self, seed: int) -> None:
        save_delay(None, 1, 3)
        random = np.random.default_rng(seed)
        model = Model(delays=lambda write: int(random.integers(1, 4)))
        with open_model(model) as camera:
            assert camera.controls.delay_frames is None
            note = (
                "the control delay is not constant (1 to 3 frames): the stream settles after each "
                "exposure"
            )
            assert note in camera.controls.notes
            shown = []
            for frame in camera.shoot(settings(TICKS)):
                shown.append(ticks_of(frame.pixels))
                model.clock.sleep_until(model.clock.now() + float(random.uniform(0, 0.5)))
            assert shown == list(TICKS)

    def test_flickering_light_does_not_settle(self) -> None:
        model = Flickering()
        with (
            open_model(model) as camera,
            pytest.raises(CameraProtocolError, match="the brightness does not settle"),
        ):
            list(camera.shoot(settings([100])))


class Flickering(Model):
    """Every other frame has half the light."""

    def finish(self) -> None:
        super().finish()
        if self.waiting and self.waiting[-1].slot % 2:
            bright = self.waiting.pop()
            self.waiting.append(replace(bright, ticks=bright.ticks // 2))


class TestStep:
    @pytest.mark.parametrize("delay", range(6))
    def test_frame_d_is_the_first_with_the_new_exposure(self, delay: int) -> None:
        before, after = settings([160, 40])
        with open_model(Model(delay=delay)) as camera:
            for _ in range(4):
                frames = camera.step(before, after, 8)
                assert exposures(frames) == [160] * delay + [40] * (8 - delay)

    @pytest.mark.parametrize("delay", range(6))
    def test_the_delay_is_measured(self, delay: int) -> None:
        with open_model(Model(delay=delay)) as camera:
            record = measure_delay(camera)
            assert (record.frames, record.smallest, record.largest) == (delay, delay, delay)

    def test_a_step_with_a_lost_frame_is_repeated(self) -> None:
        before, after = settings([160, 40])
        with open_model(Model(lose={25, 45, 46})) as camera:
            for _ in range(4):
                assert exposures(camera.step(before, after, 5)) == [160, 160, 40, 40, 40]


class TestFaults:
    @pytest.mark.parametrize("delay", [0, 2, 5])
    @pytest.mark.parametrize("place", range(8))
    def test_frames_before_a_refused_setting_are_yielded(self, delay: int, place: int) -> None:
        save_delay(delay)
        model = Model(delay=delay)
        ticks = [*TICKS[:place], 450, *TICKS[place:]]
        shown: list[int] = []
        with open_model(model) as camera:
            model.controls[ControlId.EXPOSURE_ABSOLUTE].clamp = 400
            with pytest.raises(RefusedSettingError) as caught:
                shown.extend(ticks_of(frame.pixels) for frame in camera.shoot(settings(ticks)))
        assert shown == list(TICKS[:place])
        assert caught.value.nearest == pytest.approx(0.04)

    def test_frozen_camera_times_out(self) -> None:
        save_delay(2)
        model = Model()
        with open_model(model) as camera, closing(camera.shoot(settings(TICKS))) as frames:
            next(frames)
            model.frozen = True
            model.waiting.clear()
            began_s = model.clock.now()
            with pytest.raises(CameraTimeoutError, match=rf"no frame from {PATH} for 10 s"):
                list(frames)
            assert model.clock.now() - began_s < 12

    def test_unplugged_camera(self) -> None:
        save_delay(2)
        model = Model()
        with open_model(model) as camera, closing(camera.shoot(settings(TICKS))) as frames:
            next(frames)
            model.unplugged = True
            with pytest.raises(CameraDisconnectedError, match=f"{PATH} was unplugged"):
                list(frames)

    def test_camera_closed_during_a_sequence(self) -> None:
        save_delay(2)
        with open_model(Model()) as camera, closing(camera.shoot(settings(TICKS))) as frames:
            next(frames)
            camera.close()
            with pytest.raises(CameraDisconnectedError, match=f"{PATH} is not open"):
                next(frames)

    @pytest.mark.parametrize(
        ("stamp_s", "message"),
        [
            (lambda end_s: end_s + 1.7e9, "not on the system's monotonic clock"),
            (lambda end_s: 1000.5, "frames are lost, damaged, or arrive at irregular times"),
        ],
        ids=["another clock", "constant"],
    )
    def test_unusable_timestamps(self, stamp_s: Callable[[float], float], message: str) -> None:
        model = Model()
        model.stamp_s = stamp_s
        with pytest.raises(CameraProtocolError, match=message):
            open_model(model)
        assert model.descriptors == 0


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
    with open_model(model) as camera:
        for pause_s in pauses_s:
            assert exposures(camera.shoot(settings(TICKS[:3]))) == list(TICKS[:3])
            model.clock.sleep_until(model.clock.now() + pause_s)


@pytest.mark.parametrize("delay", [1, 3])
def test_stale_delay_makes_a_capture_untrustworthy(delay: int) -> None:
    save_delay(delay)
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 2.5, 9.0), base_s=0.004)
    with open_model(Model(delay=2)) as camera:
        report = capture(camera, request)
    assert not report.trustworthy
    assert f"calibrate delay --camera v4l2:{PATH}" in (report.untrustworthy_because or "")
    save_delay(2)
    with open_model(Model(delay=2)) as camera:
        assert capture(camera, request).trustworthy
