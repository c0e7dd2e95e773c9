"""Names from arguments, files and cameras: characters that command a terminal are made visible."""

from __future__ import annotations

import json
from dataclasses import replace
from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from command_line import Ran, Run

from camctl.errors import CameraProtocolError, visible
from camctl.findings import note
from camctl.interface.backends import BackendListing
from camctl.interface.camera import CameraBase, CameraInfo
from camctl.menu.text import fit
from camctl.sim.camera import SimulatedCamera
from camctl.stills.decoding import read_still

NAME = "red \x1b[31m two\nlines \u202edlo \x9b7m \x7f bell\x07"
SHOWN = r"red \x1b[31m two\nlines \u202edlo \x9b7m \x7f bell\x07"


def check_visible(ran: Ran) -> None:
    """Check that no character of the output commands a terminal, and no name makes a line."""
    for text in (ran.out, ran.err):
        assert all(character.isprintable() for character in text.replace("\n", ""))
    assert not any(line.startswith("lines") for line in (ran.out + ran.err).split("\n"))


@pytest.mark.parametrize(
    "line",
    [
        ["shoot", "--scene", f"{NAME}.hdr"],
        ["shoot", "--scene", NAME],
        ["shoot", "--sensor", f"{NAME}.json"],
        ["shoot", "--sensor", NAME],
        ["shoot", "--camera", NAME],
        ["resume", NAME],
        ["shoot", "-O", f"{NAME}=1"],
        ["shoot", "--set", f"table={NAME}"],
        ["shoot", NAME],
        ["simulate", "-o", f"{NAME}/x.png", "--size", "24x16"],
        ["solve", "--curve", NAME],
        ["solve", "--settings", NAME],
        ["solve", "--bits", NAME],
        ["solve", f"--{NAME}"],
        ["profile", "show", NAME],
        ["menu", "--panel", NAME],
        [NAME],
        ["help", NAME],
    ],
)
def test_name_in_an_error_is_visible(run: Run, line: list[str]) -> None:
    ran = run(*line)
    assert ran.status != 0
    assert r"red \x1b[31m two\nlines \u202edlo" in ran.error
    check_visible(ran)
    traceback = run(*line, "--debug").err
    assert all(character.isprintable() for character in traceback.replace("\n", ""))


def test_name_in_json_is_escaped(run: Run) -> None:
    ran = run("solve", "--json", "--curve", NAME)
    assert NAME in ran.json["error"]["message"] or SHOWN in ran.json["error"]["message"]
    check_visible(ran)


def test_output_folder_is_visible(run: Run) -> None:
    ran = run("shoot", "-O", "size=24x16", "--ratios", "1,2", "--base", "0.01", "-o", NAME)
    assert ran.status == 0
    assert f"  {SHOWN}\n" in ran.out
    check_visible(ran)
    assert Path(NAME, "sum.tiff").exists()
    refused = run("shoot", "-O", "size=24x16", "--ratios", "1,2", "-o", NAME)
    assert refused.error.startswith(f"{SHOWN} is not empty")


def test_name_of_a_sensor_and_its_camera_is_visible(run: Run) -> None:
    file = resources.files("camctl.sim") / "sensors" / "standard.json"
    sensor = json.loads(file.read_text(encoding="utf-8")) | {"name": NAME}
    Path("sensor.json").write_text(json.dumps(sensor))
    options = ("--sensor", "sensor.json", "-O", "size=24x16")
    shot = run("shoot", *options, "--ratios", "1,2", "--base", "0.01", "-o", "out")
    assert shot.status == 0
    assert f"simulated {SHOWN} (sim)" in shot.out
    check_visible(shot)
    written = run("shoot", *options, "--ratios", "1,2", "--base", "0.01", "-o", "j", "--json")
    assert written.json["camera"]["model"] == f"simulated {NAME}"
    check_visible(written)
    measured = run("calibrate", "delay", *options, "--trials", "2")
    assert f"simulated {SHOWN} (sim)" in measured.out
    check_visible(measured)
    listed = run("profile", "list")
    assert f"simulated {SHOWN}" in listed.out
    check_visible(listed)
    (name,) = [each["name"] for each in run("profile", "list", "--json").json["profiles"]]
    shown = run("profile", "show", name)
    assert SHOWN in shown.out
    check_visible(shown)
    check_visible(run("profile", "remove", name))


def test_name_of_a_real_camera_is_visible(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    info = CameraInfo(f"v4l2:{NAME}", NAME, NAME, NAME, "v4l2")
    listing = BackendListing(NAME, NAME, (info,), problem=NAME)
    monkeypatch.setattr("camctl.interface.backends.list_backends", lambda **_: [listing])
    ran = run("cameras")
    assert ran.out.count(SHOWN) >= 3
    check_visible(ran)
    check_visible(run("cameras", "--json"))


def test_warning_of_a_camera_is_visible(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    controls = vars(CameraBase)["controls"].fget
    noted = property(lambda camera: replace(controls(camera), findings=(note(NAME),)))
    monkeypatch.setattr(SimulatedCamera, "controls", noted)
    ran = run("simulate", "--size", "24x16")
    assert f"camctl: warning: {SHOWN}\n" in ran.err
    check_visible(ran)


def test_menu_shows_no_control_characters() -> None:
    assert fit(NAME, 80).rstrip() == "red ?[31m two?lines ?dlo ?7m ? bell?"


def test_visible_leaves_other_characters() -> None:
    assert visible("Größe 12 µm, 写真, naïve ½ — “ok”") == "Größe 12 µm, 写真, naïve ½ — “ok”"
    assert visible("a\udcffb\ud800\u2028\u00a0") == r"a\xffb\ud800\u2028\xa0"


@pytest.mark.parametrize("suffix", [".exr", ".tiff", ".hdr"])
def test_library_prints_nothing_of_a_damaged_scene(run: Run, suffix: str) -> None:
    """Some of these damages make OpenEXR, libtiff or tifffile print text of their own."""
    rng = np.random.default_rng(0)
    values = rng.random((24, 32, 3), np.float32)
    file = Path(f"scene{suffix}")
    if suffix == ".exr":
        header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION}
        with OpenEXR.File(header, {"RGB": values}) as exr:
            exr.write(str(file))
    elif suffix == ".tiff":
        tifffile.imwrite(file, values, photometric="rgb", compression="zlib")
    else:
        cv2.imwrite(str(file), values)
    data = file.read_bytes()
    refused = 0
    for length in (len(data) // 4, len(data) // 2, len(data) - 500, len(data) - 1):
        file.write_bytes(data[:length])
        ran = run("simulate", "--scene", file, "--json")
        if ran.status:
            refused += 1
            assert ran.err.startswith(f"camctl: {file}")
            assert ran.err.count("\n") == 1
        assert ran.json
    assert refused >= 3


def test_library_prints_nothing_of_a_damaged_photograph(capfd: pytest.CaptureFixture[str]) -> None:
    """libjpeg prints "Corrupt JPEG data: ... extraneous bytes before marker"."""
    picture = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    data = cv2.imencode(".jpg", picture)[1].tobytes()
    spoilt = data[:-300] + b"\xff\xd9"
    assert cv2.imdecode(np.frombuffer(spoilt, np.uint8), cv2.IMREAD_UNCHANGED) is not None
    assert "Corrupt JPEG data" in capfd.readouterr().err
    with pytest.raises(CameraProtocolError, match=r"DSC_0001\.JPG .*premature end of data"):
        read_still(spoilt, "DSC_0001.JPG")
    assert capfd.readouterr() == ("", "")
