"""A camera with its profile: what is applied, what is refused, and what is said of it."""

from __future__ import annotations

import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from camctl.captures.sequencer import capture
from camctl.errors import DataError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Camera, PreviewingCamera, StreamingCamera
from camctl.interface.controls import ExposureSetting, Layout
from camctl.pictures.render import HOT
from camctl.profiles.calibrated import CalibratedCamera, calibrated, open_camera, with_profile
from camctl.profiles.exposures import Correction, ExposureRecord, exposure_mode
from camctl.profiles.noise import DarkRecord, Figure, GainNoise, HotPixel, NoiseRecord
from camctl.profiles.profile import DelayRecord, Profile, change_profile
from camctl.profiles.response import ChannelResponse, ResponseRecord
from camctl.sim.camera import SimulatedCamera

DATE = "2026-11-22T05:15:15+00:00"
BRIGHTNESS = np.linspace(0, 1, 33)


@pytest.fixture(autouse=True)
def own_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def response(
    *gammas: float, names: str = "RGB", black: int = 0, white: int = 255
) -> ResponseRecord:
    """Return a record of channels with power curves."""
    channels = tuple(
        ChannelResponse(
            name=name,
            black=black,
            white=white,
            saturates=True,
            irradiance=tuple((BRIGHTNESS**gamma).tolist()),
            brightness=tuple(BRIGHTNESS.tolist()),
            deviation=None,
            measured=(0.01, 0.99),
        )
        for name, gamma in zip(names, gammas, strict=True)
    )
    return ResponseRecord(channels=channels, phase=0.0, frames=8, measured_at=DATE)


def exposures(factor: float) -> ExposureRecord:
    """Return a record of two times, the second of which is wrong."""
    times = (
        Correction(value=0.01, factor=1.0, low=1.0, high=1.0),
        Correction(value=0.02, factor=factor, low=0.999 * factor, high=1.001 * factor),
    )
    gains = (Correction(value=1.0, factor=1.0, low=1.0, high=1.0),)
    return ExposureRecord(times=times, gains=gains, interpolates=False, measured_at=DATE)


def small(**options: object) -> Camera:
    """Open the simulated consumer camera before a colourful scene."""
    return open_camera(
        "sim", {"sensor": "consumer", "scene": "room", "size": "64x48", "unknown": True, **options}
    )


def keep(**records: object) -> Profile:
    """Keep records of the mode of that camera; return its profile."""
    kept: list[Profile] = []

    def change(profile: Profile) -> None:
        for name, record in records.items():
            getattr(profile, name)[mode] = record
        kept.append(profile)

    with small(profile="none") as camera:
        mode = exposure_mode(camera.controls)
        change_profile(camera.info, change)
    return kept[0]


def test_without_a_profile_the_camera_is_that_of_the_driver() -> None:
    with small() as camera:
        assert isinstance(camera, SimulatedCamera)
        assert camera.controls.profile is None
        assert camera.controls.response is None


def test_response_and_exposures_of_the_profile_are_applied() -> None:
    profile = keep(responses=response(2.0, 2.2, 2.4), exposures=exposures(1.1))
    with small() as camera:
        controls = camera.controls
        assert isinstance(camera, PreviewingCamera)
        assert isinstance(camera, StreamingCamera)
        assert camera.mode == "rgb8-64x48-10"
        assert camera.scene.name == "room"  # type: ignore[attr-defined]  # of the driver
    names = [each.name.partition(",")[2] for each in controls.responses]
    assert names == [" R 8 bit", " G 8 bit", " B 8 bit"]
    assert controls.response is controls.responses[1]
    assert controls.levels.levels[127] == pytest.approx(0.5**2.2, rel=1e-2)
    settings = [ExposureSetting(0.01), ExposureSetting(0.02), ExposureSetting(0.03)]
    assert controls.relative_exposures(settings) == pytest.approx((1.0, 2.2, 3.0))
    assert controls.profile == f"{profile.name}: response, exposures, measured 2026-11-22"


