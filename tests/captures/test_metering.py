"""Metering: the highlights end up just below saturation, wherever it starts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from small_cameras import WrappedCamera, small_camera

from camctl.calibration.delay import measure_delay
from camctl.captures.metering import OUTLIER_SHARE, MeteringFrames, light_histogram, meter
from camctl.errors import CaptureError, UsageError
from camctl.exposure.light import LAMP_SHARE, Light, Metering
from camctl.interface.camera import FrameStream, StreamingCamera
from camctl.interface.controls import (
    Choices,
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
)
from camctl.model.response.camera import CameraResponse, standard_response
from camctl.photographs.camera import Photograph, PhotographCamera
from camctl.profiles.calibrated import open_camera
from camctl.profiles.profile import change_profile
from camctl.sim.camera import Faults


def uniform(value: float, shape: tuple[int, int] = (40, 50)) -> NDArray[np.float32]:
    return np.full(shape, value, np.float32)


@pytest.mark.parametrize("sensor", ["standard", "ideal-4", "phone", "machine-vision", "consumer"])
@pytest.mark.parametrize("brightness", [1e-3, 0.1, 1.0, 50.0, 2000.0])
def test_highlights_are_just_below_white(sensor: str, brightness: float) -> None:
    light = uniform(brightness)
    light[:20] *= 0.01
    # Lines so short that all shutter times can be set.
    with small_camera(sensor, light, line_s=1e-7, time_minimum_s=1e-7) as camera:
        metering = meter(MeteringFrames(camera))
        controls = camera.controls
    limit = controls.time_s.nearest(metering.limit_s)
    assert controls.sensitivity is not None
    full = limit * controls.sensitivity * brightness
    # The target is as sharp as the levels are, and ends with the longest exposure.
    assert full <= 1.0
    assert full >= 0.87 - 2 / controls.levels.M or limit == controls.time_s.maximum
    assert metering.clipped <= OUTLIER_SHARE


def test_fullest_channel_is_metered() -> None:
    light = np.full((40, 50, 3), 0.05, np.float32)
    light[..., 2] = 1.0
    with small_camera(light=light, layout="rggb", line_s=1e-7, time_minimum_s=1e-7) as camera:
        assert camera.controls.sensitivity is not None
        blue = meter(MeteringFrames(camera)).limit_s * camera.controls.sensitivity * 1.0
    assert 0.85 <= blue <= 1.0


def test_few_reflections_may_saturate_and_are_reported() -> None:
    light = uniform(0.1, (200, 300))
    light[0, :4] = 1e4
    with small_camera(light=light, line_s=1e-7, time_minimum_s=1e-7) as camera:
        metering = meter(MeteringFrames(camera))
        assert camera.controls.sensitivity is not None
        assert metering.limit_s * camera.controls.sensitivity * 0.1 > 0.8
    assert metering.clipped == pytest.approx(4 / 60_000)


def test_black_scene_is_an_error() -> None:
    with (
        small_camera(light=uniform(1e-12)) as camera,
        pytest.raises(
            CaptureError, match="the picture is black even at 60 s; take the lens cap off"
        ),
    ):
        meter(MeteringFrames(camera))


def test_overexposed_scene_is_an_error() -> None:
    with (
        small_camera(light=uniform(1e9)) as camera,
        pytest.raises(CaptureError, match="the picture is white even at 1/100000 s"),
    ):
        meter(MeteringFrames(camera))


class Mechanical(WrappedCamera):
    """A camera without a preview that counts its exposures."""

    shots = 0

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        self.shots += len(settings)
        return super().shoot(settings)


def test_shutter_of_a_camera_without_preview_is_actuated_on_request_only() -> None:
    with small_camera() as simulated:
        camera = Mechanical(simulated)
        with pytest.raises(UsageError, match="no preview, and metering would cost") as refused:
            meter(MeteringFrames(camera))
        assert refused.value.remedies == {"spend_shutter": True, "base_s": None}
        assert camera.shots == 0
        metering = meter(MeteringFrames(camera, spend_shutter=True))
    assert metering.frames == camera.shots > 0


@pytest.mark.parametrize("longest_s", [1e-3, 0.01, 0.1])
def test_a_camera_that_does_not_follow_its_exposure_is_an_error(longest_s: float) -> None:
    """Without the check metering ends at 60 s, with frames as dark as at the limit."""
    with (
        small_camera(faults=Faults(longest_exposure_s=longest_s)) as camera,
        pytest.raises(CaptureError, match="the camera does not follow its exposure") as found,
    ):
        histogram(MeteringFrames(camera))
    assert "no longer than" in str(found.value)


def test_the_sun_that_stays_black_is_no_exposure_that_is_not_followed() -> None:
    """In a thousandth of the picture the reset level of the sensor holds the light, too."""
    with open_camera("sim", scene="outdoor-sun", sensor="security", size="480x270") as camera:
        histogram(MeteringFrames(camera))


@pytest.mark.parametrize("wrong_by", [-1, 1])
def test_a_stale_control_delay_is_said_to_be_the_possible_cause(
    wrong_by: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))
    options = {"scene": "ramp", "size": "160x120", "unknown": True}
    with open_camera("sim", options) as camera:
        assert isinstance(camera, StreamingCamera)
        record, mode = measure_delay(camera, trials=4), camera.mode
        assert record.frames is not None
        frames = record.frames + wrong_by
        bounds = {"frames": frames, "smallest": frames, "largest": frames}
        stale = record.model_copy(update={**bounds, "time": None, "gain": None})
        change_profile(camera.info, lambda profile: profile.delays.update({mode: stale}))
    with open_camera("sim", options) as camera, pytest.raises(CaptureError) as found:
        histogram(MeteringFrames(camera))
    assert found.value.remedies["calibrate_delay"] == "sim"


def histogram(source: MeteringFrames) -> Light:
    return light_histogram(source, meter(source))


def test_photographs_of_any_length_are_metered() -> None:
    """Nobody waits for them: those beyond 4 s show the shadows, and by the response of a colour."""
    light = np.geomspace(2e-7, 1, 4800).reshape(60, 80)
    light = np.dstack([light, light, light])
    times = [0.25 * 4.0**k for k in range(6)]  # to 256 s
    srgb = standard_response("srgb", 8)
    responses = (srgb, srgb, standard_response("rec709", 8))
    frames = [
        np.dstack(
            [
                np.searchsorted(each.levels, light[..., k] * time_s / times[0], side="right")
                for k, each in enumerate(responses)
            ]
        ).astype(np.uint8)
        for time_s in times
    ]
    camera = photographs_of(dict(zip(times, frames, strict=True)), responses)
    source = MeteringFrames(camera)
    found = light_histogram(source, meter(source))
    for threshold in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1):
        truth = float(np.mean(light < threshold))
        assert found.share_below(threshold) == pytest.approx(truth, abs=0.015)


class CloudPasses(WrappedCamera):
    """A camera whose second frame has the light of a sixteenth of the time."""

    shots = 0

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        self.shots += 1
        for frame in self.camera.shoot(settings):
            is_dim = self.shots == 2
            yield replace(frame, pixels=frame.pixels // 16) if is_dim else frame


def test_a_single_frame_that_does_not_follow_is_taken_again() -> None:
    light = uniform(0.1, (60, 80))
    with small_camera(light=light) as camera:
        assert camera.controls.sensitivity is not None
        full_s = 1 / (camera.controls.sensitivity * 0.1)
        settings = [ExposureSetting(share * full_s) for share in (0.05, 0.8)]
        source = MeteringFrames(CloudPasses(camera), spend_shutter=True)
        frames = [source.take(setting) for setting in settings]
    assert source.count == 4
    assert frames[1].pixels.mean() == pytest.approx(16 * frames[0].pixels.mean(), rel=0.05)


@pytest.mark.parametrize(
    ("between", "darkest", "is_apart"),
    [
        (0, 1e-3, True),  # the lamps clip alone
        (50, 1e-3, False),  # no dark stop between them and the rest: as much as lamps may clip
        (0, 0.12, False),  # shadows that are not seen decide the range
    ],
)
def test_lamps_clip_alone_where_they_are_apart(
    between: int, darkest: float, *, is_apart: bool
) -> None:
    """The rest spans 1:10, and the range is 1:16 anyway."""
    rest = np.geomspace(0.1, 1.0, 2000)
    E = np.concatenate([rest, np.geomspace(1.0, 1000.0, between + 2)[1:]])
    shares = np.full(E.size, 1.0)
    shares[rest.size :] = 4 / (E.size - rest.size)
    metering = Metering(1.0, ExposureSetting(1.0), 0.9, 0.0, 1)
    light = Light(metering, E, shares / shares.sum(), darkest, float(E[-1]))
    cut = light.highlights(LAMP_SHARE)
    assert 0.9 < cut < 1.0
    assert light.upper_end(None, None) == (1.0 if is_apart else cut)


def photographs_of(
    frames: dict[float, NDArray[np.uint8]], responses: Sequence[CameraResponse] = ()
) -> PhotographCamera:
    """Return the camera of photographs by their times, s, of 8 bits with the curve of sRGB."""
    pixels = list(frames.values())
    controls = ExposureControls(
        time_s=Choices((1.0,)),
        shape=pixels[0].shape[:2],
        layout=Layout.RGB if pixels[0].ndim == 3 else Layout.MONO,
        bits=8,
        black=0,
        white=255,
        response=standard_response("srgb", 8),
        responses=tuple(responses),
        response_origin=ResponseOrigin.STATED,
    )
    photographs = [Photograph(f"{time_s:g}", time_s) for time_s in frames]
    return PhotographCamera(photographs, pixels.__getitem__, controls)


def flat(levels: dict[float, int]) -> dict[float, NDArray[np.uint8]]:
    """Return frames of one brightness each, by the times of the photographs, s."""
    return {time_s: np.full((40, 50), level, np.uint8) for time_s, level in levels.items()}


def test_shortest_photograph_is_metered_where_the_next_one_is_far_longer() -> None:
    metering = meter(MeteringFrames(photographs_of(flat({1 / 4096: 180, 0.5: 255, 2.0: 255}))))
    assert metering.setting.time_s == 1 / 4096
    assert metering.clipped == 0


def test_photographs_are_not_a_camera_that_does_not_follow() -> None:
    """Their exposures are checked where they are opened, and nobody can take them again."""
    source = MeteringFrames(photographs_of(flat({1 / 64: 40, 1.0: 41})))
    assert [source.take(ExposureSetting(time_s)).pixels[0, 0] for time_s in (1 / 64, 1.0)] == [
        40,
        41,
    ]
    assert source.count == 2
