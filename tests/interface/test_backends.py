"""Backends: how they are found, and what is reported where one cannot be loaded."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping, Sequence
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import Field

from camctl.errors import CameraError, UsageError
from camctl.interface import backends
from camctl.interface.backends import (
    CAMERAS,
    BackendOptions,
    FrameShape,
    list_backends,
    list_cameras,
    load,
)
from camctl.interface.camera import CameraInfo
from camctl.profiles.calibrated import open_camera


class Working:
    """A backend with one camera, which remembers how it was opened."""

    about = "a camera for tests"
    opened: tuple[str, Mapping[str, Any]] = ("", {})

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        return [CameraInfo(f"working:{probe}", "Make", "Model", "1", "working")]

    def open(self, address: str, options: Mapping[str, Any]) -> Any:
        Working.opened = (address, options)
        return SimpleNamespace(info=CameraInfo("working", "Make", "Model", "1", "working"))


class Failing(Working):
    """A backend that cannot search for cameras."""

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        raise CameraError("the bus does not answer", hint="restart it")


@pytest.fixture
def installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two backends, defined in this module, instead of the real ones."""
    module = "backends_of_this_test"
    monkeypatch.setitem(sys.modules, module, sys.modules[__name__])
    points = {
        kind.__name__.lower(): EntryPoint(
            kind.__name__.lower(), f"{module}:{kind.__name__}", CAMERAS
        )
        for kind in (Working, Failing)
    }
    monkeypatch.setattr(backends, "_entry_points", lambda group: points)


@pytest.mark.usefixtures("installed")
def test_list_backends_has_cameras_and_problems() -> None:
    failing, working = list_backends(probe=True)
    assert (failing.name, failing.about, failing.cameras) == ("failing", "a camera for tests", ())
    assert failing.problem == "the bus does not answer; restart it"
    assert (working.name, working.problem) == ("working", "")
    assert [camera.id for camera in working.cameras] == ["working:True"]


@pytest.mark.usefixtures("installed")
def test_list_cameras_leaves_out_backends_with_a_problem() -> None:
    assert [camera.id for camera in list_cameras()] == ["working:False"]


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("camera_id", "address"), [("working", ""), ("working:", ""), ("working:a:b", "a:b")]
)
def test_open_camera_passes_address_and_options_on(camera_id: str, address: str) -> None:
    open_camera(camera_id, {"path": Path("scene.hdr"), "seed": 3, "none": None}, size=(2, 3))
    assert Working.opened == (address, {"path": "scene.hdr", "seed": 3, "size": (2, 3)})


class Options(BackendOptions):
    """Options of each kind."""

    seed: int = Field(default=0, ge=0)
    size: FrameShape | None = None


@pytest.mark.parametrize("size", ["3x2", "3X2", " 3 × 2 ", (2, 3)])
def test_options_are_read_from_strings_and_from_values(size: object) -> None:
    assert Options.parse({"seed": "5", "size": size}) == Options(seed=5, size=(2, 3))
    assert Options.parse({"seed": 5, "size": size}) == Options(seed=5, size=(2, 3))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sead": 1}, "unknown camera option 'sead'; did you mean seed or size?"),
        ({"seed": -1}, "invalid camera option seed=-1; input should be greater than or equal to 0"),
        ({"size": "640"}, "invalid camera option size=640; write WIDTHxHEIGHT, such as 640x480"),
        ({"size": "0x3"}, "invalid camera option size=0x3; write WIDTHxHEIGHT, such as 640x480"),
    ],
)
def test_invalid_option_is_a_usage_error_of_one_line(
    options: dict[str, object], message: str
) -> None:
    with pytest.raises(UsageError) as failure:
        Options.parse(options)
    assert str(failure.value) == message


@pytest.mark.parametrize(
    "arguments", [["shoot", "-O", "size=24x16", "--ratios", "1,8"], ["menu", "--help"]]
)
def test_a_folder_of_the_user_hides_nothing(arguments: list[str], tmp_path: Path) -> None:
    """A project with folders of its own of the names sim, drivers and menu can use camctl."""
    for name in ("drivers", "menu", "sim"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise ImportError('not of camctl')")
    code = f"import sys; from camctl.cli import main; sys.exit(main({arguments}))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            "import not_installed",
            "camera 'broken' cannot be loaded: No module named 'not_installed'; "
            "install the packages that it needs",
        ),
        (
            "import termios",
            "camera 'broken' needs Linux: this Python has no module termios; choose another camera",
        ),
    ],
)
def test_missing_module_is_named(
    code: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "broken_driver.py").write_text(code)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "broken_driver", raising=False)
    monkeypatch.setitem(sys.modules, "termios", None)
    broken = EntryPoint("broken", "broken_driver:Backend", CAMERAS)
    monkeypatch.setattr(backends, "_entry_points", lambda group: {"broken": broken})
    with pytest.raises(UsageError) as failure:
        load(CAMERAS, "camera", "broken")
    assert str(failure.value) == message


@pytest.mark.parametrize(
    ("make", "model", "name"),
    [
        ("Canon", "Canon EOS 5D", "Canon EOS 5D"),
        ("NIKON CORPORATION", "NIKON D90", "NIKON D90"),
        ("FUJIFILM", "X-T2", "FUJIFILM X-T2"),
        ("", "photographs", "photographs"),
        ("", "", "sim"),
    ],
)
def test_the_name_of_a_camera_has_its_maker_once(make: str, model: str, name: str) -> None:
    assert CameraInfo("sim", make, model, "1", "test").name == name
