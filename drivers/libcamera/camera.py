"""A camera of the Raspberry Pi through picamera2 and libcamera."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from typing import Annotated, Any

from pydantic import StringConstraints

from camctl.drivers.common.stream_camera import PreviewedCamera
from camctl.drivers.libcamera.formats import RawFormat
from camctl.drivers.libcamera.probe import SAME_GAIN, Probed, probe
from camctl.drivers.libcamera.requests import Arrived, Requests, Stated, stated
from camctl.drivers.libcamera.stream import RequestCycle, RequestStream
from camctl.errors import CameraBusyError, CameraError, CameraNotFoundError, UsageError
from camctl.interface.backends import BackendOptions, FrameShape
from camctl.interface.camera import CameraInfo, Frame, Pixels
from camctl.interface.clock import CaptureTiming, Clock, RealClock
from camctl.interface.controls import (
    Choices,
    ExposureControls,
    ExposureSetting,
    ResponseOrigin,
    Steps,
    resting_setting,
)
from camctl.interface.cycle import FrameCycle, check_not_empty
from camctl.streaming import ControlDelay, ExposureCycle, Shot, mean_brightness

DRIVER = "libcamera"
#: Requests in flight: what picamera2 takes for video, so that no frame is lost at 30 a second.
_BUFFERS = 6
#: Share of a line by which requests are longer than their lines: more than the error of the line
#: and of whole microseconds, and less than a half.
_BETWEEN_LINES = 0.3
#: Largest size of the stream that libcamera processes beside the raw one, and nobody reads.
_SMALL = (640, 480)
#: A request at any time of a frame, and the frame that is being exposed: frames, on average.
_LEAD_FRAMES = 1.5
#: What is switched off where the camera has it, by libcamera's names; 0 is off or false in all.
_AUTOMATIC = ("AeEnable", "AwbEnable", "NoiseReductionMode", "AfMode", "HdrMode", "AeFlickerMode")

_Name = Annotated[str, StringConstraints(strip_whitespace=True)]


class LibcameraOptions(BackendOptions):
    """Options of a camera of the Raspberry Pi.

    Attributes:
        size: of a frame, one of the sensor's; None: the largest
        format: a raw format by its name in libcamera, such as SRGGB10_CSI2P; "auto": the most bits,
            unpacked
    """

    size: FrameShape | None = None
    format: _Name = "auto"


class LibcameraCamera(PreviewedCamera):
    """A camera of libcamera with raw frames; a `PreviewingCamera`.

    Each frame is the one whose metadata state the exposure that was requested.

    Args:
        address: number of the camera, or its id in libcamera; "": the only one
        options: see `LibcameraOptions`
        clock: of the time stamps; the system's monotonic one by default

    Raises:
        UsageError: an option that this camera does not support
        CameraError: it cannot be opened, or has no raw frames
        CameraNotFoundError, CameraBusyError, CameraTimeoutError, CameraProtocolError
    """

    _requests: Requests
    _resources: ExitStack

    def __init__(
        self, address: str, options: LibcameraOptions | None = None, *, clock: Clock | None = None
    ) -> None:
        super().__init__(f"{DRIVER}:{address}", clock or RealClock())
        self._address = address
        self._options = options or LibcameraOptions()
        # Sensors are stamped since the system's start, which goes on while it sleeps.
        self._ahead_s = 0.0 if clock else time.clock_gettime(time.CLOCK_BOOTTIME) - time.monotonic()

    def _open(self) -> None:
        with ExitStack() as resources:
            self._start(resources)
            self._resources = resources.pop_all()

    def _start(self, resources: ExitStack) -> None:
        library = picamera2()
        number, self._info = _find(self._address)
        with _worded(self._name):
            camera = _made(library, number)
            resources.callback(camera.close)
            mode = _choose_mode(camera, self._options, self._name)
            self._format = _configured(camera, mode, self._options, self._name)
            configuration = camera.camera_configuration()
            camera.start(show_preview=False)
        columns, rows = configuration["raw"]["size"]
        self._shape = rows, columns
        # The Pi 5 stores samples of fewer bits in the upper ones of 16.
        bits = min(int(configuration["sensor"]["bit_depth"]), self._format.bits)
        self._shift = self._format.bits - bits
        self._requests = Requests(camera, self._name)
        limits = camera.camera_controls
        times_us = tuple(int(each) for each in limits["ExposureTime"][:2])
        gains = tuple(float(each) for each in limits["AnalogueGain"][:2])
        self._probed = probe(self._requests, (times_us[0], times_us[1]), (gains[0], gains[1]))
        (first,) = self._requests.shoot((), 1, lambda place, metadata: True)
        black = first.metadata.get("SensorBlackLevels", (0,))[0] >> (16 - bits)
        interval_s = limits["FrameDurationLimits"][0] / 1e6
        self._controls = _controls(self._probed, interval_s, self._shape, self._format, bits, black)

    def _close(self) -> None:
        self._resources.close()

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        rest = resting_setting(self.controls, settings)
        begun_s = self._clock.now()
        to_send = [self._request(each) for each in (*settings, *([] if rest is None else [rest]))]

        def is_taken(place: int, metadata: Mapping[str, Any]) -> bool:
            found, setting = stated(metadata), settings[place]
            applied_s = self._applied_s(setting, found)
            return (
                applied_s is not None
                and abs(found.gain / setting.gain - 1) < SAME_GAIN
                and self._ended_s(metadata) - applied_s >= begun_s
            )

        longest_s = max((setting.time_s for setting in settings), default=0.0)
        frames = self._requests.shoot(to_send, len(settings), is_taken, longest_s)
        for index, (setting, arrived) in enumerate(zip(settings, frames, strict=True)):
            applied_s = self._applied_s(setting, stated(arrived.metadata))
            assert applied_s is not None  # it was taken
            yield self._frame(setting, ExposureSetting(applied_s, setting.gain), arrived, index)
            self._check_open()

    def cycle(self, settings: Sequence[ExposureSetting]) -> FrameCycle:
        """Return frames without end; see `camctl.interface.cycle.CyclingCamera`."""
        check_not_empty(settings)
        checked = self._checked(settings)
        delay = ControlDelay(0, self._probed.delay_frames)  # fewer where fewer requests wait
        stream = RequestStream(self._requests, self._request, self._stated, self._ended_s)
        self._is_shooting = True

        def ended() -> None:
            self._is_shooting = False
            stream.close()

        def frame(shot: Shot[Arrived], requested: ExposureSetting) -> Frame:
            return self._frame(requested, shot.applied, shot.data, shot.index)

        endless = ExposureCycle(stream, delay, self._brightness, checked)
        return RequestCycle(endless, self.controls, self._check_open, frame, ended)

    def _brightness(self, arrived: Arrived) -> float:
        return mean_brightness(self._samples(arrived), self.controls.white + 1)

    def _samples(self, arrived: Arrived) -> Pixels:
        return self._format.samples(arrived.data, self._shape, self._shift)

    def _frame(
        self, requested: ExposureSetting, applied: ExposureSetting, arrived: Arrived, index: int
    ) -> Frame:
        return Frame(
            pixels=self._samples(arrived),
            requested=requested,
            applied=applied,
            timestamp_s=self._ended_s(arrived.metadata),
            index=index,
            black=self.controls.black,
            white=self.controls.white,
        )

    def _applied_s(self, setting: ExposureSetting, found: Stated) -> float | None:
        """Return the time of a frame that states `found`; None where it is not of a setting.

        libcamera states whole microseconds, rounded down; lines are known to more.  Of very long
        times the number of lines may be wrong by some, and the stated time is exact enough.
        """
        line_us = self._probed.line_us
        lines_us = self._lines(setting) * line_us
        off_us = abs(found.time_us + 0.5 - lines_us)
        if off_us > max(line_us / 2, SAME_GAIN * lines_us):
            return None
        return (lines_us if off_us <= 1 else found.time_us + 0.5) / 1e6

    def _stated(self, metadata: Mapping[str, Any]) -> ExposureSetting:
        """Return the setting that the metadata of a frame state: whole lines, a gain it holds."""
        found, line_us = stated(metadata), self._probed.line_us
        gain = min(self._probed.gains, key=lambda each: abs(each - found.gain))
        lines = round((found.time_us + 0.5) / line_us)
        return ExposureSetting(
            lines * line_us / 1e6, gain if abs(found.gain / gain - 1) < SAME_GAIN else found.gain
        )

    def _lines(self, setting: ExposureSetting) -> int:
        return round(setting.time_s * 1e6 / self._probed.line_us)

    def _request(self, setting: ExposureSetting) -> Stated:
        """Return what libcamera rounds to the lines of a setting, whether down or to nearest."""
        lines = self._lines(setting) + _BETWEEN_LINES
        return Stated(round(lines * self._probed.line_us), setting.gain)

    def _ended_s(self, metadata: Mapping[str, Any]) -> float:
        """Return when the exposure of a frame ended: libcamera stamps the begin of its readout."""
        return float(metadata["SensorTimestamp"]) / 1e9 - self._ahead_s


def is_installed() -> bool:
    """Return whether picamera2 and libcamera are installed; they are not imported."""
    return find_spec("picamera2") is not None and find_spec("libcamera") is not None


def picamera2() -> Any:
    """Return the class Picamera2.

    Raises:
        CameraError: it is not installed, or cannot be loaded
    """
    if not is_installed():
        raise CameraError(
            "the backend libcamera needs picamera2 and the Python module of libcamera",
            hint="on Raspberry Pi OS: apt install python3-picamera2, and a virtual environment "
            "with --system-site-packages",
        )
    try:
        from picamera2 import Picamera2  # it starts logging, and looks for the hardware
    except Exception as error:
        raise CameraError(
            f"picamera2 cannot be loaded: {error}", hint="install the packages that it needs"
        ) from error
    return Picamera2


def cameras() -> list[CameraInfo]:
    """Return the cameras that libcamera knows; their ids are stable."""
    return [
        CameraInfo(f"{DRIVER}:{each['Id']}", "", str(each.get("Model", "")), "", DRIVER)
        for each in picamera2().global_camera_info()
    ]


def _find(address: str) -> tuple[int, CameraInfo]:
    """Return the number of a camera in picamera2, and its identity."""
    found = cameras()
    places = [
        place
        for place, info in enumerate(found)
        if address in ("", str(place), info.id.partition(":")[2])
    ]
    if len(places) == 1:
        return places[0], found[places[0]]
    ids = ", ".join(info.id for info in found)
    raise CameraNotFoundError(
        f"libcamera finds {len(found) or 'no'} cameras"
        + (f", and none at {address}" if address and found else ""),
        hint=f"name one of them: {ids}"
        if found
        else "check the ribbon cable, and the system's log",
    )


def _made(library: Any, number: int) -> Any:
    """Return a new `Picamera2`, which would leave its pipe open where it cannot open the camera."""
    camera = library.__new__(library)
    try:
        camera.__init__(number)
    except BaseException:
        reader = getattr(camera, "notifymeread", None)  # None: there was no pipe to be had
        if reader is not None and not reader.closed:
            reader.close()
            os.close(camera.notifyme_w)
        raise
    return camera


def _choose_mode(camera: Any, options: LibcameraOptions, name: str) -> Mapping[str, Any]:
    """Return the sensor's mode of the requested size and format: else the largest, most bits.

    Raises:
        CameraError: the camera has no raw frames
        UsageError: it has no such size or format
    """
    modes = [mode for mode in camera.sensor_modes if "size" in mode and "exposure_limits" in mode]
    if not modes:
        raise CameraError(
            f"{name} has no raw frames", hint="use v4l2 for webcams, which libcamera lists, too"
        )
    sizes = sorted({mode["size"] for mode in modes}, key=math.prod, reverse=True)
    if options.size is not None:
        wanted = options.size[::-1]
        if wanted not in sizes:
            known = ", ".join(f"{columns}x{rows}" for columns, rows in sizes)
            raise UsageError(
                f"{name} has no frames of {wanted[0]}x{wanted[1]}", hint=f"choose one of {known}"
            )
        modes = [mode for mode in modes if mode["size"] == wanted]
    asked = None if options.format == "auto" else RawFormat.parse(options.format)
    if asked is not None:
        modes = [mode for mode in modes if mode["bit_depth"] == min(asked.bits, mode["bit_depth"])]
    best: Mapping[str, Any] = max(modes, key=lambda m: (math.prod(m["size"]), m["bit_depth"]))
    return best


def _configured(
    camera: Any, mode: Mapping[str, Any], options: LibcameraOptions, name: str
) -> RawFormat:
    """Configure the camera, everything automatic off; return the format that it has then."""
    asked = options.format
    if asked != "auto" and RawFormat.parse(asked) is None:
        raise UsageError(
            f"{name} has no readable format {asked}",
            hint="write a raw format such as SRGGB10, SRGGB12_CSI2P or SRGGB16",
        )
    order = str(mode["unpacked"]).rstrip("0123456789")
    tried = [asked] if asked != "auto" else [str(mode["unpacked"]), f"{order}16"]
    small = [min(most, size) // 2 * 2 for most, size in zip(_SMALL, mode["size"], strict=True)]
    for each in tried:
        camera.configure(
            camera.create_video_configuration(
                main={"size": tuple(small)},
                raw={"format": each, "size": mode["size"]},
                sensor={"output_size": mode["size"], "bit_depth": mode["bit_depth"]},
                buffer_count=_BUFFERS,
                queue=False,
                display=None,
                encode=None,
                controls=_fixed(camera.camera_controls),
            )
        )
        # Limits of times and durations are those of the mode.
        camera.set_controls(_fixed(camera.camera_controls))
        found = RawFormat.parse(str(camera.camera_configuration()["raw"]["format"]))
        if found is not None and asked in ("auto", found.name):
            return found
    raise UsageError(
        f"{name} has no frames of the format {asked}",
        hint="leave the format out, or choose another size",
        remedies={"option:format": None},
    )


def _fixed(limits: Mapping[str, Any]) -> dict[str, Any]:
    """Return the controls that switch everything automatic off, of those that there are."""
    fixed: dict[str, Any] = {name: 0 for name in _AUTOMATIC if name in limits}
    for name in ("AeEnable", "AwbEnable"):
        if name in fixed:
            fixed[name] = False
    if "ScalerCrop" in limits:
        fixed["ScalerCrop"] = limits["ScalerCrop"][1]
    # Exposures may make frames as long as the sensor allows.
    fixed["FrameDurationLimits"] = tuple(limits["FrameDurationLimits"][:2])
    return fixed


def _controls(
    probed: Probed,
    interval_s: float,
    shape: tuple[int, int],
    format_: RawFormat,
    bits: int,
    black: int,
) -> ExposureControls:
    line_s = probed.line_us / 1e6
    fewest, most = probed.lines
    return ExposureControls(
        time_s=Steps(fewest * line_s, most * line_s, line_s),
        gain=Choices(probed.gains),
        shape=shape,
        layout=format_.layout,
        bits=bits,
        black=black,
        white=2**bits - 1,
        pixel_format=format_.name,
        response_origin=ResponseOrigin.STATED,  # raw samples are linear
        delay_frames=probed.delay_frames,
        frame_interval_s=interval_s,
        timing=CaptureTiming(lead_frames=_LEAD_FRAMES, rests=True),
        tolerance=SAME_GAIN,
    )


@contextmanager
def _worded(name: str) -> Iterator[None]:
    """Let errors of picamera2, which are RuntimeErrors, be errors of the camera."""
    try:
        yield
    except CameraError:
        raise
    except (RuntimeError, OSError, IndexError, KeyError) as error:
        reason = error.__cause__ or error
        if "acquire" in f"{error} {reason}".lower() or "busy" in f"{reason}".lower():
            raise CameraBusyError(
                f"{name} is in use", hint="close the other program that uses it"
            ) from error
        raise CameraError(
            f"{name} cannot be opened: {str(reason).splitlines()[0]}",
            hint="try rpicam-hello --list-cameras",
        ) from error
