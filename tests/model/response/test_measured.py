from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.exposure.evaluation import evaluate
from camctl.exposure.solver import SearchOptions, solve
from camctl.model.response.camera import FloatArray, linear_response
from camctl.model.response.desired import desired_response
from camctl.model.response.measured import (
    isotonic,
    measured_response,
    read_curve,
    read_desired,
    read_response_model,
)

RAMP = np.linspace(0, 1, 1024)


@pytest.mark.parametrize("bits", [4, 8, 12, 16])
@pytest.mark.parametrize("phase", [0.0, 0.5, 0.25])
def test_straight_curve_gives_the_linear_camera(bits: int, phase: float) -> None:
    measured = measured_response(RAMP, RAMP, bits=bits, phase=phase)
    expected = linear_response(bits, phase=phase)
    np.testing.assert_allclose(measured.levels, expected.levels, rtol=1e-12, atol=1e-15)


def test_square_root_curve_gives_squares() -> None:
    E = np.linspace(0, 1, 40_001)
    measured = measured_response(E, np.sqrt(E), bits=8)
    chord = 1 / 40_000 / 4  # largest distance of a chord between samples from the parabola
    np.testing.assert_allclose(
        measured.levels, (np.arange(1, 256) / 256) ** 2, rtol=0, atol=chord * (1 + 1e-9)
    )
    assert measured.notes == ()


def test_level_inside_a_flat_run_is_the_smallest_irradiance() -> None:
    camera = measured_response([0, 0.2, 0.5, 1], [0, 0.5, 0.5, 1], bits=1)
    assert camera.levels.tolist() == [0.2]
    assert "brightness is constant over 1 of 3 steps" in camera.notes


def test_unordered_repeated_and_noisy_samples_are_repaired_and_reported() -> None:
    rng = np.random.default_rng(0)
    B = np.clip(np.sqrt(RAMP) + rng.normal(0, 0.003, 1024), 0, 1)
    B[0], B[-1] = 0, 1
    E = np.append(RAMP, RAMP[500])
    camera = measured_response(E, np.append(B, B[500] + 0.002), bits=8)
    assert np.all(np.diff(camera.levels) >= 0)
    np.testing.assert_allclose(camera.levels, (np.arange(1, 256) / 256) ** 2, atol=0.006)
    notes = " / ".join(camera.notes)
    assert "rows were not in order of irradiance: sorted" in notes
    assert "1 repeated irradiances: the brightness of each was averaged" in notes
    assert "isotonic fit, which changed it by at most" in notes


def test_offset_scale_and_early_saturation_are_repaired_and_reported() -> None:
    camera = measured_response([0, 100, 200], [16, 235, 235], bits=8)
    np.testing.assert_allclose(camera.levels, linear_response(8).levels, rtol=1e-12)
    assert camera.notes == (
        "brightness 16 without light was subtracted",
        "largest brightness 219 was scaled to 1",
        "irradiance 100, where brightness reaches 1, was scaled to 1",
        "brightness is constant over 1 of 2 steps",
        "3 samples for 255 levels: interpolated linearly",
    )


def test_isotonic_fit_is_the_least_squares_fit() -> None:
    assert isotonic(np.array([1.0, 3.0, 2.0, 2.0, 5.0])).tolist() == pytest.approx(
        [1, 7 / 3, 7 / 3, 7 / 3, 5]
    )
    assert isotonic(np.array([3.0, 2.0, 1.0])).tolist() == [2, 2, 2]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0\n0.5\n1\n", "line 1: expected 2 columns, found 1"),
        ("0 0\n0.5 0.5 0.5\n", "line 2: expected 2 columns, found 3"),
        ("irradiance brightness\n0 0\n1 1\n", "'irradiance brightness' is not two numbers"),
        ("0 0\n0.5 nan\n1 1\n", "row 2 contains a number that is not finite"),
        ("0 1\n0.5 0.5\n1 0\n", "brightness decreases with irradiance"),
        ("0 0.5\n0.5 0.5\n1 0.5\n", "the brightness is constant"),
        ("-1 0\n0.5 0.5\n1 1\n", "irradiance -1 is negative"),
        ("0 0\n", "expected two or more rows of irradiance and brightness"),
        ("# nothing\n", "the file contains no numbers"),
    ],
)
def test_unusable_curve_files_are_refused_in_one_line(
    tmp_path: Path, text: str, message: str
) -> None:
    path = tmp_path / "curve.txt"
    path.write_text(text)
    with pytest.raises(DataError, match=message) as caught:
        read_curve(path, bits=8)
    assert "curve.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_binary_curve_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"cannot read curve .*none.txt: No such file"):
        read_curve(tmp_path / "none.txt", bits=8)
    (tmp_path / "binary").write_bytes(b"\xff\x00\xfe")
    with pytest.raises(DataError, match=r"cannot read curve .*binary: it is not a text file"):
        read_curve(tmp_path / "binary", bits=8)


