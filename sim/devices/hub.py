"""All virtual devices of a configuration in one process, controlled through a socket.

    python -m camctl.sim.devices --dir DIRECTORY CONFIG.json

CONFIG.json holds ``{"devices": [{"name": "cam0", "kind": "uvc", ...}]}``; the other options of a
device depend on its kind.  USB devices are attached to the kernel's virtual host controller; a
serial device opens its line or, without one, a pseudo-terminal that DIRECTORY/NAME links to.

DIRECTORY/ctl is a UNIX socket that appears once all devices are attached.  A request is one JSON
object per line, ``{"device": "cam0", "do": "freeze", ...arguments}``, and so is the reply: the
result of the control command and ``"ok": true``, or ``"error"`` with one line of text.
"""

from __future__ import annotations

import argparse
import json
import signal
import socket
import socketserver
import threading
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any, TypeAlias

from pydantic_core import from_json

from camctl.errors import CamctlError, CameraTimeoutError, DataError, UsageError, unknown_name
from camctl.sim.devices.common import Controllable
from camctl.sim.devices.usb.device import UsbDevice
from camctl.sim.devices.usb.vhci import VhciPort
from camctl.system.input_files import read_input

CONTROL = "ctl"
_LONGEST_LINE = 64 * 1024  # bytes; no control command comes near
_REPLY_S = 30.0  # a device may be rendering a picture

MakeDevice: TypeAlias = Callable[[Mapping[str, Any]], Controllable]

#: Modules by kind of device; each has a function `make(config)`.
KINDS: Mapping[str, str] = {
    "uvc": "camctl.sim.devices.uvc.camera",
    "ptp": "camctl.sim.devices.ptp.camera",
    "ptpip": "camctl.sim.devices.ptp.network",
    "sierra": "camctl.sim.devices.sierra.device",
    "gige": "camctl.sim.devices.gige.camera",
}
_SERIAL_KINDS = ("sierra",)


def make_device(config: Mapping[str, Any], directory: Path) -> Controllable:
    """Return the device of a configuration, not attached yet.

    Raises:
        UsageError, DataError: the kind is unknown, or an option of the device is invalid
    """
    kind = str(config.get("kind"))
    if kind not in KINDS:
        raise unknown_name("kind of virtual device", kind, KINDS)
    if kind in _SERIAL_KINDS and config.get("line", "pty") == "pty":
        config = {"link": str(directory / str(config["name"])), **config}
    make: MakeDevice = import_module(KINDS[kind]).make
    device = make(config)
    if isinstance(device, UsbDevice) and device.port is None:
        device.port = VhciPort()
    return device


def read_config(path: Path) -> list[dict[str, Any]]:
    """Return the devices of a configuration file.

    Raises:
        DataError: it cannot be read, or has no list of devices with different names
    """
    try:
        devices = from_json(read_input(path, "configuration"))["devices"]
        names = [device["name"] for device in devices]
    except (ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path} has no list of devices ({type(error).__name__}: {error})",
            hint='write {"devices": [{"name": "cam0", "kind": "uvc"}]}',
        ) from error
    if len(set(names)) < len(names):
        raise DataError(
            f"{path} has two devices of the same name", hint="give each device its own name"
        )
    return list(devices)


class Hub:
    """A client of a hub that runs in another process.

    Args:
        directory: the hub's --dir
    """

    def __init__(self, directory: str | Path) -> None:
        self._path = str(Path(directory) / CONTROL)

    def do(self, device: str, command: str, **arguments: Any) -> dict[str, Any]:
        """Return the result of a control command of a device.

        Raises:
            UsageError: no such device or command, or the command failed
            CameraTimeoutError: the hub does not reply
        """
        request = json.dumps({"device": device, "do": command, **arguments}).encode() + b"\n"
        try:
            with socket.socket(socket.AF_UNIX) as connection:
                connection.settimeout(_REPLY_S)
                connection.connect(self._path)
                connection.sendall(request)
                reply = json.loads(connection.makefile("rb").readline())
        except (OSError, ValueError) as error:
            raise CameraTimeoutError(
                f"the hub at {self._path} does not reply: {error}", hint="is it running?"
            ) from error
        if "error" in reply:
            raise UsageError(f"{device} {command}: {reply['error']}")
        return {key: value for key, value in reply.items() if key != "ok"}


class _Handler(socketserver.StreamRequestHandler):
    server: _Server

    def handle(self) -> None:
        while line := self.rfile.readline(_LONGEST_LINE):
            self.wfile.write(json.dumps(self.server.reply(line)).encode() + b"\n")


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True

    def __init__(self, path: Path, devices: Mapping[str, Controllable]) -> None:
        self._devices = devices
        super().__init__(str(path), _Handler)

    def reply(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            name, command = str(request.pop("device")), str(request.pop("do"))
            if name not in self._devices:
                raise unknown_name("device", name, self._devices)
            return {"ok": True, **self._devices[name].do(command, **request)}
        except CamctlError as error:
            return {"error": str(error)}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            return {"error": f"invalid request: {type(error).__name__}: {error}"}


def run(directory: Path, config: Path, stop: threading.Event) -> None:
    """Attach the devices of a configuration and serve the control socket until `stop` is set.

    Raises:
        CamctlError: the configuration is invalid, or a device cannot be attached
    """
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / CONTROL
    path.unlink(missing_ok=True)
    devices = {each["name"]: make_device(each, directory) for each in read_config(config)}
    try:
        for device in devices.values():
            device.attach()
        # The socket is bound under another name, so that it replies from the moment it appears.
        part = directory / f".{CONTROL}.part"
        part.unlink(missing_ok=True)
        with _Server(part, devices) as server:
            poll = {"poll_interval": 0.05}
            threading.Thread(target=server.serve_forever, kwargs=poll, daemon=True).start()
            part.rename(path)
            stop.wait()
            path.unlink(missing_ok=True)
            server.shutdown()
    finally:
        for device in devices.values():
            device.detach()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a hub until it is interrupted or terminated; return the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m camctl.sim.devices", description="Run virtual cameras until interrupted."
    )
    parser.add_argument("--dir", type=Path, required=True, help="folder for the control socket")
    parser.add_argument("config", type=Path, help="JSON file that lists the devices")
    options = parser.parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        run(options.dir, options.config, stop)
    except CamctlError as error:
        parser.exit(error.exit_status, f"{parser.prog}: {error}\n")
    return 0
