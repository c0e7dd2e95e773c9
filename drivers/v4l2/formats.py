"""Pixel formats in order of honesty, and what the samples of each are.

Raw samples of many bits come first: the union of their levels is what a desired camera is made of.
Luma of 8 bits has been through the camera's own processing; a JPEG has lost levels on top of that.
OpenCV (cap_v4l.cpp, CAP_PROP_CONVERT_RGB = 0) gives Y10, Y12 and Y16 as uint16, YUYV as two
channels, and every format that it does not know as the bytes that came: packed and Bayer samples
are taken apart here.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.controls import Layout
from camctl.errors import CameraError, UsageError, unknown_name
from camctl.response.camera import CameraResponse, named_response
from drivers.v4l2 import abi
from drivers.v4l2.abi import fourcc
from drivers.v4l2.modes import Size

Bytes: TypeAlias = NDArray[np.uint8]
_SOI, _EOI = b"\xff\xd8", b"\xff\xd9"
_STANDARD_ERROR = threading.Lock()
#: What many webcams' encoders bring about in every frame, without harm to a sample.
_HARMLESS = "extraneous bytes before marker"


class SpoiltFrameError(CameraError):
    """A frame came damaged or in part; another has to be taken."""


@dataclass(frozen=True)
class Packing:
    """How samples lie in the bytes of a frame.

    Attributes:
        bytes_for: bytes of a line of so many pixels; None where a frame's length varies
        unpack: the bytes of all lines and the size to (rows, columns) samples
    """

    bytes_for: Callable[[int], int] | None
    unpack: Callable[[Bytes, Size], Pixels]


def _words(data: Bytes, size: Size) -> Pixels:
    samples: Pixels = data.view("<u2").astype(np.uint16).reshape(size.height, size.width)
    return samples


def _bytes(data: Bytes, size: Size) -> Pixels:
    return data.reshape(size.height, size.width).copy()


def _first_of_two(data: Bytes, size: Size) -> Pixels:
    return data.reshape(size.height, size.width, 2)[:, :, 0].copy()


def _second_of_two(data: Bytes, size: Size) -> Pixels:
    return data.reshape(size.height, size.width, 2)[:, :, 1].copy()


def _first_plane(data: Bytes, size: Size) -> Pixels:
    return data[: size.width * size.height].reshape(size.height, size.width).copy()


def _four_in_five(data: Bytes, size: Size) -> Pixels:
    """Four samples' upper 8 bits, then a byte of their lower 2 bits (MIPI RAW10)."""
    groups = data.reshape(-1, 5).astype(np.uint16)
    lower = (groups[:, 4:] >> np.array([0, 2, 4, 6], np.uint16)) & 3
    return _lines((groups[:, :4] << 2 | lower).astype(np.uint16, copy=False), size)


def _two_in_three(data: Bytes, size: Size) -> Pixels:
    """Two samples' upper 8 bits, then a byte of their lower 4 bits (MIPI RAW12)."""
    groups = data.reshape(-1, 3).astype(np.uint16)
    lower = (groups[:, 2:] >> np.array([0, 4], np.uint16)) & 15
    return _lines((groups[:, :2] << 4 | lower).astype(np.uint16, copy=False), size)


def _lines(groups: Pixels, size: Size) -> Pixels:
    """Return samples line by line, without those that fill up the last group of a line."""
    return groups.reshape(size.height, -1)[:, : size.width]


def _jpeg(data: Bytes, size: Size) -> Pixels:
    """Luma of a JPEG, which must be whole: decoders invent what is missing."""
    stream = data.tobytes().rstrip(b"\0")
    if not (stream.startswith(_SOI) and stream.endswith(_EOI)):
        raise SpoiltFrameError("a JPEG frame came in part", hint="take it again")
    luma, complaints = _decode(stream)
    is_harmless = all(_HARMLESS in line for line in complaints)
    if luma is None or luma.shape != (size.height, size.width) or not is_harmless:
        raise SpoiltFrameError("a JPEG frame cannot be decoded", hint="take it again")
    return luma.astype(np.uint8, copy=False)


def _decode(stream: bytes) -> tuple[NDArray[Any] | None, list[str]]:
    """Return a JPEG's luma and what libjpeg complains of.

    libjpeg invents what is damaged and tells only standard error of it, where a user must not see
    it and we must: it is led elsewhere meanwhile.
    """
    with _STANDARD_ERROR, tempfile.TemporaryFile() as told:
        ours = os.dup(2)
        try:
            os.dup2(told.fileno(), 2)
            luma = cv2.imdecode(np.frombuffer(stream, np.uint8), cv2.IMREAD_GRAYSCALE)
        except cv2.error:
            luma = None
        finally:
            os.dup2(ours, 2)
            os.close(ours)
        told.seek(0)
        return luma, told.read().decode("utf-8", "replace").splitlines()


