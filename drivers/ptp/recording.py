"""What a camera says when it is opened, packet by packet, to be sent to developers and replayed.

No picture is taken or fetched.  The serial number is hidden wherever it occurs, as are texts that
the camera keeps, such as the owner's name: their letters and digits become x.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

from camctl.drivers.ptp.camera import PtpCamera
from camctl.drivers.ptp.codes import Op
from camctl.drivers.ptp.datasets import DeviceInfo
from camctl.drivers.ptp.transport import DATA, Container, Transport
from camctl.errors import CameraError

#: Fewer characters are no name of anybody, and bytes of numbers may look like them.
_LEAST_TEXT = 4
#: Texts of PTP are UTF-16 with a zero at the end, and begin with the number of characters, the zero
#: counted (PIMA 15740:2000, 5.3.2.4); those of some makers are without the number, or UTF-8.  Of
#: UTF-8, eight characters in a row are no numbers.
_UTF16 = re.compile(rb"(?:[\x20-\x7e]\0){%d,}(?=\0\0)" % _LEAST_TEXT)
_UTF8 = re.compile(rb"(?:[\x20-\x7e]|[\xc2-\xdf][\x80-\xbf]|[\xe0-\xef][\x80-\xbf]{2}){8,}")
_LEAST_COUNTED = 3
#: Sizes of pictures, which some cameras have as texts.
_SIZE = re.compile(rb"\d+x\d+")


class RecordingTransport:
    """A `Transport` that keeps what goes through another one.

    Args:
        transport: the other one

    Attributes:
        packets: as `Replay` of the tests reads them; each is a dict of one key
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self.packets: list[dict[str, Any]] = []
        self._hidden: list[bytes] = []
        self.recover, self.reset, self.close = (
            transport.recover,
            transport.reset,
            transport.close,
        )

    @property
    def silence_s(self) -> float:
        """How long the camera may send nothing."""
        return self._transport.silence_s

    @silence_s.setter
    def silence_s(self, value: float) -> None:
        self._transport.silence_s = value

    def send(
        self, operation: int, transaction: int, parameters: Sequence[int], data: bytes | None
    ) -> None:
        """Send the first phase of a transaction, and keep it."""
        sent: dict[str, Any] = {"operation": operation, "parameters": list(parameters)}
        if data is not None:
            sent["data"] = self._without_private(data, keep_texts=False).hex()
        self.packets.append({"sent": sent})
        self._operation = operation
        self._transport.send(operation, transaction, parameters, data)

    def receive(self, transaction: int, *, limit: int) -> Container:
        """Return the next container of a transaction, and keep it without what is private."""
        try:
            found = self._transport.receive(transaction, limit=limit)
        except CameraError as error:
            self.packets.append({"failed": type(error).__name__})
            raise
        self._keep("received", found)
        return found

    def event(self, wait_s: float) -> Container | None:
        """Return the next event, and keep it."""
        found = self._transport.event(wait_s)
        if found is not None:
            self._keep("event", found)
        return found

    def _keep(self, kind: str, found: Container) -> None:
        has_texts = found.kind == DATA
        if has_texts and self._operation == Op.GET_DEVICE_INFO:
            with suppress(CameraError):
                self._hide(DeviceInfo.parse(found.payload).serial)
                has_texts = False  # else its serial number is among its texts
        payload = self._without_private(found.payload, keep_texts=not has_texts)
        self.packets.append({kind: [found.kind, found.code, payload.hex()]})

    def _hide(self, serial: str) -> None:
        if serial:
            self._hidden += [serial.encode("utf-16-le"), serial.encode("utf-8")]

    def _without_private(self, data: bytes, *, keep_texts: bool) -> bytes:
        for each in self._hidden:
            data = data.replace(each, _masked(each))
        if keep_texts:
            return data
        data = _UTF16.sub(lambda found: _masked(found[0]), _without_counted(data))
        return _UTF8.sub(lambda found: _masked(found[0]), data)


class _RecordedCamera(PtpCamera):
    """A camera whose connection is recorded."""

    recording: RecordingTransport

    def _connect(self) -> Transport:
        self.recording = RecordingTransport(super()._connect())
        return self.recording


def record(device: Any, clock: Any = None) -> dict[str, Any]:
    """Return what a camera says when it is opened and closed, and what was made of it.

    Args:
        device: a pyusb `Device`
        clock: of the camera; the system's by default
    """
    camera = _RecordedCamera(device, clock=clock)
    found: Mapping[str, Any]
    try:
        with camera:
            found = {"model": camera.info.model, "times_s": times_of(camera)}
    except CameraError as error:
        found = {"error": str(error)}
    recording = getattr(camera, "recording", None)
    return {
        "usb": {"vendor": device.idVendor, "product": device.idProduct},
        "packets": [] if recording is None else recording.packets,
        "found": dict(found),
    }


def times_of(camera: PtpCamera) -> list[float]:
    """Return the shutter times of an open camera, s, for which no picture is needed."""
    control = camera._dial_controls()[0]
    return [float(each) for each in control.between(control.minimum, control.maximum, 1000)]


def _without_counted(data: bytes) -> bytes:
    """Return data whose texts with a number of characters before them are masked, in any script."""
    hidden, place = bytearray(data), 0
    while place < len(data):
        count = data[place]
        begin, end = place + 1, place + 1 + 2 * (count - 1)
        text = data[begin:end].decode("utf-16-le", "replace")
        is_ended = count > _LEAST_COUNTED and data[end : end + 2] == b"\0\0"
        # Of numbers of 16 bits that begin a byte later, all lower bytes may be 0.
        is_text = is_ended and text.isprintable() and any(data[begin:end:2])
        if is_text and not _SIZE.fullmatch(text.encode("utf-8")):
            masked = "".join("x" if each.isalnum() else each for each in text)
            units = masked.encode("utf-16-le")
            hidden[begin:end] = units + b"x\0" * ((end - begin - len(units)) // 2)
        place = end + 2 if is_text else place + 1
    return bytes(hidden)


def _masked(text: bytes) -> bytes:
    """Return a text whose letters and digits are x; sizes of pictures stay."""
    if _SIZE.fullmatch(text.replace(b"\0", b"")):
        return text
    return re.sub(rb"[A-Za-z0-9\x80-\xff]", b"x", text)
