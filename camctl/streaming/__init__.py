"""Streaming cameras: which frame had which exposure, although the controls take effect late.

A streaming camera divides time into slots of one frame each.  A setting that is written while slot
k is being exposed is in force from slot k + 1 + d on; d is the control delay in frames.  It is -1
where a camera applies a setting to the frame that is being exposed.
`ExposurePipeline` writes a list of settings into such a stream and yields one frame for each: with
a constant delay, n settings take n + d frames; `ExposureCycle` repeats a list without end.  Both
need a `NumberedSource`, a stream that states the slot number of each frame, for example from the
device's sequence numbers.  `TimestampedStream` makes a numbered source of a stream that has only
timestamps.
"""

from camctl.interface.controls import resting_setting
from camctl.streaming.control_delay import (
    ControlDelay,
    DelayOrigin,
    FrameStamp,
    NumberedSource,
    Written,
    mean_brightness,
    with_delay,
)
from camctl.streaming.cycle import ExposureCycle, StreamCycle
from camctl.streaming.frame_clock import FrameClock, TimestampedSource, TimestampedStream
from camctl.streaming.pipeline import ExposurePipeline, Shot

__all__ = [
    "ControlDelay",
    "DelayOrigin",
    "ExposureCycle",
    "ExposurePipeline",
    "FrameClock",
    "FrameStamp",
    "NumberedSource",
    "Shot",
    "StreamCycle",
    "TimestampedSource",
    "TimestampedStream",
    "Written",
    "mean_brightness",
    "resting_setting",
    "with_delay",
]
