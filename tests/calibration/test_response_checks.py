"""Errors for unsuitable exposure series, and curves with a sharp shoulder."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some
from scene_maps import blocks

from camctl.calibration.response.checks import KEPT, inexactness, intervals_of
from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.interface.controls import Layout
from camctl.messages.plain import sentence
from camctl.model.response.camera import FloatArray
from camctl.sim.scenes.drawings import DRAWINGS

STOPS = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)


def curve(light: FloatArray) -> FloatArray:
    """Return the brightness of a film: a power, and a sharp shoulder near full scale."""
    power = light**0.5 / 0.95
    bent = power - 0.018 * np.logaddexp(0, (power - 0.95) / 0.02)
    return np.asarray(bent / (1 / 0.95 - 0.018 * np.logaddexp(0, (1 / 0.95 - 0.95) / 0.02)))


def shoot(E: FloatArray, exposure: float, seed: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(seed)
    charge = 1e4 * E * exposure
    charge = charge + np.sqrt(charge + 25) * rng.normal(size=E.shape)
    brightness = curve(np.clip(charge / 1e4, 0, 1))
    return np.clip(np.floor(brightness * 256), 0, 255).astype(np.uint8)


def room() -> FloatArray:
    light = np.asarray(DRAWINGS["room"](240, 320))
    light = light.mean(axis=2)
    return np.asarray(light / np.quantile(light, 0.98))


def shades() -> FloatArray:
    """Return light over three decades, whose neighbours differ little."""
    rows, columns = np.mgrid[0:240, 0:320]
    logs = 5 * rows / 240 + 2 * np.sin(columns / 25) + np.sin(columns / 7 + rows / 11) / 2
    return np.asarray(np.exp(logs - np.quantile(logs, 0.98)))


def series_of(
    frames: list[NDArray[np.uint8]], exposures: tuple[float, ...] | None = None
) -> Series:
    series = Series(Layout.MONO, 8, levels_are_stated=True)
    for k, (frame, exposure) in enumerate(zip(frames, exposures or STOPS, strict=True)):
        series.add(frame, exposure, f"frame {k}")
    return series


@pytest.mark.parametrize("power", some([2.2, 3.0], every=2))
def test_true_exposures_are_not_accused_where_the_curve_is_hardly_known(power: float) -> None:
    """Film as steep as curve 171 of the database, before a dark room: nearly all of it is black."""
    rng, frames = np.random.default_rng(3), []
    for exposure in STOPS:
        charge = 2e4 * room() * exposure
        charge = charge + np.sqrt(charge + 25) * rng.normal(size=charge.shape)
        brightness = np.clip(charge / 2e4, 0, 1) ** power
        frames.append(np.clip(np.floor(brightness * 256), 0, 255).astype(np.uint8))
    series = series_of(frames)
    record = estimate_response(series).record
    inexact = inexactness(record, series.exposures, has_profile=False)
    assert inexact is not None
    assert inexact.value is not None
    assert inexact.value > 0.3
    assert "add a frame" in sentence(inexact)
    channel = record.main_channel
    at = np.linspace(0.1, 0.9, 33)
    errors = np.log(np.interp(at, channel.brightness, channel.irradiance)) - np.log(at) / power
    deviations = np.interp(at, channel.brightness, channel.deviation or ())
    middle = np.interp(0.5, at, errors)
    assert np.all(np.abs(errors - middle) <= 2 * deviations + 0.02)


@pytest.mark.parametrize("is_shot", [True, False])
@pytest.mark.parametrize("is_same", [True, False])
def test_only_those_who_gave_the_frames_can_correct_them(is_shot: bool, is_same: bool) -> None:
    """The same picture twice; else frames in the wrong order."""
    first, second = (shoot(shades(), exposure, 0) for exposure in (1.0, 0.25))
    series = series_of([first, first if is_same else second], (1.0, 2.0))
    series.is_shot = is_shot
    with pytest.raises(DataError) as caught:
        estimate_response(series)
    words = ("leave one of them out", "check the order of the exposures")
    assert any(word in caught.value.hint for word in words) == (not is_shot)
    assert caught.value.hint


def test_a_camera_that_moved_is_not_taken_for_wrong_exposures() -> None:
    """Even where histograms stay as they are: what leaves at an edge comes in at the other."""
    frames = [
        np.roll(shoot(room(), exposure, k), (7 * k, -11 * k), (0, 1))
        for k, exposure in enumerate(STOPS)
    ]
    with pytest.raises(DataError, match=r"frame 0 and frame 1 do not show the same: .* moved"):
        estimate_response(series_of(frames))


def test_a_frame_is_darker_by_less_than_all_of_its_light() -> None:
    wrong = [exposure / (1.8 if k == 3 else 1) for k, exposure in enumerate(STOPS)]
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(wrong)]
    with pytest.raises(DataError, match=r"frame 3 is 44% darker than its exposure 1 says"):
        estimate_response(series_of(frames))


@pytest.mark.parametrize("wrong", [0, 2, 5])
@pytest.mark.parametrize("factor", some([1.6, 1 / 1.6], every=2, first=1))
def test_one_wrong_label_is_named_with_what_its_pixels_say(wrong: int, factor: float) -> None:
    """Not as movement, also where it is the first or the last exposure."""
    labels = tuple(exposure / (factor if k == wrong else 1) for k, exposure in enumerate(STOPS))
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(STOPS)]
    said = rf"frame {wrong} is .* than its exposure {labels[wrong]:.4g} says: .* (\S+) times"
    with pytest.raises(DataError, match=said) as caught:
        estimate_response(series_of(frames, labels))
    found = re.search(said, str(caught.value))
    assert found is not None
    assert float(found[1]) == pytest.approx(factor, rel=0.01)


def test_one_label_that_is_a_little_wrong_does_not_bend_the_curve() -> None:
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(STOPS)]
    labels = (*STOPS[:-1], 1.2 * STOPS[-1])
    right, wrong = (estimate_response(series_of(frames, each)) for each in (STOPS, labels))
    finding = wrong.findings[0]
    assert (finding.code, finding.frames) == ("exposures_contradict", (5,))
    assert finding.value == pytest.approx(1 / 1.2 - 1, abs=0.005)
    channels = [each.record.main_channel for each in (right, wrong)]
    curves = [np.interp(0.1, each.brightness, each.irradiance) for each in channels]
    assert curves[1] == pytest.approx(curves[0], rel=0.005)  # 10 % with the trend of all labels


def test_flicker_is_called_flicker_and_widens_the_interval() -> None:
    light = (1.03, 0.97, 1.08, 0.94, 1.05, 0.96)
    lamps = [
        shoot(shades(), t * gain, k) for k, (t, gain) in enumerate(zip(STOPS, light, strict=True))
    ]
    flickering = estimate_response(series_of(lamps))
    assert flickering.findings[0].details["kind"] == "flicker"
    steady = [shoot(shades(), exposure, k) for k, exposure in enumerate(STOPS)]
    widths = [
        intervals_of(each.record) for each in (estimate_response(series_of(steady)), flickering)
    ]
    assert widths[0] is not None
    assert widths[1] is not None
    assert widths[0].widest < KEPT < widths[1].widest


@pytest.mark.parametrize(
    ("labels", "count"),
    some([(np.linspace, 3), (np.geomspace, 4), (np.geomspace, 6), (np.linspace, 6)], every=2),
)
def test_times_that_are_wrong_throughout_are_refused(
    count: int, labels: Callable[[float, float, int], FloatArray]
) -> None:
    """Where no camera has the response that they give; a finding says where few cameras have it."""
    true = np.geomspace(1, 16, count) / 4
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(true)]
    with pytest.raises(DataError, match=r"contradict the pixels, which say about 1, .*") as caught:
        estimate_response(series_of(frames, tuple(labels(1, 1.5, count))))
    assert caught.value.remedies == {"estimate_ratios": True}
    assert "\n" not in str(caught.value)
    flat = estimate_response(series_of(frames, tuple(np.geomspace(1, 3, count))))
    assert [each.details.get("kind") for each in flat.findings] == ["trend"]


def test_what_is_refused_is_kept_on_request_with_a_finding() -> None:
    true = np.geomspace(1, 16, 4) / 4
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(true)]
    kept = estimate_response(series_of(frames, tuple(np.geomspace(1, 1.5, 4))), is_kept=True)
    assert [each.code for each in kept.findings] == ["response_doubtful"]


@pytest.mark.slow
def test_a_camera_that_moved_is_kept_on_request_with_a_finding() -> None:
    moved = [
        np.roll(shoot(room(), exposure, k), (7 * k, -11 * k), (0, 1))
        for k, exposure in enumerate(STOPS)
    ]
    found = estimate_response(series_of(moved, STOPS), is_kept=True).findings
    assert "response_doubtful" in [each.code for each in found]


@pytest.mark.parametrize("flatness", [0.7, 3.9])
def test_steep_and_flat_cameras_before_edges_are_measured(flatness: float) -> None:
    """An S curve as steep or as flat as a measured one, before blocks with sharp edges."""
    rng = np.random.default_rng(7)
    light = blocks(rng)
    frames = []
    for exposure in STOPS:
        charge = 2e4 * light * exposure
        charge = charge + np.sqrt(charge + 25) * rng.normal(size=light.shape)
        x = np.clip(charge / 2e4, 0, 1) ** (flatness / 1.85)
        frames.append(np.clip(np.floor((0.5 * x + 1.5 * x**2 - x**3) * 256), 0, 255))
    estimate = estimate_response(series_of([each.astype(np.uint8) for each in frames]))
    (channel,) = estimate.record.channels
    x = np.linspace(0.1, 0.95, 50)
    true = x ** (1.85 / flatness)
    found = np.interp(0.5 * x + 1.5 * x**2 - x**3, channel.brightness, channel.irradiance)
    errors = np.log(found / true)
    assert np.std(errors) < 0.03


def test_a_curve_by_contradictory_exposures_is_said_to_be_uncertain() -> None:
    true = (0.25, 1.6, 4.0)  # of three exposures each one may be the wrong one
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(true)]
    found = estimate_response(series_of(frames, (0.25, 1.2, 4.0)))
    assert [each.code for each in found.findings] == ["exposures_contradict"]
    inexact = inexactness(found.record, (0.25, 1.2, 4.0), has_profile=True)
    assert inexact is not None
    assert inexact.value is not None
    assert inexact.value > 0.4


def test_a_sharp_shoulder_is_followed() -> None:
    frames = [shoot(shades(), exposure, k) for k, exposure in enumerate(STOPS)]
    (channel,) = estimate_response(series_of(frames)).record.channels
    brightness = np.linspace(0.05, 0.98, 100)
    light = np.linspace(0, 1, 10_000)
    true = np.interp(brightness, curve(light), light)
    found = np.interp(brightness, channel.brightness, channel.irradiance)
    slope = np.gradient(brightness, np.log(true))
    errors = np.log(found / true)
    errors -= np.average(errors, weights=slope**2)  # the unit of the light is free
    assert (
        np.sqrt(np.mean((errors * slope) ** 2)) < 0.00026
    )  # 0.00030 with knots that are wide at the shoulder


@pytest.mark.parametrize("step", [2, 4, 8, 16])
def test_counted_rows_of_a_large_frame_are_all_rows_of_blocks_alike(
    step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A JPEG file changes levels most in the first and the last row of its blocks."""
    frame = np.full((960, 400), 100, np.uint8)
    frame[::8] = 200
    monkeypatch.setattr("camctl.calibration.response.series._MOST_COUNTED", frame.size // step)
    series = Series(Layout.MONO, 8)
    series.add(frame, 1.0, "frame")
    below, above = series.counts_between("Y", np.array([150.0]))[0]
    assert above / (below + above) == pytest.approx(1 / 8, rel=0.1)
