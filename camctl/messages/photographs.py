"""Plain sentences of the findings about photographs already taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

from camctl.findings import Finding
from camctl.system.number_text import percent_text, time_text


def _tags_differ(finding: Finding) -> str:
    details: dict[str, Any] = finding.details
    if details["what"] == "camera":
        return (
            f"the photographs were taken by different cameras ({details['whose']}), whose "
            "responses may differ: give photographs of one camera"
        )
    if details["what"] == "orientation":
        return (
            f"{details['file']} states another orientation than {details['other']}: it is taken "
            "to lie as that photograph does"
        )
    more = f" (and {details['count'] - 1} more)" if details["count"] > 1 else ""
    value = f"ISO {finding.value:g}" if details["what"] == "ISO" else f"f/{finding.value:g}"
    what = "ISO speed" if details["what"] == "ISO" else details["what"]
    return f"{details['file']}{more} states no {what}, and others do: {value} is assumed"


def _other_view(finding: Finding) -> str:
    details = finding.details
    if details.get("left_out"):
        return (
            f"{details['file']} does not show what the others show (another view or scene), and "
            "is left out"
        )
    return (
        f"{details['file']} and {details['other']} do not show the same view or scene, and the "
        "photographs do not show which is right"
    )


def _shifted(finding: Finding) -> str:
    details: dict[str, Any] = finding.details
    how = []
    if "columns" in details:
        how.append(
            f"shifted by about {details['columns']:+.0f} columns and {details['rows']:+.0f} rows"
        )
    if "degrees" in details:
        sense = "clockwise" if details["degrees"] > 0 else "anticlockwise"
        how.append(f"turned by about {abs(details['degrees']):.1f} degrees {sense}")
    if "percent" in details:
        size = "enlarged" if details["percent"] > 0 else "reduced"
        how.append(f"{size} by about {abs(details['percent']):.1f} %")
    how[0] = how[0].replace(" by ", f" against {details['other']} by ", 1)
    text = f"{details['file']} is {' and '.join(how)}"
    if details.get("left_out"):
        return f"{text}, and is left out: align it to use it"
    if details.get("summed"):
        return f"{text}, and the picture will be blurred: align the photographs first"
    why = "it is the only one used" if details.get("used") else "it is not used"
    return f"{text}; the picture is not blurred by it, since {why}"


def _other_white_balance(finding: Finding) -> str:
    details = finding.details
    factors = {colour: details[colour] for colour in ("red", "blue") if colour in details}
    if "other" in details:
        ((colour, factor),) = factors.items()
        return (
            "the white balance, or the colour of the light, changes between "
            f"{details['file']} and {details['other']}: {colour} against green by up to "
            f"{factor:.2f} times, and the colours of the picture are not right"
        )
    parts = " and ".join(
        f"{factor:.2f} times as much {colour}" for colour, factor in factors.items()
    )
    return (
        f"{details['file']} has another white balance than the others, or the light had another "
        f"colour ({parts}), and is left out"
    )


def _label_wrong(finding: Finding) -> str:
    details: dict[str, Any] = finding.details
    factor = finding.value or 1.0
    times = f"{factor:.3g} times" if factor >= 1 else f"{100 * factor:.3g} % of"
    text = (
        f"the exposure of {details['file']} is wrong: it says {time_text(details['stated_s'])}, "
        f"and beside the {details['agree']} photographs that agree its pixels say "
        f"{time_text(details['pixels_s'])}, {times} what it says"
    )
    if "iso" in details:
        text += (
            f", as with ISO {details['iso_of_others']:g}, which the others state, in place of its "
            f"ISO {details['iso']:g}"
        )
    if "left_out" not in details:
        return text
    return f"{text}: {_use(finding)}; correct it (or the light was different in it)"


def _labels_wrong(findings: Sequence[Finding]) -> str:
    each: list[dict[str, Any]] = [finding.details for finding in findings]
    parts = [
        f"{of['file']} says {time_text(of['stated_s'])}, and its pixels {time_text(of['pixels_s'])}"
        for of in each
    ]
    text = (
        f"the exposures of {len(each)} photographs are wrong, beside the {each[0]['agree']} that "
        f"agree: {'; '.join(parts)}"
    )
    if "left_out" not in each[0]:
        return text
    use = "they are left out" if each[0]["left_out"] else "what the pixels say is used"
    return f"{text}: {use}; correct them (or the light was different in them)"


def _labels_swapped(finding: Finding) -> str:
    details = finding.details
    return f"the exposures of {details['file']} and {details['other']} are swapped: {_use(finding)}"


def _labels_contradict(finding: Finding) -> str:
    details: dict[str, Any] = finding.details
    if "why" not in details:
        return _contradictions([finding])
    return (
        f"{_contradiction(finding)}: one of the two exposures is wrong, or the light has changed "
        f"({_WHY_UNKNOWN[details['why']]})"
    )


def _contradictions(findings: Sequence[Finding]) -> str:
    if "why" not in findings[0].details:
        files = ", ".join(str(finding.details["files"]) for finding in findings)
        return (
            f"the exposures of {files} contradict their pixels if the response is sRGB, as is "
            "assumed: give the response, or correct them"
        )
    why = _WHY_UNKNOWN[str(findings[0].details["why"])]
    return (
        f"{'; '.join(map(_contradiction, findings))}: one of each two exposures is wrong, or the "
        f"light has changed ({why})"
    )


def _contradiction(finding: Finding) -> str:
    details: dict[str, Any] = finding.details
    exposure = details["exposure"]
    light = f"{exposure * (finding.value or 1.0):.3g} times as bright"
    much = f"{exposure:.3g} times as much"
    return (
        f"{details['file']} is {'as bright' if light.startswith('1 times') else light} as "
        f"{details['other']}, although exposed {'as much' if much.startswith('1 times') else much}"
    )


_WHY_UNKNOWN: Final = {
    "two": "two photographs do not show which",
    "apart": "they share no well exposed part with others, and two photographs do not show which",
    "response": (
        "three photographs do not show which while the response is estimated from them: add some, "
        "or give the response"
    ),
    "tie": (
        "the photographs do not show which of the two is wrong: the picture takes their ratio from "
        "the pixels"
    ),
}
"""Why the photographs do not show which exposure is wrong, by the detail `why`."""


def _light_differs(finding: Finding) -> str:
    details = finding.details
    if "flash_fired" in details:
        verb = "fired" if details["flash_fired"] else "did not fire"
        them = "it" if details["count"] == 1 else "them"
        return (
            f"the flash {verb} in {details['files']} only, where the light is another: leave "
            f"{them} out"
        )
    return (
        f"{details['files']} are all about {finding.value:.3g} times as bright as their exposures "
        "say beside the others: the light or the aperture changed, or their exposures are wrong: "
        f"{_use(finding)}"
    )


def _use(finding: Finding) -> str:
    """Return what is done where pixels say other exposures than files."""
    if finding.details["left_out"]:
        return "it is left out" if finding.details["count"] == 1 else "they are left out"
    return "what the pixels say is used"


def _masked(finding: Finding) -> str:
    by = finding.details["by"]
    found = []
    if (place := finding.place) is not None:
        size = f"{place.right - place.left} x {place.bottom - place.top} pixels"
        why = "the border around has one pure colour"
        if by == "mask":
            why = "the mask is black around"
        elif by == "alpha":
            why = "what is around is transparent in a photograph"
        found.append(f"cut to {size} from column {place.left}, row {place.top}: {why}")
    if finding.value:
        share = percent_text(finding.value)
        found.append(f"{share} of the pixels are masked, and too dark in the result")
    return "; ".join(found)


def _label_unchecked(finding: Finding) -> str:
    if "file" not in finding.details:
        return (
            "three photographs or fewer do not always show that an exposure is wrong while the "
            "response is not known"
        )
    details: dict[str, Any] = finding.details
    if details.get("count", 1) > 1:
        return (
            f"the exposures of {details['files']} are not checked: no part of them is well exposed "
            "in the photograph of the next brightness, too"
        )
    return (
        f"the exposure of {details['file']} is not checked: no part of it is well exposed "
        "in the photograph of the next brightness, too"
    )


def _part_differs(finding: Finding) -> str:
    place = finding.place
    assert place is not None  # such a finding has one
    more = " and elsewhere" if finding.details["elsewhere"] else ""
    return (
        f"{finding.details['file']} contradicts the other photographs in about columns "
        f"{place.left}-{place.right - 1}, rows {place.top}-{place.bottom - 1}{more}: something "
        "moved there, or it is damaged"
    )


def _aligned(finding: Finding) -> str:
    details: dict[str, Any] = finding.details
    count = f"{details['count']} of {details['of']} photographs"
    if details["by"] == "shift":
        how = "moved by whole pixels"
    else:
        how = "moved by a homography, which interpolates their samples"
    return f"{count} were {how}, by up to {finding.value:.0f} pixels, onto the others"


SENTENCES: Final[dict[str, Callable[[Finding], str]]] = {
    "aligned": _aligned,
    "blurred": lambda finding: (
        f"{finding.details['file']} is less sharp than the others (out of focus, or shaken), and "
        "is left out"
    ),
    "copy": lambda finding: (
        f"{finding.details['file']} is the same photograph as {finding.details['other']}, and left "
        "out"
    ),
    "damaged": lambda finding: f"{finding.details['file']}: {finding.details['what']}",
    "empty": lambda finding: f"{finding.details['file']} is one colour everywhere, and left out",
    "exposure_corrected": lambda finding: (
        f"exposures in the pixels, over those stated: {finding.details['factors']}"
    ),
    "label_unchecked": _label_unchecked,
    "label_unit": lambda finding: (
        f"the times are taken for nominal shutter speeds: {finding.details['times']}"
    ),
    "label_wrong": _label_wrong,
    "labels_contradict": _labels_contradict,
    "labels_swapped": _labels_swapped,
    "light_differs": _light_differs,
    "masked": _masked,
    "other_view": _other_view,
    "other_white_balance": _other_white_balance,
    "part_differs": _part_differs,
    "profile_unclear": lambda finding: (
        f"the profiles {finding.details['profiles']} fit the photographs equally, and none is "
        "used: remove one, or give the response"
    ),
    "response_unknown": lambda finding: (
        f"the response is taken for sRGB, since it cannot be estimated: {finding.details['why']}"
    ),
    "shifted": _shifted,
    "tags_differ": _tags_differ,
}
"""The sentence of each code about photographs."""

TOGETHER: Final[dict[str, tuple[tuple[str, ...], Callable[[Sequence[Finding]], str]]]] = {
    "label_wrong": (("agree", "left_out", "iso"), _labels_wrong),
    "labels_contradict": (("why",), _contradictions),
}
"""One sentence for several findings of a code, and the details that must then be the same."""
