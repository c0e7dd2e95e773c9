"""Pixel formats in order of fidelity, and what the samples of each stand for.

Raw samples of many bits come first: the levels of a desired camera are the union of theirs.  Luma
of 8 bits has been processed by the camera; a JPEG has lost levels on top of that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.abi import fourcc
from camctl.drivers.v4l2.packing import (
    BITS_OF_10,
    BYTES,
    FIRST_OF_TWO,
    JPEG,
    MIPI_RAW10,
    MIPI_RAW12,
    MIPI_RAW14,
    SECOND_OF_TWO,
    THREE_BYTES,
    THREE_BYTES_REVERSED,
    WORDS,
    Packing,
)
from camctl.errors import CameraError, UsageError, unknown_name
from camctl.findings import Finding, note
from camctl.interface.controls import Layout, ResponseOrigin
from camctl.model.response.camera import CameraResponse, named_response

#: Black and white of limited 8-bit luma, DN (ITU-R BT.601).
_LIMITED_BLACK, _LIMITED_WHITE = 16, 235


@dataclass(frozen=True)
class PixelFormat:
    """A pixel format that the driver can read.

    Attributes:
        name: its name on the command line
        code: its four characters in V4L2
        packing: of its samples
        bits: of a sample
        layout: pixel layout
        is_raw: samples are linear in light unless the camera reports otherwise
        is_yuv: luma may be limited to 16..235
        is_lossy: compression loses levels
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


_PATTERNS = (Layout.RGGB, Layout.GRBG, Layout.GBRG, Layout.BGGR)
#: Bits of a sample, packing, and the four characters for each of `_PATTERNS`.
_BAYER = (
    (16, WORDS, ("RG16", "GR16", "GB16", "BYR2")),
    (14, WORDS, ("RG14", "GR14", "GB14", "BG14")),
    (14, MIPI_RAW14, ("pREE", "pgEE", "pGEE", "pBEE")),
    (12, WORDS, ("RG12", "BA12", "GB12", "BG12")),
    (12, MIPI_RAW12, ("pRCC", "pgCC", "pGCC", "pBCC")),
    (10, WORDS, ("RG10", "BA10", "GB10", "BG10")),
    (10, MIPI_RAW10, ("pRAA", "pgAA", "pGAA", "pBAA")),
    (8, BYTES, ("RGGB", "GRBG", "GBRG", "BA81")),
)

FORMATS: tuple[PixelFormat, ...] = (
    PixelFormat("y16", "Y16 ", WORDS, 16),
    PixelFormat("y14", "Y14 ", WORDS, 14),
    PixelFormat("y14", "Y14P", MIPI_RAW14, 14),
    PixelFormat("y12", "Y12 ", WORDS, 12),
    PixelFormat("y12", "Y12P", MIPI_RAW12, 12),
    PixelFormat("y10", "Y10 ", WORDS, 10),
    PixelFormat("y10", "Y10P", MIPI_RAW10, 10),
    PixelFormat("y10", "Y10B", BITS_OF_10, 10),
    *(
        PixelFormat(f"bayer{bits}", code, packing, bits, layout)
        for bits, packing, codes in _BAYER
        for code, layout in zip(codes, _PATTERNS, strict=True)
    ),
    PixelFormat("grey", "GREY", BYTES, 8, is_raw=False),
    PixelFormat("yuyv", "YUYV", FIRST_OF_TWO, 8, is_raw=False, is_yuv=True),
    PixelFormat("uyvy", "UYVY", SECOND_OF_TWO, 8, is_raw=False, is_yuv=True),
    PixelFormat("nv12", "NV12", BYTES, 8, is_raw=False, is_yuv=True),
    PixelFormat("yuv420", "YU12", BYTES, 8, is_raw=False, is_yuv=True),
    PixelFormat("yuv420", "YV12", BYTES, 8, is_raw=False, is_yuv=True),
    PixelFormat("rgb24", "RGB3", THREE_BYTES, 8, Layout.RGB, is_raw=False),
    PixelFormat("bgr24", "BGR3", THREE_BYTES_REVERSED, 8, Layout.RGB, is_raw=False),
    PixelFormat("mjpg", "MJPG", JPEG, 8, is_raw=False, is_lossy=True),
)


