"""picture.dng, opened by LibRaw and darktable."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from raw_photographs import NEUTRAL, mosaic, raw_file

import camctl
from camctl import CaptureReport, CaptureRequest, PhotographOptions, merge

TIMES = (1 / 64, 1 / 8, 1.0)


@pytest.fixture
def report(tmp_path: Path) -> CaptureReport:
    pytest.importorskip("rawpy", reason="rawpy is missing: pip install 'camctl[raw]'")
    colours = (
        np.random.default_rng(4).uniform(0.05, 1, (6, 8, 3)) * np.geomspace(0.1, 6, 8)[:, None]
    )
    scene = cv2.resize(colours, (256, 192), interpolation=cv2.INTER_NEAREST)
    files = []
    for time_s in TIMES:
        files.append(tmp_path / f"r{round(1 / time_s)}.dng")
        files[-1].write_bytes(raw_file(mosaic(scene, time_s), time_s))
    options = PhotographOptions(labels="exact")
    return merge(files, CaptureRequest("linear"), tmp_path / "out", options=options)


def test_libraw_opens_the_file_with_the_same_light(report: CaptureReport, tmp_path: Path) -> None:
    import rawpy

    path = tmp_path / "out" / report.files["raw"]
    samples = np.asarray(tifffile.imread(path), np.float64)
    with rawpy.imread(str(path)) as raw:
        found = raw.raw_image.astype(float)
        white, balance = raw.white_level, np.array(raw.camera_whitebalance[:3])
        assert raw.rgb_xyz_matrix[0, 0] == pytest.approx(0.4716, abs=1e-3)
        assert np.asarray(raw.raw_pattern).tolist() == [[0, 1], [3, 2]]
    assert balance == pytest.approx(1 / NEUTRAL, rel=1e-3)
    # LibRaw makes integers of 14 bits of the numbers.
    bright = samples > 100 / white
    ratio = found[bright] / samples[bright]
    assert np.percentile(np.abs(ratio / np.median(ratio) - 1), 95) < 0.01


@pytest.mark.slow
def test_darktable_develops_the_same_light(report: CaptureReport, tmp_path: Path) -> None:
    program = shutil.which("darktable-cli")
    if program is None:
        pytest.skip("darktable-cli is missing: apt-get install darktable")
    to = tmp_path / "developed.pfm"
    command = [program, str(tmp_path / "out" / report.files["raw"]), str(to)]
    command += ["--icc-type", "LIN_REC709", "--apply-custom-presets", "false", "--core"]
    command += ["--configdir", str(tmp_path / "darktable"), "--library", ":memory:"]
    command += ["--conf", "plugins/darkroom/workflow=none"]
    command += ["--conf", "plugins/darkroom/chromatic-adaptation=legacy"]
    subprocess.run(command, capture_output=True, check=True, timeout=250)
    developed = cv2.imread(str(to), cv2.IMREAD_UNCHANGED)
    assert developed is not None
    middles = np.s_[16::32, 16::32]
    ratio = np.asarray(developed)[..., ::-1][middles] / report.radiance()[middles]
    # Up to one factor of all colours, since darktable knows no irradiance.
    wrong = np.abs(ratio / np.median(ratio) - 1)
    assert np.median(wrong) < 0.005
    assert np.percentile(wrong, 90) < 0.01


def test_without_a_matrix_there_is_no_raw_file(report: CaptureReport, tmp_path: Path) -> None:
    options = PhotographOptions(labels="exact", colour="camera")
    files = sorted(tmp_path.glob("*.dng"))
    other = merge(files, CaptureRequest("linear"), tmp_path / "other", options=options)
    assert "raw" not in other.files
    assert not (tmp_path / "other" / "picture.dng").exists()


@pytest.mark.slow
def test_capture_of_a_camera_of_measured_colours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rawpy = pytest.importorskip("rawpy", reason="rawpy is missing: pip install 'camctl[raw]'")
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))
    options = {"scene": "colour-chart", "sensor": "phone", "size": "320x240"}
    request = CaptureRequest("linear", ratios=(1, 8))
    with camctl.open_camera("sim", options) as camera:
        assert "raw" not in camctl.capture(camera, request, tmp_path / "before").files
        camctl.calibrate.colour(camera).save()
    with camctl.open_camera("sim", options) as camera:
        report = camctl.capture(camera, request, tmp_path / "after")
    path = tmp_path / "after" / report.files["raw"]
    with rawpy.imread(str(path)) as raw:
        found = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            use_camera_wb=True,
            output_bps=16,
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
        )
    light, patches = report.radiance(), np.s_[30::60, 26::53]  # inside of each patch
    both = [cv2.blur(each.astype(np.float32), (9, 9))[patches] for each in (found, light)]
    inside = (both[0] > 500).all(axis=2) & (both[0] < 60_000).all(axis=2)
    assert inside.sum() >= 8
    ratio = both[0][inside] / both[1][inside]
    assert np.median(np.abs(ratio / np.median(ratio) - 1)) < 0.01
