"""Pictures computed with estimated or calibrated exposures instead of the stated ones."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from small_cameras import small_camera

from camctl.calibration.exposures import measure_exposures
from camctl.captures.sequencer import capture
from camctl.exposure.goal import CaptureRequest
from camctl.profiles.calibrated import with_profile
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.profile import Profile, change_profile
from camctl.records.report import CaptureReport
from camctl.sim.camera import Faults

RATIOS = (1.0, 2.0, 4.0)


def light() -> NDArray[np.float32]:
    y, x = np.mgrid[0:240, 0:320] / 320
    return np.asarray(np.exp(np.sin(9 * x) + np.sin(7 * y + 2) - 1), np.float32)


def shoot(faults: Faults | None = None, *, estimate: bool = False) -> CaptureReport:
    request = CaptureRequest("log", 256.0, ratios=RATIOS, estimate_ratios=estimate, base_s=0.01)
    with small_camera("machine-vision", light(), faults=faults) as camera:
        return capture(with_profile(camera), request)


def error(report: CaptureReport, truth: CaptureReport) -> float:
    """Return the largest error of radiance between the dim and the bright parts."""
    good = (report.mask() == 0) & (truth.mask() == 0)
    ratio = (report.radiance()[good] / truth.radiance()[good]).astype(np.float64)
    order = np.argsort(truth.radiance()[good])
    means = [float(part.mean()) for part in np.array_split(ratio[order], 10)]
    return max(means) / min(means) - 1


def test_estimates_replace_wrong_exposures() -> None:
    # Frame 2 has 1.3 times its exposure whenever it is shot: alone, and where the camera settles.
    faults = Faults(wrong_exposure=dict.fromkeys((1, 3, 5), 1.3))
    truth = shoot()
    wrong, estimated = shoot(faults), shoot(faults, estimate=True)
    assert not wrong.trustworthy
    assert estimated.trustworthy
    middle = estimated.frames[1].exposure_ratio
    assert middle is not None
    assert middle.used == "estimate"
    assert middle.label == pytest.approx(2, rel=1e-3)
    assert middle.estimate == pytest.approx(2.6, rel=2e-3)
    assert middle.low is not None
    assert middle.high is not None
    assert middle.low < 2.6 < middle.high
    assert estimated.frames[1].exposure == middle.exposure == middle.estimate
    assert any("the exposure that the camera states" in line for line in estimated.warnings)
    assert error(estimated, truth) < 0.2 * error(wrong, truth)


def test_estimates_agree_with_true_exposures() -> None:
    report = shoot(estimate=True)
    assert report.warnings == shoot().warnings
    for frame in report.frames:
        ratio = frame.exposure_ratio
        assert ratio is not None
        assert ratio.used == "estimate"
        assert ratio.exposure == pytest.approx(ratio.label, rel=1.5e-3)


def test_labels_are_used_where_nothing_can_be_estimated() -> None:
    request = CaptureRequest("log", 256.0, ratios=RATIOS, estimate_ratios=True, base_s=0.01)
    with small_camera("standard", np.zeros((240, 320), np.float32) + 1e-6) as camera:
        report = capture(camera, request)
    assert [frame.exposure_ratio and frame.exposure_ratio.used for frame in report.frames] == [
        "label"
    ] * 3
    assert any("could not be estimated: the frames are black" in line for line in report.warnings)


@pytest.mark.slow
def test_calibrated_exposures_replace_the_labels(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", f"{tmp_path}/profiles")
    faults = Faults(shutter_offset_s=0.001)
    truth, stated = shoot(), shoot(faults)
    with small_camera("machine-vision", light(), faults=faults) as camera:
        record = measure_exposures(camera, longest_s=0.3)
        mode, info = exposure_mode(camera.controls), camera.info

    def keep(profile: Profile) -> None:
        profile.exposures[mode] = record

    change_profile(info, keep)
    calibrated = shoot(faults)
    times = [frame.applied_s + 0.001 for frame in calibrated.frames]
    exposures = [frame.exposure for frame in calibrated.frames]
    assert exposures == pytest.approx([time / times[0] for time in times], rel=2e-3)
    assert all(
        frame.exposure_ratio and frame.exposure_ratio.used == "profile"
        for frame in calibrated.frames
    )
    assert error(calibrated, truth) < 0.5 * error(stated, truth)
