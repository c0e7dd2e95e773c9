"""Captures of a known scene, and what they say about accuracy: effective levels and coverage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from camctl.captures.sequencer import capture
from camctl.exposure.goal import CaptureRequest
from camctl.interface.controls import Layout
from camctl.model.response.desired import desired_response
from camctl.pictures.mosaic import colour_of
from camctl.pictures.render import FULL_CODE, HOT, SATURATED
from camctl.profiles.calibrated import with_profile
from camctl.records.report import CaptureReport
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.parts import Lens
from camctl.sim.sensors.sensor import Sensor, load_sensor

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)

#: Standard deviations that contain 68 % and 95 % of a normal variable.
DEVIATIONS = (0.99446, 1.95996)
NOMINAL = (0.68, 0.95)
#: Irradiance from which, up to full scale, light is near saturation.
NEAR_SATURATION = 0.97


def sensor_without_lens(name: str) -> Sensor:
    """Return a sensor preset behind a perfect lens.

    Vignetting, glare and blur change the light itself: no exposure predicts them.
    """
    return load_sensor(name).model_copy(update={"lens": Lens()})


def even_ramp(rows: int, columns: int) -> NDArray[np.float64]:
    """Return u, even from 0 to 1, rising along the rows."""
    return (np.arange(columns) + (np.arange(rows)[:, np.newaxis] + 0.5) / rows) / columns


RAMP_COLUMNS = 400
SEED = 1
"""Of the cameras that shoot ramps: pixels differ from camera to camera, as the seed says."""


def ramp_base_s(sensor: Sensor) -> float:
    """Return the exposure that full scale takes; light at full scale needs it."""
    # A line is the step of the shutter: the ratios should be exact to 1 %.
    return sensor.times.nearest(min(max(0.02, 90 * sensor.line_s), sensor.time_maximum_s / 88.5))


def shoot_ramp(
    sensor: Sensor,
    response: str,
    dynamic_range: float,
    ratios: tuple[float, ...],
    rows: int = 300,
    *,
    is_unknown: bool = False,
) -> tuple[CaptureReport, float]:
    """Return a capture of a scene that is even in u, and the effective levels measured in it.

    With `is_unknown` the camera states little, and what its profile has is used.
    """
    desired = desired_response(response, dynamic_range)
    u = even_ramp(rows, RAMP_COLUMNS)
    base_s = ramp_base_s(sensor)
    full_scale = sensor.full_scale_e / sensor.quantum_efficiency / base_s
    scene = Scene("ramp", (desired.inverse(u) * full_scale).astype(np.float32))
    request = CaptureRequest(response, dynamic_range, len(ratios), ratios=ratios, base_s=base_s)
    with SimulatedCamera(scene, sensor, seed=SEED, is_unknown=is_unknown) as camera:
        report = capture(with_profile(camera) if is_unknown else camera, request)
    error = measured_samples(report.image(), report.layout) / FULL_CODE - u
    return report, float((12 * np.mean(error**2)) ** -0.5)


def measured_samples(image: NDArray[np.uint16], layout: Layout) -> NDArray[np.uint16]:
    """Return the samples of an image that are not interpolated, (rows, columns); green of RGB."""
    if not layout.is_mosaic:
        return image if image.ndim == 2 else image[..., 1]
    found = np.empty(image.shape[:2], np.uint16)
    for row in (0, 1):
        for column in (0, 1):
            channel = colour_of(layout, row, column)
            found[row::2, column::2] = image[row::2, column::2, channel]
    return found


@dataclass(frozen=True, eq=False)
class Errors:
    """Samples of a radiance map whose light is in the desired range, neither saturated nor hot.

    Attributes:
        E: the scene's irradiance at each, 1 at full scale
        size: |error| of the map over its standard deviation
    """

    E: NDArray[np.float64]
    size: NDArray[np.float64]

    def shares(self, part: NDArray[np.bool_]) -> tuple[float, float]:
        """Return the shares of a part that lie within the 68 % and the 95 % interval."""
        one, two = (float(np.mean(self.size[part] < limit)) for limit in DEVIATIONS)
        return one, two

    def parts(self) -> dict[str, NDArray[np.bool_]]:
        """Return all samples, and those of the darkest and brightest fifth of the irradiances."""
        dark, bright = np.quantile(self.E, (0.2, 0.8))
        return {
            "all": np.ones(self.E.size, bool),
            "darkest fifth": dark >= self.E,
            "brightest fifth": bright <= self.E,
        }


def radiance_errors(
    scene: Scene, sensor: Sensor, request: CaptureRequest, stops: Sequence[float] = (0.0,)
) -> Errors:
    """Return the errors of the radiance of captures that are longer by these numbers of stops."""
    found = []
    for seed, shift in enumerate(stops):
        with SimulatedCamera(scene, sensor, seed=seed) as camera:
            report = capture(camera, replace(request, compensation_stops=shift))
        radiance, deviation, mask = (
            np.atleast_3d(part)
            for part in (report.radiance(), report.standard_deviation(), report.mask())
        )
        truth = scene.irradiance
        if scene.is_coloured and radiance.shape[2] == 1:
            truth = truth @ LUMINANCE
        truth = np.broadcast_to(np.atleast_3d(truth), radiance.shape)
        E = truth.astype(np.float64) * report.irradiance.full_scale_exposure
        # The truth decides which samples are in range: left out for what they measured, those with
        # large errors would be missing.
        unknown = (mask.astype(np.uint8) & (SATURATED | HOT)) != 0
        inside = ~unknown & (1 / report.plan.dynamic_range <= E) & (E < 1)
        size = np.abs(radiance[inside] - truth[inside].astype(np.float64)) / deviation[inside]
        found.append((E[inside], size))
    irradiances, sizes = zip(*found, strict=True)
    return Errors(np.concatenate(irradiances), np.concatenate(sizes))
