"""All virtual devices in one process, and a socket for what shall go wrong with them.

    python -m sim.devices --dir DIRECTORY CONFIG.json

CONFIG.json holds ``{"devices": [{"name": "cam0", "kind": "uvc", ...}]}``; what else stands there
is the kind's own.  USB devices are plugged into the kernel's virtual controller, serial ones open
their line; without one, or with ``"line": "pty"``, DIRECTORY/NAME is a link to a pseudo-terminal.

DIRECTORY/ctl is a UNIX socket that appears once all are attached.  It takes one JSON object a line,
``{"device": "cam0", "do": "freeze", ...arguments}``, and answers with one: what the verb returns
and ``"ok": true``, or ``"error"`` with a line of text.
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
from typing import Any, Protocol, TypeAlias

from camctl.errors import CamctlError, CameraTimeoutError, DataError, UsageError, unknown_name
from sim.devices.usb.device import UsbDevice
from sim.devices.usb.vhci import VhciPort

CONTROL = "ctl"
_LONGEST_LINE = 64 * 1024
_ANSWER_S = 30.0


class VirtualDevice(Protocol):
    """What the hub knows of a device."""

    def attach(self) -> None:
        """Plug it in."""
        ...

    def detach(self) -> None:
        """Pull the plug."""
        ...

    def do(self, verb: str, **arguments: Any) -> dict[str, Any]:
        """Do what a verb says; the answer can be written as JSON."""
        ...


Make: TypeAlias = Callable[[Mapping[str, Any]], VirtualDevice]

#: Modules by kind; each has a function `make(config)`.
KINDS: Mapping[str, str] = {
    "uvc": "sim.devices.uvc.camera",
    "ptp": "sim.devices.ptp.camera",
    "sierra": "sim.devices.sierra.device",
}
_SERIAL = ("sierra",)


def make_device(config: Mapping[str, Any], directory: Path) -> VirtualDevice:
    """Return the device that a configuration describes, not attached yet.

    Raises:
        UsageError, DataError: an unknown kind, or something of the kind's own that does not fit
    """
    kind = str(config.get("kind"))
    if kind not in KINDS:
        raise unknown_name("kind of virtual device", kind, KINDS)
    if kind in _SERIAL and config.get("line", "pty") == "pty":
        config = {"link": str(directory / str(config["name"])), **config}
    make: Make = import_module(KINDS[kind]).make
    device = make(config)
    if isinstance(device, UsbDevice) and device.port is None:
        device.port = VhciPort()
    return device


def read_config(path: Path) -> list[dict[str, Any]]:
    """Return the devices of a configuration file.

    Raises:
        DataError: it cannot be read, or holds no list of named devices
    """
    try:
        devices = json.loads(path.read_text(encoding="utf-8"))["devices"]
        names = [device["name"] for device in devices]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise DataError(
            f"{path}: no list of devices ({type(error).__name__}: {error})",
            hint='write {"devices": [{"name": "cam0", "kind": "uvc"}]}',
        ) from error
    if len(set(names)) < len(names):
        raise DataError(f"{path}: two devices of one name", hint="name them differently")
    return list(devices)


class Hub:
    """Asks a hub that runs in another process.

    Args:
        directory: its --dir
    """

    def __init__(self, directory: str | Path) -> None:
        self._path = str(Path(directory) / CONTROL)

    def do(self, device: str, verb: str, **arguments: Any) -> dict[str, Any]:
        """Return what a device answers to a verb.

        Raises:
            UsageError: no such device or verb, or the verb failed
            CameraTimeoutError: the hub does not answer
        """
        request = json.dumps({"device": device, "do": verb, **arguments}).encode() + b"\n"
        try:
            with socket.socket(socket.AF_UNIX) as line:
                line.settimeout(_ANSWER_S)
                line.connect(self._path)
                line.sendall(request)
                answer = json.loads(line.makefile("rb").readline())
        except (OSError, ValueError) as error:
            raise CameraTimeoutError(
                f"no answer from the hub at {self._path}: {error}", hint="is it running?"
            ) from error
        if "error" in answer:
            raise UsageError(f"{device} {verb}: {answer['error']}")
        return {key: value for key, value in answer.items() if key != "ok"}


class _Handler(socketserver.StreamRequestHandler):
    server: _Server

    def handle(self) -> None:
        while line := self.rfile.readline(_LONGEST_LINE):
            self.wfile.write(json.dumps(self.server.answer(line)).encode() + b"\n")


class _Server(socketserver.ThreadingUnixStreamServer):
    daemon_threads = True

    def __init__(self, path: Path, devices: Mapping[str, VirtualDevice]) -> None:
        self._devices = devices
        super().__init__(str(path), _Handler)

    def answer(self, line: bytes) -> dict[str, Any]:
        try:
            request = json.loads(line)
            name, verb = str(request.pop("device")), str(request.pop("do"))
            if name not in self._devices:
                raise unknown_name("device", name, self._devices)
            return {"ok": True, **self._devices[name].do(verb, **request)}
        except CamctlError as error:
            return {"error": str(error)}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            return {"error": f"{type(error).__name__}: {error}"}


def run(directory: Path, config: Path, stop: threading.Event) -> None:
    """Attach the devices of a configuration and answer the control socket until `stop` is set.

    Raises:
        CamctlError: the configuration does not fit, or a device cannot be attached
    """
    directory.mkdir(parents=True, exist_ok=True)
    path = directory / CONTROL
    path.unlink(missing_ok=True)
    devices = {each["name"]: make_device(each, directory) for each in read_config(config)}
    try:
        for device in devices.values():
            device.attach()
        # The socket is bound under another name, so that it answers from the moment it is there.
        part = directory / f".{CONTROL}.part"
        part.unlink(missing_ok=True)
        with _Server(part, devices) as server:
            serving = threading.Thread(target=server.serve_forever, name="hub", daemon=True)
            serving.start()
            part.rename(path)
            stop.wait()
            path.unlink(missing_ok=True)
            server.shutdown()
    finally:
        for device in devices.values():
            device.detach()


def main(words: Sequence[str] | None = None) -> int:
    """Run a hub until it is interrupted or terminated; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m sim.devices", description="Virtual cameras.")
    parser.add_argument("--dir", type=Path, required=True, help="for the control socket")
    parser.add_argument("config", type=Path, help="a JSON file")
    arguments = parser.parse_args(words)
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        run(arguments.dir, arguments.config, stop)
    except CamctlError as error:
        parser.exit(error.exit_status, f"{parser.prog}: {error}\n")
    return 0
