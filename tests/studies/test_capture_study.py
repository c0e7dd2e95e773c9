"""Accuracy of captures against time: prediction and measurement agree, the front, its words."""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean
from typing import Any

import pytest
from cells import CELLS
from sampling import some

import camctl
from camctl.captures import outputs
from camctl.errors import CaptureError
from camctl.studies.bracket_methods import (
    FRONT,
    METHODS,
    PRINTED_TABLE,
    Bracket,
    bracket_settings,
    offers,
)
from camctl.studies.capture_rows import CaptureStudy
from camctl.studies.capture_study import (
    CapturePoint,
    CaptureRun,
    front_runs,
    metered,
    rate,
    simulated_camera,
)

RUN = CaptureRun("equal", 1, "log", 1000.0, 0.019, sensor="standard", size="160x120", seeds=(0, 1))


@pytest.mark.parametrize(
    ("method", "n", "response"),
    some(
        [
            ("xi", 3, "log"),
            ("paper", 2, "linear"),
            ("doubling", 2, "log"),
            ("hasinoff", 3, "gamma"),
            ("equal", 3, "gamma"),
            ("2-stop", 3, "log"),
        ],
        every=6,
    ),
)
def test_prediction_and_measurement_agree(method: str, n: int, response: str) -> None:
    run = replace(RUN, method=method, n=n, response=response)
    point = rate(metered(run))
    assert point.effective_levels_measured is not None
    assert point.effective_levels_measured == pytest.approx(
        point.effective_levels_predicted, rel=0.03
    )
    assert len(point.effective_levels_each) == 2
    assert point.effective_levels_each[0] != point.effective_levels_each[1]
    assert point.time_measured_s is not None
    assert point.time_measured_s == pytest.approx(point.time_s, rel=0.1)


def test_a_run_gives_the_same_point_again() -> None:
    run = replace(RUN, method="doubling", n=2, size="64x48")
    assert rate(run) == rate(run)


@pytest.mark.parametrize("sensor", some(["phone", "webcam"], every=2))
def test_mosaics_and_curved_responses_are_measured_on_their_own_samples(sensor: str) -> None:
    run = replace(RUN, method="doubling", n=4, sensor=sensor, seeds=(0,), scene="ball")
    point = rate(metered(run))
    assert point.effective_levels_measured == pytest.approx(
        point.effective_levels_predicted, rel=0.06
    )


