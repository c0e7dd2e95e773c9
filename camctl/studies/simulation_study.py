"""Fidelity of the simulated sensor against its time: what each tolerance changes and saves.

A frame is compared, level by level, with the frame of the same scene, exposure and random numbers
in which every effect was simulated.  Beside tolerances, which leave out what changes little in this
exposure, there are methods that leave out the same effects in every one.  Exposures are metered, so
that the highlights lie just below saturation, or lie a given number of stops away from that.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from statistics import median
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from camctl.captures.metering import MeteringFrames, meter
from camctl.errors import UsageError
from camctl.interface.controls import ExposureSetting
from camctl.profiles.calibrated import open_camera
from camctl.sim.camera import SimulatedCamera
from camctl.sim.effects import EFFECTS
from camctl.sim.effects.budget import FramePlan, plan_frame
from camctl.sim.effects.optics import OPTICS
from camctl.sim.render import Renderer
from camctl.sim.scenes.view import View

if TYPE_CHECKING:
    from camctl.interface.camera import Camera, Pixels

TOLERANCES_DN = (0.0, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Tolerances of a study, by default."""

CAMCTL, COMPLETE = "camctl", "every effect"
"""The method that leaves out what a tolerance allows, and the one that leaves out nothing."""

_SIMPLE = {"colour mosaic", "photon noise", "full well", "read noise"}
_SIMPLE |= {"response curve", "black level", "quantisation"}
"""What simple simulations of a sensor have."""

FIXED: dict[str, tuple[str, ...]] = {
    COMPLETE: (),
    "no optics": tuple(effect.name for effect in OPTICS if effect.name != "colour mosaic"),
    "noise only": tuple(effect.name for effect in EFFECTS if effect.name not in _SIMPLE),
}
"""The other methods, with the effects that they leave out of every frame."""

IN_WORDS_DN = 0.5, 4.0
"""Tolerances of which the text says in words what they cost: half a level, and some."""

_Choice: TypeAlias = tuple[str, float | None]
"""A method and, of camctl, the tolerance in DN."""


@dataclass(frozen=True)
class SimulationRun:
    """One scene and exposure at several tolerances: all that is needed to run it again.

    Attributes:
        scene: a built-in scene, a scene file or a radiance map
        sensor: a built-in sensor or a sensor file
        tolerances_dn: tolerances, DN
        stops: exposure relative to the metered one, -64 to 64
        size: WIDTHxHEIGHT of the frames; None: the scene's own
        seed: of all noise
        frames: frames that are taken and compared at each tolerance

    Raises:
        UsageError: no tolerances, fewer than one frame, or stops out of range
    """

    scene: str
    sensor: str = "complete"
    tolerances_dn: tuple[float, ...] = TOLERANCES_DN
    stops: float = 0.0
    size: str | None = None
    seed: int = 0
    frames: int = 5

    def __post_init__(self) -> None:
        if not self.tolerances_dn:
            raise UsageError("a study of the simulation needs at least one tolerance")
        if self.frames < 1:
            raise UsageError(f"invalid number of frames {self.frames}: expected at least 1")
        if not abs(self.stops) <= 64:
            raise UsageError(f"invalid number of stops {self.stops:g}: expected -64 to 64")

    def camera(self, tolerance_dn: float) -> Camera:
        """Return the simulated camera at a tolerance, with its random numbers from the start."""
        options = {
            "scene": self.scene,
            "sensor": self.sensor,
            "size": self.size,
            "seed": self.seed,
            "tolerance": tolerance_dn,
            "profile": "none",
        }
        return open_camera("sim", {k: v for k, v in options.items() if v is not None})


@dataclass(frozen=True)
class SimulationPoint:
    """What leaving out effects changes, and what it costs.

    Attributes:
        method: `CAMCTL`, or one of `FIXED`
        tolerance_dn: the tolerance of camctl, DN; None: another method
        time_s: shutter time of the frames, s
        bound_dn: the most that leaving out effects can change before the ADC, DN; None: anything
        largest_dn: largest difference of a sample from the frame with every effect, levels
        mean_dn: mean absolute difference, levels
        shift_dn: difference of the means of all samples, levels
        milliseconds: CPU time of a frame, its choice of effects included; least of the frames
        effects: those that ran
        left_out: those that scene and sensor have, and that were left out
    """

    method: str
    tolerance_dn: float | None
    time_s: float
    bound_dn: float | None
    largest_dn: int
    mean_dn: float
    shift_dn: float
    milliseconds: float
    effects: tuple[str, ...]
    left_out: tuple[str, ...]


