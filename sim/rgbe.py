"""Radiance pictures (.hdr, .pic) in numpy: the RGBE format of Ward's Radiance."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError

_SIZE = re.compile(rb"([-+])([XY]) +(\d+) +([-+])([XY]) +(\d+)\s*$")
_HEADER_LINES = 200
_LINE_BYTES = 4096


def read_header(path: Path) -> tuple[int, bool, tuple[int, int, int]]:
    """Return (offset of the pixels, whether rows run bottom up, (rows, columns, 3)).

    Raises:
        DataError: not a Radiance picture, or one in XYZ or with columns first
    """
    with path.open("rb") as file:
        lines = [file.readline(_LINE_BYTES)]
        # Some writers put a line before the signature; blank line and size end the header.
        while lines[-1].strip():
            if len(lines) > _HEADER_LINES:
                raise DataError(f"{path}: no end of the Radiance header", hint="is it damaged?")
            lines.append(file.readline(_LINE_BYTES))
        if not any(line.startswith((b"#?RADIANCE", b"#?RGBE")) for line in lines):
            raise DataError(f"{path}: not a Radiance picture", hint="its header lacks #?RADIANCE")
        if any(line.startswith(b"FORMAT=32-bit_rle_xyze") for line in lines):
            raise DataError(f"{path}: colours are XYZ", hint="convert it to RGB with ra_xyze -r")
        size = _SIZE.match(file.readline(_LINE_BYTES))
        if size is None or size[2] != b"Y" or size[5] != b"X" or size[4] != b"+":
            raise DataError(f"{path}: rows do not run as -Y rows +X columns", hint="flip it first")
        return file.tell(), size[1] == b"+", (int(size[3]), int(size[6]), 3)


def rgbe_shape(path: Path) -> tuple[int, int, int]:
    """Return (rows, columns, 3); raises `DataError` as `read_header` does."""
    return read_header(path)[2]


def read_rgbe(path: Path) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Return (rows, columns, 3) float32, linear RGB, and what had to be repaired.

    Raises:
        DataError: as `read_header`, or the pixels end too early or are nonsense
    """
    offset, bottom_up, (rows, columns, _) = read_header(path)
    data = path.read_bytes()
    rgbe = np.empty((rows, 4, columns), dtype=np.uint8)
    position = offset
    try:
        for row in range(rows):
            position = _read_row(data, position, rgbe[row])
    except IndexError as error:
        raise DataError(
            f"{path}: ends in row {row} of {rows}", hint="the file is damaged, fetch it again"
        ) from error
    except ValueError as error:
        raise DataError(
            f"{path}: row {row} of {rows} is nonsense", hint="the file is damaged, fetch it again"
        ) from error
    if bottom_up:
        rgbe = rgbe[::-1]
    # Radiance: value = (mantissa + 1/2) 2^(exponent - 136), and exponent 0 is black.
    exponent = rgbe[:, 3, :].astype(np.int32)
    scale = np.ldexp(np.float32(1), exponent - 136)
    scale[exponent == 0] = 0
    picture = np.empty((rows, columns, 3), dtype=np.float32)
    for channel in range(3):
        np.multiply(rgbe[:, channel, :] + np.float32(0.5), scale, out=picture[..., channel])
    return picture, ()


def _read_row(data: bytes, position: int, row: NDArray[np.uint8]) -> int:
    """Read one scan line into `row` (4, columns); return where the next one starts."""
    columns = row.shape[1]
    start = data[position : position + 4]
    if len(start) < 4:
        raise IndexError
    is_coded = start[0] == 2 and start[1] == 2 and start[2] < 128
    if not (is_coded and 8 <= columns < 2**15):
        size = 4 * columns
        if position + size > len(data):
            raise IndexError
        row[...] = np.frombuffer(data, np.uint8, size, position).reshape(columns, 4).T
        return position + size
    if (start[2] << 8 | start[3]) != columns:
        raise ValueError
    position += 4
    for channel in range(4):
        filled = 0
        while filled < columns:
            count = data[position]
            if count > 128:
                count -= 128
                row[channel, filled : filled + count] = data[position + 1]
                position += 2
            else:
                literal = data[position + 1 : position + 1 + count]
                if len(literal) < count or count == 0:
                    raise IndexError
                if filled + count > columns:
                    raise ValueError
                row[channel, filled : filled + count] = np.frombuffer(literal, np.uint8)
                position += 1 + count
            filled += count
        if filled != columns:
            raise ValueError
    return position
