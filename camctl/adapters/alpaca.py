"""A camera server of ASCOM Alpaca, for programs of astronomers: ICameraV4 over HTTP, and discovery.

The duration of an exposure is the shutter time of the shortest frame: what saturates it is white in
the picture, which is linear, and the other frames of the plan show what is darker.  After the
"ASCOM Alpaca API Reference" and "Alpaca ImageBytes" of ASCOM; it needs the standard library only.
"""

from __future__ import annotations

import json
import re
import socket
import struct
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from datetime import UTC, datetime
from http import HTTPStatus
from itertools import count
from typing import Any, Final
from urllib.parse import parse_qsl

import numpy as np
from numpy.typing import NDArray

import camctl
from camctl.system.web_server import Site, SiteHandler, is_loopback

#: Port on which discovery asks (Alpaca API Reference, 4).
DISCOVERY_PORT = 32227

# Error numbers of the reference.
_NOT_IMPLEMENTED, _INVALID_VALUE, _NOT_CONNECTED = 0x400, 0x401, 0x407
_INVALID_OPERATION, _NO_ACTION, _DRIVER = 0x40B, 0x40C, 0x500

#: CameraState.
_IDLE, _EXPOSING, _FAILED = 0, 2, 5
_MAX_ADU = 65535
#: Most bytes of the body of a request; a client sends a few dozen.
_BODY_BYTES = 1 << 16
#: Longest wait for an exposure that is aborted, s: clients wait 5 s for an answer.
_ABORT_S = 4.0
#: Metadata of ImageBytes, version 1: version, error, two transactions, begin of the data, types of
#: the array (2: int32) and of what is sent (8: uint16), rank, and three dimensions.
_IMAGE_HEAD, _INT32, _UINT16 = struct.Struct("<iiIIiiiiiii"), 2, 8

#: What has the same value at any time.
_CONSTANTS: Final[dict[str, Any]] = {
    **dict.fromkeys(("binx", "biny", "maxbinx", "maxbiny"), 1),
    "canabortexposure": True,
    "driverversion": camctl.__version__,
    "exposureresolution": 0.0,
    "interfaceversion": 4,
    "maxadu": _MAX_ADU,
    "readoutmode": 0,
    "supportedactions": [],
}
_FALSE: Final = (
    "canasymmetricbin canfastreadout cangetcoolerpower canpulseguide cansetccdtemperature "
    "canstopexposure connecting hasshutter ispulseguiding"
)
#: What no camera here has.
_MISSING: Final = (
    "bayeroffsetx bayeroffsety ccdtemperature commandblind commandbool commandstring cooleron "
    "coolerpower electronsperadu fastreadout fullwellcapacity gain gainmax gainmin gains "
    "heatsinktemperature offset offsetmax offsetmin offsets pixelsizex pixelsizey pulseguide "
    "setccdtemperature stopexposure subexposureduration"
)
#: What is answered without a connection.
_ALWAYS: Final = (
    "connected connecting connect disconnect description driverinfo driverversion "
    "interfaceversion name supportedactions"
)


#: Gives a parameter of a request, of a type.
_Read = Callable[[str, Callable[[str], Any]], Any]


class AlpacaError(Exception):
    """An error of ASCOM: its number and one line."""

    def __init__(self, number: int, message: str) -> None:
        self.number = number
        super().__init__(message)


