"""Findings as plain sentences: for Python, and for ``warnings`` in a report.

They name no option of a command line and no key of a panel.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from camctl.findings import Detail, Finding
from camctl.messages import calibration, photographs
from camctl.system.number_text import percent_text, range_text, time_text

# ---- exposures


def _exposure_differs(finding: Finding) -> str:
    details, ratio = finding.details, finding.value
    name = details["name"] or f"frame {finding.frames[1] + 1}"
    before = details["before"] if details["name"] and details["before"] else "the frame before"
    expected = _number(details["expected"])
    found = f"the light in {name} does not fit its exposure, {expected:.4g} times that of {before}"
    if ratio is not None:
        found = (
            f"{name} is {_as(ratio * expected, 'bright')} as {before}, and its exposure is "
            f"{_as(expected, 'long')}, a factor of {max(ratio, 1 / ratio):.3g} apart"
        )
    mends = ""
    if "estimate_ratios" in finding.remedies:
        mends = "the pictures can be computed with the light that the frames show"
    if details["certain"]:
        return f"{found}{mends and f'; if lamps flicker, {mends}'}{_delay_helps(finding)}"
    return (
        f"{found}: do not trust the light of the picture to less than that (lamps that flicker, "
        f"stray light, or a shutter that is not exact{mends and f'; {mends}'})"
    )


def _as(times: float, what: str) -> str:
    """Return such as "2.5 times as long"."""
    number = f"{times:.4g}"
    return f"as {what}" if number == "1" else f"{number} times as {what}"


def _delay_helps(finding: Finding) -> str:
    """Return what to do again where settings take effect late."""
    if "calibrate_delay" in finding.remedies:
        return "; if this happens again, measure the control delay"
    return ""


def _part_contradicts(finding: Finding) -> str:
    first, second = finding.frames
    return (
        f"frames {first + 1} and {second + 1} can be compared in "
        f"{_share(finding.details['compared'])} of the picture only, and {_share(finding.value)} "
        "of that does not fit their exposures: something moved there or its light changed, and "
        "only that part is wrong, or one of the frames has another exposure"
    )


def _delay_settled(finding: Finding) -> str:
    shift = finding.value
    when = "at other frames than"
    if shift:
        plural = "" if abs(shift) == 1 else "s"
        when = f"{abs(shift):g} frame{plural} {'later' if shift > 0 else 'earlier'} than"
    return (
        f"exposures took effect {when} the known control delay says: the camera settled at each "
        "exposure, and all were shot again; measure its control delay again"
    )


def _base_shortened(finding: Finding) -> str:
    fps = finding.details.get("results_per_second")
    why = f"leaves {fps:.3g} results a second" if fps else "is within the camera's controls"
    return (
        f"the shortest exposure is {finding.value:.4g} s, {finding.details['stops']:.1f} stops "
        f"less than the light allows, so that the longest one {why}"
    )


def _stream_settles(_: Finding) -> str:
    return (
        "exposures took effect at other frames than the known control delay says: from now on the "
        "camera settles at each exposure, which leaves fewer results a second; measure its control "
        "delay again"
    )


def _delay_contradicts(finding: Finding) -> str:
    if not finding.value:
        return (
            "the frames fit exposures that were set for other frames: probably the control delay "
            "of the camera is not the known one; measure it"
        )
    count = f"{abs(finding.value):g} frame{'s' if abs(finding.value) > 1 else ''}"
    return (
        f"every exposure took effect {count} {'later' if finding.value > 0 else 'earlier'} than "
        "the known control delay of the camera; measure the control delay"
    )


def _frame_white(finding: Finding) -> str:
    return (
        f"{_share(finding.value)} of frame {finding.frames[0] + 1} is white, and by the metered "
        f"light it would be {_share(finding.details['metered'])}: it had a longer exposure, or the "
        f"light changed{_delay_helps(finding)}"
    )


def _lines_damaged(finding: Finding) -> str:
    assert finding.place is not None  # as where the finding was made
    return (
        f"lines {finding.place.top} to {finding.place.bottom - 1} of frame {finding.frames[0] + 1} "
        "contradict most other frames from one side to the other: lines were lost or shifted on "
        "their way from the camera, or a thing as wide as the picture was in this frame alone; "
        "the light is wrong there (mask bit 4)"
    )


def _lines_repeated(finding: Finding) -> str:
    assert finding.place is not None  # as where the finding was made
    return (
        f"from line {finding.place.top} on, frame {finding.frames[0] + 1} has lines that came "
        "before, once more, noise included: they were sent twice, and what follows is in a wrong "
        "place; the light is wrong there (mask bit 4)"
    )


def _exposure_estimated(finding: Finding) -> str:
    frame, reference = finding.frames
    return (
        f"frame {frame + 1} has {finding.value:.4g} times the exposure that the camera states, "
        f"compared with frame {reference + 1} (95 %: {finding.low:.4g} to {finding.high:.4g})"
    )


def _not_estimated(finding: Finding) -> str:
    if not finding.frames:
        return f"the exposure ratios could not be estimated: {finding.details['what']}"
    return (
        f"the exposure of frame {finding.frames[0] + 1} could not be estimated: it has no pixels "
        "in common with the others that are well exposed"
    )


# ---- settings


def _setting_differs(finding: Finding) -> str:
    details, value = finding.details, finding.value or 0.0
    requested = _number(details["requested"])
    if details["field"] == "base_s":
        return f"the shortest exposure is {value:.6g} s: the camera cannot set {requested:.6g} s"
    if details["field"] == "ratios":
        return f"ratio {requested:.6g} becomes {value:.6g} on this camera"
    return (
        f"a compensation of {details['stops']:g} stops asks for {requested:.4g} s, but the camera "
        f"has {details['least_s']:.4g} to {details['most_s']:.4g} s: the shortest exposure is "
        f"{value:.4g} s, {details['possible_stops']:+.1f} stops"
    )


def _time_differs(finding: Finding) -> str:
    planned_s, actual_s = _number(finding.details["planned_s"]), finding.value or 0.0
    cause = "the computer was busy, or frames were lost"
    if actual_s < planned_s:
        cause = "the camera was faster than its stated figures"
    return (
        f"the last frame arrived after {actual_s:.3g} s instead of the {planned_s:.3g} s planned: "
        f"{cause}"
    )


# ---- light and range


def _light_above_range(finding: Finding) -> str:
    helps = _changes(finding)
    if not helps:
        helps = "close the aperture, or put a filter before the lens"
        if finding.details["photographs"]:
            helps = "a photograph with a shorter exposure would show it"
    return f"{_share(finding.value)} of the picture is brighter than its range: {helps}"


def _light_below_range(finding: Finding) -> str:
    details, helps = finding.details, _changes(finding)
    dynamic_range = _number(details["dynamic_range"])
    if details.get("unseen"):
        seen = "metering shows no light there; if there is some, "
        if details.get("longest_s") is not None:
            longest_s = time_text(_number(details["longest_s"]))
            seen = f"metering shows no light there, and {longest_s} is the longest exposure; "
        helps = seen + (helps or "open the aperture, or light the scene")
    elif not helps and details["photographs"]:
        helps = "photographs with longer exposures would show it"
    return (
        f"{_share(finding.value)} of the picture is darker than its range of "
        f"{range_text(dynamic_range)}: {helps or 'open the aperture, or light the scene'}"
    )


def _light_changed(finding: Finding) -> str:
    return (
        f"{_share(finding.value)} of the picture is brighter than its range, and in the "
        f"metering frames {_share(finding.details['metered'])} was: the light changed, as the "
        "light of lamps that flicker does; expose shorter"
    )


def _light_spread(finding: Finding) -> str:
    helps = (
        "a shorter longest exposure spreads less, and leaves more of the picture dark; better keep "
        "the light that saturates out of the picture"
    )
    if finding.details["photographs"]:
        helps = "leave out the photographs with the longest exposures"
    return (
        "light that spread from saturated samples, or a thing beside them that moved: "
        f"{_share(finding.value)} of the picture is too bright (mask bit 4, marked in the contact "
        f"sheet): {helps}"
    )


def _moved(finding: Finding) -> str:
    place, details = finding.place, finding.details
    assert place is not None  # as where the finding was made
    where = f"columns {place.left} to {place.right - 1} and rows {place.top} to {place.bottom - 1}"
    what = f"{_share(finding.value)} of the samples contradict other frames"
    if (single := details.get("single")) is not None:
        numbers = ", ".join(str(frame + 1) for frame in finding.frames)
        one = "frame" if len(finding.frames) == 1 else "one of the frames"
        what = (
            f"there, and around it, {_share(single)} of the picture is from {one} {numbers} alone"
        )
    return (
        f"something moved, or its light changed, in {_share(details['area'])} of the picture, "
        f"most of it in {where}: {what} (mask bit 4, marked in the contact sheet)"
    )


def _noise_differs(finding: Finding) -> str:
    return (
        f"the frames show {finding.value:.4g} effective levels instead of the "
        f"{finding.details['predicted']:.4g} predicted: the noise known of this camera is not the "
        "noise of its frames"
    )


def _noise_unknown(finding: Finding) -> str:
    return (
        f"the frames do not show the noise of {_share(finding.value)} of the samples, whose "
        "standard deviations are not known: too few parts of the picture are even, and "
        "well exposed in two frames"
    )


_CHANGES: Final[dict[str, Callable[[Any], str]]] = {
    "accuracy": lambda levels: (
        "ask for no accuracy" if levels is False else f"ask for {levels:g} effective levels"
    ),
    "base_s": lambda _: "let the shortest exposure be metered",
    "clip_percent": lambda percent: (
        "let only lamps and reflections clip"
        if percent is False
        else f"let the brightest {percent:g} % clip"
    ),
    "compensation_stops": lambda stops: (
        f"shift the exposure by {stops:g} stops" if stops else "do not shift the exposure"
    ),
    "count": lambda count: f"take {count} exposures",
    "desired_curve": lambda _: "give a desired curve of a larger range",
    "dynamic_range": lambda value: (
        "let the light decide the range"
        if value == "auto"
        else f"ask for a range of {range_text(value)}"
    ),
    "fps": lambda _: "ask for fewer results a second, whose exposures may be longer",
    "ratios": lambda _: "let the exposures be chosen",
    "response": lambda _: "take constant contrast, which has more levels for the dark",
    "time_budget_s": lambda _: "allow more time",
}
"""What a changed field of a request is called."""


def _changes(finding: Finding) -> str:
    """Return what the remedies of a finding are, and what they leave; empty: there are none."""
    text = ", and ".join(_CHANGES[name](value) for name, value in finding.remedies.items())
    if (wall_s := finding.details.get("wall_s")) is not None:
        text += f" (the picture then takes {time_text(_number(wall_s))})"
    if (left := finding.details.get("left")) is not None:
        text += f", which leaves {_share(left)} by the metered light"
    return text


def _share(value: Detail) -> str:
    """Return a detail that is a share, in per cent."""
    return percent_text(_number(value))


def _number(value: Detail) -> float:
    """Return a detail that is a number."""
    assert isinstance(value, float | int)  # as where the finding was made
    return float(value)


SENTENCES: Final[dict[str, Callable[[Finding], str]]] = {
    "exposure_differs": _exposure_differs,
    "part_contradicts": _part_contradicts,
    "delay_settled": _delay_settled,
    "stream_settles": _stream_settles,
    "delay_contradicts": _delay_contradicts,
    "frame_white": _frame_white,
    "frame_damaged": lambda finding: (
        f"{_share(finding.value)} of frame {finding.frames[0] + 1} shows no scene, since samples "
        "there do not depend on their neighbours: it was damaged on its way from the camera"
    ),
    "lines_damaged": _lines_damaged,
    "lines_repeated": _lines_repeated,
    "exposure_estimated": _exposure_estimated,
    "not_estimated": _not_estimated,
    "curve_repaired": lambda finding: str(finding.details["repair"]),
    "flicker": lambda finding: (
        f"{finding.value:.4g} s is not a whole number of the lamps' flicker periods of "
        f"{finding.details['period_s']:.4g} s"
    ),
    "highlights_cut": lambda finding: (
        f"{_share(finding.value)} of the samples are clipped even at the shortest exposure"
    ),
    "light_above_range": _light_above_range,
    "light_below_range": _light_below_range,
    "light_changed": _light_changed,
    "light_spread": _light_spread,
    "moved": _moved,
    "noise_differs": _noise_differs,
    "noise_unknown": _noise_unknown,
    "quantisation_only": lambda _: (
        "the noise of this camera is not known: effective levels, and what more time would bring, "
        "count quantisation alone, and real ones are fewer"
    ),
    "picture_black": lambda _: (
        "the picture is black in every exposure; take the lens cap off, or expose longer"
    ),
    "picture_white": lambda finding: (
        f"{_share(finding.value)} of the picture is white in every exposure; expose shorter, close "
        "the aperture, or put a filter before the lens"
    ),
    "setting_differs": _setting_differs,
    "base_shortened": _base_shortened,
    "steps_cost_levels": lambda finding: (
        f"the camera's steps allow {finding.value:.0f} effective levels; the requested ratios "
        f"would give {finding.details['possible']:.0f}"
    ),
    "time_differs": _time_differs,
    "note": lambda finding: str(finding.details["text"]),
    **calibration.SENTENCES,
    # Cameras.
    "response_assumed": lambda finding: (
        f"the response {finding.details['response']} is assumed until it is measured"
    ),
    "delay_unknown": lambda _: "control delay not measured: the stream settles after each exposure",
    "delay_varies": lambda finding: (
        f"the control delay is not constant ({finding.details['smallest']} to {finding.value:g} "
        "frames): the stream settles after each exposure"
    ),
    **photographs.SENTENCES,
}
"""The sentence of each code of `camctl.findings.CODES`."""


def sentence(finding: Finding) -> str:
    """Return the finding as one line, without a full stop at its end."""
    return SENTENCES[finding.code](finding)


def sentences(findings: Iterable[Finding]) -> list[tuple[str, Mapping[str, Any]]]:
    """Return sentences with their remedies: one for findings that say the same of several files."""
    groups: dict[object, list[Finding]] = {}
    for place, finding in enumerate(findings):
        key: object = place
        if finding.code in photographs.TOGETHER and "file" in finding.details:
            same, _ = photographs.TOGETHER[finding.code]
            alike = tuple(finding.details.get(name) for name in same)
            key = finding.code, alike, repr(finding.remedies)
        groups.setdefault(key, []).append(finding)
    return [(_joint(group), group[0].remedies) for group in groups.values()]


def _joint(findings: list[Finding]) -> str:
    if len(findings) == 1:
        return sentence(findings[0])
    _, joint = photographs.TOGETHER[findings[0].code]
    return joint(sorted(findings, key=lambda each: str(each.details.get("file"))))
