"""The last step of a capture: from the sum of its frames to its pictures and its report."""

from __future__ import annotations

import time
from datetime import datetime

import numpy as np
from numpy.typing import NDArray

from camctl.captures.frame_checks import FrameChecks
from camctl.captures.metering import BLACK_SHARE, OUTLIER_SHARE
from camctl.captures.range_advice import outside_warnings
from camctl.captures.spread_advice import spread_warnings
from camctl.captures.true_exposures import relative
from camctl.evidence.movement import find_movement
from camctl.evidence.noise import measure_noise
from camctl.exposure.evaluation import evaluate
from camctl.exposure.objective import Objective
from camctl.findings import note
from camctl.interface.controls import ExposureControls
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import MeasuredNoise
from camctl.pictures.details import PictureDetails, ShownFrame
from camctl.pictures.light_shares import light_shares
from camctl.pictures.render import Rendering, Tables
from camctl.records.frame import FrameRecord, StoredFrame
from camctl.records.frame_store import CaptureStore
from camctl.records.report import Achieved, CaptureReport, Irradiance, UnfinishedCapture
from camctl.records.simulation_summary import simulation_summary, without_plan
from camctl.system.memory import return_free_memory

#: A picture with more than this share of its samples saturated gets a warning.
_MOST_SATURATED = 0.99


