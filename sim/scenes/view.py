"""The light that a sensor sees of a scene, and the statistics of it that bounds need."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.interface.controls import Layout
from camctl.sim.scenes.drawings import Drawing
from camctl.sim.scenes.motion import Lamps, PwmLamps, Target
from camctl.sim.scenes.scene import PHOTONS, Scene
from camctl.sim.sensors.sensor import Sensor

Light = NDArray[np.float32]

_LUMINANCE_WEIGHTS = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)  # ITU-R BT.709
_CHANNEL = {"r": 0, "g": 1, "b": 2}
_MOST_PHOTONS_S = np.float32(1e25)  # saturates every exposure, and products stay within float32
_BAND_ROWS = 256  # taken at a time, so that statistics need little memory
_ROUNDING_SHARE = 2.0**-20  # more than the rounding of differences and products in float32


def sample(planes: Light, layout: Layout) -> Light:
    """Return what the samples of a sensor see of a picture: in a mosaic one colour a pixel."""
    if planes.ndim == 2 or not layout.is_mosaic:
        return planes
    mosaic = np.empty(planes.shape[:2], dtype=np.float32)
    for place, letter in enumerate(layout.value):
        row, column = divmod(place, 2)
        mosaic[row::2, column::2] = planes[row::2, column::2, _CHANNEL[letter]]
    return mosaic


def photons_per_unit(scene: Scene, sensor: Sensor) -> float:
    """Return photons a pixel a second for one unit of the scene's irradiance."""
    if scene.unit == PHOTONS:
        return scene.photons_per_unit
    return scene.photons_per_unit * sensor.photons_per_candela


def _sensor_colours(light: Light, layout: Layout, sensor: Sensor) -> Light:
    """Return light as the sensor's colours see it: luminance if mono, else by its spectrum."""
    if light.ndim == 2:
        return light
    if layout is Layout.MONO:
        return np.asarray(light @ _LUMINANCE_WEIGHTS)
    if sensor.spectrum is not None:
        return np.asarray(light @ np.array(sensor.spectrum, dtype=np.float32).T)
    return light


def _photons_s(light: Light, scale: float, out: Light | None = None) -> Light:
    """Return ``light * scale``, limited to what no float32 overflows with; `out`: where to."""
    if scale > float(_MOST_PHOTONS_S):  # may be beyond float32 itself
        product = light * np.float64(scale)
        return np.minimum(product, float(_MOST_PHOTONS_S)).astype(np.float32)
    with np.errstate(over="ignore"):
        photons: Light = np.ascontiguousarray(np.multiply(light, np.float32(scale), out=out))
    return np.minimum(photons, _MOST_PHOTONS_S, out=photons)


@dataclass(frozen=True)
class Statistics:
    """Statistics of a scene's light, in photons a sample a second.

    Attributes:
        least, most: of all light, a moving target included
        bend: largest second difference along rows plus the largest along columns, borders
            mirrored
        slopes: largest first difference from row to row, and from column to column
        drift: largest change of light if the target moves by one pixel; 0 without a target
        speed_px_s: of the target
        height: rows of the picture
        is_mosaic: neighbouring samples see different colours
    """

    least: float
    most: float
    bend: float
    slopes: tuple[float, float] = (0.0, 0.0)
    drift: float = 0.0
    speed_px_s: float = 0.0
    height: int = 1
    is_mosaic: bool = False


