"""Places where things moved, shown as one of the frames shows them, beside the true light."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.pictures.ghosts.labels import LabelField, least_error_labels
from camctl.pictures.render import CONTRADICTING
from camctl.records.report import CaptureReport

EXPOSURES = (1 / 256, 1 / 64, 1 / 16, 1 / 4, 1.0)
ROWS, COLUMNS = 240, 320
#: Electrons at full scale.
FULL_E = 20_000
Light = NDArray[np.float64]


def srgb(light: Light) -> Light:
    """Return the encoding of sRGB."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


@dataclass(frozen=True)
class MovingScene:
    """A scene in which a bright ball, a dark box and a striped bar move, at each frame.

    Attributes:
        frames: uint8 (rows, columns, 3)
        truth: light at the time of each frame
        areas: where each of the things was at any time
    """

    frames: list[NDArray[np.uint8]]
    truth: list[Light]
    areas: list[NDArray[np.bool_]]

    @property
    def moved(self) -> NDArray[np.bool_]:
        return np.asarray(np.any(self.areas, axis=0))

    def error(self, light: NDArray[Any]) -> float:
        """Return the median error of ln light where things moved.

        Each thing may be where it was at the time of any frame, the same one everywhere.
        """
        logarithm = np.log(np.maximum(light, 1e-9))
        errors = []
        for area in self.areas:
            at = [np.abs(logarithm - np.log(each))[area] for each in self.truth]
            errors.append(min(at, key=lambda each: float(np.mean(each))).ravel())
        return float(np.median(np.concatenate(errors)))


