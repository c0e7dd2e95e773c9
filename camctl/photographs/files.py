"""Photographs in files: JPEG, PNG, TIFF, camera raw, OpenEXR; and what they state."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError, visible
from camctl.evidence.alignment import misfit
from camctl.findings import Detail, Finding
from camctl.interface.camera import CameraInfo, Pixels
from camctl.interface.colour import BT709, CameraColour
from camctl.interface.controls import Layout
from camctl.interface.orientation import UPRIGHT, Orientation
from camctl.model.effective import check_ratio
from camctl.model.sample_grid import SampleGrid
from camctl.photographs.alignment import grey_copy
from camctl.photographs.camera import Photograph
from camctl.photographs.moves import Move, overlap
from camctl.profiles.exposures import mode_name
from camctl.stills.decoding import Still
from camctl.stills.exif import StatedExposure
from camctl.stills.files import check_times, read_photograph, unknown_time
from camctl.stills.radiance_map import read_exr_exposure, read_map

#: Decoded pixels that are kept, so that files are not decoded again.
_KEPT_BYTES = 512 << 20
_EXR = ".exr"
#: Code of full scale of an OpenEXR file.
_FULL_EXR = 65535
#: Longest side of the grey copies that show how a photograph lies, pixels: they have little noise,
#: and the hand displaces them by little.
_SIDE = 64


def _photograph(
    path: Path, still: Still, stated: StatedExposure, time_s: float | None
) -> Photograph:
    """Return what a file states of a photograph; a given time replaces the stated one."""
    time_s = stated.time_s if time_s is None else time_s
    if time_s is None:
        raise unknown_time(path)
    gain, iso = stated.gain or 1.0, None if stated.gain is None else round(100 * stated.gain, 6)
    name = visible(path.name)
    exposure = time_s, gain, stated.f_number, stated.taken_at, iso, stated.flash_fired
    return Photograph(name, *exposure, file_details=still.details)


@dataclass(frozen=True)
class Format:
    """What the frames of one set of photographs have in common."""

    shape: tuple[int, ...]
    layout: Layout
    bits: int
    black: int
    white: int
    is_raw: bool
    orientation: Orientation = UPRIGHT
    colour: CameraColour | None = None

    def mode(self, white: int) -> str:
        """Return the name of the camera's mode, of photographs that are not turned upright."""
        lying = self.orientation.lying(np.empty(self.shape, np.bool_))
        return mode_name(self.layout.turned(self.shape, self.orientation.lying), lying.shape, white)


