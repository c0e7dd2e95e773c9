"""The exposure series of photographs, or of the frames of a capture."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.options import option_group
from camctl.cli.output import print_warning
from camctl.cli.parameter_types import PATH
from camctl.errors import DataError, UsageError
from camctl.interface.controls import Layout
from camctl.photographs.files import check_times, read_photograph, unknown_time
from camctl.records.report_file import FRAMES, REPORT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from camctl.calibration.response.series import Series
    from camctl.interface.camera import CameraInfo
    from camctl.interface.controls import ExposureControls
    from camctl.model.response.camera import CameraResponse
    from camctl.records.report import CaptureReport
    from camctl.stills.decoding import Still


@dataclass(frozen=True)
class SeriesOptions:
    """Where the frames come from, beside a camera."""

    files: tuple[Path, ...]
    times: tuple[float, ...] | None = None
    black: int | None = None
    white: int | None = None


series_options = option_group(
    SeriesOptions,
    "source",
    click.argument("files", type=PATH, nargs=-1, metavar="[FILES]..."),
    options.TIMES_OPTION,
    options.BLACK_OPTION,
    options.WHITE_OPTION,
)


def series_of_files(
    source: SeriesOptions, *, keep: bool, needs_times: bool = True
) -> tuple[CameraInfo | None, str, Series, list[NDArray[Any]]]:
    """Return the camera and its mode (where known), the series and, with `keep`, the frames.

    Raises:
        UsageError: `needs_times`, and a file does not say its exposure time
        DataError: a file cannot be read, or the files differ in format
    """
    if (stored := stored_capture(source)) is not None:
        return _from_capture(stored, keep=keep)
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


@dataclass(frozen=True)
class StoredCapture:
    """Frames of a capture in a folder, with what its report says of them.

    Attributes:
        report: of the capture
        positions: of the frames that are used
    """

    report: CaptureReport
    positions: tuple[int, ...]

    @cached_property
    def mode(self) -> str:
        """The camera's mode, as its profile names it; a frame is read for it."""
        from camctl.profiles.exposures import mode_name

        shape = self.report.frame(self.positions[0]).shape
        return mode_name(self.report.layout, shape, self.report.white, self.report.pixel_format)

    @property
    def black(self) -> int:
        """Brightness without light, DN."""
        return self.report.frames[0].black

    def responses(self, name: str | None) -> dict[str, CameraResponse]:
        """Return the response of each channel: the named one, else the measured one, else linear.

        Raises:
            UsageError: there is no response of that name
        """
        from camctl.calibration.noise.pairs import channel_names
        from camctl.profiles.profile import load_profile

        white = self.report.white
        if name is None:
            record = load_profile(self.report.camera).responses.get(self.mode)
            levels = {(each.black, each.white) for each in record.channels} if record else None
            if record is not None and levels == {(self.black, white)}:
                return {each.name: record.camera_response(each.name) for each in record.channels}
            if self.report.layout in (Layout.MONO, Layout.RGB):  # a raw mosaic is linear
                print_warning(
                    f"the response of the camera in the mode {self.mode} was not measured: its "
                    "frames are taken for linear; give --response if they are not"
                )
        real = response_named(name or "linear", white.bit_length(), self.black, white)
        return dict.fromkeys(channel_names(self.report.layout), real)


def response_named(name: str, bits: int, black: int, white: int) -> CameraResponse:
    """Return a response by its name, for files with these levels."""
    from camctl.model.response.camera import linear_response, named_response

    return named_response(name, bits, white - black) or linear_response(
        bits, phase=0.5 if black else 0.0, levels=white - black
    )


def response_of(controls: ExposureControls, name: str | None) -> CameraResponse | None:
    """Return the response of a camera by the name that the user gave it; None: none given."""
    if name is None:
        return None
    return response_named(name, controls.bits, controls.black, controls.white)


def stored_capture(source: SeriesOptions) -> StoredCapture | None:
    """Return the capture whose folder, folder of frames, or frames are given; None: photographs.

    Raises:
        DataError: the folder holds no complete capture, or frames belong to none
        UsageError: options of photographs are given for a capture
    """
    from camctl.records.folder_store import read_report

    if len(source.files) == 1 and source.files[0].is_dir():
        folder, names = source.files[0], None
        if folder.resolve().name == FRAMES and not (folder / REPORT).exists():
            folder = folder.resolve().parent
    elif source.files and all(path.suffix == ".npy" for path in source.files):
        folder = source.files[0].resolve().parent.parent
        names = {path.resolve() for path in source.files}
    else:
        return None
    if source.times or source.black is not None or source.white is not None:
        raise UsageError(
            "--times, --black and --white belong to photographs",
            hint="leave them out: the report of a capture says them",
        )
    report = read_report(folder)
    return StoredCapture(report, _positions(report, folder, names))


def _positions(report: CaptureReport, folder: Path, names: set[Path] | None) -> tuple[int, ...]:
    """Return the positions of the frames in these files; None: of all frames."""
    if names is None:
        return tuple(range(len(report.frames)))
    stored = {
        (folder / frame.file).resolve(): position
        for position, frame in enumerate(report.frames)
        if frame.file is not None
    }
    for path in sorted(names - stored.keys()):
        raise DataError(
            f"{path} is no frame of the capture in {folder}",
            hint="give the folder of a capture, or frames of one capture",
        )
    return tuple(sorted(stored[path] for path in names))


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
    from camctl.calibration.response.series import Series

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
    stored: StoredCapture, *, keep: bool
) -> tuple[CameraInfo, str, Series, list[NDArray[Any]]]:
    from camctl.calibration.response.series import Series

    report, black = stored.report, stored.black
    series = Series(
        report.layout,
        report.white.bit_length(),
        black,
        report.white,
        phase=0.5 if black else 0.0,
        levels_are_stated=True,
    )
    frames = []
    for position in stored.positions:
        record, pixels = report.frames[position], report.frame(position)
        series.add(pixels, record.exposure, record.file or f"frame {position}")
        if keep:
            frames.append(pixels)
    return report.camera, stored.mode, series, frames
