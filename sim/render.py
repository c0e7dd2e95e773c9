"""Frames of a simulated sensor: from the light on it to pixels, tile by tile."""

from __future__ import annotations

import math
import os
import time
from collections import defaultdict
from collections.abc import Callable, Hashable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.interface.camera import Pixels
from camctl.sim.compiled import KernelChoice
from camctl.sim.effects import EFFECTS
from camctl.sim.effects.budget import FramePlan, check_tolerance, plan_frame
from camctl.sim.effects.record import Effect, RowTiming, Shot, Stage, Tile
from camctl.sim.frame_cache import CACHE_BYTES, FrameCache
from camctl.sim.noise import TILE, TileNoise
from camctl.sim.scenes.view import Light, View, sample
from camctl.sim.sensors.curve import LevelLookup
from camctl.sim.sensors.sensor import Sensor

_MAX_THREADS = 2  # measured, see `camctl.sim.noise.TILE`

#: Plans that are kept: more than a capture has exposures.
_PLANS = 64

#: Effects whose change is another one in each frame of an exposure.
_VARYING = tuple((effect, effect.varies) for effect in EFFECTS if effect.varies)

TileWork = Callable[[Tile], None]


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(_MAX_THREADS, thread_name_prefix="sim-render")


@dataclass(frozen=True)
class Comparison:
    """A frame against the same one with every effect, with the same random numbers.

    Attributes:
        largest_dn: largest difference of a sample before the ADC (of a sensor with a curve: behind
            it), DN
        mean_dn: mean difference over all samples, DN
        seconds, everything_s: time to render the frame, and to render it with every effect; the
            shorter of two runs each, so that what is kept between frames has been computed
    """

    largest_dn: float
    mean_dn: float
    seconds: float
    everything_s: float


