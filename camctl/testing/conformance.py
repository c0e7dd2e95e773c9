"""The conformance suite: the contract of `camctl.Camera`, checked on any camera.

A driver's own test module subclasses it, and opens a camera in front of a steady scene::

    class TestMyCamera(CameraConformance):
        def open_camera(self) -> Camera:
            return MyCamera("/dev/mine0").open()

The scene must be neither black nor white at `middle_s`, the shutter time that the tests are based
on, and must not look the same everywhere; override `middle_s`, too, where the default does not fit.
With `unplug`, `silence`, `open_second` and `in_force` overridden, more is checked.
"""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest

from camctl.errors import CameraError, RefusedSettingError, UsageError
from camctl.interface.camera import Camera, PreviewingCamera
from camctl.interface.controls import Choices, ExposureSetting, Layout, ResponseOrigin
from camctl.testing.cycle_checks import CycleChecks
from camctl.testing.fault_checks import FaultChecks
from camctl.testing.response_checks import ResponseChecks
from camctl.testing.sample_checks import SampleChecks
from camctl.testing.suite import UNUSABLE


class CameraConformance(SampleChecks, ResponseChecks, CycleChecks, FaultChecks):
    """Subclass it, override `open_camera`, and let pytest collect the subclass.

    `CameraSuite` lists what can be overridden beside it.
    """

    def test_identity_is_complete(self, camera: Camera) -> None:
        """The id finds the camera again; model and driver say what it is."""
        info = camera.info
        assert info.id
        assert info.model
        assert info.driver

    def test_frames_have_the_format_of_the_controls(self, camera: Camera) -> None:
        """Shape, pixel layout, type, black and white level of a frame are as in `controls`."""
        controls = camera.controls
        (frame,) = self.shoot(camera, self.times(camera, [1]))
        colours = (3,) if controls.layout is Layout.RGB else ()
        assert frame.pixels.shape == (*controls.shape, *colours)
        assert frame.pixels.dtype == (np.uint8 if controls.bits <= 8 else np.uint16)
        assert int(frame.pixels.max()) < 2**controls.bits
        assert (frame.black, frame.white) == (controls.black, controls.white)

    def test_the_response_is_known_or_said_to_be_assumed(self, camera: Camera) -> None:
        """`response_origin` is one of its values; the response of raw samples is known."""
        controls = camera.controls
        assert isinstance(controls.response_origin, ResponseOrigin)
        assert not (controls.layout.is_mosaic and controls.has_assumed_response), (
            "raw samples are linear, or have a response that the driver or the user states"
        )

    def test_each_setting_gives_one_frame_in_order(self, camera: Camera) -> None:
        """Every frame has the requested setting and the applied one."""
        settings = self.times(camera, [1, 2, 0.5, 1])
        frames = self.shoot(camera, settings)
        assert [frame.requested for frame in frames] == settings
        assert [frame.index for frame in frames] == [0, 1, 2, 3]
        for frame in frames:
            tolerance = max(camera.controls.tolerance, 1e-12)
            assert frame.applied.time_s == pytest.approx(frame.requested.time_s, rel=tolerance)
            assert frame.applied.gain == pytest.approx(frame.requested.gain, rel=tolerance)

    def test_timestamps_increase(self, camera: Camera) -> None:
        """Timestamps increase from frame to frame, and lie within the time of the sequence."""
        before_s = camera.clock.now()
        stamps_s = [f.timestamp_s for f in self.shoot(camera, self.times(camera, [1, 1, 2]))]
        assert stamps_s == sorted(set(stamps_s))
        assert before_s < stamps_s[0]
        assert stamps_s[-1] <= camera.clock.now()

    def test_empty_list_gives_no_frames(self, camera: Camera) -> None:
        """An empty list of settings is not an error."""
        assert self.shoot(camera, []) == []

    def test_light_is_proportional_to_the_exposure(self, camera: Camera) -> None:
        """Every frame has the exposure that it reports, not the exposure of an earlier one."""
        settings = self.times(camera, [1, 0.25, 1, 0.5, 0.25])
        frames = self.shoot(camera, settings)
        compared = [self.check_light(camera, frames[0], frame) for frame in frames[1:]]
        assert all(compared), UNUSABLE

    def test_setting_out_of_range_is_refused_before_the_first_frame(self, camera: Camera) -> None:
        """The call of `shoot` raises with the nearest setting, and the camera still works."""
        good = self.times(camera, [1])[0]
        beyond = ExposureSetting(camera.controls.time_s.maximum * 3, good.gain)
        with pytest.raises(RefusedSettingError) as refusal:
            camera.shoot([good, beyond])
        assert refusal.value.control == "time_s"
        assert refusal.value.nearest == pytest.approx(camera.controls.time_s.maximum)
        assert len(self.shoot(camera, [good])) == 1

    def test_setting_between_two_steps_is_refused(self, camera: Camera) -> None:
        """The camera does not round a setting silently to one of its steps."""
        control = camera.controls.time_s
        if isinstance(control, Choices):
            if len(control.values) < 2:
                pytest.skip("the camera has one shutter time")
            first, second = control.values[:2]
        elif control.step == 0:
            pytest.skip("the camera's shutter time is continuous")
        else:
            first = control.minimum
            second = first + control.step
        if (second - first) / first < 8 * camera.controls.tolerance:
            pytest.skip("the camera's steps are finer than its tolerance")
        between = ExposureSetting((first + second) / 2, camera.controls.gain.nearest(1.0))
        with pytest.raises(RefusedSettingError) as refusal:
            camera.shoot([between])
        assert refusal.value.nearest in (pytest.approx(first), pytest.approx(second))

    def test_impossible_shutter_time_is_a_usage_error(self, camera: Camera) -> None:
        """A shutter time is a positive, finite number."""
        for time_s in (0.0, -1.0, float("nan"), float("inf")):
            with pytest.raises(UsageError):
                camera.shoot([ExposureSetting(time_s)])

    def test_closing_the_iterator_cancels(self, camera: Camera) -> None:
        """After a cancelled sequence the camera works, without frames of the cancelled one."""
        first, second = self.times(camera, [1, 0.25])
        frames = camera.shoot([first, first, first])
        next(frames)
        frames.close()
        (frame,) = self.shoot(camera, [second])
        (again,) = self.shoot(camera, [second])
        ratio = self.light(camera, frame) / self.light(camera, again)
        assert ratio == pytest.approx(1, rel=self.light_tolerance)

    def test_pixels_are_not_overwritten(self, camera: Camera) -> None:
        """A later frame does not change the pixels of an earlier one."""
        stream = camera.shoot(self.times(camera, [1, 0.25]))
        with closing(stream) as frames:
            first = next(frames)
            copy = first.pixels.copy()
            next(frames)
        assert np.array_equal(first.pixels, copy)

    def test_constant_delay_costs_n_plus_d_frames(self, camera: Camera) -> None:
        """With a constant control delay the stream does not settle for each exposure."""
        controls = camera.controls
        if controls.delay_frames is None:
            pytest.skip("the camera's control delay is not constant")
        settings = self.times(camera, [1, 0.5, 1, 0.5, 1, 0.5])
        if not controls.frame_interval_s:
            pytest.skip("the camera's frames are released one by one")
        slots_s = [max(controls.frame_interval_s, setting.time_s) for setting in settings]
        before = camera.clock.now()
        stamps_s = [frame.timestamp_s for frame in self.shoot(camera, settings)]
        # One frame in each slot: an unused slot between them would add its whole length.
        assert stamps_s[-1] - stamps_s[0] <= sum(slots_s[1:]) + max(slots_s) / 2
        # The list may arrive too late for the present frame and for the next one.
        slots = len(settings) + controls.delay_frames + 2
        assert stamps_s[-1] - before <= slots * max(slots_s) * 1.02

    def test_preview_has_the_requested_exposure(self, camera: Camera) -> None:
        """A preview, too, is not a frame of an earlier setting."""
        if not isinstance(camera, PreviewingCamera):
            pytest.skip("the camera has no preview")
        long, short = self.times(camera, [1, 0.25])
        bright, dim = (camera.preview(setting) for setting in (long, short))
        assert self.check_light(camera, bright, dim), UNUSABLE

    def test_closed_camera_raises_a_camera_error(self) -> None:
        """A camera may be closed twice; shooting with a closed camera is an error."""
        camera = self.open_camera()
        setting = self.times(camera, [1])
        camera.close()
        camera.close()
        with pytest.raises(CameraError):
            self.shoot(camera, setting)
