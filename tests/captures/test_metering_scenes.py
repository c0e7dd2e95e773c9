"""With default options the range of a picture holds the light of its scene, or it is said why."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from scene_maps import MAPS, write_map

import camctl
from camctl.cli.capture_output.summary import light_text
from camctl.findings import Finding
from camctl.records.capture_plan import MUCH, PlannedLight
from camctl.sim.scenes.scene import scene_names

MOST_OUTSIDE = 0.02
EXCEPTIONS = {
    "stars": "the sky gives 1 electron in the longest exposure, 60 s, and a level has 39",
}
SIZE = "240x180"
LIGHT = {"light_above_range", "light_below_range", "light_changed"}
"""Codes of findings that more than a share of the picture is outside its range."""


def shot(scene: str, folder: Path, **fields: Any) -> camctl.CaptureReport:
    """Return the capture of a scene by the simulated camera."""
    options = {"sensor": fields.pop("sensor")} if "sensor" in fields else {}
    if scene in MAPS:
        opened = camctl.open_camera("sim", scene=str(write_map(scene, folder)), **options)
    else:
        opened = camctl.open_camera("sim", scene=scene, size=SIZE, **options)
    with opened as camera:
        values: dict[str, Any] = {"dynamic_range": "auto"} | fields
        return camctl.capture(camera, camctl.CaptureRequest(**values))


@pytest.mark.slow
def test_at_most_2_percent_lie_outside_the_range(tmp_path: Path) -> None:
    outside, reports = {}, {}
    for scene in (*scene_names(), *MAPS):
        reports[scene] = shot(scene, tmp_path)
        achieved = reports[scene].achieved
        outside[scene] = achieved.saturated_fraction + achieved.dark_fraction
    beyond = {scene for scene, share in outside.items() if share > MOST_OUTSIDE}
    assert len(outside) == 18
    assert beyond == EXCEPTIONS.keys(), outside
    for scene in beyond:
        assert any("longest_s" in each.details for each in reports[scene].findings)
    light = reports["night-street"].plan.light
    assert light is not None
    assert 0.001 < light.clips <= 0.005
    assert light.clips_stops > 8


@pytest.mark.parametrize(
    ("sensor", "ratios"),
    [("webcam", (1.0, 2.0, 8.0)), pytest.param("ccd", None, marks=pytest.mark.slow)],
)
def test_lamps_that_flicker_are_the_second_exception_and_the_advice_mends_it(
    sensor: str, ratios: tuple[float, ...] | None
) -> None:
    """The metering frames fell into darker parts of the lamps' period than the capture."""

    def taken(stops: float) -> camctl.CaptureReport:
        with camctl.open_camera("sim", scene="pwm-lamp", sensor=sensor, size=SIZE) as camera:
            request = camctl.CaptureRequest(
                dynamic_range=16.0, ratios=ratios, compensation_stops=stops
            )
            return camctl.capture(camera, request)

    report = taken(0.0)
    assert report.achieved.saturated_fraction > MOST_OUTSIDE
    (advised,) = [each.remedies for each in report.findings if each.code == "light_changed"]
    achieved = taken(advised["compensation_stops"]).achieved
    assert achieved.saturated_fraction + achieved.dark_fraction < MOST_OUTSIDE


Followed = list[tuple[float, float]]


def follow(
    scene: str, fields: dict[str, Any], folder: Path, most: int = 4
) -> tuple[Followed, list[Finding]]:
    """Take pictures as advised; return the shares outside of each, and the last findings."""
    shares: Followed = []
    advised: list[tuple[str, Any]] = []
    while True:
        report = shot(scene, folder, **fields)
        achieved = report.achieved
        shares.append((achieved.saturated_fraction, achieved.dark_fraction))
        found = [each for each in report.findings if each.code in LIGHT]
        assert bool(found) == (max(shares[-1]) > MUCH)
        changes = {name: value for each in found for name, value in each.remedies.items()}
        assert not set(changes.items()) & set(advised), "the same advice again"
        advised += changes.items()
        if not changes or len(shares) == most:
            return shares, found
        fields |= {name: None if value is False else value for name, value in changes.items()}


