"""The last step of a capture: from its frames and their sum to its pictures and its report.

The stages pass values: the true exposures -> the effective camera and its tables -> the light
outside the range -> what the frames say of each other and of their noise -> pictures -> report.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.captures.advice import range_findings, spread_findings
from camctl.captures.frame_checks import FrameChecks
from camctl.captures.metering import BLACK_SHARE, OUTLIER_SHARE
from camctl.captures.true_exposures import relative
from camctl.evidence.chroma import states_few_chroma_samples
from camctl.evidence.lost_detail import stated_steps
from camctl.evidence.movement import Movement, find_movement
from camctl.evidence.noise import measure_noise
from camctl.exposure.evaluation import evaluate
from camctl.exposure.light import DARK_SHARE
from camctl.exposure.objective import Objective
from camctl.findings import Finding
from camctl.interface.controls import ExposureControls
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior, posterior_of
from camctl.model.noise import FrameNoise, MeasuredNoise
from camctl.model.response.desired import DesiredResponse
from camctl.pictures.details import PictureDetails, ShownFrame
from camctl.pictures.frame_light import FrameLight, frame_light, parts_of
from camctl.pictures.ghosts.choice import find_ghosts
from camctl.pictures.ghosts.replacement import Ghosts
from camctl.pictures.light_shares import LightShares, light_shares
from camctl.pictures.render import Rendering, Tables
from camctl.records.frame import (
    ExposureRatio,
    FrameRecord,
    StoredFrame,
    simulation_summary,
    without_plan,
)
from camctl.records.frame_store import CaptureStore
from camctl.records.report import Achieved, CaptureReport, Irradiance, UnfinishedCapture
from camctl.system.memory import return_free_memory

#: Codes of findings that say why frames contradict each other where nothing moved.
_CAUSES = frozenset({"frame_damaged", "lines_damaged", "lines_repeated", "levels_found"})


@dataclass(frozen=True, eq=False)
class _Shot:
    """The frames that were shot, and the effective camera of their true exposures.

    Attributes:
        frames: in the order of the plan
        ratios: what is known of the exposure of each, relative to the smallest
        exposures: relative exposures, which the pictures are computed with
        noise: of each frame
        posteriors: the effective camera of each colour whose response is known, or the one
        full_scale_exposure: irradiance in the pictures times this is E, 1 at full scale
        unit: of the irradiance in the pictures
    """

    frames: list[StoredFrame]
    ratios: list[ExposureRatio]
    exposures: tuple[float, ...]
    desired: DesiredResponse
    noise: tuple[FrameNoise, ...]
    posteriors: list[Posterior]
    full_scale_exposure: float
    unit: str

    @property
    def gains(self) -> list[float]:
        """Linear gain of each frame."""
        return [frame.applied.gain for frame in self.frames]

    @property
    def posterior(self) -> Posterior:
        """The effective camera of green, which stands for all colours."""
        return self.posteriors[len(self.posteriors) // 2]


def complete(
    unfinished: UnfinishedCapture,
    total: NDArray[np.unsignedinteger],
    checks: FrameChecks,
    controls: ExposureControls,
    store: CaptureStore,
) -> CaptureReport:
    """Render the pictures into `store`, save the report there, and return it.

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
    return_free_memory()  # of the shots
    shot = _effective_camera(unfinished, checks.judge(), controls)
    tables = tuple(map(Tables.of, shot.posteriors))
    outside = light_shares(controls.layout, total, tables, shot.desired)
    achieved = _achieved(unfinished, shot, controls, outside)
    known = shot.noise if controls.noise else None
    movement = find_movement(store.rows, total.shape, checks.pairs(shot.exposures, known))
    agrees = unfinished.trustworthy and (movement is None or not movement.found.is_local)
    measured = _measured(shot, checks, controls, achieved.effective_levels, agrees=agrees)
    light = _light(shot, checks, controls)
    quality = light.quality(checks.samples)
    achieved = achieved.model_copy(update={"measured": measured, "gain_over_sum": quality.gain})
    ghosts = None
    if unfinished.request.deghost and movement is not None:
        lit = (total, light, shot.exposures, checks.samples_outside, controls.black)
        ghosts = find_ghosts(movement, store.rows, *lit)
    checks.end()
    return_free_memory()
    rendering = Rendering(
        controls.layout,
        tables,
        shot.desired,
        light,
        store.rows,
        len(shot.frames),
        controls.hot_pixels,
        movement,
        controls.colour,
        ghosts,
    )
    details = _details(unfinished, shot, checks, controls, outside, movement)
    files = store.keep_pictures(total, rendering, details)
    findings = [
        *unfinished.plan.findings,
        *unfinished.findings,
        *_light_findings(unfinished, total, controls, achieved),
        *_movement_findings(unfinished, movement, ghosts, repeatable=controls.repeatable),
        *_measured_findings(achieved),
        *([Finding(code="noise_unknown", value=quality.unknown)] if quality.unknown else []),
    ]
    simulation = simulation_summary(shot.frames)
    shared = UnfinishedCapture.model_fields.keys() & CaptureReport.model_fields.keys()
    report = CaptureReport.model_validate(
        {name: getattr(unfinished, name) for name in shared}
        | {
            "status": "complete",
            "findings": findings,
            "taken_at": details.taken_at,
            "timing": {**unfinished.timing, "writing_s": time.perf_counter() - began},
            "frames": _records(shot, without=without_plan if simulation else dict),
            "achieved": achieved,
            "simulation": simulation,
            "movement": None if movement is None else movement.found,
            "irradiance": Irradiance(unit=shot.unit, full_scale_exposure=shot.full_scale_exposure),
            "files": files,
            "profile": controls.profile,
        }
    )
    store.save_report(report)
    return report.with_pictures(store)


