"""Arrays in, light out: accuracy beside rivals, standard deviations and masks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from sampling import some

import camctl
from camctl.evidence.marks import FALSE_ALARMS
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import desired_response
from camctl.model.response.measured import measured_response
from camctl.model.sensor import SensorModel

Floats = NDArray[np.float64]
DECADES = (-4, -3, -2, -1)


def camera(name: str | int, data: Path | None = None) -> CameraResponse:
    """Return a standard response of 8 bits, or a measured one by its place in the data."""
    if isinstance(name, str):
        return camctl.standard_response(name, 8)
    assert data is not None
    curves = np.load(data / "dorf" / "curves.npz")
    return measured_response(curves["irradiance"][name], curves["brightness"][name])


def shot(
    light: Floats,
    exposures: Sequence[float],
    real: CameraResponse,
    noise: FrameNoise,
    seed: int = 0,
) -> list[NDArray[np.unsignedinteger]]:
    """Return frames with photon and read noise, which arise before the response."""
    rng, full = np.random.default_rng(seed), real.M + 1
    step = real.levels[1] - real.levels[0]
    below = real.levels[0] - step * np.arange(noise.black, 0, -1)
    thresholds = np.concatenate([below, real.levels])
    frames: list[NDArray[np.unsignedinteger]] = []
    for exposure in exposures:
        x = exposure * light
        if math.isfinite(noise.electrons_per_level):
            electrons = full * noise.electrons_per_level
            x = rng.poisson(x * electrons) / electrons
        x = x + rng.normal(0, noise.read_noise_levels / full, light.shape)
        values = np.searchsorted(thresholds, x, "right")
        frames.append(
            values.astype(np.uint8) if thresholds.size < 256 else values.astype(np.uint16)
        )
    return frames


def gradient(rows: int = 96, columns: int = 1024) -> Floats:
    """Return light over four decades, with patches of nearly equal light."""
    return np.tile(np.geomspace(1e-4, 0.95, columns), (rows, 1))


def errors(found: Floats, light: Floats, least: float) -> list[float]:
    """Return the rms of ln(found / light) by decade of light; no light found is below `least`."""
    ratio = np.log(np.maximum(found, least) / light)
    decades = [(light >= 10.0**k) & (light < 10.0 ** (k + 1)) for k in DECADES]
    return [float(np.sqrt(np.mean(ratio[each] ** 2))) for each in decades]


def inverse_variance(
    frames: Sequence[NDArray[Any]],
    exposures: Sequence[float],
    real: CameraResponse,
    noise: FrameNoise,
    true: Floats,
) -> Floats:
    """Return the mean of the light of each sample, weighted as the true light demands."""
    sensor = SensorModel(real, 0)
    total: Floats = np.zeros(true.shape)
    weights: Floats = np.zeros(true.shape)
    for frame, exposure in zip(frames, exposures, strict=True):
        x = exposure * true
        variance = sensor.variance(x, noise) + sensor.step(x) ** 2 / 12
        weight = (frame <= sensor.highest(noise)) * exposure**2 / variance
        total += weight * sensor.light[frame] / exposure
        weights += weight
    return np.where(weights > 0, total / np.maximum(weights, 1e-300), sensor.full)


def debevec(
    frames: Sequence[NDArray[Any]], exposures: Sequence[float], real: CameraResponse
) -> Floats:
    """Return OpenCV's merge with the true response."""
    edges = np.concatenate([[0.0], real.levels, [1.0]])
    table = ((edges[:-1] + edges[1:]) / 2).astype(np.float32)
    table = np.ascontiguousarray(np.broadcast_to(table[:, None, None], (256, 1, 3)))
    is_mono = frames[0].ndim == 2
    colours = [np.repeat(each[..., None], 3, axis=2) if is_mono else each for each in frames]
    merged = cv2.createMergeDebevec().process(colours, np.array(exposures, "f4"), table)
    return np.asarray(merged[..., 0] if is_mono else merged, np.float64)


