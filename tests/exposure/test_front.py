"""The front of accuracy and time of a camera, and the settings chosen from it."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from sampling import some

from camctl.errors import UsageError
from camctl.exposure import cache
from camctl.exposure.accuracy import TooInaccurateError
from camctl.exposure.accurate import judge as judge_module
from camctl.exposure.cache import cache_folder
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.search import front as front_module
from camctl.exposure.search.front import POINTS, SMOOTH_LEVELS, Front, FrontPoint
from camctl.exposure.search.wall_time import predicted_wall_s
from camctl.interface.clock import CaptureTiming
from camctl.interface.controls import Choices, ExposureControls, Layout, ResponseOrigin, Steps
from camctl.model.effective import EffectiveCamera
from camctl.model.noise import FrameNoise, NoiseModel
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.model.response.tabulated import tabulated_desired

STREAM = ExposureControls(
    Steps(1e-4, 10.0, 1e-4),
    (24, 32),
    Layout.MONO,
    8,
    white=255,
    delay_frames=2,
    frame_interval_s=1 / 30,
    timing=CaptureTiming(lead_frames=0.5, readout_s=0.01),
    noise=NoiseModel(39.0625, ((1.0, 3.0),)),
    response_origin=ResponseOrigin.STATED,
)
LOG = desired_response("log", 1000.0)
BASE_S = 0.018


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path / "cache"))


@lru_cache
def standard() -> Front:
    """Return the front of `STREAM`, once for all tests: it is the same, and searched as asked."""
    return Front(STREAM, LOG, BASE_S)


def levels_of(front: Front, point: FrontPoint) -> float:
    """Return the exact prediction for the settings of a point."""
    controls = front.controls
    camera = EffectiveCamera.of(controls.levels, controls.relative_exposures(point.settings))
    return noisy_effective_levels(camera, front.desired, controls.frame_noise(point.settings))


def test_points_go_from_the_fastest_set_to_where_more_time_brings_nothing() -> None:
    front = standard()
    points = front.points
    assert POINTS - 2 <= len(points) <= POINTS + 1
    assert all(a.time_s < b.time_s and a.levels < b.levels for a, b in pairwise(points))
    assert (points[0].n, points[-1].n) == (1, 16)
    assert front.recommended in points
    for point in points[::4]:
        assert point.levels == pytest.approx(levels_of(front, point), rel=0.01)
        assert point.time_s == predicted_wall_s(STREAM, point.settings)
        assert min(s.exposure for s in point.settings) == pytest.approx(BASE_S)


def test_no_point_pays_better_than_the_recommended_one() -> None:
    """Levels^2 / time is the same for averages of any number of captures."""
    front = standard()
    best = max(point.levels**2 / point.time_s for point in front.points)
    recommended = front.recommended
    assert recommended.levels**2 / recommended.time_s >= 0.95 * best
    assert front.chosen is recommended


@pytest.mark.parametrize(
    ("read_noise_e", "longest_s"),
    some([(8.0, 0.2), (8.0, 10.0), (60.0, 10.0)], every=3),
)
def test_a_picture_in_little_light_is_no_noisier_than_one_of_three_exposures(
    read_noise_e: float, longest_s: float
) -> None:
    """Many poor frames would pay best: `levels`^2 / time is largest for a frame of high gain."""
    camera = replace(
        STREAM,
        time_s=Steps(1e-4, longest_s, 1e-4),
        gain=Choices((1.0, 2.0, 4.0, 8.0, 16.0)),
        noise=NoiseModel(39.0625, ((1.0, read_noise_e), (16.0, read_noise_e / 8))),
    )
    dim = 30 * BASE_S if longest_s > 1 else BASE_S
    found = Front(camera, LOG, dim).recommended
    three = Front(camera, LOG, dim, request=CaptureRequest(count=3)).chosen
    assert found.levels >= 0.995 * min(SMOOTH_LEVELS, three.levels)
    if found.levels < SMOOTH_LEVELS:
        assert found.time_s <= three.time_s


@pytest.mark.parametrize("budget_s", some([0.2, 2.0], every=2))
def test_a_time_budget_is_kept_and_used(budget_s: float) -> None:
    front = standard()
    point = front.at_time(budget_s)
    assert point.time_s <= budget_s * (1 + 1e-8)
    assert point.levels == pytest.approx(levels_of(front, point), rel=2e-3)
    slower = front.at_time(1.3 * budget_s)
    assert slower.levels > 1.05 * point.levels


STEPPED_GAIN = replace(
    STREAM,
    time_s=Steps(1e-4, 2.0, 1e-4),
    gain=Choices((1.0, 2.0, 4.0, 8.0)),
    noise=NoiseModel(30.0, ((1.0, 5.0), (8.0, 2.5))),
)


@pytest.mark.parametrize(
    ("camera", "dynamic_range", "budget_s", "least"),
    some(
        [
            # By the estimate, which misses that dark frames are not dithered, fewer are best.
            (STREAM, 16000.0, 2.0, 51.85),
            # Frames of exactly a frame interval cost nothing more than shorter ones.
            (STEPPED_GAIN, 1000.0, 0.5, 58.6),
            # No exchange of one frame leads to the gains of the best set.
            (STEPPED_GAIN, 4000.0, 4.0, 118.5),
            # Several levels of a dark frame lie within one step of the estimate (before: 166.46;
            # 13 frames have 166.84, and 12 have 166.77).
            (STREAM, 1000.0, 3.0, 166.6),
        ],
        every=2,
    ),
)
def test_sets_that_an_adversary_found_are_found(
    camera: ExposureControls, dynamic_range: float, budget_s: float, least: float
) -> None:
    """A random search with the exact prediction beat earlier fronts by up to 1.4 %."""
    desired = desired_response("log", dynamic_range)
    assert Front(camera, desired, BASE_S).at_time(budget_s).levels >= least


@pytest.mark.parametrize(("camera", "n", "least"), [(STREAM, 6, 159.0), (STEPPED_GAIN, 16, 159.5)])
def test_a_given_number_over_a_large_range_is_not_only_traced(
    camera: ExposureControls, n: int, least: float
) -> None:
    """Exchanges from the fastest set on, weight by weight, end at 158.3 and at 157.9 levels."""
    front = Front(camera, desired_response("log", 2.0**14), BASE_S, request=CaptureRequest(count=n))
    assert front.chosen.levels >= least


@pytest.mark.parametrize("bits", [8, 12])
def test_of_many_frames_one_set_is_predicted_exactly(
    bits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has as many levels as the most accurate set of the search that judges all its sets."""
    predicted = []

    def counted(
        camera: EffectiveCamera, desired: DesiredResponse, noise: list[FrameNoise]
    ) -> float:
        predicted.append(len(noise))
        return noisy_effective_levels(camera, desired, noise)

    monkeypatch.setattr(judge_module, "noisy_effective_levels", counted)
    camera = STREAM
    if bits == 12:
        noise = NoiseModel(39.0625 / 16, ((1.0, 3.0),))
        camera = replace(STREAM, bits=12, white=4095, noise=noise)
    front = Front(camera, LOG, BASE_S, request=CaptureRequest(count=64))
    point = front.chosen
    assert predicted == [64]
    assert point.levels == pytest.approx(levels_of(front, point), rel=1e-4)
    assert front.at_time(2 * point.time_s).levels < 1.006 * point.levels