class AlpacaCamera:
    """The state of the one camera that all clients share.

    Args:
        camera: an open camera
        request: what its pictures are to be; the exposure's duration is the base exposure
    """

    def __init__(self, camera: camctl.Camera, request: camctl.CaptureRequest) -> None:
        self._camera, self._request = camera, request
        self._lock = threading.Lock()  # guards what follows
        self.clients: set[int] = set()
        rows, columns = camera.controls.shape[:2]
        self.size = columns, rows
        self.window = {"startx": 0, "starty": 0, "numx": columns, "numy": rows}
        self._thread: threading.Thread | None = None
        self._is_cancelled = threading.Event()
        self._picture: NDArray[np.uint16] | None = None
        self._error: camctl.CamctlError | None = None
        self._done = 0.0
        self._last: dict[str, Any] = {}
        times = camera.controls.time_s
        plan = camctl.plan_capture(camera, replace(request, base_s=times.minimum))
        times_s = [each.time_s for each in plan.settings]
        self.limits_s = times.minimum, times.maximum * min(times_s) / max(times_s)

    @property
    def is_exposing(self) -> bool:
        """Whether an exposure runs."""
        is_over = self._picture is not None or self._error is not None
        return not is_over and self._thread is not None and self._thread.is_alive()

    def start(self, duration_s: float) -> None:
        """Begin an exposure; raises `AlpacaError` where that is impossible."""
        with self._lock:
            if self.is_exposing:
                raise AlpacaError(_INVALID_OPERATION, "another exposure runs: wait, or abort it")
            least, most = self.limits_s
            # A client may have rounded them.
            if not least * (1 - 1e-6) <= duration_s <= most * (1 + 1e-6):
                text = f"{duration_s:g} s is not from {least:.6g} to {most:.6g} s"
                raise AlpacaError(_INVALID_VALUE, f"invalid Duration: {text}")
            for axis, size in zip("xy", self.size, strict=True):
                first, width = self.window[f"start{axis}"], self.window[f"num{axis}"]
                if first < 0 or width < 1 or first + width > size:
                    text = f"{width} pixels from {first} of {size}"
                    raise AlpacaError(_INVALID_VALUE, f"invalid window in {axis}: {text}")
            is_gone = isinstance(self._error, camctl.CameraDisconnectedError)
            self._is_cancelled.clear()
            self._picture, self._error, self._done = None, None, 0.0
            given = duration_s, dict(self.window), is_gone
            self._thread = threading.Thread(target=self._expose, args=given, daemon=True)
            self._thread.start()

    def _expose(self, duration_s: float, window: Mapping[str, int], is_gone: bool) -> None:
        began, request = datetime.now(UTC), replace(self._request, base_s=duration_s)
        try:
            if is_gone:
                self._camera.close()
                self._camera.__enter__()
            report = camctl.capture(
                self._camera, request, progress=self._note, cancelled=self._is_cancelled.is_set
            )
        except camctl.InterruptedCaptureError:
            return
        except camctl.CamctlError as error:
            self._error = error
            return
        x, y = window["startx"], window["starty"]
        light = report.radiance()[y : y + window["numy"], x : x + window["numx"]]
        share = np.swapaxes(light, 0, 1) * np.float32(report.irradiance.full_scale_exposure)
        self._last = {
            "lastexposureduration": report.plan.base_s,
            "lastexposurestarttime": _time_text(began),
        }
        self._done = 1.0
        self._picture = np.rint(np.clip(share, 0, 1) * _MAX_ADU).astype(np.uint16, order="C")

    def _note(self, progress: camctl.Progress) -> None:
        if progress.stage == "shooting":
            self._done = progress.share

    def abort(self) -> None:
        """End the exposure that runs."""
        thread = self._thread
        self._is_cancelled.set()
        if thread is not None:
            thread.join(_ABORT_S)

    @property
    def is_ready(self) -> bool:
        """ImageReady; raises `AlpacaError` where the exposure failed."""
        if self._error is not None:
            raise AlpacaError(_DRIVER, str(self._error))
        return self._picture is not None

    def value(self, name: str) -> Any:
        """Return the property of this name; raises `AlpacaError` where there is none."""
        if name in _FALSE.split():
            return False
        if name in (known := {**_CONSTANTS, **self.window}):
            return known[name]
        if name.startswith("lastexposure"):
            if not self._last:
                raise AlpacaError(_INVALID_OPERATION, "there was no exposure")
            return self._last[name]
        if name.startswith("imagearray"):
            if not self.is_ready:
                raise AlpacaError(_INVALID_OPERATION, "there is no picture")
            return self._picture
        info, layout = self._camera.info, self._camera.controls.layout
        if name == "devicestate":
            values: dict[str, Any] = {"TimeStamp": _time_text(datetime.now(UTC))}
            with suppress(AlpacaError):
                for each in ("CameraState", "PercentCompleted", "ImageReady"):
                    values[each] = self.value(each.lower())
            return [{"Name": each, "Value": value} for each, value in values.items()]
        if name == "imageready":
            return self.is_ready
        return {
            "camerastate": _EXPOSING if self.is_exposing else _FAILED if self._error else _IDLE,
            "cameraxsize": self.size[0],
            "cameraysize": self.size[1],
            "description": f"the light of several exposures of {info.name}",
            "driverinfo": f"camctl {camctl.__version__}, {info.id}",
            "exposuremax": self.limits_s[1],
            "exposuremin": self.limits_s[0],
            "name": f"{info.name}, effective",
            "percentcompleted": int(100 * self._done),
            "readoutmodes": ["linear, 16 bits"],
            "sensorname": info.model,
            "sensortype": int(layout is not camctl.Layout.MONO),
        }[name]

    def put(self, name: str, read: _Read, client: int) -> None:
        """Call a method or set a property for a client, with the parameters that it gave."""
        match name:
            case "connected" | "connect" | "disconnect":
                is_wanted = read("Connected", _truth) if name == "connected" else name == "connect"
                (self.clients.add if is_wanted else self.clients.discard)(client)
            case "startexposure":
                read("Light", _truth)  # there is no shutter to keep closed
                self.start(read("Duration", float))
            case "abortexposure":
                self.abort()
            case "startx" | "starty" | "numx" | "numy":
                parameter = f"{name[:-1].capitalize()}{name[-1].upper()}"
                self.window[name] = read(parameter, int)
            case "binx" | "biny" | "readoutmode":
                parameter = {"binx": "BinX", "biny": "BinY"}.get(name, "ReadoutMode")
                if read(parameter, int) != _CONSTANTS[name]:
                    raise AlpacaError(_INVALID_VALUE, f"{parameter} is {_CONSTANTS[name]} only")
            case "action":
                raise AlpacaError(_NO_ACTION, "there are no actions")
            case _:
                raise KeyError(name)


