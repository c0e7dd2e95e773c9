"""What a still camera's file holds, as samples: JPEG, PNG, TIFF and camera raw.

A file comes over a cable and may be damaged, cut short, or made up.  Whatever its bytes are, the
answer is pixels or one typed error, and memory stays within what the file's length can honestly
stand for (`_check_size`).
"""

from __future__ import annotations

import io
import logging
import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.controls import Layout
from camctl.errors import CameraProtocolError, UsageError
from camctl.profile import StillRecord

# The largest still cameras (pixel shift with a medium-format back) make 400 million pixels.
MAX_PIXELS = 1 << 29

# Deflate codes at best 1032 bytes in one (zlib's technical notes); a JPEG spends at least one bit
# on the first coefficient of each block of 64 pixels, which is less than half of that.
_MOST_PIXELS_A_BYTE = 1040

_JPEG = b"\xff\xd8\xff"
_PNG = b"\x89PNG\r\n\x1a\n"
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_TIFF_SUFFIXES = (".tif", ".tiff")
_DNG_VERSION = 50706
_MIN_IS_BLACK, _RGB = 1, 2  # TIFF 6.0, PhotometricInterpretation

# JPEG, ITU-T T.81 table B.1: frame headers but for DHT, JPG and DAC; a marker in the entropy-coded
# data is FF followed by neither a stuffed zero, nor a restart marker, nor a fill byte.
_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_START_OF_SCAN, _END_OF_IMAGE = 0xDA, 0xD9
_MARKER = re.compile(rb"\xff+[\x01-\xcf\xd8-\xfe]")

# Colours of a 2 x 2 pattern as LibRaw numbers and names them: 0 R, 1 G, 2 B, 3 the other G.
_PATTERNS = {
    "RGGB": Layout.RGGB,
    "GRBG": Layout.GRBG,
    "GBRG": Layout.GBRG,
    "BGGR": Layout.BGGR,
}

# tifffile tells of broken tags on a logger; the error that follows says it to the user.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


@dataclass(frozen=True, eq=False)
class Still:
    """What one file holds.

    Attributes:
        pixels: (rows, columns), or (rows, columns, 3) in the order red, green, blue; uint8 up to
            8 bits, else uint16
        layout: how colour lies in it; grey files of three channels stay RGB
        bits: bits a sample
        black: brightness without light, DN
        white: brightness from which a sample is saturated, DN
        is_linear: True where samples are proportional to the light, as those of camera raw
        notes: what a person should know, one line each
    """

    pixels: Pixels
    layout: Layout
    bits: int
    black: int
    white: int
    is_linear: bool
    notes: tuple[str, ...] = ()

    @property
    def record(self) -> StillRecord:
        """What the file is, without its pixels, as a profile keeps it."""
        rows, columns = self.pixels.shape[:2]
        return StillRecord(
            rows=rows,
            columns=columns,
            layout=self.layout,
            bits=self.bits,
            black=self.black,
            white=self.white,
        )


def read_still(data: bytes, name: str) -> Still:
    """Return what a camera's file holds; its first bytes say what it is, then its name.

    Raw files give the samples of the sensor's visible part as they came: no demosaicing, no
    scaling, no black taken off.  Where the four colours have different black levels, each is raised
    by a whole number of levels to the highest, so that one black level holds for all of them.

    Args:
        data: the whole file
        name: what the camera calls it, for its suffix and for errors

    Raises:
        CameraProtocolError: it is damaged, cut short, or of no kind that can be read
        UsageError: it is camera raw, and rawpy is not installed
    """
    suffix = PurePath(name).suffix.lower()
    if data.startswith(_JPEG):
        return _read_jpeg(data, name)
    if data.startswith(_PNG):
        return _read_png(data, name)
    if data.startswith(_TIFF):
        return _read_tiff_family(data, name, is_plain=suffix in _TIFF_SUFFIXES)
    if len(data) < 16:
        raise _damaged(name, f"it has {len(data)} bytes")
    return _read_raw(data, name)


def _damaged(name: str, why: str) -> CameraProtocolError:
    return CameraProtocolError(
        f"the camera's file {name or '(no name)'} cannot be read: {why}", hint="shoot it again"
    )


