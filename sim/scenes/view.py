"""The light that a sensor sees of a scene, and the few numbers that say what it can do there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.controls import Layout
from sim.scenes.motion import Lamps, Target
from sim.scenes.scene import LUMINANCE, Scene
from sim.sensors.sensor import Sensor

Light = NDArray[np.float32]

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)  # ITU-R BT.709
_CHANNEL = {"r": 0, "g": 1, "b": 2}
_BLINDING = np.float32(1e25)  # photons a second: saturates any exposure, overflows none
_BAND = 256  # rows at a time, so that statistics need little memory
_ROUNDED = 2.0**-20


def sample(planes: Light, layout: Layout) -> Light:
    """Return what a sensor's samples see of planes: a mosaic takes one colour a pixel."""
    if planes.ndim == 2 or not layout.is_mosaic:
        return planes
    mosaic = np.empty(planes.shape[:2], dtype=np.float32)
    for place, letter in enumerate(layout.value):
        row, column = divmod(place, 2)
        mosaic[row::2, column::2] = planes[row::2, column::2, _CHANNEL[letter]]
    return mosaic


def light_on(scene: Scene, layout: Layout, *, sensor: Sensor | None = None) -> Light:
    """Return photons a second on each sample of a sensor: (rows, columns) or (rows, columns, 3).

    Mono sees luminance (Rec. 709), a mosaic one channel a pixel, RGB all three; a grey scene is the
    same in each.  `sensor` matters for its spectrum, and for a scene in candela.
    """
    light = _in_sensors_colours(scene.irradiance, layout, sensor)
    light = sample(light, layout)
    if light.ndim == 2 and layout is Layout.RGB:
        light = np.repeat(light[..., np.newaxis], 3, axis=2)
    return _photons(light, photons_per_unit(scene, sensor))


def photons_per_unit(scene: Scene, sensor: Sensor | None) -> float:
    """Return photons a pixel a second for one unit of the scene's irradiance."""
    if scene.unit == LUMINANCE and sensor is not None:
        return scene.photons_per_unit * sensor.photons_per_candela
    return scene.photons_per_unit


def _in_sensors_colours(light: Light, layout: Layout, sensor: Sensor | None) -> Light:
    if light.ndim == 2:
        return light
    if layout is Layout.MONO:
        return np.asarray(light @ _LUMINANCE)
    if sensor is not None and sensor.spectrum is not None:
        return np.asarray(light @ np.array(sensor.spectrum, dtype=np.float32).T)
    return light


def _photons(light: Light, scale: float) -> Light:
    if scale > float(_BLINDING):  # a map in units so large that the scale itself is beyond float32
        return np.minimum(light * np.float64(scale), float(_BLINDING)).astype(np.float32)
    with np.errstate(over="ignore"):
        photons = np.ascontiguousarray(light * np.float32(scale))
    return np.minimum(photons, _BLINDING, out=photons)


@dataclass(frozen=True)
class Statistics:
    """What bounds need to know of a scene, in photons a sample a second.

    Attributes:
        least, most: of all the light, a moving target's included
        bend: largest second difference along rows plus that along columns, borders mirrored
        drift: most that light changes where the target moves by one pixel; 0 without one
        speed_px_s: of the target
        height: rows of the picture
        is_mosaic: neighbouring samples see different colours
    """

    least: float
    most: float
    bend: float
    drift: float = 0.0
    speed_px_s: float = 0.0
    height: int = 1
    is_mosaic: bool = False


@dataclass(frozen=True, eq=False)
class View:
    """A scene as one sensor sees it.

    Attributes:
        light: photons a second on each sample, what stands still of the scene
        layout: of the samples
        behind: the scene and the sensor; None where there is nothing but `light`
    """

    light: Light
    layout: Layout = Layout.MONO
    behind: tuple[Scene, Sensor] | None = None

    @classmethod
    def of(cls, scene: Scene, sensor: Sensor) -> View:
        """Return the view of `sensor` before `scene`."""
        layout = sensor.layout_for(scene.is_coloured)
        return cls(light_on(scene, layout, sensor=sensor), layout, (scene, sensor))

    @property
    def lamps(self) -> Lamps | None:
        """The scene's lamps, where they flicker."""
        return self.behind[0].lamps if self.behind else None

    def planes(self) -> Light:
        """Return the light before the colour mosaic: not to be changed."""
        if self.behind and self.layout.is_mosaic and self.behind[0].is_coloured:
            scene, sensor = self.behind
            light = _in_sensors_colours(scene.irradiance, self.layout, sensor)
            return _photons(light, photons_per_unit(scene, sensor))
        return self.light if self.light.ndim > 1 else self.light[np.newaxis]

    @cached_property
    def target(self) -> Target | None:
        """What moves before the scene, in photons a second."""
        if self.behind is None or self.behind[0].target is None:
            return None
        scene, sensor = self.behind
        target, planes = self.behind[0].target, self.planes()
        light = _in_sensors_colours(target.light, self.layout, sensor)
        if planes.ndim == 2 and light.ndim == 3:
            light = np.asarray(light @ _LUMINANCE)
        if planes.ndim == 3 and light.ndim == 2:
            light = np.repeat(light[..., np.newaxis], 3, axis=2)
        return target.scaled(_photons(light, photons_per_unit(scene, sensor)))

    @cached_property
    def statistics(self) -> Statistics:
        """The scene's statistics; one pass over its light, once."""
        planes = self.planes()
        least, most = float(planes.min()), float(planes.max())
        bend = _bend(planes)
        target = self.target
        drift = speed = 0.0
        if target is not None:
            lit, covered = target.slopes
            drift, speed = lit + covered * most, abs(target.velocity_px_s)
            least, most = min(least, float(target.light.min())), max(most, target.most)
            # Of a shape that is sheared by its motion nothing better is known.
            bend = 4 * (most - least)
        rows = planes.shape[0]
        mosaic = self.layout.is_mosaic and planes.ndim == 3
        # The numbers themselves are rounded; they must not be too small.
        bend = bend * (1 + _ROUNDED) + 8 * _ROUNDED * most if bend else 8 * _ROUNDED * most
        drift *= 1 + _ROUNDED
        return Statistics(least, most, bend, drift, speed, rows, mosaic)


def _bend(planes: Light) -> float:
    """Return the largest |second difference| along rows plus along columns, borders mirrored."""
    along = across = 0.0
    rows = planes.shape[0]
    for top in range(0, rows, _BAND):
        band = planes[max(0, top - 1) : min(rows, top + _BAND + 1)]
        slope = np.diff(band, axis=1)
        if slope.size:
            ends = max(_largest(slope[:, 0]), _largest(slope[:, -1]))
            along = max(along, ends, _largest(np.diff(slope, axis=1)))
        slope = np.diff(band, axis=0)
        if slope.size:
            across = max(across, _largest(np.diff(slope, axis=0)))
            if top == 0:
                across = max(across, _largest(slope[0]))
            if top + _BAND >= rows:
                across = max(across, _largest(slope[-1]))
    return along + across


def _largest(values: Light) -> float:
    if values.size == 0:
        return 0.0
    return float(max(values.max(), -values.min()))
