from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camctl.errors import DataError, UsageError
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import xi
from camctl.exposure.solver import solve
from camctl.response.camera import linear_response, standard_response
from camctl.response.desired import desired_response, tabulated_desired
from camctl.response.emor import read_response_model
from camctl.response.measured import isotonic, measured_response, read_curve

RAMP = np.linspace(0, 1, 1024)


@pytest.mark.parametrize("bits", [4, 8, 12, 16])
@pytest.mark.parametrize("phase", [0.0, 0.5, 0.25])
def test_a_straight_curve_is_the_linear_camera(bits: int, phase: float) -> None:
    measured = measured_response(RAMP, RAMP, bits=bits, phase=phase)
    straight = linear_response(bits, phase=phase)
    np.testing.assert_allclose(measured.levels, straight.levels, rtol=1e-12, atol=1e-15)


def test_levels_follow_white_minus_black() -> None:
    camera = linear_response(10, levels=1023 - 64)
    assert camera.M == 959
    assert camera.levels[0] == 1 / 960
    assert camera.fingerprint != linear_response(10).fingerprint


def test_a_square_root_curve_gives_squares() -> None:
    E = np.linspace(0, 1, 40_001)
    measured = measured_response(E, np.sqrt(E), bits=8)
    chord = 1 / 40_000 / 4  # how far a chord between samples lies from the parabola, at most
    np.testing.assert_allclose(
        measured.levels, (np.arange(1, 256) / 256) ** 2, rtol=0, atol=chord * (1 + 1e-9)
    )
    assert measured.notes == ()


def test_flat_runs_take_the_least_light_that_reaches_a_level() -> None:
    camera = measured_response([0, 0.2, 0.5, 1], [0, 0.5, 0.5, 1], bits=1)
    assert camera.levels.tolist() == [0.2]
    assert any("flat over 1 of 3 steps" in note for note in camera.notes)


def test_repeated_samples_and_noise_are_repaired_and_said() -> None:
    rng = np.random.default_rng(0)
    B = np.clip(np.sqrt(RAMP) + rng.normal(0, 0.003, 1024), 0, 1)
    B[0], B[-1] = 0, 1
    E = np.append(RAMP, RAMP[500])
    camera = measured_response(E, np.append(B, B[500] + 0.002), bits=8)
    assert np.all(np.diff(camera.levels) >= 0)
    np.testing.assert_allclose(camera.levels, (np.arange(1, 256) / 256) ** 2, atol=0.006)
    text = " / ".join(camera.notes)
    assert "not in order" in text
    assert "1 repeated irradiances" in text
    assert "isotonic fit" in text


def test_offset_scale_and_early_saturation_are_said() -> None:
    camera = measured_response([0, 100, 200], [16, 235, 235], bits=8)
    np.testing.assert_allclose(camera.levels, linear_response(8).levels, rtol=1e-12)
    assert len(camera.notes) == 5
    assert any("3 samples for 255 levels" in note for note in camera.notes)


