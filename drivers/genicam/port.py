"""What this driver needs of a GenICam library: devices, features and frames.

The modules `aravis` and `viva` implement it.  Features are named as in the "GenICam Standard
Features Naming Convention" (SFNC).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CameraBusyError, CameraDisconnectedError, CameraError

Value: TypeAlias = float | str | bool

#: Chunks that are read from every frame which has them.
CHUNKS = ("ExposureTime", "Gain", "Timestamp", "FrameID", "SequencerSetActive")


class FeatureError(CameraError):
    """The camera or the library refused to read or to write a feature."""


def lost_control(name: str, why: str) -> CameraDisconnectedError:
    """Return the error for a device that does not answer, or that another program controls."""
    return CameraDisconnectedError(
        f"{name} does not answer: {why}",
        hint="check its cable and its power, close other programs, and open it again",
    )


def in_use(name: str) -> CameraBusyError:
    """Return the error for a device that another program controls."""
    return CameraBusyError(
        f"another program controls {name}", hint="close that program and try again"
    )


class Kind(StrEnum):
    """What a feature holds."""

    FLOAT = "float"
    INTEGER = "integer"
    ENUMERATION = "enumeration"
    BOOLEAN = "boolean"
    COMMAND = "command"
    TEXT = "text"


@dataclass(frozen=True)
class FoundDevice:
    """A device that answered a search.

    Attributes:
        name: by which the library opens it
        make, model, serial: as it states them, "" where it does not
        address: of a device in the network, else ""
        transport: "GigE Vision" or "USB3 Vision"
    """

    name: str
    make: str
    model: str
    serial: str
    address: str
    transport: str


@dataclass(frozen=True)
class Limits:
    """Range of a number now; `step` is 0 where the camera states none."""

    minimum: float
    maximum: float
    step: float


@dataclass(frozen=True, eq=False)
class Received:
    """A frame that arrived.

    Attributes:
        data: its bytes, of the picture at least
        shape: (rows, columns)
        code: its pixel format, in the numbers of the PFNC
        line_padding: bytes after each line
        number: the camera's own
        arrived_s: when it was received, on the system's monotonic clock: later than it was sent
            where the computer is busy
        stamp_s: the camera's own time stamp, on its own clock; 0: it states none
        is_complete: no packet of it is missing
        chunks: values of `CHUNKS` that came with it
    """

    data: NDArray[np.uint8]
    shape: tuple[int, int]
    code: int
    line_padding: int
    number: int
    arrived_s: float
    stamp_s: float
    is_complete: bool
    chunks: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class PacketCounts:
    """Packets of a stream that never arrived, and that arrived when they were sent again."""

    missing: int
    resent: int


class OpenDevice(Protocol):
    """A device that this process controls.

    Methods raise `FeatureError` where a feature is refused, and `CameraDisconnectedError` where the
    device does not answer any more, or has another controller.
    """

    def kind(self, name: str) -> Kind | None:
        """Return what a feature holds; None: the camera does not have it, or not now."""

    def read(self, name: str) -> Value:
        """Return the value of a feature."""

    def write(self, name: str, value: Value) -> None:
        """Set a feature."""

    def execute(self, name: str) -> None:
        """Execute a command."""

    def limits(self, name: str) -> Limits:
        """Return the range of a number."""

    def entries(self, name: str) -> Sequence[str]:
        """Return the entries of an enumeration that may be chosen now."""

    def unit(self, name: str) -> str:
        """Return the unit of a number, "" where none is stated."""

    def description(self) -> str:
        """Return the XML file in which the camera describes itself."""

    def start(self, buffers: int) -> None:
        """Start to receive frames; the acquisition runs when this returns."""

    def stop(self) -> None:
        """Stop the acquisition; frames that were not taken are lost."""

    def receive(self, timeout_s: float) -> Received | None:
        """Return the next frame; None where none arrived in time."""

    def packets(self) -> PacketCounts:
        """Return what was lost since the device was opened."""

    def close(self) -> None:
        """Give up control."""


class Library(Protocol):
    """A library that finds and opens devices."""

    name: str

    def search(self) -> Sequence[FoundDevice]:
        """Return the devices of all networks and of USB that answer within a second."""

    def open(self, device: FoundDevice) -> OpenDevice:
        """Return the device, controlled by this process.

        Raises:
            CameraBusyError: it has another controller
            CameraNotFoundError: it does not answer
        """
