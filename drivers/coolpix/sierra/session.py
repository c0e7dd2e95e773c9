"""Sessions with a still camera that speaks the Sierra protocol, host side."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TypeVar

from camctl.drivers.common.serial_link import SerialLink
from camctl.drivers.coolpix.sierra.commands import MAX_BAD_ANSWERS, MAX_SILENCES, Commands
from camctl.drivers.coolpix.sierra.packets import (
    ACT,
    DRAIN_BYTES,
    FIRST_SPEED,
    GET_DATA,
    GET_INTEGER,
    MAX_DATA,
    NAK,
    NUL,
    SESSION_END,
    SPEEDS,
    Action,
    RefusedCommandError,
    Register,
    SessionOverError,
    command_packet,
    drain,
    setting,
)
from camctl.errors import CameraProtocolError, CameraTimeoutError
from camctl.interface.clock import Clock

# How long a camera may take to answer the NUL that starts a session, or the end of one.
_WAKE_S = 0.5
# How long a camera may take to switch to another speed.
_SWITCH_S = 0.05

T = TypeVar("T")


class Sierra(Commands):
    """A session with a camera.

    Each call ends with its result, or after a limited number of bad answers with
    `CameraProtocolError`, after `timeout_s` without a valid one with `CameraTimeoutError`, or with
    `CameraDisconnectedError`; before that, the session is opened again once.

    Args:
        link: the line; the session sets its speed
        clock: measures the time without a valid answer
        speed: the highest speed to use, baud
        timeout_s: time without a valid answer after which a call fails

    Attributes:
        sessions: how often a session was opened
    """

    def __init__(
        self,
        link: SerialLink,
        clock: Clock,
        *,
        speed: int = 115_200,
        timeout_s: float = 12.0,
    ) -> None:
        super().__init__(link, timeout_s, clock)
        self.sessions = 0
        self._highest_speed = speed

    def open(self) -> None:
        """Open a session at the highest speed that works, up to the one requested.

        Raises:
            CameraTimeoutError: no camera answers
            CameraDisconnectedError: the line was disconnected
        """
        self.restart_timeout()
        self._open_session()

    def reopen(self, link: SerialLink) -> None:
        """Open a session over a new line; raises as `open`."""
        self.link = link
        self.open()

    def answers(self) -> bool:
        """Return whether a camera answers one NUL at 19,200 baud, which opens a session."""
        self.restart_timeout()
        self.link.write(bytes((NUL,)))
        self.mark_first()
        return self._receives_nak()

    def get(self, register: Register, *, picture: int | None = None) -> int:
        """Return an integer register, of the picture of that number if one is given.

        Raises:
            RefusedCommandError: the camera has no such register, or cannot read it now
        """
        data = self._of_picture(picture, bytes((GET_INTEGER, register)), 4)
        if len(data) != 4:
            raise self.protocol_error(f"register {register} has {len(data)} bytes instead of 4")
        return int.from_bytes(data, "little")

    def set(self, register: Register, value: int) -> None:
        """Write an integer register; only `get` shows whether the camera accepted the value.

        Raises:
            RefusedCommandError: the camera refused
        """
        self._exchange(lambda: self.send(setting(register, value)))

    def read(self, register: Register, limit: int, *, picture: int | None = None) -> bytes:
        """Return a register of data, of the picture of that number if one is given.

        Args:
            register: the register
            limit: most bytes that may come
            picture: number of the picture, from 1

        Raises:
            RefusedCommandError: the camera has no such register, or cannot read it now
        """
        return self._of_picture(picture, bytes((GET_DATA, register)), limit)

    def text(self, register: Register, *, picture: int | None = None) -> str:
        """Return a register of data as printable text; raises as `read`."""
        text = self.read(register, MAX_DATA, picture=picture).split(b"\0")[0].decode("latin-1")
        return "".join(letter for letter in text if letter.isprintable()).strip()

    def act(self, action: Action, *, wait_s: float = 0.0) -> None:
        """Start an action, and wait until the camera reports its end.

        An action whose answer is lost is not repeated, since it may have been performed.

        Args:
            action: the action
            wait_s: how long it may take beyond `timeout_s`

        Raises:
            RefusedCommandError: the camera refused, or could not
            SessionOverError: the camera has ended the session
            CameraTimeoutError, CameraProtocolError: it is unknown whether it was performed
            CameraDisconnectedError: the line was disconnected
        """
        self.restart_timeout()
        if self._has_ended():
            raise self.session_over_error()
        self.perform(bytes((ACT, action, 0)), wait_s)

    def close(self) -> None:
        """End the session: the camera returns to 19,200 baud, and its buttons work again."""
        self.restart_timeout()
        self.link.write(command_packet(bytes((ACT, Action.END_SESSION, 0))))
        self.receive(_WAKE_S)
        self.link.speed = FIRST_SPEED

    # ---- sessions

    def _open_session(self) -> None:
        self._wake()
        highest = self._highest_speed if self.link.has_speed else FIRST_SPEED
        faster = [speed for speed in SPEEDS if FIRST_SPEED < speed <= highest]
        for speed in sorted(faster, reverse=True) or [highest]:
            if speed == FIRST_SPEED or self._speed_works(speed):
                break
        self.sessions += 1

    def _wake(self) -> None:
        """Bring the camera to the start of a session.

        A camera that is still in another program's session listens at another speed, and returns
        to 19,200 baud when that session ends or has been silent for some seconds.
        """
        for other in itertools.cycle(sorted(SPEEDS, reverse=True)):
            self.link.speed = FIRST_SPEED
            for _ in range(MAX_SILENCES):
                self.link.read_waiting(DRAIN_BYTES)
                self.link.write(bytes((NUL,)))
                if self._receives_nak():
                    self.mark_first()
                    return
            self.link.speed = other
            self.link.write(command_packet(bytes((ACT, Action.END_SESSION, 0))))
            drain(self.link)

    def _receives_nak(self) -> bool:
        for _ in range(MAX_BAD_ANSWERS):
            answer = self.link.read(1, self.remaining_s(_WAKE_S))
            if answer == bytes((NAK,)):
                self.restart_timeout()
                return True
            if not answer:
                return False
        drain(self.link)
        return False

    def _speed_works(self, speed: int) -> bool:
        try:
            self.send(setting(Register.SPEED, SPEEDS[speed]))
        except CameraProtocolError:
            return False
        self.link.speed = speed
        self._clock.sleep_until(self._clock.now() + _SWITCH_S)
        try:
            self.request(bytes((GET_INTEGER, Register.PICTURES)), 4, max_silences=1)
        except RefusedCommandError:
            return True  # a refusal, too, came at this speed
        except (CameraProtocolError, CameraTimeoutError, SessionOverError):
            self._wake()
            return False
        return True

    def _exchange(self, operation: Callable[[], T]) -> T:
        """Return the result of `operation`, which is retried once in a new session."""
        self.restart_timeout()
        try:
            if self._has_ended():
                raise self.session_over_error()
            return operation()
        except (SessionOverError, CameraTimeoutError):
            self._open_session()
            return operation()

    def _has_ended(self) -> bool:
        return SESSION_END in self.link.read_waiting(DRAIN_BYTES)

    def _of_picture(self, picture: int | None, payload: bytes, limit: int) -> bytes:
        # A new session does not keep the number of the picture, so each attempt sets it.
        def request() -> bytes:
            if picture is not None:
                self.send(setting(Register.PICTURE, picture))
            return self.request(payload, limit)

        return self._exchange(request)
