"""What the commands say and do with a camera's profile; export and import."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Run
from sampling import some

from camctl.interface.camera import CameraInfo
from camctl.profiles.folder import list_profiles
from camctl.profiles.profile import DelayRecord, Profile, change_profile

UNKNOWN = ("--sensor", "consumer", "--scene", "ramp", "-O", "size=160x120", "-O", "unknown=yes")
ASSUMED = "the response linear is assumed until it is measured"
DELAY = DelayRecord(frames=2, smallest=2, largest=2, trials=12, measured_at="2026-11-22")
CAMERA = CameraInfo("v4l2:/dev/video0", "Make", "Webcam 3000", "A1B2", "v4l2")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for the profile of one calibration."""
    return tmp_path_factory.mktemp("profiles")


@pytest.fixture
def calibrated(folder: Path, run: Run, monkeypatch: pytest.MonkeyPatch) -> str:
    """Calibrate a simulated camera that states little, once; return the name of its profile."""
    monkeypatch.setenv("CAMCTL_PROFILES", str(folder))
    if not list(folder.glob("*.json")):
        ran = run("calibrate", "all", *UNKNOWN)
        assert ran.status == 0, ran.err
        assert "Put the camera on a tripod" in ran.err
        names = [line.partition(":")[0] for line in ran.out.splitlines()[:4]]
        assert names == ["control delay", "response", "exposures", "noise"]
    (kept,) = list_profiles()
    return kept.name


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of profiles."""
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))
    return tmp_path


def using(name: str) -> str:
    return f"camctl: using the profile {name}: "


def test_shoot_uses_the_profile_and_says_so(run: Run, calibrated: str, tmp_path: Path) -> None:
    line = ("shoot", *UNKNOWN, "--response", "linear", "-n", "2", "-o", str(tmp_path / "a"))
    ran = run(*line)
    assert ran.status == 0, ran.err
    assert ran.err.count(using(calibrated)) == 1
    report = json.loads((tmp_path / "a" / "report.json").read_text())
    assert report["response_origin"] == "measured"
    assert report["profile"].startswith(f"{calibrated}: response, exposures, noise")
    used = [frame["exposure_ratio"]["used"] for frame in report["frames"]]
    assert used == ["profile", "profile"]


@pytest.mark.usefixtures("calibrated")
def test_the_profile_is_switched_off(run: Run, tmp_path: Path) -> None:
    line = ("shoot", *UNKNOWN, "--response", "linear", "-n", "2", "-o", str(tmp_path / "a"))
    ran = run(*line, "-O", "profile=none", "--json")
    assert "profile" not in ran.json
    assert "using the profile" not in ran.err
    assert ran.json["response_origin"] == "assumed"
    assert ran.json["warnings"].count(ASSUMED) == 1
    assert ran.err.count(ASSUMED) == 1


@pytest.mark.parametrize("command", some(["solve", "evaluate --ratios 1,2", "table show"], every=3))
def test_computations_for_a_camera_use_its_profile(run: Run, calibrated: str, command: str) -> None:
    options = ("-O", "unknown=yes", "-O", "scene=ramp", "-O", "size=160x120")
    line = (*command.split(), "--camera", "sim", "--sensor", "consumer", *options, "-n", "2")
    line = line[:-2] if command.startswith("evaluate") else line
    ran = run(*line)
    assert ran.status == 0, ran.err
    assert using(calibrated) in ran.err
    assert ASSUMED not in ran.err
    without = run(*line, "-O", "profile=none").err
    assert using(calibrated) not in without
    assert without.count(ASSUMED) == 1


def test_options_of_a_camera_need_one(run: Run) -> None:
    ran = run("solve", "-O", "profile=none")
    assert ran.error == "--camera-option needs --camera; name the camera"


def test_show_draws_the_responses(run: Run, calibrated: str, tmp_path: Path) -> None:
    plot = tmp_path / "profile.png"
    ran = run("profile", "show", calibrated, "--plot", str(plot))
    assert ran.status == 0, ran.err
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert "% at 50% of full light" in ran.out
    assert "delay in rgb-160x120-255, 10 frames/s" in ran.out
    again = run("profile", "show", calibrated, "--plot", str(plot))
    assert again.error == f"{plot} exists; choose another file, or have it replaced (--force)"


def test_nothing_measured_draws_nothing(run: Run, own: Path) -> None:
    change_profile(CAMERA, lambda profile: profile.delays.update(mode=DELAY))
    (kept,) = list_profiles()
    ran = run("profile", "show", kept.name, "--plot", str(own / "a.png"))
    assert ran.status == 1
    assert "has no response or noise to draw" in ran.err
    assert not (own / "a.png").exists()


def test_export_and_import_round_trip(run: Run, calibrated: str, tmp_path: Path) -> None:
    file = tmp_path / "camera.json"
    assert run("profile", "export", calibrated, "-o", str(file)).status == 0
    assert run("profile", "export", calibrated, "-o", str(file)).error.startswith(f"{file} exists")
    assert json.loads(run("profile", "export", calibrated).out) == json.loads(file.read_text())
    (before,) = list_profiles()
    refused = run("profile", "import", str(file))
    assert f"the camera has the profile {calibrated} already" in refused.error
    assert refused.error.endswith("(--force)")
    assert run("profile", "import", str(file), "--force", "--json").json["name"] == calibrated
    assert list_profiles() == [before]


def test_import_for_a_new_camera_asks_nothing(run: Run, own: Path) -> None:
    file = own / "camera.json"
    profile = Profile.of(CAMERA)
    profile.delays["mode"] = DELAY
    file.write_text(profile.model_dump_json())
    assert run("profile", "import", str(file)).status == 0
    assert list_profiles() == [profile]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "is a profile of version '2', and this camctl reads version 1"),
        ({"version": "x" * 99}, "is a profile of version 'xxxxxxxxxxxxxxxxxxxx'"),
        ({"unknown": 1}, "is damaged: unknown: Extra inputs are not permitted"),
        ({"make": 5}, "is damaged: make"),
        ({"serial": "x" * 2000}, "is damaged: serial"),
        ({"delays": {"a": {**DELAY.model_dump(), "largest": 10**9, "frames": None}}}, "delays.a"),
        ({"delays": {str(k): DELAY.model_dump() for k in range(1001)}}, "is damaged: delays"),
        ({"responses": {"a": {"channels": []}}}, "is damaged: responses.a"),
    ],
)
def test_a_bad_file_is_refused_by_name(
    run: Run, own: Path, changes: dict[str, object], message: str
) -> None:
    file = own / "bad.json"
    file.write_text(json.dumps({**Profile.of(CAMERA).model_dump(), **changes}))
    ran = run("profile", "import", str(file))
    assert ran.status == 1
    assert f"{file} " in ran.error
    assert message in ran.error
    assert list_profiles() == []


@pytest.mark.parametrize("content", ["", "[]", "null", "{", "1e999", "\x00", "[" * 10_000, "NaN"])
def test_a_file_that_is_no_profile_is_refused(run: Run, own: Path, content: str) -> None:
    file = own / "bad.json"
    file.write_text(content)
    assert run("profile", "import", str(file)).error.startswith(f"{file} is damaged: ")
