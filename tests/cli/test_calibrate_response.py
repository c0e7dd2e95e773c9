"""`camctl calibrate response` from a camera, from files, and from the folder of a capture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import Run
from numpy.typing import NDArray

from camctl.model.response.camera import srgb_to_linear
from camctl.model.response.measured import read_curve
from camctl.profiles.folder import list_profiles
from camctl.sim.scenes.drawings import colour_chart

TIMES = (1 / 64, 1 / 16, 1 / 4)


def pictures(bits: int = 8) -> list[NDArray[Any]]:
    """Return frames of sRGB response of a scene with shades over three decades."""
    rng = np.random.default_rng(2)
    E = np.geomspace(1e-3, 1, 160) * np.ones((120, 1)) * rng.uniform(0.9, 1.1, (120, 160))
    top = 2**bits - 1
    levels = np.append(srgb_to_linear(np.arange(1, top + 1) / (top + 1)), np.inf)
    kind = np.uint8 if bits == 8 else np.uint16
    return [
        np.searchsorted(levels, E * time_s * 64, side="right").clip(0, top).astype(kind)
        for time_s in TIMES
    ]


def write(frames: list[NDArray[Any]]) -> list[Path]:
    paths = [Path(f"frame-{k}.png") for k in range(len(frames))]
    for path, frame in zip(paths, frames, strict=True):
        assert cv2.imwrite(str(path), frame)
    return paths


def test_a_camera_is_measured_and_the_result_is_kept(run: Run) -> None:
    ran = run("calibrate", "response", "--sensor", "consumer", "-O", "size=160x120", "--json")
    assert ran.status == 0, ran.err
    assert [each["name"] for each in ran.json["channels"]] == ["R", "G", "B"]
    for channel in ran.json["channels"]:
        E, B = np.array(channel["irradiance"]), np.array(channel["brightness"])
        assert (E[0], B[0], E[-1], B[-1]) == (0, 0, 1, 1)
        assert np.all(np.diff(E) > 0)
        assert np.all(np.diff(B) > 0)
        assert np.abs(np.interp(srgb_to_linear(B), E, B) - B).max() < 0.02
        assert len(channel["confidence"]) == E.size
    (profile,) = list_profiles()
    kept = profile.responses["rgb-160x120-255"].model_dump(mode="json")["channels"]
    assert [each["irradiance"] for each in kept] == [
        each["irradiance"] for each in ran.json["channels"]
    ]
    shown = run("profile", "show", profile.name)
    assert "response in rgb-160x120-255  channels R, G, B; black 0, white 255" in shown.out


def test_files_are_measured_and_the_curve_is_written(run: Run) -> None:
    paths = write(pictures())
    ran = run("calibrate", "response", *paths, "--times", "1/64,1/16,1/4", "-o", "curve.txt")
    assert ran.status == 0, ran.err
    assert "clips there" in ran.out
    levels = read_curve("curve.txt").levels
    expected = srgb_to_linear(np.arange(1, 256) / 256)
    ratio = levels[20:] / expected[20:]
    assert ratio.max() / ratio.min() < 1.03
    assert list_profiles() == []
    used = run("evaluate", "--ratios", "1,4,16", "--curve", "curve.txt")
    assert used.status == 0, used.err


def test_ten_bits_in_files_of_sixteen(run: Run) -> None:
    paths = write(pictures(10))
    line = ("calibrate", "response", *paths, "--times", "1,4,16", "--json")
    found = run(*line)
    assert found.json["channels"][0]["white"] == 1023
    assert "the white level is 1023" in found.err
    stated = run(*line, "--white", "1023")
    assert stated.err == ""
    assert stated.json["channels"][0]["irradiance"] == found.json["channels"][0]["irradiance"]


def test_the_folder_of_a_capture_is_measured(run: Run) -> None:
    small = ("--sensor", "consumer", "-O", "size=320x240")
    shot = run("shoot", *small, "--ratios", "1,2,4,8,16,32", "-o", "hall")
    assert shot.status == 0, shot.err
    ran = run("calibrate", "response", "hall", "--json")
    assert ran.status == 0, ran.err
    assert ran.json["mode"] == "rgb-320x240-255"
    assert len(list_profiles()) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--times", "1,2"), "2 exposure times were given for 3 files"),
        ((), "frame-0.png does not say its exposure time"),
        (("--camera", "sim"), "FILES cannot be combined with --camera"),
        (("--times", "1,4,16", "--black", "300"), "invalid levels: black 300"),
    ],
)
def test_invalid_series_are_one_line(run: Run, arguments: tuple[str, ...], message: str) -> None:
    ran = run("calibrate", "response", *write(pictures()), *arguments)
    assert message in ran.error
    assert "\n" not in ran.error
    assert ran.status == 2


def test_files_of_different_kinds_are_refused(run: Run) -> None:
    first, second, *_ = write(pictures())
    cv2.imwrite(str(second), np.zeros((120, 160, 3), np.uint8))
    error = run("calibrate", "response", first, second, "--times", "1,4").error
    assert "frame-1.png is rgb, 8 bits, and frame-0.png is mono, 8 bits" in error


def test_a_dark_scene_is_refused(run: Run) -> None:
    ran = run("calibrate", "response", "--scene", "night-street", "--longest", "0.001")
    assert ran.status == 1
    assert "the scene is too dark: it does not reach half of full scale" in ran.error


def _linear(brightness: float) -> float:
    return float(srgb_to_linear(np.array(brightness)))


def chart_picture(exposure: float = 0.85) -> NDArray[Any]:
    """Return a photograph of a Macbeth chart with sRGB response, in B, G, R."""
    E = np.full((240, 360, 3), 0.2)
    E[30:210, 45:315] = colour_chart(180, 270)
    levels = np.append(srgb_to_linear(np.arange(1, 256) / 256), np.inf)
    noisy = E * exposure * np.random.default_rng(4).normal(1, 0.01, E.shape)
    return np.searchsorted(levels, noisy, side="right").clip(0, 255).astype(np.uint8)[..., ::-1]


def test_one_photograph_of_a_chart_is_measured(run: Run) -> None:
    cv2.imwrite("chart.png", chart_picture())
    ran = run("calibrate", "response", "chart.png", "--chart", "macbeth", "--json")
    assert ran.status == 0, ran.err
    for channel in ran.json["channels"]:
        E, B = np.array(channel["irradiance"]), np.array(channel["brightness"])
        found = np.interp(0.5, B, E) / np.interp(0.9, B, E)
        assert found == pytest.approx(_linear(0.5) / _linear(0.9), rel=0.1)


def test_patches_of_a_file_are_measured(run: Run) -> None:
    cv2.imwrite("chart.png", chart_picture())
    rows = zip((0.896, 0.578, 0.352, 0.195, 0.0908, 0.0343), range(6), strict=True)
    lines = [f"{45 + 45 * k + 14} {30 + 135 + 14} 16 16 {grey}" for grey, k in rows]
    Path("patches.txt").write_text("# x y width height reflectance\n" + "\n".join(lines))
    line = ("calibrate", "response", "chart.png", "--patches", "patches.txt")
    ran = run(*line, "-o", "curve.txt")
    assert ran.status == 0, ran.err
    ratio = read_curve("curve.txt").levels[50:230] / srgb_to_linear(np.arange(51, 231) / 256)
    assert ratio.max() / ratio.min() < 1.25
    both = run(*line, "--chart", "macbeth")
    assert both.status == 2
    assert "--patches cannot be combined with --chart" in both.error
    missing = run("calibrate", "response", "chart.png", "--patches", "none.txt")
    assert "cannot read patches none.txt: No such file" in missing.error


@pytest.mark.slow
def test_what_is_not_exact_enough_is_kept_on_request_only(run: Run) -> None:
    """Four frames of a chart before a camera are few."""
    line = (
        *("calibrate", "response", "--scene", "colour-chart", "--sensor", "consumer"),
        *("-O", "size=320x240", "-n", "4", "--chart", "macbeth", "--json"),
    )
    ran = run(*line)
    assert ran.status == 0, ran.err
    assert ran.json["file"] is None
    assert list_profiles() == []
    assert "not kept in the camera's profile: at " in ran.err
    assert ", and +-7% is needed; add a frame of exposure " in ran.err
    assert run(*line, "--keep").json["file"] is not None
    assert len(list_profiles()) == 1


def test_a_curve_from_frames_that_contradict_their_exposures_is_written_on_request(
    run: Run,
) -> None:
    line = ("calibrate", "response", *write(pictures()), "--times", "1,1.1,1.2", "-o", "c.txt")
    refused = run(*line)
    assert refused.status == 1
    assert "contradict the pixels" in refused.error
    assert not Path("c.txt").exists()
    kept = run(*line, "--keep", "--json")
    assert kept.status == 0, kept.err
    assert "response_doubtful" in [each["code"] for each in kept.json["findings"]]
    assert Path("c.txt").exists()


def test_photographs_without_times_are_measured_with_a_warning(run: Run) -> None:
    ran = run("calibrate", "response", *write(pictures()), "--estimate-ratios", "--json")
    assert ran.status == 0, ran.err
    assert "no exposure is known: the exponent of the curve was chosen" in ran.err
    assert ran.json["exponent_error"] == 0.2
    assert ran.json["exposures"] == pytest.approx([1, 4, 16], rel=0.3)