def _time_text(moment: datetime) -> str:
    return f"{moment:%Y-%m-%dT%H:%M:%S.%f}"[:-3]


def _unsigned(text: str) -> int:
    if not re.fullmatch(r"\d{1,10}", text, re.ASCII) or int(text) >= 1 << 32:
        raise ValueError(text)
    return int(text)


def _truth(text: str) -> bool:
    return {"true": True, "false": False}[text.lower()]


class _Handler(SiteHandler):
    """Answers one request."""

    camera: AlpacaCamera
    numbers = count(1)

    def do_GET(self) -> None:
        """Answer a property, or what the server is."""
        if self.is_allowed():
            self._answer({k.lower(): v for k, v in parse_qsl(self.url.query)}, is_put=False)

    def do_PUT(self) -> None:
        """Do something, or set a property."""
        if not self.is_allowed():
            return
        if self.length > _BODY_BYTES:
            self.refuse(HTTPStatus.BAD_REQUEST, "the body is too long")
            return
        body = self.read_body().decode("utf-8", "replace")
        self._answer(dict(parse_qsl(body, keep_blank_values=True)), is_put=True)

    def _answer(self, given: Mapping[str, str], *, is_put: bool) -> None:
        def read(parameter: str, kind: Callable[[str], Any], usual: str = "") -> Any:
            key = parameter if is_put else parameter.lower()
            try:
                return kind(given.get(key, usual))
            except (KeyError, ValueError):
                raise camctl.UsageError(f"{self.url.path} needs {parameter}") from None

        head: dict[str, Any] = {"ServerTransactionID": next(self.numbers)}
        try:
            client = read("ClientID", _unsigned, "0")
            head |= {"ClientTransactionID": read("ClientTransactionID", _unsigned, "0")}
            value = self._value(read, client, is_put=is_put)
        except (KeyError, camctl.UsageError) as error:
            is_known = isinstance(error, camctl.UsageError)
            self.refuse(HTTPStatus.BAD_REQUEST, str(error) if is_known else "no such address")
            return
        except AlpacaError as error:
            self._json({**head, "ErrorNumber": error.number, "ErrorMessage": str(error)})
            return
        head |= {"ErrorNumber": 0, "ErrorMessage": ""}
        if isinstance(value, np.ndarray):
            self._image(value, head)
        elif isinstance(value, bytes):
            self.answer(value, "text/html; charset=utf-8")
        else:
            self._json(head if is_put else {"Value": value, **head})

    def _value(self, read: _Read, client: int, *, is_put: bool) -> Any:
        camera = self.camera
        match [each for each in self.url.path.split("/") if each]:
            case ["management", "apiversions"] if not is_put:
                return [1]
            case ["management", "v1", name] if not is_put:
                return _management(name, camera)
            case ["setup", *_] if not is_put:
                return b"<!doctype html><title>camctl</title>There is nothing to set up."
            case ["api", "v1", "camera", "0", name]:
                if name in _MISSING.split():
                    raise AlpacaError(_NOT_IMPLEMENTED, f"{name} is not implemented")
                is_connected = client in camera.clients
                if not is_connected and name not in _ALWAYS.split():
                    raise AlpacaError(_NOT_CONNECTED, "the client is not connected")
                if is_put:
                    return camera.put(name, read, client)
                return is_connected if name == "connected" else camera.value(name)
        raise KeyError(self.url.path)

    def _json(self, content: Mapping[str, Any]) -> None:
        self.answer(json.dumps(content).encode(), "application/json; charset=utf-8")

    def _image(self, picture: NDArray[np.uint16], head: Mapping[str, Any]) -> None:
        if "application/imagebytes" not in self.headers.get("Accept", "").lower():
            kind = {"Type": _INT32, "Rank": picture.ndim}
            self._json({**kind, "Value": picture.tolist(), **head})
            return
        sizes = (*picture.shape, 0)[:3]
        transactions = head["ClientTransactionID"], head["ServerTransactionID"]
        types = _INT32, _UINT16, picture.ndim
        packed = _IMAGE_HEAD.pack(1, 0, *transactions, _IMAGE_HEAD.size, *types, *sizes)
        data = packed + picture.astype("<u2", copy=False).tobytes()
        self.answer(data, "application/imagebytes")


