"""Small simulated cameras for tests of the capture: any sensor, any light, any fault."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Camera, CameraInfo, FrameStream
from camctl.interface.clock import Clock
from camctl.interface.controls import Control, ExposureControls, ExposureSetting
from camctl.records.report import CaptureReport
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import Sensor, load_sensor

#: For live results: exposures that need no metering, and so follow no light.
GIVEN = CaptureRequest(base_s=0.004, ratios=(1, 4, 16), response="log", dynamic_range=256)


def gradient(rows: int = 60, columns: int = 80, low: float = 1e-3) -> NDArray[np.float32]:
    """Return light, (rows, columns), that falls from 1 to `low` evenly in its logarithm."""
    return np.geomspace(1, low, rows * columns, dtype=np.float32).reshape(rows, columns)


@contextmanager
def small_camera(
    sensor: str = "standard",
    light: NDArray[np.float32] | None = None,
    faults: Faults | None = None,
    seed: int = 0,
    **changes: object,
) -> Iterator[SimulatedCamera]:
    """Yield an open camera with `sensor`, some of its fields changed, before `light`.

    `light` is relative irradiance, (rows, columns) or (rows, columns, 3); a gradient by default.
    """
    model = Sensor.model_validate({**load_sensor(sensor).model_dump(), **changes})
    scene = Scene("test", gradient() if light is None else light, photons_per_unit=1e6)
    with SimulatedCamera(scene, model, faults=faults or Faults(), seed=seed) as camera:
        yield camera


class WrappedCamera:
    """A camera that passes all calls on to another one; tests override what they change.

    It has no preview: to metering it is a camera with a mechanical shutter.
    """

    def __init__(self, camera: Camera, times: Control | None = None) -> None:
        self.camera = camera
        self._times = times

    @property
    def info(self) -> CameraInfo:
        """The identity of the other camera."""
        return self.camera.info

    @property
    def controls(self) -> ExposureControls:
        """The controls of the other camera, with other shutter times where they were given."""
        controls = self.camera.controls
        return controls if self._times is None else replace(controls, time_s=self._times)

    @property
    def clock(self) -> Clock:
        """The clock of the other camera."""
        return self.camera.clock

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Shoot with the other camera."""
        return self.camera.shoot(settings)

    def close(self) -> None:
        """Close the other camera."""
        self.camera.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def sum_of_frames(directory: Path, report: CaptureReport) -> NDArray[np.int64]:
    """Return the sum of the frames on disk, clipped at white."""
    total = np.zeros((), np.int64)
    for frame in report.frames:
        assert frame.file is not None
        total = total + np.minimum(np.load(directory / frame.file), frame.white).astype(np.int64)
    return total