def complete(
    unfinished: UnfinishedCapture,
    total: NDArray[np.unsignedinteger],
    checks: FrameChecks,
    controls: ExposureControls,
    store: CaptureStore,
) -> CaptureReport:
    """Render the pictures into `store`, save the report there, and return it.

    The effective camera is that of the true exposures, not of the planned ones.

    Args:
        unfinished: a capture that has all its frames
        total: sum of its frames, black included
        checks: of its frames
        controls: of the camera
        store: where the frames are

    Raises:
        StorageError: a file could not be written
    """
    began = time.perf_counter()
    plan = unfinished.plan
    frames = [frame for frame in unfinished.frames if frame is not None]
    applied = [frame.applied for frame in frames]
    chosen = checks.judge()
    ratios = relative(chosen)
    exposures = tuple(ratio.exposure for ratio in ratios)
    desired = plan.desired
    full_scale_exposure = min(ratio.exposure for ratio in chosen)
    if controls.sensitivity is not None:
        full_scale_exposure *= controls.sensitivity
    taken_at = min(_taken(frames), default=unfinished.taken_at)
    noise = controls.frame_noise(applied)
    unit = "full scales per second" if controls.sensitivity is None else "as the scene"
    posteriors = [
        Posterior(EffectiveCamera.of(each, exposures), desired, noise)
        for each in controls.responses or (controls.levels,)
    ]
    posterior = posteriors[len(posteriors) // 2]  # that of green stands for all colours
    tables = tuple(Tables.of(each, full_scale_exposure) for each in posteriors)
    outside = light_shares(controls.layout, total, tables, desired)
    quality = evaluate(controls.levels, desired, exposures, objective=Objective(plan.levels_wanted))
    effective_levels = (
        posterior.inverse.effective_levels if controls.noise else quality.effective_levels
    )
    gains = [setting.gain for setting in applied]
    no_light = _no_light(total, unfinished.black_total, controls.levels.M, outside.saturated)
    pairs = checks.pairs(exposures, noise if controls.noise else None)
    movement = find_movement(store.frame, pairs, checks.bands.__getitem__)
    measured = measure_noise(controls.levels, desired, checks.samples, exposures, noise, gains)
    if (
        measured is not None
        and controls.noise
        and movement is not None
        and movement.found.is_local
        and measured.contradicts(effective_levels)
    ):
        measured = None  # it may be that of the things that moved alone
    return_free_memory()
    rendering = Rendering(
        controls.layout, tables, desired, full_scale_exposure, controls.hot_pixels, movement
    )
    details = PictureDetails(
        camera=unfinished.camera,
        taken_at=taken_at,
        software=f"camctl {unfinished.versions.get('camctl', '')}".strip(),
        desired=desired.name,
        lowest=desired.e_min / full_scale_exposure,
        highest=1 / full_scale_exposure,
        unit=unit,
        frames=_shown(frames, exposures, checks, controls, full_scale_exposure),
        saturated=outside.saturated,
        dark=outside.dark,
        moved=None if movement is None else movement.found.share,
        spread=0.0 if movement is None else movement.found.spread,
    )
    files = store.keep_pictures(total, rendering, details)
    simulation = simulation_summary(frames)
    shared = type(unfinished).model_fields.keys() & CaptureReport.model_fields.keys()
    begun = {name: getattr(unfinished, name) for name in shared}
    report = CaptureReport.model_validate(
        begun
        | {
            "status": "complete",
            "frames": [
                FrameRecord.model_validate(
                    (without_plan(frame) if simulation else dict(frame))
                    | {"exposure": ratio.exposure, "exposure_ratio": ratio}
                )
                for frame, ratio in zip(frames, ratios, strict=True)
            ],
            "achieved": Achieved(
                xi=quality.xi,
                effective_levels=effective_levels,
                effective_levels_noise_free=quality.effective_levels_noise_free,
                noise=controls.noise,
                measured=measured,
                levels=quality.levels,
                levels_distinct=quality.levels_distinct,
                saturated_fraction=outside.saturated,
                dark_fraction=outside.dark,
                light_shares=outside.histogram,
            ),
            "taken_at": taken_at,
            "simulation": simulation,
            "movement": None if movement is None else movement.found,
            "irradiance": Irradiance(
                unit=unit,
                full_scale_exposure=full_scale_exposure,
            ),
            "files": files,
            "profile": controls.profile,
            "findings": [
                *plan.findings,
                *unfinished.findings,
                *map(
                    note,
                    no_light
                    or outside_warnings(
                        unfinished.request,
                        plan,
                        saturated=outside.saturated,
                        # What a mask leaves out of photographs is dark in the sum alone.
                        dark=outside.dark
                        if controls.repeatable or plan.light is None
                        else plan.light.dark,
                        repeatable=controls.repeatable,
                    ),
                ),
                *map(
                    note,
                    spread_warnings(
                        unfinished.request,
                        plan,
                        movement.found.spread,
                        repeatable=controls.repeatable,
                    )
                    if movement is not None
                    else [],
                ),
                *map(note, _wrong_noise(measured, effective_levels) if controls.noise else []),
            ],
            "timing": {**unfinished.timing, "writing_s": time.perf_counter() - began},
        }
    )
    store.save_report(report)
    return report.with_pictures(store)


def _taken(frames: list[StoredFrame]) -> list[datetime]:
    """Return when frames were taken that state it."""
    stated = (frame.details.get("taken_at") for frame in frames)
    return [datetime.fromisoformat(each) for each in stated if each is not None]


def _shown(
    frames: list[StoredFrame],
    exposures: tuple[float, ...],
    checks: FrameChecks,
    controls: ExposureControls,
    full_scale_exposure: float,
) -> tuple[ShownFrame, ...]:
    """Return what contact.png shows of the frames, in ascending exposure."""
    first, last = controls.levels.levels[[0, -1]].tolist()
    shown = [
        ShownFrame(
            checks.thumbnails[place],
            frame.applied,
            frame.saturated_fraction,
            first / exposure / full_scale_exposure,
            last / exposure / full_scale_exposure,
            frame.details.get("iso"),
        )
        for place, (frame, exposure) in enumerate(zip(frames, exposures, strict=True))
    ]
    return tuple(sorted(shown, key=lambda frame: -frame.highest))


def _wrong_noise(measured: MeasuredNoise | None, predicted: float) -> list[str]:
    """Return a warning where the pixels contradict the noise that is known of the camera."""
    if measured is None or not measured.contradicts(predicted):
        return []
    return [
        f"the frames show {measured.effective_levels:.4g} effective levels instead of the "
        f"{predicted:.4g} predicted: the noise known of this camera is not that of its frames"
    ]


def _no_light(
    total: NDArray[np.unsignedinteger], black_total: int, levels: int, saturated: float
) -> list[str]:
    """Return a warning for a picture without light, or with nearly all of it saturated.

    Read noise around a black level lifts half of the samples above it: only those count as lit that
    are above it by `BLACK_SHARE` of one frame's levels.
    """
    # A comparison of integers: with a fraction, a copy in float64 would be made.
    lit = np.count_nonzero(total > int(black_total + BLACK_SHARE * levels)) / total.size
    if lit <= OUTLIER_SHARE:
        return [
            "the picture is black in every exposure; take the lens cap off, or expose longer "
            "(--base)"
        ]
    if saturated > _MOST_SATURATED:
        return [
            f"{saturated:.2%} of the picture is white in every exposure; expose shorter (--base), "
            f"close the aperture, or put a filter before the lens"
        ]
    return []