WORDS = Packing(lambda width: 2 * width, _words)
OCTETS = Packing(lambda width: width, _bytes)
TENS = Packing(lambda width: -(-width // 4) * 5, _four_in_five)
TWELVES = Packing(lambda width: -(-width // 2) * 3, _two_in_three)
YUYV = Packing(lambda width: 2 * width, _first_of_two)
UYVY = Packing(lambda width: 2 * width, _second_of_two)
NV12 = Packing(lambda width: width, _first_plane)
JPEG = Packing(None, _jpeg)


@dataclass(frozen=True)
class PixelFormat:
    """A pixel format that the driver can read.

    Attributes:
        name: the word for it on the command line
        code: its four characters in V4L2
        packing: how its samples lie
        bits: of a sample
        layout: how colour lies in a frame
        is_raw: samples are linear in light unless the camera says otherwise
        is_yuv: luma may be limited to 16..235
        is_lossy: levels are lost on the way
    """

    name: str
    code: str
    packing: Packing
    bits: int
    layout: Layout = Layout.MONO
    is_raw: bool = True
    is_yuv: bool = False
    is_lossy: bool = False

    @property
    def fourcc(self) -> int:
        """Its number in V4L2."""
        return fourcc(self.code)

    def samples(self, data: NDArray[Any], size: Size) -> Pixels:
        """Return the samples of a frame of `size` as OpenCV gave it: (rows, columns).

        Raises:
            SpoiltFrameError: there are too few bytes, or they cannot be decoded

        """
        raw = np.ascontiguousarray(data).reshape(-1).view(np.uint8)
        if self.packing.bytes_for is None:
            return self.packing.unpack(raw, size)
        needed = self.packing.bytes_for(size.width) * size.height
        if raw.size < needed:
            raise SpoiltFrameError(f"a frame of {raw.size} bytes, not {needed}", hint="try again")
        # NV12's colours follow its luma; others may be padded behind their last line.
        return self.packing.unpack(raw[:needed], size)


_PATTERNS = (Layout.RGGB, Layout.GRBG, Layout.GBRG, Layout.BGGR)
#: Bits a sample: packing, and the four characters for each of `_PATTERNS`.
_BAYER = (
    (16, WORDS, ("RG16", "GR16", "GB16", "BYR2")),
    (14, WORDS, ("RG14", "GR14", "GB14", "BG14")),
    (12, WORDS, ("RG12", "BA12", "GB12", "BG12")),
    (12, TWELVES, ("pRCC", "pgCC", "pGCC", "pBCC")),
    (10, WORDS, ("RG10", "BA10", "GB10", "BG10")),
    (10, TENS, ("pRAA", "pgAA", "pGAA", "pBAA")),
    (8, OCTETS, ("RGGB", "GRBG", "GBRG", "BA81")),
)

FORMATS: tuple[PixelFormat, ...] = (
    PixelFormat("y16", "Y16 ", WORDS, 16),
    PixelFormat("y14", "Y14 ", WORDS, 14),
    PixelFormat("y12", "Y12 ", WORDS, 12),
    PixelFormat("y12", "Y12P", TWELVES, 12),
    PixelFormat("y10", "Y10 ", WORDS, 10),
    PixelFormat("y10", "Y10P", TENS, 10),
    *(
        PixelFormat(f"bayer{bits}", code, packing, bits, layout)
        for bits, packing, codes in _BAYER
        for code, layout in zip(codes, _PATTERNS, strict=True)
    ),
    PixelFormat("grey", "GREY", OCTETS, 8, is_raw=False),
    PixelFormat("yuyv", "YUYV", YUYV, 8, is_raw=False, is_yuv=True),
    PixelFormat("uyvy", "UYVY", UYVY, 8, is_raw=False, is_yuv=True),
    PixelFormat("nv12", "NV12", NV12, 8, is_raw=False, is_yuv=True),
    PixelFormat("mjpg", "MJPG", JPEG, 8, is_raw=False, is_lossy=True),
)


#: OpenCV opens a camera only in one of these (cap_v4l.cpp); another can be chosen after that.
OPENED: frozenset[int] = frozenset(
    fourcc(code)
    for code in (
        *("BGR3", "RGB3", "YV12", "YU12", "411P", "YUYV", "UYVY", "NV12", "NV21", "BA81", "GBRG"),
        *("GRBG", "XR24", "AR24", "S910", "MJPG", "JPEG", "Y16 ", "Y12 ", "Y10 ", "GREY"),
    )
)


def choose_format(offered: Sequence[int], wanted: str, path: str) -> PixelFormat:
    """Return the most honest of the formats offered, or the one wanted.

    `wanted` is a name of `FORMATS`, "bayer" for the deepest mosaic, or "auto".

    Raises:
        UsageError: no such format, or the camera does not have it
        CameraError: the camera has none that the driver can read

    """
    known = {format_.name for format_ in FORMATS} | {"auto", "bayer"}
    if wanted not in known:
        raise unknown_name("pixel format", wanted, known)
    usable = [format_ for format_ in FORMATS if format_.fourcc in offered]
    if not usable:
        listed = ", ".join(_spelt(number) for number in offered) or "none at all"
        raise CameraError(
            f"{path} has no pixel format that can be read, only {listed}",
            hint="use a camera that offers YUYV, MJPG or raw samples",
        )
    if OPENED.isdisjoint(offered):
        raise CameraError(
            f"OpenCV opens no camera that offers only {', '.join(map(_spelt, offered))}",
            hint="use a camera that offers YUYV, MJPG, Y16 or 8-bit mosaics, too",
        )
    for format_ in usable:
        if wanted in (format_.name, "auto") or (wanted == "bayer" and format_.layout.is_mosaic):
            return format_
    raise UsageError(
        f"{path} does not offer the pixel format {wanted}",
        hint=f"it offers {', '.join(dict.fromkeys(format_.name for format_ in usable))}",
    )


def _spelt(number: int) -> str:
    raw = number.to_bytes(4, "little")
    return "".join(chr(byte) if 32 < byte < 127 else "?" for byte in raw)


RANGES = ("auto", "full", "limited")
_BLACK, _WHITE = 16, 235  # of 8-bit luma in limited range, ITU-R BT.601


@dataclass(frozen=True)
class Samples:
    """What the samples of frames mean: brightness of black and white, DN, and the response."""

    bits: int
    black: int
    white: int
    response: CameraResponse | None
    notes: tuple[str, ...]


def read_samples(
    format_: PixelFormat,
    picture: abi.Format,
    *,
    bits: int | None,
    black: int | None,
    range_: str,
    response: str,
) -> Samples:
    """Return what samples are, by their format, what V4L2 says of it, and what the user says.

    Args:
        format_: the pixel format
        picture: what the camera says of the picture that is set
        bits: that samples of y16 really have; None: all
        black: brightness without light, DN; None: that of the range
        range_: one of `RANGES`
        response: one of `RESPONSES`

    Raises:
        UsageError: words that are none, or do not fit the format

    """
    if bits is not None and (format_.name != "y16" or not 9 <= bits <= 16):
        raise UsageError(
            f"{bits} bits in the pixel format {format_.name}",
            hint="bits says how many of y16 are used, 9 to 16",
        )
    if range_ not in RANGES:
        raise unknown_name("luma range", range_, RANGES)
    depth = bits or format_.bits
    is_limited = (
        format_.is_yuv and _is_limited(picture) if range_ == "auto" else (range_ == "limited")
    )
    if is_limited and not format_.is_yuv:
        raise UsageError(
            f"a limited range of the pixel format {format_.name}", hint="only YUV luma has one"
        )
    lowest, white = (_BLACK, _WHITE) if is_limited else (0, 2**depth - 1)
    dark = lowest if black is None else black
    if not 0 <= dark < white:
        raise UsageError(f"a black level of {dark}", hint=f"give 0 to {white - 1} DN")
    notes = []
    if format_.is_raw and black is None:
        notes.append(
            "black is taken as 0, for V4L2 does not tell it: cover the lens, look at the mean "
            "brightness, and give it with -O black=..."
        )
    if format_.is_lossy:
        notes.append(
            "JPEG frames lose levels: the union of levels of several exposures no longer holds; "
            "choose -O format=yuyv or a raw format where there is one"
        )
    if is_limited and range_ == "auto":
        notes.append(
            f"luma is taken as limited to {_BLACK}..{_WHITE}, as V4L2 says; "
            "-O range=full if black is 0"
        )
    if response == "auto" and not format_.is_raw:
        notes.append("the response is assumed to be sRGB until it is measured: -O response=...")
    name = ("linear" if format_.is_raw else "srgb") if response == "auto" else response
    return Samples(depth, dark, white, named_response(name, depth, white - dark), tuple(notes))


def _is_limited(picture: abi.Format) -> bool:
    """Say whether YUV luma is limited, as V4L2_MAP_QUANTIZATION_DEFAULT of videodev2.h decides."""
    if picture.quantization == abi.Quantization.DEFAULT:
        return bool(picture.colorspace != abi.COLORSPACE_JPEG)
    return bool(picture.quantization != abi.Quantization.FULL)