def _records(shot: _Shot, without: Callable[[StoredFrame], dict[str, Any]]) -> list[FrameRecord]:
    """Return the frames for the report, with their true exposures; `without` gives their fields."""
    return [
        FrameRecord.model_validate(
            without(frame) | {"exposure": ratio.exposure, "exposure_ratio": ratio}
        )
        for frame, ratio in zip(shot.frames, shot.ratios, strict=True)
    ]


def _effective_camera(
    unfinished: UnfinishedCapture, chosen: list[ExposureRatio], controls: ExposureControls
) -> _Shot:
    """Return the effective camera of the true exposures `chosen`, not of the planned ones."""
    frames = [frame for frame in unfinished.frames if frame is not None]
    ratios = relative(chosen)
    exposures = tuple(ratio.exposure for ratio in ratios)
    full_scale_exposure = min(ratio.exposure for ratio in chosen)
    if controls.sensitivity is not None:
        full_scale_exposure *= controls.sensitivity
    desired = unfinished.plan.desired
    noise = controls.frame_noise([frame.applied for frame in frames])
    return _Shot(
        frames,
        ratios,
        exposures,
        desired,
        noise,
        [
            posterior_of(EffectiveCamera.of(each, exposures), desired, noise)
            for each in controls.responses or (controls.levels,)
        ],
        full_scale_exposure,
        _unit(frames) if controls.sensitivity is None else "as the scene",
    )


def _unit(frames: Sequence[StoredFrame]) -> str:
    """Return the unit of the light of a camera of unknown sensitivity."""
    settings = [frame.applied for frame in frames]
    others = ["gain 1"] if any(each.gain != 1 for each in settings) else []
    others += ["f/1"] if any(each.f_number for each in settings) else []
    return " at ".join(filter(None, ["full scales per second", " and ".join(others)]))


def _achieved(
    unfinished: UnfinishedCapture,
    shot: _Shot,
    controls: ExposureControls,
    outside: LightShares,
) -> Achieved:
    """Return the quality of the effective camera, and the shares of the light outside its range."""
    quality = evaluate(
        controls.levels,
        shot.desired,
        shot.exposures,
        objective=Objective(unfinished.plan.levels_wanted),
    )
    has_noise = bool(controls.noise)
    return Achieved(
        xi=quality.xi,
        effective_levels=(
            shot.posterior.inverse.effective_levels if has_noise else quality.effective_levels
        ),
        effective_levels_noise_free=quality.effective_levels_noise_free,
        noise=controls.noise,
        measured=None,
        levels=quality.levels,
        levels_distinct=quality.levels_distinct,
        saturated_fraction=outside.saturated,
        dark_fraction=outside.dark,
        light_shares=outside.histogram,
    )


def _measured(
    shot: _Shot,
    checks: FrameChecks,
    controls: ExposureControls,
    effective_levels: float,
    *,
    agrees: bool,
) -> MeasuredNoise | None:
    """Return the noise that the pixels show.

    Noise that contradicts the known one is left out where things moved, or where frames do not
    agree in their exposures: it may come from that.
    """
    found = measure_noise(
        controls.levels, shot.desired, checks.samples, shot.exposures, shot.noise, shot.gains
    )
    is_doubtful = bool(controls.noise) and not agrees
    if is_doubtful and found is not None and found.contradicts(effective_levels):
        return None
    return found


def _light(shot: _Shot, checks: FrameChecks, controls: ExposureControls) -> FrameLight:
    """Return what estimates the light, with the known noise or the one that the pixels show."""
    return frame_light(
        parts_of(controls.layout, controls.responses or (controls.levels,)),
        shot.exposures,
        shot.noise if controls.noise else None,
        checks.samples,
        black=controls.black,
        unit=shot.full_scale_exposure,
        gains=shot.gains,
        prior=shot.desired,
        few_chroma_samples=states_few_chroma_samples(each.details for each in shot.frames),
        stated_steps=stated_steps([each.details for each in shot.frames]),
    )