def moving_scene(seed: int = 0) -> MovingScene:
    """Return photographs of a scene of 1:4000, from the shortest on."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:ROWS, :COLUMNS]
    texture = random.normal(0, 1, (ROWS, COLUMNS, 3))
    for width in (3, 9):
        texture += cv2.GaussianBlur(random.normal(0, width, (ROWS, COLUMNS, 3)), (0, 0), width)
    still = np.exp(np.log(0.01) + 5 * x[..., np.newaxis] / COLUMNS + 0.08 * texture)
    frames, truth = [], []
    areas = [np.zeros((ROWS, COLUMNS), np.bool_) for _ in range(3)]
    for place, exposure in enumerate(EXPOSURES):
        light = still.copy()
        ball = (x - 60 - 9 * place) ** 2 + (y - 60) ** 2 < 14**2
        box = (abs(x - 150) < 12) & (abs(y - 100 - 12 * place) < 10)
        bar = (abs(x - 250 + 7 * place) < 15) & (abs(y - 180) < 25)
        light[ball] = (0.35, 0.3, 0.2)
        light[box] = (0.03, 0.03, 0.05)
        light[bar] = np.where(y // 4 % 2, 1.2, 0.3)[bar][:, np.newaxis]
        for area, each in zip(areas, (ball, box, bar), strict=True):
            area |= each
        electrons = random.poisson(light * exposure * 8 * FULL_E)
        level = np.clip((electrons + random.normal(0, 8, electrons.shape)) / FULL_E, 0, 1)
        frames.append(np.rint(255 * srgb(level)).astype(np.uint8))
        truth.append(light)
    return MovingScene(frames, truth, areas)


@pytest.fixture(scope="module")
def scene() -> MovingScene:
    return moving_scene()


@pytest.fixture(scope="module")
def merged(scene: MovingScene, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """The report of the photographs, merged with and without the removal of ghosts."""
    folder = tmp_path_factory.mktemp("ghosts")
    paths: list[Path] = []
    for place, frame in enumerate(scene.frames):
        paths.append(folder / f"{place}.png")
        cv2.imwrite(str(paths[-1]), frame[..., ::-1])
    return {
        how: camctl.merge(
            paths,
            options=camctl.PhotographOptions(
                times=EXPOSURES, labels="exact", curve="srgb", align="none", deghost=how
            ),
        )
        for how in ("none", "single")
    }


def light_of(report: CaptureReport) -> Light:
    """Return the light in the unit of the scene."""
    return report.radiance().astype(np.float64) / 8


def mertens_light(scene: MovingScene) -> Light:
    """Return the light that the exposure fusion of OpenCV shows.

    What is at rest says which light its values are: their medians in steps of the value.
    """
    fused = cv2.createMergeMertens().process(list(scene.frames))
    found = np.empty(fused.shape)
    rest = ~scene.moved
    for channel in range(3):
        values, light = fused[rest][:, channel], np.log(scene.truth[0][rest][:, channel])
        order = np.argsort(values)
        groups = np.array_split(order, 64)
        x = [float(np.median(values[each])) for each in groups]
        y = [float(np.median(light[each])) for each in groups]
        found[..., channel] = np.exp(np.interp(fused[..., channel], x, y))
    return found


@pytest.mark.slow
def test_error_where_things_moved_is_halved(scene: MovingScene, merged: dict[str, Any]) -> None:
    plain, single = (scene.error(light_of(merged[how])) for how in ("none", "single"))
    fused = scene.error(mertens_light(scene))
    print(f"median error of ln light: all {plain:.4f}, single {single:.4f}, Mertens {fused:.4f}")
    assert single < plain / 2
    assert single < fused


@pytest.mark.slow
def test_where_nothing_moved_nothing_changes(scene: MovingScene, merged: dict[str, Any]) -> None:
    far = cv2.dilate(scene.moved.astype(np.uint8), np.ones((49, 49))) == 0
    plain, single = (merged[how] for how in ("none", "single"))
    same = (plain.radiance() == single.radiance()).all(axis=2)
    assert same[far].mean() > 0.98  # noise is taken for movement in a few cells
    both = np.abs(np.log(single.radiance() / plain.radiance()))[far & ~same]
    assert not both.size or float(np.median(both)) < 0.1
    assert (plain.mask()[scene.moved] & CONTRADICTING).any()
    np.testing.assert_array_equal(plain.mask() & CONTRADICTING, single.mask() & CONTRADICTING)


@pytest.mark.slow
def test_deviation_holds_the_error_of_the_single_frame(
    scene: MovingScene, merged: dict[str, Any]
) -> None:
    report = merged["single"]
    light, deviation = light_of(report), report.standard_deviation() / 8
    for area in scene.areas:
        errors = [np.abs(light - each)[area] for each in scene.truth]
        error = min(errors, key=lambda each: float(np.mean(each)))
        known = np.isfinite(deviation[area])
        within = error[known] <= 2 * deviation[area][known]
        assert within.mean() > 0.85
    (moved,) = [each for each in report.findings if each.code == "moved"]
    assert moved.frames
    assert 0 < float(moved.details["single"]) < 0.5


def test_what_moved_is_one_of_the_frames_to_its_edges(tmp_path: Path) -> None:
    """A dark box is elsewhere in each frame; nothing else has its brightness in the last frame."""
    random = np.random.default_rng(0)
    box = np.zeros((120, 160), np.bool_)
    box[31:78, 21:40] = True  # its edges are inside of cells
    paths, truth = [], []
    for place, exposure in enumerate((1 / 16, 1 / 4, 1.0)):
        light = np.where(np.roll(box, 47 * place, axis=1), 0.05, 0.8)[..., np.newaxis] * np.ones(3)
        level = np.minimum(random.poisson(light * exposure * FULL_E) / FULL_E, 1)
        paths.append(tmp_path / f"{place}.png")
        cv2.imwrite(str(paths[-1]), np.rint(255 * srgb(level)).astype(np.uint8))
        truth.append(np.log(light))
    options = camctl.PhotographOptions(
        times=(1 / 16, 1 / 4, 1.0), labels="exact", curve="srgb", align="none"
    )
    shown = np.log(camctl.merge(paths, options=options).radiance())
    still = np.full_like(shown, np.log(0.8))  # without the box, as each place is in two frames
    error = min((np.abs(shown - each) for each in (*truth, still)), key=np.mean)
    assert float(error.max()) < 0.15  # the box half seen through made it 1.3, its rim 0.6


def test_labels_are_of_the_least_error() -> None:
    # Two halves, each of which one frame shows well; without a seam that costs more than it gains.
    inside = np.zeros((8, 10), np.bool_)
    inside[1:-1, 1:-1] = True
    error = np.full((8, 10, 2), 0.01, np.float32)
    error[:, :5, 1], error[:, 5:, 0] = 1.0, 1.0
    features = np.zeros((8, 10, 3, 4), np.float32)
    labels = least_error_labels(LabelField(inside, error, features))
    assert (labels[~inside] == -1).all()
    assert (labels[1:-1, 1:5] == 0).all()
    assert (labels[1:-1, 5:-1] == 1).all()
    features[..., 1, :] = 20.0  # the frames contradict each other: one of them is taken
    labels = least_error_labels(LabelField(inside, error, features))
    assert set(labels[inside].tolist()) == {0}
