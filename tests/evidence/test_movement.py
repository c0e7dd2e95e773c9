"""Movement between the frames: found where it is, and false alarms at the stated rate."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some
from small_cameras import small_camera

import camctl
from camctl.evidence import marks
from camctl.evidence.light_ratio import NeighbourCheck
from camctl.evidence.marks import FALSE_ALARMS
from camctl.evidence.movement import Movement, find_movement
from camctl.evidence.residual import FrameRows, Pair, Side, outside_limits
from camctl.interface.camera import Pixels
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response, standard_response

Floats = NDArray[np.float64]

SENSORS = ("standard", "webcam", "consumer", "phone", "machine-vision", "mobile")


def shot(
    sensor: str, scene: str, *, seed: int = 0, size: str | None = None
) -> camctl.CaptureReport:
    more = {} if size is None else {"size": size}
    with camctl.open_camera("sim", scene=scene, sensor=sensor, seed=seed, **more) as camera:
        return camctl.capture(camera, camctl.CaptureRequest(ratios=(1.0, 4.0, 16.0)))


def found(report: camctl.CaptureReport) -> tuple[float, float]:
    """Return the share of the samples that differ, and the share by noise that is stated."""
    assert report.movement is not None
    return report.movement.share, report.movement.false_alarms


@pytest.mark.slow
@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize("scene", ["cloth", "ramp", "tile-floor"])
def test_false_alarms_are_no_more_than_stated(sensor: str, scene: str) -> None:
    """No place is reported, and the mask keeps its promise."""
    report = shot(sensor, scene, size="480x360")
    share, stated = found(report)
    assert share <= stated <= FALSE_ALARMS
    assert report.movement is not None
    assert report.movement.places == ()


@pytest.mark.parametrize("colours", [1, 3])
def test_bytes_are_compared_as_wider_samples_are(colours: int) -> None:
    rng = np.random.default_rng(0)
    low = np.sort(rng.integers(0, 240, (colours, 250))).astype(np.uint16)
    high = np.minimum(low + rng.integers(0, 250, (colours, 250)), 249).astype(np.uint16)
    short, long = rng.integers(0, 250, (2, 300, 50, 3), np.uint8)
    planes = [min(k, colours - 1) for k in range(3)]
    expected = np.stack(
        [
            (short[..., k] < low[plane][long[..., k]]) | (short[..., k] > high[plane][long[..., k]])
            for k, plane in enumerate(planes)
        ],
        axis=-1,
    )
    assert 0.1 < expected.mean() < 0.9
    assert np.array_equal(outside_limits(low, high, short, long), expected)
    wide = (each.astype(np.uint16) for each in (short, long))
    assert np.array_equal(outside_limits(low, high, *wide), expected)


def test_small_frames_are_compared_without_a_table_of_all_samples(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = Mock(side_effect=marks._FramePair._of_all_codes)
    monkeypatch.setattr(marks._FramePair, "_of_all_codes", lambda pair: whole(pair))
    masks = [shot("standard", "moving-target", size="96x72").mask()]
    whole.assert_not_called()
    monkeypatch.setattr(marks, "_ALL_CODES", 0)
    masks.append(shot("standard", "moving-target", size="96x72").mask())
    whole.assert_called()
    assert np.count_nonzero(masks[0] & 4) > 0
    assert np.array_equal(masks[0], masks[1])


def test_frames_without_noise_have_no_false_alarms() -> None:
    assert found(shot("ideal-8", "tile-floor", size="240x180"))[0] == 0


def test_a_moving_target_is_found_where_it_was_and_the_picture_stays_trustworthy() -> None:
    report = shot("standard", "moving-target")
    share, stated = found(report)
    assert report.trustworthy
    assert share > 10 * stated
    assert report.movement is not None
    mask, rows = report.mask(), report.mask().shape[0]
    marked = (mask & 4) != 0
    assert marked.mean() == pytest.approx(share + report.movement.spread)
    # The wheel is 42 % of the height, from 29 % on; above and below nothing moves.
    wheel = slice(round(0.28 * rows), round(0.72 * rows))
    assert marked[wheel].mean() > 20 * stated
    outside = np.delete(marked, np.arange(wheel.start, wheel.stop), axis=0)
    assert outside.mean() < 2 * stated
    first = report.movement.places[0]
    assert wheel.start <= first.top < first.bottom <= wheel.stop + 4
    assert first.right - first.left > 50


def test_lamps_that_flicker_over_the_whole_picture_are_no_movement(tmp_path: Path) -> None:
    scene = tmp_path / "lamps.json"
    scene.write_text(
        '{"name": "lamps", "picture": "cloth", "photons_s": 2e7, "shape": [240, 320],'
        ' "lamps": {"mains_hz": 50, "depth": 0.4}}'
    )
    report = shot("standard", str(scene))
    assert any(frame.ratio and not frame.ratio.agrees for frame in report.frames)
    share, stated = found(report)
    assert share < 3 * max(stated, FALSE_ALARMS)
    assert report.movement is not None
    assert report.movement.places == ()


@pytest.mark.parametrize("sensor", ["standard", "phone"])
def test_folder_and_memory_have_the_same_marks(sensor: str, tmp_path: Path) -> None:
    """The phone's mosaic marks all pixels that a sample contributed to."""
    masks = []
    for path in (None, tmp_path / "capture"):
        with camctl.open_camera(
            "sim", scene="moving-target", sensor=sensor, size="160x120"
        ) as camera:
            request = camctl.CaptureRequest(ratios=(1.0, 4.0))
            masks.append(camctl.capture(camera, request, path).mask())
    assert np.array_equal(masks[0], masks[1])
    assert np.count_nonzero(masks[0] & 4) > 0
    assert camctl.read_report(tmp_path / "capture").movement is not None


