"""What the samples of a V4L2 camera mean: bits, black and white, response."""

from __future__ import annotations

from dataclasses import dataclass

from camctl.errors import UsageError, unknown_name
from camctl.exposure.response import RealResponse
from drivers import v4l2_abi as abi
from drivers.responses import named_response
from drivers.v4l2_formats import PixelFormat

RANGES = ("auto", "full", "limited")
_BLACK, _WHITE = 16, 235  # of 8-bit luma in limited range, ITU-R BT.601


@dataclass(frozen=True)
class Samples:
    """What the samples of frames mean: brightness of black and white, DN, and the response."""

    bits: int
    black: int
    white: int
    response: RealResponse | None
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
