"""Compiled code makes the same light as numpy, bit by bit."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.model.light import LightTables
from camctl.model.light_memory import LightMemory
from camctl.model.noise import FrameNoise
from camctl.model.plain_light import plain_light
from camctl.model.response.camera import linear_response, standard_response
from camctl.model.sensor import SensorModel
from camctl.model.step_posterior import FrameSet


def _frames(bits: int, response: str, read: float, exposures: tuple[float, ...]) -> FrameSet:
    real = linear_response(bits) if response == "linear" else standard_response(response, bits)
    noise = FrameNoise(10000 / real.M, read * real.M / 255, black=0)
    return FrameSet(real, 0, exposures, (noise,) * len(exposures))


def _samples(frames: FrameSet, count: int) -> list[NDArray[Any]]:
    """Return noisy samples of light from the darkest to more than saturates each frame."""
    rng, real = np.random.default_rng(1), frames.response
    full = float(real.levels[-1])
    light = full * 2.0 ** rng.uniform(-18, 1, count)
    light[: count // 8].sort()  # blocks of which frames are saturated
    found = []
    for exposure in frames.exposures:
        noisy = light * exposure + rng.normal(0, 0.004 * full, count)
        codes = np.searchsorted(SensorModel(real, 0).light, noisy)
        found.append(np.minimum(codes, real.M).astype(np.uint8 if real.M < 256 else np.uint16))
    return found


@pytest.mark.parametrize(
    ("bits", "response", "read", "exposures"),
    [
        (8, "linear", 0.6, (1.0, 3.3, 13.0, 48.0, 176.0, 683.0)),
        (8, "linear", 1.2, (1.0, 1.0, 20.0)),
        (8, "srgb", 0.9, (1.0, 6.0, 40.0)),
        (12, "linear", 0.2, (1.0, 8.0, 60.0)),
    ],
)
def test_light_is_that_of_numpy(
    bits: int, response: str, read: float, exposures: tuple[float, ...]
) -> None:
    pytest.importorskip("numba")
    tables = LightTables(_frames(bits, response, read, exposures))
    values = _samples(_frames(bits, response, read, exposures), 150_000)
    total = np.asarray(np.sum(values, axis=0, dtype=np.uint16))
    memory, plain = LightMemory(tables.estimate), LightMemory(tables.estimate)
    plain.plain = plain_light(tables, tables.deviation)
    assert plain.plain is not None
    for found, expected in zip(plain.of(values, total), memory.of(values, total), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_nothing_is_made_where_no_noise_is_known() -> None:
    tables = LightTables(_frames(2, "linear", 0.0, (1.0, 5.0)))
    assert plain_light(tables, np.full(tables.lights.size, np.nan)) is None
