"""PTP sessions: transactions that survive what USB and cameras do to them.

A transaction is command, data (either way or none), response.  `Session.call` repeats what may be
repeated, waits while the camera is busy, brings the pipes back to order after a stall, silence or
nonsense, and opens the session again where the camera has lost it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from camctl.errors import (
    CamctlError,
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
)
from drivers.ptp.codes import (
    ALL_STORES,
    DEVICE_BUSY,
    OK,
    SESSION_ALREADY_OPEN,
    SESSION_NOT_OPEN,
    Op,
    response_error,
)
from drivers.ptp.datasets import DeviceInfo, ObjectInfo, PropertyDescription, Reader, StorageInfo
from drivers.ptp.transport import DATA, NORMAL_S, Container, HalfSentError, UsbTransport

#: No dataset of the standard comes near; Sony's list of all properties has some 20 kB.
_MOST_DATASET_BYTES = 1 << 22
#: The largest file believed in; containers of 4 GB and more say FFFFFFFF.
_MOST_OBJECT_BYTES = 1 << 31
#: Of files whose size does not fit 32 bits, or is not known.
UNKNOWN_SIZE = 0xFFFFFFFF
_TRIES = 3
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.02, 0.5
_SESSION = 1
_CLOSING_S = 2.0
_LAST_TRANSACTION = 0xFFFFFFFE


@dataclass(frozen=True)
class Answer:
    """What a transaction brought: response code, its parameters, and data."""

    code: int
    parameters: tuple[int, ...]
    data: bytes


class Session:
    """One open session with one camera.

    Args:
        transport: its pipes
        who: how errors call it
        silence_s: how long it may say nothing before that is an error
        busy_s: how long it may say that it is busy before that is an error

    Attributes:
        maker: whose vendor codes it answers with, once that is known
        times_recovered: how often the pipes had to be brought back to order
        times_busy: how often it said that it was busy
        last_transaction: number of the transaction that was begun last
        after_reopening: called where the session had to be opened again
    """

    def __init__(
        self,
        transport: UsbTransport,
        who: str,
        *,
        silence_s: float = NORMAL_S,
        busy_s: float = NORMAL_S,
    ) -> None:
        self._transport, self._who = transport, who
        self._silence_s, self._busy_s = silence_s, busy_s
        self._transaction = self.last_transaction = 0
        self._is_open = self._is_reopening = False
        self.after_reopening: Callable[[], None] | None = None
        self.times_recovered = 0
        self.maker = ""
        self.times_busy = 0
        self._info: DeviceInfo | None = None

    @property
    def info(self) -> DeviceInfo:
        """Who the camera says it is."""
        if self._info is None:
            answer = self.call(Op.GET_DEVICE_INFO, doing="asking who it is")
            self._info = DeviceInfo.parse(answer.data)
        return self._info

    def open(self) -> None:
        """Open the session; one that somebody else left open is closed first.

        Pipes that somebody left halted, or half read, are brought to order first.
        """
        self._transaction = 0
        try:
            answer = self.attempt(Op.OPEN_SESSION, _SESSION)
        except CameraProtocolError:
            answer = self.attempt(Op.OPEN_SESSION, _SESSION)
        if answer.code == SESSION_ALREADY_OPEN:
            self._transaction = 1
            self._attempt(Op.CLOSE_SESSION, ())
            self._transaction = 0
            answer = self._attempt(Op.OPEN_SESSION, (_SESSION,))
        if answer.code != OK:
            raise self._refused(answer.code, "opening a session")
        self._transaction = 1
        self._is_open = True

    def close(self) -> None:
        """Close the session, as far as the camera still listens."""
        if self._is_open:
            self._is_open = False
            self._transport.silence_s = min(self._silence_s, _CLOSING_S)
            with suppress(CamctlError):
                self._attempt(Op.CLOSE_SESSION, ())

    # ---- transactions

    def call(
        self,
        operation: int,
        *parameters: int,
        doing: str,
        data: bytes | None = None,
        limit: int = _MOST_DATASET_BYTES,
        repeatable: bool = True,
        silence_s: float | None = None,
        busy_s: float | None = None,
    ) -> Answer:
        """Do one operation and return its answer, which is OK.

        Args:
            operation: what to do
            parameters: up to five
            doing: what it is called in errors
            data: what to send with it
            limit: data bytes that may come
            repeatable: doing it again does no harm: twice after a stall or nonsense, once after
                silence
            silence_s: how long the camera may be silent; None: as long as usual
            busy_s: how long it may be busy; None: as long as usual

        Raises:
            CameraBusyError: it is busy for longer than `busy_s`
            CameraError: what it answered otherwise; see `codes`
        """
        deadline = time.monotonic() + (self._busy_s if busy_s is None else busy_s)
        pause_s, tries = _FIRST_PAUSE_S, _TRIES if repeatable else 1
        while True:
            tries -= 1
            try:
                answer = self.attempt(
                    operation, *parameters, data=data, limit=limit, silence_s=silence_s
                )
            except CameraDisconnectedError:
                raise
            except CameraTimeoutError:
                if tries <= 0:
                    raise
                tries = 0  # after such a wait it is tried once more, and not twice
                continue
            except CameraError:
                if tries <= 0:
                    raise
                continue
            if answer.code == OK:
                return answer
            if answer.code == SESSION_NOT_OPEN and self._is_open and tries > 0:
                self._reopen()
            elif answer.code == DEVICE_BUSY and time.monotonic() < deadline:
                tries += 1
                self.times_busy += 1
                time.sleep(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)
            else:
                raise self._refused(answer.code, doing)

    def attempt(
        self,
        operation: int,
        *parameters: int,
        data: bytes | None = None,
        limit: int = _MOST_DATASET_BYTES,
        silence_s: float | None = None,
    ) -> Answer:
        """Do one operation once and return whatever the camera answers.

        After a stall, silence or nonsense the pipes are in order again when the error is raised.
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
        limit: int = _MOST_DATASET_BYTES,
    ) -> Answer:
        number = self._transaction
        if self._is_open:
            self._transaction = number + 1 if number < _LAST_TRANSACTION else 1
        self.last_transaction = number
        self._transport.send_command(operation, number, parameters)
        if data is not None:
            self._transport.send_data(operation, number, data)
        came = b""
        container = self._transport.receive(number, limit=limit)
        if container.kind == DATA:
            came = container.payload
            container = self._transport.receive(number, limit=0)
        if container.kind == DATA:
            raise CameraProtocolError(
                f"{self._who} sent data twice in one transaction", hint="try again"
            )
        return Answer(container.code, container.parameters, came)

    def _recover(self, error: CameraError) -> None:
        self.times_recovered += 1
        if isinstance(error, HalfSentError):
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
        """Open a session that the camera has lost, once: opening it may fail in the same way."""
        if self._is_reopening:
            raise CameraDisconnectedError(
                f"{self._who} keeps losing its session", hint="switch it off and on again"
            )
        self._is_reopening, self._is_open = True, False
        try:
            self.open()
            if self.after_reopening is not None:
                self.after_reopening()
        finally:
            self._is_reopening = False

    def _refused(self, code: int, doing: str) -> CameraError:
        return response_error(code, doing, self._who, self.maker)

    def refused(self, answer: Answer, doing: str) -> CameraError:
        """Return the error for an answer that is not OK."""
        return self._refused(answer.code, doing)

    # ---- operations

    def event(self, wait_s: float) -> Container | None:
        """Return the next event of the interrupt pipe, or None."""
        return self._transport.event(wait_s)

    def handles(self, *, busy_s: float | None = None) -> frozenset[int]:
        """Return all objects on all cards; `busy_s`: see `call`."""
        answer = self.call(
            Op.GET_OBJECT_HANDLES,
            ALL_STORES,
            0,
            0,
            doing="listing what is on its card",
            busy_s=busy_s,
        )
        return frozenset(Reader(answer.data, "list of objects").array(4))

    def object_info(self, handle: int) -> ObjectInfo:
        """Return what an object is."""
        answer = self.call(Op.GET_OBJECT_INFO, handle, doing="asking about a picture")
        return ObjectInfo.parse(answer.data)

    def object(self, handle: int, size: int, *, busy_s: float | None = None) -> bytes:
        """Return an object of `size` bytes, which may be `UNKNOWN_SIZE`.

        `busy_s`: see `call`.

        Raises:
            CameraProtocolError: another number of bytes came, three times
        """
        for _ in range(_TRIES):
            answer = self.call(
                Op.GET_OBJECT,
                handle,
                doing="fetching a picture",
                limit=min(size, _MOST_OBJECT_BYTES),
                busy_s=busy_s,
            )
            if len(answer.data) == size or size == UNKNOWN_SIZE:
                return answer.data
        raise CameraProtocolError(
            f"{self._who} sent {len(answer.data)} of {size} bytes of a picture",
            hint="it is still on the card: copy it from there, or resume",
        )

    def delete(self, handle: int) -> None:
        """Delete an object."""
        self.call(Op.DELETE_OBJECT, handle, doing="deleting a picture", repeatable=False)

    def stores(self) -> tuple[StorageInfo, ...]:
        """Return the cards that are in."""
        answer = self.call(Op.GET_STORAGE_IDS, doing="looking for its card")
        # The lower half of an identifier is 0 where a slot is empty.
        ids = [i for i in Reader(answer.data, "list of cards").array(4) if i & 0xFFFF]
        return tuple(
            StorageInfo.parse(
                self.call(Op.GET_STORAGE_INFO, number, doing="looking at its card").data
            )
            for number in ids
        )

    def description(self, code: int) -> PropertyDescription:
        """Return what a property is and can be."""
        answer = self.call(
            Op.GET_PROPERTY_DESCRIPTION, code, doing=f"asking about property {code:04X}"
        )
        return PropertyDescription.parse(answer.data)
