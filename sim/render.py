"""From the light on a sensor to the frame it hands over, tile by tile."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camctl.camera import ExposureSetting, Frame, Layout, Pixels
from camctl.errors import UsageError
from sim.noise import TILE, TileNoise
from sim.scene import Scene
from sim.sensor import Sensor

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)  # ITU-R BT.709
_CHANNEL = {"r": 0, "g": 1, "b": 2}
_BLINDING = np.float32(1e25)  # photons a second: saturates any exposure, overflows none
_NO_LIMIT = np.float32(-3e38)
_MAX_THREADS = 2
_CURVE_BINS = 1 << 14


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_MAX_THREADS, thread_name_prefix="sim-render")


def light_on(scene: Scene, layout: Layout) -> NDArray[np.float32]:
    """Return photons a second on each sample of a sensor: (rows, columns) or (rows, columns, 3).

    Mono sees luminance (Rec. 709), a mosaic one channel a pixel, RGB all three; a grey scene is the
    same in each.
    """
    light = scene.irradiance
    if scene.is_coloured and layout is Layout.MONO:
        light = light @ _LUMINANCE
    elif scene.is_coloured and layout.is_mosaic:
        mosaic = np.empty(scene.shape, dtype=np.float32)
        for place, letter in enumerate(layout.value):
            row, column = divmod(place, 2)
            mosaic[row::2, column::2] = light[row::2, column::2, _CHANNEL[letter]]
        light = mosaic
    elif not scene.is_coloured and layout is Layout.RGB:
        light = np.repeat(light[..., np.newaxis], 3, axis=2)
    scale = scene.photons_per_unit
    if scale > float(_BLINDING):  # a map in units so large that the scale itself is beyond float32
        return np.minimum(light * np.float64(scale), float(_BLINDING)).astype(np.float32)
    with np.errstate(over="ignore"):
        photons = np.ascontiguousarray(light * np.float32(scale))
    return np.minimum(photons, _BLINDING, out=photons)


@dataclass(frozen=True, eq=False)
class _Curve:
    """Levels of a non-linear response, found by a bin and then by comparing: exact and fast."""

    levels_below: NDArray[np.uint16]
    next_level: NDArray[np.float32]
    most_in_bin: int

    @classmethod
    def of(cls, levels: NDArray[np.float64]) -> _Curve:
        edges = np.arange(_CURVE_BINS + 1) / _CURVE_BINS
        # float32 levels here and float32 irradiance there: one rounding decides on both sides.
        rounded = levels.astype(np.float32)
        below = np.searchsorted(rounded, edges.astype(np.float32), side="right")
        ahead = np.append(rounded, np.float32(np.inf))
        return cls(below[:-1].astype(np.uint16), ahead, int(np.diff(below).max()))

    def brightness(self, irradiance: NDArray[np.float32]) -> NDArray[np.uint16]:
        """Return how many levels are <= each irradiance (clipped to 0..1)."""
        inside = np.clip(irradiance, 0, np.float32(1))
        place = np.minimum((inside * np.float32(_CURVE_BINS)).astype(np.intp), _CURVE_BINS - 1)
        count = self.levels_below[place]
        for _ in range(self.most_in_bin):
            count += inside >= self.next_level[count]
        return count


class Renderer:
    """Renders frames of one sensor before one scene.

    The same seed and frame number give the same frame bit for bit, whatever `threads` is.
    """

    def __init__(
        self, light: NDArray[np.float32], sensor: Sensor, *, seed: int = 0, threads: int = 2
    ) -> None:
        if not 0 <= seed < 2**64:
            raise UsageError(f"a seed of {seed}", hint="seeds go from 0 to 2^64 - 1")
        self._light = light.reshape(-1)
        self._shape = light.shape
        self._sensor = sensor
        self._seed = seed
        self._threads = min(max(1, threads), _MAX_THREADS, os.cpu_count() or 1)
        self._curve = _Curve.of(sensor.response.levels) if sensor.response is not None else None
        self._memory = threading.local()

    def frame(self, time_s: float, gain: float, number: int) -> Pixels:
        """Return the pixels of frame `number`, exposed for `time_s` at linear `gain`.

        (rows, columns) or (rows, columns, 3), uint8 up to 8 bits, else uint16.
        """
        size = self._light.size
        pixels: Pixels = (
            np.empty(size, np.uint8) if self._sensor.bits <= 8 else np.empty(size, np.uint16)
        )
        electrons_per_photon_s = self._sensor.quantum_efficiency * time_s
        tiles = math.ceil(pixels.size / TILE)

        def run(first: int) -> None:
            for tile in range(first, tiles, self._threads):
                here = slice(tile * TILE, (tile + 1) * TILE)
                self._tile(
                    pixels[here], self._light[here], electrons_per_photon_s, gain, number, tile
                )

        _spread(run, min(self._threads, tiles))
        return pixels.reshape(self._shape)

    def _working(self) -> tuple[TileNoise, NDArray[np.float32]]:
        if not hasattr(self._memory, "noise"):
            self._memory.noise = TileNoise()
            self._memory.electrons = np.empty(TILE, dtype=np.float32)
        return self._memory.noise, self._memory.electrons

    def _tile(
        self,
        pixels: NDArray[np.uint8] | NDArray[np.uint16],
        light: NDArray[np.float32],
        electrons_per_photon_s: float,
        gain: float,
        number: int,
        tile: int,
    ) -> None:
        sensor = self._sensor
        noise, memory = self._working()
        electrons = memory[: light.size]
        np.multiply(light, np.float32(electrons_per_photon_s), out=electrons)
        if sensor.photon_noise:
            noise.add_photon_noise(electrons, self._seed, number, tile)
        # clip with a lower end that nothing reaches: numpy's minimum takes twice as long.
        np.clip(electrons, _NO_LIMIT, np.float32(sensor.full_well_e), out=electrons)
        if sensor.read_noise_e:
            noise.add_read_noise(electrons, sensor.read_noise_e, self._seed, number, tile)
        if self._curve is not None:
            np.multiply(electrons, np.float32(gain / sensor.full_scale_e), out=electrons)
            brightness = self._curve.brightness(electrons)
            np.add(brightness, sensor.black, out=pixels, casting="unsafe")
            return
        np.multiply(electrons, np.float32(gain / sensor.electrons_per_dn), out=electrons)
        if offset := sensor.black + sensor.phase:
            np.add(electrons, np.float32(offset), out=electrons)
        # Nothing is negative after clipping, so the cast that cuts off is a floor.
        np.clip(electrons, np.float32(0), np.float32(2**sensor.bits - 1), out=electrons)
        np.copyto(pixels, electrons, casting="unsafe")


def _spread(run: Callable[[int], None], threads: int) -> None:
    """Call run(0) .. run(threads - 1), side by side; the caller's thread takes one of them."""
    others = [_pool().submit(run, index) for index in range(1, threads)]
    run(0)
    for other in others:
        other.result()


def simulate_frame(
    scene: Scene,
    sensor: Sensor,
    time_s: float,
    *,
    gain: float = 1.0,
    seed: int = 0,
    number: int = 0,
    threads: int = 2,
) -> Frame:
    """Return one frame of `sensor` before `scene`, without a camera around it.

    The first frame of a bracket has `number` 0; frames of other numbers have other noise.

    Raises:
        UsageError, RefusedSettingError: the sensor cannot do that exposure
    """
    controls = sensor.controls(
        scene.shape, is_coloured=scene.is_coloured, photons_per_unit=scene.photons_per_unit
    )
    requested = ExposureSetting(time_s, gain)
    controls.check(requested)
    applied = ExposureSetting(controls.time_s.nearest(time_s), controls.gain.nearest(gain))
    light = light_on(scene, controls.layout)
    renderer = Renderer(light, sensor, seed=seed, threads=threads)
    return Frame(
        pixels=renderer.frame(applied.time_s, applied.gain, number),
        requested=requested,
        applied=applied,
        timestamp_s=applied.time_s,
        index=number,
        black=controls.black,
        white=controls.white,
    )
