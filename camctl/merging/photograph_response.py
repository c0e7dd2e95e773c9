"""The response of the camera that took photographs: stated, known, standard, or estimated."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from camctl.calibrated import response_changes
from camctl.calibration.response import estimate_response
from camctl.controls import Choices, ExposureControls, ResponseOrigin
from camctl.errors import DataError
from camctl.exposure.patches import LightScale
from camctl.exposure_record import mode_name
from camctl.input_files import exists
from camctl.profile_folder import list_profiles
from camctl.response.camera import named_response, standard_response
from camctl.response.measured import read_curve

if TYPE_CHECKING:
    from camctl.calibration.response_series import Series
    from camctl.merging.photograph_files import PhotographFiles
    from camctl.profile import Profile
    from camctl.response_record import ResponseRecord

#: Mean brightness of the patches that are compared, as shares of full scale.
_DARKEST, _BRIGHTEST = 0.1, 0.9
#: A standard response is used up to this median error of the light, or up to this multiple of the
#: error of an estimated one.
_FITS, _AS_WELL = 0.01, 1.2
#: Where a response is from that was found in the photographs themselves.
_FITTING, ASSUMED = "srgb, which fits the photographs", "srgb, assumed"
_ESTIMATED = "estimated from the photographs"
_ESTIMATED_COMMON = "estimated from the photographs, one for all colours"
OF_THEIR_EXPOSURES = (ASSUMED, _ESTIMATED, _ESTIMATED_COMMON)
FROM_PHOTOGRAPHS = (_FITTING, *OF_THEIR_EXPOSURES)


def known_controls(
    files: PhotographFiles,
    curve: str | None,
    series: Series,
    notes: list[str],
    facts: list[str],
) -> tuple[ExposureControls, str]:
    """Return what is known of the frames, and where the response is from.

    Args:
        files: the photographs
        curve: see `PhotographOptions`
        series: histograms and patches of them
        notes: warnings, to which this adds
        facts: what the user may want to know, to which this adds
    """
    series.find_limits()
    facts += series.notes
    series.notes.clear()
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
        notes.append(
            f"the profiles {names} fit the photographs equally, and none is used: remove one "
            "(camctl profile remove), or give --curve"
        )
    response = standard_response("srgb", series.bits, phase=series.phase, levels=levels)
    standard = replace(controls, response=response, response_origin=ResponseOrigin.ASSUMED)
    fitting_standard = replace(standard, response_origin=ResponseOrigin.MEASURED)
    try:
        estimate = estimate_response(series, is_scene_checked=False)
    except DataError as error:
        if fit_error(series, standard) <= _FITS:
            return fitting_standard, _FITTING
        notes.append(f"the response is taken for srgb, since it cannot be estimated: {error.what}")
        return standard, ASSUMED
    estimated = _measured(controls, estimate.record)
    common = replace(estimated, responses=())
    # An estimate has errors of its own: where the standard explains the frames as well, it is it.
    # Where one curve for all channels does, it is that: grey stays grey, and green is estimated
    # best, since JPEG files keep less of the colours.
    errors = [fit_error(series, each) for each in (standard, common, estimated)]
    if errors[0] <= _FITS or errors[0] <= _AS_WELL * errors[2] < math.inf:
        return fitting_standard, _FITTING
    (notes if estimate.is_doubtful else facts).extend(estimate.notes)
    if estimated.responses and errors[1] <= _AS_WELL * errors[2] < math.inf:
        return common, _ESTIMATED_COMMON
    return estimated, _ESTIMATED


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


def fit_error(series: Series, controls: ExposureControls) -> float:
    """Return the median relative error of the light in patches, by the exposures that are stated.

    Patches of neighbouring exposures are compared, colour by colour, that are well exposed in both;
    infinite where there are none.
    """
    responses = controls.responses or (controls.levels,) * 3
    order = np.argsort(series.exposures).tolist()
    span, errors = series.white - series.black, [np.zeros(0)]
    for name, response in zip(series.channels, responses[-len(series.channels) :], strict=True):
        scale = LightScale(response, series.black)
        for short, long in pairwise(order):
            frames = [series.channel_patches(k, name) for k in (short, long)]
            means = [(each.mean(axis=1) - series.black) / span for each in frames]
            used = (np.minimum(*means) > _DARKEST) & (np.maximum(*means) < _BRIGHTEST)
            used &= frames[1].max(axis=1) < series.white
            light = [
                scale.light[np.minimum(each[used], scale.white)].mean(axis=1) for each in frames
            ]
            ratio = series.exposures[long] / series.exposures[short]
            errors.append(np.abs(np.log(light[1] / light[0] / ratio)))
    found = np.concatenate(errors)
    return float(np.median(found)) if found.size else math.inf


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
