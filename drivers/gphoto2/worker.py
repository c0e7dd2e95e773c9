"""The process that holds one camera: libgphoto2 is loaded here and nowhere else.

libgphoto2 is not safe for cameras in several threads, and a fault in it ends its process; so each
camera has one.  It is run as a script and imports nothing of camctl, so that it starts at once.

A request is one line of JSON on standard input: ``{"do": NAME, ...}``.  A response is one line of
JSON on standard output: ``{"result": ..., "bytes": N}`` and N bytes of a file, or ``{"code": ...,
"text": ...}`` of an error of libgphoto2.  The process ends with its standard input.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Callable
from typing import Any

import gphoto2 as gp

_NETWORK_MODEL = "PTP/IP Camera"
_KINDS = {gp.GP_WIDGET_RADIO: "choice", gp.GP_WIDGET_MENU: "choice", gp.GP_WIDGET_TEXT: "text"}


class Worker:
    """Answers requests; each method whose name does not begin with "_" is one."""

    def __init__(self) -> None:
        self._camera: Any = None
        self.reasons: list[str] = []
        self._context = gp.Context()
        self._noting = self._context.set_error_func(self._note, None)

    def _note(self, _context: Any, text: Any, _data: Any = None) -> None:
        """Keep the reason that libgphoto2 gives beside the number of its error."""
        self.reasons.append(text.decode(errors="replace") if isinstance(text, bytes) else text)

    def cameras(self) -> list[dict[str, Any]]:
        """Return model, port and USB vendor of each camera, and whether it can be controlled."""
        found = gp.Camera.autodetect()
        models = gp.CameraAbilitiesList()
        models.load()
        cameras = []
        for index in range(found.count()):
            able = models.get_abilities(models.lookup_model(found.get_name(index)))
            cameras.append(
                {
                    "model": found.get_name(index),
                    "port": found.get_value(index),
                    "captures": bool(able.operations & gp.GP_OPERATION_CAPTURE_IMAGE),
                    "configures": bool(able.operations & gp.GP_OPERATION_CONFIG),
                    "usb_vendor": able.usb_vendor,
                }
            )
        return cameras

    def open(self, port: str) -> None:
        """Connect to the camera at a port."""
        ports = gp.PortInfoList()
        ports.load()
        camera = gp.Camera()
        if port.startswith("ptpip:"):  # libgphoto2 finds out the model on USB only
            models = gp.CameraAbilitiesList()
            models.load()
            camera.set_abilities(models.get_abilities(models.lookup_model(_NETWORK_MODEL)))
            if port.count(":") == 2:  # the port of the events would be the usual one
                port += port[port.rindex(":") :]
        camera.set_port_info(ports.get_info(ports.lookup_path(port)))
        camera.init()
        self._camera = camera

    def widgets(self) -> dict[str, dict[str, Any]]:
        """Return all settings by name: kind, value, choices, whether they can be set."""
        found: dict[str, dict[str, Any]] = {}

        def add(widget: Any) -> None:
            kind = _KINDS.get(widget.get_type())
            if kind is not None:
                found.setdefault(
                    widget.get_name(),
                    {
                        "label": widget.get_label(),
                        "kind": kind,
                        "value": widget.get_value(),
                        "choices": list(widget.get_choices()) if kind == "choice" else [],
                        "is_read_only": bool(widget.get_readonly()),
                    },
                )
            for index in range(widget.count_children()):
                add(widget.get_child(index))

        add(self._camera.get_config())
        return found

    def apply(self, values: dict[str, str]) -> dict[str, str]:
        """Set settings that have other values; return all of them as the camera has them then.

        libgphoto2 steps the dials of some Sony bodies and stops where it has counted wrong, from
        where a second attempt arrives.
        """
        for _ in range(3):
            widgets = {name: self._camera.get_single_config(name) for name in values}
            others = [
                name for name, widget in widgets.items() if widget.get_value() != values[name]
            ]
            if not others:
                return values
            for name in others:
                widgets[name].set_value(values[name])
                self._camera.set_single_config(name, widgets[name], self._context)
        return {name: self._camera.get_single_config(name).get_value() for name in values}

    def capture(self) -> list[str]:
        """Take a picture; return folder and name of the first file."""
        path = self._camera.capture(gp.GP_CAPTURE_IMAGE, self._context)
        return [path.folder, path.name]

    def added(self, timeout_ms: int) -> list[list[str]]:
        """Return the files that the camera has made since, until it reports nothing for a time."""
        files = []
        for _ in range(1000):  # a camera may report without end
            kind, data = self._camera.wait_for_event(timeout_ms)
            if kind == gp.GP_EVENT_TIMEOUT:
                break
            if kind == gp.GP_EVENT_FILE_ADDED:
                files.append([data.folder, data.name])
        return files

    def file(self, folder: str, name: str) -> bytes:
        file = self._camera.file_get(folder, name, gp.GP_FILE_TYPE_NORMAL)
        return bytes(file.get_data_and_size())  # a view would outlive the file

    def delete(self, folder: str, name: str) -> None:
        self._camera.file_delete(folder, name)

    def close(self) -> None:
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.exit()


def main() -> None:
    """Answer requests until standard input ends."""
    # libraries that print to standard output must not disturb the responses
    responses = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    worker = Worker()
    for line in sys.stdin:
        arguments: dict[str, Any] = json.loads(line)
        method: Callable[..., Any] = getattr(worker, arguments.pop("do"))
        data = b""
        worker.reasons.clear()
        answer: dict[str, Any]
        try:
            result = method(**arguments)
            if isinstance(result, bytes):
                data, result = result, None
            answer = {"result": result, "bytes": len(data)}
        except gp.GPhoto2Error as error:
            reasons = dict.fromkeys([*worker.reasons[-1:], str(error.string)])
            answer = {"code": error.code, "text": ": ".join(reasons)}
        responses.write(json.dumps(answer).encode() + b"\n")
        responses.write(data)
        responses.flush()
    worker.close()


if __name__ == "__main__":
    main()
