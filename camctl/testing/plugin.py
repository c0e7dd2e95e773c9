"""pytest plugin: the fixture `camctl_camera`, a simulated camera in virtual time.

It is installed with camctl.  A test that asks for the fixture gets an open camera::

    import camctl
    import pytest


    @pytest.mark.camctl_camera(scene="room", sensor="phone", seed=7)
    def test_window_is_not_saturated(camctl_camera, tmp_path):
        request = camctl.CaptureRequest(response="log", dynamic_range=1000, count=3)
        report = camctl.capture(camctl_camera, request, tmp_path / "room")
        assert report.achieved.saturated_fraction < 0.05

The marker's arguments are the options of the simulated camera: `scene`, `sensor`, `seed`, `size`
(WIDTHxHEIGHT), `tolerance`, `time` and `faults`, a dict such as ``{"unplug_after": 2}`` with fields
of `camctl.sim.camera.Faults`.  A marker on a test adds to one on its class or module.  With the
same options and calls the frames are the same, sample by sample.  Nothing waits: a minute of
exposure passes on the camera's own clock.

To run a test with several cameras, parametrise the fixture indirectly; to open several in one test,
use the fixture `camctl_camera_factory`, which takes the options as keyword arguments::

    @pytest.mark.parametrize("camctl_camera", [{"seed": 1}, {"seed": 2}], indirect=True)
    def test_with_two_seeds(camctl_camera): ...


    def test_with_two_cameras(camctl_camera_factory):
        left, right = camctl_camera_factory(seed=1), camctl_camera_factory(seed=2)
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from camctl.interface.camera import Camera

_MARKER = "camctl_camera"


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker."""
    config.addinivalue_line(
        "markers", f"{_MARKER}(**options): options of the simulated camera of the fixture {_MARKER}"
    )


@pytest.fixture
def camctl_camera_factory() -> Iterator[Callable[..., Camera]]:
    """Return a function that opens simulated cameras; they are closed after the test."""
    from camctl.profiles.calibrated import open_camera  # imports numpy: not before it is used

    with ExitStack() as cameras:

        def open_simulated(**options: Any) -> Camera:
            return cameras.enter_context(open_camera("sim", options, profile="none"))

        yield open_simulated


@pytest.fixture
def camctl_camera(
    request: pytest.FixtureRequest, camctl_camera_factory: Callable[..., Camera]
) -> Camera:
    """Return an open simulated camera, with the options of the marker `camctl_camera`."""
    options: dict[str, Any] = {}
    for marker in reversed(list(request.node.iter_markers(_MARKER))):  # the test's own is last
        if marker.args:
            raise pytest.UsageError(
                f"the marker {_MARKER} takes keyword arguments only, such as scene='room'"
            )
        options |= marker.kwargs
    return camctl_camera_factory(**options | getattr(request, "param", {}))