def test_an_accuracy_is_reached_and_not_in_less_time() -> None:
    front = standard()
    point = front.at_accuracy(99.0)
    assert 99.0 <= levels_of(front, point) < 99.5
    assert front.at_time(0.97 * point.time_s).levels < 99.0


@pytest.mark.slow
def test_more_frames_than_six_are_taken_where_they_pay() -> None:
    """With six at most, 156 levels took 3.88 s, and 1.217 s were needed for 99 levels."""
    front = standard()
    point = front.at_time(4.0)
    assert point.n > 6
    assert point.levels > 180
    assert front.at_accuracy(99.0).time_s < 1.2


def test_a_given_number_is_kept() -> None:
    front = Front(STREAM, LOG, BASE_S, request=CaptureRequest(count=3))
    assert {point.n for point in front.points} == {3}
    assert front.chosen.n == front.at_time(1.0).n == 3


@pytest.mark.parametrize("budget_s", [1e-4, 0.05])
def test_a_budget_below_the_shortest_exposure_says_the_least(budget_s: float) -> None:
    with pytest.raises(UsageError, match=r"one exposure takes 0\.126\d* s at least"):
        standard().at_time(budget_s)


def test_an_accuracy_that_no_set_reaches_says_the_best_and_its_time() -> None:
    front = standard()
    with pytest.raises(TooInaccurateError) as raised:
        front.at_accuracy(1e4)
    words = raised.value.hint.split()
    assert float(words[words.index("has") + 1]) == pytest.approx(281, rel=0.02)
    assert float(words[words.index("in") + 1]) == pytest.approx(front.points[-1].time_s, rel=0.2)


