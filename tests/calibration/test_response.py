"""The estimated response against the true one of simulated frames, and unsuitable frames."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from opencv_levels import levels_of, opencv_curves
from sampling import some

from camctl.calibration.response.estimate import ResponseEstimate, estimate_response
from camctl.calibration.response.fit import fit_response
from camctl.calibration.response.matches import match_levels
from camctl.calibration.response.series import Series
from camctl.errors import DataError, UsageError
from camctl.interface.controls import Layout
from camctl.model.response.camera import FloatArray, srgb_to_linear
from camctl.profiles.response import ChannelResponse, ResponseRecord

Curve = Callable[[FloatArray], FloatArray]
STOPS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0)


def srgb(E: FloatArray) -> FloatArray:
    return np.asarray(np.where(E <= 0.0031308, 12.92 * E, 1.055 * E ** (1 / 2.4) - 0.055))


def s_curve(E: FloatArray) -> FloatArray:
    """Return a film-like curve: steep in the middle, flat in the highlights."""
    root = E**0.45
    return np.asarray(0.35 * root + 0.65 * root**2 * (3 - 2 * root))


CURVES: dict[str, Curve] = {
    "linear": lambda E: E,
    "power": lambda E: np.asarray(E ** (1 / 2.2)),
    "srgb": srgb,
    "s": s_curve,
}


def scene(seed: int = 1, rows: int = 150, columns: int = 200) -> FloatArray:
    """Return irradiance of smooth shades over three decades with some texture."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0 : 1 : rows * 1j, 0 : 1 : columns * 1j]
    log = np.zeros((rows, columns))
    for _ in range(6):
        u, v, phase = rng.normal(size=2)[0] * 4, rng.normal() * 4, rng.uniform(0, 7)
        log += np.sin(u * x + v * y + phase)
    log = 1.7 * (log - log.mean()) / log.std() + rng.normal(0, 0.15, log.shape)
    E = np.exp(log)
    return np.asarray(E / np.quantile(E, 0.99))


def shoot(
    E: FloatArray,
    exposure: float,
    curve: Curve,
    bits: int = 8,
    *,
    black: int = 0,
    seed: int = 0,
    electrons: float = 10_000,
) -> NDArray[np.uint16]:
    """Return a frame with photon noise and read noise, quantised by truncation, black added."""
    rng = np.random.default_rng(seed)
    charge = np.minimum(E * exposure, 1.2) * electrons
    charge = charge + np.sqrt(charge + 25) * rng.normal(size=E.shape)
    light = np.clip(charge / electrons, 0, 1)
    top = 2**bits - 1 - black
    dn = np.minimum(np.floor(curve(light) * (top + 1)), top)
    return np.asarray(dn + black, np.uint8 if bits == 8 else np.uint16)


def series_of(
    curve: Curve, bits: int = 8, exposures: tuple[float, ...] = STOPS, **how: float
) -> Series:
    series = Series(Layout.MONO, bits)
    E = scene() * how.pop("brightness", 1.0)
    for seed, exposure in enumerate(exposures):
        frame = shoot(E, exposure, curve, bits, seed=seed, black=int(how.get("black", 0)))
        series.add(frame, exposure, f"frame {seed}")
    return series


def error_of(estimate: ResponseEstimate | ResponseRecord, curve: Curve) -> float:
    """Return the root mean square error of brightness from 5 % on, at the best scale of light."""
    record = estimate.record if isinstance(estimate, ResponseEstimate) else estimate
    channel = record.main_channel
    E = np.geomspace(1e-4, 0.995, 400)
    E = E[curve(E) > 0.05]
    errors = [
        np.sqrt(
            np.mean((np.interp(E * scale, channel.irradiance, channel.brightness) - curve(E)) ** 2)
        )
        for scale in np.exp(np.linspace(-0.1, 0.1, 201))
    ]
    return float(min(errors))