@pytest.mark.parametrize(
    ("sensor", "scene"),
    [
        ("complete", "room"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (("ccd", "ball"), ("ccd", "night-street"), ("complete", "colour-chart"))
        ),
    ],
)
def test_light_that_spreads_from_saturated_pixels_is_no_movement(sensor: str, scene: str) -> None:
    report = shot(sensor, scene, seed=1, size="320x240")
    share, stated = found(report)
    assert share <= stated <= FALSE_ALARMS
    assert report.movement is not None
    assert report.movement.area < 0.01
    assert all(frame.attempts == 1 for frame in report.frames)


@pytest.mark.slow
def test_light_that_flows_out_of_lamps_is_named_as_that() -> None:
    """Streaks end in pixels that are marked, and only became brighter, beside saturated ones."""
    request = camctl.CaptureRequest(dynamic_range="auto", ratios=(1.0, 8.0, 64.0))
    with camctl.open_camera("sim", scene="night-street", sensor="complete") as camera:
        movement = camctl.capture(camera, request).movement
    assert movement is not None
    assert movement.places == ()
    assert movement.area == 0
    assert movement.spread > 2e-4


@pytest.mark.parametrize("sensor", ["standard", "phone", "complete"])
def test_things_that_move_before_a_saturated_wall_are_reported(sensor: str) -> None:
    report = shot(sensor, "moving-target", size="240x180")
    assert report.movement is not None
    assert min(frame.saturated_fraction for frame in report.frames[1:]) > 0.5
    assert report.movement.share > 0.02
    assert report.movement.area > 0.04


@pytest.mark.parametrize(
    "sensor",
    [
        "complete",
        "webcam",
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("consumer", "ccd")),
    ],
)
def test_a_moving_target_is_found_by_sensors_whose_charge_spreads(sensor: str) -> None:
    share, stated = found(shot(sensor, "moving-target", seed=1, size="240x180"))
    assert share > 10 * stated


