"""What is found wrong with photographs of one scene, from labels to white balance."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bracketed_photographs import FEW, TIMES, film, light, photograph, save
from numpy.typing import NDArray
from sampling import some

from camctl import CaptureRequest, DataError, PhotographOptions
from camctl.findings import Finding
from camctl.model.response.camera import srgb_to_linear
from camctl.photographs.merge import plan_merge
from camctl.photographs.photograph_set import open_photographs

from .conftest import Opened


def codes(findings: tuple[Finding, ...]) -> list[str]:
    return [each.code for each in findings]


def slow(*cases: tuple[Any, ...]) -> list[Any]:
    """Return cases that are like others, for the slow tests."""
    return [pytest.param(*case, marks=pytest.mark.slow) for case in cases]


def test_shutters_that_are_not_exact_are_corrected_from_the_pixels(opened: Opened) -> None:
    times = TIMES[1:7]
    found = opened(times, labels=[each * (1.12 if k == 3 else 1) for k, each in enumerate(times)])
    assert found.camera.photographs[3].time_s == pytest.approx(times[3], rel=0.01)
    (corrected,) = [each for each in found.facts if each.code == "exposure_corrected"]
    assert corrected.frames == (3,)
    assert corrected.value == pytest.approx(1 / 1.12, rel=0.01)
    assert found.notes == ()


def test_reversed_labels_are_named(opened: Opened) -> None:
    with pytest.raises(DataError, match="are in the reverse order"):
        opened(FEW, labels=FEW[::-1])


def test_one_wrong_label_is_named(opened: Opened) -> None:
    times, place = TIMES[1:7], 4
    labels = [each * (1.7 if k == place else 1) for k, each in enumerate(times)]
    found = opened(times, labels=labels)
    (wrong,) = found.notes
    assert (wrong.code, wrong.frames) == ("label_wrong", (place,))
    assert wrong.value == pytest.approx(1 / 1.7, rel=0.05)
    assert wrong.details["stated_s"] == pytest.approx(labels[place])
    assert wrong.details["left_out"] is False
    assert wrong.remedies == {"times": None}
    assert found.camera.photographs[place].time_s == pytest.approx(times[place], rel=0.05)


def test_an_exact_label_that_is_wrong_is_left_out(opened: Opened) -> None:
    labels = [each * (1.7 if k == 2 else 1) for k, each in enumerate(TIMES[2:8])]
    found = opened(TIMES[2:8], labels=labels, options={"labels": "exact"})
    (wrong,) = found.notes
    assert (wrong.code, wrong.frames, wrong.details["left_out"]) == ("label_wrong", (2,), True)
    assert "p02.png" not in [each.name for each in found.camera.photographs]
    assert len(found.camera.photographs) == 5


@pytest.mark.slow
@pytest.mark.parametrize(("place", "factor"), [(0, 1.6), *slow((3, 0.6))])
def test_one_wrong_label_does_not_bend_the_response(
    opened: Opened, place: int, factor: float
) -> None:
    times = TIMES[1:7]
    labels = [each * (factor if k == place else 1) for k, each in enumerate(times)]
    found = opened(times, labels=labels, curve=None, change=lambda _, pixels: film(pixels))
    assert found.response.startswith("estimated from the photographs")
    (wrong,) = found.notes
    assert (wrong.code, wrong.frames) == ("label_wrong", (place,))
    assert wrong.details["pixels_s"] == pytest.approx(times[place], rel=0.1)


@pytest.mark.parametrize(
    ("place", "factor", "curve"),
    [(0, 0.5, "srgb"), *slow((0, 4.0, None), (2, 0.5, None), (5, 2, "srgb"))],
)
def test_a_wrong_label_is_named_where_photographs_are_nearly_black(
    opened: Opened, place: int, factor: float, curve: str | None
) -> None:
    times = tuple(2.0 ** (2 * k - 14) for k in range(6))
    labels = [each * (factor if k == place else 1) for k, each in enumerate(times)]
    change = lambda _, pixels: pixels if curve else film(pixels)  # noqa: E731
    found = opened(times, labels=labels, curve=curve, change=change)
    (wrong,) = found.notes
    assert (wrong.code, wrong.frames) == ("label_wrong", (place,))
    assert found.camera.photographs[place].time_s == pytest.approx(times[place], rel=0.1)


@pytest.mark.slow
def test_all_wrong_labels_are_named_also_those_that_turn_the_order(opened: Opened) -> None:
    labels = list(TIMES[1:9])
    labels[1] *= 5
    labels[6] /= 3
    found = opened(TIMES[1:9], labels=labels, curve=None, change=lambda _, pixels: film(pixels))
    assert {(each.code, each.frames) for each in found.notes} == {
        ("label_wrong", (1,)),
        ("label_wrong", (6,)),
    }
    assert len(found.camera.photographs) == 8


def steep(pixels: NDArray[Any]) -> NDArray[Any]:
    """Return photographs of a camera whose range is 1:6, of sRGB ones."""
    linear = srgb_to_linear(np.arange(256) / 255)
    table = np.clip(1 + np.log(np.maximum(linear, 1e-3)) / np.log(6), 0, 1)
    return np.asarray(np.rint(255 * table).astype(np.uint8)[pixels])


def test_histograms_choose_the_response_where_no_patch_is_in_two_photographs(
    opened: Opened,
) -> None:
    """With nothing compared all explain the same: one that is wrong by e^2 was said to fit."""
    change = lambda _, pixels: steep(pixels)  # noqa: E731
    found = opened(
        FEW, curve=None, options={"labels": "exact"}, change=change, scene=light(480, 640)
    )
    assert found.response.startswith("estimated from the photographs")
    levels = found.camera.controls.levels.levels
    places = np.linspace(0.1, 0.9, 9)
    errors = np.log(levels[np.rint(places * 254).astype(int)]) - (places - 1) * np.log(6)
    assert np.std(errors) < 0.1


def test_numbers_are_exact_and_fractions_are_labels_of_a_dial(opened: Opened) -> None:
    times = tuple(0.002 * 10**k for k in range(3))
    exact = opened(times, options={"labels": "auto"})
    assert tuple(each.time_s for each in exact.camera.photographs) == times
    labels = (Fraction(1, 500), Fraction(1, 50), Fraction(1, 5))
    dial = opened(times, labels=labels, options={"labels": "auto"})
    assert [each.code for each in dial.facts if each.code == "label_unit"] == ["label_unit"]


def test_times_are_estimated_from_the_pixels_where_that_is_asked_for(opened: Opened) -> None:
    labels = [
        each * factor
        for each, factor in zip(TIMES, (1, 3, 0.3, 1, 2, 1, 0.5, 1, 4, 1, 1), strict=True)
    ]
    found = opened(TIMES, labels=labels, options={"labels": "pixels"})
    assert found.notes == ()
    used = np.array([each.time_s for each in found.camera.photographs])
    assert np.ptp(np.log(used / TIMES)) < 0.05


def test_three_photographs_without_a_response_do_not_show_which_label_is_wrong(
    opened: Opened,
) -> None:
    labels = [TIMES[2], TIMES[3] * 1.8, TIMES[4]]
    found = opened(TIMES[2:5], labels=labels, curve=None, change=lambda _, each: film(each))
    assert set(codes(found.notes)) == {"labels_contradict"}
    assert {each.details["why"] for each in found.notes} == {"response"}
    assert all(each.remedies == {"curve": None} for each in found.notes)


@pytest.mark.parametrize("labels", some(["exact", "auto"], every=2))
def test_where_most_exposures_contradict_the_pixels_decide(opened: Opened, labels: str) -> None:
    """As where a camera was asked for longer times than it has, and did not say so."""
    times = tuple(0.001 * 2.0**k for k in range(8))
    shown = (*times[:3], *(times[2] * factor for factor in (1.08, 1.02, 1.12, 1.05, 1.15)))
    found = opened(
        shown, labels=[Fraction(2**k, 1024) for k in range(8)], options={"labels": labels}
    )
    assert set(codes(found.notes)) == {"labels_contradict"}
    assert {each.details["why"] for each in found.notes} == {"tie"}
    assert all(each.remedies == {"times": None, "labels": "pixels"} for each in found.notes)
    assert found.positions == tuple(range(8))
    used = np.array([each.time_s for each in found.camera.photographs])
    assert np.ptp(np.log(used / np.array(shown))) < 0.1


def test_a_response_that_is_assumed_makes_no_exposure_wrong(opened: Opened) -> None:
    times = (TIMES[0], TIMES[2], TIMES[4])

    def flat(_: int, pixels: NDArray[Any]) -> NDArray[Any]:  # up to half of full scale
        return np.asarray(120 * np.sqrt(pixels / 255), np.uint8)

    found = opened(times, curve=None, change=flat, options={"white": 255, "black": 0})
    unknown, contradicting = found.notes
    assert (unknown.code, unknown.remedies) == ("response_unknown", {"curve": None})
    assert (contradicting.code, contradicting.value) == ("labels_contradict", None)
    assert "curve" in contradicting.remedies
    used = [each.time_s for each in found.camera.photographs]
    assert used == pytest.approx(times, rel=0.01)


def test_a_few_photographs_without_a_response_are_taken_for_srgb(opened: Opened) -> None:
    assert "response_unknown" in codes(opened((TIMES[0], TIMES[-1]), curve=None).notes)


def test_light_that_changed_is_no_wrong_label(opened: Opened) -> None:
    labels = [each * (2.5 if k > 3 else 1) for k, each in enumerate(TIMES[1:7])]
    (differs,) = opened(TIMES[1:7], labels=labels).notes
    assert (differs.code, differs.frames) == ("light_differs", (4, 5))
    assert differs.value == pytest.approx(0.4, rel=0.05)


def test_a_shifted_photograph_is_left_out(opened: Opened) -> None:
    def shift(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.roll(pixels, (5, -7), axis=(0, 1)) if k == 4 else pixels

    found = opened(TIMES[1:7], suffix=".jpg", change=shift, options={"align": "none"})
    (shifted,) = found.notes
    assert (shifted.code, shifted.frames) == ("shifted", (4,))
    assert (shifted.details["columns"], shifted.details["rows"]) == (-7, 5)
    assert shifted.details["left_out"] is True
    assert "p04.jpg" not in [each.name for each in found.camera.photographs]


def test_photographs_of_which_each_is_shifted_are_all_used(opened: Opened) -> None:
    def shift(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.roll(pixels, (3 * k, 2 * k), axis=(0, 1))

    found = opened(TIMES[2:6], change=shift, options={"align": "none"})
    assert found.notes == ()
    assert list(found.displaced) == [1, 2, 3]
    assert {each.details["other"] for each in found.displaced.values()} == {"p00.png"}
    assert len(found.camera.photographs) == 4


def test_two_photographs_of_different_things_are_named(opened: Opened) -> None:
    found = opened(TIMES[4:6], change=lambda k, pixels: pixels[:, ::-1] if k else pixels)
    other = found.notes[0]
    assert (other.code, other.frames) == ("other_view", (0, 1))
    assert "left_out" not in other.details


LARGE = light(180, 240)
"""Differences of colours need more samples than others."""

Colours = list[tuple[float, float]]


def with_colours(times: tuple[float, ...], colours: Colours, curve: str | None) -> Any:
    """Open photographs whose red and blue are these times those of the scene."""
    files = [
        save(Path(f"p{k}.png"), photograph(time_s, LARGE * np.array([red, 1.0, blue])))
        for k, (time_s, (red, blue)) in enumerate(zip(times, colours, strict=True))
    ]
    return open_photographs(files, PhotographOptions(times=times, curve=curve))


@pytest.mark.usefixtures("opened")
class TestWhiteBalance:
    @pytest.mark.parametrize(
        ("place", "curve"), [(3, None), *slow((1, "srgb"), (3, "srgb"), (1, None))]
    )
    def test_another_one_is_left_out(self, place: int, curve: str | None) -> None:
        colours = [(1.15, 0.9) if k == place else (1.0, 1.0) for k in range(5)]
        found = with_colours(TIMES[1:6], colours, curve)
        (other,) = found.notes
        assert (other.code, other.frames) == ("other_white_balance", (place,))
        assert other.details["red"] == pytest.approx(1.15, abs=0.005)
        assert other.details["blue"] == pytest.approx(0.9, abs=0.005)
        assert len(found.camera.photographs) == 4

    @pytest.mark.slow
    def test_another_one_of_the_darkest_photograph_is_named(self) -> None:
        """JPEG hides small differences in it, and not this one."""
        (other,) = with_colours(TIMES[:8:2], [(1.4, 1), (1, 1), (1, 1), (1, 1)], "srgb").notes
        assert (other.code, other.frames) == ("other_white_balance", (0,))
        assert {"red", "blue"} & other.details.keys() == {"red"}

    @pytest.mark.parametrize("place", range(3))
    def test_five_percent_show_in_linear_files_of_16_bits(self, place: int) -> None:
        """JPEG files hide 12 %: their photographs have offsets, and others have none."""
        times, rng = (2.0**-9, 2.0**-7, 2.0**-5), np.random.default_rng(0)
        files = []
        for k, time_s in enumerate(times):
            E = LARGE * time_s * np.array([1.05 if k == place else 1.0, 1.0, 1.0])
            E += np.sqrt(E / 8000) * rng.normal(size=E.shape)
            codes = np.rint(np.clip(65535 * E, 0, 65535)).astype(np.uint16)
            files.append(save(Path(f"p{k}.tif"), codes))
        found = open_photographs(files, PhotographOptions(times=times, curve="linear"))
        (other,) = found.notes
        assert (other.code, other.frames) == ("other_white_balance", (place,))
        assert other.details["red"] == pytest.approx(1.05, abs=0.005)

    def test_one_that_changes_halfway_is_named(self) -> None:
        found = with_colours(TIMES[2:6], [(1, 1), (1, 1), (1.2, 1), (1.2, 1)], "srgb")
        (other,) = found.notes
        assert (other.code, other.frames) == ("other_white_balance", (0, 3))
        assert other.value == pytest.approx(1.2, abs=0.005)
        assert other.details["other"] == "p3.png"
        assert len(found.camera.photographs) == 4


def test_copies_are_left_out_or_refused(opened: Opened) -> None:
    opened(times := TIMES[2:6])
    Path("copy.png").write_bytes(Path("p02.png").read_bytes())
    files = [*(Path(f"p{k:02d}.png") for k in range(4)), Path("copy.png")]
    known = PhotographOptions(times=(*times, times[2]), curve="srgb")
    found = open_photographs(files, known)
    assert [(each.code, each.frames) for each in found.notes] == [("copy", (4, 2))]
    assert len(found.camera.photographs) == 4
    known_again = replace(known, times=(*times[:2], times[2], *times[2:]))
    # In a merge frames are the frames of its picture; the copy is none of them.
    merged = plan_merge([*files[:2], files[4], *files[2:4]], CaptureRequest(count=3), known_again)
    (copy,) = [each for each in merged.notes if each.code == "copy"]
    used = [each["file"] for each in merged.photographs if each["used"]]
    assert copy.details["file"] == "p02.png"
    assert [used[k] for k in copy.frames] == ["copy.png"]
    with pytest.raises(DataError, match=r"^p02.png and copy.png are the same photograph, but"):
        open_photographs(files, PhotographOptions(times=(*times, 2.0), curve="srgb"))


def test_photographs_of_one_colour_are_left_out(opened: Opened) -> None:
    def white(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return np.full_like(pixels, 255) if k >= 4 else pixels

    found = opened(TIMES[2:8], change=white)
    assert [(each.code, each.frames) for each in found.notes] == [("empty", (4,)), ("empty", (5,))]
    assert len(found.camera.photographs) == 4


@pytest.mark.parametrize(
    ("levels", "message"),
    [
        (
            (40, 255),
            "0 of 2 photographs can be merged: p00.png is one colour everywhere, p01.png is",
        ),
        ((None, 255), "1 of 2 photographs can be merged: p01.png is one colour everywhere;"),
        ((0, 10, 20, 30, 40), r"p02.png is one colour everywhere, and 2 others are such;"),
    ],
)
def test_what_is_left_out_is_named_where_too_few_remain(
    opened: Opened, levels: tuple[int | None, ...], message: str
) -> None:
    def even(k: int, pixels: NDArray[Any]) -> NDArray[Any]:
        return pixels if levels[k] is None else np.full_like(pixels, levels[k])

    with pytest.raises(DataError, match=message):
        opened(TIMES[2 : 2 + len(levels)], change=even)


def test_a_photograph_and_its_copy_are_one(opened: Opened) -> None:
    opened(TIMES[:2])
    Path("copy.png").write_bytes(Path("p00.png").read_bytes())
    with pytest.raises(DataError, match=r"1 of 2 .*: copy.png is the same photograph as p00.png;"):
        open_photographs(
            [Path("p00.png"), Path("copy.png")],
            PhotographOptions(times=(TIMES[0], TIMES[0]), curve="srgb"),
        )


def test_different_sizes_and_formats_are_named(opened: Opened) -> None:
    opened(TIMES[:3])
    files = [Path(f"p{k:02d}.png") for k in range(3)]
    save(files[1], photograph(TIMES[1])[:-10])
    with pytest.raises(DataError, match=r"^p01.png has 160 x 110 pixels and p00.png has 160"):
        open_photographs(files, PhotographOptions(times=TIMES[:3]))
    save(files[1], photograph(TIMES[1])[..., 1])
    with pytest.raises(DataError, match=r"p01.png is mono, 8 bits"):
        open_photographs(files, PhotographOptions(times=TIMES[:3]))
