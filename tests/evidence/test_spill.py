"""Light that spread from saturated samples: marked where the picture is wrong, and reported."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

import camctl
from camctl.captures.advice import MUCH_SPREAD, spread_findings
from camctl.sim.sensors.sensor import load_sensor

SIZE = "240x180"


@cache
def shot(sensor: str, scene: str, request: camctl.CaptureRequest) -> camctl.CaptureReport:
    with camctl.open_camera("sim", scene=scene, sensor=sensor, seed=1, size=SIZE) as camera:
        return camctl.capture(camera, request)


@pytest.fixture
def sensor_without_blooming(tmp_path: Path) -> str:
    """Return the file of the sensor `ccd`, whose charge does not flow."""
    sensor = load_sensor("ccd")
    pixels = sensor.pixels.model_copy(update={"blooming": 0.0, "smear_s": 0.0})
    path = tmp_path / "calm.json"
    path.write_text(sensor.model_copy(update={"pixels": pixels}).model_dump_json())
    return str(path)


@pytest.mark.parametrize(
    ("scene", "exposures", "least"),
    [
        pytest.param("room", None, 0.97, marks=pytest.mark.slow),
        # By default there is a frame of 1 ms, too, in which smear of the lamps is marked as well.
        pytest.param("night-street", (0.022, 0.53, 8.556), 0.96, marks=pytest.mark.slow),
        pytest.param("ball", None, 0.97, marks=pytest.mark.slow),
        # Two frames are 270 times apart: the shorter one has noise of a quarter of its signal.
        ("room", 2, 0.97),
        pytest.param("night-street", 2, 0.8, marks=pytest.mark.slow),
    ],
)
def test_samples_that_blooming_makes_wrong_are_marked(
    scene: str,
    exposures: int | tuple[float, ...] | None,
    least: float,
    sensor_without_blooming: str,
) -> None:
    """The truth is what the same sensor, but without blooming, shows with the same exposures."""
    if isinstance(exposures, tuple):
        ratios = tuple(each / exposures[0] for each in exposures)
        request = camctl.CaptureRequest(dynamic_range="auto", base_s=exposures[0], ratios=ratios)
    else:
        request = camctl.CaptureRequest(dynamic_range="auto", count=exposures)
    report = shot("ccd", scene, request)
    times = [frame.applied_s for frame in report.frames]
    request = camctl.CaptureRequest(
        dynamic_range=report.plan.dynamic_range,
        base_s=times[0],
        ratios=tuple(each / times[0] for each in times),
    )
    truth = shot(sensor_without_blooming, scene, request)
    marked = (report.mask() & 4) != 0
    in_range = ((report.mask() | truth.mask()) & 3) == 0
    factor = report.radiance()[in_range] / truth.radiance()[in_range]
    wrong, right = factor > 1.5, np.abs(np.log(factor)) < 0.1
    assert wrong.mean() > MUCH_SPREAD
    assert marked[in_range][wrong].mean() > least
    assert marked[in_range][right].mean() < 0.01
    movement = report.movement
    assert movement is not None
    assert movement.places == ()
    assert marked.mean() == pytest.approx(movement.share + movement.spread)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sensor", "stops"), [("phone", -0.5), pytest.param("ccd", -1.0, marks=pytest.mark.slow)]
)
def test_light_of_lamps_that_flicker_has_not_spread(sensor: str, stops: float) -> None:
    """Where the longest frame is not saturated, all of it is brighter by one factor."""
    request = camctl.CaptureRequest(dynamic_range=16.0, compensation_stops=stops)
    report = shot(sensor, "pwm-lamp", request)
    assert report.frames[-1].saturated_fraction > 0.5
    assert report.movement is not None
    assert report.movement.spread < MUCH_SPREAD
    assert not [each for each in report.findings if each.code == "light_spread"]


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["room", "night-street", "ball"])
def test_the_advice_against_light_that_spreads_helps(scene: str) -> None:
    report = shot("ccd", scene, camctl.CaptureRequest(dynamic_range="auto"))
    assert report.movement is not None
    (found,) = [each for each in report.findings if each.code == "light_spread"]
    assert found.value == report.movement.spread
    assert found.remedies.keys() == {"dynamic_range", "compensation_stops"}
    request = camctl.CaptureRequest(**found.remedies)
    after = shot("ccd", scene, request).movement
    assert after is not None
    assert after.spread < 0.8 * report.movement.spread


@pytest.mark.slow
@pytest.mark.parametrize(
    "sensor",
    ["phone", *(pytest.param(each, marks=pytest.mark.slow) for each in ("standard", "complete"))],
)
def test_sensors_without_much_blooming_have_no_warning(sensor: str) -> None:
    report = shot(sensor, "room", camctl.CaptureRequest(dynamic_range="auto"))
    assert report.movement is not None
    assert report.movement.spread < MUCH_SPREAD / 10
    assert not [each for each in report.findings if each.code == "light_spread"]


def test_advice_fits_what_was_asked_for() -> None:
    request = camctl.CaptureRequest(base_s=0.01, ratios=(1.0, 16.0))
    report = shot("standard", "room", request)
    assert spread_findings(request, report.plan, 0.9 * MUCH_SPREAD) == []
    (fixed,) = spread_findings(request, report.plan, MUCH_SPREAD)
    assert (fixed.code, fixed.remedies) == ("light_spread", {"base_s": 0.0025})
    (taken,) = spread_findings(request, report.plan, MUCH_SPREAD, repeatable=False)
    assert (taken.remedies, taken.details) == ({}, {"photographs": True})