class PhotographFiles:
    """The files of one exposure series, read when they are needed.

    Args:
        paths: of the files
        times: shutter times in place of the stated ones, s

    Attributes:
        photographs: name and exposure of each file
        format: of all of them
        grid: values of their samples; `pixels` are codes of it
        taken_by: make, model and serial number of the camera, as the files state them; empty where
            they do not
        notes: findings

    Raises:
        DataError: a file cannot be read, or differs in size or format
        UsageError: a file does not say its exposure time
    """

    def __init__(self, paths: Sequence[Path], times: Sequence[float | Fraction] | None) -> None:
        check_times(paths, times)
        self._paths = tuple(paths)
        self._times = None if times is None else tuple(map(float, times))
        self._kept: dict[int, Pixels] = {}
        self._moves: dict[int, Move] = {}
        self._invalid: dict[int, NDArray[np.bool_]] = {}
        self._full = _largest_of_exr(self._paths)
        self.photographs: list[Photograph] = []
        found: Format | None = None
        self.grid = SampleGrid(1, 0, 0)  # until all are read
        self.notes: list[Finding] = []
        self._orientations: dict[int, Orientation] = {}
        self.taken_by = ("", "", "")
        cameras: dict[str, str] = {}
        for position, path in enumerate(self._paths):
            pixels, this, photograph, taken_by = self._read(position)
            self.photographs.append(photograph)
            if not any(self.taken_by):
                self.taken_by = taken_by
            if any(taken_by[:2]):
                cameras.setdefault(CameraInfo("", *taken_by, "").name, photograph.name)
            if found is None:
                found = this
            _check_alike(path, this, self._paths[0], found)
            self._keep(position, pixels)
        assert found is not None  # there is a file
        check_ratio([each.exposure for each in self.photographs])
        self.format = found
        latest_first = map(self.pixels, reversed(range(len(self._paths))))  # kept, and decides
        self.grid = SampleGrid.of(latest_first, found.white, found.black)
        self._kept = {k: self.grid.codes(pixels) for k, pixels in self._kept.items()}
        if len(cameras) > 1:
            whose = " and ".join(f"{name} by {model}" for model, name in cameras.items())
            details: dict[str, Detail] = {"what": "camera", "whose": whose}
            self.notes.append(Finding(code="tags_differ", details=details))
        self._name_apart()

    def pixels(self, position: int) -> Pixels:
        """Return the codes of the pixels of a file."""
        if position not in self._kept:
            pixels = self.grid.codes(self._read(position)[0])
            if (move := self._moves.get(position)) is not None:
                white = self.grid.code(self.format.white)
                pixels = move.applied(pixels, self.format.layout, white)
            self._keep(position, pixels)
        return self._kept[position]

    def taken(self, position: int) -> Pixels:
        """Return the pixels of a file for a capture, which keeps them itself."""
        pixels = self.pixels(position)
        self._kept.pop(position, None)
        return pixels

    def move(self, moves: Mapping[int, Move]) -> None:
        """Move the pixels of some files from now on."""
        self._moves = dict(moves)
        for position in moves:
            self._kept.pop(position, None)

    def invalid(self, position: int) -> NDArray[np.bool_] | None:
        """Return which pixels the alpha channel of a file leaves out; None: none."""
        found = self._invalid.get(position)
        if found is None or (move := self._moves.get(position)) is None:
            return found
        marks = found.astype(np.uint8)
        return move.applied(marks, self.format.layout, 1) > 0

    @property
    def are_upright(self) -> bool:
        """Whether the pixels of all are as their files have them."""
        return all(each.is_upright for each in self._orientations.values())

    @property
    def moved(self) -> tuple[int, ...]:
        """Positions of the files that are moved."""
        return tuple(self._moves)

    @property
    def shown_by_all(self) -> tuple[slice, slice]:
        """Rows and columns that every file shows."""
        if not self._moves:
            return slice(0, self.format.shape[0]), slice(0, self.format.shape[1])
        return overlap(list(self._moves.values()), self.format.shape)

    def _keep(self, position: int, pixels: Pixels) -> None:
        while self._kept and sum(each.nbytes for each in self._kept.values()) > _KEPT_BYTES:
            del self._kept[next(iter(self._kept))]
        self._kept[position] = pixels

    def _read(self, position: int) -> tuple[Pixels, Format, Photograph, tuple[str, str, str]]:
        path = self._paths[position]
        time_s = None if self._times is None else self._times[position]
        if path.suffix.lower() == _EXR:
            linear, photograph = _read_exr(path, time_s, self._full)
            layout = Layout.MONO if linear.ndim == 2 else Layout.RGB
            this = Format(linear.shape, layout, 16, 0, _FULL_EXR, True, colour=BT709)
            return linear, this, photograph, ("",) * 3
        still, stated = read_photograph(path)
        photograph = _photograph(path, still, stated, time_s)
        is_raw = still.layout.is_mosaic or still.black > 0
        lies = self._orientation(position, still, photograph, stated.orientation)
        known = [each.details.get("what") for each in self.notes]
        for what in () if is_raw else still.notes:
            if what not in known:
                self._note("damaged", position, what=what)
        if still.invalid is not None:
            self._invalid[position] = lies.upright(still.invalid)
        pixels: Pixels = np.ascontiguousarray(lies.upright(still.pixels))
        layout = still.layout.turned(still.pixels.shape, lies.upright)
        levels = (layout, still.bits, still.black, still.white)
        this = Format(pixels.shape, *levels, is_raw, lies, still.colour)
        return pixels, this, photograph, (stated.make, stated.model, stated.serial)

    def _note(self, code: str, position: int, **details: str) -> None:
        """Add a finding about a file; it may be read again."""
        finding = Finding(code=code, frames=(position,), details=dict(details))
        if finding not in self.notes:
            self.notes.append(finding)

    def _orientation(
        self, position: int, still: Still, photograph: Photograph, stated: Orientation
    ) -> Orientation:
        """Return how a photograph lies: as the first one states, or as it states itself.

        Of a camera on a tripod all lie alike, but one that looks down may state any orientation.
        Of photographs that a program turned or mirrored, each is as it states.
        """
        if position in self._orientations:
            return self._orientations[position]
        first = self._orientations.get(0, stated)
        if stated != first and self._is_as_stated(still, photograph, stated, first):
            first = stated
        elif stated != first:
            self._note("tags_differ", position, what="orientation", other=self._paths[0].name)
        self._orientations[position] = first
        return first

    def _is_as_stated(
        self, still: Still, photograph: Photograph, stated: Orientation, first: Orientation
    ) -> bool:
        """Return whether a photograph fits the others as it states, better than as the first."""
        found = [each.upright(still.pixels) for each in (stated, first)]
        if found[0].shape != found[1].shape:
            return found[0].shape == self.pixels(0).shape
        if still.layout.is_mosaic:  # the same sensor took all
            return False
        stops = [abs(math.log(each.exposure / photograph.exposure)) for each in self.photographs]
        nearest = int(np.argmin(stops))
        is_longer = photograph.exposure > self.photographs[nearest].exposure
        other = grey_copy(self.pixels(nearest), still.white, _SIDE)[0]
        greys = [grey_copy(each, still.white, _SIDE)[0] for each in found]
        misfits = [misfit(other, each) if is_longer else misfit(each, other) for each in greys]
        return misfits[0] < misfits[1]

    def _name_apart(self) -> None:
        """Name files by their paths where two have the same name."""
        names = [each.name for each in self.photographs]
        if len(set(names)) < len(names):
            self.photographs = [
                replace(each, name=visible(path))
                for each, path in zip(self.photographs, self._paths, strict=True)
            ]


