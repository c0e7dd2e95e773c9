"""Operations on pictures, by OpenCV where it is installed and by numpy alone where it is not.

OpenCV is the faster one.  Both return the same: integers that differ by 1 at most, floating-point
numbers that differ by 1e-5 of the largest; text has other letters.  Decoding of JPEG files has no
replacement: `required_opencv` raises an error that says so.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections import deque
from collections.abc import Sequence
from types import ModuleType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError, UsageError
from camctl.system.characters import HEIGHTS, coverage

_Numbers = TypeVar("_Numbers", NDArray[np.uint8], NDArray[np.float32])

#: Width of a character as a multiple of the size of text; OpenCV's own letters are as wide.
_CHARACTER_WIDTH = 18
#: Height of capital letters above the base line, as a share of the height of a line.
_ABOVE_BASE_LINE = 0.76
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
#: The filter of PNG that predicts each row from the one above.
_UP = 2
#: Bytes of the samples of a PNG file that is read, at most.
_LARGEST_PNG = 1 << 25
#: Columns of `connected_parts`.
LEFT, TOP, WIDTH, HEIGHT, AREA = range(5)

#: Marks of samples that stay in a cache.
_MARKED = 1 << 16
#: Samples that are counted at once: less memory is needed, and float32 has each number up to 2^24.
_COUNTED = 1 << 20

#: Types of numbers in tables of OpenCV.
_IN_TABLES = tuple(map(np.dtype, ("u1", "u2", "i2", "i4", "f4", "f8")))

Kernel = NDArray[np.float32]


def opencv() -> ModuleType | None:
    """Return OpenCV, which is loaded here, where it is installed."""
    try:
        import cv2
    except ModuleNotFoundError:
        return None
    return cv2


def required_opencv(task: str) -> ModuleType:
    """Return OpenCV for what nothing else can do; raises `UsageError` where it is not installed.

    >>> required_opencv("decoding JPEG frames").__name__
    'cv2'
    """
    if (cv2 := opencv()) is None:
        raise UsageError(
            f"{task} needs OpenCV, which is not installed",
            hint="install it with: pip install opencv-contrib-python-headless",
        )
    return cv2


def png(picture: NDArray[Any]) -> bytes:
    """Return a picture as a PNG file: (rows, columns) or (rows, columns, 3), 8 or 16 bits.

    Rows are predicted from the rows above.  It is compressed at level 1, where it is as fast as by
    OpenCV, and the file is as large.
    """
    rows, columns = picture.shape[:2]
    lines = np.ascontiguousarray(picture, picture.dtype.newbyteorder(">")).view(np.uint8)
    lines = lines.reshape(rows, -1)
    filtered = np.empty((rows, 1 + lines.shape[1]), np.uint8)
    filtered[:, 0] = _UP
    filtered[0, 1:] = lines[0]
    np.subtract(lines[1:], lines[:-1], out=filtered[1:, 1:])
    data = zlib.compress(filtered.data, 1)
    colour = 2 if picture.ndim == 3 else 0
    header = struct.pack(">IIBBBBB", columns, rows, 8 * picture.itemsize, colour, 0, 0, 0)
    return _PNG_SIGNATURE + b"".join(
        struct.pack(">I", len(part)) + name + part + struct.pack(">I", zlib.crc32(name + part))
        for name, part in ((b"IHDR", header), (b"IDAT", data), (b"IEND", b""))
    )


def jpeg(picture: NDArray[np.uint8], quality: int, *, full_colour: bool = False) -> bytes:
    """Return a picture as a JPEG file: (rows, columns) or RGB (rows, columns, 3).

    Args:
        picture: the picture
        quality: 1 to 100
        full_colour: whether each pixel has its own colour, not each 2 x 2

    Raises:
        UsageError: OpenCV is not installed
    """
    cv2 = required_opencv("a JPEG file")
    swapped = cv2.cvtColor(picture, cv2.COLOR_RGB2BGR) if picture.ndim == 3 else picture
    sampling = (cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444)
    options = [cv2.IMWRITE_JPEG_QUALITY, quality, *(sampling if full_colour else ())]
    return bytes(cv2.imencode(".jpg", swapped, options)[1])


def png_pixels(data: bytes | bytearray) -> NDArray[np.uint8]:
    """Return the samples of a PNG file that `png` has made of 8 bits; other chunks are left out.

    Raises:
        DataError: it is damaged, or another kind of file
    """
    chunks: dict[bytes, bytes] = {}
    place = len(_PNG_SIGNATURE)
    try:
        while b"IEND" not in chunks:
            (length,) = struct.unpack_from(">I", data, place)
            name, part = data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
            (checksum,) = struct.unpack_from(">I", data, place + 8 + length)
            if zlib.crc32(name + part) != checksum:
                raise ValueError("checksum")
            chunks[bytes(name)] = bytes(part)
            place += length + 12
        columns, rows, bits, colour, *_ = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
        shape = (rows, columns, 3) if colour == 2 else (rows, columns)
        size = rows + math.prod(shape)
        if bits != 8 or not 0 < size <= _LARGEST_PNG:
            raise ValueError("size")
        lines = zlib.decompressobj().decompress(chunks[b"IDAT"], size)
        filtered = np.frombuffer(lines, np.uint8).reshape(rows, -1)
        if len(lines) != size or (filtered[:, 0] != _UP).any():
            raise ValueError("filter")
    except (ValueError, KeyError, struct.error, zlib.error) as error:
        raise DataError("this is no PNG file of camctl, or a damaged one") from error
    return np.add.accumulate(filtered[:, 1:], axis=0, dtype=np.uint8).reshape(shape)


def channels_apart(picture: NDArray[Any]) -> tuple[NDArray[Any], ...]:
    """Return the channels of (rows, columns, channels), (rows, columns) each, or a plane itself."""
    if picture.ndim == 2:
        return (picture,)
    planes = np.moveaxis(picture, 2, 0)
    if not planes.flags.c_contiguous and (cv2 := opencv()) is not None:
        return tuple(each.view(picture.dtype) for each in cv2.split(_as_integers(picture)))
    return tuple(np.ascontiguousarray(planes))


def plane_by_plane(picture: NDArray[Any]) -> NDArray[Any]:
    """Return (rows, columns[, channels]) of which each channel is contiguous."""
    if picture.ndim == 2:
        return picture
    if (cv2 := opencv()) is None:
        return np.moveaxis(np.ascontiguousarray(np.moveaxis(picture, 2, 0)), 0, 2)
    planes = np.empty((picture.shape[2], *picture.shape[:2]), picture.dtype)
    cv2.split(_as_integers(picture), tuple(_as_integers(planes)))
    return np.moveaxis(planes, 0, 2)


def channels_together(planes: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Return (rows, columns, channels) of planes, or a single plane itself."""
    if len(planes) == 1:
        return planes[0]
    if (cv2 := opencv()) is not None:
        return np.asarray(cv2.merge([_as_integers(each) for each in planes])).view(planes[0].dtype)
    return np.stack(planes, axis=-1)


