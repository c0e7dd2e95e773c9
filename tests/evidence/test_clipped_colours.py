"""Photographs of bright colours: what saturation makes of them in JPEG files is no movement."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.evidence.edges import mixed_colours
from camctl.evidence.marks import FALSE_ALARMS
from camctl.model.colour_rounding import ENCODED

_EXPOSURES, _CONTRADICTS = (1.0, 4.0, 16.0), 4
_REAL = camctl.standard_response("srgb", 8)


def scene() -> NDArray[np.float64]:
    """Return light of sharp patches of many colours, most of which the longest frame clips."""
    rng = np.random.default_rng(7)
    coarse = np.exp(rng.normal(0, 0.8, (18, 28, 3)) + rng.normal(0, 0.6, (18, 28, 1)))
    patches = cv2.resize(coarse, (336, 216), interpolation=cv2.INTER_NEAREST)
    return np.asarray(0.04 * cv2.GaussianBlur(patches, (0, 0), 1.0))


def marks(
    lights: list[NDArray[np.float64]], quality: int, chroma: int = 0x221111
) -> NDArray[np.bool_]:
    """Return which samples contradict of files of these lights, of 4:2:0 unless told."""
    rng, frames = np.random.default_rng(3), []
    for exposure, light in zip(_EXPOSURES, lights, strict=True):
        x = rng.poisson(np.minimum(exposure * light, 8) * 15_000) / 15_000
        pixels = np.searchsorted(_REAL.levels, x + rng.normal(0, 2e-3, x.shape), "right")
        options = [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, chroma]
        data = cv2.imencode(".jpg", pixels.astype(np.uint8)[..., ::-1], options)[1]
        frames.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    return camctl.combine(frames, _EXPOSURES, response=_REAL).mask & _CONTRADICTS > 0


@pytest.mark.parametrize("quality", [75, 95])
def test_colours_that_saturation_clips_do_not_move(quality: int) -> None:
    """Marked were 1.3 and 0.5 %: files make what was clipped darker, and mix its colour."""
    assert marks([scene()] * 3, quality).mean() < FALSE_ALARMS


@pytest.mark.parametrize("moved", [0, 1, 2])
def test_what_moves_beside_saturated_colours_is_found(moved: int) -> None:
    light = scene()
    other = light.copy()
    other[100:160, 100:160] = 0.012, 0.02, 0.01
    is_changed = np.abs(np.log(np.minimum(light, 0.5) / np.minimum(other, 0.5))) > 0.5
    is_changed &= np.minimum(light, other) * _EXPOSURES[moved] < 0.5
    lights = [light] * 3
    lights[moved] = other
    found = marks(lights, 75)
    assert found[is_changed].mean() > 0.7
    found[92:168, 92:168] = False
    assert found.mean() < FALSE_ALARMS


def test_files_with_all_colours_mix_none() -> None:
    """39 % were marked where files of 4:4:4 were taken for ones that mix what is clipped."""
    light = scene()
    other = light.copy()
    moved = slice(100, 160), slice(100, 160)
    other[moved] *= 0.6
    is_changed = light[moved] * _EXPOSURES[2] < 0.5
    is_changed &= (light[moved] * _EXPOSURES[2] > 1).any(axis=2, keepdims=True)
    assert marks([light, light, other], 90, 0x111111)[moved][is_changed].mean() > 0.43
    assert marks([light] * 3, 90, 0x111111).mean() < FALSE_ALARMS / 10


@pytest.mark.parametrize("shape", [(12, 16), (13, 17)])
def test_errors_of_mixed_colours_are_those_of_cells_that_are_interpolated(
    shape: tuple[int, int],
) -> None:
    rng = np.random.default_rng(1)
    short = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    clipped = np.maximum(np.arange(256) - np.array([[100], [150], [200]]), 0.0)
    colours = np.stack([clipped[k][short[..., k]] for k in range(3)], axis=-1)
    colours -= colours @ ENCODED[:1].T
    even = np.pad(colours, [(0, each % 2) for each in shape] + [(0, 0)], mode="edge")
    rows, columns = (each // 2 for each in even.shape[:2])
    cells = even.reshape(rows, 2, columns, 2, 3).mean(axis=(1, 3))
    shown = cv2.resize(cells, (2 * columns, 2 * rows), interpolation=cv2.INTER_LINEAR)
    places = np.unravel_index(np.arange(short.size), short.shape)
    found = mixed_colours(clipped, short, places).reshape(short.shape)
    np.testing.assert_allclose(found, shown[: shape[0], : shape[1]] - colours, atol=1e-9)
