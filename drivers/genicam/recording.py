"""What a camera says when it is opened: its description and its answers, to be replayed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, cast

from camctl.drivers.genicam.camera import GenicamCamera
from camctl.drivers.genicam.libraries import find_device
from camctl.drivers.genicam.port import FoundDevice, Library, OpenDevice, Received
from camctl.errors import CameraError

#: Features that tell one camera from others of its model, or its owner.
_PRIVATE = ("DeviceSerialNumber", "DeviceID", "DeviceUserID")
#: Methods whose answers open the camera again.
_KEPT = ("kind", "read", "write", "execute", "limits", "entries", "unit")


class RecordingDevice:
    """A `camctl.drivers.genicam.port.OpenDevice` whose answers are kept; of frames no picture is.

    Attributes:
        calls: name of the method, its arguments, and its answer or its error
    """

    def __init__(self, device: OpenDevice) -> None:
        self._device = device
        self.calls: list[dict[str, Any]] = []

    def __getattr__(self, name: str) -> Any:
        """Return a method of the device; what is called of `_KEPT` is kept."""
        method = getattr(self._device, name)
        return partial(self._kept, name, method) if name in _KEPT else method

    def _kept(self, name: str, ask: Callable[..., Any], *arguments: Any) -> Any:
        entry: dict[str, Any] = {"call": name, "arguments": list(arguments)}
        self.calls.append(entry)
        try:
            answer = ask(*arguments)
        except CameraError as error:
            entry["error"] = type(error).__name__  # its text has the device's name
            raise
        is_private = name == "read" and arguments[0] in _PRIVATE
        entry["answer"] = "x" if is_private else vars(answer) if name == "limits" else answer
        return answer

    def receive(self, timeout_s: float) -> Received | None:
        frame = self._device.receive(timeout_s)
        if frame is not None:
            kept = {**vars(frame), "bytes": int(frame.data.size)}
            del kept["data"], kept["arrived_s"]
            self.calls.append({"call": "receive", "answer": kept})
        return frame


class _RecordingLibrary:
    """A `camctl.drivers.genicam.port.Library` that opens a device as a `RecordingDevice`."""

    def __init__(self, library: Library) -> None:
        self._library = library
        self.name = library.name
        self.device: RecordingDevice | None = None

    def search(self) -> Sequence[FoundDevice]:
        return self._library.search()

    def open(self, device: FoundDevice) -> OpenDevice:
        self.device = RecordingDevice(self._library.open(device))
        return cast(OpenDevice, self.device)


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
