"""The response of the camera that took photographs: stated, known, standard, or estimated."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.calibration.response.colours import AS_WELL, disagreement
from camctl.calibration.response.estimate import estimate_response
from camctl.errors import DataError
from camctl.findings import Detail, Finding
from camctl.interface.controls import Choices, ExposureControls, ResponseOrigin
from camctl.model.response.camera import named_response, standard_response
from camctl.model.response.measured import read_curve
from camctl.model.sensor import SensorModel
from camctl.profiles.calibrated import response_changes
from camctl.profiles.exposures import mode_name
from camctl.profiles.folder import list_profiles
from camctl.system.input_files import exists

if TYPE_CHECKING:
    from camctl.calibration.response.series import Series
    from camctl.photographs.files import PhotographFiles
    from camctl.profiles.profile import Profile
    from camctl.profiles.response import ResponseRecord

#: A standard response is used up to this median error of the light, or where it explains the
#: photographs as well as an estimated one.
_FITS = 0.01
#: Origins of a response that was found in the photographs themselves.
_FITTING, ASSUMED = "srgb, which fits the photographs", "srgb, assumed"
_ESTIMATED = "estimated from the photographs"
_ESTIMATED_COMMON = "estimated from the photographs, one for all colours"
OF_THEIR_EXPOSURES = (ASSUMED, _ESTIMATED, _ESTIMATED_COMMON)
FROM_PHOTOGRAPHS = (_FITTING, *OF_THEIR_EXPOSURES)


def known_controls(
    files: PhotographFiles,
    curve: str | None,
    series: Series,
    notes: list[Finding],
    facts: list[Finding],
) -> tuple[ExposureControls, str]:
    """Return what is known of the frames, and where the response is from.

    Args:
        files: the photographs
        curve: see `PhotographOptions`
        series: histograms and patches of them, with black and white level
        notes: findings that are warnings, to which this adds
        facts: findings that are none, to which this adds
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
    levels = series.white - series.black
    if curve is not None:
        return replace(controls, response=_named_curve(curve, series)), curve
    if files.format.is_raw:
        return controls, "linear, as raw files are"
    mode = mode_name(files.format.layout, files.format.shape_on_sensor, series.white)
    levels_now = (series.black, series.white)
    fitting = [
        profile
        for profile in profiles_of(files.taken_by)
        if (record := profile.responses.get(mode)) is not None
        and (record.main_channel.black, record.main_channel.white) == levels_now
    ]
    if any(files.taken_by[2] and each.serial for each in fitting):  # better than without a serial
        fitting = [each for each in fitting if each.serial]
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
    response = standard_response("srgb", series.bits, phase=series.phase, levels=levels)
    standard = replace(controls, response=response, response_origin=ResponseOrigin.ASSUMED)
    fitting_standard = replace(standard, response_origin=ResponseOrigin.MEASURED)
    try:
        estimate = estimate_response(series, is_scene_checked=False)
    except DataError as error:
        if _fit_error(series, standard) <= _FITS:
            return fitting_standard, _FITTING
        notes.append(
            Finding(
                code="response_unknown",
                details={"why": error.what},
                remedies={"curve": None},
            )
        )
        return standard, ASSUMED
    estimated = _measured(controls, estimate.record)
    # An estimate has errors of its own: where the standard explains the frames as well, it is used.
    errors = [_fit_error(series, each) for each in (standard, estimated)]
    if errors[0] <= _FITS or errors[0] <= AS_WELL * errors[1] < math.inf:
        return fitting_standard, _FITTING
    (notes if estimate.is_doubtful else facts).extend(estimate.findings)
    is_common = len(series.channels) > 1 and not estimated.responses
    return estimated, _ESTIMATED_COMMON if is_common else _ESTIMATED


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


def _fit_error(series: Series, controls: ExposureControls) -> float:
    """Return the `disagreement` of the photographs by the exposures that are stated."""
    responses = (controls.responses or (controls.levels,) * 3)[-len(series.channels) :]
    lights = [SensorModel(each, series.black).light[series.black :] for each in responses]
    return disagreement(series, lights, (series.exposures,) * len(lights))


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