def _check_size(name: str, rows: int, columns: int, bytes_in_file: int) -> None:
    """Refuse sizes that no camera has or that so short a file cannot hold."""
    pixels = rows * columns
    if not (0 < pixels <= MAX_PIXELS and pixels <= _MOST_PIXELS_A_BYTE * bytes_in_file):
        raise _damaged(name, f"{columns} x {rows} pixels in {bytes_in_file} bytes")


# ---- JPEG and PNG


def _read_jpeg(data: bytes, name: str) -> Still:
    _check_size(name, *_jpeg_size(data, name), len(data))
    return _decode(data, name)


def _jpeg_size(data: bytes, name: str) -> tuple[int, int]:
    """Return (rows, columns), having walked all markers to the end of the image.

    libjpeg fills up with grey what a file cut short does not have, so its end is looked for here.
    """
    size: tuple[int, int] | None = None
    at = 2
    while (found := _MARKER.search(data, at)) is not None:
        marker, at = data[found.end() - 1], found.end()
        if marker == _END_OF_IMAGE:
            if size is None:
                raise _damaged(name, "it has no frame header")
            return size
        if at + 2 > len(data):
            break
        (length,) = struct.unpack_from(">H", data, at)
        if marker in _FRAME_HEADERS:
            if length < 8 or at + 8 > len(data):
                break
            precision, rows, columns, channels = struct.unpack_from(">BHHB", data, at + 2)
            if precision != 8 or channels not in (1, 3):
                raise _damaged(name, f"JPEG of {channels} channels of {precision} bits")
            size = (rows, columns)
        at += max(length, 2)
    raise _damaged(name, "it ends too early")


def _read_png(data: bytes, name: str) -> Still:
    at, size = len(_PNG), None
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        if zlib.crc32(memoryview(data)[at + 4 : end - 4]) != int.from_bytes(data[end - 4 : end]):
            raise _damaged(name, f"the checksum of its part {kind!r} is wrong")
        if kind == b"IHDR" and length == 13:
            columns, rows = struct.unpack_from(">II", data, at + 8)
            size = (rows, columns)
        if kind == b"IEND":
            if size is None:
                break
            _check_size(name, *size, len(data))
            return _decode(data, name)
        at = end
    raise _damaged(name, "it ends too early")


def _decode(data: bytes, name: str) -> Still:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise _damaged(name, error.err or "OpenCV refuses it") from None
    if image is None:
        raise _damaged(name, "OpenCV cannot decode it")
    if image.ndim == 3 and image.shape[2] == 3:
        image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    return _brightness(np.asarray(image), name)


def _brightness(image: NDArray[Any], name: str) -> Still:
    """Return grey or RGB samples of 8 or 16 bits that use all their codes."""
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.dtype not in (np.uint8, np.uint16):
        raise _damaged(name, f"samples of type {image.dtype}")
    if image.ndim != 2 and not (image.ndim == 3 and image.shape[2] == 3):
        raise _damaged(name, f"an array of {image.shape}")
    bits = 8 * image.dtype.itemsize
    return Still(
        np.ascontiguousarray(image),
        Layout.MONO if image.ndim == 2 else Layout.RGB,
        bits,
        black=0,
        white=2**bits - 1,
        is_linear=False,
    )


# ---- TIFF, and the raw formats that are built like one (DNG, NEF, CR2, ARW, ...)


def _read_tiff_family(data: bytes, name: str, *, is_plain: bool) -> Still:
    try:
        with tifffile.TiffFile(io.BytesIO(data)) as file:
            page = file.pages.first
            is_plain = is_plain and _DNG_VERSION not in page.tags
            _check_segments(page, name, len(data))
            for offset in page.subifds or () if not is_plain else ():
                if not 0 <= offset < len(data):
                    raise _damaged(name, "a directory lies behind its end")
            if is_plain:
                return _read_page(page, name, len(data))
    except (CameraProtocolError, UsageError):
        raise
    except Exception as error:  # whatever a made-up tag leads tifffile to
        raise _damaged(name, f"{type(error).__name__}: {error}".splitlines()[0]) from None
    return _read_raw(data, name)


def _check_segments(page: Any, name: str, bytes_in_file: int) -> None:
    segments = zip(page.dataoffsets, page.databytecounts, strict=False)
    if any(offset + count > bytes_in_file for offset, count in segments):
        raise _damaged(name, "it ends too early")


