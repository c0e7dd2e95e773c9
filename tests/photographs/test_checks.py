"""What is found on the pixels of photographs before they are merged."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

from camctl.findings import Finding
from camctl.model.response.camera import standard_response
from camctl.photographs.alignment import Sight, chains_of, misaligned
from camctl.photographs.camera import Photograph, with_all_stated

Light = NDArray[np.float32]


def misplaced(sights: list[Sight]) -> dict[int, Finding]:
    return misaligned(sights, chains_of(sights))


def test_a_shift_is_that_of_the_whole_picture_where_tiles_have_lines_of_one_direction() -> None:
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    rng = np.random.default_rng(1)
    across, down = (
        np.convolve(rng.normal(0, 50, length + 4), np.full(5, 0.2), "valid")
        for length in (480, 360)
    )
    scene = np.full((360, 480), 110.0) + across
    scene[:, 320:] = 110 + down[:, np.newaxis]
    photographs = [Photograph("a", 1.0), Photograph("b", 1.25)]
    sights = []
    for photograph, shift in zip(photographs, ((0, 0), (5, 9)), strict=True):
        light = np.roll(scene, shift, (0, 1)) * photograph.time_s
        noisy = np.clip(np.rint(light + rng.normal(0, 2, scene.shape)), 0, 255)
        sights.append(Sight.of(photograph, noisy.astype(np.uint8), 255))
    (found,) = misplaced(sights).values()
    assert found.frames == (1,)
    assert found.details == {"other": "a", "columns": 9, "rows": 5}
    assert found.value == pytest.approx(np.hypot(9, 5), abs=0.2)


def test_what_only_some_photographs_state_is_assumed_and_named() -> None:
    alike = [Photograph("a", 1.0, 2.0, 8.0, iso=200.0), Photograph("b", 2.0, 2.0, 8.0, iso=200.0)]
    assert with_all_stated(alike) == (alike, [])
    silent = [Photograph("a", 1.0), Photograph("b", 2.0)]
    assert with_all_stated(silent) == (silent, [])
    found, notes = with_all_stated(
        [*alike, Photograph("c", 4.0), Photograph("d", 8.0, 2.0, iso=200.0)]
    )
    assert {each.code for each in notes} == {"tags_differ"}
    assert [(each.details["what"], each.frames, each.value) for each in notes] == [
        ("ISO", (2,), 200),
        ("f-number", (2, 3), 8),
    ]
    assert [(each.gain, each.f_number, each.iso) for each in found] == [(2.0, 8.0, 200.0)] * 4


def test_what_others_state_differently_is_not_taken_from_them() -> None:
    others = [Photograph("a", 1.0, 1.0, 8.0, iso=100.0), Photograph("b", 1.0, 4.0, 4.0, iso=400.0)]
    found, notes = with_all_stated([*others, Photograph("c", 1.0)])
    assert [(each.details["what"], each.value) for each in notes] == [("ISO", 100), ("f-number", 1)]
    assert (found[2].gain, found[2].f_number) == (1.0, 1.0)


def bracket(shifted: int | None, columns: int = 9) -> list[Sight]:
    """Return a bracket of a scene with few lights, in which noise hides most of the rest."""
    rng = np.random.default_rng(2)
    scene = np.exp(rng.normal(0, 1, (45, 60)).repeat(8, 0).repeat(8, 1)) * 8
    sights = []
    for k, time_s in enumerate((1.0, 2.0, 4.0, 8.0)):
        light = np.roll(scene, columns, 1) if k == shifted else scene
        noisy = np.clip(np.rint(light * time_s / 4 + 13 + rng.normal(0, 2, scene.shape)), 0, 255)
        sights.append(Sight.of(Photograph(f"p{k}", time_s), noisy.astype(np.uint8), 255))
    return sights


@pytest.mark.parametrize("shifted", some([0, 1, 2, 3], every=2))
def test_the_photograph_that_is_not_where_the_others_are_is_named(shifted: int) -> None:
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    (found,) = misplaced(bracket(shifted)).values()
    assert found.code == "shifted"
    assert (found.frames, found.details["columns"]) == ((shifted,), 9)


def test_noise_is_no_shift() -> None:
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    assert misplaced(bracket(None)) == {}


def smooth_bracket(
    change: Callable[[int, Light], Light], step: float = 4.0, quality: int = 92
) -> list[Sight]:
    """Return JPEG photographs of a smooth scene, `step` apart, each changed before it is taken."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
    rng = np.random.default_rng(3)
    coarse = rng.normal(0, 1.5, (9, 12)).astype(np.float32)
    scene = np.exp(cv2.resize(coarse, (560, 440), interpolation=cv2.INTER_CUBIC))
    response = standard_response("srgb", 8).levels
    sights = []
    for k in range(4):
        light = change(k, scene)[60:-60, 60:-60] * 0.02 * step**k
        noisy = light + np.sqrt(light / 3000) * rng.normal(size=light.shape)
        pixels = np.searchsorted(response, noisy, side="right").astype(np.uint8)
        data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        decoded = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        sights.append(Sight.of(Photograph(f"p{k}", step**k), decoded, 255))
    return sights