@pytest.mark.parametrize(
    ("name", "exposures"), [("s", (1.0, 10.0)), ("srgb", (0.5, 4.0, 32.0)), ("srgb", (1.0, 10.0))]
)
def test_curves_with_a_toe_and_a_shoulder_are_found_from_frames_far_apart(
    name: str, exposures: tuple[float, ...]
) -> None:
    """With the smoothest curve alone the error of the first is 0.004 to 0.009."""
    series = series_of(CURVES[name], exposures=exposures, brightness=0.5)
    found = estimate_response(series, is_scene_checked=False, exposure_error=0.05)
    assert error_of(found, CURVES[name]) < 0.002


@pytest.mark.parametrize("name", ["s", "power"])
def test_a_frame_that_shares_no_light_with_others_changes_nothing(name: str) -> None:
    """A trend of its exposure was taken for an exponent of the others: errors were 100 times."""
    pair = (4.0, 16.0)
    alone, beside = (
        estimate_response(
            series_of(CURVES[name], exposures=each), is_scene_checked=False, exposure_error=0.05
        )
        for each in (pair, (*pair, pair[0] / 512))
    )
    assert error_of(alone, CURVES[name]) < 0.002
    assert error_of(beside, CURVES[name]) < 0.002
    assert beside.exposures[1] == pytest.approx(4, rel=0.02)


def test_errors_that_are_alike_over_many_levels_do_not_bend_the_curve() -> None:
    series = Series(Layout.MONO, 8)
    for k, exposure in enumerate((1.0, 2.0, 4.0, 8.0, 16.0)):
        frame = shoot(scene(3, 300, 400) / 4, exposure, s_curve, seed=k).astype(float)
        if k == 0:  # developed differently, by up to four levels
            frame = np.clip(np.rint(frame + 4 * np.sin(2 * np.pi * frame / 255)), 0, 255)
        series.add(frame.astype(np.uint8), exposure, str(k))
    assert error_of(estimate_response(series, is_scene_checked=False), s_curve) < 0.002


@pytest.mark.parametrize(
    ("name", "bits"),
    [
        # By default two of the curves, with 8 and 12 bits.
        pytest.param(
            name, bits, marks=() if (place, bits) in ((0, 8), (1, 12)) else pytest.mark.slow
        )
        for place, name in enumerate(CURVES)
        for bits in (8, 10, 12, 16)
    ],
)
def test_the_response_is_found_at_every_depth(name: str, bits: int) -> None:
    assert error_of(estimate_response(series_of(CURVES[name], bits)), CURVES[name]) < 0.003


def test_three_frames_suffice() -> None:
    estimate = estimate_response(series_of(srgb, exposures=(1.0, 4.0, 16.0)))
    assert error_of(estimate, srgb) < 0.006


def test_it_is_much_better_than_the_methods_of_opencv() -> None:
    frames = [shoot(scene(), exposure, s_curve, seed=k) for k, exposure in enumerate(STOPS)]
    ours = estimate_response(series_of(s_curve))
    for method in ("debevec", "robertson"):
        levels = levels_of(opencv_curves(frames, STOPS, method)[:, 0])
        rising = np.maximum.accumulate(levels) * (1 + 1e-6 * np.arange(255))
        light = (0.0, *(rising / rising[-1] * 0.999).tolist(), 1.0)
        channel = ours.record.main_channel.model_copy(
            update={"irradiance": light, "brightness": tuple((np.arange(257) / 256).tolist())}
        )
        theirs = ours.record.model_copy(update={"channels": (channel,)})
        assert error_of(ours, s_curve) < error_of(theirs, s_curve) / 2


@pytest.mark.parametrize("layout", some([Layout.RGB, Layout.GRBG], every=2, first=1))
def test_each_channel_has_its_own_response(layout: Layout) -> None:
    curves = {"R": CURVES["power"], "G": srgb, "B": CURVES["linear"]}
    series = Series(layout, 8)
    letters = series.colours()
    for seed, exposure in enumerate(STOPS):
        planes = [
            shoot(scene(), exposure, curves[letter], seed=10 * seed + k)
            for k, letter in enumerate(letters)
        ]
        if layout is Layout.RGB:
            pixels = np.stack(planes, axis=2)
        else:
            pixels = np.zeros((300, 400), np.uint8)
            for plane, part in zip(planes, layout.planes(pixels), strict=True):
                part[...] = plane
        series.add(pixels, exposure, f"frame {seed}")
    record = estimate_response(series).record
    assert [each.name for each in record.channels] == ["R", "G", "B"]
    for channel in record.channels:
        alone = record.model_copy(update={"channels": (channel,)})
        assert error_of(alone, curves[channel.name]) < 0.004