def _check_alike(path: Path, this: Format, first: Path, other: Format) -> None:
    """Raise `DataError` where a file has not the size or format of the first one."""
    if (this.layout, this.bits, this.black) != (other.layout, other.bits, other.black):
        raise DataError(
            f"{path} is {this.layout}, {this.bits} bits, black {this.black}, and {first} is "
            f"{other.layout}, {other.bits} bits, black {other.black}",
            hint="give photographs of one format",
        )
    if this.shape != other.shape:
        sizes = [f"{shape[1]} x {shape[0]}" for shape in (this.shape, other.shape)]
        if sizes[0] != sizes[1]:
            raise DataError(
                f"{path} has {sizes[0]} pixels and {first} has {sizes[1]}",
                hint="give photographs of one size; turned ones must be turned alike",
            )


def _largest_of_exr(paths: Sequence[Path]) -> float:
    """Return the full scale of the OpenEXR files: 1, or the largest value in any of them."""
    largest = 1.0
    for path in paths:
        if path.suffix.lower() == _EXR:
            values = _exr_values(path)
            largest = max(largest, float(np.max(values, where=np.isfinite(values), initial=0.0)))
    return largest


def _exr_values(path: Path) -> Any:
    values = np.asarray(read_map(path)[0], np.float32)
    return values[..., :3] if values.ndim == 3 and values.shape[2] >= 3 else values.squeeze()


def _read_exr(path: Path, time_s: float | None, full: float) -> tuple[Pixels, Photograph]:
    """Return the linear values of an OpenEXR file in 16 bits, and its exposure."""
    values = _exr_values(path)
    scaled = np.nan_to_num(values, nan=0.0, posinf=full, neginf=0.0) / full * _FULL_EXR
    pixels: Pixels = np.rint(np.clip(scaled, 0, _FULL_EXR)).astype(np.uint16)
    return pixels, _exr_exposure(path, time_s)


def _exr_exposure(path: Path, time_s: float | None) -> Photograph:
    """Return the exposure in the standard attributes of a file; a given time replaces its own."""
    stated = read_exr_exposure(path)
    stated_s, iso, f_number = map(stated.get, ("expTime", "isoSpeed", "aperture"))
    time_s = stated_s if time_s is None else time_s
    if time_s is None:
        raise unknown_time(path)
    gain = 1.0 if iso is None else iso / 100
    return Photograph(visible(path.name), time_s, gain, f_number, None, iso)
