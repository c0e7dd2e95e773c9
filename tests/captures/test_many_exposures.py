"""A capture of 64 exposures, the most that there are."""

from __future__ import annotations

import numpy as np

import camctl


def test_sum_of_64_exposures_is_the_sum_of_their_frames() -> None:
    ratios = tuple(1.12**k for k in range(64))
    with camctl.open_camera("sim", scene="ramp", size=(48, 32)) as camera:
        request = camctl.CaptureRequest(response="log", dynamic_range=1000.0, ratios=ratios)
        report = camctl.capture(camera, request)
        white = camera.controls.white
    frames = [np.minimum(report.frame(k), white).astype(np.int64) for k in range(64)]
    assert len({frame.applied for frame in report.frames}) == 64
    np.testing.assert_array_equal(report.sum(), sum(frames))


def test_64_exposures_are_planned() -> None:
    with camctl.open_camera("sim", scene="ramp", size=(48, 32)) as camera:
        request = camctl.CaptureRequest(response="log", dynamic_range=1000.0, count=64)
        assert len(camctl.plan_capture(camera, request).settings) == 64