@pytest.mark.parametrize(
    ("scene", "fields"),
    [
        ("room", {"count": 1}),
        *(
            pytest.param(scene, fields, marks=pytest.mark.slow)
            for scene, fields in (
                ("room", {"dynamic_range": 256.0}),
                ("room", {"time_budget_s": 0.5}),
                ("room", {"base_s": 1e-4, "dynamic_range": 1000.0}),
                ("room", {"base_s": 8.0, "dynamic_range": 1000.0}),
                ("cloth", {"compensation_stops": 2.0}),
                ("room", {"response": "linear", "dynamic_range": 1000.0}),
                ("room", {"clip_percent": 20.0}),
                ("room", {"time_budget_s": 1.0, "accuracy": 60.0}),
            )
        ),
    ],
)
def test_following_the_advice_ends_without_a_warning(
    scene: str, fields: dict[str, Any], tmp_path: Path
) -> None:
    shares, findings = follow(scene, fields, tmp_path)
    assert len(shares) > 1
    assert not findings


@pytest.mark.slow
def test_what_is_too_bright_for_two_reasons_gets_one_advice(tmp_path: Path) -> None:
    fields = {"compensation_stops": 2.0, "clip_percent": 20.0}
    shares, findings = follow("cloth", fields, tmp_path)
    assert shares[0][0] > MUCH
    assert len(shares) == 2
    assert not findings


@pytest.mark.slow
def test_what_is_too_dark_for_two_reasons_gets_one_advice(tmp_path: Path) -> None:
    fields = {"clip_percent": 0.0, "dynamic_range": 1000.0}
    shares, findings = follow("night-street", fields, tmp_path)
    assert shares[0][1] > MUCH
    assert len(shares) == 2
    assert not findings


@pytest.mark.slow
def test_a_large_lamp_may_clip_where_nothing_else_shows_the_room(tmp_path: Path) -> None:
    fields: dict[str, Any] = {"sensor": "phone", "objective": "xi"}
    report = shot("lamp-in-room.exr", tmp_path, **fields)
    assert [each.remedies for each in report.findings] == [{"clip_percent": 2.0}]
    shares, findings = follow("lamp-in-room.exr", fields, tmp_path)
    assert not findings
    assert len(shares) == 2
    assert 0.015 < shares[-1][0] < 0.02


@pytest.mark.parametrize(
    "fields", [{"dynamic_range": 1000.0}, pytest.param({}, marks=pytest.mark.slow)]
)
def test_stars_get_no_advice_that_does_not_help(fields: dict[str, Any], tmp_path: Path) -> None:
    shares, findings = follow("stars", fields, tmp_path)
    assert len(shares) == 1
    assert [each.details["unseen"] for each in findings] == [True]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "sensor"),
    [
        ("night-street", "standard"),
        ("stars", "complete"),
        ("outdoor-sun", "security"),
    ],
)
def test_each_advice_helps(scene: str, sensor: str, tmp_path: Path) -> None:
    shares, _ = follow(scene, {"sensor": sensor, "dynamic_range": 64.0}, tmp_path, most=3)
    worst = [max(each) for each in shares]
    assert all(after < before for before, after in pairwise(worst)), worst


@pytest.mark.parametrize(
    "clip", [10.0, *(pytest.param(each, marks=pytest.mark.slow) for each in (0.0, 1.0))]
)
def test_the_share_that_may_clip_clips(clip: float, tmp_path: Path) -> None:
    report = shot("tile-floor", tmp_path, clip_percent=clip)
    assert report.achieved.saturated_fraction == pytest.approx(clip / 100, rel=0.25, abs=2e-4)


@pytest.mark.slow
def test_compensation_keeps_the_shadows_in_an_automatic_range(tmp_path: Path) -> None:
    plans = [shot("tile-floor", tmp_path, compensation_stops=stops).plan for stops in (0, -2)]
    assert plans[1].base_s == pytest.approx(plans[0].base_s / 4, rel=0.02)
    assert plans[1].dynamic_range == 4 * plans[0].dynamic_range


@pytest.mark.parametrize(
    ("clips", "stops", "name"),
    [
        (0.002, 8.0, "(lamps, reflections)"),
        (0.1, 8.0, "(the brightest parts)"),
        (0.002, 1.0, "(the brightest parts)"),
    ],
)
def test_lamps_are_few_and_far_above_the_rest(clips: float, stops: float, name: str) -> None:
    light = PlannedLight(1e4, is_open=False, clips=clips, clips_stops=stops, dark=0.0, needed=1e4)
    assert name in light_text(light)


@pytest.mark.slow
def test_light_that_clips_is_said_once(tmp_path: Path) -> None:
    report = shot("outdoor-sun", tmp_path)
    light, metering = report.plan.light, report.plan.metering
    assert light is not None
    assert metering is not None
    assert light.clips >= metering.clipped > 0
    assert report.findings == []
