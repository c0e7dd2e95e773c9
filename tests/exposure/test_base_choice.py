"""Metering ends in a plan or in one refusal, over all presets of sensors and lists of times."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle

import numpy as np
import pytest

from camctl.captures.plan import plan_for
from camctl.errors import CamctlError, CaptureError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.light import Light, Metering
from camctl.exposure.search.best import Search
from camctl.exposure.search.settings import listed_up_to_longest
from camctl.interface.controls import (
    Choices,
    Control,
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.records.capture_plan import CapturePlan
from camctl.sim.sensors.sensor import load_sensor, sensor_names

#: Lists as still cameras have them, down to three times, and the steps of webcams.
TIMES: dict[str, Control] = {
    "thirds": Choices(tuple(2.0 ** (k / 3) for k in range(-36, 16))),
    "stops": Choices(tuple(2.0**k for k in range(-10, 1))),
    "two stops": Choices(tuple(4.0**k for k in range(-5, 1))),
    "three": Choices((1 / 60, 1 / 30, 1 / 15)),
    "100 us": Steps(1e-4, 0.5, 1e-4),
    "4 ms": Steps(4e-3, 0.04, 4e-3),
    "continuous": Steps(1e-5, 0.033),
}
GAINS: tuple[Control, ...] = (Choices((1.0,)), Steps(1.0, 8.0, 0.25))
REQUESTS = (
    CaptureRequest("log", 1000.0, 3),
    CaptureRequest("linear", 256.0, 2),
    CaptureRequest("gamma", 16000.0, 5),
    CaptureRequest(ratios=(1.0, 4.96393)),
    CaptureRequest(ratios=(1.0, 4.96393), mains_hz=50.0),
    CaptureRequest(ratios=(1.0, 8.0, 64.0, 512.0)),
    CaptureRequest(ratios=(1.0, 30.0), use_aperture=True),
)


def controls_of(time_s: Control, gain: Control, f_number: Control | None) -> ExposureControls:
    return ExposureControls(
        time_s,
        (4, 4),
        Layout.MONO,
        8,
        white=255,
        gain=gain,
        f_number=f_number,
        response_origin=ResponseOrigin.STATED,
    )


def light_of(controls: ExposureControls, limit_s: float, request: CaptureRequest) -> Light:
    """Light of which an exposure of `limit_s` is just saturated."""
    aperture = controls.f_number
    f_number = aperture.maximum if aperture is not None and request.use_aperture else None
    setting = ExposureSetting(controls.time_s.nearest(limit_s), controls.gain.minimum, f_number)
    irradiance = np.geomspace(1e-4, 1.0, 50)
    return Light(
        Metering(limit_s, setting, 0.9, 0.0, 3), irradiance, np.full(50, 1 / 50), 1e-4, last=setting
    )


def all_cases() -> Iterator[tuple[ExposureControls, CaptureRequest]]:
    lens = Choices((2.8, 4.0, 5.6, 8.0))
    controls = [controls_of(time_s, gain, lens) for time_s in TIMES.values() for gain in GAINS]
    for each in controls:
        for request in REQUESTS:
            yield each, request


def plan_or_error(
    controls: ExposureControls, request: CaptureRequest, limit_s: float
) -> CapturePlan | CamctlError:
    try:
        return plan_for(controls, Search(controls, request), light_of(controls, limit_s, request))
    except (CaptureError, UsageError) as error:
        return error


@pytest.mark.slow
@pytest.mark.parametrize(
    "place", [0.0, *(pytest.param(each, marks=pytest.mark.proof) for each in (0.62, 1.0)), 0.87]
)
def test_no_metered_light_leads_to_hints_that_do_not_end(place: float) -> None:
    for controls, request in all_cases():
        shortest, longest = controls.time_s.minimum, controls.time_s.maximum
        limit_s = shortest * (longest / shortest) ** place
        plan = plan_or_error(controls, request, limit_s)
        if isinstance(plan, CamctlError):  # no shift of the exposure makes one possible
            assert plan.hint
            assert "\n" not in f"{plan.what}{plan.hint}"
            assert "compensation_stops" not in plan.remedies
            continue
        assert plan.base_s <= max(limit_s * (1 + 1e-9), shortest)
        for setting in plan.settings:
            controls.check(setting)
        for finding in plan.findings:
            assert "compensation_stops" not in finding.remedies


def check_that_hints_end(
    controls: ExposureControls,
    request: CaptureRequest,
    limit_s: float,
    before: tuple[CaptureRequest, ...] = (),
) -> int:
    """Follow each hint that changes the exposure, and those after it; return the most in a row.

    A request that comes again is a loop.
    """
    assert request not in before, (limit_s, *before)
    found = plan_or_error(controls, request, limit_s)
    hints = (found,) if isinstance(found, CamctlError) else found.findings
    names = {"base_s", "compensation_stops", "count", "ratios"}
    changes = [{k: v} for hint in hints for k, v in hint.remedies.items() if k in names]
    if isinstance(found, CapturePlan):
        for setting in found.settings:
            controls.check(setting)
    return max(
        (
            1
            + check_that_hints_end(controls, replace(request, **each), limit_s, (*before, request))
            for each in changes
        ),
        default=0,
    )


@pytest.mark.parametrize("stops", [-0.5, 0.0, 1.0])
def test_hints_end_where_light_is_beyond_the_times_of_the_camera(stops: float) -> None:
    controls = controls_of(TIMES["4 ms"], GAINS[0], None)
    request = CaptureRequest("linear", 256.0, 2, compensation_stops=stops)
    for limit_s in (0.001, 0.16):  # two stops below the shortest time, and above the longest
        assert check_that_hints_end(controls, request, limit_s) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "preset",
    [
        pytest.param(name, marks=[pytest.mark.proof] * (place % 6 > 0))
        for place, name in enumerate(sensor_names())
    ],
)
def test_hints_end_for_every_preset_at_every_step_of_exposure(preset: str) -> None:
    """Light for every third of a stop, from below the shortest to above the longest time."""
    sensor = load_sensor(preset)
    controls = controls_of(sensor.times, sensor.gains, None)
    shortest, longest = controls.time_s.minimum, controls.time_s.maximum
    thirds = np.arange(-6, 3 * np.log2(longest / shortest) + 7)
    compensations = cycle((0.0, -0.5, 1.0, -3.0, 0.3, -12.0, 12.0, 0.0))  # with each request once
    most = 0
    for limit_s in shortest * 2.0 ** (thirds / 3):
        for request, stops in zip(REQUESTS, compensations, strict=False):
            one = replace(request, compensation_stops=stops)
            most = max(most, check_that_hints_end(controls, one, float(limit_s)))
    assert most >= 1  # compensations beyond the camera's times have a hint


@pytest.mark.parametrize("preset", sensor_names())
def test_every_preset_has_a_plan_at_its_longest_time(preset: str) -> None:
    sensor = load_sensor(preset)
    request = CaptureRequest(ratios=(1.0, 4.96393, 24.6))
    time_s, gain = sensor.times, sensor.gains
    controls = controls_of(time_s, gain, None)
    span = time_s.maximum * gain.maximum / (time_s.minimum * gain.nearest(1.0))
    light = light_of(controls, time_s.maximum, request)
    if span < 24.6:
        with pytest.raises(CaptureError, match=r"beyond the camera's controls, which reach"):
            plan_for(controls, Search(controls, request), light)
    else:
        plan = plan_for(controls, Search(controls, request), light)
        assert plan.exposures[-1] == pytest.approx(24.6, rel=0.35)


@pytest.mark.parametrize("count", [2, 3, 5, 8, 12, 16])
@pytest.mark.parametrize("gain", GAINS)
def test_a_list_up_to_the_longest_time_makes_few_sets(count: int, gain: Control) -> None:
    """Each is scored: more would take minutes."""
    controls = controls_of(Steps(1e-4, 0.1, 1e-4), gain, None)
    found = listed_up_to_longest(controls, 0.0126, count, 400)
    assert isinstance(found.time_s, Choices)
    assert isinstance(found.gain, Choices)
    number = len(found.time_s.values) + len(found.gain.values) - 1
    assert count <= number
    assert math.comb(number - 1, count - 1) <= 400 or number == count
    assert max(found.time_s.values) == pytest.approx(0.1)
    assert max(found.gain.values) == gain.maximum


def test_what_is_known_of_all_exposures_is_not_searched_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The user waits: for 12 bits a full search takes 45 s, and found no better set."""
    monkeypatch.setattr("camctl.exposure.grid_search.solve", None)
    controls = replace(controls_of(TIMES["thirds"], GAINS[0], None), bits=12, white=4095)
    request = CaptureRequest("log", 520.0, 5, base_s=2.0**-8, objective="xi")
    chosen = Search(controls, request).best(controls, None)
    assert len(chosen.settings) == 5
