"""The samples in the bytes of a frame, as V4L2 packs them.

OpenCV (cap_v4l.cpp, CAP_PROP_CONVERT_RGB = 0) delivers Y10, Y12 and Y16 as uint16, YUYV as two
channels, and each format that it does not know as the bytes that arrived.  All are read here as
bytes.
"""

from __future__ import annotations

import os
import tempfile
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.errors import CameraError
from drivers.v4l2.node import Shape

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
        unpack: from the bytes of all lines and the shape to samples, (rows, columns)
    """

    bytes_per_line: Callable[[int], int] | None
    unpack: Callable[[Bytes, Shape], Pixels]

    def samples(self, data: NDArray[Any], shape: Shape) -> Pixels:
        """Return the samples of a frame as OpenCV delivered it: (rows, columns).

        Raises:
            DamagedFrameError: bytes are missing, or they cannot be decoded
        """
        raw = np.ascontiguousarray(data).reshape(-1).view(np.uint8)
        if self.bytes_per_line is None:
            return self.unpack(raw, shape)
        rows, columns = shape
        needed = self.bytes_per_line(columns) * rows
        if raw.size < needed:
            raise DamagedFrameError(
                f"the frame has {raw.size} bytes instead of {needed}", hint="try again"
            )
        # The chroma plane of NV12 follows its luma; other formats may be padded at the end.
        return self.unpack(raw[:needed], shape)


def _words(data: Bytes, shape: Shape) -> Pixels:
    samples: Pixels = data.view("<u2").astype(np.uint16).reshape(shape)
    return samples


def _bytes(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(shape).copy()


def _first_of_two(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(*shape, 2)[:, :, 0].copy()


def _second_of_two(data: Bytes, shape: Shape) -> Pixels:
    return data.reshape(*shape, 2)[:, :, 1].copy()


def _mipi_raw10(data: Bytes, shape: Shape) -> Pixels:
    """Unpack groups of five bytes: the upper 8 bits of four samples, then their lower 2 bits."""
    groups = data.reshape(-1, 5).astype(np.uint16)
    lower = (groups[:, 4:] >> np.array([0, 2, 4, 6], np.uint16)) & 3
    return _lines((groups[:, :4] << 2 | lower).astype(np.uint16, copy=False), shape)


def _mipi_raw12(data: Bytes, shape: Shape) -> Pixels:
    """Unpack groups of three bytes: the upper 8 bits of two samples, then their lower 4 bits."""
    groups = data.reshape(-1, 3).astype(np.uint16)
    lower = (groups[:, 2:] >> np.array([0, 4], np.uint16)) & 15
    return _lines((groups[:, :2] << 4 | lower).astype(np.uint16, copy=False), shape)


def _lines(groups: Pixels, shape: Shape) -> Pixels:
    """Return samples line by line, without those that fill up the last group of a line."""
    rows, columns = shape
    return groups.reshape(rows, -1)[:, :columns]


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
MIPI_RAW10 = Packing(lambda columns: -(-columns // 4) * 5, _mipi_raw10)
MIPI_RAW12 = Packing(lambda columns: -(-columns // 2) * 3, _mipi_raw12)
FIRST_OF_TWO = Packing(lambda columns: 2 * columns, _first_of_two)
SECOND_OF_TWO = Packing(lambda columns: 2 * columns, _second_of_two)
JPEG = Packing(None, _jpeg)
