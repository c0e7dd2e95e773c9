"""Streams at another rate than announced, with an unknown or wrong control delay, or that fail."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from sampling import some
from v4l2_bench import TICKS, exposures, open_streaming, save_delay, settings
from v4l2_model import PATH, Model, ticks_of

from camctl.calibration.delay import measure_delay
from camctl.captures.sequencer import capture
from camctl.errors import (
    CameraDisconnectedError,
    CameraProtocolError,
)
from camctl.exposure.goal import CaptureRequest

pytestmark = pytest.mark.usefixtures("own_profiles")


def test_frame_rate_lower_than_announced_is_noted() -> None:
    save_delay(2)
    model = Model(announced_s=0.1, interval_s=0.2)
    with open_streaming(model) as camera:
        assert camera.controls.frame_interval_s == pytest.approx(0.2)
        note = "the camera announces 10 frames a second and sends 5"
        assert note in camera.controls.notes
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)


@pytest.mark.parametrize("interval_s", [0.05, 0.0667, 0.12, 0.2])
def test_frame_rate_other_than_announced(interval_s: float) -> None:
    save_delay(1)
    model = Model(delay=1, announced_s=0.1, interval_s=interval_s, lateness_s=0.001)
    with open_streaming(model) as camera:
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
    with open_streaming(model) as camera:
        assert camera.controls.frame_interval_s == 0.1
        assert not any("announces" in note for note in camera.controls.notes)
        assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)


class TestSettling:
    @pytest.mark.parametrize("delay", range(6))
    def test_without_a_measured_delay(self, delay: int) -> None:
        model = Model(delay=delay)
        with open_streaming(model) as camera:
            assert camera.controls.delay_frames is None
            remedies = [each.remedies for each in camera.controls.findings]
            assert {"calibrate_delay": f"v4l2:{PATH}"} in remedies
            assert exposures(camera.shoot(settings(TICKS))) == list(TICKS)

    @pytest.mark.parametrize("seed", range(5))
    def test_with_a_delay_that_is_not_constant(self, seed: int) -> None:
        save_delay(None, 1, 3)
        random = np.random.default_rng(seed)
        model = Model(delays=lambda write: int(random.integers(1, 4)))
        with open_streaming(model) as camera:
            assert camera.controls.delay_frames is None
            (varies,) = (e for e in camera.controls.findings if e.code == "delay_varies")
            assert (varies.details["smallest"], varies.value) == (1, 3)
            shown = []
            for frame in camera.shoot(settings(TICKS)):
                shown.append(ticks_of(frame.pixels))
                model.clock.sleep_until(model.clock.now() + float(random.uniform(0, 0.5)))
            assert shown == list(TICKS)

    def test_flickering_light_does_not_settle(self) -> None:
        model = Flickering()
        with (
            open_streaming(model) as camera,
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
    @pytest.mark.parametrize("delay", some(range(-1, 6), every=2))
    def test_the_delay_is_measured(self, delay: int) -> None:
        with open_streaming(Model(delay=delay)) as camera:
            record = measure_delay(camera)
            assert (record.frames, record.smallest, record.largest) == (delay, delay, delay)


class TestFaults:
    def test_camera_closed_during_a_sequence(self) -> None:
        save_delay(2)
        with open_streaming(Model()) as camera, closing(camera.shoot(settings(TICKS))) as frames:
            next(frames)
            camera.close()
            with pytest.raises(CameraDisconnectedError, match=f"{PATH} is not open"):
                next(frames)


@pytest.mark.parametrize("delay", [1, 3])
def test_stale_delay_is_settled_and_named(delay: int) -> None:
    save_delay(delay)
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 2.5, 9.0), base_s=0.004)
    with open_streaming(Model(delay=2)) as camera:
        report = capture(camera, request)
    assert report.trustworthy
    (settled,) = [finding for finding in report.findings if finding.code == "delay_settled"]
    assert settled.remedies == {"calibrate_delay": f"v4l2:{PATH}"}
    save_delay(2)
    with open_streaming(Model(delay=2)) as camera:
        assert capture(camera, request).trustworthy
