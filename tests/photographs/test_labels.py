"""Exposures that photographs state, against their pixels, by a known response."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.evidence.patches import Patches, sample_patches
from camctl.findings import Finding
from camctl.interface.controls import Layout
from camctl.model.response.camera import standard_response
from camctl.model.sensor import SensorModel
from camctl.photographs.camera import Photograph
from camctl.photographs.labels import check_reversed, doubted_labels, wrong_labels
from camctl.photographs.ratios import RatiosToDarker

TRUE_S = tuple(2.0**k for k in range(-6, -1))
SCALE = SensorModel(standard_response("power", 8, phase=0.5), 0)


def photographs() -> list[Patches]:
    """Return patches of photographs of a smooth scene, with offsets as JPEG files have them."""
    rng = np.random.default_rng(3)
    light = np.geomspace(0.02, 4, 240)[:, np.newaxis] * rng.uniform(0.7, 1.4, (240, 320))
    found = []
    for k, time_s in enumerate(TRUE_S):
        codes = 255 * np.clip(light * time_s * 4, 0, 1) ** (1 / 2.2)
        noisy = codes + rng.normal(0, 1, light.shape) + (3, -2, 0, 2, -1)[k]
        found.append(sample_patches([np.clip(np.rint(noisy), 0, 255).astype(np.uint8)], 255))
    return found


PATCHES = photographs()


def found(labels: tuple[float, ...], iso: tuple[float, ...] = (100.0,) * 5) -> list[Finding]:
    stated = [
        Photograph(f"p{k}", label, each / 100, iso=each)
        for k, (label, each) in enumerate(zip(labels, iso, strict=True))
    ]
    return wrong_labels(
        stated, RatiosToDarker.of(PATCHES, SCALE), is_exact=False, is_known=True
    ).notes


def test_right_labels_are_not_accused_whatever_offset_a_dark_photograph_has() -> None:
    assert found(TRUE_S) == []


@pytest.mark.parametrize("place", range(5))
@pytest.mark.parametrize("factor", [1.5, 8.0, 1 / 1.5, 1 / 8])
def test_a_wrong_label_is_named_with_its_factor(place: int, factor: float) -> None:
    labels = tuple(each * (factor if k == place else 1) for k, each in enumerate(TRUE_S))
    (wrong,) = found(labels)
    assert (wrong.code, wrong.frames) == ("label_wrong", (place,))
    # Three levels of offset are 15 % of the light in the darkest photograph.
    assert wrong.value == pytest.approx(1 / factor, rel=0.16)


def test_where_the_response_is_not_known_no_label_is_checked() -> None:
    levels = standard_response("power", 8, phase=0.5)
    scale = SensorModel(replace(levels, deviation=np.full(levels.M, np.inf)), 0)
    stated = [Photograph(f"p{k}", each, each / 100) for k, each in enumerate(TRUE_S[::-1])]
    errors = wrong_labels(stated, RatiosToDarker.of(PATCHES, scale), is_exact=False, is_known=False)
    assert errors.notes == []
    assert [each.frames for each in errors.facts] == [(0, 1, 2, 3, 4)]


def test_swapped_labels_are_named_together_with_another_wrong_one() -> None:
    labels = (TRUE_S[1], TRUE_S[0], *TRUE_S[2:])
    (swapped,) = found(labels)
    assert (swapped.code, swapped.frames) == ("labels_swapped", (0, 1))


def test_an_iso_speed_that_explains_a_wrong_exposure_is_named() -> None:
    (wrong,) = found(TRUE_S, (100.0, 400.0, 100.0, 100.0, 100.0))
    assert (wrong.details["iso"], wrong.details["iso_of_others"]) == (400, 100)
    (other,) = found((TRUE_S[0], TRUE_S[1] * 2, *TRUE_S[2:]))
    assert "iso" not in other.details


def test_exposures_in_reverse_order_are_refused() -> None:
    stated = [Photograph(f"p{k}", label) for k, label in enumerate(TRUE_S[::-1])]
    with pytest.raises(DataError, match="in the reverse order"):
        check_reversed(stated, PATCHES, 255)


def test_photographs_that_are_all_dark_do_not_hide_the_reverse_order() -> None:
    dark = [np.full_like(PATCHES[0], level) for level in (0, 1)]  # by their offsets alone
    stated = [Photograph(f"p{k}", 2.0**-k) for k in range(7)]
    with pytest.raises(DataError, match="in the reverse order"):
        check_reversed(stated, [*dark, *PATCHES], 255)
    check_reversed(stated, [*PATCHES[::-1], *dark], 255)


def test_steps_between_labels_are_right_where_most_of_the_labels_are_not() -> None:
    """Of a bracket of nine the longest time of the camera was reached, and the labels went on."""
    true = np.array([1, 2, 4, 4, 4, 4, 4, 8, 16]) / 64
    stated = 2.0 ** np.arange(9)[[0, 1, 2, 6, 5, 3, 4, 7, 8]]
    rng = np.random.default_rng(5)
    light = np.geomspace(0.02, 4, 240)[:, np.newaxis] * rng.uniform(0.7, 1.4, (240, 320))
    series = Series(Layout.MONO, 8)
    for k, time_s in enumerate(true.tolist()):
        codes = 255 * np.clip(light * time_s * 4, 0, 1) ** (1 / 2.2) + rng.normal(0, 1, light.shape)
        series.add(np.clip(np.rint(codes), 0, 255).astype(np.uint8), float(stated[k]), f"p{k}")
    right = stated * [doubted_labels(series).get(k, 1.0) for k in range(9)]
    steps = np.diff(np.log(right)) - np.diff(np.log(true))
    assert np.abs(steps).max() < 0.1
