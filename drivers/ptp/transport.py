"""What carries the transactions of PTP: containers, and what a session needs of a transport."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from camctl.errors import CameraProtocolError

DATA, RESPONSE, EVENT = 2, 3, 4  # types of containers

#: Silence after which a camera counts as unresponsive, and the same while it takes a picture, s;
#: long enough for slow cards and long noise reduction.
NORMAL_S, CAPTURE_S = 20.0, 100.0

#: More than any camera is known to send in a row before the container that is expected.
MAX_STALE_CONTAINERS = 8
MAX_PARAMETERS = 5


@dataclass(frozen=True)
class Container:
    """A container that has arrived.

    Attributes:
        kind: DATA, RESPONSE or EVENT
        code: of the operation, the response or the event
        transaction: its number
        payload: parameters or data
    """

    kind: int
    code: int
    transaction: int
    payload: bytes

    @property
    def parameters(self) -> tuple[int, ...]:
        """The payload as 32-bit numbers."""
        count = min(len(self.payload) // 4, MAX_PARAMETERS)
        return struct.unpack_from(f"<{count}I", self.payload)


class IncompleteDataError(CameraProtocolError):
    """The data phase ended too early, and the response followed it."""


class Transport(Protocol):
    """The connection to one camera.

    Attributes:
        silence_s: how long the camera may send nothing
    """

    silence_s: float

    def send(
        self, operation: int, transaction: int, parameters: Sequence[int], data: bytes | None
    ) -> None:
        """Send the first phase of a transaction, and `data` if it is not None."""

    def receive(self, transaction: int, *, limit: int) -> Container:
        """Return the next container of a transaction, with at most `limit` bytes of data.

        Raises:
            CameraProtocolError: the bytes are no container, are too long, or belong to a later
                transaction; the transport must then be recovered
            CameraTimeoutError: nothing came for `silence_s`
            CameraDisconnectedError: the camera was disconnected
        """

    def event(self, wait_s: float) -> Container | None:
        """Return the next event; None if none came within `wait_s`, or if it was invalid."""

    def recover(self, transaction: int) -> bool:
        """Cancel a transaction; return whether the camera is ready, else it needs `reset`."""

    def reset(self) -> None:
        """Reset the connection, which closes the session."""

    def close(self) -> None:
        """Disconnect; errors of a disconnected camera are ignored."""
