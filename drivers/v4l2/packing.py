"""The samples in the bytes of a frame, as V4L2 packs them."""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeAlias

import numpy as np
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from camctl.drivers.common.packed_samples import lines, mipi
from camctl.drivers.v4l2.node import Shape
from camctl.errors import CameraError
from camctl.interface.camera import Pixels
from camctl.system.picture_operations import required_opencv

Bytes: TypeAlias = NDArray[np.uint8]

_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_STANDARD_ERROR_LOCK = threading.Lock()
#: A warning of libjpeg that many webcams' encoders cause in every frame, and that harms no sample.
_HARMLESS = "extraneous bytes before marker"


class DamagedFrameError(CameraError):
    """A frame is damaged or incomplete; take another."""


@dataclass(frozen=True)
class Packing:
    """How the samples of a frame are stored in its bytes.

    Attributes:
        bytes_per_line: bytes of a line with this number of columns; None where the length of a
            frame varies
        unpack: from the bytes of all lines and the shape to samples, (rows, columns), of RGB with
            3 more; a copy
    """

    bytes_per_line: Callable[[int], int] | None
    unpack: Callable[[Bytes, Shape], Pixels]

    def samples(self, data: Bytes, shape: Shape, line_bytes: int = 0) -> Pixels:
        """Return the samples of a frame: (rows, columns), of RGB (rows, columns, 3).

        Args:
            data: its bytes
            shape: (rows, columns)
            line_bytes: from the start of a line to the start of the next, where lines are padded

        Raises:
            DamagedFrameError: bytes are missing, or they cannot be decoded
        """
        if self.bytes_per_line is None:
            return self.unpack(data, shape)
        rows, columns = shape
        used = self.bytes_per_line(columns)
        line_bytes = max(line_bytes, used)
        needed = line_bytes * (rows - 1) + used
        if data.size < needed:
            raise DamagedFrameError(
                f"the frame has {data.size} bytes instead of {needed}", hint="try again"
            )
        # The chroma of NV12 and YUV420 follows the luma; other formats may be padded at the end.
        lines = as_strided(data[:needed], (rows, used), (line_bytes, 1), writeable=False)
        return self.unpack(np.ascontiguousarray(lines).reshape(-1), shape)


def _words(data: Bytes, shape: Shape) -> Pixels:
    samples: Pixels = data.view("<u2").astype(np.uint16).reshape(shape)
    return samples


def _bytes(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(shape).copy()


def _three(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(*shape, 3).copy()


def _three_reversed(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(*shape, 3)[:, :, ::-1].copy()


def _first_of_two(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(*shape, 2)[:, :, 0].copy()


def _second_of_two(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(*shape, 2)[:, :, 1].copy()


def _bits_of_10(data: Bytes, shape: Shape) -> Pixels:
    """Unpack five bytes into four samples of 10 bits, one after the other, upper bits first."""
    groups = data.reshape(-1, 5).astype(np.uint16)
    upper = groups[:, :4] << np.array([2, 4, 6, 8], np.uint16)
    lower = groups[:, 1:] >> np.array([6, 4, 2, 0], np.uint16)
    return lines(((upper | lower) & 1023).astype(np.uint16), shape)


def _jpeg(data: Bytes, shape: Shape) -> Pixels:
    """Return the luma of a JPEG, which must be complete: decoders invent what is missing."""
    stream = data.tobytes().rstrip(b"\0")
    if not (stream.startswith(_JPEG_START) and stream.endswith(_JPEG_END)):
        raise DamagedFrameError("the JPEG frame is incomplete", hint="take it again")
    luma, warnings = _decode_jpeg(stream)
    is_harmless = all(_HARMLESS in line for line in warnings)
    if luma is None or luma.shape != shape or not is_harmless:
        raise DamagedFrameError("the JPEG frame cannot be decoded", hint="take it again")
    return luma.astype(np.uint8, copy=False)


def _decode_jpeg(stream: bytes) -> tuple[NDArray[Any] | None, list[str]]:
    """Return the luma of a JPEG and the warnings of libjpeg.

    libjpeg invents samples for damaged parts and reports that on standard error only.  That is
    redirected to a file meanwhile, so that it is read here and not printed.
    """
    cv2 = required_opencv("decoding MJPG frames")  # a second of loading, here alone

    with _STANDARD_ERROR_LOCK, tempfile.TemporaryFile() as warnings:
        standard_error = os.dup(2)
        try:
            os.dup2(warnings.fileno(), 2)
            luma = cv2.imdecode(np.frombuffer(stream, np.uint8), cv2.IMREAD_GRAYSCALE)
        except cv2.error:
            luma = None
        finally:
            os.dup2(standard_error, 2)
            os.close(standard_error)
        warnings.seek(0)
        return luma, warnings.read().decode("utf-8", "replace").splitlines()


WORDS = Packing(lambda columns: 2 * columns, _words)
BYTES = Packing(lambda columns: columns, _bytes)
MIPI_RAW10 = Packing(lambda columns: -(-columns // 4) * 5, partial(mipi, 10, 4))
MIPI_RAW12 = Packing(lambda columns: -(-columns // 2) * 3, partial(mipi, 12, 2))
MIPI_RAW14 = Packing(lambda columns: -(-columns // 4) * 7, partial(mipi, 14, 4))
BITS_OF_10 = Packing(lambda columns: -(-columns // 4) * 5, _bits_of_10)
THREE_BYTES = Packing(lambda columns: 3 * columns, _three)
THREE_BYTES_REVERSED = Packing(lambda columns: 3 * columns, _three_reversed)
FIRST_OF_TWO = Packing(lambda columns: 2 * columns, _first_of_two)
SECOND_OF_TWO = Packing(lambda columns: 2 * columns, _second_of_two)
JPEG = Packing(None, _jpeg)