@pytest.mark.slow
def test_without_known_noise_quantisation_alone_decides() -> None:
    known = standard().at_time(1.0)
    front = Front(replace(STREAM, noise=None), LOG, BASE_S)
    assert not front.has_noise
    point = front.at_time(1.0)
    assert point.time_s <= 1.0
    assert point.levels > 2 * known.levels


@pytest.mark.parametrize(
    ("points", "flat"), some([(2, False), (9, True), (10_000, False)], every=3, first=1)
)
def test_tabulated_responses_have_a_front(points: int, flat: bool) -> None:
    u = np.linspace(0.0, 1.0, points)
    if flat:
        u = np.maximum(np.minimum(u, 0.4), u - 0.3)
    desired: DesiredResponse = tabulated_desired(np.geomspace(1e-3, 1, points), u)
    front = Front(STREAM, desired, BASE_S)
    assert 20 < front.recommended.levels < math.inf
    assert front.at_time(2.0).levels > front.at_time(0.4).levels


def test_a_list_of_times_and_gains_is_kept() -> None:
    times = Choices(tuple(2.0 ** (np.arange(-30, 10) / 3)))
    controls = replace(STREAM, time_s=times, gain=Choices((1.0, 2.0, 4.0)))
    point = Front(controls, LOG, BASE_S).at_time(0.6)
    assert {setting.time_s for setting in point.settings} <= set(times.values)
    assert {setting.gain for setting in point.settings} <= {1.0, 2.0, 4.0}
    assert point.time_s <= 0.6


def test_points_are_kept_for_the_next_time(monkeypatch: pytest.MonkeyPatch) -> None:
    request = CaptureRequest(time_budget_s=0.5)
    first = Front(STREAM, LOG, BASE_S, request=request)
    known = first.points, first.chosen, first.levels_within(0.2), first.estimated_levels
    assert first.levels_within(1e-4) is None
    monkeypatch.setattr(front_module, "accurate_sets", None)  # no search must be needed
    again = Front(STREAM, LOG, BASE_S, request=request)
    assert (again.points, again.chosen) == known[:2]
    assert (again.levels_within(0.2), again.estimated_levels) == known[2:]
    assert again.levels_within(1e-4) is None
    assert again.chosen.time_s == predicted_wall_s(STREAM, again.chosen.settings)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b'[{"settings": [], "time_s": "x"}]'])
def test_a_damaged_point_is_found_again(content: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    point = Front(STREAM, LOG, BASE_S).recommended
    (path,) = cache_folder().iterdir()
    path.write_bytes(content)
    assert Front(STREAM, LOG, BASE_S).recommended == point


@pytest.mark.slow
def test_another_camera_light_or_goal_has_points_of_its_own() -> None:
    for front in (
        Front(STREAM, LOG, BASE_S),
        Front(STREAM, LOG, 2 * BASE_S),
        Front(STREAM, desired_response("log", 500.0), BASE_S),
        Front(replace(STREAM, frame_interval_s=0.1), LOG, BASE_S),
        Front(replace(STREAM, noise=NoiseModel(30.0, ((1.0, 3.0),))), LOG, BASE_S),
        Front(STREAM, LOG, BASE_S, request=CaptureRequest(count=2)),
    ):
        assert front.recommended.levels > 20
    assert len(list(cache_folder().iterdir())) == 6


def test_the_oldest_kept_points_are_deleted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cache, "MOST_FILES", 3)
    front = Front(STREAM, LOG, BASE_S)
    for time_s in (0.2, 0.3, 0.4, 0.5, 0.6):
        front.at_time(time_s)
    assert len(list(cache_folder().iterdir())) == 3
