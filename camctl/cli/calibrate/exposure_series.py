"""The exposure series of photographs, or of the frames of a capture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli.options import option_group
from camctl.cli.parameter_types import PATH
from camctl.cli.photograph_options import BLACK_OPTION, TIMES_OPTION, WHITE_OPTION
from camctl.errors import DataError, UsageError
from camctl.merging.photograph_files import check_times, read_photograph, unknown_time

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from camctl.calibration.response_series import Series
    from camctl.camera import CameraInfo
    from drivers.common.still_file import Still


@dataclass(frozen=True)
class SeriesOptions:
    """Where the frames come from, beside a camera."""

    files: tuple[Path, ...]
    times: tuple[float, ...] | None
    black: int | None
    white: int | None


series_options = option_group(
    SeriesOptions,
    "source",
    click.argument("files", type=PATH, nargs=-1, metavar="[FILES]..."),
    TIMES_OPTION,
    BLACK_OPTION,
    WHITE_OPTION,
)


def series_of_files(
    source: SeriesOptions, *, keep: bool, needs_times: bool = True
) -> tuple[CameraInfo | None, str, Series, list[NDArray[Any]]]:
    """Return the camera and its mode (where known), the series and, with `keep`, the frames.

    Raises:
        UsageError: `needs_times`, and a file does not say its exposure time
        DataError: a file cannot be read, or the files differ in format
    """
    if len(source.files) == 1 and source.files[0].is_dir():
        refuse_for_capture(source)
        return _from_capture(source.files[0], keep=keep)
    series: Series | None = None
    frames = []
    for path, still, time_s in read_stills(source, needs_times=needs_times):
        if series is None:
            series = _new_series(source, still)
        elif still.layout != series.layout or still.bits != series.bits:
            raise DataError(
                f"{path} is {still.layout}, {still.bits} bits, and {source.files[0]} is "
                f"{series.layout}, {series.bits} bits",
                hint="give frames of one size and format",
            )
        if math.isnan(time_s):
            series.exposures_are_stated = False
            time_s = 1.0
        series.add(still.pixels, time_s, path.name)
        if keep:
            frames.append(still.pixels)
    assert series is not None
    return None, "", series, frames


def refuse_for_capture(source: SeriesOptions) -> None:
    """Raise `UsageError` where options of photographs are given for a capture."""
    if source.times or source.black is not None or source.white is not None:
        raise UsageError(
            "--times, --black and --white belong to photographs",
            hint="leave them out: the report of a capture says them",
        )


def levels_of(source: SeriesOptions, still: Still) -> tuple[int, int]:
    """Return the black and white level of a file: as given, else as it states them."""
    return (
        still.black if source.black is None else source.black,
        still.white if source.white is None else source.white,
    )


def check_levels(bits: int, black: int, white: int) -> None:
    """Raise `UsageError` where frames of so many bits cannot have these levels."""
    if not black < white < 2**bits:
        raise UsageError(
            f"invalid levels: black {black} and white {white} in files of {bits} bits",
            hint=f"expected black < white < {2**bits}",
        )


def _new_series(source: SeriesOptions, still: Still) -> Series:
    from camctl.calibration.response_series import Series

    black, white = levels_of(source, still)
    check_levels(still.bits, black, white)
    return Series(
        still.layout,
        still.bits,
        black,
        white,
        phase=0.5 if black else 0.0,
        levels_are_stated=source.black is not None or source.white is not None or black > 0,
    )


def read_stills(
    source: SeriesOptions, *, needs_times: bool = True
) -> Iterator[tuple[Path, Still, float]]:
    """Yield path, content and shutter time of each file; nan where it is unknown.

    Raises:
        DataError: a file cannot be read
        UsageError: a time is unknown, and `needs_times`
    """
    check_times(source.files, source.times)
    for path, given_s in zip(source.files, source.times or repeat(None), strict=False):
        still, stated = read_photograph(path)
        time_s = given_s or stated.time_s
        if time_s is None and needs_times:
            raise unknown_time(path)
        yield path, still, math.nan if time_s is None else time_s


def _from_capture(
    folder: Path, *, keep: bool
) -> tuple[CameraInfo, str, Series, list[NDArray[Any]]]:
    from camctl.calibration.response_series import Series
    from camctl.captures.folder_store import read_report
    from camctl.exposure_record import mode_name

    report = read_report(folder)
    black = report.frames[0].black
    series = Series(
        report.layout,
        report.white.bit_length(),
        black,
        report.white,
        phase=0.5 if black else 0.0,
        levels_are_stated=True,
    )
    frames = []
    shape: tuple[int, ...] = ()
    for position, record in enumerate(report.frames):
        pixels = report.frame(position)
        shape = pixels.shape
        series.add(pixels, record.exposure, record.file or f"frame {position}")
        if keep:
            frames.append(pixels)
    mode = mode_name(report.layout, shape, report.white, report.pixel_format)
    return report.camera, mode, series, frames
