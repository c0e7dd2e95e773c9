"""`camctl table`: the exposure table."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli import parameters as kinds
from camctl.cli.commands import LazyGroup, command
from camctl.cli.evaluate import rows_text, sensitivity_facts
from camctl.cli.output import (
    executor_of,
    number,
    progress_bar,
    range_name,
    say,
    say_json,
    share_of_time,
    warn,
)
from camctl.cli.output import table as columns
from camctl.cli.response_options import real_camera, real_response
from camctl.errors import CamctlError, DataError, StorageError, UsageError

if TYPE_CHECKING:
    from camctl.exposure.robustness import Robustness
    from camctl.exposure.table import TableEntry
    from camctl.response.camera import CameraResponse

table = LazyGroup(
    "table",
    help="Show the exposure table, or build one for another camera.",
    examples=(
        ("camctl table show", "the table that ships, for an 8-bit linear camera"),
        ("camctl table build --bits 10 -o ten-bit.json", "one for a 10-bit camera"),
    ),
)


class InterruptedBuildError(CamctlError):
    """Somebody stopped the building of a table; the rows that were solved are kept."""

    exit_status = 130


@command(
    parent=table,
    examples=(
        ("camctl table show", "all rows of the table that ships"),
        ("camctl table show --response log --range high", "some of them"),
        ("camctl table show --table ten-bit.json --json", "a table of your own, for a script"),
        ("camctl table show -n 3 --sensitivity", "what wrong exposures and noise leave of it"),
    ),
)
@click.option(
    "--table",
    "path",
    type=kinds.PATH,
    metavar="FILE",
    help="A table that was built.  [default: the one that ships]",
)
@click.option(
    "--response",
    type=options.RESPONSE,
    metavar="linear|gamma|log",
    help="Only this response.  [default: all]",
)
@click.option(
    "--range",
    "dynamic_range",
    type=kinds.Range(),
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
    help="Show what is left of the effective levels when exposures are off by 0.01, 0.1 or 1 %, "
    "with noise of 0.1, 0.5 or 2 brightness levels, and over the quantiser's phases.  Takes about "
    "0.1 s a row of 8 bits.",
)
@real_camera
@options.as_json
@click.pass_context
def show(
    context: click.Context,
    path: Path | None,
    response: str | None,
    dynamic_range: float | None,
    count: int | None,
    sensitivity: bool,
    bits: int,
    phase: float,
    curve: str | None,
    coefficients: tuple[float, ...] | None,
    as_json: bool,
) -> None:
    """Show which exposures the table holds, what they cost and what they give.

    Each row belongs to one camera's levels, one response, one range and one number of exposures.
    With --bits, --phase or --curve the table must be of that camera.
    """
    from camctl.exposure.table import ExposureTable, default_table

    found = default_table() if path is None else ExposureTable.load(path)
    real = None
    if options.given(context) & {"bits", "phase", "curve", "coefficients"}:
        real = real_response(bits, phase, curve, coefficients)
        if all(entry.camera != real.fingerprint for entry in found.entries):
            where = "the table that ships" if path is None else str(path)
            raise DataError(
                f"{where} holds no row for {real.name}", hint="make one with camctl table build"
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
            "the table holds no such row", hint="camctl solve finds exposures for any wish"
        )
    judged = _judged(entries, real) if sensitivity else []
    if as_json:
        told = [entry.model_dump() for entry in entries]
        for row, each in zip(told, judged, strict=False):
            row["sensitivity"] = sensitivity_facts(each)
        say_json({"entries": told})
    else:
        say(rows_text(entries, judged) if judged else _rows(entries))


def _judged(entries: list[TableEntry], real: CameraResponse | None) -> list[Robustness]:
    """Return the sensitivity of each row; without `real`, of the camera that its levels tell."""
    from camctl.exposure.robustness import sensitivity
    from camctl.response.desired import desired_response

    judged = []
    weight = sum(entry.n for entry in entries)
    with progress_bar(f"disturbing {len(entries)} rows") as tick:
        cameras: dict[str, CameraResponse] = {}
        for entry in entries:
            if entry.camera not in cameras:
                cameras[entry.camera] = real or _camera_of(entry)
            judged.append(
                sensitivity(
                    cameras[entry.camera],
                    desired_response(entry.response, entry.dynamic_range),
                    entry.exposures,
                    levels_wanted=entry.levels_wanted,
                )
            )
            if tick is not None:
                tick(sum(each.n for each in entries[: len(judged)]) / weight, "")
    return judged


def _camera_of(entry: TableEntry) -> CameraResponse:
    """Return the linear camera whose levels a row names; others the user has to name."""
    for bits in range(1, 17):
        for phase in (0.0, 0.5):
            real = real_response(bits, phase, None, None)
            if real.fingerprint == entry.camera:
                return real
    raise UsageError(
        f"--sensitivity needs the camera, {entry.camera_name}",
        hint="name it with --bits, --phase and --curve, as when the table was built",
    )


def _rows(entries: list[TableEntry]) -> str:
    cameras = dict.fromkeys(entry.camera_name for entry in entries)
    blocks = []
    for name in cameras:
        lines = [
            (
                entry.response,
                range_name(entry.dynamic_range),
                str(entry.n),
                number(entry.effective_levels, 4),
                f"{number(entry.xi, 5)} of {number(entry.levels_wanted)}",
                number(entry.total_exposure, 4),
                "  ".join(number(exposure) for exposure in entry.exposures),
            )
            for entry in entries
            if entry.camera_name == name
        ]
        heads = ("response", "range", "n", "effective", "missing (xi)", "shutter", "exposures")
        blocks.append(f"camera: {name}\n\n" + columns(heads, lines, right=(1, 2, 3, 4, 5)))
    legend = (
        "effective: equal steps of brightness that would be as accurate; "
        "shutter: open time in units of the shortest exposure"
    )
    return "\n\n".join([*blocks, legend])


@command(
    parent=table,
    examples=(
        ("camctl table build --bits 10 -o ten-bit.json", "every menu entry for a 10-bit camera"),
        (
            "camctl table build --curve webcam.txt --responses log --ranges 500,5000 -n 3",
            "six rows for a measured camera",
        ),
    ),
)
@real_camera
@click.option(
    "--responses",
    type=kinds.Names("response", options.RESPONSES),
    default="linear,gamma,log",
    metavar="NAME,...",
    help="Wanted responses.",
)
@click.option(
    "--ranges",
    type=kinds.Ranges(),
    default="low,medium,high",
    metavar="RANGE,...",
    help="Wanted dynamic ranges, by name or number.",
)
@click.option(
    "-n",
    "--exposures",
    "count",
    type=options.COUNT,
    default=6,
    metavar="N",
    help="Numbers of exposures: 1 up to N.",
)
@options.seed
@click.option(
    "--workers",
    type=kinds.Whole("a whole number of workers, 1 to 256", least=1, most=256),
    metavar="N",
    help="Processes that share the work; the table is the same.  [default: one a processor]",
)
@click.option(
    "-o",
    "--output",
    type=kinds.PATH,
    default="exposure-table.json",
    metavar="FILE",
    help="The table.",
)
@click.option("--force", is_flag=True, help="Replace an existing file.")
@options.as_json
def build(
    bits: int,
    phase: float,
    curve: str | None,
    coefficients: tuple[float, ...] | None,
    responses: tuple[str, ...],
    ranges: tuple[float, ...],
    count: int,
    seed: int,
    workers: int | None,
    output: Path,
    force: bool,
    as_json: bool,
) -> None:
    """Build an exposure table for a camera.

    Takes seconds a row, most of them for five exposures and more.  Finished rows are kept beside
    the table, so that the same command goes on where an interrupted one stopped.
    """
    from camctl.exposure.build import build_table, table_jobs

    if output.exists() and not force:
        raise StorageError(f"{output} exists", hint="choose another name with -o, or say --force")
    real = real_response(bits, phase, curve, coefficients)
    for note in real.notes:
        warn(note)
    each = len(responses) * len(ranges)
    rows = each * count
    done = 0

    def count_rows(finished: int, _all: int) -> None:
        nonlocal done
        done = finished
        if tick is not None:
            tick(share_of_time(finished, each, count), "")

    parts = output.with_name(f"{output.name}.parts")
    try:
        with (
            progress_bar(f"solving {rows} rows") as tick,
            executor_of(min(workers or os.cpu_count() or 1, rows)) as executor,
        ):
            made = build_table(
                table_jobs(real, responses, ranges, range(1, count + 1), seed=seed),
                executor=executor,
                state=parts,
                progress=count_rows,
            )
    except KeyboardInterrupt:
        raise InterruptedBuildError(
            f"interrupted with {done} of {rows} rows done"
            + (f", which are kept in {parts}" if done else ""),
            hint="say the same again to go on" if done else "",
        ) from None
    made.save(output)
    if as_json:
        say_json({"file": output, "entries": [entry.model_dump() for entry in made.entries]})
    else:
        say(f"{rows} rows for {real.name} in {output}; see camctl table show --table {output}")