@dataclass(frozen=True, eq=False)
class View:
    """A scene as one sensor sees it.

    Attributes:
        light: photons a second on each sample, without a moving target: (rows, columns), or
            (rows, columns, 3) for the layout RGB
        layout: pixel layout of the samples
        source: the scene and the sensor; None if there is nothing but `light`
    """

    light: Light
    layout: Layout = Layout.MONO
    source: tuple[Scene, Sensor] | None = None

    @classmethod
    def of(cls, scene: Scene, sensor: Sensor) -> View:
        """Return the view of `sensor` in front of `scene`.

        A mono sensor sees luminance (Rec. 709), a mosaic one channel a pixel, RGB all three; a grey
        scene is the same in each.
        """
        layout = sensor.layout_for(scene.is_coloured)

        def sampled(light: Light) -> Light:
            return sample(_sensor_colours(light, layout, sensor), layout)

        # The light in front of a mosaic is needed later; of another drawing only what is seen.
        drawing, scale = scene.picture, photons_per_unit(scene, sensor)
        if isinstance(drawing, Drawing) and not (layout.is_mosaic and scene.is_coloured):
            light = drawing.drawn(sampled)
            light = _photons_s(light, scale, out=light)
        else:
            light = _photons_s(sampled(scene.irradiance), scale)
        if light.ndim == 2 and layout is Layout.RGB:
            light = np.repeat(light[..., np.newaxis], 3, axis=2)
        return cls(light, layout, (scene, sensor))

    @property
    def lamps(self) -> Lamps | PwmLamps | None:
        """The scene's lamps, if they are not steady."""
        return self.source[0].lamps if self.source else None

    @property
    def has_colours_before_mosaic(self) -> bool:
        """Whether `planes` has three colours a pixel, and `light` one."""
        return self.source is not None and self.layout.is_mosaic and self.source[0].is_coloured

    def planes(self) -> Light:
        """Return the light in front of the colour mosaic, (rows, columns[, 3]); do not write."""
        if self.source is not None and self.has_colours_before_mosaic:
            scene, sensor = self.source
            light = _sensor_colours(scene.irradiance, self.layout, sensor)
            return _photons_s(light, photons_per_unit(scene, sensor))
        return self.light if self.light.ndim > 1 else self.light[np.newaxis]

    @cached_property
    def target(self) -> Target | None:
        """The scene's moving target, if any, in photons a second."""
        if self.source is None or self.source[0].target is None:
            return None
        scene, sensor = self.source
        target, planes = self.source[0].target, self.planes()
        light = _sensor_colours(target.light, self.layout, sensor)
        if planes.ndim == 2 and light.ndim == 3:
            light = np.asarray(light @ _LUMINANCE_WEIGHTS)
        if planes.ndim == 3 and light.ndim == 2:
            light = np.repeat(light[..., np.newaxis], 3, axis=2)
        return target.scaled(_photons_s(light, photons_per_unit(scene, sensor)))

    @cached_property
    def column_means(self) -> NDArray[np.float64]:
        """Mean light of each sample of a row over all rows, (width,), computed once."""
        rows = self.light.shape[0] if self.light.ndim > 1 else 1
        return np.asarray(np.mean(self.light.reshape(rows, -1), axis=0, dtype=np.float64))

    @cached_property
    def statistics(self) -> Statistics:
        """Statistics of the light, computed once."""
        planes = self.planes()
        least, most = float(planes.min()), float(planes.max())
        bend, slopes = _largest_differences(planes)
        target = self.target
        drift = speed = 0.0
        if target is not None:
            lit, covered = target.slopes
            drift, speed = lit + covered * most, abs(target.velocity_px_s)
            least, most = min(least, float(target.light.min())), max(most, target.most)
            # A target that is sheared by its motion has no smaller limit that is certain.
            bend = 4 * (most - least)
            slopes = (most - least, most - least)
        # Upwards by the rounding of the statistics themselves: they must not be too small.
        bend = bend * (1 + _ROUNDING_SHARE) + 8 * _ROUNDING_SHARE * most
        slopes = (slopes[0] + 8 * _ROUNDING_SHARE * most, slopes[1] + 8 * _ROUNDING_SHARE * most)
        drift *= 1 + _ROUNDING_SHARE
        mosaic = self.layout.is_mosaic and planes.ndim == 3
        return Statistics(least, most, bend, slopes, drift, speed, planes.shape[0], mosaic)


def _largest_differences(planes: Light) -> tuple[float, tuple[float, float]]:
    """Return `Statistics.bend` and `Statistics.slopes`."""
    along = across = 0.0
    down = right = 0.0
    rows = planes.shape[0]
    for top in range(0, rows, _BAND_ROWS):
        band = planes[max(0, top - 1) : min(rows, top + _BAND_ROWS + 1)]
        slope = np.diff(band, axis=1)
        if slope.size:
            ends = max(_largest(slope[:, 0]), _largest(slope[:, -1]))
            along = max(along, ends, _largest(np.diff(slope, axis=1)))
            right = max(right, _largest(slope))
        slope = np.diff(band, axis=0)
        if slope.size:
            across = max(across, _largest(np.diff(slope, axis=0)))
            down = max(down, _largest(slope))
            if top == 0:
                across = max(across, _largest(slope[0]))
            if top + _BAND_ROWS >= rows:
                across = max(across, _largest(slope[-1]))
    return along + across, (down, right)


def _largest(values: Light) -> float:
    """Return the largest absolute value; 0 without values."""
    if values.size == 0:
        return 0.0
    return float(max(values.max(), -values.min()))
