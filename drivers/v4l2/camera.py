"""Webcams and machine-vision cameras through Video4Linux.

Frames come from buffers that the kernel fills (`camctl.drivers.v4l2.capture`), controls, formats
and names through ioctls (`camctl.drivers.v4l2.node`).  `camctl.streaming` assigns exposures to
frames by the frames' timestamps and sequence numbers.
"""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field

from camctl.drivers.common.gain_unit import GainUnit, parse_gain
from camctl.drivers.common.packed_samples import used_bits
from camctl.drivers.common.stream_camera import StreamCamera
from camctl.drivers.v4l2.capture import Capture, StreamMode, choose_mode
from camctl.drivers.v4l2.controls import EXPOSURES, ExposureControl
from camctl.drivers.v4l2.formats import SampleScale, choose_format, sample_scale
from camctl.drivers.v4l2.kernel import Kernel
from camctl.drivers.v4l2.node import Node
from camctl.drivers.v4l2.system import camera_info
from camctl.errors import CameraProtocolError
from camctl.findings import note
from camctl.interface.backends import BackendOptions, FrameShape, LowerCase
from camctl.interface.camera import Frame, Pixels
from camctl.interface.clock import Clock, RealClock
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.profiles.profile import load_profile
from camctl.streaming import (
    ControlDelay,
    ExposurePipeline,
    Shot,
    TimestampedStream,
    mean_brightness,
)

#: Frames from a request until the first one whose exposure begins after the write, on average: the
#: rest of the running one, and the next, since the write comes after the running one was grabbed.
_LEAD_FRAMES = 1.5


class V4l2Options(BackendOptions):
    """Options of a V4L2 camera.

    Attributes:
        format: a name of `camctl.drivers.v4l2.formats.FORMATS`, "bayer" for the Bayer format with
            the most bits, or "auto" for the format of highest fidelity
        size: of a frame; None: the largest with 15 frames a second or more
        fps: frames a second; None: the fewest from 15 on that the camera offers, because no
            exposure is longer than the interval between frames
        bits: bits that the samples of y16 or bayer16 use; None: all
        black: brightness without light, DN; None: 0, or 16 of limited luma
        gain: what the steps of the gain add; None: unknown, so that the gain is held
        range: of luma; "auto": as V4L2 reports
        response: one of `model.response.camera.RESPONSES`; "auto": linear for raw samples, else
            sRGB
    """

    format: Annotated[str, LowerCase] = "auto"
    size: FrameShape | None = None
    fps: float | None = Field(default=None, gt=0, le=10_000, allow_inf_nan=False)
    bits: int | None = Field(default=None, ge=9, le=16)
    black: int | None = Field(default=None, ge=0)
    gain: Annotated[GainUnit | None, BeforeValidator(parse_gain)] = None
    range: Annotated[Literal["auto", "full", "limited"], LowerCase] = "auto"
    response: Annotated[str, LowerCase] = "auto"


