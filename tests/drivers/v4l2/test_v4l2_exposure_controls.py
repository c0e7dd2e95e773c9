"""Gain of a V4L2 camera, and exposure that an image sensor counts in lines."""

from __future__ import annotations

import numpy as np
import pytest
from v4l2_bench import open_model, opening_error
from v4l2_model import PATH, Model, Register, brightness

from camctl.drivers.v4l2.abi import ControlId, ControlType
from camctl.errors import CameraError, RefusedSettingError, UsageError
from camctl.interface.controls import Choices, ExposureSetting, Steps

pytestmark = pytest.mark.usefixtures("own_profiles")


class TestGain:
    def test_linear_steps(self) -> None:
        model = Model()
        with open_model(model, gain="linear:0.0625") as camera:
            gains = camera.controls.gain
            assert (gains.minimum, gains.maximum) == (1.0, 1 + 255 / 16)
            assert model.controls[ControlId.GAIN].value == 0
            for gain, register in ((2.0, 16), (1.0, 0), (16.9375, 255)):
                (frame,) = camera.shoot([ExposureSetting(0.01, gain)])
                assert frame.applied.gain == gain
                assert model.controls[ControlId.GAIN].value == register
            assert any("its lowest, 0, is gain 1" in note for note in camera.controls.notes)

    def test_decibel_steps(self) -> None:
        with open_model(Model(), gain="db:0.1") as camera:
            gains = camera.controls.gain
            assert isinstance(gains, Choices)
            assert gains.values[200] == pytest.approx(10.0)

    def test_clamped_gain_is_refused(self) -> None:
        model = Model()
        with open_model(model, gain="linear:0.0625") as camera:
            model.controls[ControlId.GAIN].clamp = 32
            with pytest.raises(RefusedSettingError) as caught:
                list(camera.shoot([ExposureSetting(0.01, 9.0)]))
        assert caught.value.nearest == 3.0

    def test_camera_without_gain(self) -> None:
        model = Model()
        del model.controls[ControlId.GAIN]
        message = opening_error(UsageError, model, gain="db:1")
        assert f"{PATH} has no gain that can be set; leave" in message


class TestImageSensor:
    """A sensor's own driver: exposure in lines of (columns + blanking) / pixel rate."""

    def sensor(self, *, blanking: int | None = 92, pixel_rate: int | None = 1_000_000) -> Model:
        model = Model(formats=("pRAA",), pixel_rate=pixel_rate, intervals=())
        for control in (ControlId.EXPOSURE_AUTO, ControlId.EXPOSURE_ABSOLUTE, ControlId.GAIN):
            del model.controls[control]
        integer = ControlType.INTEGER
        model.controls[ControlId.EXPOSURE] = Register("Exposure", integer, 4, 2000, 1, 100, 100)
        model.controls[ControlId.ANALOGUE_GAIN] = Register("Gain", integer, 0, 232, 1, 0, 7)
        if blanking is not None:
            model.controls[ControlId.HBLANK] = Register(
                "Blanking", integer, 92, 92, 1, 92, blanking
            )
        return model

    def test_exposure_in_lines_is_given_in_seconds(self) -> None:
        model = self.sensor()
        with open_model(model) as camera:
            times = camera.controls.time_s
            assert isinstance(times, Steps)
            assert (times.minimum, times.step) == (4e-4, 1e-4)  # 8 + 92 pixels at 1 MHz
            assert times.maximum == pytest.approx(0.1, rel=2e-3)
            (frame,) = camera.shoot([ExposureSetting(0.0123)])
            assert frame.applied.time_s == 0.0123
            assert model.controls[ControlId.EXPOSURE].value == 123
            assert np.array_equal(frame.pixels, brightness(123, 10))
            assert any("lines of 100 us" in note for note in camera.controls.notes)

    def test_analogue_gain_is_held_or_used(self) -> None:
        model = self.sensor()
        with open_model(model):
            assert model.controls[ControlId.ANALOGUE_GAIN].value == 0
        with open_model(self.sensor(), gain="db:0.1") as camera:
            assert camera.controls.gain.maximum == pytest.approx(10 ** (23.2 / 20))

    @pytest.mark.parametrize(
        ("blanking", "pixel_rate", "missing"),
        [
            (None, 1_000_000, "horizontal blanking"),
            (92, None, "pixel rate"),
            (92, 0, "pixel rate"),
            (None, None, "pixel rate and horizontal blanking"),
        ],
    )
    def test_lines_of_unknown_length_are_refused(
        self, blanking: int | None, pixel_rate: int | None, missing: str
    ) -> None:
        model = self.sensor(blanking=blanking, pixel_rate=pixel_rate)
        message = opening_error(CameraError, model)
        assert f"sets its exposure in lines, but does not report {missing}, from which" in message
