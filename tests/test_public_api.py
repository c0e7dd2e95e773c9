"""The public API: what `import camctl` gives, and what it costs."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
import textwrap
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
from sampling import some

import camctl

PROMISED = {
    "open_camera",
    "list_cameras",
    "capture",
    "resume",
    "plan_capture",
    "solve",
    "evaluate",
    "desired_response",
    "linear_response",
    "measured_response",
    "CaptureRequest",
    "CapturePlan",
    "CaptureReport",
    "Camera",
    "ExposureSetting",
    "ExposureControls",
    "Frame",
    "CamctlError",
    "CameraBase",
    "CameraInfo",
    "CameraBackend",
    "BackendOptions",
    "Choices",
    "Steps",
    "Layout",
}


def run_python(code: str, cwd: Path) -> str:
    """Return what a fresh interpreter prints for `code`."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        cwd=cwd,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_import_loads_no_numpy_until_a_name_is_used(tmp_path: Path) -> None:
    code = """
        import sys
        import camctl
        dir(camctl), camctl.__version__, camctl.UsageError, camctl.VirtualClock
        print("numpy" in sys.modules)
        camctl.CaptureRequest()
        print("numpy" in sys.modules)
    """
    assert run_python(code, tmp_path).split() == ["False", "True"]


def test_dir_lists_all_public_names() -> None:
    assert dir(camctl) == sorted(camctl.__all__)
    assert set(dir(camctl)) >= PROMISED


@pytest.mark.parametrize("name", sorted(camctl.__all__))
def test_public_name_exists_and_is_documented(name: str) -> None:
    value = getattr(camctl, name)
    if inspect.isclass(value) or inspect.isfunction(value):
        assert inspect.getdoc(value)
        assert value.__name__ == name


def test_all_errors_are_public() -> None:
    errors = {camctl.CamctlError.__name__}
    queue: list[type[Exception]] = [camctl.CamctlError]
    while queue:
        queue += (kinds := queue.pop().__subclasses__())
        errors |= {kind.__name__ for kind in kinds if kind.__module__ == "camctl.errors"}
    assert len(errors) >= 13
    assert errors <= set(dir(camctl))