SETS = [
    ("linear", (1, 4, 16, 64), FrameNoise(20.0, 0.6)),
    ("srgb", (1, 4, 16, 64), FrameNoise(30.0, 1.0)),
    ("rec709", (1, 8, 64), FrameNoise(15.0, 0.7)),
    (5, (1, 4, 16, 64), FrameNoise(30.0, 0.6)),
    (20, (1, 3, 9, 27), FrameNoise(25.0, 0.8)),
    (40, (1, 8, 64), FrameNoise(15.0, 0.6)),
    (70, (1, 2, 4, 8, 16, 32), FrameNoise(60.0, 1.0)),
    (90, (1, 16, 256), FrameNoise(40.0, 0.5)),
]


@pytest.mark.parametrize(("name", "exposures", "noise"), some(SETS, every=3))
def test_light_is_at_least_as_exact_as_rivals_with_the_true_response(
    name: str | int, exposures: tuple[int, ...], noise: FrameNoise, real_data: Path
) -> None:
    """Noise is not known to it; the inverse variance of a rival knows noise and the true light."""
    real, light = camera(name, real_data), gradient()
    frames = shot(light, exposures, real, noise)
    found = camctl.combine(frames, exposures, response=real)
    assert [each.code for each in found.findings] == []
    # Below one level of the longest exposure, any estimate is a matter of the prior.
    least = real.levels[0] / max(exposures) / 2
    mine = errors(found.irradiance.astype(np.float64), light, least)
    best = errors(inverse_variance(frames, exposures, real, noise, light), light, least)
    others = errors(debevec(frames, exposures, real), light, least)
    for own, known, other in zip(mine, best, others, strict=True):
        assert own <= 1.02 * known
        assert own <= 1.0001 * other  # equal where one frame alone shows the light
    z = (found.irradiance - light) / found.sd
    within = found.mask & 3 == 0
    assert np.std(z[within]) == pytest.approx(1.0, abs=0.05)
    assert 0.66 <= np.mean(np.abs(z[within]) < 1) <= 0.70
    assert 0.94 <= np.mean(np.abs(z[within]) < 1.96) <= 0.96
    assert np.mean(found.mask & 4 > 0) < FALSE_ALARMS


@pytest.mark.parametrize("level", [0.25, 0.06])
@pytest.mark.parametrize(
    ("bits", "black", "noise"), [(12, 64, FrameNoise(2.5, 1.2)), (8, 0, FrameNoise(20.0, 0.9))]
)
def test_unknown_noise_of_a_uniform_field_is_measured(
    level: float, bits: int, black: int, noise: FrameNoise
) -> None:
    """Two pairs of frames in range distinguish photon noise from read noise."""
    real, times_s = camctl.linear_response(bits, levels=2**bits - 1 - black), (0.004, 0.008, 0.014)
    light = np.full((160, 200), level)
    frames = shot(light, [each / 0.004 for each in times_s], real, replace(noise, black=black))
    found = camctl.combine(frames, times_s, response=real, black=black)
    assert found.findings == ()
    assert np.std(found.irradiance) / np.median(found.sd) == pytest.approx(1.0, abs=0.05)
    assert np.mean(found.irradiance) == pytest.approx(level / 0.004, rel=2e-3)


EXPOSURES = (1.0, 4.0, 16.0)
NOISE = FrameNoise(30.0, 0.7)


@pytest.fixture(scope="module")
def frames() -> list[NDArray[np.unsignedinteger]]:
    """Three frames of a gradient, 8 bits, linear."""
    light = np.tile(np.geomspace(5e-3, 0.95, 256), (48, 1))
    return shot(light, EXPOSURES, camera("linear"), NOISE)


def test_frames_may_be_a_stack_a_generator_or_lazy(
    frames: list[NDArray[np.unsignedinteger]],
) -> None:
    expected = camctl.combine(frames, EXPOSURES)
    stack = np.stack(frames)
    kinds: list[Any] = [stack, (each for each in frames)]
    dask = pytest.importorskip("dask.array")
    kinds.append(dask.from_array(stack, chunks=(1, 16, 256)))
    for kind in kinds:
        found = camctl.combine(kind, EXPOSURES)
        for name in ("irradiance", "sd", "mask", "sum"):
            assert np.array_equal(getattr(found, name), getattr(expected, name))