def interleave(planes: Sequence[NDArray[Any]], out: NDArray[Any]) -> None:
    """Write values, (S,) each, into (S, planes); all of one type of `_as_integers`.

    Eight bytes are two words of four, which OpenCV merges in half the time.
    """
    if (cv2 := opencv()) is not None:
        parts = [each[np.newaxis] for each in planes]
        if len(parts) == 8 and out.dtype == np.uint8:
            words = (cv2.merge(some).view(np.int32)[..., 0] for some in (parts[:4], parts[4:]))
            parts, out = list(words), out.view(np.int32)
        cv2.merge(parts, out[np.newaxis])
        return
    for place, each in enumerate(planes):
        out[:, place] = each


def _as_integers(values: NDArray[Any]) -> NDArray[Any]:
    """Return values of 1, 2 or 4 bytes as integers that each version of OpenCV has."""
    return values.view((np.uint8, np.uint16, np.int32)[values.itemsize // 2])


def reduced_by_area(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return a picture of (columns, rows) pixels, each the mean over its area; of the same type."""
    if (cv2 := opencv()) is not None:
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA))
    columns, rows = size
    height, width = picture.shape[:2]
    if height % rows == 0 and width % columns == 0:
        cells = picture.reshape(rows, height // rows, columns, width // columns, -1)
        found = cells.mean(axis=(1, 3), dtype=np.float32)
    else:
        found = _weighted(picture, _area_weights(height, rows), _area_weights(width, columns))
    return _of_type(found, picture, size)


def reduced_in_steps(picture: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return the same of a picture that is halved while it is four times as large, or larger.

    OpenCV takes a fifth to a third of the time for that, and the rest: edges move by a quarter of a
    pixel.
    """
    while min(picture.shape[0] // size[1], picture.shape[1] // size[0]) >= 4:
        rows, columns = picture.shape[0] // 2, picture.shape[1] // 2
        picture = reduced_by_area(picture[: 2 * rows, : 2 * columns], (columns, rows))
    return reduced_by_area(picture, size)


def enlarged_smoothly(picture: Kernel, size: tuple[int, int]) -> Kernel:
    """Return a picture in float32 of (columns, rows) pixels, interpolated linearly."""
    if (cv2 := opencv()) is not None:
        return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR))
    height, width = picture.shape[:2]
    found = _weighted(picture, _linear_weights(height, size[1]), _linear_weights(width, size[0]))
    return np.asarray(_of_type(found, picture, size), np.float32)


def _of_type(found: Kernel, picture: NDArray[Any], size: tuple[int, int]) -> NDArray[Any]:
    """Return a result in the type and with the channels of a picture, as OpenCV does."""
    # OpenCV drops a single channel.
    channels = picture.shape[2:] if picture.shape[2:] != (1,) else ()
    found = found.reshape(size[1], size[0], *channels)
    return (found if picture.dtype.kind == "f" else np.rint(found)).astype(picture.dtype)


def _weighted(picture: NDArray[Any], down: Kernel, across: Kernel) -> Kernel:
    """Return down * picture * across^T for each channel, (rows, columns, channels)."""
    height, width = picture.shape[:2]
    lines = down @ picture.reshape(height, -1).astype(np.float32, copy=False)
    return np.asarray(np.tensordot(lines.reshape(len(down), width, -1), across, (1, 1))).transpose(
        0, 2, 1
    )


def _area_weights(length: int, count: int) -> Kernel:
    """Return the share that each of `length` pixels has in each of `count`, (count, length)."""
    edges = np.arange(count + 1) * (length / count)
    pixels = np.arange(length)
    covered = np.minimum(edges[1:, None], pixels + 1) - np.maximum(edges[:-1, None], pixels)
    return np.asarray(np.maximum(covered, 0) * (count / length), np.float32)


def _linear_weights(length: int, count: int) -> Kernel:
    """Return the weights of linear interpolation at the middle of each of `count` pixels."""
    places = np.clip((np.arange(count) + 0.5) * (length / count) - 0.5, 0, length - 1)
    distances = np.abs(places[:, None] - np.arange(length))
    return np.asarray(np.maximum(1 - distances, 0), np.float32)


def level_counts(
    samples: NDArray[np.unsignedinteger], levels: int, where: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """Return how often each value below `levels` occurs in (rows, columns[, channels]).

    Args:
        samples: of which none is `levels` or more
        levels: how many there are
        where: which samples count, in their shape; None: all
    """
    counts = np.zeros(levels, np.int64)
    # OpenCV takes longer for samples of which about each has a level of its own.
    cv2 = opencv() if samples.itemsize <= 2 and samples.size >= 2 * levels else None
    rows = max(1, _COUNTED // (samples.size // len(samples)))
    for start in range(0, len(samples), rows):
        part = samples[start : start + rows]
        used = None if where is None else where[start : start + rows]
        if cv2 is None:
            counts += np.bincount(part.ravel() if used is None else part[used], minlength=levels)
        else:  # in float32, which has the number of samples of a part exactly
            flat = part.reshape(len(part), -1)
            mask = None if used is None else used.reshape(flat.shape).view(np.uint8)
            found = cv2.calcHist([flat], [0], mask, [levels], [0, levels])
            counts += found.ravel().astype(np.int64)
    return counts


def looked_up(table: NDArray[Any], samples: NDArray[np.unsignedinteger]) -> NDArray[Any]:
    """Return the value in a table, (levels,), of each sample, in the shape of the samples.

    In a fifth of the time of `take`, which makes indices of 8 bytes of the samples; those of 16
    bits in a third, from OpenCV 5 on.  Fewer samples than four for each number of OpenCV's table
    are looked up as fast by numpy.  Samples that fit into 8 bits are looked up as such.
    """
    if samples.dtype == np.uint16 and table.size <= 256:
        samples = samples.astype(np.uint8)
    cv2 = opencv() if samples.itemsize <= 2 and table.dtype in _IN_TABLES else None
    if cv2 is not None and samples.itemsize == 2 and int(cv2.__version__.split(".")[0]) < 5:
        cv2 = None
    size = 1 << 8 * samples.itemsize
    if cv2 is None or samples.size < 4 * size:
        return np.asarray(table.take(samples))
    if table.size < size:
        table = np.pad(table, (0, size - table.size), mode="edge")
    return np.asarray(cv2.LUT(samples, table[:size])).reshape(samples.shape)


def as_halves(values: Kernel) -> NDArray[np.float16]:
    """Return (rows, columns) rounded to float16, in a seventh of numpy's time."""
    if (cv2 := opencv()) is None:
        return values.astype(np.float16)
    if hasattr(cv2, "convertFp16"):  # before OpenCV 5
        return np.asarray(cv2.convertFp16(values)).view(np.float16)
    return np.asarray(cv2.add(values, 0.0, dtype=cv2.CV_16F))


def count_from(samples: NDArray[Any], least: int) -> int:
    """Return how many samples of (rows, columns[, channels]) are at least `least`.

    Some rows at a time, whose marks stay in a cache: a fifth of the time.
    """
    rows = max(1, _MARKED // (samples.size // len(samples)))
    return sum(
        int(np.count_nonzero(samples[start : start + rows] >= least))
        for start in range(0, len(samples), rows)
    )


def sums_along_columns(values: NDArray[Any], length: int) -> Kernel:
    """Return the sums of so many pixels around each one, along its column; nothing is outside.

    `length` is odd.
    """
    values = values.astype(np.float32)
    if (cv2 := opencv()) is not None:
        found = cv2.boxFilter(
            values, -1, (1, length), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        return np.asarray(found, np.float32).reshape(values.shape)
    ends = np.zeros((length // 2 + 1, *values.shape[1:]))
    sums = np.cumsum(np.concatenate([ends, values, ends[1:]]), axis=0)
    return np.asarray(sums[length:] - sums[:-length], np.float32)


def box_means(values: NDArray[Any], radius: int) -> Kernel:
    """Return the means over squares of 2 radius + 1 pixels a side, borders mirrored."""
    side = 2 * radius + 1
    if (cv2 := opencv()) is not None:
        mean = cv2.blur(values, (side, side), borderType=cv2.BORDER_REFLECT)
        return np.asarray(mean, np.float32).reshape(values.shape)
    for axis in (0, 1):
        padding = [(0, 0)] * values.ndim
        padding[axis] = (radius + 1, radius)
        sums = np.cumsum(np.pad(values, padding, "symmetric"), axis=axis, dtype=np.float64)
        sums = sums.swapaxes(0, axis)
        # The first line is not part of any square, so that it is subtracted everywhere.
        values = ((sums[side:] - sums[:-side]) / side).swapaxes(0, axis)
    return values.astype(np.float32)


def box_sums(values: NDArray[np.int16], radius: int) -> NDArray[np.int16]:
    """Return the sums over squares of 2 radius + 1 pixels a side, which are 0 outside.

    They must fit into 16 bits.
    """
    side = 2 * radius + 1
    if (cv2 := opencv()) is not None:
        found = cv2.boxFilter(
            values, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT
        )
        return np.asarray(found, np.int16).reshape(values.shape)
    padded = np.pad(values, [(radius, radius)] * 2 + [(0, 0)] * (values.ndim - 2))
    sums = np.rint(box_means(padded, radius) * side**2).astype(np.int16)
    return sums[radius:-radius, radius:-radius]


def correlated(values: Kernel, kernel: NDArray[Any], *, repeats_border: bool) -> Kernel:
    """Return the sums of each pixel's neighbours, weighted by a small kernel of odd sides.

    Borders are mirrored; with `repeats_border` the outermost pixels are repeated, too.
    """
    if (cv2 := opencv()) is not None:
        border = cv2.BORDER_REFLECT if repeats_border else cv2.BORDER_REFLECT_101
        return np.asarray(cv2.filter2D(values, -1, kernel, borderType=border), np.float32)
    down, across = kernel.shape
    padding = [(down // 2, down // 2), (across // 2, across // 2), (0, 0)][: values.ndim]
    padded = np.pad(values, padding, "symmetric" if repeats_border else "reflect")
    total = np.zeros_like(values)
    for (row, column), weight in np.ndenumerate(kernel.astype(np.float32)):
        if weight:
            total += weight * padded[row:, column:][: values.shape[0], : values.shape[1]]
    return total


def smoothed(values: Kernel, kernel: Kernel) -> Kernel:
    """Return values weighted by a kernel of odd length along columns and rows, borders repeated."""
    if (cv2 := opencv()) is not None:
        found = cv2.sepFilter2D(values, -1, kernel, kernel, borderType=cv2.BORDER_REFLECT)
        return np.asarray(found, np.float32)
    line = kernel.reshape(1, -1)
    return correlated(correlated(values, line, repeats_border=True), line.T, repeats_border=True)


def dilated(marks: _Numbers, size: tuple[int, int]) -> _Numbers:
    """Return the largest of the values in a box of (rows, columns), both odd, around each pixel.

    Values are uint8 or float32, and not negative.
    """
    if (cv2 := opencv()) is not None:
        largest: _Numbers = cv2.dilate(marks, np.ones(size, np.uint8))
        return largest
    for axis, length in enumerate(size):
        padding = [(0, 0), (0, 0)]
        padding[axis] = (length // 2, length // 2)
        found, width = np.pad(marks, padding).swapaxes(0, axis), 1
        while width < length:
            step = min(width, length - width)
            found = np.maximum(found[:-step], found[step:])
            width += step
        marks = found.swapaxes(0, axis)
    return marks


def connected_parts(marks: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the parts of neighbouring marks, diagonals included.

    Returns:
        the number of its part for each mark, from 1, and 0 elsewhere, in the shape of the marks;
        and a row for each number: `LEFT`, `TOP`, `WIDTH`, `HEIGHT` of its box, and its `AREA`
    """
    if (cv2 := opencv()) is not None:
        _, labels, boxes, _ = cv2.connectedComponentsWithStats(marks.astype(np.uint8))
        return np.asarray(labels, np.int32), np.asarray(boxes, np.int32)
    labels = np.zeros(marks.shape, np.int32)
    rest = set(zip(*(places.tolist() for places in np.nonzero(marks)), strict=True))
    number = 0
    boxes = [[0, 0, marks.shape[1], marks.shape[0], marks.size - len(rest)]]
    for seed in sorted(rest):
        if seed not in rest:
            continue
        number += 1
        rest.remove(seed)
        part, border = [seed], deque([seed])
        while border:
            row, column = border.popleft()
            near = {(row + down, column + across) for down in (-1, 0, 1) for across in (-1, 0, 1)}
            near &= rest
            rest -= near
            part.extend(near)
            border.extend(near)
        rows, columns = np.array(part).T
        labels[rows, columns] = number
        left, top = int(columns.min()), int(rows.min())
        width, height = int(columns.max()) + 1 - left, int(rows.max()) + 1 - top
        boxes.append([left, top, width, height, len(part)])
    return labels, np.array(boxes, np.int32)


def text_width(text: str, size: float) -> int:
    """Return the width of a line of text, pixels; `size` is OpenCV's scale of its letters."""
    if (cv2 := opencv()) is not None:
        return int(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, size, 1)[0][0])
    return len(text) * _line_height(size) // 2


def draw_text(
    pixels: NDArray[np.uint8],
    text: str,
    place: tuple[int, int],
    size: float,
    colour: tuple[int, int, int],
) -> None:
    """Draw a line of ASCII text into (rows, columns, 3); `place` is the left end of its base line.

    What is outside of the picture is cut.
    """
    if (cv2 := opencv()) is not None:
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(pixels, text, place, font, size, colour, 1, cv2.LINE_AA)
        return
    height = _line_height(size)
    left, top = max(0, place[0]), max(0, place[1] - round(_ABOVE_BASE_LINE * height))
    area = pixels[top : top + height, left : left + len(text) * height // 2]
    ink = coverage(text, height)[: area.shape[0], : area.shape[1], np.newaxis] / np.float32(255)
    area[:] = np.rint(area + (np.array(colour, np.float32) - area) * ink)


def _line_height(size: float) -> int:
    fitting = [each for each in HEIGHTS if each / 2 <= _CHARACTER_WIDTH * size]
    return max(fitting, default=HEIGHTS[0])