def test_black_level_and_clipping_level_are_found() -> None:
    series = Series(Layout.MONO, 12)
    for seed, exposure in enumerate(STOPS):
        light = np.minimum(scene() * exposure, 1.0)
        noise = np.random.default_rng(seed).normal(0, 6, light.shape)
        dn = np.clip(256 + 3500 * light + noise, 0, 3600)
        series.add(np.asarray(np.rint(dn), np.uint16), exposure, f"frame {seed}")
    record = estimate_response(series).record
    (channel,) = record.channels
    assert channel.black == pytest.approx(256, abs=8)
    assert channel.white == 3600
    assert channel.saturates
    assert error_of(record, lambda E: E) < 0.004


def test_nothing_is_saturated_where_no_frame_is() -> None:
    series = series_of(srgb, brightness=0.0295)
    (channel,) = estimate_response(series).record.channels
    assert not channel.saturates
    assert channel.white == 255
    assert channel.measured[1] < 0.999


def test_estimated_ratios_correct_wrong_exposures() -> None:
    wrong = np.array([1.0, 2.3, 3.9, 7.4, 17.0, 31.0])
    series = series_of(srgb)
    series.exposures = wrong.tolist()
    known, estimated = (
        estimate_response(series, estimate_ratios=estimate) for estimate in (False, True)
    )
    true, given_logs, found = (
        np.log(np.array(each) / each[0]) for each in (STOPS, wrong, estimated.exposures)
    )

    def straight(logs: FloatArray) -> float:
        """Return the largest deviation from a power of the true exposures."""
        return float(np.abs(logs - np.polyval(np.polyfit(true, logs, 1), true)).max())

    assert straight(found) < 0.1 * straight(given_logs)
    kinds = [e.details["kind"] for e in known.findings if e.code == "exposures_contradict"]
    assert kinds == ["flicker"]


def test_the_record_gives_the_levels_of_a_camera() -> None:
    record = estimate_response(series_of(srgb)).record
    response = ResponseRecord.model_validate_json(record.model_dump_json()).camera_response()
    assert response.M == 255
    expected = srgb_to_linear(np.arange(1, 256) / 256)
    assert np.abs(response.levels / expected - 1)[20:].max() < 0.03
    with pytest.raises(UsageError, match="unknown channel 'R'"):
        record.camera_response("R")


def test_the_plain_table_is_the_irradiance_of_each_sample() -> None:
    """A linear camera of 4 bits has 12 levels above black 2; it rounds or truncates."""
    line: dict[str, Any] = {
        "irradiance": (0.0, 1.0),
        "brightness": (0.0, 1.0),
        "measured": (0.0, 1.0),
    }
    channel = ChannelResponse(name="Y", black=2, white=14, saturates=True, deviation=None, **line)
    rounds, truncates = channel.level_table(0.5), channel.level_table(0.0)
    assert rounds == pytest.approx([0, 0, 0, *(np.arange(1, 13) / 13)])
    assert truncates == pytest.approx([0, 0, 0, *(np.arange(1.5, 13) / 13)])
    # The thresholds of the same response lie half a level below and above each entry.
    record = ResponseRecord(channels=(channel,), phase=0.5, frames=2, measured_at="")
    thresholds = record.camera_response().levels
    assert rounds[3:14] == pytest.approx((thresholds[:-1] + thresholds[1:]) / 2)