def compressed(picture: Floats, quality: int) -> NDArray[Any]:
    """Return light, 1 at full scale, as a JPEG file in sRGB shows it; (rows, columns, 3)."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
    levels = standard_response("srgb", 8).levels
    codes = np.searchsorted(levels, picture, side="right").astype(np.uint8)
    coded = cv2.imencode(".jpg", codes, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    decoded = cv2.imdecode(coded, cv2.IMREAD_COLOR)
    assert decoded is not None
    return np.asarray(decoded)


def rows_of(frames: list[Pixels]) -> FrameRows:
    return lambda position, part: frames[position][part]


def movement_of(frames: list[Pixels], exposures: tuple[float, ...]) -> Movement:
    """Return what moved in photographs in sRGB, whose noise is not known."""
    check = NeighbourCheck(standard_response("srgb", 8), 0, camctl.Layout.RGB)
    samples = [check.sample(frame).patches for frame in frames]
    sides = [Side(k, exposure, None) for k, exposure in enumerate(exposures)]
    pairs = [
        Pair(check.scale, short, long, long.exposure / short.exposure, both, 3)
        for (short, long), both in zip(pairwise(sides), pairwise(samples), strict=True)
    ]
    movement = find_movement(rows_of(frames), frames[0].shape, pairs)
    assert movement is not None
    return movement


def window(exposures: tuple[float, ...]) -> list[Floats]:
    """Return photographs of a bright window with bars in a dim wall, at 1 = full scale."""
    rng = np.random.default_rng(0)
    light = np.broadcast_to(np.geomspace(0.002, 0.02, 640), (480, 640)).copy()
    light[80:400, 160:480] = 0.35
    for bar in range(4):
        light[80:400, 160 + bar : 480 : 24] = light[80 + bar : 400 : 40, 160:480] = 0.01
    light = light[..., None] * np.array([1.0, 0.8, 0.6])
    frames = [light * exposure for exposure in exposures]
    return [E + np.sqrt(E / 8000) * rng.normal(size=E.shape) for E in frames]


def test_errors_of_jpeg_files_at_edges_are_no_movement() -> None:
    exposures = (1.0, 2.0, 4.0, 8.0)
    frames = [compressed(np.clip(E, 0, 1.001), 75) for E in window(exposures)]
    movement = movement_of(frames, exposures)
    assert movement.found.places == ()
    assert movement.found.share < 1.1 * FALSE_ALARMS
    assert movement.rows(80, 400)[:, 160:480].mean() < 1.5 * FALSE_ALARMS


@pytest.mark.parametrize("changed", some([0.02, 0.8], every=2))
def test_a_box_that_only_the_longest_photograph_has_is_found_in_all_of_its_parts(
    changed: float,
) -> None:
    """Its brightness is rare elsewhere: it must not be taken for what that brightness shows."""
    exposures, box = (1.0, 4.0, 16.0), (slice(200, 280), slice(100, 220))
    rng = np.random.default_rng(2)
    light = np.broadcast_to(np.geomspace(0.003, 0.9, 640), (480, 640))[..., None]
    frames = []
    for exposure in exposures:
        E = light * exposure * np.array([1.0, 0.8, 0.6])
        if exposure == exposures[-1]:
            E[box] = changed
        E = E + np.sqrt(E / 8000) * rng.normal(size=E.shape)
        frames.append(compressed(np.clip(E, 0, 1.001), 92))
    movement = movement_of(frames, exposures)
    marks = movement.rows(0, 480).max(axis=2)
    halves = np.hsplit(marks[box], 2)
    assert min(half.mean() for half in halves) > 0.9
    assert marks.mean() < 0.05


@pytest.mark.parametrize("noise", [FrameNoise(39.0, 0.1), None])
@pytest.mark.parametrize("contrast", [1.8, 0.6])
def test_a_thing_of_sixty_pixels_is_found_whether_noise_is_known_or_not(
    noise: FrameNoise | None, contrast: float
) -> None:
    """It is in the longer frame, at a tenth of full scale; the promise of the mask holds."""
    rng, thing = np.random.default_rng(4), (slice(100, 106), slice(150, 160))
    light = np.broadcast_to(np.geomspace(0.01, 0.9, 320), (240, 320))
    check = NeighbourCheck(linear_response(8), 0)
    frames: list[Pixels] = []
    for exposure in (0.25, 1.0):
        E = light * exposure
        if exposure == 1:
            E[thing] *= contrast
        E = E + np.hypot(np.sqrt(E / 39 / 256), 0.1 / 256) * rng.normal(size=E.shape)
        frames.append(np.clip(E * 256, 0, 255).astype(np.uint8))
    samples = check.sample(frames[0]).patches, check.sample(frames[1]).patches
    pair = Pair(check.scale, Side(0, 0.25, noise), Side(1, 1.0, noise), 4.0, samples)
    movement = find_movement(rows_of(frames), frames[0].shape, [pair])
    assert movement is not None
    marks = movement.rows(0, 240) > 0
    (place,) = movement.found.places
    assert place.top <= 100 < 106 <= place.bottom
    assert place.left <= 150 < 160 <= place.right
    assert marks[thing].mean() > 0.8
    marks[96:110, 146:164] = False  # with the border that means reach
    assert marks.mean() < FALSE_ALARMS


def pair_of(frames: list[Pixels], exposures: tuple[float, float], noise: FrameNoise) -> Pair:
    check = NeighbourCheck(linear_response(8, phase=0.5, levels=239), 16)
    samples = check.sample(frames[0]).patches, check.sample(frames[1]).patches
    sides = [Side(k, each, noise) for k, each in enumerate(exposures)]
    return Pair(check.scale, sides[0], sides[1], exposures[1] / exposures[0], samples)


@pytest.mark.parametrize("black", [15.6, 16.0, 16.4])
def test_dark_things_are_found_whatever_the_fraction_of_the_black_level_is(black: float) -> None:
    """Black is a whole number: by how much it is wrong, the frames show, and the limits follow."""
    rng, thing = np.random.default_rng(7), (slice(90, 150), slice(20, 100))
    light = np.broadcast_to(np.geomspace(0.003, 0.1, 320), (240, 320))
    frames: list[Pixels] = []
    for exposure in (1.0, 8.0):
        levels = light * exposure * 239
        if exposure == 1:
            levels = levels.copy()
            levels[thing] += 1.2
        levels = rng.poisson(levels * 100) / 100 + rng.normal(0, 0.8, levels.shape)
        frames.append(np.clip(np.rint(levels + black), 0, 255).astype(np.uint8))
    pair = pair_of(frames, (1.0, 8.0), FrameNoise(100.0, 0.8))
    movement = find_movement(rows_of(frames), frames[0].shape, [pair])
    assert movement is not None
    marks = movement.rows(0, 240) > 0
    assert marks[thing].mean() > 0.45
    marks[86:154, 16:104] = False
    assert marks.mean() < FALSE_ALARMS


def moved_in_mono() -> Movement | None:
    """Return what moved in frames with samples that saturate."""
    rng, light = np.random.default_rng(5), np.linspace(0.01, 0.4, 230) * np.ones((150, 1))
    moved = light.copy()
    moved[40:60, 30:70] *= 1.5
    moved[135:, 50:60] *= 0.6
    frames: list[Pixels] = []
    for exposure, each in ((1.0, light), (3.0, moved)):
        levels = rng.poisson(each * exposure * 23900) / 100 + rng.normal(0, 0.8, each.shape)
        frames.append(np.clip(np.rint(levels + 16), 0, 255).astype(np.uint8))
    pair = pair_of(frames, (1.0, 3.0), FrameNoise(100.0, 0.8))
    return find_movement(rows_of(frames), frames[0].shape, [pair])


def moved_in_photographs() -> Movement | None:
    """Return what moved in photographs with edges, of which the longest one saturates."""
    exposures = (1.0, 2.0, 8.0)
    lights = window(exposures)
    lights[1][430:, 30:70] *= 1.4
    lights[1][200:230, 300:340, 2] *= 0.7
    frames = [compressed(np.clip(E, 0, 1.001)[:470, :637], 92) for E in lights]
    return movement_of(frames, exposures)


@pytest.mark.parametrize("found", [moved_in_mono, moved_in_photographs])
def test_compiled_code_finds_the_same(
    found: Callable[[], Movement | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """In areas within the picture and at its edges, with samples that saturate, and means."""
    pytest.importorskip("numba")
    from camctl.model import compiled_residuals

    monkeypatch.setattr(marks, "STRIP_SAMPLES", 1 << 14)
    monkeypatch.setattr(marks, "_AREA_SAMPLES", 1 << 12)
    monkeypatch.setattr(marks, "SAMPLES_WORTH_LOADING", 1 << 60)
    numpy = found()
    monkeypatch.setattr(marks, "SAMPLES_WORTH_LOADING", 0)
    compared = Mock(wraps=compiled_residuals.compare)
    monkeypatch.setattr(compiled_residuals, "compare", compared)
    compiled = found()
    compared.assert_called()
    assert numpy is not None
    assert compiled is not None
    assert numpy.found.places
    assert numpy.found == compiled.found
    np.testing.assert_array_equal(numpy.marks, compiled.marks)
    np.testing.assert_array_equal(numpy.cells, compiled.cells)


def test_borders_have_no_more_false_alarms_than_the_rest() -> None:
    rng, marks = np.random.default_rng(8), []
    for _ in range(20):
        frames: list[Pixels] = [
            np.rint(16 + each + rng.normal(0, 2, (120, 160))).astype(np.uint8) for each in (10, 40)
        ]
        pair = pair_of(frames, (1.0, 4.0), FrameNoise(1e6, 2.0))
        movement = find_movement(rows_of(frames), frames[0].shape, [pair])
        assert movement is not None
        marks.append(movement.rows(0, 120) > 0)
    border = np.ones((120, 160), np.bool_)
    border[2:-2, 2:-2] = False
    assert np.mean([each[border].mean() for each in marks]) < FALSE_ALARMS


@pytest.mark.parametrize(
    ("is_plain", "moves"),
    [
        (True, (0, 1, 2)),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((False, (1,)), (True, (1,)), (False, (0, 1, 2)))
        ),
    ],
)
def test_a_thing_that_covers_a_third_of_the_picture_is_not_taken_for_noise(
    is_plain: bool, moves: tuple[int, ...]
) -> None:
    """Noise that is not known is measured where nothing moved."""
    exposures, rng = (1.0, 4.0, 16.0), np.random.default_rng(3)
    y, x = np.mgrid[:480, :640]
    wall = 0.02 * np.exp(np.sin(x / 37) + np.sin(y / 23) + x / 640)
    thing = 0.004 * (np.ones_like(wall) if is_plain else np.exp(np.sin(x / 11) + np.sin(y / 17)))
    lights, frames = [], []
    for k, exposure in enumerate(exposures):
        covered = np.zeros(wall.shape, np.bool_)
        if k in moves:
            covered[60:420, 40 + 90 * k : 320 + 90 * k] = True
        lights.append(np.where(covered, thing, wall))
        E = lights[-1][..., None] * exposure * np.array([1.0, 0.8, 0.6])
        E = E + np.sqrt(E / 8000) * rng.normal(size=E.shape)
        frames.append(compressed(np.clip(E, 0, 1.001), 92))
    ratio = np.max(lights, axis=0) / np.min(lights, axis=0)
    differs = ratio > 1.5
    assert 0.15 < differs.mean() < 0.45
    movement = movement_of(frames, exposures)
    marks = movement.rows(0, 480).max(axis=2)
    assert marks[differs].mean() > 0.9
    assert marks[ratio == 1].mean() < 0.015
    assert movement.found.false_alarms < 1.25 * FALSE_ALARMS


@pytest.mark.parametrize(
    ("quality", "moves"),
    [
        (92, True),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in ((75, False), (92, False), (75, True))
        ),
    ],
)
def test_noise_that_is_not_known_is_measured_in_the_frames(quality: int, moves: bool) -> None:
    """Photographs: neither the noise of the sensor nor the error of JPEG files is known."""
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
    rng = np.random.default_rng(0)
    fine = cv2.GaussianBlur(rng.normal(size=(480, 640)), (0, 0), 4) * 12
    light = np.exp(np.linspace(-6, 0, 640)[None, :] + np.clip(fine, -3, 3) - 1.5)
    light = light[..., None] * np.array([1.0, 0.8, 0.6])
    exposures, frames = (1.0, 4.0, 16.0), []
    for k, exposure in enumerate(exposures):
        E = light * exposure
        if moves and k == 1:
            E[200:260, 300:380] *= 0.3
        noisy = E + np.sqrt(E / 5000) * rng.normal(size=E.shape)
        frames.append(compressed(np.clip(noisy, 0, 1.001), quality))
    movement = movement_of(frames, exposures)
    share, stated = movement.found.share, movement.found.false_alarms
    if not moves:
        assert movement.found.places == ()
        assert share <= stated <= FALSE_ALARMS
        return
    first = movement.found.places[0]
    assert 190 <= first.top < first.bottom <= 270
    assert 290 <= first.left < first.right <= 390
    assert share > 3 * stated


def test_frames_without_samples_in_common_show_no_movement_and_no_rest() -> None:
    with small_camera("standard", np.full((48, 64), 0.5, np.float32)) as camera:
        far = camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 1000), base_s=0.01))
        near = camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 1.5), base_s=0.01))
    assert far.movement is not None
    assert near.movement is not None
    assert (far.movement.compared, far.movement.is_seen) == (0.0, False)
    assert (near.movement.compared, near.movement.is_seen) == (1.0, True)