def test_curve_file_may_contain_comments_and_any_separator(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_text("# irradiance, brightness\n0, 0\n0.5; 0.5 # middle\n\n1\t1\n")
    np.testing.assert_allclose(read_curve(path, bits=4).levels, linear_response(4).levels)


def test_desired_response_from_a_file(tmp_path: Path) -> None:
    path = tmp_path / "desired.txt"
    path.write_text("0.5 0\n5 3\n50 4\n")
    desired = read_desired(path)
    assert desired.name == "desired.txt"
    assert desired.dynamic_range == 100
    assert desired.u(0.1).item() == pytest.approx(0.75)


def test_invalid_desired_response_in_a_file_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "desired.txt"
    path.write_text("0.5 0\n5 3\n50 2\n")
    message = "invalid desired response 'desired.txt': u must not decrease"
    with pytest.raises(DataError, match=message):
        read_desired(path)


def write_model(path: Path) -> None:
    """Write a response model of a mean and two components, in the published format."""

    def block(values: FloatArray) -> str:
        return "\n".join(" ".join(f"{v:.6e}" for v in row) for row in values.reshape(-1, 4))

    bump = np.sin(np.pi * RAMP)
    path.write_text(
        f"E = \n{block(RAMP)}\nf0 = \n{block(RAMP**0.45)}\n"
        f"h(1)=\n{block(0.1 * bump)}\nh(2)=\n{block(0.05 * np.sin(2 * np.pi * RAMP))}\n"
    )


def test_response_of_the_empirical_model(tmp_path: Path) -> None:
    write_model(tmp_path / "model.txt")
    model = read_response_model(tmp_path / "model.txt")
    assert model.components.shape == (2, 1024)
    mean = model.response()
    brighter = model.response([1.0])
    assert mean.levels[127] == pytest.approx(0.5 ** (1 / 0.45), rel=1e-3)
    assert brighter.levels[127] < mean.levels[127]
    with pytest.raises(UsageError, match="the response model has 2 components, not 3"):
        model.response([1, 1, 1])
    with pytest.raises(DataError, match="brightness decreases with irradiance"):
        model.response([-60.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("f0 = 0 1\n", "the block 'E =' is missing"),
        ("E = 0 1\nf0 = 0 0.5 1\n", "block 'f0' has 3 numbers, expected 2"),
        ("E = 0 1\nf0 = 0 x\n", "line 2: '0 x' is not a row of numbers"),
        ("0 1\n", "line 1: numbers come before the first heading"),
        ("E = 0 1\nh(" + "9" * 5000 + ") = 0 1\n", "line 2: 'h.9+' is not a row of numbers"),
    ],
)
def test_damaged_response_models_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "model.txt").write_text(text)
    with pytest.raises(DataError, match=message):
        read_response_model(tmp_path / "model.txt")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["log", "linear", "gamma"])
def test_exposures_for_curves_of_the_published_model_beat_doubling(
    tmp_path: Path, real_data: Path, name: str
) -> None:
    """A dozen curves, by way of two-column files of 1,024 samples."""
    model = read_response_model(real_data / "emor.txt")
    assert model.components.shape == (25, 1024)
    desired = desired_response(name, 1000.0)
    rng = np.random.default_rng(12)
    for number in range(12):
        weights = rng.normal(0, 1, 3) * (1.5, 0.4, 0.2)
        curve = model.mean + weights @ model.components[:3]
        path = tmp_path / f"curve{number}.txt"
        np.savetxt(path, np.column_stack([model.irradiance, curve]))
        camera = read_curve(path, bits=8)
        found = solve(camera, desired, 3, search=SearchOptions(effort=0.1))
        assert found.xi < evaluate(camera, desired, (1, 2, 4)).xi