def _read_page(page: Any, name: str, bytes_in_file: int) -> Still:
    _check_size(name, page.imagelength, page.imagewidth, bytes_in_file)
    _check_size(name, page.imagelength, page.imagewidth * page.samplesperpixel, bytes_in_file)
    if page.photometric not in (_MIN_IS_BLACK, _RGB):
        raise _damaged(name, f"TIFF of photometric interpretation {page.photometric}")
    if page.bitspersample not in (8, 16) or page.imagedepth != 1:
        raise _damaged(name, f"TIFF of {page.bitspersample} bits a sample")
    if not page.dataoffsets or len(page.dataoffsets) != len(page.databytecounts):
        raise _damaged(name, "it does not say where its samples are")
    try:
        image = page.asarray(maxworkers=1)
    except ValueError as error:
        if "imagecodecs" in str(error):
            raise UsageError(
                f"{name} is a compressed TIFF", hint="pip install imagecodecs"
            ) from None
        raise
    if page.planarconfig == 2 and image.ndim == 3:
        image = np.moveaxis(image, 0, -1)
    return _brightness(image, name)


# ---- camera raw


def _read_raw(data: bytes, name: str) -> Still:
    try:
        import rawpy
    except ImportError:
        raise UsageError(
            f"{name} is camera raw, and rawpy is not installed", hint="pip install 'camctl[raw]'"
        ) from None
    try:
        with rawpy.imread(io.BytesIO(data)) as raw:
            sizes = raw.sizes
            _check_size(name, sizes.raw_height, sizes.raw_width, len(data))
            return _mosaic(raw, name)
    except rawpy.LibRawError as error:
        raise _damaged(name, _words(error)) from None


def _words(error: Exception) -> str:
    said = error.args[0] if error.args else type(error).__name__
    return said.decode("ascii", "replace") if isinstance(said, bytes) else str(said)


def _mosaic(raw: Any, name: str) -> Still:
    samples: NDArray[np.uint16] = raw.raw_image_visible
    if samples is None or samples.size == 0:
        raise _damaged(name, "it holds no samples")
    blacks = [int(level) for level in raw.black_level_per_channel]
    whites = [int(level) for level in raw.camera_white_level_per_channel or ()]
    white = min([int(raw.white_level), *(level for level in whites if level > max(blacks))])
    layout, channels = _layout(raw, samples, name)
    black = max(blacks[int(channel)] for channel in np.unique(channels))
    if not 0 <= black < white < 1 << 16:
        raise _damaged(name, f"black level {black}, white level {white}")
    bits = white.bit_length()
    pixels = np.minimum(samples, np.uint16(2**bits - 1))
    raise_by = np.array([black - level for level in blacks])[channels]
    notes: tuple[str, ...] = ()
    if np.any(raise_by):
        _raise_blacks(pixels, raise_by, 2**bits - 1)
        notes = (
            f"black levels of the colours differ ({', '.join(map(str, blacks))}): each was raised "
            f"to {black}",
        )
    if bits <= 8:
        return Still(pixels.astype(np.uint8), layout, bits, black, white, True, notes)
    return Still(pixels, layout, bits, black, white, True, notes)


def _layout(raw: Any, samples: NDArray[np.uint16], name: str) -> tuple[Layout, NDArray[np.intp]]:
    """Return the layout, and the channel numbers of its smallest repeating part."""
    if samples.ndim == 3:
        raise _damaged(name, "raw files with all colours in each pixel are not supported")
    if raw.num_colors == 1:
        return Layout.MONO, np.zeros((1, 1), np.intp)
    channels = raw.raw_colors_visible[:2, :2].astype(np.intp)
    names = raw.color_desc.decode("ascii", "replace")
    word = "".join(names[channel] for channel in channels.ravel())
    pattern = raw.raw_pattern
    if word not in _PATTERNS or pattern is None or pattern.shape != (2, 2):
        raise _damaged(name, f"a colour pattern of {word} is not supported")
    return _PATTERNS[word], channels


def _raise_blacks(pixels: NDArray[np.uint16], raise_by: NDArray[np.intp], top: int) -> None:
    """Add to each colour, in place and without running over."""
    for row, column in np.ndindex(raise_by.shape):
        part = pixels[row :: raise_by.shape[0], column :: raise_by.shape[1]]
        by = np.uint16(raise_by[row, column])
        np.minimum(part, np.uint16(top - by), out=part)
        part += by
