"""From the light on a sensor to the frame it hands over, tile by tile."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Frame, Pixels
from camctl.controls import ExposureSetting, Layout
from camctl.errors import UsageError
from sim.effects import EFFECTS
from sim.effects.budget import FramePlan, check_tolerance, plan_frame
from sim.effects.charge import bloom
from sim.effects.optics import flicker_lines
from sim.effects.readout import bend_adc
from sim.effects.record import Effect, Shot, Stage, Tile
from sim.noise import TILE, TileNoise
from sim.scenes.scene import Scene
from sim.scenes.view import Light, View, photons_per_unit, sample
from sim.sensors.parts import Curve
from sim.sensors.sensor import Sensor

_MAX_THREADS = 2


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_MAX_THREADS, thread_name_prefix="sim-render")


class Renderer:
    """Renders frames of one sensor before one scene.

    The same seed and frame number give the same frame bit for bit, whatever `threads` is; each
    effect has random bits of its own, so that leaving one out does not change the others.

    Args:
        view: the scene as the sensor sees it, or bare photons a second on each sample
        sensor: see `sim.sensors.sensor.Sensor`
        seed: of all noise and of the sensor's own pattern
        threads: 1 or 2
        tolerance_dn: most that leaving effects out may change in any sample of a frame, before
            the ADC; 0 leaves nothing out
        left_out: leave out just these effects instead, whatever that changes

    Raises:
        UsageError: a seed or a tolerance out of range, an unknown effect
    """

    def __init__(
        self,
        view: View | Light,
        sensor: Sensor,
        *,
        seed: int = 0,
        threads: int = 2,
        tolerance_dn: float = 0.0,
        left_out: Collection[str] | None = None,
    ) -> None:
        if not 0 <= seed < 2**64:
            raise UsageError(f"a seed of {seed}", hint="seeds go from 0 to 2^64 - 1")
        if not isinstance(view, View):
            view = View(view, Layout.RGB if view.ndim == 3 else Layout.MONO)
        self._view = view
        self._sensor = sensor
        self._seed = seed
        self._tolerance_dn = check_tolerance(tolerance_dn)
        self._left_out = left_out
        self._threads = min(max(1, threads), _MAX_THREADS, os.cpu_count() or 1)
        self._curve = Curve.of(sensor.response.levels) if sensor.response is not None else None
        self._memory = threading.local()

    def shot(
        self,
        time_s: float,
        gain: float,
        number: int,
        *,
        start_s: float = 0.0,
        previous_s: float | None = None,
    ) -> Shot:
        """Return an exposure; see `sim.effects.Shot` for its fields."""
        return Shot(self._view, self._sensor, self._seed, time_s, gain, number, start_s, previous_s)

    def plan(self, shot: Shot, *, share: float = 1.0) -> FramePlan:
        """Return which effects a frame has; `share` of the tolerance is this frame's."""
        return plan_frame(shot, self._tolerance_dn * share, left_out=self._left_out)

    def frame(self, time_s: float, gain: float, number: int) -> Pixels:
        """Return the pixels of frame `number`, exposed for `time_s` at linear `gain`.

        (rows, columns) or (rows, columns, 3), uint8 up to 8 bits, else uint16.
        """
        shot = self.shot(time_s, gain, number)
        return self.expose(shot, self.plan(shot))

    def expose(self, shot: Shot, plan: FramePlan) -> Pixels:
        """Return the pixels of a shot with the effects of its plan; shape and dtype as `frame`."""
        pixels: Pixels = np.empty(
            self._view.light.shape, np.uint8 if self._sensor.bits <= 8 else np.uint16
        )
        self._develop(shot, plan, pixels)
        return pixels

    def brightness(self, shot: Shot, plan: FramePlan) -> NDArray[np.float32]:
        """Return what the ADC is given, DN with black and phase, neither floored nor clipped.

        For a sensor with a curve: irradiance, 1 where the curve ends.
        """
        values = np.empty(self._view.light.shape, np.float32)
        self._develop(shot, plan, values)
        return values

    def _develop(self, shot: Shot, plan: FramePlan, out: Pixels | Light) -> None:
        running = [e for e in EFFECTS if plan.runs(e.name)]
        light = self._light(shot, running).reshape(-1)
        for effect in running:
            if effect.lines is not None:
                shot.lines[effect.name] = effect.lines(shot)
        if plan.runs("mains flicker"):
            rows = flicker_lines(shot, rolls=plan.runs("rolling shutter"))
            shot.lines["mains flicker"] = rows, None
        stages: dict[Stage, list[Callable[[Tile], None]]] = {}
        for effect in running:
            stages.setdefault(effect.stage, []).append(effect.apply)
        collect = [*stages.get(Stage.MEAN, []), *stages.get(Stage.CHARGE, [])]
        read = [*stages.get(Stage.WELL, []), *stages.get(Stage.READING, [])]
        flat = out.reshape(-1)
        bows = plan.runs("ADC non-linearity")
        scale = np.float32(shot.electrons_per_photon_s)

        def expose(tile: Tile, here: slice) -> None:
            np.multiply(light[here], scale, out=tile.electrons)
            for work in collect:
                work(tile)

        def finish(tile: Tile, here: slice) -> None:
            for work in read:
                work(tile)
            self._convert(tile, flat[here], bows)

        if not plan.runs("blooming"):
            self._tiles(shot, light.size, (expose, finish))
            return
        charge = np.empty(light.size, np.float32)
        self._tiles(shot, light.size, (expose,), charge)
        bloom(charge.reshape(self._view.planes().shape[:2] + self._view.light.shape[2:]), shot)
        self._tiles(shot, light.size, (finish,), charge)

    def _light(self, shot: Shot, running: list[Effect]) -> Light:
        """Return photons a second on each sample, after all that changes the picture of light."""
        view, names = self._view, {effect.name for effect in running}
        lens = [e for e in running if e.stage is Stage.LENS and e.picture]
        samples = [e for e in running if e.stage is Stage.SAMPLES and e.picture]
        light = view.light
        if lens or view.target is not None:
            planes = view.planes()
            if view.target is not None:
                planes = planes.copy()
                starts = shot.row_starts_s
                if "rolling shutter" not in names:
                    starts = np.full(starts.shape, starts[starts.size // 2])
                view.target.draw(planes, starts, shot.time_s, is_blurred="motion blur" in names)
            for effect in lens:
                assert effect.picture is not None
                planes = effect.picture(planes, shot)
            light = sample(planes, view.layout)
        for effect in samples:
            assert effect.picture is not None
            shape = light.shape if light.ndim > 1 else (1, light.size)
            light = effect.picture(light.reshape(shape), shot)
        return np.ascontiguousarray(light)

    def _tiles(
        self,
        shot: Shot,
        size: int,
        steps: tuple[Callable[[Tile, slice], None], ...],
        charge: Light | None = None,
    ) -> None:
        """Do `steps` on all tiles; their electrons lie in `charge` where they are to be kept."""
        tiles = math.ceil(size / TILE)

        def run(first: int) -> None:
            for index in range(first, tiles, self._threads):
                start = index * TILE
                here = slice(start, min(start + TILE, size))
                noise, memory = self._working()
                electrons = memory[: here.stop - start] if charge is None else charge[here]
                tile = Tile(shot, electrons, start, index, noise)
                for step in steps:
                    step(tile, here)

        _spread(run, min(self._threads, tiles))

    def _working(self) -> tuple[TileNoise, Light]:
        if not hasattr(self._memory, "noise"):
            self._memory.noise = TileNoise()
            self._memory.electrons = np.empty(TILE, dtype=np.float32)
        return self._memory.noise, self._memory.electrons

    def _convert(self, tile: Tile, out: Pixels | Light, bows: bool) -> None:
        """Turn charge into brightness, or into what the ADC is given where `out` is float."""
        sensor, shot, electrons = self._sensor, tile.shot, tile.electrons
        is_analogue = out.dtype == np.float32
        if self._curve is not None:
            np.multiply(electrons, np.float32(shot.gain / sensor.full_scale_e), out=electrons)
            if is_analogue:
                np.copyto(out, electrons)
                return
            brightness = self._curve.brightness(electrons)
            np.add(brightness, sensor.black, out=out, casting="unsafe")
            return
        np.multiply(electrons, np.float32(shot.gain / sensor.electrons_per_dn), out=electrons)
        if bows:
            bend_adc(electrons, shot)
        if offset := sensor.black + sensor.phase:
            np.add(electrons, np.float32(offset), out=electrons)
        if is_analogue:
            np.copyto(out, electrons)
            return
        # Nothing is negative after clipping, so the cast that cuts off is a floor.
        np.clip(electrons, np.float32(0), np.float32(2**sensor.bits - 1), out=electrons)
        np.copyto(out, electrons, casting="unsafe")


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
    start_s: float = 0.0,
    tolerance_dn: float = 0.0,
    left_out: Collection[str] | None = None,
) -> Frame:
    """Return one frame of `sensor` before `scene`, without a camera around it.

    The first frame of a bracket has `number` 0; frames of other numbers have other noise.  See
    `Renderer` for the other arguments.

    Raises:
        UsageError, RefusedSettingError: the sensor cannot do that exposure
    """
    controls = sensor.controls(
        scene.shape,
        is_coloured=scene.is_coloured,
        photons_per_unit=photons_per_unit(scene, sensor),
    )
    requested = ExposureSetting(time_s, gain)
    controls.check(requested)
    applied = ExposureSetting(controls.time_s.nearest(time_s), controls.gain.nearest(gain))
    renderer = Renderer(
        View.of(scene, sensor),
        sensor,
        seed=seed,
        threads=threads,
        tolerance_dn=tolerance_dn,
        left_out=left_out,
    )
    shot = renderer.shot(applied.time_s, applied.gain, number, start_s=start_s)
    return Frame(
        pixels=renderer.expose(shot, renderer.plan(shot)),
        requested=requested,
        applied=applied,
        timestamp_s=start_s + applied.time_s,
        index=number,
        black=controls.black,
        white=controls.white,
    )
