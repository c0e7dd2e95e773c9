"""Radiance maps for the tests of metering, drawn here and written as files for `--scene`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

Light = NDArray[np.float32]
_SHAPE = 240, 320
#: Shares of the samples of the memorial map, and how many times as bright its brightest one is.
_MAP_SHARES = 0.0, 0.001, 0.005, 0.01, 0.02, 0.05, 0.5, 0.9, 0.98, 0.99, 0.995, 0.998, 0.999, 1.0
_MAP_DARKNESS = (
    1.64e6,
    8.79e5,
    7.21e5,
    6.21e5,
    4.81e5,
    2.69e5,
    1.29e4,
    2160,
    245,
    30.7,
    19.7,
    13.1,
    7.38,
    1.0,
)


def _grid() -> tuple[Light, Light]:
    rows, columns = _SHAPE
    y, x = np.mgrid[0:rows, 0:columns].astype(np.float32)
    return x / rows, y / rows


def _texture(seed: int, low: float, high: float) -> Light:
    """Return smooth blotches from `low` to `high`."""
    noise = np.random.default_rng(seed).random((12, 16), dtype=np.float32)
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
    smooth = cv2.resize(noise, _SHAPE[::-1], interpolation=cv2.INTER_CUBIC)
    return np.asarray(low + (high - low) * np.clip(smooth, 0, 1), np.float32)


def blocks(rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (240, 320) of overlapping blocks of one light each, exp(-6) to 1: sharp edges."""
    light = np.full((240, 320), np.exp(-6.0))
    for _ in range(400):
        row, column = rng.integers(0, 240), rng.integers(0, 320)
        height, width = rng.integers(3, 50, 2)
        light[row : row + height, column : column + width] = np.exp(rng.uniform(-6, 0))
    return light


def sun_through_window() -> Light:
    """Return a room with a window of 6 % of the picture, and the sun in it."""
    x, y = _grid()
    wall = 0.004 * _texture(1, 0.1, 1.0) / (0.3 + (x - 0.9) ** 2 + (y - 0.4) ** 2)
    window = (abs(x - 0.9) < 0.14) & (abs(y - 0.35) < 0.14)
    light = np.where(window, 1.0 + 2 * _texture(2, 0.0, 1.0), wall)
    light = np.where(np.hypot(x - 0.86, y - 0.28) < 0.018, 2000.0, light)
    return np.stack([light, 0.95 * light, 0.9 * light], axis=-1).astype(np.float32)


def candle_in_hall() -> Light:
    """Return a dark hall that one candle lights; the flame is 0.1 % of the picture."""
    x, y = _grid()
    distance = np.hypot(x - 0.5, y - 0.6)
    light = _texture(3, 0.05, 0.8) / (0.02 + distance**2)
    light = np.where(np.hypot((x - 0.5) * 2, y - 0.6) < 0.025, 4000.0, light)
    return np.stack([light, 0.6 * light, 0.25 * light], axis=-1).astype(np.float32)


def memorial() -> Light:
    """Return a dim nave with bright windows: a stand-in for the memorial map.

    Its light has the distribution of that map.
    """
    x, y = _grid()
    panes = (np.sin(x * 47) > 0.6) & (np.sin(y * 61) > 0.2) & (y < 0.35)
    order = _texture(4, -1.0, 1.0) - 1.2 * y + _texture(5, 0.0, 1.0) + 2 * panes
    ranks = np.argsort(np.argsort(order.ravel())).reshape(_SHAPE) / order.size
    light = np.exp(-np.interp(ranks, _MAP_SHARES, np.log(_MAP_DARKNESS)))
    return np.stack([0.9 * light, 0.8 * light, light], axis=-1).astype(np.float32)


def lamp_in_room() -> Light:
    """Return a room with dark corners and a far brighter lamp of 2 % of the picture."""
    x, y = _grid()
    room = np.exp(-_texture(6, 0.0, 5.0))
    light = np.where(np.hypot(x - 0.7, y - 0.3) < 0.092, 400 * _texture(7, 0.8, 1.0), room)
    return np.stack([light, 0.9 * light, 0.7 * light], axis=-1).astype(np.float32)


MAPS: dict[str, Callable[[], Light]] = {
    "sun-through-window.exr": sun_through_window,
    "candle-in-hall.hdr": candle_in_hall,
    "memorial.hdr": memorial,
    "lamp-in-room.exr": lamp_in_room,
}


def write_map(name: str, folder: Path) -> Path:
    """Write one of `MAPS` into a folder; return its path."""
    path, light = folder / name, MAPS[name]()
    if path.suffix == ".exr":
        import OpenEXR

        channels = {c: np.ascontiguousarray(light[..., k]) for k, c in enumerate("RGB")}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, channels).write(str(path))
    else:
        cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
        cv2.imwrite(str(path), light[..., ::-1])
    return path
