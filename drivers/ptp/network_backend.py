"""The backend `ptpip`: still cameras in the network, for the entry point `camctl.cameras`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import field_validator

from camctl.drivers.ptp.camera import PtpCamera, PtpOptions
from camctl.drivers.ptp.network_link import PORT, Address, Connect, connect_socket
from camctl.drivers.ptp.network_transport import Caller, NetworkTransport, guid_of_this_computer
from camctl.drivers.ptp.transport import CAPTURE_S, NORMAL_S, Transport
from camctl.errors import UsageError
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import Clock

DRIVER = "ptpip"


class NetworkOptions(PtpOptions):
    """Options of a camera in the network, besides `PtpOptions`.

    Attributes:
        guid: number by which the camera recognises a computer, 32 hexadecimal digits; None: one
            made from the name of this computer
    """

    guid: str | None = None

    @field_validator("guid")
    @classmethod
    def _is_a_guid(cls, digits: str | None) -> str | None:
        if digits is not None and re.fullmatch(r"[0-9a-fA-F]{32}", digits) is None:
            raise ValueError("write 32 hexadecimal digits")
        return digits


class NetworkCamera(PtpCamera):
    """A still camera in the network; `open` connects to it.

    Raises what `NetworkTransport` and `PtpCamera` raise when it is opened.

    Args:
        address: where it listens: HOST, HOST:PORT or [IPV6]:PORT
        options: see `NetworkOptions`
        clock: of timestamps, and for all waiting
        connect: opens a connection
        silence_s: how long the camera may send nothing
        capture_s: how long a picture may take beyond its exposure
    """

    def __init__(
        self,
        address: str,
        options: NetworkOptions | None = None,
        *,
        clock: Clock | None = None,
        connect: Connect = connect_socket,
        silence_s: float = NORMAL_S,
        capture_s: float = CAPTURE_S,
    ) -> None:
        place = Address.parse(address)
        chosen = options if options is not None else NetworkOptions()
        super().__init__(place, chosen, clock=clock, silence_s=silence_s, capture_s=capture_s)
        guid = bytes.fromhex(chosen.guid) if chosen.guid else guid_of_this_computer()
        self._address, self._connector, self._caller = place, connect, Caller(guid)

    @classmethod
    def _place(cls, device: Any) -> str:
        return f"{device.host}:{device.port}"

    def _connect(self) -> Transport:
        transport = NetworkTransport(self._address, self._connector, self._caller, self._clock)
        self._name = transport.name
        return transport

    def _identity(self) -> CameraInfo:
        info = self._body.session.info
        return CameraInfo(f"{DRIVER}:{self._address}", info.make, info.model, info.serial, DRIVER)


class NetworkBackend:
    """Opens ``ptpip:HOST`` and ``ptpip:HOST:PORT``; see `NetworkOptions`.

    It has no addresses that a file may name: they are other machines.
    """

    about = f"still cameras in the network that speak PTP/IP: give ptpip:HOST (port {PORT})"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return nothing: cameras in the network are opened by their addresses only."""
        return ()

    def open(self, address: str, options: Mapping[str, Any]) -> NetworkCamera:
        chosen = NetworkOptions.parse(options)
        if not address:
            raise UsageError(
                "cameras in the network are found by their addresses only",
                hint="give the one that the camera shows in its network menu: ptpip:HOST",
            )
        return NetworkCamera(address, chosen).open()
