"""The response from rendered charts of known reflectance, and the exponent of unknown exposures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

from camctl.calibration.response.chart import ChartPatch, find_macbeth, read_patches
from camctl.calibration.response.estimate import Chart, ResponseEstimate, estimate_response
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.interface.controls import Layout
from camctl.model.response.camera import FloatArray
from camctl.sim.scenes.drawings import colour_chart

GREYS = (0.9, 0.59, 0.36, 0.2, 0.09, 0.03)
UNEVEN = (0.08, -0.05)


def srgb(E: FloatArray) -> FloatArray:
    return np.asarray(np.where(E <= 0.0031308, 12.92 * E, 1.055 * E ** (1 / 2.4) - 0.055))


def s_curve(E: FloatArray) -> FloatArray:
    root = E**0.45
    return np.asarray(0.35 * root + 0.65 * root**2 * (3 - 2 * root))


CURVES: dict[str, Callable[[FloatArray], FloatArray]] = {
    "linear": lambda E: E,
    "srgb": srgb,
    "s": s_curve,
}


def shoot(
    E: FloatArray,
    exposure: float,
    curve: Callable[[FloatArray], FloatArray],
    *,
    bits: int = 8,
    light: tuple[float, float] = UNEVEN,
) -> NDArray[Any]:
    """Return a frame: uneven light, photon noise of 10,000 electrons, read noise, the curve."""
    rng = np.random.default_rng(round(1000 * exposure))
    y, x = np.mgrid[-1 : 1 : E.shape[0] * 1j, -1 : 1 : E.shape[1] * 1j]
    shade = np.exp(light[0] * x + light[1] * y)
    charge = 1e4 * exposure * E * shade.reshape(shade.shape + (1,) * (E.ndim - 2))
    charge += np.sqrt(charge + 25) * rng.normal(size=E.shape)
    frame = np.minimum(np.floor(curve(np.clip(charge / 1e4, 0, 1)) * 2**bits), 2**bits - 1)
    return np.asarray(frame, np.uint8 if bits == 8 else np.uint16)


def macbeth() -> FloatArray:
    """Return a picture of a chart, through colour filters that are not those of sRGB."""
    picture = np.full((360, 540, 3), 0.2)
    picture[60:300, 90:450] = colour_chart(240, 360)
    filters = np.array([[0.8, 0.15, 0.05], [0.1, 0.8, 0.1], [0.05, 0.1, 0.85]])
    return np.asarray(picture @ filters.T)


def step_chart() -> tuple[FloatArray, tuple[ChartPatch, ...]]:
    """Return a picture of a grey step chart, and its patches."""
    picture = np.full((90, 260), 0.15)
    patches = []
    for k, grey in enumerate(GREYS):
        picture[20:70, 10 + 40 * k : 45 + 40 * k] = grey
        patches.append(ChartPatch(15 + 40 * k, 25, 25, 40, (grey,) * 3, (0.02,) * 3))
    return picture, tuple(patches)


def estimate(
    frames: list[NDArray[Any]],
    patches: tuple[ChartPatch, ...] | None,
    *,
    exposures: tuple[float, ...] | None = None,
    bits: int = 8,
) -> ResponseEstimate:
    layout = Layout.MONO if frames[0].ndim == 2 else Layout.RGB
    series = Series(layout, bits, exposures_are_stated=exposures is not None or len(frames) == 1)
    for k, frame in enumerate(frames):
        series.add(frame, exposures[k] if exposures else 1.0, f"frame {k}")
    return estimate_response(series, chart=Chart(patches, frames) if patches else None)


def error_of(found: ResponseEstimate, curve: Callable[[FloatArray], FloatArray]) -> float:
    """Return the largest rms error of brightness of a channel, at the best scale of light."""
    E = np.geomspace(1e-3, 0.99, 300)
    E = E[curve(E) > 0.05]
    errors = []
    for channel in found.record.channels:
        differences = [
            np.interp(E * scale, channel.irradiance, channel.brightness) - curve(E)
            for scale in np.exp(np.linspace(-0.2, 0.2, 201))
        ]
        errors.append(min(float(np.sqrt(np.mean(each**2))) for each in differences))
    return max(errors)


@pytest.mark.parametrize(
    ("name", "bits"), some([("linear", 12), ("srgb", 8), ("s", 8), ("s", 12)], every=4, first=1)
)
def test_one_frame_of_a_macbeth_chart_gives_the_response(name: str, bits: int) -> None:
    frames = [shoot(macbeth(), 0.85, CURVES[name], bits=bits)]
    patches = find_macbeth(frames, Layout.RGB)
    assert len(patches) == 24
    found = estimate(frames, patches, bits=bits)
    assert error_of(found, CURVES[name]) < 0.02
    for channel in found.record.channels:
        assert np.all(np.diff(channel.irradiance) > 0)


@pytest.mark.parametrize("angle", some([1, 2], every=2))
def test_a_turned_chart_and_a_mosaic_are_found(angle: int) -> None:
    picture = np.rot90(macbeth(), angle)
    frame = shoot(picture, 0.85, srgb)
    straight = find_macbeth([frame], Layout.RGB)
    mosaic = np.zeros(frame.shape[:2], np.uint8)
    for letter, plane in zip("RGGB", Layout.RGGB.planes(mosaic), strict=True):
        row, column = divmod("RGGB".index(letter) if letter != "G" else 1, 2)
        plane[...] = frame[row::2, column::2, "RGB".index(letter)]
    for found in (straight, find_macbeth([mosaic], Layout.RGGB)):
        white = found[18]
        x, y = round(white.x + white.width / 2), round(white.y + white.height / 2)
        assert picture[y, x].min() > 0.85


@pytest.mark.slow
def test_exposures_that_nobody_states_are_found_with_a_chart() -> None:
    true = (1.0, 0.4, 0.15)
    for curve in (srgb, s_curve):
        frames = [shoot(macbeth(), 0.9 * each, curve) for each in true]
        found = estimate(frames, find_macbeth(frames, Layout.RGB))
        assert found.exposures == pytest.approx(true, rel=0.1)
        assert found.exponent_error is not None
        assert found.exponent_error < 0.05
        assert error_of(found, curve) < 0.015


def test_a_list_of_patches_gives_the_response_and_adds_to_several_frames() -> None:
    picture, patches = step_chart()
    one = estimate([shoot(picture, 0.95, srgb)], patches)
    assert error_of(one, srgb) < 0.015
    steps = tuple(0.95 * 2.0**-k for k in range(6))
    frames = [shoot(picture, each, srgb) for each in steps]
    several = estimate(frames, patches, exposures=steps)
    assert error_of(several, srgb) < min(0.008, error_of(one, srgb))


def test_a_patch_that_contradicts_the_others_is_named() -> None:
    picture, patches = step_chart()
    wrong = ChartPatch(**{**vars(patches[2]), "reflectance": (0.7,) * 3})
    steps = tuple(0.95 * 2.0**-k for k in range(6))
    frames = [shoot(picture, each, srgb) for each in steps]
    found = estimate(frames, (*patches[:2], wrong, *patches[3:]), exposures=steps)
    patches_named = [e.details["patch"] for e in found.findings if e.code == "chart_contradicts"]
    assert patches_named == [3]


def test_exposures_that_nobody_states_are_estimated_with_a_plain_warning() -> None:
    rng = np.random.default_rng(5)
    E = np.geomspace(1e-3, 1, 160) * rng.uniform(0.9, 1.1, (120, 160))
    true = (1.0, 2.0, 4.0, 8.0)
    found = estimate([shoot(E, each, srgb, light=(0, 0)) for each in true], None)
    assert found.exposures == pytest.approx(true, rel=0.15)
    assert found.exponent_error == 0.2
    (finding,) = [each for each in found.findings if each.code == "exponent_unknown"]
    assert finding.value == found.exponent_error
    assert "times" in finding.remedies
    (channel,) = found.record.channels
    assert channel.deviation is not None
    at = int(np.searchsorted(channel.brightness, 0.05))
    assert channel.deviation[at] > 0.2  # the unknown exponent is in the intervals


def test_pictures_without_a_chart_and_bad_patches_are_refused() -> None:
    picture, patches = step_chart()
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 255, (200, 300), np.uint8)
    for frame in (noise, np.zeros((5, 7), np.uint8), np.full((50, 80), 255, np.uint8)):
        with pytest.raises(DataError, match="no Macbeth chart was found in any frame; let a chart"):
            find_macbeth([frame], Layout.MONO)
    outside = (*patches, ChartPatch(250, 80, 30, 30, (0.5,) * 3, (0.02,) * 3))
    frame = shoot(picture, 0.95, srgb)
    with pytest.raises(DataError, match="the patch at 250, 80 has no pixels in frames of 260 x 90"):
        estimate([frame], outside)
    with pytest.raises(DataError, match=r"0 of 6 patches .* neither black nor saturated"):
        estimate([shoot(picture, 30.0, srgb)], patches)
    with pytest.raises(DataError, match=r"the frames show the response only up to .*%"):
        estimate([shoot(picture, 0.3, srgb)], patches)


def test_a_file_of_patches_is_read(tmp_path: Path) -> None:
    path = tmp_path / "patches.txt"
    path.write_text(
        "# greys\n10 20 30 40 0.9\n\n50,20,30,40,0.5 # the next\n90 20 30 40 .1 .2 .3\n"
    )
    first, second, third = read_patches(path)
    assert (first.x, first.y, first.width, first.height) == (10, 20, 30, 40)
    assert second.reflectance == (0.5, 0.5, 0.5)
    assert third.reflectance == (0.1, 0.2, 0.3)
    assert third.channel("B")[0] == 0.3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has 0 patches: expected 3 or more; give one patch a line"),
        ("1 2 3 4 0.5\n" * 2, "has 2 patches"),
        ("1 2 3 4\n", "line 1: expected 5 or 7 numbers; give x, y, width"),
        ("1 2 3 4 a\n", "line 1: expected 5 or 7 numbers"),
        ("1 2 3 4 .5 .5\n", "line 1: expected 5 or 7 numbers"),
        ("\n-1 2 3 4 .5\n", "line 2: invalid rectangle -1 2 3 4"),
        ("1 2 0 4 .5\n", "line 1: invalid rectangle 1 2 0 4"),
        ("nan 2 3 4 .5\n", "line 1: invalid rectangle nan"),
        ("1 2 3 1e400 .5\n", "line 1: invalid rectangle"),
        ("1 2 3 4 0\n", "line 1: invalid reflectance 0; give numbers from 0 to 1"),
        ("1 2 3 4 nan\n", "line 1: invalid reflectance nan"),
    ],
)
def test_invalid_files_of_patches_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "patches.txt"
    path.write_text(text)
    with pytest.raises(DataError) as caught:
        read_patches(path)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
