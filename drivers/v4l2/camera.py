"""Webcams and machine-vision cameras through Video4Linux: the camera and the road to it.

Frames come through OpenCV (`drivers.v4l2.capture`); controls, formats and names through ioctls on
a descriptor of our own (`drivers.v4l2.node`); which frame had which exposure is told by
`drivers.v4l2.stream`.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence

from camctl.camera import CameraInfo, Closing, Frame, FrameStream, Pixels
from camctl.clock import Clock, RealClock
from camctl.controls import ExposureControls, ExposureSetting
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraProtocolError,
)
from camctl.profile import DelayRecord, load_profile
from drivers.v4l2.capture import Capture, Picture, VideoOpener, open_video
from drivers.v4l2.controls import ExposureControl, GainUnit
from drivers.v4l2.discovery import describe
from drivers.v4l2.formats import SpoiltFrameError, choose_format, read_samples
from drivers.v4l2.modes import choose_interval, choose_size
from drivers.v4l2.node import Kernel, Node
from drivers.v4l2.stream import UNKNOWN_DELAY, Shot, Stream


class V4l2Camera(Closing):
    """A V4L2 camera; implements `PreviewingCamera` and `StreamingCamera` of `camctl.camera`.

    Args:
        path: its node, best the link in /dev/v4l/by-id
        format: a name of `drivers.v4l2.formats.FORMATS`, "bayer", or "auto": the most honest
        size: (width, height), pixels; None: the largest
        fps: frames a second; None: the fewest that it offers, because no exposure is longer than
            the interval between frames
        bits: that the samples of y16 really have, 9 to 16
        black: brightness without light, DN; None: 0, or 16 of limited luma
        gain: what the steps of its gain do; None: unknown, so that it is held
        range: "full" or "limited" luma; "auto": as V4L2 says
        response: one of `camctl.response.camera.RESPONSES`; "auto": linear where samples are raw,
            else sRGB
        clock: the clock of the frames' timestamps
        kernel, opener: system calls and video, for tests

    Raises:
        UsageError: an option that is no option, or that this camera does not have
        DataError: its profile is damaged
        CameraError: it cannot be opened, is no camera, or has no manual exposure
        CameraBusyError, CameraDisconnectedError, CameraTimeoutError, CameraProtocolError

    """

    def __init__(
        self,
        path: str,
        *,
        format: str = "auto",
        size: tuple[int, int] | None = None,
        fps: float | None = None,
        bits: int | None = None,
        black: int | None = None,
        gain: GainUnit | None = None,
        range: str = "auto",
        response: str = "auto",
        clock: Clock | None = None,
        kernel: Kernel | None = None,
        opener: VideoOpener = open_video,
    ) -> None:
        self._clock = clock or RealClock()
        self._is_shooting = False
        self._capture: Capture | None = None
        self._node = Node(path, kernel)
        try:
            self._info = describe(path, self._node.check_capture())
            chosen = choose_format(self._node.formats(), format, path)
            wanted = choose_size(self._node.sizes(chosen.fourcc), size, path)
            interval_s = choose_interval(self._node.intervals(chosen.fourcc, wanted), fps, path)
            self._picture = Picture(chosen, wanted, interval_s)
            self._capture = Capture(self._node, self._picture, self._clock, opener)
            announced_s = self._node.interval_s() or interval_s
            self._exposure = ExposureControl(self._node, gain)
            samples = read_samples(
                chosen,
                self._node.picture(),
                bits=bits,
                black=black,
                range_=range,
                response=response,
            )
            self._samples = samples
            self._stream = Stream(self, self._clock, announced_s, samples.white - samples.black)
            self._stream.start()
            seen_s = self._stream.slots.interval_s
            self._picture = Picture(chosen, wanted, announced_s)
            self._delay = load_profile(self._info).delays.get(self.mode)
            self._controls = ExposureControls(
                time_s=self._exposure.times(min(announced_s, seen_s)),
                gain=self._exposure.gains,
                shape=(wanted.height, wanted.width),
                layout=chosen.layout,
                bits=samples.bits,
                black=samples.black,
                white=samples.white,
                response=samples.response,
                delay_frames=None if self._delay is None else self._delay.frames,
                frame_interval_s=seen_s,
                notes=(
                    *samples.notes,
                    *self._exposure.notes,
                    *_rate_notes(announced_s, seen_s),
                    *_delay_notes(self._delay, self._info.id),
                ),
            )
        except BaseException:
            self.close()
            raise

    @property
    def info(self) -> CameraInfo:
        """Who it is."""
        return self._info

    @property
    def controls(self) -> ExposureControls:
        """What it can set."""
        return self._controls

    @property
    def clock(self) -> Clock:
        """The clock of its timestamps: the system's monotonic one."""
        return self._clock

    @property
    def mode(self) -> str:
        """Pixel format, size and frame rate, such as yuyv-640x480-30."""
        rate = round(1 / self._picture.interval_s, 3)
        return f"{self._picture.format.name}-{self._picture.size}-{rate:g}"

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Take the settings in their order; see `camctl.camera.Camera.shoot`."""
        wanted = tuple(settings)
        self._check_ready(wanted)
        return self._shoot(wanted)

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame at `setting`, for metering; raises as `shoot` does."""
        self._check_ready((setting,))
        frames = self._shoot((setting,))
        try:
            return next(frames)
        finally:
            frames.close()

    def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Frame]:
        """Return the frames that follow a change; see `camctl.camera.StreamingCamera.step`."""
        self._check_ready((before, after))
        shots = self._stream.step(before, after, frames)
        return [self._frame(shot, after) for shot in shots]

    def close(self) -> None:
        """Stop the stream and let go of the device; a second call does nothing."""
        capture, self._capture = self._capture, None
        if capture is not None:
            capture.close()
        self._node.close()

    def grab(self) -> float:
        """Wait for the next frame and return its timestamp, s: for the camera's own stream."""
        return self._running().grab()

    def retrieve(self) -> Pixels | None:
        """Return the samples of the frame grabbed last, None where they came spoilt.

        Raises:
            CameraProtocolError: samples have more bits than they should

        """
        data = self._running().retrieve()
        if data is None:
            return None
        try:
            pixels = self._picture.format.samples(data, self._picture.size)
        except SpoiltFrameError:
            return None
        most = int(pixels.max())
        if most >= 2**self._samples.bits:
            raise CameraProtocolError(
                f"{self._node.path} sends {most}, which is no sample of {self._samples.bits} bits",
                hint="name the bits with -O bits=..., or choose another -O format=...",
            )
        return pixels

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set the exposure and return it as read back: for the camera's own stream."""
        self._running()
        return self._exposure.write(setting)

    def _running(self) -> Capture:
        if self._capture is None:
            raise CameraDisconnectedError(
                f"the camera at {self._node.path} is closed", hint="open it again"
            )
        return self._capture

    def _check_ready(self, settings: Sequence[ExposureSetting]) -> None:
        self._running()
        if self._is_shooting:
            raise CameraBusyError(
                f"{self._node.path} is still shooting", hint="finish or close that shot first"
            )
        for setting in settings:
            self._controls.check(setting)

    def _shoot(self, settings: tuple[ExposureSetting, ...]) -> Generator[Frame, None, None]:
        if self._is_shooting:
            raise CameraBusyError(
                f"{self._node.path} is still shooting", hint="finish or close that shot first"
            )
        self._is_shooting = True
        try:
            if self._delay is not None and self._delay.frames is not None:
                shots = self._stream.shoot(settings, self._delay.frames)
            else:
                largest = UNKNOWN_DELAY if self._delay is None else self._delay.largest
                shots = self._stream.settle(settings, largest)
            for shot in shots:
                yield self._frame(shot, settings[shot.index])
        finally:
            self._is_shooting = False

    def _frame(self, shot: Shot, requested: ExposureSetting) -> Frame:
        return Frame(
            pixels=shot.pixels,
            requested=requested,
            applied=shot.applied,
            timestamp_s=shot.time_s,
            index=shot.index,
            black=self._samples.black,
            white=self._samples.white,
        )


def _rate_notes(announced_s: float, seen_s: float) -> tuple[str, ...]:
    if seen_s == announced_s:
        return ()
    return (
        f"the camera announces {1 / announced_s:.3g} frames a second and sends {1 / seen_s:.3g}",
    )


def _delay_notes(delay: DelayRecord | None, camera_id: str) -> tuple[str, ...]:
    if delay is None:
        return (
            "control delay not measured: the stream settles for each exposure; run camctl "
            f"calibrate delay --camera {camera_id}",
        )
    if delay.frames is None:
        return (
            f"the control delay is not constant ({delay.smallest} to {delay.largest} frames): "
            "the stream settles for each exposure",
        )
    return ()
