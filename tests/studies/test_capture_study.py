"""Accuracy of captures against time: prediction and measurement agree, the front, its words."""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean
from typing import Any

import pytest
from cells import CELLS

import camctl
from camctl.captures import outputs
from camctl.studies.bracket_methods import METHODS, NEED_NOISE, Bracket, bracket_settings, offers
from camctl.studies.capture_rows import CaptureStudy, knee, pareto_front
from camctl.studies.capture_study import (
    CapturePoint,
    CaptureRun,
    metered,
    rate,
    simulated_camera,
)
from camctl.studies.paper_table import PRINTED_TABLE

RUN = CaptureRun("equal", 1, "log", 1000.0, 0.019, sensor="standard", size="320x240", seeds=(0, 1))


@pytest.mark.parametrize(
    ("method", "n", "response"),
    [
        ("accuracy", 3, "log"),
        ("xi", 3, "log"),
        ("paper", 2, "linear"),
        ("doubling", 2, "log"),
        ("equal", 3, "gamma"),
        ("hasinoff", 3, "gamma"),
    ],
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


@pytest.mark.parametrize("sensor", ["phone", "webcam"])
def test_mosaics_and_curved_responses_are_measured_on_their_own_samples(sensor: str) -> None:
    run = replace(RUN, method="doubling", n=4, sensor=sensor, seeds=(0,), scene="ball")
    point = rate(metered(run))
    assert point.effective_levels_measured == pytest.approx(
        point.effective_levels_predicted, rel=0.06
    )


@pytest.mark.parametrize("sensor", ["webcam", "consumer"])
def test_the_stated_time_is_that_of_a_capture_after_metering(
    sensor: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The stream of `consumer` waits for frames as long as the last metering frame."""
    # The room is darker than the range: planning what would help takes a minute, and no frame.
    monkeypatch.setattr(outputs, "range_findings", lambda *args, **kwargs: [])
    options = {"sensor": sensor, "scene": "room", "size": "64x48"}
    run = replace(RUN, method="accuracy", n=2, seeds=tuple(range(8)))
    run = replace(run, sensor=sensor, scene=options["scene"], size=options["size"])
    point = rate(metered(run))
    taken = []
    for seed in run.seeds:
        with camctl.open_camera("sim", {**options, "seed": seed}, profile="none") as camera:
            request = replace(run.request, base_s=None)
            taken.append(camctl.capture(camera, request).timing["actual_wall_s"])
    assert point.time_s == pytest.approx(fmean(taken), rel=0.1)
    assert point.time_measured_s == pytest.approx(point.time_s, rel=0.2)


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
    if method in NEED_NOISE:
        with pytest.raises(Exception, match="the noise of this camera is not known"):
            bracket_settings(method, replace(bracket, controls=replace(controls, noise=None)))


def point(time_s: float, levels: float, **more: Any) -> CapturePoint:
    return CapturePoint(time_s=time_s, effective_levels_predicted=levels, **more)


def test_the_front_has_what_nothing_else_beats() -> None:
    points = [point(1, 10), point(2, 9), point(2, 20), point(3, 20.05), point(4, 30)]
    assert pareto_front(points) == [True, False, True, False, True]
    assert pareto_front([*points, CapturePoint(note="beyond the controls")])[-1] is False


def test_the_knee_is_where_time_stops_to_pay() -> None:
    assert knee([point(1, 10), point(2, 40), point(8, 45)]) == 1
    assert knee([point(1, 10), point(2, 40)]) is None


def test_steps_are_told_in_words() -> None:
    runs = tuple(replace(RUN, n=n) for n in (3, 4))
    study = CaptureStudy(runs, (point(1.0, 69.0), point(1.8, 100.0)))
    assert study.steps_in_words("equal", lambda seconds: f"{seconds:.1f} s") == [
        "the fourth exposure costs 0.8 s and brings 31 % less error"
    ]
