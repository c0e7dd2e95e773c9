"""Accuracy of captures against their time: predicted, and measured against a simulated scene.

Irradiance is normalised as in a capture: E = 1 is full scale of the shortest exposure that was
applied, which is metered so that the highlights are just below saturation.  Prediction and
measurement use the same exposures and this same scale.  The error is the error of the image in
the desired response, in u; every part of u counts alike, as in the definition of effective levels,
however many pixels a scene has there; parts of u that the scene lacks are left out of both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import median

import numpy as np
from numpy.typing import NDArray

from camctl.captures.metering import meter_light
from camctl.captures.sequencer import capture
from camctl.errors import CaptureError, UsageError
from camctl.exposure.evaluation import evaluate
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.best import longest_base_s
from camctl.exposure.search.front import Front
from camctl.exposure.search.settings import relative_exposures
from camctl.exposure.search.wall_time import predicted_wall_s
from camctl.interface.camera import Camera, PreviewingCamera
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import NoiseModel
from camctl.model.response.desired import DesiredResponse
from camctl.profiles.calibrated import open_camera, with_profile
from camctl.records.capture_plan import CapturePlan
from camctl.sim.camera import SimulatedCamera
from camctl.sim.sensors.parts import Lens
from camctl.studies.bracket_methods import FRONT, Bracket, bracket_settings, check_base
from camctl.studies.scene_errors import (
    BINS,
    Decade,
    covered_parts,
    decade_errors,
    measured_levels,
    median_decade,
    native_samples,
    scene_truth,
)

SIMULATED = "sim"

WITH_NOISE, NOISELESS = "with noise", "without noise, of which this sensor has none"
NOISE_UNKNOWN = "noise unknown: quantisation only"
"""What effective levels count."""

_SAMPLES_OF_BIN = 32
"""Values of u in each part at which the error is predicted."""


@dataclass(frozen=True)
class CaptureRun:
    """One bracket: all that is needed to take and measure it again.

    Attributes:
        method: a name in `camctl.studies.bracket_methods.METHODS`, or `FRONT`
        n: number of exposures
        response, dynamic_range, gamma: the desired response
        camera: id; its pictures are measured where it is the simulated one
        scene, sensor, size: of the simulated camera; None: its defaults
        base_s: longest shutter time of the shortest exposure, s
        lens: simulate blur, vignetting and glare of the lens, too
        seeds: one capture with each
        profile: parts of the camera's profile that are applied; see `camctl.open_camera`
        options: further ones of the camera, as (name, value)
        times_s, gains: the settings, by ascending exposure; empty: the method chooses them
        is_recommended: whether it is the point of the front beyond which time pays as averaging
        metered_s: shutter time of the last metering frame, for which a stream may have to wait, s;
            None: the light was not metered
    """

    method: str
    n: int
    response: str
    dynamic_range: float
    base_s: float
    gamma: float | None = None
    camera: str = SIMULATED
    scene: str | None = None
    sensor: str | None = None
    size: str | None = None
    lens: bool = False
    seeds: tuple[int, ...] = (0,)
    profile: str = "all"
    options: tuple[tuple[str, str], ...] = ()
    times_s: tuple[float, ...] = ()
    gains: tuple[float, ...] = ()
    is_recommended: bool = False
    metered_s: float | None = None

    @property
    def request(self) -> CaptureRequest:
        """The request of its captures."""
        return CaptureRequest(
            self.response, self.dynamic_range, self.n, base_s=self.base_s, gamma=self.gamma
        )

    @property
    def before(self) -> ExposureSetting | None:
        """The setting of the last metering frame, if there was one."""
        return None if self.metered_s is None else ExposureSetting(self.metered_s)

    @property
    def desired(self) -> DesiredResponse:
        """The desired response."""
        desired = self.request.desired
        assert desired is not None  # "auto" is no response of a study
        return desired


@dataclass(frozen=True)
class CapturePoint:
    """Accuracy and time of a run.

    Attributes:
        settings: as applied, by ascending exposure
        exposures: relative to the smallest
        shutter_s: total exposure time
        time_s: predicted time until the last frame, s
        time_measured_s: the same as it was, by the camera's clock; None without a capture
        effective_levels: predicted, with noise, over the whole range
        front_levels: the most that any settings of the camera have in this time
        effective_levels_predicted: predicted over the parts of u that the scene has
        effective_levels_noise_free: the same sets without noise, over the whole range
        effective_levels_each: measured, for each seed; empty for a real camera
        noise_known: False where the numbers count quantisation alone
        noise_counted: what the effective levels count, in words
        coverage: share of u that the scene has
        decades: measured errors, the brightest first
        note: why there is no result, or ""
    """

    settings: tuple[ExposureSetting, ...] = ()
    exposures: tuple[float, ...] = ()
    shutter_s: float = math.nan
    time_s: float = math.nan
    time_measured_s: float | None = None
    effective_levels: float = math.nan
    front_levels: float = math.nan
    effective_levels_predicted: float = math.nan
    effective_levels_noise_free: float = math.nan
    effective_levels_each: tuple[float, ...] = ()
    noise_known: bool = True
    noise_counted: str = WITH_NOISE
    coverage: float = 1.0
    decades: tuple[Decade, ...] = ()
    note: str = ""

    @property
    def effective_levels_measured(self) -> float | None:
        """The median over the seeds."""
        return median(self.effective_levels_each) if self.effective_levels_each else None

    @property
    def deviations(self) -> tuple[float, ...]:
        """Measured levels over predicted ones - 1, of each capture, where the scene has light."""
        return tuple(
            each / self.effective_levels_predicted - 1 for each in self.effective_levels_each
        )

    @property
    def less_accurate_by(self) -> float:
        """The share of the most effective levels in this time that are missing."""
        return 1 - self.effective_levels / self.front_levels

    @property
    def levels(self) -> float:
        """Effective levels, measured where there was a measurement."""
        measured = self.effective_levels_measured
        return self.effective_levels_predicted if measured is None else measured


def simulated_camera(run: CaptureRun, seed: int) -> SimulatedCamera:
    """Return the simulated camera of a run."""
    chosen = {"scene": run.scene, "sensor": run.sensor, "size": run.size}
    given = {name: value for name, value in chosen.items() if value is not None}
    further = dict(run.options)
    if wrong := sorted(further.keys() - {"unknown"}):
        raise UsageError(
            f"the simulated camera of a study has no option '{wrong[0]}'",
            hint="it has unknown=yes only; scene, sensor, size and seed have options of their own",
        )
    camera = open_camera(SIMULATED, given | further, profile="none")
    assert isinstance(camera, SimulatedCamera)
    sensor, lens = camera.sensor, camera.sensor.lens
    if not run.lens:
        ideal = Lens(f_number=lens.f_number, transmission=lens.transmission)
        sensor = sensor.model_copy(update={"lens": ideal})
    return SimulatedCamera(camera.scene, sensor, seed=seed, is_unknown=camera.is_unknown)


def _calibrated(run: CaptureRun, camera: SimulatedCamera) -> Camera:
    """Return a simulated camera with what its profile says of it, where that counts in the run."""
    return camera if run.profile == "none" else with_profile(camera)


def metered(run: CaptureRun) -> CaptureRun:
    """Return the run with the base exposure and the last metering frame of ``camctl shoot``.

    Raises:
        UsageError: the camera has no preview to meter with
        CaptureError: all is black at the longest exposure, or white at the shortest
        CameraError: the camera cannot be opened
    """
    simulated = run.camera == SIMULATED
    opened = (
        _calibrated(run, simulated_camera(run, seed=0))
        if simulated
        else open_camera(run.camera, {"profile": run.profile, **dict(run.options)})
    )
    with opened as camera:
        if not isinstance(camera, PreviewingCamera):
            raise UsageError(
                f"{run.camera} has no preview to meter with",
                hint="give the shortest exposure",
                remedies={"base_s": None},
            )
        request = replace(run.request, base_s=None)
        light = meter_light(camera, request)
    assert light is not None  # no base exposure is given
    base_s = longest_base_s(request, light)
    return replace(run, base_s=base_s, metered_s=light.last.time_s if light.last else None)


def _controls(run: CaptureRun) -> ExposureControls:
    """Return what the camera of a run can set."""
    if run.camera == SIMULATED:
        return _calibrated(run, simulated_camera(run, seed=0)).controls
    return _real_controls(run.camera, run.profile, run.options)


@lru_cache(maxsize=4)
def _real_controls(
    camera_id: str, profile: str, further: tuple[tuple[str, str], ...]
) -> ExposureControls:
    with open_camera(camera_id, {"profile": profile, **dict(further)}) as camera:
        return camera.controls


@lru_cache(maxsize=2)
def _front(run: CaptureRun) -> Front:
    """Return the front of a run of no method."""
    controls = _controls(run)
    check_base(controls, run.base_s)
    return Front(controls, run.desired, run.base_s, before=run.before)


def front_of(run: CaptureRun) -> Front:
    """Return the front of a run's camera and desired response.

    Raises:
        CaptureError: the base exposure is beyond the camera's shutter times
        CameraError: a real camera cannot be opened
    """
    return _front(
        replace(
            run, method=FRONT, n=1, seeds=run.seeds[:1], times_s=(), gains=(), is_recommended=False
        )
    )


def front_runs(run: CaptureRun) -> tuple[CaptureRun, ...]:
    """Return a run for each point of the front; raises what `front_of` raises."""
    front = front_of(run)
    return tuple(
        replace(
            run,
            method=FRONT,
            n=point.n,
            times_s=tuple(setting.time_s for setting in point.settings),
            gains=tuple(setting.gain for setting in point.settings),
            is_recommended=point == front.recommended,
        )
        for point in front.points
    )


def rate(run: CaptureRun) -> CapturePoint:
    """Choose the exposures of a run, predict their accuracy and time, and measure both.

    A method that has no exposures for this camera gives a point without numbers and with a note.

    Raises:
        CameraError: a real camera cannot be opened
    """
    simulated = run.camera == SIMULATED
    camera = simulated_camera(run, run.seeds[0]) if simulated else None
    controls = _controls(run)
    settings = tuple(map(ExposureSetting, run.times_s, run.gains))
    if not settings:
        try:
            bracket = Bracket(controls, run.request, run.base_s, run.before)
            settings = bracket_settings(run.method, bracket)
        except CaptureError as error:
            return CapturePoint(note=error.what)
    truth = None if camera is None else scene_truth(camera)
    point = _predicted(run, controls, settings, truth)
    most = point.effective_levels
    if run.method != FRONT:
        most = front_of(run).at_time(point.time_s).levels
    point = replace(point, front_levels=most)
    if camera is None or truth is None:
        return point
    levels, taken, decades = [], [], []
    for seed in run.seeds:
        with _calibrated(run, simulated_camera(run, seed)) as shooting:
            if run.before is not None and not (controls.timing and controls.timing.rests):
                assert isinstance(shooting, PreviewingCamera)
                shooting.preview(run.before)  # whose end the capture waits for
            report = capture(shooting, run.request, plan=_plan(run, shooting.controls, settings))
        E = truth * _smallest(settings)
        u = native_samples(report)
        levels.append(measured_levels(run.desired, E, u))
        decades.append(decade_errors(run.desired, E, u))
        taken.append(report.timing["actual_wall_s"])
    return replace(
        point,
        effective_levels_each=tuple(levels),
        time_measured_s=median(taken),
        decades=tuple(map(median_decade, zip(*decades, strict=True))),
    )


def _smallest(settings: Sequence[ExposureSetting]) -> float:
    return min(setting.exposure for setting in settings)


def _predicted(
    run: CaptureRun,
    controls: ExposureControls,
    settings: tuple[ExposureSetting, ...],
    truth: NDArray[np.float64] | None,
) -> CapturePoint:
    exposures = controls.relative_exposures(settings)
    desired, real = run.desired, controls.levels
    covered = np.ones(BINS, dtype=bool)
    if truth is not None:
        covered = covered_parts(desired, truth * _smallest(settings))
    u = (np.arange(BINS * _SAMPLES_OF_BIN) + 0.5) / (BINS * _SAMPLES_OF_BIN)
    posterior = Posterior(
        EffectiveCamera.of(real, exposures), desired, controls.frame_noise(settings)
    )
    errors = posterior.errors(u).reshape(BINS, -1)
    predicted = float((12 * errors[covered].mean()) ** -0.5) if covered.any() else math.nan
    return CapturePoint(
        settings=settings,
        exposures=exposures,
        shutter_s=sum(setting.time_s for setting in settings),
        time_s=predicted_wall_s(controls, settings, before=run.before),
        effective_levels=float((12 * errors.mean()) ** -0.5),
        effective_levels_predicted=predicted,
        effective_levels_noise_free=evaluate(real, desired, exposures).effective_levels,
        noise_known=controls.noise is not None,
        noise_counted=_noise_counted(controls.noise),
        coverage=float(covered.mean()),
    )


def _noise_counted(noise: NoiseModel | None) -> str:
    if noise is None:
        return NOISE_UNKNOWN
    return NOISELESS if noise.is_none else WITH_NOISE


def _plan(
    run: CaptureRun, controls: ExposureControls, settings: tuple[ExposureSetting, ...]
) -> CapturePlan:
    """Return the plan of exactly these settings."""
    exposures = relative_exposures(settings)
    noise = controls.frame_noise(settings)
    quality = evaluate(controls.levels, run.desired, exposures, noise=noise)
    return CapturePlan(
        response=run.response,
        dynamic_range=run.dynamic_range,
        ratios=exposures,
        settings=settings,
        exposures=exposures,
        base_s=settings[0].time_s,
        shutter_s=sum(setting.time_s for setting in settings),
        levels_wanted=quality.levels_wanted,
        xi=quality.xi,
        effective_levels=quality.effective_levels,
        effective_levels_noise_free=quality.effective_levels_noise_free,
        gamma=run.gamma,
        wall_s=predicted_wall_s(controls, settings, before=run.before),
        noise=controls.noise,
    )
