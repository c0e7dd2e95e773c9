"""The preview: a natural picture of any light, without noise, colour shifts or lost shadows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from picture_parts import light_of
from sampling import some

import camctl
from camctl.interface.colour import BT709, CameraColour
from camctl.model.response.camera import CameraResponse
from camctl.model.sensor import SensorModel
from camctl.pictures import preview_light
from camctl.pictures.development import Development
from camctl.pictures.preview import srgb_codes, tone_map
from camctl.pictures.preview_light import ALL, Light, LightReducer
from camctl.pictures.render import DARK, SATURATED, Strip
from camctl.sim.scenes.scene import scene_names
from camctl.system.picture_operations import channels_apart

SCENES = sorted(scene_names())
LONGEST = {"colour-chart": 700.0, "night-street": 70.0, "stars": 5.0}
"""Longest exposure over the shortest one where the camera has none of 1,000 times."""


def strip_of(
    light: NDArray[np.float32], deviation: NDArray[np.float32], mask: NDArray[np.uint8]
) -> Strip:
    planes = channels_apart(light)
    deviations, masks = channels_apart(deviation), channels_apart(mask)
    return Strip(planes, planes, deviations, masks, mask.astype(np.uint16))


def linear(codes: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return the light that a display shows, by the standard's inverse."""
    encoded = codes / 255
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def test_srgb_codes_invert_the_standard() -> None:
    assert np.array_equal(srgb_codes(linear(np.arange(256, dtype=np.uint8))), np.arange(256))
    assert srgb_codes(np.array([-1.0, 2.0])).tolist() == [0, 255]


@pytest.mark.parametrize(
    ("name", "sensor"),
    some(
        [
            ("stars", "complete"),
            *((name, "standard") for name in SCENES),
            ("night-street", "complete"),
        ],
        every=5,
    ),
)
def test_preview_of_each_scene_shows_the_light_in_range(name: str, sensor: str) -> None:
    """Under 2 % of the samples in range are 0, and the picture is neither black nor white."""
    with camctl.open_camera("sim", scene=name, sensor=sensor, size="160x120") as camera:
        # Solving them for each scene takes a second or more.
        ratios = tuple(LONGEST.get(name, 1000.0) ** (k / 3) for k in range(4))
        request = camctl.CaptureRequest(response="log", dynamic_range=16000, ratios=ratios)
        report = camctl.capture(camera, request)
    light, sd, mask = report.radiance(), report.standard_deviation(), report.mask()
    reducer = LightReducer(light.shape[0], light.shape[1], float(light.max()))
    bare = np.where((mask & DARK > 0) & (light <= sd), np.float32(0), light)
    reducer.add(strip_of(bare, sd, mask))
    shown = tone_map(reducer.light())
    in_range = (mask & (DARK | SATURATED)) == 0
    assert (shown[in_range] == 0).mean() < 0.02
    # Light that noise hides is shown darker, so that the noise is not seen.
    known = in_range & (sd < light / 2)
    assert known.any()
    assert 30 < np.median(shown[known]) < 225
    assert np.percentile(shown[in_range], 99.5) > 110


def ratios_of(light: NDArray[np.floating], shown: NDArray[np.uint8]) -> None:
    """Check that the channels have the ratios of the light, as far as 8 bits show them."""
    found = linear(shown)
    visible = found.max(axis=2) > 0.05
    assert visible.any()
    expected = light / light.max(axis=2, keepdims=True)
    got = found / found.max(axis=2, keepdims=True)
    assert np.abs(got - expected)[visible].max() < 0.03


@given(
    st.lists(st.floats(0.1, 1.0), min_size=3, max_size=3),
    st.floats(0.0, 5.0),
)
def test_colours_keep_their_hue_over_decades(colour: list[float], decades: float) -> None:
    column = np.geomspace(1.0, 10.0**decades, 64)[:, np.newaxis, np.newaxis]
    light = np.broadcast_to(column * np.array(colour), (64, 48, 3)).copy()
    ratios_of(light, tone_map(light_of(light)))


WIDER = CameraColour(
    ((1.4, -0.4, 0.0), (0.0, 1.0, 0.0), (0.0, -0.04, 1.04)),
    encoding=tuple(np.linspace(0, 1, 256) ** 2.2),
)
"""Colours as of Adobe RGB."""