def test_nearest_time_is_that_of_the_true_exposure() -> None:
    keep(exposures=exposures(1.25))
    with small() as camera:
        controls = camera.controls
    assert controls.nearest_time(0.02, 1.0) == pytest.approx(0.016)
    assert controls.nearest_time(0.03, 1.0) == pytest.approx(0.03)
    assert controls.nearest_time(0.01, 1.0) == pytest.approx(0.01)


def test_equal_channels_share_one_response() -> None:
    keep(responses=response(2.2, 2.2, 2.2))
    with small() as camera:
        assert camera.controls.responses == ()


def test_the_user_is_told_of_the_profile(caplog: pytest.LogCaptureFixture) -> None:
    profile = keep(responses=response(2.2, 2.2, 2.2))
    with caplog.at_level(logging.INFO, "camctl"), small() as camera:
        _ = camera.controls, camera.controls
    assert caplog.messages == [f"using the profile {profile.name}: response, measured 2026-11-22"]


@pytest.mark.parametrize(
    ("parts", "has_response", "has_exposures"),
    [("none", False, False), ("response", True, False), ("exposures", False, True)],
)
def test_parts_of_a_profile_are_chosen(parts: str, has_response: bool, has_exposures: bool) -> None:
    keep(responses=response(2.2, 2.2, 2.2), exposures=exposures(1.1))
    with small(profile=parts) as camera:
        assert (camera.controls.response is not None) is has_response
        assert (camera.controls.true_exposures is not None) is has_exposures


def test_noise_and_hot_pixels_of_the_profile_are_applied() -> None:
    figure = Figure(value=50.0, low=49.0, high=51.0)
    dark = DarkRecord(
        gain=1.0,
        times_s=(0.1, 1.0),
        dark_current_e_s=figure,
        dsnu_e=figure,
        black_dn=0.0,
        hot_pixels=(
            HotPixel(row=3, column=5, rate_e_s=900.0),
            HotPixel(row=3, column=64, rate_e_s=800.0),  # beyond the last column
        ),
        measured_at=DATE,
    )
    gain = GainNoise(
        gain=1.0, conversion_e_per_dn=figure, read_noise_e=figure, patches=9, misfit=1.0
    )
    record = NoiseRecord(
        gains=(gain,), full_well_e=figure, saturates=True, dark=dark, measured_at=DATE
    )
    keep(noises=record)
    with small() as camera:
        assert camera.controls.noise == record.noise_model()
        assert camera.controls.noise.conversion_e_per_dn == 50.0
        assert camera.controls.hot_pixels == ((3, 5),)
    with small(profile="response") as camera:
        assert camera.controls.noise is None


def test_an_unknown_part_is_refused() -> None:
    with pytest.raises(UsageError, match="unknown part of a profile 'respons'"):
        small(profile="respons")


def test_the_control_delay_is_left_out_with_the_profile() -> None:
    record = DelayRecord(frames=1, smallest=1, largest=1, trials=12, measured_at=DATE)
    with small() as camera:
        assert isinstance(camera, StreamingCamera)
        mode = camera.mode
        change_profile(camera.info, lambda profile: profile.delays.update({mode: record}))
    with small() as camera:
        assert camera.controls.delay_frames == 1
    with small(profile="none") as camera:
        assert camera.controls.delay_frames is None


def test_another_mode_is_named_and_its_profile_not_used(caplog: pytest.LogCaptureFixture) -> None:
    keep(responses=response(2.2, 2.2, 2.2))
    with caplog.at_level(logging.INFO, "camctl"), small(size="32x24") as camera:
        assert camera.controls.response is None
    assert caplog.messages == [
        "no measurements for rgb-32x24-255 in the camera's profile, only for rgb-64x48-255"
    ]


def test_another_mode_is_not_named_where_the_camera_states_everything(
    caplog: pytest.LogCaptureFixture,
) -> None:
    keep(responses=response(2.2, 2.2, 2.2))
    options = {"size": "32x24", "unknown": False}
    with caplog.at_level(logging.INFO, "camctl"), small(**options) as camera:
        assert camera.controls.response is not None
    assert caplog.messages == []


