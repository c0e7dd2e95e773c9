from __future__ import annotations

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.model.response.camera import (
    CameraResponse,
    FloatArray,
    linear_response,
    named_response,
    standard_response,
)


def test_number_of_levels_is_white_minus_black() -> None:
    camera = linear_response(10, levels=1023 - 64)
    assert camera.M == 959
    assert camera.levels[0] == 1 / 960
    assert camera.fingerprint != linear_response(10).fingerprint


@pytest.mark.parametrize(
    ("name", "brightness", "irradiance"),
    [
        ("srgb", 0.5, 0.21404114048223255),
        ("srgb", 0.03125, 0.03125 / 12.92),
        ("rec709", 0.5, 0.25958940050628576),  # 1.099 E^0.45 - 0.099 = 0.5
        ("power", 0.5, 0.5**2.2),
    ],
)
def test_standard_responses_invert_their_formulas(
    name: str, brightness: float, irradiance: float
) -> None:
    level = int(brightness * 256) - 1
    assert standard_response(name, 8).levels[level] == pytest.approx(irradiance, rel=1e-9)


@pytest.mark.parametrize("phase", [0.0, 0.5, 0.999])
@pytest.mark.parametrize("bits", [8, 12, 13, 14, 15, 16])
def test_rec709_levels_are_where_the_printed_formula_reaches_them(bits: int, phase: float) -> None:
    """Its constants are rounded: brightness jumps from 0.0810 to 0.0812 at irradiance 0.018."""

    def brightness(E: FloatArray) -> FloatArray:
        return np.where(E < 0.018, 4.5 * E, 1.099 * E**0.45 - 0.099)

    levels = standard_response("rec709", bits, phase=phase).levels
    wanted = (np.arange(1, 2**bits) - phase) / 2**bits
    assert np.all(np.diff(levels) >= 0)
    assert np.all(brightness(levels * (1 + 1e-12)) >= wanted)
    assert np.all(brightness(levels * (1 - 1e-12)) < wanted)


def test_rec709_levels_that_the_jump_skips_coincide() -> None:
    assert np.count_nonzero(standard_response("rec709", 16).levels == 0.018) == 16
    assert np.count_nonzero(standard_response("rec709", 8).levels == 0.018) == 0


def test_unknown_standard_suggests_similar_names() -> None:
    with pytest.raises(UsageError, match="unknown camera response 'sRGBA'; did you mean srgb"):
        standard_response("sRGBA")


@pytest.mark.parametrize(
    ("bits", "phase", "levels", "message"),
    [
        (0, 0.0, None, "invalid bit depth 0: expected 1 to 16"),
        (17, 0.0, None, "invalid bit depth 17: expected 1 to 16"),
        (8, 1.0, None, "invalid quantiser phase 1.0: expected at least 0 and less than 1"),
        (8, -0.1, None, "invalid quantiser phase -0.1: expected at least 0 and less than 1"),
        (8, 0.0, 0, "invalid number of levels 0: expected 1 to 65535"),
    ],
)
def test_invalid_quantisers_are_refused(
    bits: int, phase: float, levels: int | None, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        linear_response(bits, phase=phase, levels=levels)


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        ([], "expected a list of one or more levels"),
        ([0.5, float("nan")], "a level is not a finite number"),
        ([0.5, 0.4], "levels must be >= 0 and must not decrease"),
        ([-0.1, 0.4], "levels must be >= 0 and must not decrease"),
    ],
)
def test_invalid_levels_are_refused(levels: list[float], message: str) -> None:
    with pytest.raises(DataError, match=f"invalid response 'test': {message}"):
        CameraResponse(np.array(levels), "test")


def test_slope_counts_coincident_levels() -> None:
    camera = CameraResponse(np.array([0.25, 0.5, 0.5, 1.0]), "test")
    assert camera.slope([0.1, 0.3, 0.6, 2.0]).tolist() == [8.0, 8.0, 2.0, 2.0]


def test_driver_option_names_a_response() -> None:
    assert named_response("linear", 8, 255) is None
    power = named_response("power:1.8", 8, 239)
    assert power is not None
    assert power.name == "power 1/1.8 8 bit, 239 levels"
    default = named_response("power", 8, 255)
    assert default is not None
    assert default.fingerprint == standard_response("power", 8, gamma=2.2).fingerprint


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("srgb:2", "unknown camera response 'srgb:2'"),
        ("power:x", "invalid response 'power:x': 'x' is not a number; for example power:2.2"),
        ("power:99", "invalid gamma 99 of a power response: expected 0.05 to 20"),
    ],
)
def test_invalid_driver_options_are_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        named_response(text, 8, 255)
