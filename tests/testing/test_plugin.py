"""The pytest plugin, in test runs of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from camctl.errors import UsageError
from camctl.sim.backend import SimulatedOptions
from camctl.sim.camera import Faults

pytest_plugins = ["pytester"]

USES = """
import camctl
import numpy as np
import pytest

SMALL = {"scene": "tile-floor", "size": "64x48"}
REQUEST = camctl.CaptureRequest(ratios=(1, 4))


def test_without_a_marker(camctl_camera):
    assert camctl_camera.info.id == "sim"


@pytest.mark.camctl_camera(**SMALL)
class TestMarkers:
    def test_of_the_class(self, camctl_camera):
        assert camctl_camera.controls.shape == (48, 64)

    @pytest.mark.camctl_camera(sensor="phone")
    def test_of_class_and_function_are_combined(self, camctl_camera):
        assert camctl_camera.controls.shape == (48, 64)
        assert camctl_camera.info.serial == "phone"

    @pytest.mark.camctl_camera(size="32x24")
    def test_of_the_function_are_preferred(self, camctl_camera):
        assert camctl_camera.controls.shape == (24, 32)


@pytest.mark.camctl_camera(**SMALL)
@pytest.mark.parametrize("camctl_camera", [{"sensor": "phone"}, {}], indirect=True)
def test_parametrised(camctl_camera):
    assert camctl_camera.info.serial in ("phone", "standard")
    assert camctl_camera.controls.shape == (48, 64)


def test_same_seed_gives_the_same_frames(camctl_camera_factory):
    sums = [
        camctl.capture(camctl_camera_factory(seed=seed, **SMALL), REQUEST).sum()
        for seed in (1, 1, 2)
    ]
    assert np.array_equal(sums[0], sums[1])
    assert not np.array_equal(sums[0], sums[2])


@pytest.mark.camctl_camera(faults={"unplug_after": 1}, **SMALL)
def test_unplugged(camctl_camera):
    with pytest.raises(camctl.CameraDisconnectedError, match="unplugged"):
        camctl.capture(camctl_camera, REQUEST)


@pytest.mark.camctl_camera(faults={"wrong_exposure": {1: 0.5}}, **SMALL)
def test_wrong_exposure(camctl_camera):
    assert 2 in [frame.attempts for frame in camctl.capture(camctl_camera, REQUEST).frames]


@pytest.mark.camctl_camera(**SMALL)
def test_long_exposures_pass_on_the_cameras_own_clock(camctl_camera):
    began = camctl_camera.clock.now()
    request = camctl.CaptureRequest(ratios=(1,) * 16, base_s=60)
    camctl.capture(camctl_camera, request)
    assert camctl_camera.clock.now() - began >= 16 * 60


opened = []


def test_cameras_are_closed_after_the_test(camctl_camera_factory):
    opened.append(camctl_camera_factory(**SMALL))


def test_cameras_were_closed():
    (camera,) = opened
    with pytest.raises(camctl.CameraDisconnectedError):
        camera.shoot([camctl.ExposureSetting(0.01)])
"""

MISUSES = """
import pytest


@pytest.mark.camctl_camera("room")
def test_positional(camctl_camera): ...


@pytest.mark.camctl_camera(sene="room")
def test_unknown_option(camctl_camera): ...


@pytest.mark.camctl_camera(faults={"unplug": 2})
def test_unknown_fault(camctl_camera): ...
"""


def test_fixture_gives_the_camera_of_the_marker(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(test_uses=USES)
    result = pytester.runpytest_inprocess(
        "-q", "--strict-markers", "-W", "error", "-p", "no:cacheprovider"
    )
    result.assert_outcomes(passed=12)


@pytest.mark.slow
def test_examples_of_the_page_work(pytester: pytest.Pytester) -> None:
    page = Path(__file__).parents[2] / "docs/how-to/ci.md"
    first, second = [
        block.partition("```")[0]
        for block in page.read_text("utf-8").split("```python\n")[1:]
        if "camctl_camera" in block
    ]
    assert 8 <= len(first.splitlines()) <= 12
    pytester.makepyfile(test_first=first, test_second=second)
    result = pytester.runpytest_subprocess("-q", "--strict-markers", "-W", "error")
    result.assert_outcomes(passed=5)


def test_invalid_options_are_errors_of_one_line(pytester: pytest.Pytester) -> None:
    pytester.makepyfile(MISUSES)
    result = pytester.runpytest_inprocess("-q", "-p", "no:cacheprovider")
    result.assert_outcomes(errors=3)
    result.stdout.fnmatch_lines(
        [
            "*the marker camctl_camera takes keyword arguments only, such as scene='room'",
            "*unknown camera option 'sene'; did you mean scene*",
            "*unknown fault 'unplug'; did you mean unplug_after?",
        ]
    )


def test_loading_the_plugin_imports_neither_numpy_nor_the_simulator(
    pytester: pytest.Pytester,
) -> None:
    pytester.makepyfile(
        """
        import sys


        def test_modules(pytestconfig):
            assert pytestconfig.pluginmanager.has_plugin("camctl")
            assert "camctl.testing.plugin" in sys.modules
            assert any(line.startswith("camctl_camera(") for line in pytestconfig.getini("markers"))
            assert not {"numpy", "camctl.sim", "camctl.drivers", "pydantic"} & set(sys.modules)
        """
    )
    result = pytester.runpytest_subprocess("-q", "-p", "no:hypothesispytest")
    result.assert_outcomes(passed=1)


@pytest.mark.parametrize("faults", [{"unplug_after": 2}, Faults(unplug_after=2)])
def test_faults_are_options_of_the_simulated_camera(faults: object) -> None:
    assert SimulatedOptions.parse({"faults": faults}).faults == Faults(unplug_after=2)
    with pytest.raises(UsageError, match="invalid fault '2'; known are unplug@FRAME"):
        SimulatedOptions.parse({"faults": "2"})


def test_conformance_suite_is_imported_on_use() -> None:
    code = (
        "import sys, camctl.testing; print('numpy' in sys.modules); "
        "camctl.testing.CameraConformance; print('numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]