def measure(run: SimulationRun) -> tuple[SimulationPoint, ...]:
    """Return a point for each tolerance of a run, then for each method in `FIXED`.

    Raises:
        CamctlError: a scene, sensor or size that cannot be used; light that cannot be metered
    """
    with run.camera(0.0) as camera:
        assert isinstance(camera, SimulatedCamera)
        scene, sensor, controls = camera.scene, camera.sensor, camera.controls
        time_s = meter(MeteringFrames(camera)).setting.time_s * 2**run.stops
    setting = ExposureSetting(controls.time_s.nearest(time_s))
    choices: list[_Choice] = [(CAMCTL, tolerance_dn) for tolerance_dn in run.tolerances_dn]
    choices += [(method, None) for method in FIXED]
    view = View.of(scene, sensor)
    renderers = {
        choice: Renderer(view, sensor, seed=run.seed, tolerance_dn=choice[1] or 0.0)
        for choice in choices
    }
    taken = _take(run, setting, renderers)
    reference = taken[COMPLETE, None]
    points = []
    for (method, tolerance_dn), found in taken.items():
        differences = [
            frame.astype(np.int32) - complete
            for frame, complete in zip(found.frames, reference.frames, strict=True)
        ]
        bound_dn = found.plan.joint_bound_dn
        points.append(
            SimulationPoint(
                method=method,
                tolerance_dn=tolerance_dn,
                time_s=setting.time_s,
                bound_dn=bound_dn if math.isfinite(bound_dn) else None,
                largest_dn=max(int(np.abs(each).max()) for each in differences),
                mean_dn=float(np.mean([np.abs(each).mean() for each in differences])),
                shift_dn=float(np.mean([each.mean() for each in differences])),
                milliseconds=1e3 * found.seconds,
                effects=found.plan.simulated,
                left_out=tuple(
                    name for name in reference.plan.simulated if not found.plan.runs(name)
                ),
            )
        )
    return tuple(points)


@dataclass(eq=False)
class _Taken:
    """Frames of one method, the least CPU time of one, s, and the plan of the last."""

    frames: list[Pixels]
    seconds: float
    plan: FramePlan


def _take(
    run: SimulationRun, setting: ExposureSetting, renderers: Mapping[_Choice, Renderer]
) -> dict[_Choice, _Taken]:
    """Return frames at one setting by each method.

    The methods take turns, so that other work on the machine disturbs all alike.  The first frame
    of each, in which it prepares what all frames of the scene share, is left out.
    """
    found: dict[_Choice, _Taken] = {}
    for number in range(run.frames + 1):
        for (method, tolerance_dn), renderer in renderers.items():
            started = time.process_time()
            shot = renderer.shot(setting.time_s, setting.gain, number)
            if method == CAMCTL:
                plan = renderer.plan(shot)
            elif number == 0:
                plan = plan_frame(shot, 0.0, left_out=FIXED[method])
            else:
                plan = found[method, tolerance_dn].plan
            frame = renderer.expose(shot, plan)
            spent = time.process_time() - started
            if number == 0:
                found[method, tolerance_dn] = _Taken([], math.inf, plan)
                continue
            taken = found[method, tolerance_dn]
            taken.frames.append(frame)
            taken.seconds, taken.plan = min(taken.seconds, spent), plan
    return found


@dataclass(frozen=True)
class SimulationStudy:
    """Runs and their points, one for each tolerance."""

    runs: tuple[SimulationRun, ...]
    points: tuple[tuple[SimulationPoint, ...], ...]

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each point: its run, which can be run again, and what was found."""
        return [
            asdict(run) | asdict(point)
            for run, points in zip(self.runs, self.points, strict=True)
            for point in points
        ]

    def in_words(self) -> list[str]:
        """Return what fidelity costs, a sentence for each method: medians over the runs."""
        complete = [
            next(point.milliseconds for point in points if point.method == COMPLETE)
            for points in self.points
        ]
        found: dict[_Choice, list[tuple[float, SimulationPoint]]] = {}
        for points, whole in zip(self.points, complete, strict=True):
            if not whole:  # shorter than a step of the clock
                continue
            for point in points:
                share = point.milliseconds / whole
                found.setdefault((point.method, point.tolerance_dn), []).append((share, point))
        sentences = []
        for (method, tolerance_dn), rows in found.items():
            if method == COMPLETE or tolerance_dn not in (None, *IN_WORDS_DN):
                continue
            name = method if tolerance_dn is None else f"camctl, {tolerance_dn:g} DN"
            largest = max(point.largest_dn for _, point in rows)
            mean = median(point.mean_dn for _, point in rows)
            sentences.append(
                f"{name}: a frame takes {100 * median(s for s, _ in rows):.0f} % of the time with "
                f"every effect, and samples differ by {mean:.2g} levels on average and {largest} "
                "at most."
            )
        return sentences


def simulation_runs(
    scenes: Iterable[str],
    sensor: str = "complete",
    tolerances_dn: tuple[float, ...] = TOLERANCES_DN,
    *,
    stops: Iterable[float] = (0.0,),
    size: str | None = None,
    seed: int = 0,
    frames: int = 5,
) -> tuple[SimulationRun, ...]:
    """Return the runs of a study: every scene at every exposure."""
    exposures = tuple(stops)
    return tuple(
        SimulationRun(scene, sensor, tolerances_dn, each, size, seed, frames)
        for scene in scenes
        for each in exposures
    )