@pytest.mark.slow
@pytest.mark.parametrize("sensor", ["consumer", "webcam"])
def test_the_stated_time_is_that_of_a_capture_after_metering(
    sensor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stream of `consumer` waits for frames as long as the last metering frame."""
    # The room is darker than the range: planning what would help takes a minute, and no frame.
    monkeypatch.setattr(outputs, "range_findings", lambda *args, **kwargs: [])
    options = {"sensor": sensor, "scene": "room", "size": "64x48"}
    run = replace(RUN, method=FRONT, n=2, seeds=tuple(range(8)))
    run = metered(replace(run, sensor=sensor, scene=options["scene"], size=options["size"]))
    taken = []
    for seed in run.seeds:
        with camctl.open_camera("sim", {**options, "seed": seed}, profile="none") as camera:
            report = camctl.capture(camera, replace(run.request, base_s=None))
            taken.append(report.timing["actual_wall_s"])
    settings = report.plan.settings
    times, gains = zip(*((setting.time_s, setting.gain) for setting in settings), strict=True)
    point = rate(replace(run, times_s=times, gains=gains))
    assert point.time_s == pytest.approx(fmean(taken), rel=0.1)
    assert point.time_measured_s == pytest.approx(point.time_s, rel=0.2)


@pytest.mark.slow
def test_the_lens_costs_accuracy_that_is_not_predicted() -> None:
    run = replace(RUN, method="doubling", n=5, sensor="mobile", seeds=(0,))
    run = metered(run)
    without, with_lens = rate(run), rate(replace(run, lens=True))
    assert with_lens.levels < 0.8 * without.levels
    assert without.effective_levels_predicted == pytest.approx(
        with_lens.effective_levels_predicted, rel=0.02
    )


def test_the_printed_table_is_that_of_the_tests() -> None:
    assert {(cell.response, len(cell.printed)): cell.printed for cell in CELLS} == PRINTED_TABLE
    desired = replace(RUN, response="gamma", gamma=0.45).desired
    assert not offers("paper", desired, 3)
    assert not offers("paper", RUN.desired, 1)
    assert offers("doubling", desired, 3)


@pytest.mark.parametrize("method", METHODS)
def test_all_methods_begin_at_the_metered_base(method: str) -> None:
    with simulated_camera(RUN, seed=0) as camera:
        controls = camera.controls
    bracket = Bracket(controls, replace(RUN, n=3).request, 0.019)
    settings = bracket_settings(method, bracket)
    assert settings[0].exposure == pytest.approx(0.019, rel=1e-3)
    for setting in settings:
        controls.check(setting)
    if method == "hasinoff":
        with pytest.raises(CaptureError, match="the noise of the camera, which is not known"):
            bracket_settings(method, replace(bracket, controls=replace(controls, noise=None)))


def point(time_s: float, levels: float, **more: Any) -> CapturePoint:
    return CapturePoint(time_s=time_s, effective_levels_predicted=levels, **more)


def study_of(*points: tuple[str, float, float, float]) -> CaptureStudy:
    """Return a study of (method, time, effective levels, the most in this time); 2 s is best."""
    runs = tuple(
        replace(RUN, method=method, is_recommended=method == FRONT and time_s == 2)
        for method, time_s, _, _ in points
    )
    rated = (
        point(t, levels, effective_levels=levels, front_levels=m) for _, t, levels, m in points
    )
    return CaptureStudy(runs, tuple(rated))


def test_other_methods_are_compared_with_the_front_at_equal_accuracy_and_time() -> None:
    front = [(FRONT, 0.5, 10.0, 10.0), (FRONT, 2.0, 40.0, 40.0), (FRONT, 8.0, 80.0, 80.0)]
    study = study_of(*front, ("equal", 4.0, 20.0, 56.0), ("xi", 8.0, 80.0, 80.0))
    equal, best = study.of_method("equal")[0][1], study.of_method("xi")[0][1]
    assert study.slower_by(equal) == pytest.approx(4.0)  # the front has 20 levels in 1 s
    assert equal.less_accurate_by == pytest.approx(1 - 20 / 56)
    assert study.slower_by(best) == pytest.approx(1.0)
    assert [p.time_s for _, p in study.around] == [0.5, 2.0, 8.0]
    assert len(study.in_words(str)) == 3
    rows = study.rows()
    assert [row["slower_by"] for row in rows[:3]] == pytest.approx([1.0] * 3)
    assert rows[3]["less_accurate_by"] == equal.less_accurate_by


def test_rows_without_a_front_or_a_result_have_no_comparison() -> None:
    noted = CapturePoint(note="beyond the controls")
    study = CaptureStudy((RUN, RUN), (noted, point(1.0, 5.0, effective_levels=5, front_levels=9)))
    assert study.rows()[0]["slower_by"] is study.rows()[0]["less_accurate_by"] is None
    assert study.recommended is None
    assert study.in_words(str) == []
    assert study.around == []


@pytest.mark.slow
def test_no_method_beats_the_front_and_its_points_are_what_they_promise() -> None:
    run = metered(replace(RUN, size="64x48"))
    runs = front_runs(run)
    points = [rate(replace(each, seeds=(0,))) for each in runs[:3]]
    assert sum(each.is_recommended for each in runs) == 1
    assert [p.less_accurate_by for p in points] == [0.0] * 3
    assert [p.time_s for p in points] == sorted(p.time_s for p in points)
    for method, n in (("doubling", 2), ("2-stop", 3)):
        found = rate(replace(run, method=method, n=n, seeds=(0,)))
        assert found.less_accurate_by > -2e-3


@pytest.mark.slow
def test_the_front_of_a_camera_of_unknown_noise_counts_quantisation_alone() -> None:
    run = metered(replace(RUN, size="64x48", options=(("unknown", "yes"),), profile="none"))
    found = rate(front_runs(run)[1])
    assert not found.noise_known
    assert found.effective_levels == pytest.approx(found.effective_levels_noise_free, rel=0.02)
