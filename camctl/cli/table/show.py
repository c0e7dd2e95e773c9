"""`camctl table show`: the rows of an exposure table."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import (
    format_number,
    format_range,
    format_table,
    print_json,
    print_text,
    progress_bar,
)
from camctl.cli.parameter_types import PATH, DynamicRange
from camctl.cli.response_options import RESPONSE, RealCameraOptions, real_camera_options
from camctl.cli.sensitivity import sensitivity_json, sensitivity_table
from camctl.errors import DataError, UsageError

if TYPE_CHECKING:
    from camctl.exposure.robustness import Robustness
    from camctl.exposure.table import TableEntry
    from camctl.response.camera import CameraResponse


@command(
    examples=(
        ("camctl table show", "all rows of the built-in table"),
        ("camctl table show --response log --range high", "some of them"),
        ("camctl table show --table ten-bit.json --json", "a table of your own, for a script"),
        ("camctl table show -n 3 --sensitivity", "with exposure errors and noise"),
    ),
)
@click.option(
    "--table",
    "path",
    type=PATH,
    metavar="FILE",
    help="Table made by camctl table build.  [default: the built-in one]",
)
@click.option(
    "--response",
    type=RESPONSE,
    metavar="linear|gamma|log",
    help="Only this response.  [default: all]",
)
@click.option(
    "--range",
    "dynamic_range",
    type=DynamicRange(),
    metavar="low|medium|high|NUMBER",
    help="Only this dynamic range.  [default: all]",
)
@click.option(
    "-n",
    "--exposures",
    "count",
    type=options.COUNT,
    metavar="N",
    help="Only this number of exposures.  [default: all]",
)
@click.option(
    "--sensitivity",
    is_flag=True,
    help="Show the effective levels with exposure errors of 0.01, 0.1 and 1 %, with noise of 0.1, "
    "0.5 and 2 brightness levels, and over all phases of the quantiser.  Takes about 0.1 s per row "
    "of 8 bits.",
)
@real_camera_options
@options.as_json
@click.pass_context
def show(
    context: click.Context,
    path: Path | None,
    response: str | None,
    dynamic_range: float | None,
    count: int | None,
    sensitivity: bool,
    real_camera: RealCameraOptions,
    as_json: bool,
) -> None:
    """Show the exposures in the table, how long they take and how good they are.

    Each row is for one camera, response, dynamic range and number of exposures. With --bits,
    --phase or --curve only rows of that camera are shown.
    """
    from camctl.exposure.table import ExposureTable, default_table

    found = default_table() if path is None else ExposureTable.load(path)
    real = None
    if options.given(context) & {"bits", "phase", "curve", "coefficients"}:
        real = real_camera.response()
        if all(entry.camera != real.fingerprint for entry in found.entries):
            name = "the built-in table" if path is None else f"table {path}"
            raise DataError(
                f"{name} has no row for {real.name}", hint="build one with camctl table build"
            )
    entries = [
        entry
        for entry in found.entries
        if response in (None, entry.response)
        and dynamic_range in (None, entry.dynamic_range)
        and count in (None, entry.n)
        and (real is None or entry.camera == real.fingerprint)
    ]
    if not (entries or as_json):
        raise UsageError(
            "the table has no such row",
            hint="camctl solve finds exposures for any response, range and number",
        )
    robustness = _robustness(entries, real) if sensitivity else []
    if as_json:
        rows = [entry.model_dump() for entry in entries]
        for row, each in zip(rows, robustness, strict=False):
            row["sensitivity"] = sensitivity_json(each)
        print_json({"entries": rows})
    else:
        print_text(sensitivity_table(entries, robustness) if robustness else _rows_text(entries))


def _robustness(entries: list[TableEntry], real: CameraResponse | None) -> list[Robustness]:
    """Return the robustness of each row; without `real`, for the camera found by its levels."""
    from camctl.exposure.robustness import sensitivity
    from camctl.response.desired import desired_response

    robustness = []
    exposures = sum(entry.n for entry in entries)
    with progress_bar(f"computing {len(entries)} rows") as bar:
        cameras: dict[str, CameraResponse] = {}
        for entry in entries:
            if entry.camera not in cameras:
                cameras[entry.camera] = real or _linear_camera(entry)
            robustness.append(
                sensitivity(
                    cameras[entry.camera],
                    desired_response(entry.response, entry.dynamic_range),
                    entry.exposures,
                    levels_wanted=entry.levels_wanted,
                )
            )
            if bar is not None:
                bar(sum(each.n for each in entries[: len(robustness)]) / exposures, "")
    return robustness


def _linear_camera(entry: TableEntry) -> CameraResponse:
    """Return the linear camera with the levels of a row; raise `UsageError` for any other."""
    for bits in range(1, 17):
        for phase in (0.0, 0.5):
            real = RealCameraOptions(bits, phase, None, None).response()
            if real.fingerprint == entry.camera:
                return real
    raise UsageError(
        f"--sensitivity needs the response of the camera {entry.camera_name}",
        hint="give --bits, --phase and --curve as when the table was built",
    )


def _rows_text(entries: list[TableEntry]) -> str:
    cameras = dict.fromkeys(entry.camera_name for entry in entries)
    blocks = []
    for name in cameras:
        rows = [
            (
                entry.response,
                format_range(entry.dynamic_range),
                str(entry.n),
                format_number(entry.effective_levels, 4),
                f"{format_number(entry.xi, 5)} of {format_number(entry.levels_wanted)}",
                format_number(entry.total_exposure, 4),
                "  ".join(map(format_number, entry.exposures)),
            )
            for entry in entries
            if entry.camera_name == name
        ]
        headings = (
            *("response", "range", "n", "effective levels", "missing (xi)", "total time"),
            "exposures",
        )
        text = format_table(headings, rows, right_aligned=(1, 2, 3, 4, 5))
        blocks.append(f"camera: {name}\n\n{text}")
    legend = (
        "effective levels: equal steps of brightness that would be as accurate; "
        "missing (xi): desired levels not reached;\n"
        "exposures and their total time are relative to the shortest exposure"
    )
    return "\n\n".join([*blocks, legend])
