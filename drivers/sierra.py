"""A session with a still camera that speaks the Sierra protocol, from the host's side."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TypeVar

from camctl.clock import Clock, RealClock
from camctl.errors import CameraProtocolError, CameraTimeoutError, UsageError
from drivers.seriallink import SerialLink
from drivers.sierra_packets import (
    ACK,
    ACT,
    DATA,
    DC1,
    DRAIN_BYTES,
    ENQ,
    FIRST_SPEED,
    GET_DATA,
    GET_INTEGER,
    LAST_DATA,
    MAX_DATA,
    NAK,
    NUL,
    SESSION_END,
    SESSION_OVER,
    SPEEDS,
    Action,
    RefusedCommandError,
    Register,
    Reply,
    SessionOverError,
    command_packet,
    drain,
    receive,
    setting,
)

# Bad answers (NAK, damaged, stray) come at once and may come in bursts; silence costs time.
_BAD_ANSWERS = 6
# Half of the patience goes into asking again, the rest is left for opening the session again.
_SILENCES = 3
_REPLY_SHARE = 1 / (2 * _SILENCES)
_WAKE_S = 0.5
_SWITCH_S = 0.05

T = TypeVar("T")


class Sierra:
    """A session with a camera.

    Whatever the line brings, a call ends: with its result, or with a typed error after a bounded
    number of bad answers or after `timeout_s` seconds without a good one, in which the session has
    been opened again once.

    Args:
        link: the line, whose speed the session sets
        speed: the highest speed to ask for, baud
        timeout_s: seconds without a valid answer after which a call gives up
        clock: what that silence is counted on

    Raises:
        UsageError: the protocol has no such speed
    """

    def __init__(
        self,
        link: SerialLink,
        *,
        speed: int = 115_200,
        timeout_s: float = 12.0,
        clock: Clock | None = None,
    ) -> None:
        if speed not in SPEEDS:
            raise UsageError(
                f"a speed of {speed} baud",
                hint=f"the camera knows {', '.join(map(str, SPEEDS))}",
            )
        self.link = link
        self.sessions = 0
        self.timeout_s = timeout_s
        self._clock = clock or RealClock()
        self._reply_s = timeout_s * _REPLY_SHARE
        self._wanted = speed
        self._heard_s = 0.0
        self._is_first = True

    # ---- what a camera driver uses

    def open(self) -> None:
        """Begin a session, at the highest speed up to the wanted one that works.

        Raises:
            CameraTimeoutError: nobody answers
            CameraDisconnectedError: the line has gone
        """
        self._heard_s = self._clock.now()
        self._begin()

    def hears(self) -> bool:
        """Say whether a camera answers one NUL at 19,200 baud; it is in session then.

        Raises:
            CameraDisconnectedError: the line has gone
        """
        self._heard_s = self._clock.now()
        self.link.write(bytes((NUL,)))
        self._is_first = True
        return self._is_answered_with_nak()

    def get(self, register: Register, *, picture: int | None = None) -> int:
        """Return an integer register, of the picture of that number where one is given.

        Raises:
            RefusedCommandError: the camera has no such register, or cannot read it now
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        data = self._of_picture(picture, bytes((GET_INTEGER, register)), 4)
        if len(data) != 4:
            raise self._nonsense(f"register {register} has {len(data)} bytes instead of 4")
        return int.from_bytes(data, "little")

    def set(self, register: Register, value: int) -> None:
        """Write an integer register; whether the camera took the value only `get` can tell.

        Raises:
            RefusedCommandError: the camera will not
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        self._exchange(lambda: self._order(setting(register, value)))

    def read(
        self,
        register: Register,
        limit: int,
        *,
        picture: int | None = None,
        progress: Callable[[int], None] | None = None,
    ) -> bytes:
        """Return a register of data, of the picture of that number where one is given.

        Args:
            register: which
            limit: bytes from which the answer is nonsense
            picture: number of the picture, from 1
            progress: takes the bytes that have come, after each packet

        Raises:
            RefusedCommandError: the camera has no such register, or cannot read it now
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        return self._of_picture(picture, bytes((GET_DATA, register)), limit, progress)

    def text(self, register: Register, *, picture: int | None = None) -> str:
        """Return a register of data as printable text; raises as `read`."""
        words = self.read(register, MAX_DATA, picture=picture).split(b"\0")[0].decode("latin-1")
        return "".join(letter for letter in words if letter.isprintable()).strip()

    def act(self, action: Action, *, wait_s: float = 0.0) -> None:
        """Let the camera act, and wait until it says that it is done.

        An action whose answer is lost is not repeated: it may have been done.

        Args:
            action: what to do
            wait_s: seconds that it may take, beside `timeout_s`

        Raises:
            RefusedCommandError: the camera will not or could not
            SessionOverError: the camera has ended the session
            CameraTimeoutError, CameraProtocolError: whether it was done is not known
            CameraDisconnectedError: the line has gone
        """
        self._heard_s = self._clock.now()
        if self._has_ended():
            raise self._over()
        payload = bytes((ACT, action, 0))
        self._send(payload)
        is_taken = False
        for _ in range(_BAD_ANSWERS):
            patience_s = self.timeout_s + wait_s if is_taken else _SILENCES * self._reply_s
            reply = self._receive(patience_s)
            if reply is None:
                raise self._silent(patience_s)
            self._raise_if_refused(reply)
            if reply.kind == ENQ or (reply.kind == ACK and is_taken):
                return
            if reply.kind == ACK:
                is_taken = True
            elif reply.kind == NAK and not is_taken:
                self._send(payload)
        raise self._nonsense("it does not say whether it has done what it was told")

    def close(self) -> None:
        """End the session, so that the camera goes back to 19,200 baud and to its own buttons."""
        self._heard_s = self._clock.now()
        self._send(bytes((ACT, Action.END_SESSION, 0)))
        self._receive(_WAKE_S)
        self.link.speed = FIRST_SPEED

    # ---- sessions

    def _begin(self) -> None:
        self._wake()
        wanted = self._wanted if self.link.has_speed else FIRST_SPEED
        faster = [speed for speed in SPEEDS if FIRST_SPEED < speed <= wanted]
        for speed in sorted(faster, reverse=True) or [wanted]:
            if speed == FIRST_SPEED or self._speed_works(speed):
                break
        self.sessions += 1

    def _wake(self) -> None:
        """Bring the camera to the beginning of a session, whatever it was about.

        One that is still in a session of somebody else listens at another speed, and returns to
        19,200 baud when that session is ended or has been silent for seconds.
        """
        for other in itertools.cycle(sorted(SPEEDS, reverse=True)):
            self.link.speed = FIRST_SPEED
            for _ in range(_SILENCES):
                self.link.waiting(DRAIN_BYTES)
                self.link.write(bytes((NUL,)))
                if self._is_answered_with_nak():
                    self._is_first = True
                    return
            self.link.speed = other
            self.link.write(command_packet(bytes((ACT, Action.END_SESSION, 0))))
            drain(self.link)

    def _is_answered_with_nak(self) -> bool:
        for _ in range(_BAD_ANSWERS):
            came = self.link.read(1, self._patience(_WAKE_S))
            if came == bytes((NAK,)):
                self._heard_s = self._clock.now()
                return True
            if not came:
                return False
        drain(self.link)
        return False

    def _speed_works(self, speed: int) -> bool:
        try:
            self._order(setting(Register.SPEED, SPEEDS[speed]))
        except CameraProtocolError:
            return False
        self.link.speed = speed
        self._clock.sleep_until(self._clock.now() + _SWITCH_S)
        try:
            self._ask(bytes((GET_INTEGER, Register.PICTURES)), 4, silences=1)
        except RefusedCommandError:
            return True  # it was understood
        except (CameraProtocolError, CameraTimeoutError, SessionOverError):
            self._wake()
            return False
        return True

    def _exchange(self, once: Callable[[], T]) -> T:
        """Return what `once` does, with the session opened again where it has broken off."""
        self._heard_s = self._clock.now()
        try:
            if self._has_ended():
                raise self._over()
            return once()
        except (SessionOverError, CameraTimeoutError):
            self._begin()
            return once()

    def _has_ended(self) -> bool:
        return SESSION_END in self.link.waiting(DRAIN_BYTES)

    # ---- commands

    def _of_picture(
        self,
        picture: int | None,
        payload: bytes,
        limit: int,
        progress: Callable[[int], None] | None = None,
    ) -> bytes:
        # A new session has forgotten which picture was chosen: choosing belongs to each attempt.
        def once() -> bytes:
            if picture is not None:
                self._order(setting(Register.PICTURE, picture))
            return self._ask(payload, limit, progress)

        return self._exchange(once)

    def _order(self, payload: bytes) -> None:
        """Send a command that is answered with ACK."""
        silences = 0
        self._send(payload)
        for _ in range(_BAD_ANSWERS):
            reply = self._receive(self._patience(self._reply_s))
            if reply is None:
                silences += 1
                if silences == _SILENCES:
                    raise self._silent()
            else:
                self._raise_if_refused(reply)
                if reply.kind == ACK:
                    return
                if reply.kind in (ENQ, NUL):
                    continue  # a late word on something earlier
            self._send(payload)
        raise self._nonsense("it does not acknowledge what it is sent")

    def _ask(
        self,
        payload: bytes,
        limit: int,
        progress: Callable[[int], None] | None = None,
        *,
        silences: int = _SILENCES,
    ) -> bytes:
        """Send a command that is answered with data packets; acknowledge and return them."""
        data = bytearray()
        last: bytes | None = None
        expected, bad, silent = 0, 0, 0
        self._send(payload)
        while bad < _BAD_ANSWERS:
            reply = self._receive(self._patience(self._reply_s))
            if reply is None:
                silent += 1
                if silent == silences:
                    raise self._silent()
                self._send_again(payload, is_answered=last is not None)
                continue
            self._raise_if_refused(reply)
            if reply.kind not in (DATA, LAST_DATA):
                bad += 1
                if reply.kind is None:
                    self.link.write(bytes((NAK,)))
                elif reply.kind == NAK:
                    self._send_again(payload, is_answered=last is not None)
                continue
            if reply.data == last and reply.sequence == (expected - 1) % 256:
                bad += 1  # our acknowledgement was lost
                self.link.write(bytes((ACK,)))
                continue
            if reply.sequence != expected % 256:
                raise self._nonsense(f"packet {reply.sequence} came instead of {expected % 256}")
            if reply.kind == DATA and not reply.data:
                raise self._nonsense("an empty packet that is not the last one")
            data += reply.data
            if len(data) > limit:
                raise self._nonsense(f"more than {limit} bytes")
            self.link.write(bytes((ACK,)))
            if progress is not None:
                progress(len(data))
            if reply.kind == LAST_DATA:
                return bytes(data)
            last, expected, bad, silent = reply.data, expected + 1, 0, 0
        raise self._nonsense("its packets come damaged, again and again")

    def _send(self, payload: bytes) -> None:
        self.link.write(command_packet(payload, first=self._is_first))

    def _send_again(self, payload: bytes, *, is_answered: bool) -> None:
        """Ask for the last packet again, or for the first one by the whole command."""
        if is_answered:
            self.link.write(bytes((NAK,)))
        else:
            self._send(payload)

    # ---- the line

    def _receive(self, silence_s: float) -> Reply | None:
        """Return the next packet or single byte, None where the line stays silent."""
        reply = receive(self.link, silence_s)
        if reply is not None and reply.kind is not None:
            self._heard_s = self._clock.now()
            if reply.kind != NAK:
                self._is_first = False
        return reply

    def _patience(self, wanted_s: float) -> float:
        """Return how long to wait for the next byte."""
        left_s = self._heard_s + self.timeout_s - self._clock.now()
        if left_s <= 0:
            raise self._silent()
        return min(wanted_s, left_s)

    # ---- errors

    def _raise_if_refused(self, reply: Reply) -> None:
        if reply.kind in SESSION_OVER:
            raise self._over()
        if reply.kind == DC1:
            raise RefusedCommandError(
                f"the camera at {self.link.url} will not do what it is told",
                hint="see what its display says",
            )

    def _over(self) -> SessionOverError:
        return SessionOverError(
            f"the camera at {self.link.url} has ended the session", hint="try again"
        )

    def _silent(self, seconds: float | None = None) -> CameraTimeoutError:
        waited_s = self.timeout_s if seconds is None else seconds
        return CameraTimeoutError(
            f"the camera at {self.link.url} has not answered for {waited_s:g} s",
            hint="see that it is on and the cable fits, switch it off and on, then try again",
        )

    def _nonsense(self, what: str) -> CameraProtocolError:
        return CameraProtocolError(
            f"the camera at {self.link.url} answers nonsense: {what}",
            hint="try a lower speed (-O speed=19200) or another cable",
        )