class Renderer:
    """Renders frames of one sensor in front of one scene.

    The same seed and frame number give the same frame bit for bit, whatever `threads` is.  Each
    effect has its own random bits, so that leaving one out does not change the others.

    Args:
        view: the scene as the sensor sees it
        sensor: see `camctl.sim.sensors.sensor.Sensor`
        seed: of all noise and of the sensor's fixed patterns
        threads: 1 or 2
        tolerance_dn: largest allowed change of any sample of a frame before the ADC by leaving
            effects out; 0 leaves out only what changes no bit
        cache_bytes: memory for what is the same in every frame: the light of a scene without a
            moving target behind the lens, PRNU, DSNU and hot pixels; frames do not depend on it
        compiled: whether the functions of `camctl.sim.compiled` are used, see `LoadedLater`;
            frames do not depend on it

    Raises:
        UsageError: a seed or a tolerance out of range
    """

    def __init__(
        self,
        view: View,
        sensor: Sensor,
        *,
        seed: int = 0,
        threads: int = 2,
        tolerance_dn: float = 0.0,
        cache_bytes: int = CACHE_BYTES,
        compiled: bool | None = None,
    ) -> None:
        if not 0 <= seed < 2**64:
            raise UsageError(f"invalid seed {seed}", hint="expected 0 to 2^64 - 1")
        self._view = view
        self._sensor = sensor
        self._seed = seed
        self._tolerance_dn = check_tolerance(tolerance_dn)
        self._threads = min(max(1, threads), _MAX_THREADS, os.cpu_count() or 1)
        response = sensor.response
        self._curve = LevelLookup.of(response.levels) if response is not None else None
        self._cache = FrameCache(cache_bytes)
        self._plans: dict[Hashable, FramePlan] = {}
        self._kernels = KernelChoice(compiled)

    def shot(
        self,
        time_s: float,
        gain: float,
        number: int,
        *,
        start_s: float = 0.0,
        previous_s: float | None = None,
    ) -> Shot:
        """Return an exposure; see `camctl.sim.effects.record.Shot` for the arguments."""
        return Shot(self._view, self._sensor, self._seed, time_s, gain, number, start_s, previous_s)

    def plan(self, shot: Shot, *, share: float = 1.0) -> FramePlan:
        """Return which effects a frame has if it may use `share` of the tolerance.

        It is decided once for an exposure, as far as effects do not vary from frame to frame.
        """
        varying = tuple(change(shot) for effect, change in _VARYING if effect.present(shot))
        key = (shot.time_s, shot.gain, shot.lag_ratio, share, varying)
        plan = self._plans.get(key)
        if plan is None:
            if len(self._plans) >= _PLANS:
                self._plans.clear()
            plan = self._plans[key] = plan_frame(shot, self._tolerance_dn * share)
        return plan

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
        self._render(shot, plan, pixels)
        return pixels

    def brightness(self, shot: Shot, plan: FramePlan) -> NDArray[np.float32]:
        """Return the input of the ADC: DN with black level and phase, not floored and not clipped.

        For a sensor with a response curve it is irradiance, 1 at the end of the curve.
        """
        values = np.empty(self._view.light.shape, np.float32)
        self._render(shot, plan, values)
        return values

    def compare(self, shot: Shot, plan: FramePlan) -> Comparison:
        """Render a shot with its plan and with every effect, and return what differs."""
        everything = plan_frame(shot, 0.0, left_out=())
        is_linear = self._curve is None
        render = self.brightness if is_linear else self.expose
        pictures: list[NDArray[np.float64]] = []
        seconds = [math.inf, math.inf]
        for _ in range(2):  # the first frames also fill the cache
            pictures.clear()
            for place, one in enumerate((everything, plan)):
                started = time.perf_counter()
                picture = render(shot, one)
                seconds[place] = min(seconds[place], time.perf_counter() - started)
                pictures.append(picture.astype(np.float64))
        off = pictures[1] - pictures[0]
        return Comparison(float(np.abs(off).max()), float(off.mean()), seconds[1], seconds[0])

    def _render(self, shot: Shot, plan: FramePlan, out: Pixels | Light) -> None:
        running = [effect for effect in EFFECTS if plan.runs(effect.name)]
        timing = shot.global_timing
        for effect in running:
            if effect.timing is not None:
                timing = effect.timing(timing, shot)
        light = self._light(shot, running, timing).reshape(-1)
        work = _tile_work(shot, running, timing)
        collecting = work[Stage.MEAN] + work[Stage.CHARGE]
        reading = work[Stage.WELL] + work[Stage.READING]
        converting = work[Stage.ADC]
        flat = out.reshape(-1)
        scale = np.float32(shot.electrons_per_photon_s)

        def collect(tile: Tile, here: slice) -> None:
            np.multiply(light[here], scale, out=tile.values)
            for apply in collecting:
                apply(tile)

        def read(tile: Tile, here: slice) -> None:
            for apply in reading:
                apply(tile)
            self._convert(tile, flat[here], converting)

        flows = [effect.flow for effect in running if effect.flow is not None]
        if not flows:
            self._run_tiles(shot, light, (collect, read))
            return
        charge = np.empty(light.size, np.float32)
        self._run_tiles(shot, light, (collect,), charge)
        for flow in flows:
            flow(charge.reshape(-1, shot.width), shot, self._kernels.after(0))
        self._run_tiles(shot, light, (read,), charge)

    def _light(self, shot: Shot, running: Sequence[Effect], timing: RowTiming) -> Light:
        """Return photons a second on each sample, after all effects on the picture of light."""
        if self._view.target is not None:
            return self._new_light(shot, running, timing)
        changes = [e.name for e in running if e.picture is not None]
        if not changes:
            return np.ascontiguousarray(self._view.light)
        return self._cache.get(tuple(changes), lambda: (self._new_light(shot, running, timing),))[0]

    def _new_light(self, shot: Shot, running: Sequence[Effect], timing: RowTiming) -> Light:
        view, target = self._view, self._view.target
        lens = _pictures(running, Stage.LENS)
        light = view.light
        if lens or target is not None:
            planes = view.planes()
            if target is not None:
                planes = planes.copy()
                blurred = timing.is_motion_blurred
                target.draw(planes, timing.starts_s, shot.time_s, is_blurred=blurred)
            for change in lens:
                planes = change(planes, shot)
            light = sample(planes, view.layout)
        for change in _pictures(running, Stage.SAMPLES):
            shape = light.shape if light.ndim > 1 else (1, light.size)
            light = change(light.reshape(shape), shot)
        return np.ascontiguousarray(light)

    def _run_tiles(
        self,
        shot: Shot,
        light: Light,
        steps: Sequence[Callable[[Tile, slice], None]],
        charge: Light | None = None,
    ) -> None:
        """Do `steps` on each tile of a frame with `light` on its samples.

        Its values lie in `charge` where that is given, and otherwise in memory of the thread.
        """
        size = light.size
        tiles = math.ceil(size / TILE)
        kernels = self._kernels.after(size)

        def run(first: int) -> None:
            # Not kept from frame to frame: an idle camera would hold it for every thread.
            most = min(size, TILE)
            noise, memory = TileNoise(kernels, most), np.empty(most, np.float32)
            for index in range(first, tiles, self._threads):
                start = index * TILE
                here = slice(start, min(start + TILE, size))
                values = memory[: here.stop - start] if charge is None else charge[here]
                tile = Tile(shot, values, light[here], start, index, noise, self._cache)
                for step in steps:
                    step(tile, here)

        _run_threads(run, min(self._threads, tiles))

    def _convert(self, tile: Tile, out: Pixels | Light, effects: Sequence[TileWork]) -> None:
        """Turn charge into pixels, or into the input of the ADC where `out` is float32."""
        sensor, shot, values = self._sensor, tile.shot, tile.values
        is_analogue = out.dtype == np.float32
        if self._curve is not None:
            np.multiply(values, np.float32(shot.gain / sensor.full_scale_e), out=values)
            if is_analogue:
                np.copyto(out, values)
                return
            np.add(self._curve.brightness(values), sensor.black, out=out, casting="unsafe")
            return
        scale = np.float32(shot.gain / sensor.electrons_per_dn)
        offset, top = np.float32(sensor.black + sensor.phase), np.float32(2**sensor.bits - 1)
        if tile.noise.kernels is not None and not effects and not is_analogue:
            tile.noise.kernels.quantise(values, scale, offset, top, out)
            return
        np.multiply(values, scale, out=values)
        for apply in effects:
            apply(tile)
        if is_analogue:
            np.add(values, offset, out=out)
        elif tile.noise.kernels is not None:
            tile.noise.kernels.quantise(values, np.float32(1), offset, top, out)
        else:
            np.add(values, offset, out=values)
            # Nothing is negative after clipping, so that the cast is a floor.
            np.clip(values, np.float32(0), top, out=values)
            np.copyto(out, values, casting="unsafe")


def _pictures(effects: Sequence[Effect], stage: Stage) -> list[Callable[[Light, Shot], Light]]:
    """Return the work on whole pictures that the effects of a stage have."""
    return [e.picture for e in effects if e.stage is stage and e.picture is not None]


def _tile_work(
    shot: Shot, effects: Sequence[Effect], timing: RowTiming
) -> dict[Stage, list[TileWork]]:
    """Return the work on tiles that effects have, in their order, by stage."""
    work: dict[Stage, list[TileWork]] = defaultdict(list)
    for effect in effects:
        if effect.lines is not None:
            work[effect.stage].append(effect.lines(shot, timing).apply)
        if effect.apply is not None:
            work[effect.stage].append(effect.apply)
    return work


def _run_threads(run: Callable[[int], None], threads: int) -> None:
    """Call run(0) to run(threads - 1) at the same time; the calling thread takes the first."""
    others = [_pool().submit(run, index) for index in range(1, threads)]
    run(0)
    for other in others:
        other.result()