def _details(
    unfinished: UnfinishedCapture,
    shot: _Shot,
    checks: FrameChecks,
    controls: ExposureControls,
    outside: LightShares,
    movement: Movement | None,
) -> PictureDetails:
    """Return what the files of the pictures, and the contact sheet, say of them."""
    return PictureDetails(
        camera=unfinished.camera,
        taken_at=min(_taken(shot.frames), default=unfinished.taken_at),
        software=f"camctl {unfinished.versions.get('camctl', '')}".strip(),
        desired=shot.desired.name,
        lowest=shot.desired.e_min / shot.full_scale_exposure,
        highest=1 / shot.full_scale_exposure,
        unit=shot.unit,
        frames=_shown(shot, checks, controls),
        saturated=outside.saturated,
        dark=outside.dark,
        moved=None if movement is None else movement.found.share,
        spread=0.0 if movement is None else movement.found.spread,
        colour=controls.colour,
        orientation=shot.frames[0].orientation,
    )


def _taken(frames: Sequence[StoredFrame]) -> list[datetime]:
    """Return when frames were taken that state it."""
    stated = (frame.details.get("taken_at") for frame in frames)
    return [datetime.fromisoformat(each) for each in stated if each is not None]


def _shown(shot: _Shot, checks: FrameChecks, controls: ExposureControls) -> tuple[ShownFrame, ...]:
    """Return what contact.png shows of the frames, in ascending exposure."""
    first, last = controls.levels.levels[[0, -1]].tolist()
    lies = shot.frames[0].orientation
    shown = [
        ShownFrame(
            lies.upright(checks.thumbnails[place]),
            frame.applied,
            frame.saturated_fraction,
            first / exposure / shot.full_scale_exposure,
            last / exposure / shot.full_scale_exposure,
            frame.details.get("iso"),
        )
        for place, (frame, exposure) in enumerate(zip(shot.frames, shot.exposures, strict=True))
    ]
    return tuple(sorted(shown, key=lambda frame: -frame.highest))


def _light_findings(
    unfinished: UnfinishedCapture,
    total: NDArray[np.unsignedinteger],
    controls: ExposureControls,
    achieved: Achieved,
) -> list[Finding]:
    """Return how much of the light the pictures do not hold.

    Read noise around a black level lifts half of the samples above it: only those count as lit that
    are above it by `BLACK_SHARE` of one frame's levels.
    """
    saturated, plan = achieved.saturated_fraction, unfinished.plan
    # A comparison of integers: with a fraction, a copy in float64 would be made.
    least = int(unfinished.black_total + BLACK_SHARE * controls.levels.M)
    if np.count_nonzero(total > least) / total.size <= OUTLIER_SHARE:
        return [Finding(code="picture_black", remedies={"base_s": None})]
    if saturated > 1 - DARK_SHARE:  # no more shows light than may be below the range
        return [Finding(code="picture_white", value=saturated, remedies={"base_s": None})]
    return range_findings(
        unfinished.request,
        plan,
        controls,
        saturated=saturated,
        # What a mask leaves out of photographs is dark in the sum alone.
        dark=(
            achieved.dark_fraction if controls.repeatable or plan.light is None else plan.light.dark
        ),
    )


def _movement_findings(
    unfinished: UnfinishedCapture,
    movement: Movement | None,
    ghosts: Ghosts | None,
    *,
    repeatable: bool,
) -> list[Finding]:
    """Return what the frames say of movement, and of light that spread.

    What is damaged in a frame, or has another level, contradicts the others as both do.
    """
    is_explained = any(each.code in _CAUSES for each in unfinished.findings)
    if movement is None or is_explained:
        return []
    found = movement.found.findings
    if ghosts is not None:
        found = [
            each.model_copy(
                update={
                    "frames": ghosts.frames,
                    "details": each.details | {"single": ghosts.share},
                    "remedies": {"deghost": "none"},
                }
            )
            for each in found
        ]
    spread = movement.found.spread
    return found + spread_findings(
        unfinished.request, unfinished.plan, spread, repeatable=repeatable
    )


def _measured_findings(achieved: Achieved) -> list[Finding]:
    """Return that the frames contradict the camera's known noise."""
    measured, predicted = achieved.measured, achieved.effective_levels
    if not achieved.noise or measured is None or not measured.contradicts(predicted):
        return []
    value = measured.effective_levels
    return [Finding(code="noise_differs", value=value, details={"predicted": predicted})]
