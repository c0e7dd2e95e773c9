"""The response of the camera that took photographs: stated, known, standard, or estimated."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.calibration.response.colours import (
    NUMBERS,
    HistogramRatios,
    PatchRatios,
    grey_scales,
    score,
)
from camctl.calibration.response.estimate import estimate_response
from camctl.errors import DataError
from camctl.findings import Detail, Finding
from camctl.interface.colour import CameraColour
from camctl.interface.controls import Choices, ExposureControls, ResponseOrigin
from camctl.model.response.camera import FloatArray, named_response, standard_response
from camctl.model.response.measured import read_curve
from camctl.model.sensor import SensorModel
from camctl.profiles.calibrated import response_changes
from camctl.profiles.folder import list_profiles
from camctl.system.input_files import exists

if TYPE_CHECKING:
    from camctl.calibration.response.series import Series
    from camctl.photographs.files import PhotographFiles
    from camctl.profiles.profile import Profile
    from camctl.profiles.response import ResponseRecord

#: Standard responses and phases of the quantiser that are compared with an estimated one; programs
#: truncate or round.
_STANDARDS, _PHASES = ("srgb", "rec709", "linear"), (0.0, 0.5)
#: Standard deviations of the logarithm of an exposure: a shutter's, a third of the tolerance of ISO
#: 516 (a quarter of a stop); of one that is known exactly.
_SHUTTER, _EXACT = 0.05, 0.002
#: Origins of a response that was found in the photographs themselves.
_FITTING, ASSUMED = "{}, which fits the photographs best", "srgb, assumed"
_ESTIMATED = "estimated from the photographs"
_ESTIMATED_COMMON = "estimated from the photographs, one for all colours"
OF_THEIR_EXPOSURES = (ASSUMED, _ESTIMATED, _ESTIMATED_COMMON)
FROM_PHOTOGRAPHS = (*map(_FITTING.format, _STANDARDS), *OF_THEIR_EXPOSURES)


def known_controls(
    files: PhotographFiles,
    curve: str | None,
    series: Series,
    notes: list[Finding],
    facts: list[Finding],
    *,
    are_exact: bool = False,
) -> tuple[ExposureControls, str]:
    """Return what is known of the frames, and where the response is from.

    Args:
        files: the photographs
        curve: see `PhotographOptions`
        series: histograms and patches of them, with black and white level
        notes: findings that are warnings, to which this adds
        facts: findings that are none, to which this adds
        are_exact: the exposures are
    """
    rows, columns = series.shape[:2]
    controls = ExposureControls(
        time_s=Choices((1.0,)),
        shape=(rows, columns),
        layout=series.layout,
        bits=series.bits,
        black=series.black,
        white=series.white,
        phase=series.phase,
        response_origin=ResponseOrigin.STATED,
    )
    if curve is not None:
        return replace(controls, response=_named_curve(curve, series)), curve
    if files.format.is_raw:
        return controls, "linear, as raw files are"
    mode = files.format.mode(series.white)
    fitting = _fitting_profiles(files, mode, (series.black, series.white))
    if len(fitting) == 1:
        found = fitting[0]
        return _measured(
            controls, found.responses[mode]
        ), f"measured, from the profile {found.name}"
    if fitting:
        names = " and ".join(each.name for each in fitting)
        details: dict[str, Detail] = {"profiles": names}
        unclear = Finding(code="profile_unclear", details=details, remedies={"curve": None})
        notes.append(unclear)
    standards = _standards(controls)
    patches, error = PatchRatios.of(series), _EXACT if are_exact else _SHUTTER
    ratios = patches if patches.has_cells else HistogramRatios.of(series)

    def score_of(known: ExposureControls, numbers: int) -> float:
        return score(*ratios.misfit(_lights(series, known), series.exposures, error), numbers)

    scores = {}
    for key, each in standards.items():
        scores[key] = score_of(each, 0)
        if scores[key] == 0:  # none is better
            break
    best = min(scores, key=lambda key: scores[key])
    standard = replace(standards[best], response_origin=ResponseOrigin.MEASURED)
    if patches.has_cells and scores[best] == 0:  # an estimate, whose numbers count, is worse
        return standard, _FITTING.format(best[0])
    try:
        estimate = estimate_response(series, is_scene_checked=False, exposure_error=error)
    except DataError as problem:
        why: dict[str, Detail] = {"why": problem.what}
        notes.append(Finding(code="response_unknown", details=why, remedies={"curve": None}))
        return standards["srgb", series.phase], ASSUMED
    estimated = _measured(controls, estimate.record)
    # An estimate has errors of its own: where a standard explains the frames as well, it is used.
    if scores[best] <= score_of(estimated, NUMBERS * (len(estimated.responses) or 1)):
        return standard, _FITTING.format(best[0])
    (notes if estimate.is_doubtful else facts).extend(estimate.findings)
    if estimated.responses:
        scales = grey_scales(series, _lights(series, estimated))
        scaled = tuple(
            replace(each, levels=scale * each.levels)
            for each, scale in zip(estimated.responses, scales.tolist(), strict=True)
        )
        return replace(estimated, response=scaled[1], responses=scaled), _ESTIMATED
    is_common = len(series.channels) > 1
    return estimated, _ESTIMATED_COMMON if is_common else _ESTIMATED


def _fitting_profiles(files: PhotographFiles, mode: str, levels: tuple[int, int]) -> list[Profile]:
    """Return the profiles of the camera with a response in this mode, black and white level."""
    fitting = [
        profile
        for profile in profiles_of(files.taken_by)
        if (record := profile.responses.get(mode)) is not None
        and (record.main_channel.black, record.main_channel.white) == levels
    ]
    if any(files.taken_by[2] and each.serial for each in fitting):  # better than without a serial
        return [each for each in fitting if each.serial]
    return fitting


def known_colour(files: PhotographFiles, white: int) -> CameraColour | None:
    """Return the colours in the profile of the camera, else those that the files state.

    The white balance is as the files state it.
    """
    stated = files.format.colour
    mode = files.format.mode(white)
    found = [each.colours[mode] for each in profiles_of(files.taken_by) if mode in each.colours]
    if len(found) != 1:
        return stated
    return found[0].camera_colour(None if stated is None else stated.white_balance)


def _standards(controls: ExposureControls) -> dict[tuple[str, float], ExposureControls]:
    """Return controls with each standard response, by its name and the phase of the quantiser."""
    levels = controls.white - controls.black
    phases = (controls.quantiser_phase,) if controls.black else _PHASES
    return {
        (name, phase): replace(
            controls,
            response=standard_response(name, controls.bits, phase=phase, levels=levels),
            response_origin=ResponseOrigin.ASSUMED,
            phase=phase,
        )
        for name in _STANDARDS
        for phase in phases
    }


def _lights(series: Series, controls: ExposureControls) -> list[FloatArray]:
    """Return the light of each brightness above black, of each channel or one for all."""
    responses = controls.responses or (controls.levels,)
    return [SensorModel(each, series.black).light[series.black :] for each in responses]


def profiles_of(taken_by: tuple[str, str, str]) -> list[Profile]:
    """Return the profiles that do not contradict a make, model and serial number.

    Of a make the first word counts: the same maker is "NIKON CORPORATION" and "Nikon".
    """
    make, model, serial = taken_by

    def agree(*texts: str) -> bool:
        return not all(texts) or len(set(texts)) == 1

    return [
        each
        for each in list_profiles()
        if model
        and each.model == model
        and agree(_maker(each.make), _maker(make))
        and agree(each.serial.strip().lstrip("0"), serial.strip().lstrip("0"))
    ]


def _maker(make: str) -> str:
    first = re.search(r"\w+", make.casefold())
    return first[0] if first else ""


def _measured(controls: ExposureControls, record: ResponseRecord) -> ExposureControls:
    """Return controls with a measured response; remarks on its samples are left out."""
    changes = response_changes(record)
    changes["response"] = replace(changes["response"], notes=())
    return replace(controls, **changes)


def _named_curve(curve: str, series: Series) -> Any:
    """Return the response that a file or a name gives."""
    levels = series.white - series.black
    if exists(curve):
        return read_curve(Path(curve), bits=series.bits, phase=series.phase, levels=levels)
    return named_response(curve, series.bits, levels)
