"""Plans and reports as HTML, for notebooks (`_repr_html_`)."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Sequence
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from camctl.errors import CamctlError
from camctl.system.number_text import range_text
from camctl.system.picture_operations import png

if TYPE_CHECKING:
    from camctl.records.capture_plan import CapturePlan
    from camctl.records.report import Achieved, CaptureReport

#: Longer side of the picture in a notebook, pixels: half of a usual page.
_SIDE = 480


def plan_html(plan: CapturePlan) -> str:
    """Return what will be shot, and what it should give."""
    wall = "not known" if plan.wall_s is None else f"{plan.wall_s:.3g} s"
    at_least = "" if plan.is_wall_known else "at least "
    facts = [
        *_desired(plan),
        ("effective levels", _levels(plan)),
        (
            "time",
            f"{at_least}{wall}, exposed {plan.shutter_s:.3g} s",
        ),
    ]
    rows = [
        (f"{setting.time_s:.4g}", f"{setting.gain:.4g}", f"{exposure:.4g}")
        for setting, exposure in zip(plan.settings, plan.exposures, strict=True)
    ]
    return _page(facts, _table(("time, s", "gain", "relative exposure"), rows), plan.warnings)


def report_html(report: CaptureReport) -> str:
    """Return the picture, its exposures, its quality and what to know of it."""
    plan, achieved = report.plan, report.achieved
    facts = [
        ("camera", f"{report.camera.name} ({report.camera.id})"),
        *_desired(plan),
        (
            "effective levels",
            _levels(achieved),
        ),
        ("missing levels (xi)", f"{achieved.xi:.4g} of {plan.levels_wanted:.6g}"),
        (
            "outside the range",
            f"{achieved.saturated_fraction:.2%} saturated in every frame, "
            f"{achieved.dark_fraction:.2%} darker",
        ),
    ]
    if report.untrustworthy_because is not None:
        facts.append(("not trustworthy", report.untrustworthy_because))
    rows = [
        (
            f"{frame.applied_s:.4g}",
            f"{frame.applied.gain:.4g}",
            f"{frame.exposure:.4g}",
            f"{frame.saturated_fraction:.2%}",
        )
        for frame in report.frames
    ]
    headings = ("time, s", "gain", "relative exposure", "saturated")
    return _page(facts, _picture(report) + _table(headings, rows), report.warnings)


def _desired(plan: CapturePlan) -> list[tuple[str, str]]:
    return [("desired", f"{plan.desired.name}, {range_text(plan.dynamic_range)}")]


def _levels(quality: CapturePlan | Achieved) -> str:
    levels, noise_free = quality.effective_levels, quality.effective_levels_noise_free
    if noise_free is None or noise_free == levels:
        return f"{levels:.4g} by quantisation"
    return f"{levels:.4g} with noise, {noise_free:.4g} without"


def _picture(report: CaptureReport) -> str:
    """Return the image in the desired response, small; nothing where its file is missing."""
    try:
        image = report.image()
    except CamctlError:
        return ""
    step = -(-max(image.shape[:2]) // _SIDE)
    small = np.ascontiguousarray(image[::step, ::step] >> 8).astype(np.uint8)
    data = base64.b64encode(png(small)).decode("ascii")
    return (
        f'<p><img alt="the image in the desired response" src="data:image/png;base64,{data}"></p>'
    )


def _table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    head = "".join(f"<th>{escape(each)}</th>" for each in headings)
    body = "".join(
        f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _page(facts: Iterable[tuple[str, str]], middle: str, warnings: Sequence[str]) -> str:
    listed = "".join(
        f"<tr><th>{escape(name)}</th><td>{escape(text)}</td></tr>" for name, text in facts
    )
    notes = "".join(f"<li>{escape(text)}</li>" for text in warnings)
    return f"<table>{listed}</table>{middle}{f'<ul>{notes}</ul>' if notes else ''}"
