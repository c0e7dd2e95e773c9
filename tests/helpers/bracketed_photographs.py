"""Bracketed photographs of one scene, and the error of what is merged from them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

from camctl import read_report
from camctl.model.response.camera import standard_response

TIMES = tuple(2.0**k for k in range(-9, 2))
"""Exposures of the series, s: its shortest is dark and its longest mostly saturated."""
FEW = TIMES[::2]
"""Six of them: what is shown of a merge with these takes half the time."""

Floats = NDArray[np.float64]


def light(rows: int = 120, columns: int = 160) -> Floats:
    """Return irradiance of a scene over 1:2,000 with shapes in it, (rows, columns, 3)."""
    rng = np.random.default_rng(1)
    coarse = cv2.resize(rng.uniform(0, 1, (12, 16)), (columns, rows), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(rng.normal(size=(rows, columns)), (0, 0), 1.5)
    ramp = np.linspace(0, 1, columns)[None, :]
    log = 7.6 * (0.6 * ramp + 0.4 * np.clip(coarse, 0, 1)) + 0.8 * fine
    scene = np.exp(np.clip(log - log.max(), -7.6, 0))
    return np.asarray(200 * scene[..., None] * np.array([1.0, 0.8, 0.6]))


SCENE = light()


def photograph(time_s: float, scene: Floats = SCENE, seed: int = 0, bits: int = 8) -> NDArray[Any]:
    """Return an sRGB photograph with a little noise, (rows, columns, 3) in R, G, B."""
    made = _of_scene(time_s, seed, bits) if scene is SCENE else _taken(time_s, scene, seed, bits)
    return made.copy()


@cache
def _of_scene(time_s: float, seed: int, bits: int) -> NDArray[Any]:
    return _taken(time_s, SCENE, seed, bits)


def _taken(time_s: float, scene: Floats, seed: int, bits: int) -> NDArray[Any]:
    rng = np.random.default_rng((seed, int(time_s * 1e6)))
    E = scene * time_s
    E = E + np.sqrt(np.maximum(E, 0) / 8000) * rng.normal(size=E.shape)
    levels = standard_response("srgb", bits).levels
    return np.searchsorted(levels, E, side="right").astype(np.uint8 if bits == 8 else np.uint16)


def save(path: Path, pixels: NDArray[Any]) -> Path:
    """Write pixels in R, G, B, or grey ones, in the format of the suffix."""
    if path.suffix == ".tif":
        tifffile.imwrite(path, pixels, photometric="rgb" if pixels.ndim == 3 else "minisblack")
    else:
        swapped = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels
        assert cv2.imwrite(str(path), swapped, [cv2.IMWRITE_JPEG_QUALITY, 97])
    return path


def film(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return photographs as a film would show them: the response is to be estimated."""
    x = np.arange(256) / 255
    table = np.rint(255 * (0.4 * x + 0.6 * x**2 * (3 - 2 * x))).astype(np.uint8)
    return np.asarray(table[pixels])


def write_series(
    times: Sequence[float] = TIMES,
    suffix: str = ".png",
    change: Callable[[int, NDArray[Any]], NDArray[Any]] = lambda _, pixels: pixels,
    **more: Any,
) -> list[str]:
    """Write photographs, each changed before it is written, and return their names."""
    return [
        str(save(Path(f"p{k:02d}{suffix}"), change(k, photograph(time_s, **more))))
        for k, time_s in enumerate(times)
    ]


Series = Callable[..., list[str]]
"""Writes photographs, and returns arguments that name them."""


def error_of(folder: str, scene: Floats = SCENE) -> float:
    """Return the error of the radiance in a folder, see `error_between`."""
    return error_between(read_report(folder).radiance(), scene)


def error_between(radiance: NDArray[Any], scene: Floats) -> float:
    """Return the median absolute difference of the logarithms up to one scale per channel."""
    logs = np.log(np.maximum(radiance, 1e-9)) - np.log(np.maximum(scene, 1e-9))
    return float(np.median(np.abs(logs - np.median(logs, axis=(0, 1)))))
