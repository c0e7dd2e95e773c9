"""`camctl preview`: what the camera sees in the desired responses, before anything is shot."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.cli import options
from camctl.cli.capture_output import new_directory
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, option
from camctl.cli.output import (
    format_duration,
    format_fields,
    format_number,
    format_percent,
    format_table,
    print_finding,
    print_json,
    print_text,
)
from camctl.cli.parameter_types import PATH
from camctl.cli.request_options import RequestOptions, request_options
from camctl.cli.shoot import PICTURE_OPTIONS
from camctl.errors import UsageError
from camctl.system.number_text import range_text

if TYPE_CHECKING:
    from camctl.captures.response_preview import ResponsePreview

_SUFFIX = ".png"


@command(
    examples=(
        ("camctl preview", "the simulated camera, into preview-DATE-TIME.png"),
        ("camctl preview --camera v4l2:/dev/video0 -o look.png", "what a webcam sees"),
    )
)
@options.camera_options
@request_options(*PICTURE_OPTIONS, "settings", has_light=True)
@option(
    "-o --output FILE.png", "The picture.  [default: preview-DATE-TIME.png]", PATH, field="path"
)
@options.force
@options.as_json
def preview(
    camera: CameraOptions,
    request: RequestOptions,
    path: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Show the scene in three responses, before anything is shot.

    Writes one picture that shows the scene, as the camera sees it now, in a linear, a gamma and a
    log response side by side, each over the range that its light has.
    """
    from camctl.captures.response_preview import preview_responses
    from camctl.system.files import check_new, write_bytes
    from camctl.system.picture_operations import png

    if request.table is not None:
        raise UsageError("a preview has no table of exposures", hint="leave --set table= out")
    wanted = request.request()
    path = _free_name() if path is None else path
    if path.suffix.lower() != _SUFFIX:
        raise UsageError(
            f"the preview is a picture, and {path} is not the name of a PNG file",
            hint=f"name it -o {path.name or 'preview'}{_SUFFIX}",
        )
    check_new(path, overwrite=force)
    with camera.open() as opened:
        shown = preview_responses(opened, wanted)
    write_bytes(path, png(shown.picture))
    for finding in shown.plan.findings:
        print_finding(finding)
    if as_json:
        print_json({"file": str(path), **_json(shown)})
    else:
        print_text(_text(shown, path))


def _json(shown: ResponsePreview) -> dict[str, Any]:
    return {
        "findings": shown.plan.findings,
        "warnings": shown.plan.warnings,
        "dynamic_range": shown.plan.dynamic_range,
        "preview_times_s": [setting.time_s for setting in shown.settings],
        "left_out_s": shown.left_out_s,
        "unseen_fraction": _unseen(shown),
        "planned_times_s": [setting.time_s for setting in shown.plan.settings],
        "responses": [
            {
                "response": each.name,
                "dynamic_range": each.plan.dynamic_range,
                "planned_times_s": [setting.time_s for setting in each.plan.settings],
                "effective_levels": each.plan.effective_levels,
                "dark_fraction": each.dark,
                "saturated_fraction": each.saturated,
            }
            for each in shown.responses
        ],
    }


def _text(shown: ResponsePreview, path: Path) -> str:
    from camctl.exposure.light import DARK_SHARE

    rows = [
        (
            each.name,
            range_text(each.plan.dynamic_range),
            format_number(each.plan.effective_levels, 3),
            format_duration(each.plan.shutter_s),
            format_percent(each.dark),
            format_percent(each.saturated),
        )
        for each in shown.responses
    ]
    headings = ("response", "range", "effective levels", "exposures", "too dark", "saturated")
    times = ", ".join(format_duration(setting.time_s) for setting in shown.settings)
    fields = [("computed from", f"preview frames of {times}")]
    if shown.left_out_s:
        left_out = ", ".join(map(format_duration, shown.left_out_s))
        fields.append(("left out", f"{left_out}: too long for a preview"))
    if (unseen := _unseen(shown)) > DARK_SHARE:
        share = format_percent(unseen)
        fields.append(
            ("not seen", f"metering shows no light in {share}, all of which may be too dark")
        )
    fields += [("result", str(path)), ("", "nothing was shot")]
    table = format_table(headings, rows, right_aligned=range(1, len(headings)))
    return f"{table}\n\n{format_fields(fields)}"


def _unseen(shown: ResponsePreview) -> float:
    return 0.0 if shown.plan.light is None else shown.plan.light.unseen


def _free_name() -> Path:
    """Return a name of a picture that does not exist, by date and time."""
    from camctl.system.files import make_folder

    folder = new_directory(kind="preview")
    make_folder(folder.parent)
    return folder.with_name(f"{folder.name}{_SUFFIX}")
