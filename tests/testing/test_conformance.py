"""The conformance suite: simulated cameras of every kind pass it, cameras with a defect do not."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import pytest
from small_cameras import WrappedCamera
from still_scene import gradient, open_before

from camctl.interface.camera import Camera, Frame, FrameStream
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.testing.conformance import CameraConformance


class Steady(CameraConformance):
    """A simulated camera in front of a gradient; subclasses change its sensor."""

    sensor = "standard"
    changes: Mapping[str, object] = MappingProxyType({})

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.02)

    def open_camera(self) -> Camera:
        return open_before(gradient(), self.sensor, **self.changes)


class TestStandard(Steady):
    pass


class TestNoDelay(Steady):
    changes = MappingProxyType({"delay_frames": 0})


@pytest.mark.slow
class TestLongDelay(Steady):
    changes = MappingProxyType({"delay_frames": 5})


class TestVaryingDelay(Steady):
    changes = MappingProxyType({"delay_frames": 1, "delay_jitter_frames": 2})


class TestMosaicWithBlackLevel(Steady):
    sensor = "phone"


@pytest.mark.slow
class TestTwelveBits(Steady):
    sensor = "machine-vision"


@pytest.mark.slow
class TestFourBits(Steady):
    sensor = "ideal-4"


@pytest.mark.slow
class TestNonLinear(Steady):
    sensor = "consumer"


class Defective(WrappedCamera):
    """A camera with a defect; it previews by shooting."""

    def preview(self, setting: ExposureSetting) -> Frame:
        (frame,) = self.shoot([setting])
        return frame


class ReturnsOldFrames(Defective):
    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        old = [replace(settings[0], time_s=settings[0].time_s / 2), *settings[:-1]]
        frames = super().shoot([self._possible(setting) for setting in old])
        return (
            replace(frame, requested=setting, applied=setting)
            for frame, setting in zip(frames, settings, strict=True)
        )

    def _possible(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, time_s=self.controls.time_s.nearest(setting.time_s))


class PreviewsOldFrames(Defective):
    earlier: ExposureSetting | None = None

    def preview(self, setting: ExposureSetting) -> Frame:
        frame = super().preview(self.earlier or setting)
        self.earlier = setting
        return replace(frame, requested=setting, applied=setting)


class RoundsSilently(Defective):
    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        time = self.controls.time_s
        return super().shoot([replace(s, time_s=time.nearest(s.time_s)) for s in settings])


class ReusesItsBuffer(Defective):
    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        return self._frames(super().shoot(settings))

    def _frames(self, frames: FrameStream) -> Generator[Frame, None, None]:
        buffer = None
        for frame in frames:
            buffer = frame.pixels.copy() if buffer is None else buffer
            buffer[:] = frame.pixels
            yield replace(frame, pixels=buffer)


class ReportsAnotherWhiteLevel(Defective):
    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        return (replace(frame, white=frame.white - 1) for frame in super().shoot(settings))


class LosesTheLastFrame(Defective):
    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        return (f for f in super().shoot(settings) if f.index < max(1, len(settings) - 1))


class SettlesForEachExposure(Defective):
    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        self.controls.check(settings[0])
        return (
            replace(next(super(SettlesForEachExposure, self).shoot([setting])), index=index)
            for index, setting in enumerate(settings)
        )


class WorksWhenClosed(Defective):
    def close(self) -> None:
        pass


@pytest.mark.parametrize(
    ("defect", "check"),
    [
        (ReturnsOldFrames, CameraConformance.test_light_is_proportional_to_the_exposure),
        (PreviewsOldFrames, CameraConformance.test_preview_has_the_requested_exposure),
        (RoundsSilently, CameraConformance.test_setting_between_two_steps_is_refused),
        (
            RoundsSilently,
            CameraConformance.test_setting_out_of_range_is_refused_before_the_first_frame,
        ),
        (ReusesItsBuffer, CameraConformance.test_pixels_are_not_overwritten),
        (ReportsAnotherWhiteLevel, CameraConformance.test_frames_have_the_format_of_the_controls),
        (LosesTheLastFrame, CameraConformance.test_each_setting_gives_one_frame_in_order),
        (SettlesForEachExposure, CameraConformance.test_constant_delay_costs_n_plus_d_frames),
    ],
)
def test_suite_finds_a_defect(
    defect: Callable[[SimulatedCamera], Camera],
    check: Callable[[CameraConformance, Camera], None],
) -> None:
    suite = Steady()
    with suite.open_camera() as camera:
        assert isinstance(camera, SimulatedCamera)
        check(suite, camera)
    with suite.open_camera() as camera:
        assert isinstance(camera, SimulatedCamera)
        with pytest.raises((AssertionError, pytest.fail.Exception)):
            check(suite, defect(camera))


def test_suite_finds_a_camera_that_works_when_closed() -> None:
    class Suite(Steady):
        def open_camera(self) -> Camera:
            camera = super().open_camera()
            assert isinstance(camera, SimulatedCamera)
            return WorksWhenClosed(camera)

    with pytest.raises(pytest.fail.Exception):
        Suite().test_closed_camera_raises_a_camera_error()