class V4l2Camera(StreamCamera[Pixels]):
    """A V4L2 camera; a `PreviewingCamera` and a `StreamingCamera` of `camctl.interface.camera`.

    The constructor does no I/O; `open` starts the stream and raises the errors below.

    Args:
        path: of its node, best the link in /dev/v4l/by-id
        options: see `V4l2Options`
        clock: the clock of the frames' timestamps; the system's monotonic one by default
        kernel: the system calls, replaced in tests
        root: of the files of the system, likewise

    Raises:
        UsageError: an option that this camera does not support
        DataError: its profile is damaged
        CameraError: it cannot be opened, is not a camera, or has no manual exposure
        CameraBusyError, CameraDisconnectedError, CameraTimeoutError, CameraProtocolError
    """

    _mode: StreamMode
    _scale: SampleScale
    _open_resources: ExitStack

    def __init__(
        self,
        path: str,
        options: V4l2Options | None = None,
        *,
        clock: Clock | None = None,
        kernel: Kernel | None = None,
        root: Path = Path("/"),
    ) -> None:
        super().__init__(path, clock or RealClock())
        self._path = path
        self._options = options or V4l2Options()
        self._kernel, self._root = kernel, root

    @property
    def mode(self) -> str:
        """Pixel format, size and frame rate, such as yuyv-640x480-30."""
        self._check_open()
        return self._mode.name

    def _open(self) -> None:
        with ExitStack() as resources:
            node = resources.enter_context(Node(self._path, self._kernel))
            self._start(node, resources)
            self._open_resources = resources.pop_all()

    def _start(self, node: Node, resources: ExitStack) -> None:
        """Start the stream of an open node; what has to be closed is added to `resources`."""
        options, path = self._options, self._path
        identity = node.capture_identity()
        info = camera_info(path, identity.driver, identity.card)
        format_ = choose_format(node.formats(), options.format, path)
        mode = choose_mode(node, format_, options.size, options.fps)
        shape = mode.shape
        capture = Capture(node, mode)
        resources.callback(capture.close)
        self._mode = StreamMode(format_, shape, capture.interval_s)
        exposure = self._exposure(node, shape[1], resources)
        source = _Frames(path, capture, exposure, format_.bits)
        stream = TimestampedStream[Pixels](
            source, self._clock, self._mode.interval_s, sequence=lambda: capture.sequence
        )
        stream.start()
        if format_.bits == 16 and (first := stream.read()) is not None:
            source.shift = 16 - used_bits(first, options.bits)
        self._scale = scale = sample_scale(
            format_,
            node.current_format(),
            bits=16 - source.shift if source.shift else options.bits,
            black=options.black,
            luma_range=options.range,
            response=options.response,
        )
        source.bits = 16 if source.shift else scale.bits
        delay = ControlDelay.from_record(load_profile(info).delays.get(self._mode.name))
        self._pipeline = ExposurePipeline(
            stream, delay, lambda pixels: mean_brightness(pixels, scale.white - scale.black)
        )
        announced_s, measured_s = self._mode.interval_s, stream.frame_clock.interval_s
        self._info = info
        self._controls = ExposureControls(
            time_s=exposure.times(min(announced_s, measured_s)),
            gain=exposure.gains,
            shape=shape,
            layout=format_.layout,
            pixel_format=format_.name,
            bits=scale.bits,
            black=scale.black,
            white=scale.white,
            response=scale.response,
            response_origin=scale.response_origin,
            delay_frames=delay.frames,
            frame_interval_s=measured_s,
            timing=replace(
                delay.timing(_LEAD_FRAMES),
                readout_s=delay.readout_s or stream.arrival_s,
                rests=delay.frames is not None,
            ),
            findings=(
                *scale.findings,
                *exposure.findings,
                *map(note, _rate_notes(announced_s, measured_s)),
                *map(note, _upper_bits_notes(source.shift)),
                *delay.findings(info.id),
            ),
        )

    def _exposure(self, node: Node, columns: int, resources: ExitStack) -> ExposureControl:
        """Return the exposure of a node, or of the sensor behind it where it has none itself."""
        gain = self._options.gain
        if not any(node.control(each) for each in EXPOSURES):
            sensor = node.sensor(self._root)
            if sensor is not None:
                resources.enter_context(sensor)
                return ExposureControl(sensor, sensor.columns() or columns, gain)
        return ExposureControl(node, columns, gain)

    def _close(self) -> None:
        self._open_resources.close()

    def _frame(self, shot: Shot[Pixels], requested: ExposureSetting) -> Frame:
        return Frame(
            pixels=shot.data,
            requested=requested,
            applied=shot.applied,
            timestamp_s=shot.time_s,
            index=shot.index,
            black=self._scale.black,
            white=self._scale.white,
            lost=shot.lost,
        )


class _Frames:
    """The stream of an open node: a `camctl.streaming.TimestampedSource` of pixels."""

    def __init__(self, path: str, capture: Capture, exposure: ExposureControl, bits: int) -> None:
        self._path = path
        self._capture = capture
        self.bits, self.shift = bits, 0  # bits below the used ones of a sample
        self.write = exposure.write
        self.grab = capture.grab

    def retrieve(self) -> Pixels | None:
        """Return the samples of the frame grabbed last; None where it is damaged.

        Raises:
            CameraProtocolError: a sample has more bits than the format, or than the first frame
        """
        pixels = self._capture.retrieve()
        if pixels is not None and self.shift:
            lower = pixels & np.uint16(2**self.shift - 1) > 0
            if lower.any() and (pixels[lower] < 0xFFFF).any():  # white may have all bits
                raise CameraProtocolError(
                    f"{self._path} sent samples of more than the {16 - self.shift} upper bits",
                    hint="say that all 16 bits are used",
                    remedies={"option:bits": "16"},
                )
            return np.right_shift(pixels, self.shift)
        if pixels is None or self.bits == 8 * pixels.itemsize:
            return pixels
        most = int(pixels.max())
        if most >= 2**self.bits:
            raise CameraProtocolError(
                f"{self._path} sent the sample {most}, which has more than {self.bits} bits",
                hint="give the number of bits, or choose another format",
                remedies={"option:bits": None, "option:format": None},
            )
        return pixels


def _rate_notes(announced_s: float, measured_s: float) -> tuple[str, ...]:
    if measured_s == announced_s:
        return ()
    announced, measured = 1 / announced_s, 1 / measured_s
    return (f"the camera announces {announced:.3g} frames a second and sends {measured:.3g}",)


def _upper_bits_notes(shift: int) -> tuple[str, ...]:
    return (f"the upper {16 - shift} bits of 16 are used, by the first frame",) if shift else ()
