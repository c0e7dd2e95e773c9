"""Which frame had which exposure: by timestamps, late controls and all that goes wrong."""

from contextlib import closing

import numpy as np
import pytest
from v4l2_model import PATH, Model, ticks_of

from camctl.calibration.delay import measure_delay
from camctl.camera import CameraInfo
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
from drivers.v4l2.camera import V4l2Camera

TICKS = (40, 10, 160, 20, 80, 40, 320, 11)


@pytest.fixture(autouse=True)
def profiles(monkeypatch, tmp_path):
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def know(frames, smallest=None, largest=None):
    """Write down the delay of the model's mode."""
    record = DelayRecord(
        frames=frames,
        smallest=frames if smallest is None else smallest,
        largest=frames if largest is None else largest,
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


def open_model(model):
    return V4l2Camera(
        PATH, kernel=model, opener=model.video, clock=model.clock, response="linear", fps=10
    )


def settings(ticks):
    return [ExposureSetting(each / 10_000) for each in ticks]


def shown(frames):
    return [ticks_of(frame.pixels) for frame in frames]


class TestConformance(CameraConformance):
    def open_camera(self):
        know(2)
        return open_model(Model())

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(0.02)


class TestConformanceUnknownDelay(CameraConformance):
    def open_camera(self):
        return open_model(Model())

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(0.02)


@pytest.mark.parametrize("lateness_s", [0.002, 0.03, 0.065, 0.095, 0.13])
@pytest.mark.parametrize("delay", range(6))
def test_n_exposures_cost_n_plus_d_frames(delay, lateness_s):
    know(delay)
    model = Model(delay=delay, lateness_s=lateness_s)
    with open_model(model) as camera:
        before = len(model.used)
        frames = list(camera.shoot(settings(TICKS)))
        assert shown(frames) == list(TICKS)
        # The one under way when the first setting was written is left out.
        used = [slot for slot in model.used[before:] if slot > model.written_in[0]]
        assert len(used) / (len(TICKS) + delay) == 1.0
        stamps = [frame.timestamp_s for frame in frames]
        assert np.diff(stamps) == pytest.approx(np.full(len(TICKS) - 1, 0.1))


def test_every_frame_says_what_was_read_back():
    know(2)
    with open_model(Model()) as camera:
        for frame, ticks in zip(camera.shoot(settings(TICKS)), TICKS, strict=True):
            assert frame.applied == ExposureSetting(ticks / 10_000)
            assert frame.requested == frame.applied


@pytest.mark.parametrize("delay", range(6))
@pytest.mark.parametrize("pause_s", [0.04, 0.09, 0.35, 1.0, 7.77])
def test_a_late_consumer_gets_no_stale_frame(delay, pause_s):
    know(delay)
    model = Model(delay=delay)
    with open_model(model) as camera:
        got = []
        for frame in camera.shoot(settings(TICKS)):
            got.append(ticks_of(frame.pixels))
            model.clock.sleep_until(model.clock.now() + pause_s)
        assert got == list(TICKS)


@pytest.mark.parametrize("pause_s", [0.05, 0.5, 60.0, 3600.03])
def test_what_waited_in_the_buffers_is_thrown_away(pause_s):
    know(2)
    model = Model()
    with open_model(model) as camera:
        list(camera.shoot(settings([40])))
        model.clock.sleep_until(model.clock.now() + pause_s)
        asked_s = model.clock.now()
        (frame,) = camera.shoot(settings([20]))
        assert ticks_of(frame.pixels) == 20
        assert frame.timestamp_s - frame.applied.time_s > asked_s


@pytest.mark.parametrize("first", range(4, 20))
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_lost_frame_is_shot_again(first, count):
    know(2)
    model = Model(lose=set(range(first, first + count)))
    with open_model(model) as camera:
        frames = list(camera.shoot(settings(TICKS)))
        assert shown(frames) == list(TICKS)
        assert [frame.index for frame in frames] == list(range(len(TICKS)))


def test_a_frame_that_nobody_needs_may_be_lost():
    """It costs the one slot in which no control could be written; nothing is shot again."""
    know(3)
    model = Model(delay=3)
    with open_model(model) as camera:
        model.lose = {model.slot + 2}  # on the way of the first setting
        began_s = model.clock.now()
        frames = list(camera.shoot(settings(TICKS)))
        assert shown(frames) == list(TICKS)
        slots = (frames[-1].timestamp_s - began_s) / 0.1
        assert slots <= len(TICKS) + 3 + 2


@pytest.mark.parametrize("slot", range(5, 16))
def test_a_spoilt_frame_is_shot_again(slot):
    know(2)
    with open_model(Model(spoil={slot})) as camera:
        assert shown(camera.shoot(settings(TICKS))) == list(TICKS)


def test_frames_that_never_come_whole_end_in_an_error():
    know(2)
    with open_model(Model(spoil=set(range(1000)))) as camera, pytest.raises(CameraProtocolError):
        list(camera.shoot(settings(TICKS)))


@pytest.mark.parametrize("seed", range(12))
def test_jittering_timestamps(seed):
    know(2)
    random = np.random.default_rng(seed)
    model = Model(jitter_s=lambda slot: float(random.uniform(0, 0.015)))
    with open_model(model) as camera:
        before = len(model.used)
        assert shown(camera.shoot(settings(TICKS))) == list(TICKS)
        assert len(model.used) - before <= len(TICKS) + 3


@pytest.mark.parametrize("seed", range(20))
def test_everything_at_once(seed):
    """Losses, jitter, spoilt frames and a consumer that comes when it likes: no frame is wrong."""
    random = np.random.default_rng(seed)
    delay = int(random.integers(0, 6))
    know(delay)
    model = Model(
        delay=delay,
        lateness_s=float(random.uniform(0, 0.12)),
        jitter_s=lambda slot: float(random.uniform(0, 0.01)),
        lose=set(random.integers(8, 90, 8).tolist()),
        spoil=set(random.integers(8, 90, 8).tolist()),
        write_s=float(random.uniform(0, 0.02)),
    )
    ticks = random.choice(TICKS, 25).tolist()
    with open_model(model) as camera:
        got = []
        for frame in camera.shoot(settings(ticks)):
            got.append(ticks_of(frame.pixels))
            if random.random() < 0.3:
                model.clock.sleep_until(model.clock.now() + float(random.exponential(0.2)))
        assert got == ticks


@pytest.mark.parametrize("seconds", [0.04, 0.09, 0.12, 0.2])
def test_slow_controls_are_not_taken_for_fast_ones(seconds):
    """A control transfer that ends in the next slot lands nobody knows where."""
    know(1)
    model = Model(delay=1, write_s=seconds)
    with open_model(model) as camera:
        assert shown(camera.shoot(settings(TICKS))) == list(TICKS)


def test_a_camera_that_is_slower_than_it_says():
    know(2)
    model = Model(announced_s=0.1, interval_s=0.2)
    with open_model(model) as camera:
        assert camera.controls.frame_interval_s == pytest.approx(0.2)
        assert any("announces 10" in note for note in camera.controls.notes)
        assert shown(camera.shoot(settings(TICKS))) == list(TICKS)


@pytest.mark.parametrize("interval_s", [0.05, 0.0667, 0.12, 0.2])
def test_any_other_rate_than_announced(interval_s):
    know(1)
    model = Model(delay=1, announced_s=0.1, interval_s=interval_s, lateness_s=0.001)
    with open_model(model) as camera:
        assert shown(camera.shoot(settings(TICKS))) == list(TICKS)
        assert camera.controls.time_s.maximum <= min(0.1, interval_s) + 1e-9
        assert camera.controls.frame_interval_s == pytest.approx(interval_s)


@pytest.mark.parametrize(
    "offsets_s", [(0.03, 0.015, 0, 0), (0.09, 0.07, 0.05, 0.03), (0.5, 0, 0, 0)]
)
def test_a_camera_that_stumbles_at_the_start(offsets_s):
    know(2)
    offsets_s = dict(enumerate(offsets_s, start=1))
    model = Model(jitter_s=lambda slot: offsets_s.get(slot, 0.0))
    with open_model(model) as camera:
        assert camera.controls.frame_interval_s == 0.1
        assert not any("announces" in note for note in camera.controls.notes)
        assert shown(camera.shoot(settings(TICKS))) == list(TICKS)


def test_two_lists_after_each_other_and_one_cut_short():
    know(3)
    with open_model(Model(delay=3)) as camera:
        with closing(camera.shoot(settings([160, 80, 40]))) as frames:
            assert ticks_of(next(frames).pixels) == 160
        assert shown(camera.shoot(settings([20, 40]))) == [20, 40]


class TestSettling:
    @pytest.mark.parametrize("delay", range(6))
    def test_without_a_measured_delay(self, delay):
        model = Model(delay=delay)
        with open_model(model) as camera:
            assert camera.controls.delay_frames is None
            assert any(
                f"camctl calibrate delay --camera v4l2:{PATH}" in note
                for note in camera.controls.notes
            )
            assert shown(camera.shoot(settings(TICKS))) == list(TICKS)

    @pytest.mark.parametrize("seed", range(5))
    def test_with_a_delay_that_is_not_constant(self, seed):
        know(None, 1, 3)
        random = np.random.default_rng(seed)
        model = Model(delays=lambda write: int(random.integers(1, 4)))
        with open_model(model) as camera:
            assert camera.controls.delay_frames is None
            assert any("not constant (1 to 3 frames)" in note for note in camera.controls.notes)
            got = []
            for frame in camera.shoot(settings(TICKS)):
                got.append(ticks_of(frame.pixels))
                model.clock.sleep_until(model.clock.now() + float(random.uniform(0, 0.5)))
            assert got == list(TICKS)

    def test_a_picture_that_never_rests(self):
        model = Model()
        with open_model(model) as camera:
            model._finish, finish = (lambda: (finish(), _flicker(model))), model._finish
            with pytest.raises(CameraProtocolError, match="come to rest"):
                list(camera.shoot(settings([100])))


def _flicker(model):
    if model.waiting and model.waiting[-1][0] % 2:
        slot, end_s, ticks = model.waiting.pop()
        model.waiting.append((slot, end_s, ticks // 2))


class TestStep:
    @pytest.mark.parametrize("delay", range(6))
    def test_frame_d_is_the_first_that_has_it(self, delay):
        with open_model(Model(delay=delay)) as camera:
            for _ in range(4):
                frames = camera.step(*settings([160, 40]), 8)
                assert shown(frames) == [160] * delay + [40] * (8 - delay)

    @pytest.mark.parametrize("delay", range(6))
    def test_the_delay_is_measured(self, delay):
        with open_model(Model(delay=delay)) as camera:
            record = measure_delay(camera)
            assert (record.frames, record.smallest, record.largest) == (delay, delay, delay)

    def test_a_missing_frame_is_not_counted_over(self):
        model = Model(lose={25, 45, 46})
        with open_model(model) as camera:
            for _ in range(4):
                assert shown(camera.step(*settings([160, 40]), 5)) == [160, 160, 40, 40, 40]


class TestFaults:
    @pytest.mark.parametrize("delay", [0, 2, 5])
    @pytest.mark.parametrize("place", range(8))
    def test_frames_before_a_refused_setting_are_handed_over(self, delay, place):
        know(delay)
        model = Model(delay=delay)
        ticks = [*TICKS[:place], 450, *TICKS[place:]]
        got = []
        with open_model(model) as camera:
            model.controls[ControlId.EXPOSURE_ABSOLUTE].clamp = 400
            with pytest.raises(RefusedSettingError) as caught:
                got.extend(ticks_of(frame.pixels) for frame in camera.shoot(settings(ticks)))
        assert got == list(TICKS[:place])
        assert caught.value.nearest == pytest.approx(0.04)

    def test_a_frozen_camera(self):
        know(2)
        model = Model()
        with open_model(model) as camera, closing(camera.shoot(settings(TICKS))) as frames:
            next(frames)
            model.frozen = True
            model.waiting.clear()
            began_s = model.clock.now()
            with pytest.raises(CameraTimeoutError, match=r"no frame from .* for 10 s"):
                list(frames)
            assert model.clock.now() - began_s < 12

    def test_an_unplugged_camera(self):
        know(2)
        model = Model()
        with open_model(model) as camera, closing(camera.shoot(settings(TICKS))) as frames:
            next(frames)
            model.unplugged = True
            with pytest.raises(CameraDisconnectedError, match="unplugged"):
                list(frames)

    def test_timestamps_of_another_clock(self):
        model = Model()
        model.stamp_s = lambda end_s: end_s + 1.7e9
        with pytest.raises(CameraProtocolError, match="monotonic"):
            open_model(model)
        assert model.descriptors == 0

    def test_timestamps_that_stand_still(self):
        model = Model()
        model.stamp_s = lambda end_s: 1000.5
        with pytest.raises(CameraProtocolError, match="irregular"):
            open_model(model)


class Hasty(VirtualClock):
    """Every look at it takes a while, as it does on a computer that is busy."""

    def now(self):
        self.sleep_until(super().now() + 0.007)
        return super().now()


def test_a_busy_computer():
    know(2)
    model = Model()
    model.clock = Hasty(1000.0)
    with open_model(model) as camera:
        for pause_s in np.arange(0, 0.1, 0.003):
            assert shown(camera.shoot(settings(TICKS[:3]))) == list(TICKS[:3])
            model.clock.sleep_until(model.clock.now() + float(pause_s))