def test_isotonic_is_the_least_squares_fit() -> None:
    assert isotonic(np.array([1.0, 3.0, 2.0, 2.0, 5.0])).tolist() == pytest.approx(
        [1, 7 / 3, 7 / 3, 7 / 3, 5]
    )
    assert isotonic(np.array([3.0, 2.0, 1.0])).tolist() == [2, 2, 2]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0\n0.5\n1\n", "line 1: 1 column"),
        ("0 0\n0.5 0.5 0.5\n", "line 2: 3 columns"),
        ("irradiance brightness\n0 0\n1 1\n", "not two numbers"),
        ("0 0\n0.5 nan\n1 1\n", "row 2 holds a number that is not finite"),
        ("0 1\n0.5 0.5\n1 0\n", "brightness falls with irradiance"),
        ("0 0.5\n0.5 0.5\n1 0.5\n", "the curve is constant"),
        ("-1 0\n0.5 0.5\n1 1\n", "negative"),
        ("0 0\n", "two or more rows"),
        ("# nothing\n", "no numbers"),
    ],
)
def test_curve_files_that_cannot_be_used(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "curve.txt"
    path.write_text(text)
    with pytest.raises(DataError, match=words) as caught:
        read_curve(path, bits=8)
    assert "curve.txt" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_curve_files_that_are_not_text_or_not_there(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="No such file"):
        read_curve(tmp_path / "none.txt", bits=8)
    (tmp_path / "binary").write_bytes(b"\xff\x00\xfe")
    with pytest.raises(DataError, match="not a text file"):
        read_curve(tmp_path / "binary", bits=8)


def test_curve_files_with_comments_and_commas(tmp_path: Path) -> None:
    path = tmp_path / "curve.csv"
    path.write_text("# irradiance, brightness\n0, 0\n0.5; 0.5 # middle\n\n1\t1\n")
    np.testing.assert_allclose(read_curve(path, bits=4).levels, linear_response(4).levels)


@pytest.mark.parametrize(
    ("name", "brightness", "irradiance"),
    [
        ("srgb", 0.5, 0.21404114048223255),
        ("srgb", 0.03125, 0.03125 / 12.92),
        ("rec709", 0.5, 0.25958940050628576),  # 1.099 E^0.45 - 0.099 = 0.5
        ("power", 0.5, 0.5**2.2),
    ],
)
def test_standard_responses(name: str, brightness: float, irradiance: float) -> None:
    level = int(brightness * 256) - 1
    assert standard_response(name, 8).levels[level] == pytest.approx(irradiance, rel=1e-9)


def test_unknown_standard() -> None:
    with pytest.raises(UsageError, match="did you mean srgb"):
        standard_response("sRGBA")


@pytest.mark.parametrize(
    "options", [{"bits": 0}, {"bits": 17}, {"phase": 1.0}, {"phase": -0.1}, {"levels": 0}]
)
def test_quantisers_that_cannot_be(options: dict[str, float]) -> None:
    with pytest.raises(UsageError):
        linear_response(**{"bits": 8, **options})  # type: ignore[arg-type]


def write_model(path: Path) -> None:
    def block(values: np.ndarray) -> str:
        return "\n".join(" ".join(f"{v:.6e}" for v in row) for row in values.reshape(-1, 4))

    bump = np.sin(np.pi * RAMP)
    path.write_text(
        f"E = \n{block(RAMP)}\nf0 = \n{block(RAMP**0.45)}\n"
        f"h(1)=\n{block(0.1 * bump)}\nh(2)=\n{block(0.05 * np.sin(2 * np.pi * RAMP))}\n"
    )


def test_the_empirical_model_of_response(tmp_path: Path) -> None:
    write_model(tmp_path / "model.txt")
    model = read_response_model(tmp_path / "model.txt")
    assert model.components.shape == (2, 1024)
    mean = model.response()
    brighter = model.response([1.0])
    assert mean.levels[127] == pytest.approx(0.5 ** (1 / 0.45), rel=1e-3)
    assert brighter.levels[127] < mean.levels[127]
    with pytest.raises(UsageError, match="the model has 2 components"):
        model.response([1, 1, 1])
    with pytest.raises(DataError, match="falls with irradiance"):
        model.response([-60.0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("f0 = 0 1\n", "no block 'E ='"),
        ("E = 0 1\nf0 = 0 0.5 1\n", "'f0' has 3 numbers, not 2"),
        ("E = 0 1\nf0 = 0 x\n", "line 2"),
        ("0 1\n", "before a heading"),
    ],
)
def test_damaged_models(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "model.txt").write_text(text)
    with pytest.raises(DataError, match=words):
        read_response_model(tmp_path / "model.txt")


@pytest.mark.parametrize(
    ("name", "dynamic_range", "words"),
    [
        ("lgo", 100.0, "did you mean log"),
        ("log", 1.0, "must be above 1"),
        ("log", 0.5, "must be above 1"),
        ("log", float("nan"), "must be above 1"),
        ("log", float("inf"), "finite range"),
        ("log", "mediun", "did you mean medium"),
    ],
)
def test_desired_responses_that_cannot_be(
    name: str, dynamic_range: float | str, words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        desired_response(name, dynamic_range)


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
@pytest.mark.parametrize("dynamic_range", [1.001, 256.0, 1e7])
def test_desired_responses_and_their_inverse(name: str, dynamic_range: float) -> None:
    desired = desired_response(name, dynamic_range)
    u = np.linspace(0, 1, 101)
    np.testing.assert_allclose(desired.u(desired.inverse(u)), u, atol=1e-12)
    assert desired.u([desired.e_min, 1.0]).tolist() == pytest.approx([0, 1], abs=1e-12)
    assert desired.u([0.0, 5.0]).tolist() == pytest.approx([0, 1], abs=1e-12)


def test_a_table_inverts_across_flat_runs() -> None:
    table = tabulated_desired([0.1, 0.2, 0.4, 1.0], [0, 0.5, 0.5, 1])
    assert table.inverse([0.0, 0.25, 0.5, 0.75, 1.0]).tolist() == pytest.approx(
        [0.1, 0.15, 0.2, 0.7, 1.0]
    )


@pytest.mark.parametrize(
    ("E", "u", "words"),
    [
        ([0.1], [0.0], "two or more"),
        ([0.1, 1.0], [0.0, float("nan")], "not finite"),
        ([0.0, 1.0], [0.0, 1.0], "positive and increase"),
        ([0.5, 0.5], [0.0, 1.0], "positive and increase"),
        ([0.1, 0.5, 1.0], [0.0, 0.6, 0.5], "must not decrease"),
        ([0.1, 1.0], [0.5, 0.5], "rise somewhere"),
    ],
)
def test_desired_tables_that_cannot_be(E: list[float], u: list[float], words: str) -> None:
    with pytest.raises(DataError, match=words):
        tabulated_desired(E, u)


@pytest.mark.parametrize("name", ["linear", "gamma", "log"])
def test_a_dozen_measured_curves_are_solved(tmp_path: Path, real_data: Path, name: str) -> None:
    """Curves of the published model, by way of two-column files of 1,024 samples."""
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
        found = solve(camera, desired, 3, effort=0.1)
        doubling = xi(EffectiveCamera.of(camera, (1, 2, 4)), desired, 765)
        assert found.xi < doubling
