"""`camctl calibrate noise` from a camera, from files, and from the folder of a capture."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import Run

from camctl.profiles.folder import list_profiles

SIZE = ("-O", "size=160x120")


def write_pairs(suffix: str = ".png") -> list[Path]:
    """Write pairs of frames with 20 electrons a level and read noise of 16 electrons."""
    random = np.random.default_rng(5)
    light = np.broadcast_to(np.geomspace(4, 200, 320), (160, 320))
    paths: list[Path] = []
    for time_s in (0.25, 0.5, 1.0, 2.0):
        for _ in (0, 1):
            levels = random.poisson(light * time_s * 20) / 20 + random.normal(0, 0.8, light.shape)
            frame = np.clip(np.floor(levels + 0.5), 0, 255).astype(np.uint8)
            paths.append(Path(f"frame-{len(paths)}{suffix}"))
            assert cv2.imwrite(str(paths[-1]), frame)
    return paths


TIMES = ("--times", "0.25,0.25,0.5,0.5,1,1,2,2")


def test_a_camera_is_measured_and_the_result_is_kept(run: Run) -> None:
    ran = run("calibrate", "noise", "--sensor", "phone", *SIZE, "-n", "6", "--json")
    assert ran.status == 0, ran.err
    for name, true in (("conversion_e_per_dn", 6.0), ("read_noise_e", 5.0), ("full_well_e", 5754)):
        figure = ran.json[name]
        assert figure["low"] < figure["value"] < figure["high"]
        assert figure["value"] == pytest.approx(true, rel=0.05)
    assert ran.json["emva1288"]["dynamic_range"]["value"] == pytest.approx(1000, rel=0.05)
    (profile,) = list_profiles()
    record = profile.noises[ran.json["mode"]]
    assert record.noise_model().conversion_e_per_dn == ran.json["conversion_e_per_dn"]["value"]


def test_flat_field_and_lens_cap_complete_the_record(run: Run) -> None:
    sensor = ("--sensor", "mobile", *SIZE)
    flat = run("calibrate", "noise", *sensor, "--scene", "uniform", "--flat", "-n", "8")
    assert flat.status == 0, flat.err
    (prnu,) = [line.split()[1] for line in flat.out.splitlines() if line.startswith("PRNU")]
    assert 0.6 < float(prnu) < 1.1  # of 0.7; without a lens cap DSNU counts, too
    assert "put the lens cap on" in flat.out
    cap = {"name": "cap", "picture": "uniform", "photons_s": 1e-6, "what": "a lens cap"}
    Path("cap.json").write_text(json.dumps(cap))
    dark = run("calibrate", "noise", *sensor, "--scene", "cap.json", "--dark", "--json")
    assert dark.status == 0, dark.err
    current = dark.json["dark"]["dark_current_e_s"]["value"]
    assert current == pytest.approx(3 * 2 ** (15 / 8), rel=0.03)
    with_dark = dark.json["prnu"]
    assert with_dark["low"] <= 0.007 <= with_dark["high"]
    (profile,) = list_profiles()
    (record,) = profile.noises.values()
    assert record.dark is not None
    assert record.prnu is not None


def test_lens_cap_alone_is_refused(run: Run) -> None:
    ran = run("calibrate", "noise", "--sensor", "phone", *SIZE, "--dark")
    assert ran.status == 2
    assert "measure the noise with light first (camctl calibrate noise)" in ran.error


def test_light_in_dark_frames_is_refused(run: Run) -> None:
    assert run("calibrate", "noise", "--sensor", "phone", *SIZE, "-n", "5").status == 0
    ran = run("calibrate", "noise", "--sensor", "phone", *SIZE, "--dark")
    assert ran.status == 1
    assert "is not dark" in ran.error
    assert "lens cap" in ran.error


def test_photographs_are_measured_and_nothing_is_kept(run: Run) -> None:
    ran = run("calibrate", "noise", *write_pairs(), *TIMES, "--json")
    assert ran.status == 0, ran.err
    figure = ran.json["conversion_e_per_dn"]
    assert figure["value"] == pytest.approx(20, rel=0.05)
    assert ran.json["read_noise_e"]["value"] == pytest.approx(16, rel=0.05)
    assert ran.json["file"] is None
    assert list_profiles() == []


def test_jpeg_files_are_noted(run: Run) -> None:
    ran = run("calibrate", "noise", *write_pairs(".jpg"), *TIMES, "--response", "linear")
    assert "compression hides noise" in ran.err


def test_a_capture_with_two_frames_of_each_exposure_is_measured(run: Run) -> None:
    shot = run("shoot", "--sensor", "phone", *SIZE, "--ratios", "1,1,4,4,16,16", "-o", "hall")
    assert shot.status == 0, shot.err
    ran = run("calibrate", "noise", "hall", "--json")
    assert ran.status == 0, ran.err
    assert ran.json["conversion_e_per_dn"]["value"] == pytest.approx(6.0, rel=0.05)
    assert list_profiles()[0].noises
    whole = ran.json["gains"]
    frames = sorted(Path("hall", "frames").glob("*.npy"))
    assert len(frames) == 6
    assert run("calibrate", "noise", "hall/frames", "--json").json["gains"] == whole
    assert run("calibrate", "noise", *frames, "--json").json["gains"] == whole
    ran = run("calibrate", "noise", *frames[2:], "--json")
    assert ran.json["conversion_e_per_dn"]["value"] == pytest.approx(6.0, rel=0.05)


@pytest.mark.slow
def test_the_measured_response_of_its_camera_is_used_for_a_capture(run: Run) -> None:
    camera = ("--sensor", "consumer", "--scene", "tile-floor", *SIZE)
    measured = run("calibrate", "response", *camera)
    assert measured.status == 0, measured.err
    run("shoot", *camera, "--ratios", "1,1,4,4,16,16", "-o", "hall")
    ran = run("calibrate", "noise", "hall", "--json")
    assert ran.status == 0, ran.err
    assert ran.json["conversion_e_per_dn"]["value"] == pytest.approx(12000 / 256, rel=0.05)
    ran = run("calibrate", "exposure", "--from", "hall/frames", "--json")
    assert [each["factor"] for each in ran.json["times"]] == pytest.approx([1.0] * 3, rel=0.01)


def test_frames_that_belong_to_no_capture_are_refused(run: Run) -> None:
    np.save("dark.npy", np.zeros((8, 8), np.uint16))
    ran = run("calibrate", "noise", "dark.npy")
    assert ran.status == 1
    assert "holds no capture" in ran.error
    run("shoot", "--sensor", "phone", *SIZE, "--ratios", "1,1", "-o", "hall")
    ran = run("calibrate", "noise", "hall/frames/frame-03.npy")
    assert "is no frame of the capture" in ran.error


def test_the_frames_of_a_camera_without_a_response_are_taken_for_linear(run: Run) -> None:
    run("shoot", "--sensor", "webcam", *SIZE, "--ratios", "1,2", "-o", "hall")
    ran = run("calibrate", "exposure", "--from", "hall")
    assert "the response linear is assumed until it is measured" in ran.err
    assert "--response NAME" in ran.err


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        ((*TIMES, "--sensor", "phone"), "--sensor"),
        ((*TIMES, "--dark"), "--dark"),
        ((*TIMES, "--response", "sepia"), "unknown camera response"),
    ],
)
def test_unsuitable_options_are_refused(run: Run, arguments: tuple[str, ...], problem: str) -> None:
    ran = run("calibrate", "noise", *write_pairs(), *arguments)
    assert ran.status in (1, 2)
    assert problem in ran.error
