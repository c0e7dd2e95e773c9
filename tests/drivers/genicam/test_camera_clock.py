"""Times of frames by a camera's own time stamps."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest
from gige_bench import installed, opened, settings, virtual_camera

from camctl.drivers.genicam.slots import CameraClock

INTERVAL_S = 1 / 15
#: What a busy computer adds to reception, s, at random.
BUSY_S = 0.03


def arrivals(stamps_s: Sequence[float], received_s: Sequence[float]) -> list[float]:
    clock = CameraClock()
    return [clock.arrival(*each) for each in zip(stamps_s, received_s, strict=True)]


def stream(frames: int) -> tuple[list[float], list[float]]:
    """Return when frames were sent, and when a busy computer received them."""
    sent = [100 + INTERVAL_S * k for k in range(frames)]
    late = np.random.default_rng(3).exponential(BUSY_S / 3, frames).clip(0, BUSY_S)
    return sent, [time_s + float(more) for time_s, more in zip(sent, late, strict=True)]


def test_times_are_as_regular_as_the_camera_while_the_computer_is_busy() -> None:
    sent, received = stream(200)
    found = arrivals([time_s - 77 for time_s in sent], received)
    gaps = [after - before for before, after in pairwise(found[20:])]
    assert gaps == pytest.approx([INTERVAL_S] * len(gaps), abs=1e-3)
    assert np.ptp(np.diff(received)) > 0.02


@pytest.mark.parametrize("rate", [1 - 1e-4, 1 + 1e-4])
def test_clocks_may_drift_apart_for_hours(rate: float) -> None:
    sent, received = stream(100_000)
    found = arrivals([time_s * rate for time_s in sent], received)
    late = np.subtract(found, sent)[1000:]
    assert late.min() > -1e-6
    assert late.max() < 0.005


@pytest.mark.parametrize("unit", [1e-3, 0.125, 8.0, 1e3])
def test_clock_with_another_unit_than_it_states_is_not_used(unit: float) -> None:
    sent, received = stream(50)
    assert arrivals([time_s * unit for time_s in sent], received) == pytest.approx(received)


@pytest.mark.parametrize("jump_s", [-1e9, -90.0, -2.0, 0.5, 1e9])
def test_clock_that_is_set_meanwhile_is_compared_anew(jump_s: float) -> None:
    sent, received = stream(200)
    stamps = [time_s + 2e9 + (jump_s if k >= 100 else 0.0) for k, time_s in enumerate(sent)]
    late = np.subtract(arrivals(stamps, received), sent)
    assert np.abs(late).max() <= BUSY_S
    assert late[150:].max() < 0.005


def test_frame_without_a_time_stamp_has_the_time_of_its_reception() -> None:
    sent, received = stream(20)
    found = arrivals([0.0 if k == 10 else time_s for k, time_s in enumerate(sent)], received)
    assert found[10] == received[10]
    assert arrivals([0.0] * 20, received) == received
    assert arrivals([5.0] * 20, received) == received  # the same in every frame


@pytest.mark.serial
@pytest.mark.parametrize("library", ["aravis", "viva"])
@pytest.mark.parametrize("ticks_per_s", [1_000_000_000, 125_000_000])
def test_frames_of_a_free_run_have_the_camera_s_times(library: str, ticks_per_s: int) -> None:
    with (
        virtual_camera(ticks_per_s=ticks_per_s) as device,
        opened(device, installed(library), trigger="off", fps="15") as camera,
    ):
        wanted = settings(camera, 0.004, 0.001, 0.002, 0.004, 0.003, 0.002)
        frames = list(camera.shoot(wanted))
        ended = {each["block"]: each["ended_s"] for each in device.do("log")["frames"]}
        late = [frame.timestamp_s - ended[frame.details["frame_id"]] for frame in frames]
        assert np.ptp(late) < 0.001
