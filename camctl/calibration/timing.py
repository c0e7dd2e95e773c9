"""How regularly frames come, and how long each takes to arrive: for the predicted wall time."""

from __future__ import annotations

from itertools import pairwise
from statistics import fmean, median, pstdev

from camctl.errors import CameraProtocolError
from camctl.interface.camera import Camera, StreamingCamera
from camctl.interface.controls import ExposureSetting
from camctl.profiles.profile import FrameTiming

#: Frames of a stream whose times are compared, and frames of which the arrival is measured.
_STREAMED, _ARRIVED = 32, 8
#: Shutter time and number of frames of a still camera, s.
_STILL_S, _STILLS = 1 / 60, 4


def measure_stream_timing(camera: StreamingCamera) -> FrameTiming:
    """Measure interval, jitter and read-out of a stream with an exposure within one frame.

    Raises:
        CameraProtocolError: the times of the frames do not ascend
        CameraError: as `StreamingCamera.step` raises
    """
    controls = camera.controls
    time_s = controls.time_s.nearest(max(controls.frame_interval_s / 2, controls.time_s.minimum))
    setting = ExposureSetting(time_s, controls.gain.nearest(1.0))
    ends = [frame.timestamp_s for frame in camera.step(setting, setting, _STREAMED)]
    steps = [after - before for before, after in pairwise(ends)]
    if min(steps) <= 0:
        raise CameraProtocolError(
            "the times of the camera's frames do not ascend",
            hint="report this camera and its driver",
        )
    usual_s = median(steps)
    slots = [max(1, round(step / usual_s)) for step in steps]
    # The median itself is wrong where most frames come early and few of them late.
    interval_s = sum(steps) / sum(slots)
    jitters = [step - slot * interval_s for step, slot in zip(steps, slots, strict=True)]
    arrivals = [
        camera.clock.now() - frame.timestamp_s for frame in camera.shoot([setting] * _ARRIVED)
    ]
    return FrameTiming(
        frame_interval_s=interval_s,
        jitter_s=pstdev(jitters),
        readout_s=max(0.0, median(arrivals)),
        download_s=0.0,
        lost=sum(slots) - len(slots),
    )


def measure_still_timing(camera: Camera) -> FrameTiming:
    """Measure the time from frame to frame of a still camera beside its exposure, and its jitter.

    What read-out and download take of it is what the driver has measured meanwhile.

    Raises:
        CameraError: as `Camera.shoot` raises
    """
    controls = camera.controls
    setting = ExposureSetting(controls.time_s.nearest(_STILL_S), controls.gain.nearest(1.0))
    arrivals = [camera.clock.now() for _ in camera.shoot([setting] * _STILLS)]
    steps = [after - before for before, after in pairwise(arrivals)]
    timing = camera.controls.timing
    return FrameTiming(
        frame_interval_s=max(0.0, fmean(steps) - setting.time_s),
        jitter_s=pstdev(steps),
        readout_s=timing.readout_s if timing else 0.0,
        download_s=timing.download_s if timing else 0.0,
        lost=0,
    )