def test_colours_may_have_a_response_each(frames: list[NDArray[np.unsignedinteger]]) -> None:
    colours = [np.stack([each, each[::-1], each], axis=2) for each in frames]
    curves = [camera("linear"), camera("linear"), camera("srgb")]
    found = camctl.combine(colours, EXPOSURES, response=curves, noise=NOISE)
    for channel, curve in enumerate(curves):
        planes = [each[..., channel] for each in colours]
        single = camctl.combine(planes, EXPOSURES, response=curve, noise=NOISE)
        assert np.array_equal(found.irradiance[..., channel], single.irradiance)
        assert np.array_equal(found.mask[..., channel] & 3, single.mask & 3)
    mosaic = camctl.combine(frames, EXPOSURES, response=curves, layout="rggb", noise=NOISE)
    blue = camctl.combine(frames, EXPOSURES, response=curves[2], noise=NOISE)
    assert np.array_equal(mosaic.irradiance[1::2, 1::2], blue.irradiance[1::2, 1::2])


def test_exposures_in_seconds_give_irradiance_per_second(
    frames: list[NDArray[np.unsignedinteger]],
) -> None:
    """The order of the frames does not matter either."""
    first = camctl.combine(frames, EXPOSURES, noise=NOISE)
    seconds = [0.01 * each for each in EXPOSURES]
    again = camctl.combine(frames[::-1], seconds[::-1], noise=NOISE)
    assert np.allclose(again.irradiance, 100 * first.irradiance, rtol=1e-5)
    assert np.array_equal(again.sum, first.sum)


def test_the_sum_is_inverted_as_the_paper_has_it(
    frames: list[NDArray[np.unsignedinteger]],
) -> None:
    found = camctl.combine(frames, EXPOSURES, noise=NOISE, method="sum")
    total = np.sum(frames, axis=0, dtype=np.uint32)
    assert np.array_equal(found.sum, total)
    assert found.sum.dtype == np.uint16
    real = camctl.linear_response(8)
    desired = desired_response("linear", 255 * 16.0)
    inverse = Posterior(EffectiveCamera.of(real, EXPOSURES), desired, [NOISE] * 3).inverse
    within = found.mask & 2 == 0
    assert np.array_equal(found.irradiance[within], inverse.E.astype("f4")[total][within])


