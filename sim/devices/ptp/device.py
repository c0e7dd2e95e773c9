"""What virtual PTP cameras on all transports share: operations, replies, faults and commands."""

from __future__ import annotations

import random
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from camctl.sim.devices.clock import DeviceClock
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.ptp.canon import CanonResponder
from camctl.sim.devices.ptp.config import Identity, PtpConfig, WireFaultCommands, WireFaults
from camctl.sim.devices.ptp.fuji import FujiResponder
from camctl.sim.devices.ptp.nikon import NikonResponder
from camctl.sim.devices.ptp.olympus import OlympusResponder
from camctl.sim.devices.ptp.panasonic import PanasonicResponder
from camctl.sim.devices.ptp.protocol import Operation, Reply, Response
from camctl.sim.devices.ptp.responder import Responder
from camctl.sim.devices.ptp.sony import SonyResponder
from camctl.sim.devices.still_body import BodyOptions, StillBody, StillFaultCommands

RESPONDERS: dict[str, type[Responder]] = {
    "none": Responder,
    "nikon": NikonResponder,
    "canon": CanonResponder,
    "sony": SonyResponder,
    "fuji": FujiResponder,
    "olympus": OlympusResponder,
    "panasonic": PanasonicResponder,
}
_OBJECT_OPERATIONS = (
    Operation.GET_OBJECT,
    Operation.GET_PARTIAL_OBJECT,
    Operation.EOS_GET_OBJECT,
    Operation.EOS_GET_PARTIAL_OBJECT,
)
_NEVER_BUSY = (Operation.GET_DEVICE_INFO, Operation.OPEN_SESSION, Operation.CLOSE_SESSION)


@dataclass(frozen=True)
class Command:
    """An operation that the host has requested."""

    code: int
    transaction: int
    parameters: tuple[int, ...]

    @property
    def is_of_object(self) -> bool:
        return self.code in _OBJECT_OPERATIONS


def identity_of(config: PtpConfig) -> Identity:
    """Return the identity of the camera of a configuration."""
    return config.identity(RESPONDERS[config.vendor].identity)


class PtpDevice(WireFaultCommands, StillFaultCommands):
    """A PTP camera; a transport derives from it.

    A transport sets `lock` and `clock` before it calls `make_body`, and calls `begin_command` and
    `take_data` for what the host sends.  It implements `send_event`, `send_reply`, `send_bytes` and
    `refuse_transfers`.

    Attributes:
        lock: held in each call from a transport and while the camera sends
        clock: on which it times exposures
        body: shutter, sensor and their faults
        responder: its operations
        faults: of the cable and of the protocol
    """

    lock: threading.RLock
    clock: DeviceClock

    def make_body(self, config: PtpConfig, sensor: VirtualSensor) -> None:
        """Make body and responder; called once."""
        options = BodyOptions(
            "VIRT",
            delay_s=config.delay_s,
            object_bytes=config.object_bytes,
            model=identity_of(config).model,
            states_iso=True,
            reduces_noise=config.noise_reduction,
        )
        self.config = config
        self.body = StillBody(sensor, self.lock, self.clock, options)
        kind = RESPONDERS[config.vendor]
        self.responder = kind(self.body, config, self.send_event, self._reply_later)
        self.faults = WireFaults()
        self._random = random.Random(0)
        self._command: Command | None = None  # that waits for its data phase
        self._unanswered: Command | None = None  # whose reply is sent later

    # A transport implements these.

    def send_event(self, code: int, parameters: Sequence[int]) -> None:
        """Send an event."""
        raise NotImplementedError

    def send_reply(self, command: Command, reply: Reply) -> None:
        """Send the data phase and the response of an operation."""
        raise NotImplementedError

    def send_bytes(self, data: bytes) -> None:
        """Send bytes that are no packet."""
        raise NotImplementedError

    def refuse_transfers(self) -> None:
        """Refuse further transfers until the host recovers the transport."""
        raise NotImplementedError

    # A transport calls these.

    def begin_command(self, code: int, transaction: int, parameters: tuple[int, ...]) -> None:
        """Begin an operation."""
        self._command = Command(code, transaction, parameters)
        if code not in self.responder.takes_data or code not in self.responder.operations:
            self._execute(b"")

    def take_data(self, data: bytes) -> None:
        """Take the data phase of an operation; ignored if the operation has been refused."""
        if self._command is not None:
            self._execute(data)

    def drop_command(self) -> Command | None:
        """Cancel the current operation; return it if it has not been answered."""
        command = self._command or self._unanswered
        self._command = self._unanswered = None
        return command

    def cut_object(self, command: Command, data: bytes) -> bytes | None:
        """Return the half of an object that a truncated transfer has; None: it is complete."""
        if not command.is_of_object or self.faults.truncations <= 0:
            return None
        self.faults.truncations -= 1
        return data[: len(data) // 2]

    def _execute(self, data: bytes) -> None:
        command, self._command = self._command, None
        assert command is not None
        if self.faults.is_hanging:
            return
        if self.faults.stalls > 0:
            self.faults.stalls -= 1
            self.refuse_transfers()
            return
        if self.faults.busy and command.code not in _NEVER_BUSY:
            self.faults.busy -= self.faults.busy > 0
            self._reply(command, Reply(Response.DEVICE_BUSY))
            return
        self._unanswered = command
        reply = self.responder.execute(command.code, command.transaction, command.parameters, data)
        if reply is not None:
            self._unanswered = None
            self._reply(command, reply)

    def _reply_later(self, reply: Reply) -> None:
        command, self._unanswered = self._unanswered, None
        if command is not None:  # else the operation has been cancelled
            self._reply(command, reply)

    def _reply(self, command: Command, reply: Reply) -> None:
        if self.faults.garbage > 0:
            self.faults.garbage -= 1
            self.send_bytes(self._random.randbytes(37))
        else:
            self.send_reply(command, reply)

    # Control commands.

    def do_ok(self) -> None:
        self.faults = WireFaults()
        self.body.clear_faults()
        self.responder.sends_events = self.config.event_order != "never"

    def do_no_events(self) -> None:
        """Send no events until the command ok."""
        self.responder.sends_events = False

    def do_mode(self, dial: Literal["manual", "auto"]) -> None:
        """Turn the mode dial."""
        with self.lock:
            self.responder.turn_dial(dial)

    def state(self) -> dict[str, Any]:
        """Return properties by code, session, number of pictures, and counts of operations."""
        with self.lock:
            responder = self.responder
            return {
                "session": responder.session,
                "properties": {f"{c:04X}": p.value for c, p in responder.properties.items()},
                "pictures": responder.card.count,
                "is_exposing": self.body.is_exposing,
                **self.body.state(),
                "operations": dict(responder.operation_counts),
            }

    def do_log(self) -> dict[str, Any]:
        with self.lock:
            return {"operations": list(self.responder.log), "shots": list(self.body.log)}