def choose_format(offered: Sequence[int], name: str, path: str) -> PixelFormat:
    """Return the requested pixel format if it is offered, or the one that loses least.

    `name` is a name of `FORMATS`, "bayer" for the Bayer format with the most bits, or "auto".

    Raises:
        UsageError: no such format, or the camera does not offer it
        CameraError: the camera offers none that the driver can read
    """
    known = {format_.name for format_ in FORMATS} | {"auto", "bayer"}
    if name not in known:
        raise unknown_name("pixel format", name, known)
    usable = [format_ for format_ in FORMATS if format_.fourcc in offered]
    codes = ", ".join(map(_code, offered))
    if not usable:
        raise CameraError(
            f"{path} offers no pixel format that camctl can read, only {codes or 'none at all'}",
            hint="use a camera that offers YUYV, MJPG or raw samples",
        )
    for format_ in usable:
        if name in (format_.name, "auto") or (name == "bayer" and format_.layout.is_mosaic):
            return format_
    raise UsageError(
        f"{path} does not offer the pixel format {name}",
        hint=f"it offers {', '.join(dict.fromkeys(format_.name for format_ in usable))}",
    )


def _code(number: int) -> str:
    raw = number.to_bytes(4, "little")
    return "".join(chr(byte) if 32 < byte < 127 else "?" for byte in raw)


@dataclass(frozen=True)
class SampleScale:
    """What the samples of a stream stand for.

    Attributes:
        bits: of a sample
        black, white: brightness without light and at saturation, DN
        response: as levels between black and white; None: linear
        response_origin: whether it is stated or only assumed
        findings: what a person should know of it
    """

    bits: int
    black: int
    white: int
    response: CameraResponse | None
    response_origin: ResponseOrigin
    findings: tuple[Finding, ...]


def sample_scale(
    format_: PixelFormat,
    current: abi.Format,
    *,
    bits: int | None,
    black: int | None,
    luma_range: str,
    response: str,
) -> SampleScale:
    """Return what samples stand for, by the format, what V4L2 reports, and the user's options.

    Args:
        format_: the pixel format
        current: what V4L2 reports of the format that is set
        bits: bits that samples of 16 bits use; None: all
        black: brightness without light, DN; None: the lower end of the luma range
        luma_range: "auto", "full" or "limited"
        response: one of `camctl.model.response.camera.RESPONSES`, or "auto"

    Raises:
        UsageError: an unknown response, or an option that does not fit the format
    """
    if bits is not None and format_.bits != 16:
        raise UsageError(
            f"the option bits={bits} does not apply to the pixel format {format_.name}",
            hint="it states how many bits of y16 or bayer16 are used",
        )
    if luma_range == "auto":
        is_limited = format_.is_yuv and _is_limited(current)
    else:
        is_limited = luma_range == "limited"
    if is_limited and not format_.is_yuv:
        raise UsageError(
            f"the option range=limited does not apply to the pixel format {format_.name}",
            hint="only YUV luma has a limited range",
        )
    depth = bits or format_.bits
    lowest, white = (_LIMITED_BLACK, _LIMITED_WHITE) if is_limited else (0, 2**depth - 1)
    dark = lowest if black is None else black
    if not 0 <= dark < white:
        raise UsageError(f"invalid black level {dark}", hint=f"give 0 to {white - 1} DN")
    findings = []
    if format_.is_raw and black is None:
        findings.append(
            note(
                "black is assumed to be 0, because V4L2 does not report it: cover the lens, "
                "measure the mean brightness, and give it",
                {"option:black": None},
            )
        )
    if format_.is_lossy:
        findings.append(
            note(
                "JPEG frames lose levels: several exposures do not give the union of their levels; "
                "choose yuyv or a raw format if the camera offers one",
                {"option:format": "yuyv"},
            )
        )
    if is_limited and luma_range == "auto":
        findings.append(
            note(
                f"luma is limited to {_LIMITED_BLACK}..{_LIMITED_WHITE} according to V4L2; say "
                "that its range is full if black is 0",
                {"option:range": "full"},
            )
        )
    is_assumed = response == "auto" and not format_.is_raw
    name = ("linear" if format_.is_raw else "srgb") if response == "auto" else response
    return SampleScale(
        depth,
        dark,
        white,
        named_response(name, depth, white - dark),
        ResponseOrigin.ASSUMED if is_assumed else ResponseOrigin.STATED,
        tuple(findings),
    )


def _is_limited(current: abi.Format) -> bool:
    """Return whether luma is limited, by V4L2_MAP_QUANTIZATION_DEFAULT of videodev2.h."""
    if current.quantization == abi.Quantization.DEFAULT:
        return bool(current.colorspace != abi.COLORSPACE_JPEG)
    return bool(current.quantization != abi.Quantization.FULL)
