"""`camctl figures`: the figures of the paper, recomputed."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import option
from camctl.cli.output import (
    format_fields,
    print_json,
    print_text,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import PATH, ListOf, Name, WholeNumber
from camctl.cli.request_options import named
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.profiles.response import ResponseRecord

NUMBERS = ("3", "4", "5", "6", "7", "8", "9", "10")
"""Keys of `camctl.studies.figures.FIGURES`, here because that module imports numpy."""

LONGEST = ("4", "10", "8")
"""Figures that take long; they are begun first."""


@command(
    examples=(
        ("camctl figures", "all of them, as PNG files in the folder figures"),
        ("camctl figures --only 5,7 -o paper --svg", "two of them, also as SVG"),
        ("camctl figures --only 10 --profile NAME", "from the measured response of a camera"),
        ("camctl figures -o small --dpi 80", "smaller files"),
    )
)
@option(
    "-o --output DIR",
    "Folder for the files; it is made if it does not exist.",
    PATH,
    field="folder",
    default="figures",
)
@option(
    "--only N,...",
    "Numbers of figures; 4 is the table 4(a).",
    ListOf(Name("figure", NUMBERS), unique=True),
    field="numbers",
    default=",".join(NUMBERS),
)
@option(
    "--profile NAME",
    "Draw figure 10 with the response that this profile has of the simulated camera "
    "'consumer', in place of the true one; see camctl profile list.",
    click.STRING,
    field="profile_name",
)
@option("--svg", "Also write SVG files.")
@option(
    "--dpi N",
    "Resolution of the PNG files, dots per inch.",
    WholeNumber(least=30, most=600),
    default=150,
)
@named("workers")
@options.force
@options.as_json
def figures(
    folder: Path,
    numbers: tuple[str, ...],
    profile_name: str | None,
    svg: bool,
    dpi: int,
    workers: int | None,
    force: bool,
    as_json: bool,
) -> None:
    """Draw the paper's figures 3 and 5 to 10 and its table 4(a), recomputed.

    Exposures are solved for and pictures are taken by the simulated camera, with the paper's
    cameras as sensors; where the paper has photographs, a simulated scene stands for them. The
    caption in each figure says what to see. Takes less than a minute.
    """
    from camctl.errors import StorageError
    from camctl.studies.figures import draw, figure_files
    from camctl.studies.parallel import run_all
    from camctl.system.plots import check_plots

    measured = None if profile_name is None else _measured(profile_name)
    todo = figure_files(numbers, folder, svg=svg, dpi=dpi, measured=measured)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"could not make the folder {folder}: {error.strerror}") from error
    check_plots(tuple(path for files in todo for path in files.paths), overwrite=force)
    in_order = sorted(todo, key=lambda files: files.number not in LONGEST)
    with progress_bar(f"drawing {len(todo)} figures") as bar:
        run_all(draw, in_order, workers=workers, progress=without_stage(bar))
    if as_json:
        drawn = [
            {
                "figure": files.number,
                "title": files.title,
                "caption": files.caption,
                "files": files.paths,
            }
            for files in todo
        ]
        print_json({"figures": drawn})
        return
    print_text(format_fields([(f"figure {f.number}", f"{f.title}: {f.paths[0]}") for f in todo]))


def _measured(name: str) -> ResponseRecord:
    """Return the newest response in a profile that a colour camera of 8 bits has."""
    from camctl.profiles.folder import find_profile

    found = [
        record
        for record in find_profile(name).responses.values()
        if [(each.black, each.white) for each in record.channels] == [(0, 255)] * 3
    ]
    if not found:
        raise UsageError(
            f"the profile {name} has no response of three channels from 0 to 255",
            hint="measure it: camctl calibrate response --sensor consumer -O unknown=yes",
        )
    return max(found, key=lambda record: record.measured_at)
