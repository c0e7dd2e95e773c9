"""What a measurement found, as data: a code of one table, frames, a value, its interval, a place.

A finding is made where it is measured, and has no sentence: each front end words it, see
`camctl.messages`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field


class Place(BaseModel):
    """A rectangle of a picture, in pixels: rows `top` to `bottom` - 1, and columns likewise."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    top: int
    left: int
    bottom: int
    right: int


CODES: Final[dict[str, str]] = {
    "note": "nothing: its sentence is the detail `text`",
    # Exposures: what the frames say of the exposures that the camera states.
    "exposure_differs": "light over the light of the frame before, over the ratio of the"
    " exposures; null: no ratio could be measured",
    "part_contradicts": "share of the comparable samples that do not fit the exposures",
    "delay_settled": "frames by which exposures took effect late at first; negative: early; then "
    "the camera settled at each exposure, and all were shot again",
    "stream_settles": "nothing: exposures of a stream took effect at other frames than the control "
    "delay says; from then on the camera settles at each exposure",
    "delay_contradicts": "frames by which exposures took effect late; negative: early",
    "frame_white": "share of the frame that is saturated, though the metered light is not",
    "frame_damaged": "share of the frame that shows no scene: its samples are any codes",
    "lines_damaged": "share of the frame's lines that are in `place`, where some contradict most"
    " other frames from one side to the other",
    "lines_repeated": "share of the frame's lines that are in `place`, from the first line on that"
    " is an earlier one once more",
    "exposure_estimated": "exposure in the pixels over the stated one",
    "not_estimated": "nothing: an exposure, or all of them, could not be estimated from the pixels",
    "curve_repaired": "nothing: the curve of the camera was repaired; `repair` says how",
    "setting_differs": "what the camera sets instead of the requested value; `field` names it",
    "base_shortened": "shortest exposure, s: shorter than the light allows by `stops`, so that the "
    "longest one is within the camera's controls, or leaves `results_per_second`",
    "flicker": "shutter time that is not a whole number of the lamps' flicker periods, s",
    "steps_cost_levels": "effective levels that the camera's steps allow",
    "time_differs": "time until the last frame arrived, s",
    # Light and range: what of the scene's light the picture holds.
    "highlights_cut": "share of the samples that are saturated even at the shortest exposure",
    "light_above_range": "share of the samples that are brighter than the range of the picture",
    "light_below_range": "share of the samples that are darker than the range of the picture",
    "light_changed": "share of the samples that are saturated, though metering showed less light",
    "picture_black": "nothing: the picture is black in every exposure",
    "picture_white": "share of the samples that are saturated in every exposure",
    # The picture: movement, light that spread, noise.
    "moved": "share of the samples that contradict others: from `low`, without those that noise"
    " marks at most; `place` is the one with most of them; `frames` are those of which"
    " one shows each such place alone",
    "light_spread": "share of the samples that are too bright by light that spread, or that moved",
    "noise_differs": "effective levels that the pixels show; the known noise predicts others",
    "noise_unknown": "share of the samples whose noise the frames do not show",
    "quantisation_only": "nothing: the noise of the camera is unknown, and accuracy leaves it out",
    # Photographs already taken; `details` name the files, which need not be frames of the picture.
    "aligned": "how far what was moved most was moved, pixels",
    "blurred": "contrast over the contrast in the other photographs",
    "copy": "nothing: the second of its frames is the same photograph",
    "damaged": "nothing: the detail `what` says what is wrong with the file",
    "empty": "nothing: it has one colour everywhere",
    "exposure_corrected": "largest factor by which an exposure was corrected from the pixels",
    "label_unchecked": "nothing: nothing shows whether its exposure is right",
    "label_unit": "nothing: the times are taken for nominal shutter speeds",
    "label_wrong": "exposure in the pixels over the stated one",
    "labels_contradict": "ratio of the light of two photographs over the ratio of their exposures",
    "labels_swapped": "nothing: `frames` are the two photographs",
    "light_differs": "light over the light of the others; nothing where the flash fired",
    "masked": "share of the pixels in `place` that a mask leaves out; `place` is what is used",
    "other_view": "share of the picture that agrees with the others",
    "other_white_balance": "red or blue against green, over the ratio in the others",
    "part_differs": "share of the picture in which it contradicts the others",
    "profile_unclear": "nothing: several profiles fit the photographs",
    "response_unknown": "nothing: the response is assumed",
    "shifted": "displacement of what is displaced most, pixels",
    "tags_differ": "value that is assumed where a file states none; else nothing",
    # Calibrations and profiles.
    "exposures_contradict": "relative error of the stated exposure that is most wrong",
    "exponent_unknown": "relative standard deviation of the exponent of the response",
    "left_out": "share of the picture that is left out of an estimate, where it is known",
    "levels_found": "black or white level in the pixels, DN",
    "chart_contradicts": "relative error of the reflectance of a patch of a chart",
    "response_doubtful": "nothing: checks of the frames refuse it, and it is kept on request",
    "response_inexact": "half of the widest 95 % interval of the irradiance, relative",
    "noise_misfit": "mean square deviation of the noise from its fit, over its expectation",
    "noise_filtered": "correlation of the noise of neighbouring pixels; null: JPEG compression",
    "channels_differ": "nothing: the channels have different electrons per level",
    "not_measured": "number of settings, or the gain, that could not be measured",
    "light_varies": "relative change of the light between frames of one setting",
    "delay_irregular": "number of steps with a frame between two exposures; null: a step repeated",
    # Cameras.
    "response_assumed": "nothing: the response of the camera is not known",
    "delay_unknown": "nothing: the control delay was not measured",
    "delay_varies": "the largest control delay, in frames",
}
"""Each code, and what its `value` is; the codes are stable."""


def _known(code: str) -> str:
    if code not in CODES:
        raise ValueError(f"unknown code of a finding: {code}")
    return code


Detail: TypeAlias = str | float | int | bool | None


class Finding(BaseModel):
    """One finding of a capture, a merge or a calibration.

    Attributes:
        code: of `CODES`, which says what `value` is
        frames: positions of the frames of the capture that it is about, 0 first; empty: it is about
            all of them, or about a photograph that is none of them and named in `details`
        value: what was measured
        low, high: its 95 % confidence interval, where it has one
        place: where in the picture; None: everywhere
        details: what else its sentence names, by name
        remedies: what helps: names of request fields with the value that helps, None where any
            other value may, False where the field is to be left out; and names of calibrations
            ("calibrate_delay") with None
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    code: Annotated[str, AfterValidator(_known)]
    frames: tuple[int, ...] = ()
    value: float | None = None
    low: float | None = None
    high: float | None = None
    place: Place | None = None
    details: dict[str, Detail] = Field(default_factory=dict)
    remedies: dict[str, Any] = Field(default_factory=dict)


def note(text: str, remedies: Mapping[str, Any] | None = None) -> Finding:
    """Return a sentence of a driver as a finding."""
    return Finding(code="note", details={"text": text}, remedies=dict(remedies or {}))