@pytest.mark.parametrize("colour", [BT709, WIDER], ids=["sRGB", "wider"])
def test_developed_pictures_keep_the_colours_that_the_curve_of_the_camera_made(
    colour: CameraColour,
) -> None:
    """They are the camera's own in the exposure in which the largest channel is as bright.

    The curve is that of R, G and B in the files, which a display shows in their own colour space.
    """
    light = np.random.default_rng(2).uniform(0.3, 1, (6, 8, 3)).repeat(8, 0).repeat(8, 1)
    matrix = np.array(colour.matrix)
    brightness = np.linspace(0, 1, 255)
    black, levels = 16, brightness[: 255 - 16] ** 2.2 * (0.3 + 0.7 * brightness[: 255 - 16] ** 4)
    steep = CameraResponse(levels / levels[-1], "with a shoulder")
    development = Development((SensorModel(steep, black).light,) * 3, colour)
    shown = tone_map(replace(light_of(light @ matrix.T), development=development))
    exposures = np.geomspace(0.01, 20, 4000)[:, np.newaxis, np.newaxis]
    codes = black + np.searchsorted(steep.levels, exposures * light[4::8, 4::8].reshape(-1, 3))
    pictures = codes
    if colour.encoding:
        displayed = np.array(colour.encoding)[np.minimum(codes, 255)] @ matrix.T
        pictures = srgb_codes(displayed).astype(int)
    for picture, found in zip(
        pictures.swapaxes(0, 1), shown[4::8, 4::8].reshape(-1, 3).astype(int), strict=True
    ):
        nearest = picture[np.abs(picture.max(axis=1) - found.max()).argmin()]
        assert np.abs(nearest - found).max() <= 3
    plain = tone_map(light_of(light @ matrix.T)).astype(int)
    assert np.percentile(np.abs(shown.astype(int) - plain), 90) > 10


def test_light_that_may_be_saturated_is_shown_as_the_light_beside_it() -> None:
    """Beside edges of a JPEG file each frame may be saturated: no bound, and no noise."""
    light = np.broadcast_to(np.array((0.4, 0.6, 1.0), np.float32), (64, 64, 3)).copy()
    deviation = 0.02 * light
    deviation[20:40, 20:40] = np.inf
    reducer = LightReducer(64, 64, 2.0)
    reducer.add(strip_of(light, deviation, np.zeros((64, 64, 3), np.uint8)))
    shown = tone_map(reducer.light()).astype(int)
    assert np.abs(shown - shown[0, 0]).max() <= 1


def test_saturated_light_is_white_whatever_its_channels_say() -> None:
    """Only one channel saturated would be magenta or green."""
    light = np.full((40, 40, 3), 0.1)
    saturated = np.zeros((40, 40))
    light[10:20, 10:20], saturated[10:20, 10:20] = (1.0, 0.5, 0.9), 1.0
    shown = tone_map(light_of(light, saturated=saturated))
    assert (shown[10:20, 10:20] == 255).all()
    assert (shown[:8] < 255).all()


def test_one_saturated_channel_keeps_its_colour_and_all_are_white() -> None:
    """Noise around saturation would leave white pixels beside those of the colour of the light."""
    light = np.full((30, 30, 3), (1.0, 0.6, 0.3), np.float32)
    light[::2, :20] *= 0.999
    light[:, 20:] = 1.0
    mask = np.where(light >= 1, SATURATED, 0).astype(np.uint8)
    reducer = LightReducer(30, 30, 1.0)
    reducer.add(strip_of(light, light * 0, mask))
    shown = tone_map(reducer.light()).astype(int)
    assert np.ptp(shown[:, 2:17], axis=(0, 1)).max() <= 3
    assert (shown[:, 5, 0] - shown[:, 5, 2]).min() > 50
    assert (shown[:, 24:] == 255).all()


def test_light_below_one_level_is_the_mean_of_the_area() -> None:
    """Single samples have 0 or 1 level there; the picture is smooth, and darker with less light."""
    rng = np.random.default_rng(1)
    level, share = 1e-3, np.linspace(0.05, 0.95, 300, dtype=np.float32)
    lit = rng.random((120, 300)) < share
    light = np.where(lit, level, level / 4).astype(np.float32)[..., np.newaxis]
    unlit = np.where(lit, 0, ALL).astype(np.uint8)
    none = np.zeros_like(unlit)
    noise = np.where(lit, 0.3, 0.6).astype(np.float32)[..., np.newaxis]
    shown = tone_map(Light(light, noise, none, unlit, unlit, none)).astype(float)[10:-10]
    columns = shown.mean(axis=0).reshape(-1, 50).mean(axis=1)
    assert (np.diff(columns) > 0).all()
    assert shown.min() > 0
    assert shown.std(axis=0).mean() < 0.3 * np.ptp(columns)


def test_single_pixels_of_large_error_are_not_the_mean_of_each_other() -> None:
    """Frames contradict each other there: in bright and in dark light, far from each other."""
    light = np.ones((80, 120, 3))
    light[:, 60:] = 40.0
    light *= np.exp(np.random.default_rng(5).normal(0, 0.02, light.shape))
    noise = np.full(light.shape, 0.02, np.float32)
    noise[5::16, 5::16] = 2.0
    shown = tone_map(replace(light_of(light), noise=noise)).astype(int)
    assert np.ptp(shown[:, 2:58], axis=(0, 1)).max() < 20
    assert np.ptp(shown[:, 62:118], axis=(0, 1)).max() < 20


