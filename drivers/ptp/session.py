"""PTP sessions: transactions that are repeated, recovered and reopened as USB and cameras require.

A transaction is a command, data (in one direction or none) and a response.  `Session.call` repeats
operations that may be repeated, waits while the camera is busy, recovers the pipes after a stall, a
time-out or an invalid answer, and opens the session again if the camera has lost it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace

from camctl.drivers.ptp.codes import (
    ALL_STORES,
    DEVICE_BUSY,
    OK,
    SESSION_ALREADY_OPEN,
    SESSION_NOT_OPEN,
    Op,
    response_error,
)
from camctl.drivers.ptp.datasets import (
    DeviceInfo,
    ObjectInfo,
    PropertyDescription,
    Reader,
    StorageInfo,
)
from camctl.drivers.ptp.transport import DATA, NORMAL_S, Container, IncompleteDataError, Transport
from camctl.errors import (
    CamctlError,
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.clock import Clock

#: Size of objects whose size does not fit 32 bits or is not known.
UNKNOWN_SIZE = 0xFFFFFFFF

# Far above any dataset; Sony's list of all properties, the largest, has some 20 kB.
_MAX_DATASET_BYTES = 1 << 22
# Above any picture; containers of 4 GB and more state FFFFFFFF.
_MAX_OBJECT_BYTES = 1 << 31
_ATTEMPTS = 3
# Pauses between requests to a busy camera: doubled from the first to the longest.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.02, 0.5
_SESSION_ID = 1


@dataclass(frozen=True)
class Answer:
    """Response code and parameters of a transaction, and the data received with it."""

    code: int
    parameters: tuple[int, ...]
    data: bytes


class Session:
    """A session with one camera.

    Args:
        transport: the connection to it
        name: name of the camera in error messages
        clock: for waiting while the camera is busy
        silence_s: how long the camera may send nothing
        busy_s: how long the camera may answer that it is busy

    Attributes:
        clock: the same clock
        maker: whose vendor codes it answers with, once known
        times_recovered: how often the pipes had to be recovered
        times_busy: how often the camera answered that it was busy
        last_transaction: number of the latest transaction
        asked_s: when the transaction was sent that has no answer yet; None: all are answered
        after_reopening: called after the session had to be opened again
    """

    def __init__(
        self,
        transport: Transport,
        name: str,
        clock: Clock,
        *,
        silence_s: float = NORMAL_S,
        busy_s: float = NORMAL_S,
    ) -> None:
        self._transport, self._name, self.clock = transport, name, clock
        self._silence_s, self._busy_s = silence_s, busy_s
        self._transaction = self.last_transaction = 0
        self._is_open = self._is_reopening = False
        self.after_reopening: Callable[[], None] | None = None
        self.asked_s: float | None = None
        self.times_recovered = 0
        self.maker = ""
        self.times_busy = 0
        self._info: DeviceInfo | None = None

    @property
    def info(self) -> DeviceInfo:
        """The camera's device information."""
        if self._info is None:
            answer = self.call(Op.GET_DEVICE_INFO, task="report its device information")
            self._info = DeviceInfo.parse(answer.data)
        return self._info

    def correct_info(
        self, added: frozenset[int], removed: frozenset[int], properties: Iterable[int]
    ) -> None:
        """Correct the device information: operations, and properties that it leaves out."""
        info = self.info
        self._info = replace(
            info,
            operations=(info.operations | added) - removed,
            properties=tuple(dict.fromkeys((*info.properties, *properties))),
        )

    def open(self) -> None:
        """Open the session; one that another program left open is closed first.

        Pipes that another program left halted or half read are recovered first.
        """
        self._transaction = 0
        try:
            answer = self.attempt(Op.OPEN_SESSION, _SESSION_ID)
        except CameraProtocolError:
            answer = self.attempt(Op.OPEN_SESSION, _SESSION_ID)
        if answer.code == SESSION_ALREADY_OPEN:
            self._transaction = 1
            self._attempt(Op.CLOSE_SESSION, ())
            self._transaction = 0
            answer = self._attempt(Op.OPEN_SESSION, (_SESSION_ID,))
        if answer.code != OK:
            raise self._refused(answer.code, "open a session")
        self._transaction = 1
        self._is_open = True

    def close(self) -> None:
        """Close the session; errors are ignored."""
        if self._is_open:
            self._is_open = False
            self._transport.silence_s = min(self._silence_s, 2.0)  # s
            with suppress(CamctlError):
                self._attempt(Op.CLOSE_SESSION, ())

    # ---- transactions

    def call(
        self,
        operation: int,
        *parameters: int,
        task: str,
        data: bytes | None = None,
        limit: int = _MAX_DATASET_BYTES,
        repeatable: bool = True,
        busy_s: float | None = None,
    ) -> Answer:
        """Perform an operation and return its answer, whose response code is OK.

        Args:
            operation: code
            parameters: up to five
            task: the operation in error messages, such as "take a picture"
            data: data to send with it
            limit: most bytes of data that may be received
            repeatable: True if it may be repeated: twice after a stall or an invalid answer, once
                after a time-out
            busy_s: how long the camera may be busy; None: the session's `busy_s`

        Raises:
            CameraBusyError: the camera stayed busy for `busy_s`
            CameraError: any other response; see `camctl.drivers.ptp.codes.response_error`
        """
        deadline_s = self.clock.now() + (self._busy_s if busy_s is None else busy_s)
        pause_s, attempts = _FIRST_PAUSE_S, _ATTEMPTS if repeatable else 1
        while True:
            attempts -= 1
            try:
                answer = self.attempt(operation, *parameters, data=data, limit=limit)
            except CameraDisconnectedError:
                raise
            except CameraTimeoutError:
                if attempts <= 0:
                    raise
                attempts = 0  # a time-out takes long: one more attempt, not two
                continue
            except CameraError:
                if attempts <= 0:
                    raise
                continue
            if answer.code == OK:
                return answer
            if answer.code == SESSION_NOT_OPEN and self._is_open and attempts > 0:
                self._reopen()
            elif answer.code == DEVICE_BUSY and self.clock.now() < deadline_s:
                attempts += 1
                self.times_busy += 1
                self.clock.sleep_until(self.clock.now() + pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
            else:
                raise self._refused(answer.code, task)

    def attempt(
        self,
        operation: int,
        *parameters: int,
        data: bytes | None = None,
        limit: int = _MAX_DATASET_BYTES,
        silence_s: float | None = None,
    ) -> Answer:
        """Perform an operation once and return its answer, whatever the response code.

        After a stall, a time-out or an invalid answer the pipes are recovered before the error is
        raised.  `silence_s` is how long the camera may send nothing; None: as for the session.
        """
        self._transport.silence_s = self._silence_s if silence_s is None else silence_s
        try:
            return self._attempt(operation, parameters, data, limit)
        except (CameraTimeoutError, CameraProtocolError) as error:
            self._transport.silence_s = self._silence_s
            self._recover(error)
            raise

    def _attempt(
        self,
        operation: int,
        parameters: tuple[int, ...],
        data: bytes | None = None,
        limit: int = _MAX_DATASET_BYTES,
    ) -> Answer:
        number = self._transaction
        if self._is_open:
            self._transaction = number + 1 if number < 0xFFFFFFFE else 1  # FFFFFFFF is none
        self.last_transaction, self.asked_s = number, self.clock.now()
        self._transport.send(operation, number, parameters, data)
        received = b""
        container = self._transport.receive(number, limit=limit)
        if container.kind == DATA:
            received = container.payload
            container = self._transport.receive(number, limit=0)
        if container.kind == DATA:
            raise CameraProtocolError(
                f"{self._name} sent data twice in one transaction", hint="try again"
            )
        self.asked_s = None
        return Answer(container.code, container.parameters, received)

    def _recover(self, error: CameraError) -> None:
        self.times_recovered += 1
        if isinstance(error, IncompleteDataError):
            with suppress(CameraProtocolError):
                self._transport.receive(self.last_transaction, limit=0)
                return
        if self._transport.recover(self.last_transaction):
            return
        self._transport.reset()
        if self._is_open:
            with suppress(CameraTimeoutError, CameraProtocolError):
                self._reopen()

    def _reopen(self) -> None:
        """Open a session that the camera has lost; not while that is already being done."""
        if self._is_reopening:
            raise CameraDisconnectedError(
                f"{self._name} keeps losing its session", hint="switch it off and on again"
            )
        self._is_reopening, self._is_open = True, False
        try:
            self.open()
            if self.after_reopening is not None:
                self.after_reopening()
        finally:
            self._is_reopening = False

    def _refused(self, code: int, task: str) -> CameraError:
        return response_error(code, task, self._name, self.maker)

    # ---- operations

    def event(self, wait_s: float) -> Container | None:
        """Return the next event of the interrupt pipe; None if none comes within `wait_s`."""
        return self._transport.event(wait_s)

    def handles(self, *, busy_s: float | None = None) -> frozenset[int]:
        """Return the handles of all objects on all cards; `busy_s` as in `call`."""
        answer = self.call(
            Op.GET_OBJECT_HANDLES, ALL_STORES, 0, 0, task="list its files", busy_s=busy_s
        )
        return frozenset(Reader(answer.data, "list of objects").array(4))

    def object_info(self, handle: int, *, busy_s: float | None = None) -> ObjectInfo:
        """Return the description of an object; `busy_s` as in `call`."""
        answer = self.call(Op.GET_OBJECT_INFO, handle, task="describe a file", busy_s=busy_s)
        return ObjectInfo.parse(answer.data)

    def object(self, handle: int, size: int, *, busy_s: float | None = None) -> bytes:
        """Return an object of `size` bytes, or `UNKNOWN_SIZE`; `busy_s` as in `call`.

        Raises:
            CameraProtocolError: another number of bytes was received, three times
        """
        for _ in range(_ATTEMPTS):
            answer = self.call(
                Op.GET_OBJECT,
                handle,
                task="send a file",
                limit=min(size, _MAX_OBJECT_BYTES),
                busy_s=busy_s,
            )
            if len(answer.data) == size or size == UNKNOWN_SIZE:
                return answer.data
        raise CameraProtocolError(
            f"{self._name} sent {len(answer.data)} of {size} bytes of a file",
            hint="it is still on the card: copy it from there, or resume",
        )

    def delete(self, handle: int) -> None:
        self.call(Op.DELETE_OBJECT, handle, task="delete a file", repeatable=False)

    def stores(self) -> tuple[StorageInfo, ...]:
        """Return the cards in the camera."""
        answer = self.call(Op.GET_STORAGE_IDS, task="list its cards")
        # The lower half of an identifier is 0 for an empty slot.
        ids = [i for i in Reader(answer.data, "list of cards").array(4) if i & 0xFFFF]
        return tuple(
            StorageInfo.parse(self.call(Op.GET_STORAGE_INFO, number, task="describe its card").data)
            for number in ids
        )

    def description(self, code: int) -> PropertyDescription:
        answer = self.call(Op.GET_PROPERTY_DESCRIPTION, code, task=f"describe property {code:04X}")
        return PropertyDescription.parse(answer.data)
