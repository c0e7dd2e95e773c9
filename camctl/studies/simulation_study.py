"""Fidelity of the simulated sensor against its time: what each tolerance changes and saves.

A frame is compared, level by level, with the frame of the same scene, exposure and random numbers
in which every effect was simulated (tolerance 0).  Exposures are metered, so that the highlights
lie just below saturation, or lie a given number of stops away from that.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from camctl.captures.metering import MeteringFrames, meter
from camctl.errors import UsageError
from camctl.interface.controls import ExposureSetting
from camctl.profiles.calibrated import open_camera
from camctl.sim.camera import SimulatedCamera

if TYPE_CHECKING:
    from camctl.interface.camera import Camera, Frame

TOLERANCES_DN = (0.0, 0.1, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Tolerances of a study, by default."""


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
    """What a tolerance changes and costs.

    Attributes:
        tolerance_dn: the tolerance, DN
        time_s: shutter time of the frames, s
        bound_dn: the most that leaving out effects can change before the ADC, DN
        largest_dn: largest difference of a sample from the frame with every effect, levels
        mean_dn: mean absolute difference, levels
        shift_dn: difference of the means of all samples, levels
        milliseconds: CPU time of a frame, its choice of effects included; least of the frames
        effects: those that ran
        left_out: those that scene and sensor have, and that were left out
    """

    tolerance_dn: float
    time_s: float
    bound_dn: float
    largest_dn: int
    mean_dn: float
    shift_dn: float
    milliseconds: float
    effects: tuple[str, ...]
    left_out: tuple[str, ...]


def measure(run: SimulationRun) -> tuple[SimulationPoint, ...]:
    """Return a point for each tolerance of a run.

    Raises:
        CamctlError: a scene, sensor or size that cannot be used; light that cannot be metered
    """
    with run.camera(0.0) as camera:
        time_s = meter(MeteringFrames(camera)).setting.time_s * 2**run.stops
        setting = ExposureSetting(camera.controls.time_s.nearest(time_s))
    tolerances_dn = tuple(dict.fromkeys((0.0, *run.tolerances_dn)))
    frames, seconds, effects = _take(run, setting, tolerances_dn)
    complete = effects[0.0]
    points = []
    for tolerance_dn in run.tolerances_dn:
        differences = [
            frame.pixels.astype(np.int32) - reference.pixels
            for frame, reference in zip(frames[tolerance_dn], frames[0.0], strict=True)
        ]
        ran = effects[tolerance_dn]
        points.append(
            SimulationPoint(
                tolerance_dn=tolerance_dn,
                time_s=setting.time_s,
                bound_dn=max(float(_plan(f)["joint_bound_dn"]) for f in frames[tolerance_dn]),
                largest_dn=max(int(np.abs(each).max()) for each in differences),
                mean_dn=float(np.mean([np.abs(each).mean() for each in differences])),
                shift_dn=float(np.mean([each.mean() for each in differences])),
                milliseconds=1e3 * seconds[tolerance_dn],
                effects=ran,
                left_out=tuple(name for name in complete if name not in ran),
            )
        )
    return tuple(points)


def _take(
    run: SimulationRun, setting: ExposureSetting, tolerances_dn: Sequence[float]
) -> tuple[dict[float, list[Frame]], dict[float, float], dict[float, tuple[str, ...]]]:
    """Return frames at one setting, the least CPU time of one, s, and its effects, by tolerance.

    Each frame is requested alone and has the whole tolerance.  The tolerances take turns, so that
    other work on the machine disturbs all alike.  The first frame of a camera, in which it prepares
    what all frames of the scene share, is left out.
    """
    frames: dict[float, list[Frame]] = {tolerance_dn: [] for tolerance_dn in tolerances_dn}
    seconds = dict.fromkeys(tolerances_dn, math.inf)
    effects: dict[float, tuple[str, ...]] = {}
    with ExitStack() as opened:
        cameras = {t: opened.enter_context(run.camera(t)) for t in tolerances_dn}
        for turn in range(run.frames + 1):
            for tolerance_dn, camera in cameras.items():
                started = time.process_time()
                taken = list(camera.shoot((setting,)))
                spent = time.process_time() - started
                assert isinstance(camera, SimulatedCamera)
                assert camera.last_plan is not None
                effects[tolerance_dn] = camera.last_plan.simulated
                if turn > 0:
                    frames[tolerance_dn] += taken
                    seconds[tolerance_dn] = min(seconds[tolerance_dn], spent)
    return frames, seconds, effects


def _plan(frame: Frame) -> dict[str, Any]:
    plan: dict[str, Any] = frame.details["simulation"]
    return plan


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