def test_pixel_formats_of_one_layout_have_modes_of_their_own() -> None:
    with small(sensor="webcam") as camera:
        modes = {
            exposure_mode(replace(camera.controls, pixel_format=name))
            for name in ("", "yuyv", "mjpg")
        }
    assert modes == {"rgb-64x48-255", "rgb-yuyv-64x48-255", "rgb-mjpg-64x48-255"}


@pytest.mark.parametrize(
    ("changed", "measured", "now"),
    [
        ({"black": 16}, "black 0 and white 255", "black 16 and white 255"),
        ({"layout": Layout.MONO}, "3 channels", "1"),
    ],
)
def test_a_profile_that_no_longer_fits_is_refused_by_name(
    changed: dict[str, object], measured: str, now: str
) -> None:
    profile = keep(responses=response(2.2, 2.2, 2.2))
    with small(profile="none") as camera:
        controls = replace(camera.controls, **changed)  # type: ignore[arg-type]  # of any field
    profile.responses[exposure_mode(controls)] = response(2.2, 2.2, 2.2)
    with pytest.raises(DataError) as caught:
        calibrated(controls, profile)
    assert profile.name in caught.value.what
    assert measured in caught.value.what
    assert f"now has {now}" in caught.value.what
    assert "option:profile" in caught.value.remedies


def test_each_channel_is_decoded_by_its_own_response() -> None:
    keep(responses=response(1.0, 2.0, 3.0))
    with small() as camera:
        report = capture(camera, CaptureRequest("linear", 64.0, ratios=(1.0,), base_s=0.1))
    assert report.profile is not None
    frame = report.frame(0)
    inside = (frame > 20) & (frame < 230)
    for channel, gamma in enumerate((1.0, 2.0, 3.0)):
        good = inside[..., channel]
        brightness = (frame[..., channel][good] + 0.5) / 256
        expected = report.plan.desired.u(brightness**gamma)
        found = report.image()[..., channel][good] / 65535
        assert found == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("sensor", ["standard", "consumer", "phone"])
def test_hot_pixels_are_masked_and_replaced_in_the_image(sensor: str) -> None:
    hot = ((0, 0), (20, 31), (47, 63))
    request = CaptureRequest("log", 256.0, ratios=(1.0, 4.0))
    with small(sensor=sensor, unknown=False) as camera:
        plain = capture(camera, request)

        class Hot(CalibratedCamera):
            @property
            def controls(self):  # type: ignore[no-untyped-def]  # as that of the base
                return replace(super().controls, hot_pixels=hot)

    with small(sensor=sensor, unknown=False) as camera:
        profile = Profile.of(camera.info)
        report = capture(Hot(camera, profile), request)
    for row, column in hot:
        assert np.all(report.mask()[row, column] & HOT)
    marked = np.any(np.atleast_3d(report.mask() & HOT), axis=2)
    assert np.array_equal(report.sum(), plain.sum())
    assert np.array_equal(report.radiance(), plain.radiance())
    assert np.array_equal(report.image()[~marked], plain.image()[~marked])
    near = report.image()[19:22, 30:33].reshape(9, -1).astype(float)
    assert np.all(near[4] >= near.min(axis=0))
    assert np.all(near[4] <= near.max(axis=0))


def test_with_profile_wraps_a_camera_without_preview() -> None:
    keep(responses=response(2.2, 2.2, 2.2))

    class Still:
        def __init__(self, camera: Camera) -> None:
            self.info, self.controls, self.clock = camera.info, camera.controls, camera.clock

    with small(profile="none") as camera:
        wrapped = with_profile(Still(camera))  # type: ignore[arg-type]  # it shoots nothing
        assert not isinstance(wrapped, PreviewingCamera | StreamingCamera)
        assert wrapped.controls.response is not None
