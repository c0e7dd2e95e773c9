"""`camctl doctor`: each state of what it looks at."""

from __future__ import annotations

import sys
import tomllib
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from command_line import Run

from camctl.cli.doctor import checks as doctor
from camctl.drivers.common.usb import UDEV_RULES
from camctl.errors import CameraNotFoundError
from camctl.interface import backends


def install(monkeypatch: pytest.MonkeyPatch, **files: list[Path]) -> None:
    """Let these distributions be installed, with these files."""

    def distribution(name: str) -> Any:
        key = name.replace("-", "_")
        if key not in files:
            raise PackageNotFoundError(name)
        listed = [
            SimpleNamespace(suffix=path.suffix, locate=lambda path=path: path)
            for path in files[key]
        ]
        return SimpleNamespace(version="4.11.0", files=listed)

    monkeypatch.setattr(doctor, "distribution", distribution)


def test_everything_is_looked_at(run: Run) -> None:
    ran = run("doctor", "--json")
    assert ran.json["format_version"] == 1
    names = [check["name"] for check in ran.json["checks"]]
    assert names[:4] == ["OpenCV", "libusb", "video devices", "udev rules"]
    assert {"configuration", "profiles", "cameras, sim", "extra raw", "extra plots"} <= {*names}
    text = run("doctor").out
    assert all(f"\n{name} " in text for name in names)
    problems = [check for check in ran.json["checks"] if check["state"] == "problem"]
    assert ran.status == bool(problems)


def test_two_opencv_in_one_place_are_a_problem(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, opencv_python=[], opencv_contrib_python_headless=[])
    found = doctor.check_opencv()
    assert found.state == "problem"
    assert "opencv-contrib-python-headless 4.11.0, opencv-python 4.11.0" in found.found
    assert found.to_do == (
        "keep one: pip uninstall -y opencv-contrib-python-headless opencv-python && "
        "pip install --no-deps opencv-python"
    )
    ran = run("doctor")
    assert ran.status == 1
    assert "there are problems: OpenCV" in ran.err


def test_opencv_whose_files_are_gone_is_a_problem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there.py").touch()
    paths = [tmp_path / name for name in ("there.py", "cv2.abi3.so", "LICENSE.txt")]
    install(monkeypatch, opencv_python=paths)
    found = doctor.check_opencv()
    assert (found.state, "1 of its files are gone" in found.found) == ("problem", True)
    assert found.to_do == "pip install --force-reinstall --no-deps opencv-python"


def test_no_opencv_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch)
    monkeypatch.setitem(sys.modules, "cv2", None)
    found = doctor.check_opencv()
    assert found.state == "missing"
    assert "no camctl merge" in (found.to_do or "")


def test_any_flavour_of_opencv_is_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    build = "  GUI:                           QT5\n  Media I/O:\n"
    fake = SimpleNamespace(
        __version__="4.11.0", __file__="/x/cv2/__init__.py", getBuildInformation=lambda: build
    )
    monkeypatch.setitem(sys.modules, "cv2", fake)
    install(monkeypatch, opencv_python=[])
    found = doctor.check_opencv()
    assert (found.state, found.to_do) == ("ok", None)
    assert "opencv-python 4.11.0; windows by QT5; no Macbeth charts" in found.found
    install(monkeypatch)
    assert "of no distribution that pip knows" in doctor.check_opencv().found


def test_libusb(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("usb.backend.libusb1.get_backend", lambda: None)
    assert doctor.check_libusb().state == "missing"
    monkeypatch.setattr("usb.backend.libusb1.get_backend", object)
    assert doctor.check_libusb().state == "ok"


def test_permissions_of_video_devices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "DEVICES", tmp_path)
    assert doctor.check_video_devices().state == "missing"
    (tmp_path / "video0").touch()
    assert doctor.check_video_devices().state == "ok"
    monkeypatch.setattr("os.access", lambda *_: False)
    found = doctor.check_video_devices()
    assert (found.state, f"{tmp_path}/video0" in found.found) == ("problem", True)


def test_udev_rules(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(doctor, "RULES", tmp_path / "70-camctl.rules")
    missing = doctor.check_udev_rules()
    assert (missing.state, "--udev-rules" in (missing.to_do or "")) == ("missing", True)
    (tmp_path / "70-camctl.rules").write_text("# of last year\n")
    assert doctor.check_udev_rules().state == "problem"
    (tmp_path / "70-camctl.rules").write_text(UDEV_RULES)
    assert doctor.check_udev_rules().state == "ok"


def test_profiles(run: Run, own_profiles: Path) -> None:
    assert doctor.check_profiles().state == "missing"
    run("calibrate", "delay", "-O", "size=64x48", "--trials", "2")
    assert doctor.check_profiles().found.startswith("1 in ")
    (own_profiles / "broken-12345678.json").write_text("{")
    found = doctor.check_profiles()
    assert (found.state, "camctl profile remove" in (found.to_do or "")) == ("problem", True)


@pytest.mark.parametrize("fails", [True, False])
def test_backends(monkeypatch: pytest.MonkeyPatch, *, fails: bool) -> None:
    listed = backends.BackendListing(
        "bus", "", problem=str(CameraNotFoundError("the bus is closed", hint="open it"))
    )
    other = backends.BackendListing("none", "")
    monkeypatch.setattr(backends, "list_backends", lambda: [listed if fails else other])
    (check,) = doctor.check_cameras()
    assert check.state == ("problem" if fails else "missing")


def test_extras_say_how_they_are_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, rawpy=[])
    found = {check.name: check for check in doctor.check_extras()}
    assert found["extra raw"].state == "ok"
    assert found["extra plots"].to_do == "pip install 'camctl[plots]'"
    studies = found["extra studies"]
    assert (studies.state, "matplotlib and scipy are" in studies.found) == ("missing", True)


def test_extras_are_those_of_the_distribution_and_of_the_documentation() -> None:
    """Of all that pyproject.toml has, developers alone need three."""
    root = Path(__file__).parents[2]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert {*doctor.EXTRAS} == {*project["optional-dependencies"]} - {"bench", "dev", "docs"}
    page = (root / "docs" / "how-to" / "install.md").read_text(encoding="utf-8")
    rows = "".join(f"| `{extra}` | {purpose} |\n" for extra, purpose in doctor.EXTRAS.items())
    assert f"| extra | for |\n|---|---|\n{rows}\n" in page
