"""Timing of the frames of simulated cameras, whose times are known."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import pytest

import camctl
from camctl.calibration.timing import measure_still_timing, measure_stream_timing
from camctl.errors import CameraProtocolError
from camctl.interface.camera import Camera, Frame, StreamingCamera
from camctl.interface.controls import ExposureSetting
from camctl.profiles.profile import DelayRecord, FrameTiming
from camctl.streaming import ControlDelay


class OtherTimes:
    """A camera whose frames come at other times than those of the camera that it stands for."""

    def __init__(self, camera: Camera, times_s: Sequence[float], arrival_s: float) -> None:
        assert isinstance(camera, StreamingCamera)
        self._camera, self._times_s, self._arrival_s = camera, times_s, arrival_s
        self.controls, self.clock = camera.controls, camera.clock

    def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Frame]:
        found = self._camera.step(before, after, frames)
        return [
            replace(frame, timestamp_s=time_s)
            for frame, time_s in zip(found, self._times_s[:frames], strict=True)
        ]

    def shoot(self, settings: Sequence[ExposureSetting]) -> Iterator[Frame]:
        for frame in self._camera.shoot(settings):
            yield replace(frame, timestamp_s=self.clock.now() - self._arrival_s)


def measure(times_s: Sequence[float], arrival_s: float = 0.0) -> FrameTiming:
    with camctl.open_camera("sim", size="32x24") as camera:
        other = OtherTimes(camera, times_s, arrival_s)
        return measure_stream_timing(other)  # type: ignore[arg-type]  # what is measured is there


def test_regular_stream_has_its_interval_and_no_jitter() -> None:
    with camctl.open_camera("sim", size="32x24", sensor="machine-vision") as camera:
        assert isinstance(camera, StreamingCamera)
        timing = measure_stream_timing(camera)
    assert timing.frame_interval_s == pytest.approx(0.02)
    assert timing.jitter_s == pytest.approx(0, abs=1e-9)
    assert timing.lost == 0


def test_jitter_and_lost_frames_are_measured() -> None:
    random = np.random.default_rng(1)
    slots = np.delete(np.arange(40), [7, 21])[:32]
    times = slots * 0.04 + random.normal(0, 0.001, 32)
    timing = measure(times.tolist(), arrival_s=0.012)
    assert timing.frame_interval_s == pytest.approx(0.04, rel=0.02)
    assert timing.jitter_s == pytest.approx(0.001 * 2**0.5, rel=0.3)
    assert timing.lost == 2
    assert timing.readout_s == pytest.approx(0.012)


def test_interval_of_frames_of_which_each_third_comes_late() -> None:
    times = [0.04 * k + 0.006 * (k % 3) / 2 for k in range(32)]  # two steps of 43 ms, one of 34 ms
    timing = measure(times)
    assert timing.frame_interval_s == pytest.approx(0.04, rel=0.003)
    assert timing.lost == 0


def test_times_that_do_not_ascend_are_refused() -> None:
    with pytest.raises(CameraProtocolError, match="do not ascend"):
        measure([0.04 * (k % 5) for k in range(32)])


def test_measured_readout_counts_in_the_timing_of_a_stream() -> None:
    timing = FrameTiming(
        frame_interval_s=0.04, jitter_s=0.0, readout_s=0.015, download_s=0.0, lost=0
    )
    record = DelayRecord(
        frames=2, smallest=2, largest=2, trials=12, measured_at="2026-11-22", timing=timing
    )
    assert ControlDelay.from_record(record).timing(0.5).readout_s == 0.015
    bare = record.model_copy(update={"timing": None})
    assert ControlDelay.from_record(bare).timing(0.5).readout_s == 0


def test_still_camera_has_the_time_between_pictures() -> None:
    with camctl.open_camera("sim", size="32x24") as camera:
        timing = measure_still_timing(camera)
        interval_s = camera.controls.frame_interval_s
    assert timing.frame_interval_s == pytest.approx(interval_s - 1 / 60, abs=1e-3)
    assert timing.jitter_s == pytest.approx(0, abs=1e-9)