def _management(name: str, camera: AlpacaCamera) -> Any:
    host, about = socket.gethostname(), {"ServerName": "camctl", "Manufacturer": "camctl"}
    device: dict[str, Any] = {"DeviceType": "Camera", "DeviceNumber": 0}
    device["DeviceName"] = camera.value("name")
    device["UniqueID"] = f"{host}, {camera.value('driverinfo')}"
    return {
        "description": {**about, "ManufacturerVersion": camctl.__version__, "Location": host},
        "configureddevices": [device],
    }[name]


class AlpacaServer:
    """Serves a camera until it is closed.

    Args:
        camera: an open camera
        request: what its pictures are to be
        address: ``PORT`` or ``HOST:PORT``: whoever reaches it may use the camera, since the
            protocol has no passwords; without a host this computer alone

    Raises:
        UsageError: an address that cannot be used, or a request that the camera cannot meet
    """

    def __init__(self, camera: camctl.Camera, request: camctl.CaptureRequest, address: str) -> None:
        self.camera = AlpacaCamera(camera, request)
        self.site = Site(address, "", "", "", "the camera server", b"", is_open=True)
        self.site.start(_Handler, camera=self.camera)
        self._answers = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._answers.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        with suppress(OSError):  # another program shares the port with nobody
            self._answers.bind(("", DISCOVERY_PORT))
            threading.Thread(target=self._discover, daemon=True).start()

    def _discover(self) -> None:
        """Tell who asks for Alpaca servers which port this one has."""
        answer = json.dumps({"AlpacaPort": self.site.served_port}).encode()
        with suppress(OSError):  # it was closed
            while True:
                asked, sender = self._answers.recvfrom(64)
                if not sender:
                    return
                is_served = is_loopback(sender[0]) or not is_loopback(self.site.host)
                if is_served and asked.startswith(b"alpacadiscovery1"):
                    self._answers.sendto(answer, sender)

    def close(self) -> None:
        """Abort what runs, and serve no more."""
        self.site.stop()
        with suppress(OSError):  # on Linux this alone ends a thread that waits
            self._answers.shutdown(socket.SHUT_RDWR)
        self._answers.close()
        self.camera.abort()