SHIFTS = ((9, 0), (0, -3), (-2, 2), (40, -57))


@pytest.mark.parametrize(
    ("shifted", "columns", "rows"),
    [
        # By default two of the photographs, each by one of the shifts.
        pytest.param(k, *shift, marks=() if k == place and k % 2 else pytest.mark.slow)
        for k in range(4)
        for place, shift in enumerate(SHIFTS)
    ],
)
def test_a_shift_of_a_smooth_photograph_is_named(shifted: int, columns: int, rows: int) -> None:
    def shift(k: int, scene: Light) -> Light:
        return np.roll(scene, (rows, columns), (0, 1)) if k == shifted else scene

    (found,) = misplaced(smooth_bracket(shift)).values()
    assert (found.code, found.frames) == ("shifted", (shifted,))
    assert found.details.keys() == {"other", "columns", "rows"}
    place = found.details["columns"], found.details["rows"]
    assert place == pytest.approx((columns, rows), abs=1)


@pytest.mark.parametrize(
    ("degrees", "zoom", "what", "value"),
    some(
        [
            (0.5, 1.0, "degrees", 0.5),
            (-1.0, 1.0, "degrees", -1.0),
            (0.0, 1.01, "percent", 1.0),
            (0.0, 0.98, "percent", -2.0),
        ],
        every=4,
    ),
)
def test_a_turned_or_enlarged_photograph_is_named(
    degrees: float, zoom: float, what: str, value: float
) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")

    def change(k: int, scene: Light) -> Light:
        if k != 2:
            return scene
        middle = (scene.shape[1] - 1) / 2, (scene.shape[0] - 1) / 2
        matrix = cv2.getRotationMatrix2D(middle, -degrees, zoom)  # positive is anticlockwise there
        return np.asarray(cv2.warpAffine(scene, matrix, scene.shape[::-1]))

    (found,) = misplaced(smooth_bracket(change)).values()
    assert (found.frames, found.details["other"]) == ((2,), "p1")
    assert found.details[what] == pytest.approx(value, abs=0.05)
    assert found.details.keys().isdisjoint({"degrees", "percent"} - {what})


def test_a_thing_that_moves_is_no_shift() -> None:
    def move(k: int, scene: Light) -> Light:
        changed = scene.copy()
        left = 100 + 50 * k
        changed[150:290, left : left + 140] = 0.3
        changed[180:260, left + 30 : left + 110] = 2.0
        return changed

    assert misplaced(smooth_bracket(move)) == {}


def test_the_neighbours_of_a_turned_photograph_are_not_turned() -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")

    def change(k: int, scene: Light) -> Light:
        middle = (scene.shape[1] - 1) / 2, (scene.shape[0] - 1) / 2
        matrix = cv2.getRotationMatrix2D(middle, -5.0, 1.0)
        return np.asarray(cv2.warpAffine(scene, matrix, scene.shape[::-1])) if k == 1 else scene

    assert list(misplaced(smooth_bracket(change))) == [1]
