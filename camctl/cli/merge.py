"""`camctl merge`: the picture of an effective camera from photographs already taken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.capture_output import (
    new_directory,
    print_findings,
    show_capture,
)
from camctl.cli.capture_output.summary import capture_text
from camctl.cli.commands import command
from camctl.cli.options import declare, declare_as
from camctl.cli.output import (
    format_duration,
    format_table,
    print_json,
    print_text,
)
from camctl.cli.parameter_types import FILE, PATH, Name, Number, Ratios, Text
from camctl.cli.real_camera import STANDARDS
from camctl.cli.request_options import (
    COUNT,
    STOPS,
    RequestOption,
    RequestOptions,
    request_options,
)
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.photographs.merge import MergePlan
    from camctl.records.report import CaptureReport


@dataclass(frozen=True)
class SourceOptions:
    """The photographs, and what is known of them beside their files."""

    files: tuple[Path, ...] = declare_as(
        click.argument("files", type=PATH, nargs=-1, required=True, metavar="FILES...")
    )
    times: tuple[float | Fraction, ...] | None = declare_as(options.DIAL_TIMES_OPTION)
    labels: str = declare(
        "--labels auto|dial|exact|pixels",
        "What the times are: nominal shutter speeds (1/60 means 1/64 s), corrected from the "
        "pixels; exact ones, which are not; or rough, and estimated from the pixels.  auto takes "
        "numbers such as 0.02 for exact; EXIF data and fractions such as 1/60 for nominal where "
        "all of them are usual shutter speeds.",
        Name("meaning of the times", ("auto", "dial", "exact", "pixels")),
        default="auto",
    )
    black: int | None = declare_as(options.BLACK_OPTION)
    white: int | None = declare_as(options.WHITE_OPTION)
    curve: str | None = declare(
        "--curve FILE|NAME",
        "Response of the camera: a file of two columns, irradiance and brightness, or linear, "
        "srgb, rec709, power:GAMMA.  [default: linear for raw, else from the profile of the "
        "camera in the EXIF data, or estimated from the photographs]",
        Text(lambda: (*STANDARDS, "linear", "power:"), files=True),
    )
    mask: str | None = declare(
        "--mask FILE",
        "Picture that is black where the photographs, of the same size, are not valid.  "
        "[default: a border of one pure colour is cut off]",
        FILE,
    )
    align: str = declare(
        "--align none|shift|full",
        "What to do with photographs that are shifted against the others: move them by whole "
        "pixels, which keeps every level; or by a homography, which corrects turns, too, and "
        "interpolates.",
        Name("alignment", ("none", "shift", "full")),
        default="shift",
    )
    colour: str = declare(
        "--colour bt709|camera",
        "Colours of the pictures: linear light of the primaries of BT.709 (sRGB), with the white "
        "balance of the first photograph; or R, G and B as they are in the files, for measuring.",
        Name("colours of the pictures", ("bt709", "camera")),
        default="bt709",
    )
    deghost: str | None = declare(
        "--deghost none|single",
        "Places where something moved: computed from all photographs, or each taken from a "
        "single one.  [default: single, but none with --colour camera]",
        Name("way to show what moved", ("none", "single")),
    )


_source_options = options.option_group(SourceOptions, "source")


_CHOICE = {
    "count": RequestOption(
        "Number of photographs to use, the best ones for the picture.  [default: all]",
        "N",
        COUNT,
    ),
    "ratios": RequestOption(
        "Exposures to use, relative to each other, instead of those chosen.", "A,B,...", Ratios()
    ),
    "compensation_stops": RequestOption(
        "Let more of the highlights saturate, and begin with a longer photograph (-1: a shorter "
        "one).  [default: 0]",
        "STOPS",
        STOPS,
    ),
    "clip_percent": RequestOption(
        "Share of the picture, the brightest, that may saturate in every photograph.  [default: 0]",
        "PERCENT",
        Number("a percentage from 0 to 50", least=0, most=50),
    ),
}
"""Options of a request whose help pages say something else of photographs."""


_TITLES: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
    ("ISO", "gain", lambda gain: f"{100 * gain:.0f}"),
    ("aperture", "f_number", lambda number: "unknown" if number is None else f"f/{number:.2g}"),
)
"""What may differ between photographs beside the time: its heading, its name, and its text."""


@command(
    examples=(
        ("camctl merge IMG_0*.JPG", "a bracket, with the exposures in its EXIF data"),
        ("camctl merge a.png b.png c.png --times 1/60,1/15,1/4 -o hall", "exposures given"),
        ("camctl merge *.dng -n 3 --range high", "the three raw files that serve best"),
    )
)
@_source_options
@request_options(*("response", "gamma", "dynamic_range", *_CHOICE), has_light=True, **_CHOICE)
@options.result_folder("merge")
@options.as_json
def merge(
    source: SourceOptions,
    request: RequestOptions,
    directory: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Make a picture of high dynamic range from photographs already taken.

    FILES are photographs of one scene with different exposures, from a tripod: JPEG, PNG, TIFF,
    camera raw or linear OpenEXR. All are used unless one is proven wrong or fewer are asked for;
    each one that is left out is named with the reason. The result is a folder as from `camctl
    shoot`. The default range is what the photographs hold.
    """
    from camctl.photographs.merge import plan_merge
    from camctl.photographs.photograph_set import PhotographOptions
    from camctl.records.folder_store import FolderStore

    if "ratios" in request and "count" in request:
        raise UsageError("--ratios cannot be combined with -n", hint="leave one of them out")
    folder = new_directory(kind="merge") if directory is None else directory
    FolderStore.check_free(folder, overwrite=force)
    known = asdict(source)
    found = plan_merge(known.pop("files"), request.request(), PhotographOptions(**known))
    show_capture(
        lambda complete: complete(found.capture(folder, overwrite=force)),
        folder,
        as_json=as_json,
        show=lambda report: _print(report, found, folder, as_json=as_json),
    )


def _print(report: CaptureReport, found: MergePlan, directory: Path, *, as_json: bool) -> None:
    """Print which photographs are used, which are not and why, and the summary of the capture."""
    from camctl.messages.command_line import finding_line

    print_findings(report)
    if as_json:
        from camctl.records.report_json import to_json  # loads pydantic

        print_json(to_json(report) | found.source)
        return
    photographs = sorted(
        found.photographs,
        key=lambda each: each["time_s"] * each["gain"] / (each["f_number"] or 1) ** 2,
    )
    more = [
        (title, key, text)
        for title, key, text in _TITLES
        if len({each[key] for each in photographs}) > 1
    ]
    rows = [
        (
            each["file"],
            format_duration(each["time_s"]),
            *(text(each[key]) for _, key, text in more),
            "used" if each["used"] else f"not used: {each['why_not']}",
        )
        for each in photographs
    ]
    titles = ("photograph", "time", *(title for title, _, _ in more), "")
    parts = [format_table(titles, rows, right_aligned=tuple(range(1, 2 + len(more)))), ""]
    # What each estimate leaves out is in the report alone: a warning says what moved, once.
    facts = [
        finding_line(each)
        for each in found.facts
        if each.code != "left_out" or each.details["what"] not in ("movement", "saturation")
    ]
    parts += [f"response: {found.opened.response}", *facts, ""]
    print_text("\n".join([*parts, capture_text(report, directory)]))