def test_all_saturated_is_white_and_no_light_is_black() -> None:
    everywhere = np.ones((20, 30))
    assert (tone_map(light_of(everywhere, saturated=everywhere)) == 255).all()
    assert (tone_map(light_of(everywhere * 1e-9, noise=9.0, dark=everywhere)) == 0).all()


def test_the_darkest_light_in_range_is_not_black() -> None:
    """Steps of 1 to 1:300,000, the three darkest on 2 % of the picture each."""
    light = np.ones((200, 300, 3)) * [0.5, 1.0, 0.8]
    steps = np.geomspace(0.01, 1 / 300_000, 10)
    for place, step in enumerate(steps):
        light[20:60, 30 * place : 30 * place + 30] *= step
    codes = tone_map(light_of(light)).astype(int)
    shown = codes[40, 15::30]
    assert shown.min() > 0
    assert (np.diff(shown[:, 1]) < 0).all()


@pytest.mark.parametrize("noise", [0.1, 0.4])
def test_noise_of_the_predicted_size_is_filtered_out(noise: float) -> None:
    rng = np.random.default_rng(0)
    light = np.ones((200, 200, 3))
    light[:, 100:] = 30.0
    grainy = light * np.exp(rng.normal(0, noise, light.shape))
    codes = tone_map(light_of(grainy, noise)).astype(float)
    untouched = tone_map(light_of(grainy)).astype(float)
    dark = np.s_[20:180, 20:80]
    assert codes[dark].std(axis=(0, 1)).max() < 0.3 * untouched[dark].std(axis=(0, 1)).min()
    # The edge stays: within two pixels it has most of its height.
    edge = codes[20:180].mean(axis=(0, 2))
    assert edge[101] - edge[98] > 0.8 * (edge[120] - edge[80])


def test_detail_larger_than_the_noise_stays() -> None:
    light = np.where(np.indices((64, 64)).sum(axis=0) % 2, 1.0, 2.0)
    with_noise, without = (tone_map(light_of(light, noise)).astype(int) for noise in (0.05, 0.0))
    assert abs(with_noise - without).max() <= 6


def test_no_halo_beside_an_edge_of_ten_stops() -> None:
    light = np.ones((200, 300))
    light[:, 150:] = 1024.0
    rows = tone_map(light_of(light))[100].astype(int)
    assert abs(rows[:149] - rows[10]).max() <= 6
    assert abs(rows[152:] - rows[290]).max() <= 6


@pytest.mark.parametrize("shape", [(1, 1), (1, 9000), (9000, 1), (3, 2), (5, 7, 3), (2561, 4)])
def test_any_shape_gives_a_preview_of_at_most_2560_pixels(shape: tuple[int, ...]) -> None:
    reducer = LightReducer(shape[0], shape[1], 1.0)
    light = np.linspace(0.1, 1.0, int(np.prod(shape)), dtype=np.float32).reshape(shape)
    rows = np.array_split(np.arange(shape[0]), min(3, shape[0]))
    for part in rows:
        some = light[part]
        mask = np.zeros(some.shape, np.uint8)
        deviation = some * np.float32(0.01)
        reducer.add(strip_of(some, deviation, mask))
    shown = tone_map(reducer.light())
    assert max(shown.shape) <= preview_light.PREVIEW_SIDE
    assert shown.shape[2:] == shape[2:]
    assert shown.dtype == np.uint8


def test_reduced_light_is_the_mean_and_its_noise_is_less(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preview_light, "PREVIEW_SIDE", 5)
    light = np.arange(100, dtype=np.float32).reshape(10, 10)
    mask = np.zeros((10, 10), np.uint8)
    mask[:2, :2], mask[4, 4], mask[6:8, 6] = SATURATED, SATURATED | 4, DARK
    deviation = np.where(mask & SATURATED, np.inf, light / 10).astype(np.float32)
    reducer = LightReducer(10, 10, 39.0)
    for rows in (slice(0, 3), slice(3, 4), slice(4, 10)):  # strips need not fit
        reducer.add(strip_of(light[rows], deviation[rows], mask[rows]))
    found = reducer.light()
    expected = light.reshape(5, 2, 5, 2).mean(axis=(1, 3))
    assert np.allclose(found.irradiance[..., 0], expected)
    assert found.noise[3, 1, 0] == pytest.approx(0.05)
    assert found.saturated[0, 0] == 255
    assert found.saturated[2, 2] in (63, 64)
    assert found.dark[3, 3] in (127, 128)
    assert found.unlit[0].tolist() in ([63, 0, 0, 0, 0], [64, 0, 0, 0, 0])
