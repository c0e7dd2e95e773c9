"""Reads radiance maps: .hdr and .pic (RGBE) and .npy here, in numpy; .exr and .tiff apart."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError, OutOfMemoryError
from camctl.stills.maps import (
    Map,
    Shape,
    exr_exposure,
    exr_shape,
    read_exr,
    read_tiff,
    tiff_shape,
)
from camctl.stills.separate import fact_apart, map_apart
from camctl.system.input_files import check_regular
from camctl.system.library_output import quiet_libraries

Result = TypeVar("Result")

_SIZE = re.compile(rb"([-+])([XY]) +(\d{1,9}) +([-+])([XY]) +(\d{1,9})\s*$")
_MOST_HEADER_LINES = 200
_MOST_LINE_BYTES = 4096
_FETCH_AGAIN = "the file is damaged, fetch it again"


@dataclass(frozen=True)
class _FileType:
    """How files of one type are read: their shape alone, and their pixels."""

    read_shape: Callable[[Path], Shape]
    read_map: Callable[[Path], Map]


def read_shape(path: Path) -> Shape:
    """Return (rows, columns, ...) of the map in `path` without reading its pixels.

    Raises:
        DataError: missing, unreadable, or not of the type that its suffix names
    """
    return tuple(_read(path, _FILE_TYPES[path.suffix.lower()].read_shape))


def read_map(path: Path) -> Map:
    """Return the map in `path` with its own values and data type.

    Raises:
        DataError: missing, unreadable, or not of the type that its suffix names
        OutOfMemoryError: too large
    """
    return _read(path, _FILE_TYPES[path.suffix.lower()].read_map)


def read_exr_exposure(path: Path) -> dict[str, float]:
    """Return the exposure that an .exr file states, see `camctl.stills.maps.exr_exposure`.

    Raises:
        DataError: missing, unreadable, or no .exr file
    """
    return _read(path, partial(fact_apart, exr_exposure))


def _read(path: Path, read: Callable[[Path], Result]) -> Result:
    check_regular(path, "", hint="give a scene's name or a radiance map")
    try:
        with quiet_libraries():
            return read(path)
    except DataError:
        raise
    except PermissionError as error:
        raise DataError(f"{path}: no permission to read it") from error
    except MemoryError as error:
        raise OutOfMemoryError(
            f"{path}: not enough memory to read it", hint="give a smaller radiance map"
        ) from error
    # The libraries raise errors of any type for a damaged file.
    except Exception as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise DataError(
            f"{path}: cannot be read as {path.suffix} ({reason})", hint=_FETCH_AGAIN
        ) from error


@dataclass(frozen=True)
class _RgbeHeader:
    pixels_at: int
    rows: int
    columns: int
    is_bottom_up: bool


def _read_rgbe_header(path: Path) -> _RgbeHeader:
    with path.open("rb") as file:
        # Ward's programs write their command lines into the header, also before the signature.  A
        # blank line ends the header, and the size follows.
        lines = [file.readline(_MOST_LINE_BYTES)]
        while lines[-1].strip():
            if len(lines) > _MOST_HEADER_LINES:
                raise DataError(f"{path}: the Radiance header does not end", hint=_FETCH_AGAIN)
            lines.append(file.readline(_MOST_LINE_BYTES))
        if not any(line.startswith((b"#?RADIANCE", b"#?RGBE")) for line in lines):
            raise DataError(f"{path}: not a Radiance picture", hint="its header lacks #?RADIANCE")
        if any(line.startswith(b"FORMAT=32-bit_rle_xyze") for line in lines):
            raise DataError(f"{path}: colours are XYZ", hint="convert it to RGB with ra_xyze -r")
        size = _SIZE.match(file.readline(_MOST_LINE_BYTES))
        if size is None or size[2] != b"Y" or size[5] != b"X" or size[4] != b"+":
            raise DataError(
                f"{path}: invalid Radiance size or orientation",
                hint="expected -Y rows +X columns: use pflip or protate",
            )
        return _RgbeHeader(file.tell(), int(size[3]), int(size[6]), size[1] == b"+")


def _rgbe_shape(path: Path) -> Shape:
    header = _read_rgbe_header(path)
    return header.rows, header.columns, 3


def _rgbe(path: Path) -> Map:
    header = _read_rgbe_header(path)
    # The shortest encoding is runs of 127 equal bytes; the longest, runs of one byte.
    least = header.rows * min(4 * header.columns, 4 + 8 * (header.columns // 127))
    most = header.rows * (8 * header.columns + 4)
    size = path.stat().st_size - header.pixels_at
    if size < least:
        raise DataError(f"{path}: the data ends before the last row", hint=_FETCH_AGAIN)
    with path.open("rb") as file:
        file.seek(header.pixels_at)
        data = file.read(min(size, most))
    rgbe = np.empty((header.rows, 4, header.columns), dtype=np.uint8)
    position = 0
    for row in range(header.rows):
        try:
            position = _read_rgbe_row(data, position, rgbe[row])
        except IndexError as error:
            raise DataError(
                f"{path}: the data ends in row {row} of {header.rows}", hint=_FETCH_AGAIN
            ) from error
        except ValueError as error:
            raise DataError(
                f"{path}: row {row} of {header.rows} has invalid run lengths", hint=_FETCH_AGAIN
            ) from error
    if header.is_bottom_up:
        rgbe = rgbe[::-1]
    # Radiance: value = (mantissa + 1/2) 2^(exponent - 136), and exponent 0 is black.
    exponent = rgbe[:, 3, :].astype(np.int32)
    scale = np.ldexp(np.float32(1), exponent - 136)
    scale[exponent == 0] = 0
    picture = np.empty((header.rows, header.columns, 3), dtype=np.float32)
    for channel in range(3):
        np.multiply(rgbe[:, channel, :] + np.float32(0.5), scale, out=picture[..., channel])
    return picture, ()


def _read_rgbe_row(data: bytes, position: int, row: NDArray[np.uint8]) -> int:
    """Read one scan line into `row` (4, columns); return where the next one starts.

    Raises:
        IndexError: the data ends within the scan line
        ValueError: the run lengths do not fit the scan line
    """
    columns = int(row.shape[1])
    start = data[position : position + 4]
    if len(start) < 4:
        raise IndexError
    if not (8 <= columns < 2**15 and start[:2] == b"\x02\x02" and start[2] < 128):
        size = 4 * columns
        if position + size > len(data):
            raise IndexError
        row[...] = np.frombuffer(data, np.uint8, size, position).reshape(columns, 4).T
        return position + size
    if (start[2] << 8 | start[3]) != columns:
        raise ValueError
    position += 4
    for channel in row:
        filled = 0
        while filled < columns:
            count = data[position]
            length = count - 128 if count > 128 else count
            if length == 0 or filled + length > columns:
                raise ValueError
            if count > 128:
                channel[filled : filled + length] = data[position + 1]
                position += 2
            else:
                literal = data[position + 1 : position + 1 + length]
                if len(literal) < length:
                    raise IndexError
                channel[filled : filled + length] = np.frombuffer(literal, np.uint8)
                position += 1 + length
            filled += length
    return position


_EXR = _FileType(partial(fact_apart, exr_shape), partial(map_apart, read_exr))
_TIFF = _FileType(partial(fact_apart, tiff_shape), partial(map_apart, read_tiff))
_FILE_TYPES = {
    ".hdr": _FileType(_rgbe_shape, _rgbe),
    ".pic": _FileType(_rgbe_shape, _rgbe),
    ".exr": _EXR,
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".npy": _FileType(
        lambda path: tuple(np.load(path, mmap_mode="r", allow_pickle=False).shape),
        lambda path: (np.load(path, allow_pickle=False), ()),
    ),
}
SUFFIXES = tuple(_FILE_TYPES)
