"""What `camctl cameras --record` has written, as a camera that answers the same."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from camctl import errors
from camctl.drivers.ptp.camera import PtpCamera, PtpOptions
from camctl.drivers.ptp.transport import Container, Transport
from camctl.drivers.v4l2.abi import Request
from camctl.drivers.v4l2.kernel import Linux
from camctl.interface.clock import VirtualClock


class PtpReplay:
    """A transport that answers as a recorded camera did.

    An operation has the answer that followed it in the recording: the next one with the same
    parameters, else the last one before.  Events come at the place at which they were recorded.
    """

    silence_s = 1.0

    def __init__(self, packets: Sequence[Mapping[str, Any]]) -> None:
        self._packets = packets
        self._place = -1
        self.unknown: list[tuple[int, tuple[int, ...]]] = []

    def send(
        self, operation: int, transaction: int, parameters: Sequence[int], data: bytes | None
    ) -> None:
        wanted = {"operation": operation, "parameters": list(parameters)}
        wanted |= {} if data is None else {"data": data.hex()}
        later = range(self._place + 1, len(self._packets))
        earlier = range(min(self._place, len(self._packets) - 1), -1, -1)
        for place in (*later, *earlier):
            if self._packets[place].get("sent") == wanted:
                self._place = place
                return
        self.unknown.append((operation, tuple(parameters)))
        raise errors.CameraProtocolError(f"the recording has no operation {operation:#06x}")

    def receive(self, transaction: int, *, limit: int) -> Container:
        while True:
            self._place += 1
            packet = self._packets[self._place]
            if "failed" in packet:
                failure: errors.CameraError = getattr(errors, packet["failed"])("as recorded")
                raise failure
            if "received" in packet:
                kind, code, payload = packet["received"]
                return Container(kind, code, transaction, bytes.fromhex(payload))

    def event(self, wait_s: float) -> Container | None:
        following = self._packets[self._place + 1 : self._place + 2]
        if not following or "event" not in following[0]:
            return None
        self._place += 1
        kind, code, payload = following[0]["event"]
        return Container(kind, code, 0, bytes.fromhex(payload))

    def recover(self, transaction: int) -> bool:
        return True

    def reset(self) -> None:
        pass

    def close(self) -> None:
        pass


class ReplayedCamera(PtpCamera):
    """A camera on a recording; its clock is virtual."""

    def __init__(self, record: Mapping[str, Any]) -> None:
        usb = record["usb"]
        texts = dict.fromkeys(("serial_number", "manufacturer", "product"), "")
        device = SimpleNamespace(
            bus=1,
            address=1,
            idVendor=usb["vendor"],
            idProduct=usb["product"],
            backend=None,
            iManufacturer=0,
            iProduct=0,
            iSerialNumber=0,
            langids=(),
            **texts,
        )
        super().__init__(device, PtpOptions.parse({"response": "srgb"}), clock=VirtualClock())
        self.replay = PtpReplay(record["packets"])

    def _connect(self) -> Transport:
        return self.replay


class NodeReplay(Linux):
    """A kernel whose node answers as a recorded one did; nothing else can be asked."""

    def __init__(self, calls: Sequence[Sequence[Any]]) -> None:
        self._answers = {(call[0], call[1]): call[2:] for call in calls}

    def open(self, path: str) -> int:
        return 0

    def close(self, descriptor: int) -> None:
        pass

    def ioctl(self, descriptor: int, request: Request, argument: ctypes.Structure) -> None:
        after, failure = self._answers[int(request), bytes(argument).hex()]
        if failure:
            raise OSError(failure, "as recorded")
        ctypes.memmove(ctypes.addressof(argument), bytes.fromhex(after), ctypes.sizeof(argument))