def test_what_jpeg_adds_is_part_of_the_noise() -> None:
    """Ringing beside saturated edges was taken for light: errors of 32 % where 2 % are possible."""
    real, exposures = camera("srgb"), (1.0, 3.0, 9.0, 27.0)
    row, column = np.mgrid[:256, :384]
    texture = np.exp(0.8 * np.sin(row / 2.1) * np.sin(column / 1.7))
    light = np.where((row // 40 + column // 40) % 2, 0.3, 0.004) * texture
    light[:, 192:] = np.repeat(np.geomspace(0.004, 0.9, 6), 32)
    frames = shot(light, exposures, real, FrameNoise(30.0, 0.7))
    files = [cv2.imencode(".jpg", each, [cv2.IMWRITE_JPEG_QUALITY, 90])[1] for each in frames]
    lossy = [np.asarray(cv2.imdecode(each, cv2.IMREAD_UNCHANGED), np.uint8) for each in files]
    assert camctl.combine(frames, exposures, response=real).noise[0][0].file is None
    found = camctl.combine(lossy, exposures, response=real)
    noise = found.noise[0][0]
    assert noise.file is not None
    # The noise is that of the camera, though a file leaves less of it where the scene is smooth.
    assert noise.electrons_per_level == pytest.approx(30, rel=0.12)
    assert noise.read_noise_levels == pytest.approx(0.7, rel=0.12)
    mine, other = (
        np.sqrt(np.mean(np.log(each / light) ** 2))
        for each in (found.irradiance, debevec(lossy, exposures, real))
    )
    assert mine < 0.6 * other
    z = ((found.irradiance - light) / found.sd)[found.mask & 3 == 0]
    assert 0.7 < np.std(z) < 1.5


def windows(rows: int = 192, columns: int = 288) -> Floats:
    """Return coloured walls, and windows of other colours that are 100 times as bright."""
    rng = np.random.default_rng(1)
    walls, panes = (
        np.kron(rng.uniform(0.3, 1.0, (rows // k, columns // k, 3)), np.ones((k, k, 1)))
        for k in (24, 12)
    )
    row, column = np.mgrid[:rows, :columns]
    is_pane = ((row - 31) // 37 % 3 == 1) & ((column - 13) // 29 % 3 == 1)
    light = np.where(is_pane[..., np.newaxis], 0.9 * panes, 0.004 * walls)
    return np.asarray(cv2.GaussianBlur(light, (0, 0), 0.7))


@pytest.mark.parametrize("quality", some([90, 98], every=2))
def test_colours_of_jpeg_files_are_as_unsure_as_their_chroma(quality: int) -> None:
    """Standard deviations were up to 30,000 times too small beside windows that saturate."""
    real, exposures, light = camera("srgb"), (1.0, 4.0, 16.0, 64.0), windows()
    frames = shot(light, exposures, real, FrameNoise(30.0, 0.7))
    files = [
        cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        for each in frames
    ]
    lossy = [np.asarray(cv2.imdecode(each, 1), np.uint8)[..., ::-1] for each in files]
    found = camctl.combine(lossy, exposures, response=real)
    z = np.abs((found.irradiance - light) / found.sd)[found.mask & 3 == 0]
    assert 0.6 < np.mean(z < 0.99446) < 0.85
    assert np.mean(z < 1.95996) > 0.85
    assert np.sqrt(np.mean(z**2)) < 2
    assert np.isinf(found.sd).mean() < 0.05
    mine, other = (
        np.sqrt(np.mean(np.log(np.maximum(each, 1e-5) / light) ** 2))
        for each in (found.irradiance, debevec(lossy, exposures, real))
    )
    assert mine < other


def test_light_beside_saturated_colours_is_that_of_each_sample_by_itself(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It depended on which other samples were computed at the same time."""
    real, exposures, light = camera("srgb"), (1.0, 2.0, 4.0, 8.0, 16.0), windows(96, 144)
    lossy = []
    for each in shot(light, exposures, real, FrameNoise(30.0, 0.7)):
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = [camctl.combine(lossy, exposures, response=real)]
    monkeypatch.setattr("camctl.pictures.chroma_light._BLOCK", 1 << 6)
    found.append(camctl.combine(lossy, exposures, response=real))
    for name in ("irradiance", "sd"):
        np.testing.assert_array_equal(*(getattr(each, name) for each in found))


@pytest.mark.slow
def test_light_of_colours_is_that_of_numpy_where_it_is_compiled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pytest.importorskip("numba")
    real, exposures, light = camera("srgb"), (4.0, 1.0, 64.0, 16.0, 256.0), windows()
    light = light[:-1, :-1]
    light = light * np.exp(np.random.default_rng(3).normal(0, 0.1, (*light.shape[:2], 1)))
    lossy = []
    for each in shot(light, exposures, real, FrameNoise(30.0, 0.7)):
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 90])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = []
    for least in (1 << 60, 1):
        monkeypatch.setattr("camctl.pictures.chroma_light._WORTH_LOADING", least)
        found.append(camctl.combine(lossy, exposures, response=real))
    numpy, compiled = found
    known = np.isfinite(numpy.sd)
    assert np.array_equal(known, np.isfinite(compiled.sd))
    off = np.abs(numpy.irradiance - compiled.irradiance)[known] / numpy.sd[known]
    assert off.max() < 1e-3
    np.testing.assert_allclose(compiled.sd[known], numpy.sd[known], rtol=1e-4)
    assert np.mean(compiled.irradiance == numpy.irradiance) > 0.9


def test_light_beside_saturated_colours_is_as_exact_as_with_all_frames() -> None:
    """Frames with another colour saturated were left out: of two, the darker one was all."""
    real, exposures, light = camera("srgb"), (1.0, 4.0), windows()
    lossy = []
    for each in shot(light, exposures, real, FrameNoise(30.0, 0.7)):
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = camctl.combine(lossy, exposures, response=real)
    mine, other = (
        np.sqrt(np.mean(np.log(np.maximum(each, 1e-4) / light) ** 2))
        for each in (found.irradiance, debevec(lossy, exposures, real))
    )
    assert mine < other


def test_white_beside_lamps_in_jpeg_files_is_not_taken_for_light_above_full_scale(
    real_data: Path,
) -> None:
    """Compression lifts some samples to white: with a shoulder they moved light by half of it."""
    real, rng = camera(60, real_data), np.random.default_rng(5)
    light, exposures = np.full((256, 256), 0.02), [1.0, 3.0, 9.0, 27.0]
    for _ in range(150):
        row, column, side = (int(each) for each in rng.integers((0, 0, 2), (240, 240, 12)))
        lamp = math.exp(rng.uniform(math.log(0.02), math.log(0.95)))
        light[row : row + side, column : column + side] = lamp
    frames = []
    for each in shot(light, exposures, real, FrameNoise(20.0, 0.9)):
        data = cv2.imencode(".jpg", each, [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
        frames.append(np.asarray(cv2.imdecode(data, 0), np.uint8))
    found = camctl.combine(frames, exposures, response=real)
    known = (found.mask & 3 == 0) & np.isfinite(found.sd)
    mine, rival = (
        np.sqrt(np.mean(np.log(np.maximum(each, 1e-6) / light)[known] ** 2))
        for each in (found.irradiance, debevec(frames, exposures, real))
    )
    assert mine < rival / 2


def test_detail_that_all_jpeg_files_lose_alike_is_part_of_the_standard_deviation() -> None:
    """It is in no difference of frames: errors were twice as large as their `sd`."""
    real, exposures = camera("srgb"), tuple(1.7**k for k in range(12))
    rng = np.random.default_rng(2)
    fine = cv2.GaussianBlur(rng.normal(0, 1, (256, 384)), (0, 0), 0.8)
    coarse = cv2.resize(rng.normal(0, 1, (8, 12)), (384, 256), interpolation=cv2.INTER_CUBIC)
    light = np.exp(0.4 * fine + coarse)[..., np.newaxis] * (0.01, 0.008, 0.006)
    frames = shot(light, exposures, real, FrameNoise(40.0, 0.7))
    lossy = []
    for each in frames:
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 85])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = camctl.combine(lossy, exposures, response=real)
    z = np.abs((found.irradiance - light) / found.sd)[found.mask & 3 == 0]
    z = z[np.isfinite(z)]
    assert z.size > light.size / 2
    assert 0.85 < np.sqrt(np.mean(z**2)) < 1.15
    assert 0.62 < np.mean(z < 0.99446) < 0.76


def test_red_points_that_saturate_are_as_unsure_as_shorter_frames_show() -> None:
    """Longer frames show less colour of them: errors were up to 195 of their `sd`."""
    real, exposures = camera("srgb"), tuple(1.6**k for k in range(12))
    rng = np.random.default_rng(3)
    light = np.full((192, 288, 3), 0.004) * rng.uniform(0.8, 1.2, (192, 288, 1))
    row, column = np.mgrid[:192, :288]
    is_point = (row % 13 == 5) & (column % 11 == 3)
    light[is_point] *= (25, 4, 2)
    lossy = []
    for each in shot(light, exposures, real, FrameNoise(40.0, 0.7)):
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = camctl.combine(lossy, exposures, response=real, noise=FrameNoise(40.0, 0.7))
    z = ((found.irradiance - light) / found.sd)[is_point]
    assert np.sqrt(np.mean(z[:, 0] ** 2)) < 10
    assert np.abs(z).max() < 25


def test_dark_colours_of_jpeg_files_are_not_the_darker_for_many_black_frames() -> None:
    """Frames lose a dark colour together: red that few frames show was 26 % too dark."""
    real = CameraResponse((np.arange(1, 256) / 256) ** 0.75, "coarse at black")
    exposures = tuple(1.35**k for k in range(10))
    rng = np.random.default_rng(3)
    coarse = cv2.resize(rng.normal(0, 1, (24, 36)), (384, 256), interpolation=cv2.INTER_CUBIC)
    fine = cv2.GaussianBlur(rng.normal(0, 1, (256, 384)), (0, 0), 1.2)
    first = real.levels[0] / max(exposures)
    light = first * np.exp(0.5 * coarse + 0.6 * fine)[..., np.newaxis] * (2.2, 1.4, 0.7)
    light[:, :128] *= 60  # where the noise is measured
    lossy = []
    for each in shot(light, exposures, real, FrameNoise(25.0, 0.6)):
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 98])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = camctl.combine(lossy, exposures, response=real)
    few = np.count_nonzero(lossy, axis=0)
    dark = (few >= 1) & (few <= 2)
    dark[..., 1:] = False
    assert np.count_nonzero(dark) > 2000
    ratios = np.log(found.irradiance / light)[dark]
    assert abs(ratios.mean()) < 0.1
    assert np.sqrt(np.mean(ratios**2)) < 0.2


def test_the_offset_of_a_short_exposure_contradicts_no_longer_one() -> None:
    """Four levels of it are 20 times the light of a wall; most of that was called dark."""
    real, exposures, light = camera("srgb"), tuple(4.0**k for k in range(7)), windows() / 64
    frames = shot(light, exposures, real, FrameNoise(30.0, 0.3))
    lossy = []
    for each in frames:
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    for each, offset in zip(lossy, (4, 3, 2), strict=False):
        np.maximum(each, offset, out=each)
    found = camctl.combine(lossy, exposures, response=real)
    usable = (found.mask & 3 == 0) & np.isfinite(found.sd)
    assert usable.mean() > 0.9
    assert np.median((found.sd / light)[usable]) < 0.2
    assert np.median((np.abs(found.irradiance - light) / light)[usable]) < 0.1


def test_two_levels_are_few_and_enough() -> None:
    frames = [np.array([[8, 9], [10, 9]], np.uint8), np.array([[8, 10], [10, 9]], np.uint8)]
    found = camctl.combine(frames, (1.0, 1.5), black=8, white=10, noise=FrameNoise(math.inf, 0.0))
    assert np.all(np.isfinite(found.irradiance))
    assert found.mask.tolist() == [[1, 0], [2, 0]]


def test_masks_tell_what_is_dark_saturated_and_contradictory(
    frames: list[NDArray[np.unsignedinteger]],
) -> None:
    marked = [each.copy() for each in frames]
    for each in marked:
        each[:2, :2], each[:2, 8:10] = 0, 255
    marked[2][20, 105:115] //= 2
    found = camctl.combine(marked, EXPOSURES, noise=NOISE)
    assert np.all(found.mask[:2, :2] == 1)
    assert np.all(found.mask[:2, 8:10] == 2)
    assert np.all(np.isinf(found.sd[:2, 8:10]))
    assert np.all(found.irradiance[:2, 8:10] == np.float32(camctl.linear_response(8).levels[-1]))
    assert np.all(found.mask[20, 105:115] & 4)
    assert np.count_nonzero(found.mask & 4) - 10 < FALSE_ALARMS * found.mask.size


def test_noise_that_the_frames_do_not_show_gives_no_standard_deviation(
    frames: list[NDArray[np.unsignedinteger]],
) -> None:
    found = camctl.combine(frames[:1], EXPOSURES[:1])
    assert found.noise == ()
    assert np.all(np.isnan(found.sd[found.mask & 2 == 0]))
    (finding,) = found.findings
    assert finding.code == "noise_unknown"
    assert finding.value == np.mean(np.isnan(found.sd))
    middle = SensorModel(camctl.linear_response(8), 0).light[frames[0]]
    assert np.allclose(found.irradiance, middle, rtol=0.02, atol=0.01)


def test_dark_colours_of_jpeg_files_are_found_from_all_frames_that_show_them() -> None:
    """Frames within 3 standard deviations of black did not count: errors were 0.285."""
    real, exposures = camera("srgb"), tuple(1.6**k for k in range(9))
    squares = np.kron(np.random.default_rng(4).uniform(0.5, 1, (12, 18, 3)), np.ones((16, 16, 1)))
    light = np.asarray(cv2.GaussianBlur(squares, (0, 0), 1.0), np.float64)
    light *= np.geomspace(1e-4, 3e-3, 288)[:, np.newaxis]
    light[:48] *= 100
    lossy = []
    for each in shot(light, exposures, real, FrameNoise(25.0, 1.0)):
        data = cv2.imencode(".jpg", each[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
        lossy.append(np.asarray(cv2.imdecode(data, 1), np.uint8)[..., ::-1])
    found = camctl.combine(lossy, exposures, response=real, noise=FrameNoise(25.0, 1.0))
    ratios = np.log(found.irradiance / light)[64:][light[64:] < 1e-3]
    assert abs(ratios.mean()) < 0.03
    assert np.sqrt(np.mean(ratios**2)) < 0.27
