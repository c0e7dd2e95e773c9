"""Frames that are damaged on their way from the camera, as streams damage them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Pixels
from camctl.system.library_output import quiet_libraries
from camctl.system.picture_operations import jpeg, required_opencv

_GREEN = (0, 135, 0)
"""RGB of a sample of zeros in Y, U and V (BT.601, 16 to 235): what a lost packet of USB leaves."""

_BAND = 8  # lines of a lost packet, at most a fifth of the frame's
_JPEG_QUALITY = 90
_SCAN = b"\xff\xda"  # marker of a JPEG file


def _first_line(pixels: Pixels, random: np.random.Generator) -> int:
    """Return the line where the damage begins, from 30 to 70 % of the height."""
    rows = pixels.shape[0]
    return int(rows * random.uniform(0.3, 0.7))


def _random_half(pixels: Pixels, white: int, random: np.random.Generator) -> None:
    rest = pixels[pixels.shape[0] // 2 :]
    rest[...] = random.integers(0, white, rest.shape, pixels.dtype, endpoint=True)


def _truncated(pixels: Pixels, white: int, random: np.random.Generator) -> None:
    """Leave out all bytes from one within a line on: the buffer holds zeros there."""
    first = _first_line(pixels, random) * pixels[0].size
    pixels.reshape(-1)[first + int(random.integers(pixels[0].size)) :] = 0


def _shifted(pixels: Pixels, white: int, random: np.random.Generator) -> None:
    """Leave out a part of a line: all samples after it come too early, and zeros at the end."""
    columns = pixels.shape[1]
    flat = pixels.reshape(pixels.shape[0] * columns, -1)
    first = _first_line(pixels, random) * columns + int(random.integers(columns))
    gap = int(columns * random.uniform(0.1, 0.9))
    flat[first:] = np.concatenate((flat[first + gap :], np.zeros_like(flat[:gap])))


def _doubled(pixels: Pixels, white: int, random: np.random.Generator) -> None:
    """Send a block of lines twice: all lines after it come too late, and the last are missing."""
    first = _first_line(pixels, random)
    count = max(1, pixels.shape[0] // 10)
    rest = np.concatenate((pixels[first - count : first], pixels[first:-count]))
    pixels[first:] = rest


def _green(pixels: Pixels, white: int, random: np.random.Generator) -> None:
    """Lose packets of a USB stream in YUYV: green blocks; in a grey stream they are black."""
    columns = pixels.shape[1]
    flat = pixels.reshape(pixels.shape[0] * columns, -1)
    colour = np.array(_GREEN if pixels.ndim == 3 else (0,), np.float64) * (white / 255)
    lines = max(1, min(_BAND, pixels.shape[0] // 5))
    for _ in range(3):
        first = _first_line(pixels, random) * columns + int(random.integers(columns))
        flat[first : first + lines * columns] = colour.astype(pixels.dtype)


def _broken_jpeg(pixels: Pixels, white: int, random: np.random.Generator) -> None:
    """Lose bytes in the middle of a JPEG file: what follows is decoded wrongly.

    Samples that this does not change stay as they are, without the loss of JPEG.
    """
    cv2 = required_opencv("the fault jpeg")
    whole: NDArray[np.uint8] = np.rint(pixels * (255 / white)).clip(0, 255).astype(np.uint8)
    data = np.frombuffer(jpeg(whole, _JPEG_QUALITY), np.uint8)
    begin = data.tobytes().index(_SCAN)  # the bytes of the picture follow
    first = begin + int((data.size - begin) * random.uniform(0.4, 0.6))
    broken = np.concatenate((data[:first], data[first + max(1, (data.size - begin) // 20) :]))
    kind = cv2.IMREAD_COLOR_RGB if pixels.ndim == 3 else cv2.IMREAD_GRAYSCALE
    with quiet_libraries():
        right, wrong = cv2.imdecode(data, kind), cv2.imdecode(broken, kind)
    if wrong is None:  # nothing can be decoded of it
        wrong = np.full_like(right, 128)
    changed = right != wrong
    pixels[changed] = np.rint(wrong[changed] * (white / 255)).astype(pixels.dtype)


DAMAGES: Final[Mapping[str, Callable[[Pixels, int, np.random.Generator], None]]] = {
    "corrupt": _random_half,
    "truncate": _truncated,
    "shift": _shifted,
    "double": _doubled,
    "green": _green,
    "jpeg": _broken_jpeg,
}
"""How each kind of damage changes the pixels of a frame, in place, up to white."""


def damaged(pixels: Pixels, kind: str, number: int, white: int) -> Pixels:
    """Return a frame with damage of a kind of `DAMAGES`, the same for one frame number."""
    found = pixels.copy()
    DAMAGES[kind](found, white, np.random.Generator(np.random.PCG64(number)))
    return found
