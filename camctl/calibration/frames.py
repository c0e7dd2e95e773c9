"""Frames that were taken before, with their exposures: as arrays, in files, or of a capture."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, repeat
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

from numpy.typing import ArrayLike, NDArray

from camctl.calibration.noise.estimate import NoiseFrames
from camctl.calibration.noise.pairs import channel_names
from camctl.calibration.response.series import Series
from camctl.errors import DataError, UsageError
from camctl.findings import Finding
from camctl.interface.camera import CameraInfo
from camctl.interface.controls import ExposureSetting, Layout
from camctl.model.response.camera import (
    CameraResponse,
    linear_response,
    named_response,
    phase_of_black,
)
from camctl.model.sample_grid import SampleGrid
from camctl.pictures.combine_arguments import checked_frames, known_level
from camctl.profiles.exposures import mode_name
from camctl.profiles.profile import load_profile
from camctl.records.folder_store import read_report
from camctl.records.report import CaptureReport
from camctl.records.report_file import FRAMES, REPORT, SAMPLES
from camctl.stills.files import check_times, read_photograph, unknown_time

PathLike: TypeAlias = str | os.PathLike[str]
Source: TypeAlias = CaptureReport | PathLike | Iterable[PathLike] | Iterable[ArrayLike]
"""A capture, the path of its folder, paths of its frames or of photographs, or arrays."""
Response: TypeAlias = CameraResponse | str | None


class SceneFrame(NamedTuple):
    """One frame.

    Attributes:
        pixels: as `SceneFrames` says
        setting: as stated; None: the exposure is not known
        exposure: relative to the others; 1 where it is not known
        name: in messages
    """

    pixels: NDArray[Any]
    setting: ExposureSetting | None
    exposure: float
    name: str


@dataclass(frozen=True, eq=False)
class SceneFrames:
    """Frames of one scene in one mode of a camera; each is read when it is asked for, once.

    Attributes:
        frames: yields them
        layout, bits: of each
        black, white: levels, DN
        levels_are_stated: else they are looked for in the frames
        camera, mode: which camera has taken them, and how; None and "" where it is not known
        is_jpeg: they were compressed, with a curve that is about sRGB
        grid: values of their samples, where `combine` and merging see it, too; None: all
        findings: what the user should know
    """

    frames: Iterator[SceneFrame]
    layout: Layout
    bits: int
    black: int
    white: int
    levels_are_stated: bool
    camera: CameraInfo | None = None
    mode: str = ""
    is_jpeg: bool = False
    grid: SampleGrid | None = None
    findings: list[Finding] = field(default_factory=list)

    def series(self, kept: list[NDArray[Any]] | None = None) -> Series:
        """Return the exposure series; the frames are added to `kept`."""
        series = Series(
            self.layout,
            self.bits,
            self.black,
            self.white,
            phase=0.5 if self.black else 0.0,
            levels_are_stated=self.levels_are_stated,
        )
        for frame in self.frames:
            if frame.setting is None:
                series.exposures_are_stated = False
            series.add(frame.pixels, frame.exposure, frame.name)
            if kept is not None:
                kept.append(frame.pixels)
        return series

    def pairs(self, response: Response, *, is_flat: bool) -> NoiseFrames:
        """Return the pairs of frames of one exposure, as codes of their grid."""
        black, white = self.code_levels
        responses = self.responses(response)
        found = NoiseFrames(self.layout, black, white, responses, is_flat, list(self.findings))
        if self.is_jpeg:
            found.note_format(".jpg")
        for codes, setting in self.codes():
            found.add(codes, setting)
        return found

    @property
    def code_levels(self) -> tuple[int, int]:
        """The codes of black and white."""
        grid = self.grid or SampleGrid(1, 0, self.white)
        return grid.nearest(self.black), grid.code(self.white)

    def codes(self) -> Iterator[tuple[NDArray[Any], ExposureSetting]]:
        """Yield the codes of each frame, and its setting, which `scene_frames` needed."""
        for frame in self.frames:
            assert frame.setting is not None
            pixels = frame.pixels if self.grid is None else self.grid.codes(frame.pixels)
            yield pixels, frame.setting

    def responses(self, given: Response) -> dict[str, CameraResponse]:
        """Return the response of the codes of each channel: given, measured, sRGB or linear."""
        found = self._responses(given)
        if self.grid is None:
            return found
        return {name: self.grid.response(each, self.black) for name, each in found.items()}

    def _responses(self, given: Response) -> dict[str, CameraResponse]:
        """Return the response of each channel: as given, else measured, else sRGB or linear.

        Raises:
            UsageError: there is no response of that name, or it has other levels
        """
        if given is None and self.camera is not None:
            record = load_profile(self.camera).responses.get(self.mode)
            levels = {(each.black, each.white) for each in record.channels} if record else None
            if record is not None and levels == {(self.black, self.white)}:
                return {each.name: record.camera_response(each.name) for each in record.channels}
            if not self.layout.is_mosaic:  # a raw mosaic is linear
                self.findings.append(
                    Finding(
                        code="response_assumed",
                        details={"response": "linear"},
                        remedies={"calibrate_response": None, "response": None},
                    )
                )
        usual = "srgb" if self.is_jpeg else "linear"
        real = response_named(usual if given is None else given, self.bits, self.black, self.white)
        return dict.fromkeys(channel_names(self.layout), real)


def response_named(
    given: CameraResponse | str, bits: int, black: int, white: int
) -> CameraResponse:
    """Return a response, which may be given by its name, for frames with these levels.

    Raises:
        UsageError: there is no response of that name, or it has other levels
    """
    levels = white - black
    if isinstance(given, CameraResponse):
        if levels != given.M:
            raise UsageError(
                f"the response has {given.M} levels, and white - black is {levels}",
                hint="give the black and white level of the frames",
            )
        return given
    return named_response(given, bits, levels) or linear_response(
        bits, phase=phase_of_black(black), levels=levels
    )


def scene_frames(
    source: Source,
    exposures: Sequence[float] | None = None,
    *,
    black: int | None = None,
    white: int | None = None,
    layout: Layout | str | None = None,
    needs_times: Callable[[int], bool] = lambda _count: True,
    finds_levels: bool = False,
) -> SceneFrames:
    """Return the frames of a source.

    Args:
        source: where they are
        exposures: of arrays and photographs, s; None: as the files state them
        black: of arrays and photographs, DN; None: stated, or looked for
        white: likewise
        layout: of arrays: the Bayer pattern where they are mosaics
        needs_times: whether frames of unknown exposure are refused, by the number of frames
        finds_levels: levels that are not known can be found in the frames

    Raises:
        UsageError: an exposure is not known, or the white level of 16-bit arrays; frames cannot
            have these levels; something is given for a capture, which states everything
        DataError: a file cannot be read, frames differ in format, or a folder is no capture
    """
    black, white = known_level("black", black), known_level("white", white)
    levels = None if black is None and white is None else (black, white)
    if isinstance(source, str | os.PathLike):
        source = (source,)
    if not isinstance(source, CaptureReport):
        given = list(source)
        paths = [Path(each) for each in given if isinstance(each, str | os.PathLike)]
        if not paths:
            if exposures is None and needs_times(len(given)):
                raise UsageError(
                    "the exposures of the frames are not known",
                    hint="give the exposure of each frame, in s",
                )
            found = _of_arrays(given, exposures, levels, layout)
            if found.bits > 8 and white is None and not finds_levels:
                raise UsageError(
                    "the white level of 16-bit frames is not known", hint="give white, such as 4095"
                )
            return found
        if not _are_of_capture(paths):
            return _of_files(paths, exposures, levels, needs_times=needs_times(len(paths)))
    if exposures is not None or levels is not None:
        raise UsageError(
            "times, black level and white level belong to photographs",
            hint="leave them out: the report of a capture says them",
            remedies={"times": False, "black": False, "white": False},
        )
    if isinstance(source, CaptureReport):
        return _of_capture(source, range(len(source.frames)))
    return _of_capture(*_stored(paths))


def _of_arrays(
    arrays: Sequence[Any],
    exposures: Sequence[float] | None,
    levels: tuple[int | None, int | None] | None,
    layout: Layout | str | None,
) -> SceneFrames:
    pictures, stated = checked_frames(
        arrays, [1.0] * len(arrays) if exposures is None else exposures
    )
    black, white = levels or (None, None)
    most = 8 * pictures[0].dtype.itemsize
    if white is None:
        bits, white = most, 2**most - 1
    else:
        bits = min(most, max(white, *(int(each.max()) for each in pictures)).bit_length())
    kind = Layout.RGB if pictures[0].ndim == 3 else Layout(layout or Layout.MONO)
    frames = _numbered(pictures, None if exposures is None else stated)
    grid = SampleGrid.of(pictures, white, black or 0)
    found = SceneFrames(frames, kind, bits, black or 0, white, levels is not None, grid=grid)
    _check_levels(bits, found)
    return found


def _numbered(
    pictures: Sequence[NDArray[Any]], exposures: Sequence[float] | None
) -> Iterator[SceneFrame]:
    for position, pixels in enumerate(pictures):
        time_s = None if exposures is None else exposures[position]
        yield _timed(pixels, time_s, f"frame {position}")


def _timed(pixels: NDArray[Any], time_s: float | None, name: str) -> SceneFrame:
    setting = None if time_s is None else ExposureSetting(time_s)
    return SceneFrame(pixels, setting, time_s or 1.0, name)


def _of_files(
    paths: Sequence[Path],
    times: Sequence[float] | None,
    levels: tuple[int | None, int | None] | None,
    *,
    needs_times: bool,
) -> SceneFrames:
    """Return the frames of photographs; the first one says the format of all."""
    check_times(paths, None if times is None else tuple(times))
    first, _ = read_photograph(paths[0])

    def frames() -> Iterator[SceneFrame]:
        for path, given_s in zip(paths, times or repeat(None), strict=False):
            still, stated = read_photograph(path)
            if (still.layout, still.bits) != (first.layout, first.bits):
                raise DataError(
                    f"{path} is {still.layout}, {still.bits} bits, and {paths[0]} is "
                    f"{first.layout}, {first.bits} bits",
                    hint="give frames of one size and format",
                )
            time_s = given_s or stated.time_s
            if time_s is None and needs_times:
                raise unknown_time(path)
            yield _timed(still.pixels, time_s, path.name)

    black, white = levels or (None, None)
    black = first.black if black is None else black
    white = first.white if white is None else white
    others = (read_photograph(path)[0] for path in paths[1:])
    found = SceneFrames(
        frames(),
        first.layout,
        first.bits,
        black,
        white,
        levels is not None or first.black > 0,
        grid=SampleGrid.of((each.pixels for each in chain((first,), others)), white, black),
        is_jpeg=any(path.suffix.lower() in (".jpg", ".jpeg") for path in paths),
    )
    _check_levels(first.bits, found)
    return found


def _check_levels(bits: int, found: SceneFrames) -> None:
    """Raise `UsageError` where frames of so many bits cannot have these levels."""
    if not 0 <= found.black < found.white < 2**bits:
        raise UsageError(
            f"invalid levels: black {found.black} and white {found.white} in frames of {bits} bits",
            hint=f"expected 0 <= black < white < {2**bits}",
        )


def _are_of_capture(paths: Sequence[Path]) -> bool:
    """Return whether paths are the folder of a capture, or frames in it."""
    return (len(paths) == 1 and paths[0].is_dir()) or all(path.suffix == SAMPLES for path in paths)


def _stored(paths: Sequence[Path]) -> tuple[CaptureReport, Sequence[int]]:
    """Return a capture whose folder, folder of frames, or frames are given, and their positions."""
    if paths[0].is_dir():
        folder = paths[0]
        if folder.resolve().name == FRAMES and not (folder / REPORT).exists():
            folder = folder.resolve().parent
        report = read_report(folder)
        return report, range(len(report.frames))
    folder = paths[0].resolve().parent.parent
    report = read_report(folder)
    stored = {
        (folder / frame.file).resolve(): position
        for position, frame in enumerate(report.frames)
        if frame.file is not None
    }
    names = {path.resolve() for path in paths}
    for path in sorted(names - stored.keys()):
        raise DataError(
            f"{path} is no frame of the capture in {folder}",
            hint="give the folder of a capture, or frames of one capture",
        )
    return report, sorted(stored[path] for path in names)


def _of_capture(report: CaptureReport, positions: Sequence[int]) -> SceneFrames:
    white = report.white
    shape = report.frame(positions[0]).shape
    return SceneFrames(
        (
            SceneFrame(
                report.frame(position),
                report.frames[position].applied,
                report.frames[position].exposure,
                report.frames[position].file or f"frame {position}",
            )
            for position in positions
        ),
        report.layout,
        white.bit_length(),
        report.frames[0].black,
        white,
        levels_are_stated=True,
        camera=report.camera,
        mode=mode_name(report.layout, shape, white, report.pixel_format),
    )
