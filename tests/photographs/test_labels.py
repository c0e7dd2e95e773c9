"""Which exposures of photographs are doubted before the response is known."""

from __future__ import annotations

import numpy as np
import pytest

from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.interface.controls import Layout
from camctl.photographs.camera import Photograph
from camctl.photographs.labels import check_doubted

TRUE_S = (1 / 32, 1 / 16, 1 / 8, 1 / 4)


def series(labels: tuple[float, ...]) -> Series:
    """Return four photographs of a smooth scene with these exposures."""
    rng = np.random.default_rng(3)
    light = np.geomspace(0.02, 4, 240)[:, np.newaxis] * rng.uniform(0.7, 1.4, (240, 320))
    found = Series(Layout.MONO, 8, 0, 255, phase=0.5, levels_are_stated=True)
    for k, (time_s, label) in enumerate(zip(TRUE_S, labels, strict=True)):
        codes = 255 * np.clip(light * time_s * 4, 0, 1) ** (1 / 2.2)
        noisy = np.clip(np.rint(codes + rng.normal(0, 1, light.shape)), 0, 255)
        found.add(noisy.astype(np.uint8), label, f"p{k}")
    return found


def checked(
    labels: tuple[float, ...], doubted: dict[int, float], iso: tuple[float, ...] = (100.0,) * 4
) -> str:
    photographs = [
        Photograph(f"p{k}", label, each / 100, iso=each)
        for k, (label, each) in enumerate(zip(labels, iso, strict=True))
    ]
    with pytest.raises(DataError) as raised:
        check_doubted(photographs, doubted, series(labels))
    return raised.value.what


def test_one_of_two_swapped_labels_is_doubted_and_both_are_named() -> None:
    labels = (TRUE_S[1], TRUE_S[0], *TRUE_S[2:])
    assert checked(labels, {1: 3.0}).startswith("the exposures of p1 and p0 are swapped")


def test_a_wrong_label_is_not_called_swapped() -> None:
    labels = (TRUE_S[0], TRUE_S[0] / 2.5, *TRUE_S[2:])
    assert checked(labels, {1: 5.0}).startswith("the exposure of p1 is wrong")


def test_an_iso_speed_that_explains_a_wrong_exposure_is_named() -> None:
    what = checked(TRUE_S, {1: 0.25}, (100.0, 400.0, 100.0, 100.0))
    assert what.endswith(", as with ISO 100, which the others state, in place of its ISO 400")
    assert "ISO" not in checked(TRUE_S, {1: 0.5}, (100.0, 400.0, 100.0, 100.0))
