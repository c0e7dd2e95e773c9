"""`camctl table`: the exposure table."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import kinds, options
from camctl.cli.commands import LazyGroup, command
from camctl.cli.output import number, range_name, say, say_json, warn
from camctl.cli.output import table as columns
from camctl.cli.progress import progress_bar
from camctl.errors import CamctlError, DataError, StorageError, UsageError

if TYPE_CHECKING:
    from camctl.exposure.rows import TableEntry

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
    "--response", type=options.RESPONSE, metavar="linear|gamma|log", help="Only this response."
)
@click.option(
    "--range",
    "dynamic_range",
    type=kinds.Range(),
    metavar="low|medium|high|NUMBER",
    help="Only this dynamic range.",
)
@click.option(
    "-n",
    "--exposures",
    "count",
    type=options.COUNT,
    metavar="N",
    help="Only this number of exposures.",
)
@options.real_camera
@options.as_json
@click.pass_context
def show(
    context: click.Context,
    path: Path | None,
    response: str | None,
    dynamic_range: float | None,
    count: int | None,
    bits: int,
    phase: float,
    curve: str | None,
    as_json: bool,
) -> None:
    """Show which exposures the table holds, what they cost and what they give.

    Each row belongs to one camera's levels, one response, one range and one number of exposures.
    With --bits, --phase or --curve the table must be of that camera.
    """
    from camctl.exposure.table import ExposureTable, default_table

    found = default_table() if path is None else ExposureTable.load(path)
    if options.given(context) & {"bits", "phase", "curve"}:
        real = options.real_response(bits, phase, curve)
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
    ]
    if as_json:
        say_json({"entries": [entry.model_dump() for entry in entries]})
    elif entries:
        say(_rows(entries))
    else:
        raise UsageError(
            "the table holds no such row", hint="camctl solve finds exposures for any wish"
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
@options.real_camera
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

    Takes seconds a row.  Finished rows are kept beside the table, so that the same command goes on
    where an interrupted one stopped.
    """
    from camctl.exposure.table import build_table

    if output.exists() and not force:
        raise StorageError(f"{output} exists", hint="choose another name with -o, or say --force")
    real = options.real_response(bits, phase, curve)
    for note in real.notes:
        warn(note)
    rows = len(responses) * len(ranges) * count
    parts = output.with_name(f"{output.name}.parts")
    try:
        with (
            progress_bar(f"solving {rows} rows") as tick,
            _executor(min(workers or os.cpu_count() or 1, rows)) as executor,
        ):
            made = build_table(
                real,
                responses,
                ranges,
                range(1, count + 1),
                seed=seed,
                executor=executor,
                state=parts,
                progress=None if tick is None else lambda done, all_: tick(done / all_, ""),
            )
    except KeyboardInterrupt:
        kept = len(list(parts.glob("*.json")))
        raise InterruptedBuildError(
            f"interrupted with {kept} of {rows} rows done"
            + (f", which are kept in {parts}" if kept else ""),
            hint="say the same again to go on" if kept else "",
        ) from None
    made.save(output)
    if as_json:
        say_json({"file": output, "entries": [entry.model_dump() for entry in made.entries]})
    else:
        say(f"{rows} rows for {real.name} in {output}; see camctl table show --table {output}")


@contextmanager
def _executor(workers: int) -> Iterator[Executor | None]:
    """Yield processes to work with; None for one worker, which is this one."""
    if workers == 1:
        yield None
        return
    import multiprocessing
    from concurrent.futures import ProcessPoolExecutor

    pool = ProcessPoolExecutor(
        workers,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=signal.signal,
        initargs=(signal.SIGINT, signal.SIG_IGN),  # Control-C is for us to answer
    )
    try:
        yield pool
    except BaseException:
        for child in multiprocessing.active_children():
            child.terminate()  # a row can take a long while, and nobody waits for it
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()
