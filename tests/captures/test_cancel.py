"""A capture that is cancelled ends at once, aborts the exposure that runs, and loses no frame."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from ptp_bench import camera_on, settings_at

import camctl
from camctl.captures.sequence import Progress
from camctl.errors import InterruptedCaptureError
from camctl.interface import clock as clock_module
from camctl.interface.clock import RealClock, VirtualClock, cancelled_by, wait_for
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

EXPOSURE_S = 60.0
"""Exposure that a test would wait for if it were not aborted, s."""


def long_request(*ratios: float) -> camctl.CaptureRequest:
    return camctl.CaptureRequest("linear", ratios=ratios, base_s=EXPOSURE_S / ratios[-1])


def camera(faults: Faults | None = None, clock: camctl.Clock | None = None) -> SimulatedCamera:
    sensor = load_sensor("standard").model_copy(update={"time_maximum_s": 2 * EXPOSURE_S})
    return SimulatedCamera(
        load_scene("uniform", (16, 24)), sensor, faults=faults, clock=clock or RealClock()
    )


class After:
    """A cancel button that is pressed by `press`, as by another thread."""

    def __init__(self) -> None:
        self.pressed = threading.Event()

    def press(self, when: Callable[[Progress], bool]) -> Callable[[Progress], None]:
        return lambda progress: self.pressed.set() if when(progress) else None

    def __call__(self) -> bool:
        return self.pressed.is_set()


def test_the_running_exposure_is_aborted_and_frames_are_kept(tmp_path: Path) -> None:
    button, ratios = After(), (1.0, 600.0)
    with camera() as opened:
        with pytest.raises(InterruptedCaptureError, match="cancelled; 1 of 2 frames are kept"):
            camctl.capture(
                opened,
                long_request(*ratios),
                tmp_path / "out",
                progress=button.press(lambda each: each.stage == "shooting" and each.done == 1),
                cancelled=button,
            )
        # The next capture need not wait for the exposure that was aborted.
        camctl.capture(opened, camctl.CaptureRequest("linear", ratios=(1, 2), base_s=0.01))
        assert opened.clock.now() - opened.device._began_s < EXPOSURE_S


@pytest.mark.parametrize("stage", ["shooting", "writing"])
def test_a_complete_set_becomes_a_picture_whenever_it_is_cancelled(stage: str) -> None:
    button = After()
    with camera(clock=VirtualClock()) as opened:
        report = camctl.capture(
            opened,
            long_request(1.0, 8.0),
            progress=button.press(lambda each: each.stage == stage and each.share == 1.0),
            cancelled=button,
        )
    assert button()
    assert report.radiance().shape == (16, 24)
    assert np.count_nonzero(report.sum())


def test_a_cancelled_capture_shoots_no_suspect_again() -> None:
    button = After()
    request = camctl.CaptureRequest("linear", ratios=(1, 2), base_s=0.01)
    with camera(Faults(wrong_exposure={1: 0.5}), VirtualClock()) as opened:
        report = camctl.capture(
            opened, request, progress=button.press(lambda each: each.share == 1), cancelled=button
        )
        assert opened._frames_returned == 2
    assert not report.trustworthy


def test_metering_is_cancelled() -> None:
    with camera() as opened, pytest.raises(InterruptedCaptureError):
        camctl.capture(opened, camctl.CaptureRequest("linear", count=2), cancelled=lambda: True)


def test_a_timed_exposure_of_a_still_camera_is_aborted() -> None:
    with camera_on(vendor="nikon") as (opened, device):
        long, short = settings_at(opened, 30, 1 / 250)
        stream = opened.shoot([short, long])
        next(stream)  # the long exposure runs meanwhile
        began_s = device.clock.now()
        stream.close()
        frames = list(opened.shoot([short]))
        assert device.clock.now() - began_s < 5
        assert frames[0].applied.time_s == short.time_s
        assert frames[0].pixels.max() < 255  # the picture is not of the aborted exposure


@pytest.mark.parametrize("vendor", ["none", "nikon", "canon", "sony"])
def test_a_bulb_exposure_is_aborted(vendor: str) -> None:
    pressed: list[float] = []

    def cancelled() -> bool:
        return bool(pressed)

    with camera_on(vendor=vendor, bulb=True, options={"bulb": 60}) as (opened, device):
        sleep_until, began_s = device.clock.sleep_until, device.clock.now()

        def sleep(deadline_s: float) -> None:
            """Press the button when the wait for the end of the exposure begins."""
            if deadline_s - device.clock.now() > 30:
                pressed.append(deadline_s)
                clock_module.check_cancelled()
            sleep_until(deadline_s)

        opened.clock.sleep_until = sleep  # type: ignore[method-assign]
        (setting,) = settings_at(opened, 55)
        with cancelled_by(cancelled), pytest.raises(InterruptedCaptureError):
            list(opened.shoot([setting]))
        opened._sequence.finish_pending()
        assert device.clock.now() - began_s < 30
    assert pressed


def test_waits_for_something_else_than_a_clock_are_cancelled() -> None:
    waited: list[float] = []

    def wait(timeout_s: float) -> bool:
        waited.append(timeout_s)
        return len(waited) == 100

    assert not wait_for(wait, 10.0)
    assert waited == [10.0]
    with cancelled_by(lambda: len(waited) > 4), pytest.raises(InterruptedCaptureError):
        wait_for(wait, 10.0)
    assert len(waited) == 5
