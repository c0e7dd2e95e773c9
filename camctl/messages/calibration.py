"""What a person does before a calibration, and the plain sentences of what it finds."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Final

from camctl.system.number_text import percent_text

if TYPE_CHECKING:
    from camctl.findings import Finding


def exposures_contradict(finding: Finding) -> str:
    """Return what the pixels say of the stated exposures; by the detail `kind`."""
    value, found = finding.value or 0.0, finding.details
    if found["kind"] == "label":
        where = f" in channel {found['channel']}" if found["channel"] else ""
        return (
            f"{found['name']} is {abs(value):.0%} {'brighter' if value > 0 else 'darker'}{where} "
            f"than its exposure {found['stated']:.4g} says: all its pixels say "
            f"{found['said']:.4g}, {1 + value:.3g} times as much"
        )
    if found["kind"] == "few":
        return (
            f"the exposures {found['stated']} contradict the pixels by {value:.0%}: one of them is "
            "wrong, or the light changed"
        )
    if found["kind"] == "trend":
        return (
            f"the exposures {found['stated']} contradict the pixels, which say about "
            f"{found['said']} (for a response like sRGB)"
        )
    return (
        "the light flickers, or the shutter varies: frames differ from their exposures by "
        f"{found['least']:+.0%} ({found['darkest']}) to {found['most']:+.0%} "
        f"({found['brightest']}), each in all its pixels"
    )


def contradiction_hint(finding: Finding) -> str:
    """Return what to do where the stated exposures contradict the pixels."""
    if finding.details["is_shot"]:
        return (
            "use daylight or a lamp that does not flicker, before a scene that does not move, or "
            "have the exposures estimated"
        )
    hints = {
        "label": "correct its exposure, leave the frame out, or have the exposures estimated",
        "few": "correct it, add frames to show which one it is, or have the exposures estimated",
        "trend": "correct them, or leave the times out and have the exposures estimated",
        "flicker": "use daylight or a lamp that does not flicker, or have the exposures estimated",
    }
    return hints[str(finding.details["kind"])]


def _left_out(finding: Finding) -> str:
    share = percent_text(finding.value or 0.0)
    return {
        "saturation": (
            "saturated samples change those beside them (blooming, or JPEG compression): they and "
            "those near them are left out of the estimate"
        ),
        "movement": (
            f"something moved in up to {share} of the picture from one frame to another: it is "
            "left out of the estimate of the response"
        ),
        "none": (
            f"something moved in up to {share} of the picture from one frame to another, and the "
            "rest does not show the response: the estimate may be wrong"
        ),
        "copy": (
            f"{finding.details.get('first')} and {finding.details.get('second')} are the same "
            "picture: a copy adds nothing; leave one of them out"
        ),
    }[str(finding.details["what"])]


def _levels_found(finding: Finding) -> str:
    level, colour = finding.details["level"], finding.details.get("colour")
    why = "samples saturate there" if level == "white" else "the pixels show it"
    where = f" of channel {colour}" if colour else ""
    return f"the {level} level{where} is {finding.value:g}, not {finding.details['stated']}: {why}"


def _chart_contradicts(finding: Finding) -> str:
    value, found = finding.value or 0.0, finding.details
    return (
        f"patch {found['patch']} of the chart is {abs(value):.0%} "
        f"{'brighter' if value > 0 else 'darker'} in channel {found['channel']} than its "
        "reflectance says: check for glare, shadows, and the list of patches"
    )


def _response_inexact(finding: Finding) -> str:
    found = finding.details
    known = (
        f"at {found['brightness']:.0%} of full scale the response is known to +-{finding.value:.0%}"
    )
    if not found["has_profile"]:
        return f"{known}; {found['help']}"
    return (
        f"not kept in the camera's profile: {known}, and +-{found['needed']:.0%} is needed; "
        f"{found['help']}, or keep it all the same"
    )


def _noise_filtered(finding: Finding) -> str:
    if finding.value is None:
        return "the frames are JPEG files: compression hides noise, so that the figures are too low"
    return (
        f"the noise of neighbouring pixels has a correlation of {finding.value:.2f}: the camera "
        "filters its pictures (demosaicing, noise reduction, compression), and the figures "
        "describe the filtered picture"
    )


def _not_measured(finding: Finding) -> str:
    found = finding.details
    if found["what"] == "settings":
        return (
            f"{finding.value:g} of {found['of']} settings expose too little of the scene well and "
            "are not measured"
        )
    if found["what"] == "gain":
        return f"not measured at gain {finding.value:.4g}: {found['why']}"
    return f"channel {found['channel']} is left out: {found['why']}"


def _light_varies(finding: Finding) -> str:
    if finding.details["within"] == "pair":
        return f"the light changes by up to {finding.value:.1%} within a pair: corrected"
    if finding.details["within"] == "stream":
        return "frames contradict their exposures: the light changes from one frame to the next"
    return f"frames with one setting differ by {finding.value:.2%}: the light or the shutter varies"


def _delay_irregular(finding: Finding) -> str:
    found = finding.details
    if finding.value is None:
        return f"a step is repeated: {found['why']}"
    return (
        f"{finding.value:g} of {found['trials']} steps show a frame between the two exposures: the "
        "camera mixes exposures while it changes them"
    )


SENTENCES: Final[dict[str, Callable[[Finding], str]]] = {
    "exposures_contradict": lambda finding: (
        f"{exposures_contradict(finding)}; {contradiction_hint(finding)}"
    ),
    "exponent_unknown": lambda finding: (
        "no exposure is known: the exponent of the curve was chosen so that it is about as steep "
        f"as sRGB, and may be {percent_text(finding.value or 0)} wrong for a camera that makes "
        "such pictures, and 100 % for raw ones; give the times of the frames, or put a chart into "
        "the picture"
    ),
    "left_out": _left_out,
    "levels_found": _levels_found,
    "chart_contradicts": _chart_contradicts,
    "response_doubtful": lambda finding: (
        f"the response may be wrong, and is kept all the same: {finding.details['why']}"
    ),
    "response_inexact": _response_inexact,
    "noise_misfit": lambda finding: (
        f"the noise does not follow the response of the camera (misfit {finding.value:.1f}): the "
        "intervals are widened; measure the response, with more frames if it was measured"
    ),
    "noise_filtered": _noise_filtered,
    "channels_differ": lambda finding: (
        f"the channels have different electrons per level ({finding.details['each']}), as after a "
        f"white balance: the figures are for {finding.details['channel']}"
    ),
    "not_measured": _not_measured,
    "light_varies": _light_varies,
    "delay_irregular": _delay_irregular,
}
"""The sentence of each code of a calibration."""


STILL_SCENE: Final = (
    "Put the camera on a tripod before a scene that does not move, with dark and bright parts and "
    "many shades between: a room with a window, a desk under a lamp.",
    "Its light must be steady: daylight without moving clouds, or a lamp that does not flicker.",
    "Switch automatic exposure, gain, white balance and focus off. It takes a few minutes.",
)
COVERED: Final = (
    "Cover the lens, with its cap or a dark cloth. What the pictures then show is the dark signal "
    "and hot pixels."
)
