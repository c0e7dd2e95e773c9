"""Where results go: a pipe to another program, or files."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import BinaryIO, Protocol

import numpy as np
from numpy.typing import NDArray

from camctl.errors import StorageError
from camctl.interface.controls import Layout
from camctl.livestream.display import Display
from camctl.livestream.result import LiveResult
from camctl.livestream.stream import Live
from camctl.system.files import make_folder, storage_error
from camctl.system.picture_operations import required_opencv

#: Most of the denominator of a rate: those of NTSC have 1001, and both parts stay below 2^31.
_RATE_PARTS = 10_000


class Output(Protocol):
    """Takes one result after the other."""

    def write(self, result: LiveResult) -> None:
        """Take a result; raises `BrokenPipeError` where nobody takes it any more."""

    def close(self) -> None:
        """End."""


def _send(stream: BinaryIO, *parts: bytes) -> None:
    """Write to a pipe or a file; raises `BrokenPipeError` or `StorageError`."""
    try:
        for part in parts:
            stream.write(part)
        stream.flush()
    except BrokenPipeError:
        raise
    except OSError as error:
        raise storage_error(Path("standard output"), error) from error


class RawOutput:
    """The desired response as 16-bit numbers, little endian: gray16le or rgb48le of ffmpeg.

    A mosaic is sent as it is: bayer_rggb16le.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream

    def write(self, result: LiveResult) -> None:
        """Send the picture of a result."""
        _send(self._stream, result.image.astype("<u2", copy=False).tobytes())

    def close(self) -> None:
        """Leave the stream open: it is not this one's."""


class Y4mOutput:
    """YUV4MPEG2, which ffmpeg and players read without further options, in 8 bits.

    Its rate is that of the first exposures; longer ones, and a slow reader, make it smaller later.

    Args:
        stream: where it goes
        display: makes the pictures
        live: the stream whose results are written
    """

    def __init__(self, stream: BinaryIO, display: Display, live: Live) -> None:
        self._stream, self._display, self._live = stream, display, live
        self._shape: tuple[int, ...] | None = None

    def write(self, result: LiveResult) -> None:
        """Send the picture of a result."""
        picture = self._display.picture(result)
        if self._shape is None:
            self._shape = picture.shape
            rows, columns = picture.shape[:2]
            colours = "mono" if picture.ndim == 2 else "444"
            found = self._live.planner.rate(result.plan.settings)
            rate = Fraction(found).limit_denominator(_RATE_PARTS)
            head = (
                f"YUV4MPEG2 W{columns} H{rows} F{rate.numerator}:{rate.denominator} Ip A1:1 "
                f"C{colours} XCOLORRANGE=FULL\n"
            )
            _send(self._stream, head.encode())
        _send(self._stream, b"FRAME\n", _planes(picture).tobytes())

    def close(self) -> None:
        """Leave the stream open: it is not this one's."""


def _planes(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return Y, Cb and Cr of full range (BT.601), (3, rows, columns), or Y alone."""
    if picture.ndim == 2:
        return picture
    return np.ascontiguousarray(np.moveaxis(ycbcr(picture), 2, 0))


def ycbcr(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return Y, Cb and Cr of full range (BT.601) of R, G and B, (rows, columns, 3)."""
    cv2 = required_opencv("video in colour")
    found = cv2.cvtColor(picture, cv2.COLOR_RGB2YCrCb)
    return np.asarray(found[..., [0, 2, 1]], np.uint8)


class ExrOutput:
    """Irradiance, standard deviation and mask of each k-th result, as OpenEXR files.

    Args:
        folder: new or empty; files are called 000000.exr, by the number of the result
        every: each so many-th result is written
    """

    def __init__(self, folder: Path, every: int = 1) -> None:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise StorageError(f"{folder} is not an empty folder", hint="name a new one")
        make_folder(folder)
        self._folder, self._every = folder, every
        self._count = 0

    def write(self, result: LiveResult) -> None:
        """Write a result, or leave it out."""
        number, self._count = self._count, self._count + 1
        if number % self._every:
            return
        import OpenEXR

        is_mosaic = result.layout.is_mosaic
        planes = Layout.MONO.planes if is_mosaic else result.layout.planes
        channels = {}
        for prefix, values in (
            ("", result.irradiance),
            ("sd.", result.sd),
            ("mask.", result.mask.astype(np.float16)),
        ):
            names = "RGB" if result.layout is Layout.RGB else "Y"
            for name, plane in zip(names, planes(values), strict=True):
                channels[prefix + name] = np.ascontiguousarray(plane)
        header = {
            "compression": OpenEXR.ZIP_COMPRESSION,
            "type": OpenEXR.scanlineimage,
            "expTime": float(sum(each.setting.time_s for each in result.exposures)),
        }
        path = self._folder / f"{result.number:06d}.exr"
        try:
            OpenEXR.File(header, channels).write(str(path))
        except (OSError, RuntimeError) as error:
            raise storage_error(path, OSError(str(error))) from error

    def close(self) -> None:
        """Nothing is left to be written."""
