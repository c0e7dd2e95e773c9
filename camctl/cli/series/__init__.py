"""`camctl series`: the same picture many times, at even intervals or on a key."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.cli import options
from camctl.cli.capture_output import new_directory
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, declare, option
from camctl.cli.parameter_types import PATH, Name, Seconds, Text, WholeNumber
from camctl.cli.request_options import RequestOptions, request_options
from camctl.cli.series.run import HookOptions, check_keys, hook_options, run_series
from camctl.cli.shoot import PICTURE_OPTIONS
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.records.journal import SeriesOptions

_MOST_SETS = 100_000  # `camctl.records.journal.MOST_SETS`, which imports numpy
_LEAST_INTERVAL_S = 1e-9  # `camctl.records.journal.LEAST_INTERVAL_S`


@dataclass(frozen=True)
class SetOptions:
    """How the sets of a series follow each other."""

    repeat: int | None = declare(
        "--repeat N",
        "Number of sets.  In a terminal p pauses the series and q ends it.",
        WholeNumber(least=1, most=_MOST_SETS),
    )
    interval_s: float | None = declare(
        "--interval SECONDS",
        "Time from the start of one set to the start of the next; a start that has passed "
        "because the set before took longer is left out.  [default: one set after another]",
        Seconds(least=_LEAST_INTERVAL_S),
    )
    on_key: bool = declare(
        "--on-key", "Take a set whenever enter or space is pressed, until q is (or N are taken)."
    )
    name: str | None = declare(
        "--name PATTERN",
        "Names of the sets' folders, with {number}, {date} and {time}; a name that is taken "
        "gets -{number} at its end.  [default: set-{number}]",
        Text(),
    )
    metering: str | None = declare(
        "--meter [once|each]",
        "Meter with full exposures on a camera that has no preview: once for all sets (as "
        "without --meter), or each of them.",
        Name("time to meter", ("once", "each")),
        is_flag=False,
        flag_value="once",
    )

    def options(self) -> SeriesOptions:
        """Return the options as the journal of a series keeps them.

        Raises:
            UsageError: the name pattern is invalid, or two options contradict each other
        """
        from camctl.records.journal import PATTERN, SeriesOptions, check_pattern

        if self.repeat is None and not self.on_key:
            raise UsageError(
                "a series needs its number of sets", hint="give it with --repeat N, or use --on-key"
            )
        if self.on_key and self.interval_s is not None:
            raise UsageError(
                "--on-key cannot be combined with --interval", hint="leave one of them out"
            )
        return SeriesOptions(
            repeat=self.repeat,
            interval_s=self.interval_s,
            on_key=self.on_key,
            name=check_pattern(PATTERN if self.name is None else self.name),
            meter="each" if self.metering == "each" else "once",
        )


_set_options = options.option_group(SetOptions, "sets")


@command(
    examples=(
        ("camctl series --repeat 50 --interval 60 -o day", "one picture a minute"),
        ("camctl series --on-key", "one picture for each key"),
        ("camctl resume day", "continue a series that was interrupted"),
    )
)
@_set_options
@hook_options
@options.camera_options
@request_options(
    *(each for each in PICTURE_OPTIONS if each != "spend_shutter"), "settings", has_light=True
)
@option(
    "-o --output PATH",
    "Folder of the series.  [default: series-DATE-TIME in the working directory]",
    PATH,
    field="directory",
)
@options.as_json
def series(
    sets: SetOptions,
    hook: HookOptions,
    camera: CameraOptions,
    request: RequestOptions,
    directory: Path | None,
    as_json: bool,
) -> None:
    """Take the same picture many times.

    Each set is what `camctl shoot` takes, in a folder of its own, with a page of all of them
    (index.html). A set that fails is tried again once, then left out.
    """
    from camctl.records.journal import SeriesJournal, check_series_folder

    hook.check()
    chosen = sets.options()
    request["spend_shutter"] = sets.metering is not None
    wanted = request.request()
    directory = new_directory(kind="series") if directory is None else directory
    check_keys(needed=chosen.on_key)
    check_series_folder(directory)
    with camera.open() as opened:
        journal = SeriesJournal(
            camera=opened.info,
            source=camera.source(),
            request=wanted,
            table_file=None if request.table is None else str(Path.cwd() / request.table),
            options=chosen,
            has_hook=hook.hook is not None,
        )
        run_series(opened, journal, hook, directory, as_json=as_json)