@pytest.mark.slow
@settings(max_examples=20)
@given(
    exponent=st.floats(0.3, 3.0),
    slope=st.floats(0.0, 0.9),
    contrast=st.floats(0.5, 3.0),
    seed=st.integers(0, 50),
)
def test_the_curve_ascends_and_is_finite_whatever_the_matches(
    exponent: float, slope: float, contrast: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    E = np.exp(rng.normal(-3, contrast, 4000))
    frames = [
        np.minimum(255, 256 * (slope * E * t + (1 - slope) * (E * t) ** exponent)) for t in STOPS
    ]
    frames[seed % 6] = rng.permutation(frames[seed % 6]) * rng.uniform(0.5, 1)  # a contradiction
    counts = np.array([np.histogram(each, np.arange(257.0))[0] for each in frames])
    edges = np.arange(1.0, 256.0)
    matches = match_levels(lambda *pair: counts[list(pair)], STOPS, edges)
    if matches.low.size < 20:
        return
    fit = fit_response(matches, STOPS, edges)
    assert np.all(np.isfinite(fit.irradiance))
    assert np.all(np.diff(fit.irradiance) > 0)
    assert np.all(fit.deviation >= 0)


@settings(max_examples=30)
@given(
    kinds=st.lists(
        st.sampled_from(["flat", "two", "half", "noise", "ramp"]), min_size=2, max_size=4
    ),
    step=st.sampled_from([1.2, 2.0, 8.0]),
    estimate=st.booleans(),
    stated=st.booleans(),
    seed=st.integers(0, 50),
)
def test_odd_frames_are_refused_or_give_a_curve_that_ascends(
    kinds: list[str], step: float, estimate: bool, stated: bool, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    series = Series(Layout.MONO, 8, exposures_are_stated=stated)
    for k, kind in enumerate(kinds):
        level = min(255.0, 20 * step**k + seed)
        frame = {
            "flat": np.full((40, 60), level),
            "two": rng.choice([level / 3, level], (40, 60)),
            "half": np.where(np.arange(60) < 30, 255, rng.uniform(0, level, (40, 60))),
            "noise": rng.integers(0, 256, (40, 60)),
            "ramp": np.minimum(255, np.geomspace(0.5, level * 3, 60) * np.ones((40, 1))),
        }[kind]
        series.add(np.asarray(frame, np.uint8), step**k, f"frame {k}")
    try:
        found = estimate_response(series, estimate_ratios=estimate)
    except DataError:
        return
    assert np.all(np.isfinite(found.exposures))
    (channel,) = found.record.channels
    assert np.all(np.isfinite(channel.irradiance))
    assert np.all(np.diff(channel.irradiance) > 0)
    assert channel.deviation is not None
    assert np.all(np.isfinite(channel.deviation))
    assert np.all(np.array(channel.deviation) >= 0)


@pytest.mark.slow
def test_the_intervals_hold_at_coarse_steps_too() -> None:
    inside = []
    for name in CURVES:
        for exposures in ((1.0, 2.0, 4.0, 8.0, 16.0, 32.0), (1.0, 4.0, 16.0), (1.0, 8.0, 32.0)):
            channel = estimate_response(series_of(CURVES[name], exposures=exposures)).record
            (found,) = channel.channels
            E, B = np.array(found.irradiance), np.array(found.brightness)
            used = (B > 0.03) & (B < 0.98)
            grid = np.linspace(0, 1, 20_001)
            logs = np.log(E[used] / np.interp(B[used], CURVES[name](grid), grid))
            logs -= np.interp(0.5, B[used], logs)
            assert found.deviation is not None
            inside.append(np.mean(np.abs(logs) <= 1.96 * np.array(found.deviation)[used]))
    assert np.mean(inside) > 0.9


def test_samples_without_information_have_no_weight() -> None:
    record = estimate_response(series_of(srgb, black=17)).record
    (channel,) = record.channels
    weights = channel.sample_weights()
    assert weights.shape == (channel.white + 1,)
    assert np.all(weights[: channel.black + 1] == 0)
    assert weights[channel.white] == 0
    assert np.all(weights[channel.black + 1 : channel.white] > 0)
    assert weights[100] > 10 * weights[channel.black + 2]


def flat(value: float) -> NDArray[np.uint8]:
    return np.full((60, 80), value, np.uint8)


def add_frames(frames: list[NDArray[np.uint8]], exposures: tuple[float, ...]) -> Series:
    series = Series(Layout.MONO, 8)
    for k, (frame, exposure) in enumerate(zip(frames, exposures, strict=True)):
        series.add(frame, exposure, f"frame {k}")
    return series


def good(exposures: tuple[float, ...] = STOPS) -> list[NDArray[np.uint8]]:
    return [
        shoot(scene(), exposure, srgb, seed=k).astype(np.uint8)
        for k, exposure in enumerate(exposures)
    ]


def test_unsuitable_frames_are_refused_with_what_to_do() -> None:
    frames = good()
    moved = [np.roll(frame, 25 * k, axis=1) for k, frame in enumerate(frames)]
    flickering = good((1.0, 2.0, 4.0, 8.0 * 1.6, 16.0, 32.0))
    cases: list[tuple[list[NDArray[np.uint8]], tuple[float, ...], str]] = [
        (frames[:1], (1.0,), "1 frame with 1 different exposure: .* at least 2; give 3 or more"),
        (frames[:2], (1.0, 1.0), "2 frames with 1 different exposure"),
        ([flat(0), flat(1)], (1.0, 2.0), "all frames are black; take the lens cap off"),
        ([flat(255)] * 2, (1.0, 1.2), "saturated everywhere"),
        ([flat(200), flat(100)], (2.0, 1.0), "no brightness occurs in two frames"),
        ([frames[0], frames[0]], (1.0, 2.0), "frame 0 and frame 1 are the same picture"),
        (frames[::-1], STOPS, "frame . is brighter than frame ., .* check the order"),
        (moved, STOPS, "the camera or the scene moved; put the camera on a tripod"),
        (flickering, STOPS, "frame 3 is 60% brighter than its exposure 8 says: .* 12.8"),
        (good((1.0, 2.0, 4.0))[:3], (1.0, 2.0, 4.0), ""),
        (good((0.02, 0.04)), (0.02, 0.04), "only up to .* of full scale; add frames of exposure"),
        ([frames[0], frames[5]], (1.0, 500.0), "no brightness occurs in two frames; add a frame"),
    ]
    for case, exposures, message in cases:
        if not message:
            estimate_response(add_frames(case, exposures))
            continue
        with pytest.raises(DataError, match=message) as caught:
            estimate_response(add_frames(case, exposures))
        assert "\n" not in str(caught.value)


def test_saturated_frames_are_refused() -> None:
    rng = np.random.default_rng(3)
    frames = [flat(255) - (rng.random((60, 80)) < 0.001).astype(np.uint8) for _ in range(2)]
    with pytest.raises(DataError, match="saturated everywhere; expose shorter"):
        estimate_response(add_frames(frames, (1.0, 2.0)))


def test_frames_of_another_size_are_refused() -> None:
    series = add_frames(good()[:1], (1.0,))
    with pytest.raises(DataError, match="frame 1 has 40 x 30 pixels and frame 0 has 200 x 150"):
        series.add(np.zeros((30, 40), np.uint8), 2.0, "frame 1")
    with pytest.raises(UsageError, match="invalid exposure nan of x"):
        series.add(np.zeros((150, 200), np.uint8), float("nan"), "x")


def test_all_colours_of_jpeg_files_have_one_response() -> None:
    """JPEG files keep less of the colours: estimated alone, red and blue have other dark parts."""
    series = Series(Layout.RGB, 8)
    light = np.stack([scene(seed) * share for seed, share in ((1, 1.0), (2, 1.0), (3, 0.7))], 2)
    for seed, exposure in enumerate(STOPS):
        frame = shoot(light, exposure, s_curve, seed=seed)
        _, packed = cv2.imencode(".jpg", frame[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])
        pixels = np.asarray(cv2.imdecode(packed, cv2.IMREAD_COLOR))[..., ::-1]
        series.add(pixels, exposure, f"frame {seed}")
    estimate = estimate_response(series)
    assert [each.name for each in estimate.record.channels] == ["R", "G", "B"]
    assert len({each.irradiance for each in estimate.record.channels}) == 1
    assert error_of(estimate, s_curve) < 0.01
