"""A simulated camera before a small scene at rest, for the checks of conformance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import Sensor, load_sensor

ROWS, COLUMNS = 24, 32
#: Full scale of the middle exposure, 0.02 s, is at this irradiance.
_FULL_SCALE = 1.2


def gradient() -> NDArray[np.float32]:
    """Return (rows, columns, 3) light from 0.2 to 0.7."""
    return np.linspace(0.2, 0.7, ROWS * COLUMNS * 3, dtype=np.float32).reshape(ROWS, COLUMNS, 3)


def waves() -> NDArray[np.float32]:
    """Return (rows, columns, 3) grey light from 0.25 to 0.65, with structure in both directions."""
    rows, columns = np.mgrid[0:ROWS, 0:COLUMNS]
    light = 0.45 + 0.2 * np.sin(columns / 5.0) * np.cos(rows / 4.0)
    return np.repeat(light[..., None], 3, axis=2).astype(np.float32)


def open_before(light: NDArray[np.float32], sensor: str, **changes: Any) -> SimulatedCamera:
    """Return a camera with a preset sensor, some of whose fields are changed."""
    model = Sensor.model_validate({**load_sensor(sensor).model_dump(), **changes})
    controls = model.controls((ROWS, COLUMNS), is_coloured=True, photons_per_unit=1.0)
    assert controls.sensitivity is not None
    photons = 1 / (controls.sensitivity * 0.02 * _FULL_SCALE)
    return SimulatedCamera(Scene("steady", light, photons_per_unit=photons), model, seed=3)