def test_names_of_type_checkers_are_those_of_the_interpreter() -> None:
    tree = ast.parse(inspect.getsource(camctl))
    (block,) = [
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    ]
    for_checkers = {
        alias.asname: statement.module
        for statement in block.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    assert for_checkers == camctl._MODULES | dict.fromkeys(camctl._SUBMODULES, "camctl")


def test_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'camctl' has no attribute 'shot'"):
        camctl.shot  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.parametrize("first", some(["camctl.captures.plan", "camctl.cli"], every=2))
def test_functions_are_callable_whatever_was_imported_before(first: str, tmp_path: Path) -> None:
    code = f"""
        import {first}
        print(all(callable(camctl.__dict__.get(n) or getattr(camctl, n)) for n in dir(camctl)
                  if n not in ("__version__", *camctl._SUBMODULES)))
    """
    assert run_python(code, tmp_path).split() == ["True"]


def test_version_is_that_of_the_distribution() -> None:
    assert camctl.__version__ == version("camctl")


def test_example_of_the_interface_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    with camctl.open_camera("sim", scene="room", sensor="phone", size="320x240") as camera:
        request = camctl.CaptureRequest(response="log", dynamic_range=1000, count=3)
        plan = camctl.plan_capture(camera, request)
        report = camctl.capture(camera, request, "room", plan=plan)
    radiance, deviation = report.radiance(), report.standard_deviation()

    assert len(plan.exposures) == 3
    assert 50 < plan.effective_levels < 100
    assert plan.effective_levels_noise_free is not None
    assert plan.effective_levels_noise_free > 1000
    assert report.plan == plan
    assert report.achieved.effective_levels == pytest.approx(plan.effective_levels)
    assert radiance.dtype == np.float32
    assert radiance.shape == (*camera.controls.shape, 3)
    assert (deviation.dtype, deviation.shape) == (radiance.dtype, radiance.shape)
    assert np.all(deviation > 0)
    saved = camctl.read_report("room")
    assert np.array_equal(saved.radiance(), radiance)
    assert np.array_equal(saved.standard_deviation(), deviation)
    assert (tmp_path / "room" / "radiance.exr").exists()


def test_options_of_a_camera_may_be_a_mapping_keywords_or_both(tmp_path: Path) -> None:
    with camctl.open_camera("sim", {"scene": "uniform"}, size="64x48", sensor=None) as camera:
        assert camera.controls.shape == (48, 64)
    scene = tmp_path / "scene.npy"
    np.save(scene, np.full((24, 32), 0.5, np.float32))
    with camctl.open_camera("sim", scene=scene) as camera:
        assert camera.controls.shape == (24, 32)
    with pytest.raises(camctl.UsageError, match=r"unknown .*option.* 'sene'.* did you mean scene"):
        camctl.open_camera("sim", sene="uniform")


CONSUMER = '''
"""A project that uses camctl."""

import numpy as np
from numpy.typing import NDArray

import camctl
from camctl.testing import CameraConformance


def take(camera: camctl.Camera, path: str | None) -> NDArray[np.float32]:
    request = camctl.CaptureRequest(response="gamma", gamma=0.45, dynamic_range=1000.0, count=3)
    plan = camctl.plan_capture(camera, request)
    report = camctl.capture(camera, request, path, plan=plan, progress=show)
    levels: float = report.achieved.effective_levels
    exposures: list[float] = [frame.exposure for frame in report.frames]
    print(levels, exposures, plan.xi)
    return report.radiance()


def show(progress: camctl.Progress) -> None:
    print(progress.stage, progress.share)


def dimmest(camera: camctl.Camera) -> camctl.Frame:
    shortest = camctl.ExposureSetting(camera.controls.time_s.minimum)
    return next(camera.shoot([shortest]))


def search() -> tuple[float, ...]:
    response = camctl.linear_response(8)
    desired = camctl.desired_response("log", 1000.0)
    print(camctl.evaluate(response, desired, (1, 2, 4)).effective_levels)
    return camctl.solve(response, desired, 3).exposures


def main() -> None:
    try:
        for info in camctl.list_cameras():
            print(info.id, info.make)
        with camctl.open_camera("sim", scene="room", seed=3) as camera:
            print(take(camera, "room").mean(), dimmest(camera).pixels.mean())
    except camctl.UsageError as error:
        print(error.what, error.hint)
    except camctl.CamctlError as error:
        raise SystemExit(str(error)) from error


class TestSimulated(CameraConformance):
    def open_camera(self) -> camctl.Camera:
        return camctl.open_camera("sim", scene="uniform")
'''


@pytest.mark.slow
def test_project_that_uses_camctl_passes_mypy_strict(tmp_path: Path) -> None:
    (tmp_path / "consumer.py").write_text(CONSUMER)
    driver = Path(__file__).parent / "example_driver" / "camctl_example.py"
    (tmp_path / "driver.py").write_text(driver.read_text("utf-8"), "utf-8")
    (tmp_path / "wrong.py").write_text(
        "import camctl\n\ncamctl.open_camra('sim')\ncamctl.CaptureRequest(gamma='0.5')\n"
    )
    (tmp_path / "mypy.ini").write_text("[mypy]\nstrict = True\n")
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--no-incremental", "consumer.py", "driver.py", "wrong.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    *errors, _ = done.stdout.splitlines()
    assert [error.partition(" error: ")[0] for error in errors] == ["wrong.py:3:", "wrong.py:4:"]
    assert errors[0].endswith('has no attribute "open_camra"  [attr-defined]')
    assert errors[1].endswith('expected "float | None"  [arg-type]')
