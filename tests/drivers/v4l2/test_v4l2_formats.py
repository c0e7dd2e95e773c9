"""Samples of a V4L2 camera are what the pixel format defines."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from v4l2_bench import one_frame, open_model, opening_error
from v4l2_model import Model, brightness

from camctl.errors import CameraError, CameraProtocolError, UsageError
from camctl.interface.controls import Layout, ResponseOrigin

pytestmark = pytest.mark.usefixtures("own_profiles")


class TestFormats:
    @pytest.mark.parametrize(
        ("offered", "name"),
        [
            (("MJPG", "YUYV"), "yuyv"),
            (("MJPG", "YUYV", "GREY"), "grey"),
            (("YUYV", "RG10"), "bayer10"),
            (("RGGB", "Y10 ", "Y12 "), "y12"),
            (("Y12 ", "Y16 "), "y16"),
            (("MJPG", "H264"), "mjpg"),
        ],
    )
    def test_default_is_the_format_of_highest_fidelity(
        self, offered: tuple[str, ...], name: str
    ) -> None:
        with open_model(Model(formats=offered)) as camera:
            assert camera.mode.startswith(f"{name}-")

    @pytest.mark.parametrize(
        ("code", "bits", "layout"),
        [
            ("Y16 ", 16, Layout.MONO),
            ("Y14P", 14, Layout.MONO),
            ("Y12 ", 12, Layout.MONO),
            ("Y12P", 12, Layout.MONO),
            ("Y10 ", 10, Layout.MONO),
            ("Y10P", 10, Layout.MONO),
            ("BYR2", 16, Layout.BGGR),
            ("RG14", 14, Layout.RGGB),
            ("pGEE", 14, Layout.GBRG),
            ("BA12", 12, Layout.GRBG),
            ("pRCC", 12, Layout.RGGB),
            ("RG10", 10, Layout.RGGB),
            ("pBAA", 10, Layout.BGGR),
            ("RGGB", 8, Layout.RGGB),
            ("GRBG", 8, Layout.GRBG),
            ("GBRG", 8, Layout.GBRG),
            ("BA81", 8, Layout.BGGR),
            ("GREY", 8, Layout.MONO),
            ("YUYV", 8, Layout.MONO),
            ("YU12", 8, Layout.MONO),
            ("YV12", 8, Layout.MONO),
            ("NV12", 8, Layout.MONO),
        ],
    )
    def test_samples_are_not_changed(self, code: str, bits: int, layout: Layout) -> None:
        with open_model(Model(formats=(code,))) as camera:
            frame = one_frame(camera)
            assert (camera.controls.bits, camera.controls.layout) == (bits, layout)
            assert camera.controls.white == 2**bits - 1
            assert frame.pixels.dtype == (np.uint8 if bits == 8 else np.uint16)
            assert np.array_equal(frame.pixels, brightness(100, bits))

    def test_loss_of_levels_in_jpeg_is_noted(self) -> None:
        with open_model(Model(formats=("MJPG",))) as camera:
            assert any("JPEG frames lose levels" in note for note in camera.controls.notes)
            assert np.abs(one_frame(camera).pixels - brightness(100)).max() < 8

    def test_bits_of_y16(self) -> None:
        model = Model(formats=("Y16 ",))
        with open_model(model, bits=14) as camera:
            assert (camera.controls.bits, camera.controls.white) == (14, 2**14 - 1)
            assert int(one_frame(camera, 10).pixels.max()) < 2**14
            with pytest.raises(CameraProtocolError, match="which has more than 14 bits"):
                one_frame(camera, 200)

    @pytest.mark.parametrize(("options", "least"), [({}, 0.002), ({"bits": 12}, 0.0007)])
    def test_y16_of_which_the_upper_bits_are_used(
        self, monkeypatch: pytest.MonkeyPatch, options: dict[str, int], least: float
    ) -> None:
        """They are counted once, at opening, as 12 bits: the step of 16 is that of the samples.

        A dark frame shows that a stated number is that of the upper ones.
        """
        _of_upper_bits(monkeypatch, np.geomspace(least, 250 * least, 16 * 32))
        with open_model(Model(formats=("Y16 ",), sizes=((32, 16),)), **options) as camera:
            controls = camera.controls
            assert (controls.bits, controls.white, controls.levels.M) == (12, 4095, 4095)
            assert np.array_equal(one_frame(camera, 10).pixels, brightness(10, 12))
            assert any("the upper 12 bits of 16" in note for note in controls.notes)

    def test_lower_bits_of_later_frames_are_not_lost(self, monkeypatch: pytest.MonkeyPatch) -> None:
        _of_upper_bits(monkeypatch, np.geomspace(0.002, 0.5, 16 * 32))
        with open_model(Model(formats=("Y16 ",), sizes=((32, 16),))) as camera:
            monkeypatch.setattr("v4l2_model.brightness", brightness)
            with pytest.raises(CameraProtocolError, match="more than the 12 upper bits") as caught:
                one_frame(camera, 10)
            assert caught.value.remedies == {"option:bits": "16"}

    @pytest.mark.parametrize(
        ("quantization", "range_", "black", "white"),
        [
            (0, "auto", 16, 235),
            (1, "auto", 0, 255),
            (2, "auto", 16, 235),
            (2, "full", 0, 255),
            (1, "limited", 16, 235),
        ],
    )
    def test_luma_range(self, quantization: int, range_: str, black: int, white: int) -> None:
        with open_model(Model(quantization=quantization), range=range_) as camera:
            controls = camera.controls
            assert (controls.black, controls.white) == (black, white)
            assert white - black == controls.levels.M
            frame = one_frame(camera)
            assert (frame.black, frame.white) == (black, white)

    @pytest.mark.parametrize(
        ("code", "response", "is_linear"),
        [
            ("YUYV", "auto", False),
            ("YUYV", "linear", True),
            ("Y16 ", "auto", True),
            ("Y16 ", "srgb", False),
            ("YUYV", "power:1.8", False),
            ("YUYV", "rec709", False),
        ],
    )
    def test_response(self, code: str, response: str, is_linear: bool) -> None:
        with open_model(Model(formats=(code,)), response=response) as camera:
            assert (camera.controls.response is None) == is_linear
            is_assumed = code == "YUYV" and response == "auto"
            assert camera.controls.has_assumed_response == is_assumed
            if not is_assumed:
                assert camera.controls.response_origin is ResponseOrigin.STATED

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"format": "y16"}, "does not offer the pixel format y16; it offers yuyv"),
            ({"format": "yuyw"}, "unknown pixel format 'yuyw'; did you mean yuyv"),
            ({"size": (480, 640)}, "does not offer frames of 640x480; it offers 8x6"),
            ({"fps": 25.0}, "does not offer 25 frames a second; it offers 10, 30"),
            ({"bits": 12}, "bits=12 does not apply to the pixel format yuyv"),
            ({"black": 255}, "invalid black level 255; give 0 to 254 DN"),
            ({"response": "gamma"}, "'gamma'"),
            ({"response": "power:x"}, "'power:x'"),
            ({"response": "srgb:2"}, "'srgb:2'"),
        ],
    )
    def test_options_that_the_camera_does_not_support(
        self, options: dict[str, Any], message: str
    ) -> None:
        assert message in opening_error(UsageError, Model(), **options)

    def test_limited_range_of_raw_samples_is_refused(self) -> None:
        model = Model(formats=("Y16 ",))
        message = opening_error(UsageError, model, range="limited")
        assert "range=limited does not apply to the pixel format y16" in message

    def test_black_of_raw_samples(self) -> None:
        with open_model(Model(formats=("Y12 ",)), black=60) as camera:
            assert (camera.controls.black, camera.controls.levels.M) == (60, 4095 - 60)
            assert one_frame(camera).black == 60
            assert not any("black" in note for note in camera.controls.notes)
        with open_model(Model(formats=("Y12 ",))) as camera:
            assert any("option:black" in each.remedies for each in camera.controls.findings)

    @pytest.mark.parametrize("code", ["YUYV", "GREY", "Y16 ", "RG10", "pRAA", "pBCC"])
    def test_padding_of_lines_is_left_out(self, code: str) -> None:
        with open_model(Model(formats=(code,), bytesperline=64)) as camera:
            frame = one_frame(camera)
            assert np.array_equal(frame.pixels, brightness(100, camera.controls.bits))

    def test_unreadable_formats_are_refused(self) -> None:
        message = opening_error(CameraError, Model(formats=("H264", "\1\2\3\4")))
        assert "offers no pixel format that camctl can read, only H264, ????" in message


def _of_upper_bits(monkeypatch: pytest.MonkeyPatch, light: NDArray[np.float64]) -> None:
    """Let the model show this light, 16 x 32 samples of 16 bits, of which 12 are used."""

    def shifted(ticks: int, bits: int = 8) -> NDArray[np.float64]:
        return brightness(ticks, bits) // 16 * 16

    for name, value in (("LIGHT", light.reshape(16, 32)), ("ROWS", 16), ("COLUMNS", 32)):
        monkeypatch.setattr(f"v4l2_model.{name}", value)
    monkeypatch.setattr("v4l2_model.brightness", shifted)
