"""Machine-vision cameras that speak GenICam, on GigE Vision or USB3 Vision.

A frame is released by software where the camera allows it, and else taken from a free run.  In both
the control delay says which frame has which setting, and what the camera states in its chunk data,
once the pixels have agreed with that.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np

from camctl.drivers.common.stream_camera import StreamCamera
from camctl.drivers.genicam import sequencer
from camctl.drivers.genicam.controls import TOLERANCE, ExposureControl
from camctl.drivers.genicam.evidence import Scale
from camctl.drivers.genicam.formats import choose_format
from camctl.drivers.genicam.levels import has_no_gamma, sample_levels
from camctl.drivers.genicam.libraries import DRIVER, camera_info
from camctl.drivers.genicam.port import FoundDevice, Library, OpenDevice, Received
from camctl.drivers.genicam.preparation import (
    GenicamOptions,
    choose_rate,
    choose_trigger,
    turn_chunks_on,
)
from camctl.drivers.genicam.slots import FreeRunFrames, TriggeredSlots, no_complete_frame
from camctl.drivers.genicam.uploaded import UploadedCycle, UploadedSequence
from camctl.errors import CameraError, CameraProtocolError, UsageError
from camctl.interface.camera import CameraInfo, CyclePlace, Frame, MeasuredDelay, Pixels
from camctl.interface.clock import CaptureTiming, Clock, RealClock
from camctl.interface.controls import (
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
)
from camctl.interface.cycle import FrameCycle, check_not_empty
from camctl.model.response.camera import linear_response, named_response
from camctl.profiles.profile import load_profile
from camctl.streaming import (
    ControlDelay,
    DelayOrigin,
    ExposurePipeline,
    Shot,
    TimestampedStream,
    mean_brightness,
)

#: Buffers that are filled while no frame is taken, as many as of V4L2 cameras.
_BUFFERS = 8
#: Silence after which the camera counts as frozen, s, beyond an exposure.
SILENCE_S = 10.0
#: A released frame is exposed after the setting was written, so its delay is 0 in most cameras;
#: image sensors that take their registers over at the end of a frame need up to two more.
_TRIGGERED_DELAY = ControlDelay(0, 2, DelayOrigin.ASSUMED)
#: Frames from a request in free run until the first whose exposure begins after the write.
_LEAD_FRAMES = 1.5
#: Exposure of the frames that are taken when the camera is opened, s.
_FIRST_EXPOSURE_S = 0.002


class GenicamCamera(StreamCamera[Received]):
    """A GenICam camera; a `PreviewingCamera` and a `StreamingCamera` of `camctl.interface.camera`.

    The constructor does no I/O; `open` raises the errors below.

    Args:
        library: that opens it
        device: as the library has found it
        options: see `GenicamOptions`
        clock: the system's monotonic one by default
        silence_s: how long it may send nothing, beyond an exposure

    Raises:
        UsageError: an option that this camera does not support
        CameraBusyError: another program controls it
        CameraError: it has no manual exposure
        CameraDisconnectedError, CameraTimeoutError, CameraProtocolError
    """

    _device: OpenDevice

    def __init__(
        self,
        library: Library,
        device: FoundDevice,
        options: GenicamOptions | None = None,
        *,
        clock: Clock | None = None,
        silence_s: float = SILENCE_S,
    ) -> None:
        super().__init__(f"{DRIVER}:{device.name}", clock or RealClock())
        self._library = library
        self._found = device
        self._options = options or GenicamOptions()
        self._silence_s = silence_s
        self._shift = 0  # bits below the used ones of a sample

    @property
    def mode(self) -> str:
        """Pixel format, size, and how frames are released."""
        rows, columns = self.controls.shape
        return f"{self._format.name.lower()}-{columns}x{rows}-{self._rate}"

    @property
    def controls(self) -> ExposureControls:
        controls = super().controls
        return replace(controls, timing=self._timing(self._pipeline.delay))

    @property
    def device(self) -> OpenDevice:
        """The open device, for its features."""
        self._check_open()
        return self._device

    # ---- opening

    def _open(self) -> None:
        self._device = self._library.open(self._found)
        try:
            self._start()
        except BaseException:
            self._device.close()
            raise

    def _close(self) -> None:
        """Leave the camera in free run, as other programs expect it."""
        device = self._device
        with suppress(CameraError):
            device.stop()
            sequencer.turn_off(device)
            if self._is_triggered:
                device.write("TriggerMode", "Off")
        device.close()

    def _start(self) -> None:
        """Prepare the open device and start to take frames."""
        device, options, name = self._device, self._options, self._name
        self._info = info = camera_info(self._found, device)
        self._exposure = exposure = ExposureControl(device, name, options.gain)
        self._format = choose_format(device.entries("PixelFormat"), options.format, name)
        device.write("PixelFormat", self._format.name)
        if options.black_level is not None:
            device.write("BlackLevel", options.black_level)
        self._is_triggered = choose_trigger(device, name, options.trigger)
        findings = turn_chunks_on(device) if options.chunks == "auto" else []
        self._sets = sequencer.sets(device) if options.sequencer == "on" else 0
        if options.sequencer == "on" and not self._sets:
            raise UsageError(f"{name} has no sequencer", hint="leave it off")
        interval_s = 0.0
        if not self._is_triggered:
            interval_s = 1 / choose_rate(device, exposure, name, options.fps)
        times = exposure.times(interval_s or None)
        gain = exposure.gains.minimum
        exposure.write(ExposureSetting(times.nearest(_FIRST_EXPOSURE_S), gain))
        device.start(_BUFFERS)
        self._rate = "software" if self._is_triggered else f"{round(1 / interval_s, 3):g}"
        first = self._start_pipeline(interval_s)
        levels = sample_levels(options, self._format, first)
        self._shift = levels.shift
        response = named_response(options.response, levels.bits, levels.white - levels.black)
        self._scale = Scale.of(
            levels.black,
            levels.white,
            response or linear_response(levels.bits, levels=levels.white - levels.black),
        )
        delay = self._delay_in_profile(info, first.shape)
        self._pipeline.delay = delay
        if not self._is_triggered:
            interval_s = self._stream.frame_clock.interval_s
            times = exposure.times(min(interval_s, self._announced_s))
        is_stated = "response" in options.model_fields_set or has_no_gamma(device)
        self._controls = ExposureControls(
            time_s=times,
            gain=exposure.gains,
            shape=first.shape,
            layout=self._format.layout,
            pixel_format=self._format.name,
            bits=levels.bits,
            black=levels.black,
            white=levels.white,
            response=response,
            response_origin=ResponseOrigin.STATED if is_stated else ResponseOrigin.ASSUMED,
            delay_frames=delay.frames,
            frame_interval_s=interval_s,
            tolerance=TOLERANCE,
            findings=(*exposure.findings, *findings, *levels.findings, *delay.findings(info.id)),
        )

    def _start_pipeline(self, interval_s: float) -> Received:
        """Make the pipeline and return the first frame."""
        device, name, clock = self._device, self._name, self._clock
        delay = _TRIGGERED_DELAY if self._is_triggered else ControlDelay.of(None)
        if self._is_triggered:
            slots = TriggeredSlots(
                device,
                name,
                self._exposure,
                clock,
                self._silence_s,
                lambda frame: self._statement(frame.chunks),
            )
            self._pipeline = ExposurePipeline(slots, delay, self._brightness)
            self._overhead_s, first = slots.timed(self._exposure.gains.minimum, self._samples)
            return first
        self._announced_s = interval_s
        frames = self._run_free(delay)
        for _ in range(_BUFFERS):
            frames.grab()
            if (found := frames.retrieve()) is not None:
                return found
        raise no_complete_frame(name)

    def _run_free(self, delay: ControlDelay) -> FreeRunFrames:
        """Take frames from a free run that has just begun, with a pipeline of its own."""
        frames = FreeRunFrames(
            self._device, self._name, self._exposure, self._clock, self._silence_s
        )
        self._stream = TimestampedStream[Received](
            frames,
            self._clock,
            self._announced_s,
            sequence=lambda: frames.sequence,
            stated=lambda frame: self._statement(frame.chunks),
        )
        self._stream.start()
        self._pipeline = ExposurePipeline(self._stream, delay, self._brightness)
        return frames

    # ---- delay and time

    def _delay_in_profile(self, info: CameraInfo, shape: tuple[int, int]) -> ControlDelay:
        mode = f"{self._format.name.lower()}-{shape[1]}x{shape[0]}-{self._rate}"
        record = load_profile(info).delays.get(mode)
        return self._delay(None if record is None else record.bounds)

    def _delay(self, measured: MeasuredDelay | None) -> ControlDelay:
        if measured is None and self._is_triggered:
            return _TRIGGERED_DELAY
        return ControlDelay.of(measured)

    def _timing(self, delay: ControlDelay) -> CaptureTiming:
        if self._is_triggered:
            timing = replace(delay.timing(0.0), readout_s=self._overhead_s)
        else:
            readout_s = delay.readout_s or self._stream.arrival_s
            is_constant = delay.frames is not None
            timing = replace(delay.timing(_LEAD_FRAMES), readout_s=readout_s, rests=is_constant)
        # A frame that states its exposure ends the wait, mostly the first one that may have it.
        is_stated = self._pipeline.is_stated
        return replace(timing, old_frames=0.0, unsettled_frames=0.0) if is_stated else timing

    # ---- frames

    def _brightness(self, frame: Received) -> float:
        pixels = self._samples(frame)
        return 0.0 if pixels is None else mean_brightness(pixels, 2**self._format.bits)

    def _samples(self, frame: Received) -> Pixels | None:
        pixels = self._format.samples(frame)
        if pixels is None or not self._shift:
            return pixels
        return np.right_shift(pixels, self._shift)

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        if 2 <= len(settings) <= self._sets:
            yield from self._uploaded(settings)
            return
        if self._is_triggered:  # a slot is an exposure: nothing has to rest
            for shot in self._pipeline.shoot(settings):
                yield self._frame(shot, settings[shot.index])
                self._check_open()
            return
        yield from super()._frames(settings)

    def _statement(self, chunks: Mapping[str, float]) -> ExposureSetting | None:
        """Return the exposure that a frame states itself."""
        return self._exposure.stated(chunks.get("ExposureTime"), chunks.get("Gain"))

    def _frame(self, shot: Shot[Received], requested: ExposureSetting) -> Frame:
        made = self._made(shot.data, requested, shot.applied, shot.time_s, shot.index)
        return replace(made, lost=shot.lost)

    def _made(
        self,
        received: Received,
        requested: ExposureSetting,
        applied: ExposureSetting,
        time_s: float,
        index: int,
    ) -> Frame:
        pixels = self._samples(received)
        colours = (3,) if self._format.layout is Layout.RGB else ()
        if (
            pixels is None
            or received.code != self._format.code
            or pixels.shape != (*self.controls.shape, *colours)
        ):
            raise CameraProtocolError(
                f"{self._name} has changed its pixel format or its size",
                hint="close other programs and open it again",
            )
        counts = self._device.packets()
        details: dict[str, Any] = {"frame_id": received.number}
        if received.chunks:
            details["chunks"] = dict(received.chunks)
        if counts.missing or counts.resent:
            details["packets"] = {"missing": counts.missing, "resent": counts.resent}
        return Frame(
            pixels=pixels,
            requested=requested,
            applied=applied,
            timestamp_s=time_s,
            index=index,
            black=self._scale.black,
            white=self._scale.white,
            details=details,
        )

    # ---- uploaded

    def cycle(self, settings: Sequence[ExposureSetting]) -> FrameCycle:
        """Return frames without end; see `camctl.interface.cycle.CyclingCamera`."""
        if not self._sets:
            return super().cycle(settings)
        check_not_empty(settings)
        checked = self._checked(settings)
        self._check_uploadable(checked)
        self._is_shooting = True
        try:
            return UploadedCycle(
                self._sequence(),
                checked,
                self._check_open,
                self._check_uploadable,
                self._cycled,
                self._end_uploaded,
            )
        except BaseException:
            self._end_cycle()
            raise

    def _resume(self) -> None:
        """Go on as before an uploaded sequence: a free run has begun anew, with other numbers."""
        if self._is_triggered:
            self._pipeline.release()  # the sequencer has set what is in force
        else:
            self._run_free(self._pipeline.delay)

    def _end_uploaded(self) -> None:
        self._end_cycle()
        if self._is_open:
            self._resume()

    def _check_uploadable(self, settings: Sequence[ExposureSetting]) -> None:
        for setting in settings:
            self.controls.check(setting)
        if not 2 <= len(settings) <= self._sets:
            raise UsageError(
                f"a list of {len(settings)} exposures cannot be uploaded",
                hint=f"give 2 to {self._sets}, or leave the sequencer off",
            )

    def _cycled(
        self, received: Received, setting: ExposureSetting, index: int, place: CyclePlace
    ) -> Frame:
        frame = self._made(received, setting, setting, received.arrived_s, index)
        return replace(frame, place=place)

    def _sequence(self) -> UploadedSequence:
        return UploadedSequence(
            self._device,
            self._name,
            self._exposure,
            self._scale,
            self._samples,
            self._clock,
            self._silence_s,
            is_triggered=self._is_triggered,
        )

    def _uploaded(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        """Upload a list and yield its frames, once the pixels show where it begins."""
        sequence = self._sequence()
        try:
            sequence.start(settings)
            taken = list(islice(sequence.frames(settings), len(settings)))
        finally:
            sequence.stop()
            self._resume()
        for (index, received), setting in zip(taken, settings, strict=True):
            yield self._made(received, setting, setting, received.arrived_s, index)
