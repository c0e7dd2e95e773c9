"""The range where the metered light decides it: by the accuracy that is possible over each."""

from __future__ import annotations

from dataclasses import replace

import pytest

import camctl
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.front import Front, FrontPoint
from camctl.exposure.search.ranges import STOPS, _largest
from camctl.records.capture_plan import CapturePlan
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor


def planned(request: CaptureRequest) -> CapturePlan:
    with SimulatedCamera(load_scene("tile-floor", (48, 64)), load_sensor("standard")) as camera:
        return camctl.plan_capture(camera, request)


@pytest.mark.parametrize("power", [0.3, 1.0, 4.0])
@pytest.mark.parametrize("least", [0.0, 1.0, 7.0, 40.0, 79.0, 99.0, 101.0])
def test_the_largest_range_of_enough_levels_is_found_from_few_of_them(
    power: float, least: float
) -> None:
    """However the levels fall with the range, and where the largest ones have none."""
    levels = [100.0 * (1 - (place / 14) ** power) if place < 14 else 0.0 for place in range(17)]
    tried: set[int] = set()

    def rated(place: int) -> float:
        tried.add(place)
        return levels[place]

    enough = [place for place, each in enumerate(levels) if each >= least]
    assert _largest(16, 0, rated, least) == (max(enough) if enough else 16)
    assert len(tried) <= 9


@pytest.mark.slow
def test_an_accuracy_is_reached_over_the_largest_range_that_has_it() -> None:
    request = CaptureRequest(dynamic_range="auto", accuracy=90.0, time_budget_s=1.5)
    plan = planned(request)
    assert plan.effective_levels >= 90.0 * (1 - 1e-6)
    larger = replace(request, dynamic_range=STOPS[STOPS.index(plan.dynamic_range) + 1])
    with pytest.raises(camctl.UsageError, match="no set of 1 to 16 exposures has 90 effective"):
        planned(larger)


@pytest.mark.slow
def test_an_accuracy_beyond_all_ranges_names_the_range_with_most() -> None:
    """Over a very small range there are fewer levels than over a larger one."""
    request = CaptureRequest("log", "auto", 3, accuracy=1e5)
    with pytest.raises(camctl.UsageError) as found:
        planned(request)
    error = found.value
    assert error.what.startswith("no set of 3 exposures has 100000 effective levels")
    assert "over any range up to 1:" in error.what
    assert error.hint is not None
    span, levels = (float(each.replace(",", "")) for each in _numbers(error.hint))
    for other in STOPS[:9]:
        plan = planned(replace(request, dynamic_range=other, accuracy=None))
        assert plan.effective_levels <= 1.01 * levels, other
    plan = planned(replace(request, dynamic_range=span, accuracy=levels * 0.98))
    assert plan.effective_levels >= levels * 0.98


def test_a_budget_too_short_for_any_exposure_names_no_range() -> None:
    request = CaptureRequest("log", "auto", accuracy=120.0, time_budget_s=0.05)
    with pytest.raises(camctl.UsageError) as found:
        planned(request)
    assert str(found.value) == (
        "one exposure takes 0.1 s at least, more than the 0.05 s allowed; allow more time"
    )


def _numbers(hint: str) -> tuple[str, str]:
    """Return the range and the levels of: over 1:256 the best has 121 in 3.4 s; ..."""
    words = hint.split()
    return words[1].removeprefix("1:"), words[words.index("has") + 1]


def test_exposures_are_solved_for_one_range_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solving for all ranges from the largest to the chosen one took 11 s of processor time."""
    solved: list[float] = []
    at_time = Front.at_time

    def counted(front: Front, budget_s: float) -> FrontPoint:
        solved.append(front.desired.dynamic_range)
        return at_time(front, budget_s)

    monkeypatch.setattr(Front, "at_time", counted)
    plan = planned(CaptureRequest(dynamic_range="auto", time_budget_s=0.5))
    assert solved == [plan.dynamic_range]


@pytest.mark.parametrize(
    ("scene", "sensor", "response"),
    [
        ("tile-floor", "standard", "log"),
        pytest.param("night-street", "webcam", "linear", marks=pytest.mark.slow),
        pytest.param("night-street", "webcam", "log", marks=pytest.mark.slow),
        pytest.param("room", "webcam", "log", marks=pytest.mark.slow),
    ],
)
def test_the_planned_shares_outside_the_range_are_those_of_the_result(
    scene: str, sensor: str, response: str
) -> None:
    """Light within the range that no exposure shows is too dark in both."""
    with camctl.open_camera("sim", scene=scene, sensor=sensor, size="320x240") as camera:
        request = CaptureRequest(response, "auto", count=3)
        report = camctl.capture(camera, request, None)
    light, achieved = report.plan.light, report.achieved
    assert light is not None
    assert achieved.dark_fraction > 0.005  # else it proves nothing
    assert light.dark == pytest.approx(achieved.dark_fraction, rel=0.1, abs=0.003)
    assert light.clips == pytest.approx(achieved.saturated_fraction, rel=0.3, abs=0.001)
