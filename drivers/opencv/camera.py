"""A camera or stream that OpenCV reads, as a `camctl.Camera`.

The stream settles after each setting: OpenCV keeps frames in buffers of unknown number, and says
neither when a frame was exposed nor how.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from camctl.drivers.common.response_option import ResponseOptions
from camctl.drivers.common.stream_camera import StreamCamera
from camctl.drivers.opencv.controls import (
    AddressExposure,
    Exposure,
    FixedExposure,
    PropertyExposure,
)
from camctl.drivers.opencv.video import Address, Video
from camctl.errors import CameraProtocolError
from camctl.findings import note
from camctl.interface.backends import FrameShape
from camctl.interface.camera import CameraInfo, Frame, Pixels
from camctl.interface.clock import Clock, RealClock
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.model.response.camera import named_response
from camctl.streaming import (
    ControlDelay,
    DelayOrigin,
    ExposurePipeline,
    FrameStamp,
    Shot,
    Written,
    mean_brightness,
)

DRIVER = "opencv"
#: Frames after a write that may still have the exposure before: four in OpenCV's buffers, and the
#: control delay of usual webcams.
SETTLING = 8
#: Frame interval where the stream states none, s.
_USUAL_INTERVAL_S = 1 / 30


_Seconds = Annotated[float | None, Field(gt=0, le=3600, allow_inf_nan=False)]


class OpencvOptions(ResponseOptions):
    """Options of a camera that OpenCV reads.

    Attributes:
        size: of a frame, of a camera by index; None: as it is
        settle: frames after each setting that may still have the one before
        time: exposure time of a stream that has no control for it, s; None: its frame interval
        shortest, longest: exposure times of an address with a place for one, s
    """

    size: FrameShape | None = None
    settle: int = Field(default=SETTLING, ge=1, le=200)
    time: _Seconds = None
    shortest: _Seconds = None
    longest: _Seconds = None


class OpencvCamera(StreamCamera[Pixels]):
    """A camera or stream that OpenCV reads; a `PreviewingCamera` of `camctl.interface.camera`.

    Args:
        address: an index, a URL or file, or a GStreamer pipeline; see `Address`
        options: see `OpencvOptions`
        clock: of timestamps and of time-outs

    Raises:
        UsageError: an option that does not fit the address
        CameraError: it cannot be opened, or its exposure cannot be set
    """

    def __init__(
        self, address: str, options: OpencvOptions | None = None, *, clock: Clock | None = None
    ) -> None:
        super().__init__(f"{DRIVER}:{address}", clock or RealClock())
        self._address = Address.parse(address)
        self._options = options or OpencvOptions()

    def _open(self) -> None:
        self._stream = _Stream(self._address, self._clock, self._options)
        try:
            self._start()
        except BaseException:
            self._stream.close()
            raise

    def _start(self) -> None:
        stream, options = self._stream, self._options
        first = stream.first_frame()
        bits = 8 * first.itemsize
        white = 2**bits - 1
        notes = [*stream.exposure.notes]
        if isinstance(stream.exposure, FixedExposure):
            delay = ControlDelay(0, 0, DelayOrigin.GUARANTEED)
        else:
            delay = ControlDelay(0, options.settle, DelayOrigin.ASSUMED)
            notes.append(
                f"OpenCV reports neither time nor exposure of a frame: after each setting "
                f"{options.settle} frames are left out, then two must be equally bright"
            )
        self._pipeline = ExposurePipeline[Pixels](
            stream, delay, lambda pixels: mean_brightness(pixels, white)
        )
        self._white = white
        self._info = CameraInfo(self._name, "", self._address.text, "", DRIVER)
        self._controls = ExposureControls(
            time_s=stream.exposure.times,
            shape=(first.shape[0], first.shape[1]),
            layout=Layout.MONO if first.ndim == 2 else Layout.RGB,
            bits=bits,
            white=white,
            response=named_response(options.response, bits, white),
            response_origin=options.response_origin,
            frame_interval_s=stream.interval_s,
            timing=delay.timing(0.0),
            findings=tuple(map(note, notes)),
        )

    def _close(self) -> None:
        self._stream.close()

    def _frame(self, shot: Shot[Pixels], requested: ExposureSetting) -> Frame:
        shape = shot.data.shape[:2]
        if shape != self.controls.shape:
            raise CameraProtocolError(
                f"{self._name} now sends frames of {shape[1]}x{shape[0]}",
                hint="open the camera again",
            )
        setting = requested, shot.applied, shot.time_s, shot.index
        return Frame(shot.data, *setting, 0, self._white, lost=shot.lost)


class _Stream:
    """The frames, counted as they arrive: a `camctl.streaming.NumberedSource` of pixels."""

    def __init__(self, address: Address, clock: Clock, options: OpencvOptions) -> None:
        self._address = address
        self._clock = clock
        self._number = 0
        self._video = Video(address, clock, options.shortest or 0.01)
        try:
            if address.kind == "index" and options.size is not None:
                self._video.set("FRAME_HEIGHT", options.size[0])
                self._video.set("FRAME_WIDTH", options.size[1])
            self.interval_s = self._video.interval_s or _USUAL_INTERVAL_S
            self.exposure = self._find_exposure(options)
        except BaseException:
            self.close()
            raise

    def _find_exposure(self, options: OpencvOptions) -> Exposure:
        if self._address.has_exposure:
            return AddressExposure(self.reopen, options.shortest, options.longest)
        if self._address.kind == "index":
            return PropertyExposure(self._video, self.interval_s)
        return FixedExposure(options.time or self.interval_s, is_stated=options.time is not None)

    def first_frame(self) -> Pixels:
        self.next_frame()
        data = self.read()
        if data is None:
            raise CameraProtocolError(
                f"{self._video.name} sends frames that OpenCV cannot decode",
                hint="choose another format on the camera",
            )
        return data

    def next_frame(self) -> FrameStamp:
        self._video.grab()
        self._number += 1
        return FrameStamp(self._number, self._clock.now())

    def read(self) -> Pixels | None:
        return self._video.retrieve()

    def upcoming(self, *, late: bool = False) -> int:
        """Return the number of the next frame: a setting may be written at any time."""
        return self._number + 1

    def write(self, setting: ExposureSetting) -> Written:
        applied = self.exposure.write(setting)
        return Written(applied, self._number + 1, self._number + 1)

    def reopen(self, time_s: float) -> None:
        """Open the stream again with another exposure time in its address."""
        self.close()
        self._video = Video(self._address, self._clock, time_s)

    def close(self) -> None:
        self._video.close()
