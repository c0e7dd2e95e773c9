"""What a camera says when it is opened: its description and its answers, to be replayed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from camctl.drivers.genicam.camera import GenicamCamera
from camctl.drivers.genicam.libraries import find_device
from camctl.drivers.genicam.port import (
    FoundDevice,
    Kind,
    Library,
    Limits,
    OpenDevice,
    PacketCounts,
    Received,
    Value,
)
from camctl.errors import CameraError

AnswerT = TypeVar("AnswerT")

#: Features that tell one camera from others of its model, or its owner.
_PRIVATE = ("DeviceSerialNumber", "DeviceID", "DeviceUserID")


class RecordingDevice:
    """A `camctl.drivers.genicam.port.OpenDevice` whose answers are kept; of frames no picture is.

    Attributes:
        calls: name of the method, its arguments, and its answer or its error
    """

    def __init__(self, device: OpenDevice) -> None:
        self._device = device
        self.calls: list[dict[str, Any]] = []

    def kind(self, name: str) -> Kind | None:
        return self._kept("kind", (name,), lambda: self._device.kind(name))

    def read(self, name: str) -> Value:
        return self._kept("read", (name,), lambda: self._device.read(name))

    def write(self, name: str, value: Value) -> None:
        self._kept("write", (name, value), lambda: self._device.write(name, value))

    def execute(self, name: str) -> None:
        self._kept("execute", (name,), lambda: self._device.execute(name))

    def limits(self, name: str) -> Limits:
        return self._kept("limits", (name,), lambda: self._device.limits(name))

    def entries(self, name: str) -> Sequence[str]:
        return self._kept("entries", (name,), lambda: list(self._device.entries(name)))

    def unit(self, name: str) -> str:
        return self._kept("unit", (name,), lambda: self._device.unit(name))

    def start(self, buffers: int) -> None:
        self._device.start(buffers)

    def stop(self) -> None:
        self._device.stop()

    def receive(self, timeout_s: float) -> Received | None:
        frame = self._device.receive(timeout_s)
        if frame is not None:
            self.calls.append(
                {
                    "call": "receive",
                    "answer": {
                        "shape": list(frame.shape),
                        "code": frame.code,
                        "bytes": int(frame.data.size),
                        "line_padding": frame.line_padding,
                        "number": frame.number,
                        "stamp_s": frame.stamp_s,
                        "is_complete": frame.is_complete,
                        "chunks": dict(frame.chunks),
                    },
                }
            )
        return frame

    def packets(self) -> PacketCounts:
        return self._device.packets()

    def description(self) -> str:
        return self._device.description()

    def close(self) -> None:
        self._device.close()

    def _kept(self, name: str, arguments: tuple[Any, ...], ask: Callable[[], AnswerT]) -> AnswerT:
        entry: dict[str, Any] = {"call": name, "arguments": list(arguments)}
        self.calls.append(entry)
        try:
            answer = ask()
        except CameraError as error:
            entry["error"] = type(error).__name__  # its text has the device's name
            raise
        is_private = name == "read" and arguments[0] in _PRIVATE
        entry["answer"] = "x" if is_private else vars(answer) if name == "limits" else answer
        return answer


class _RecordingLibrary:
    """A `camctl.drivers.genicam.port.Library` that opens a device as a `RecordingDevice`."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self.name = library.name
        self.device: RecordingDevice | None = None

    def search(self) -> Sequence[FoundDevice]:
        return self._library.search()

    def open(self, device: FoundDevice) -> RecordingDevice:
        self.device = RecordingDevice(self._library.open(device))
        return self.device


def record(library: Library, address: str) -> dict[str, Any]:
    """Return what a camera says when it is opened; the few pictures it takes then are not kept."""
    recording = _RecordingLibrary(library)
    found: dict[str, Any]
    description = ""
    try:
        with GenicamCamera(recording, find_device(library, address)) as camera:
            found = described(camera)
            description = camera.device.description()
    except CameraError as error:
        found = {"error": type(error).__name__}
    calls = [] if recording.device is None else recording.device.calls
    return {"library": library.name, "description": description, "calls": calls, "found": found}


def described(camera: GenicamCamera) -> dict[str, Any]:
    """Return what an open camera was found to be."""
    controls = camera.controls
    return {
        "model": camera.info.model,
        "mode": camera.mode,
        "bits": controls.bits,
        "layout": str(controls.layout),
        "times_s": [controls.time_s.minimum, controls.time_s.maximum],
        "gains": [controls.gain.minimum, controls.gain.maximum],
    }
