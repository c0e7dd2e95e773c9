"""A session with a still camera that speaks the Sierra protocol, from the host's side."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TypeVar

from camctl.clock import Clock, RealClock
from camctl.errors import CameraProtocolError, CameraTimeoutError, UsageError
from drivers.common.serial_link import SerialLink
from drivers.coolpix.sierra.commands import BAD_ANSWERS, SILENCES, Commands
from drivers.coolpix.sierra.packets import (
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
        self._clock = clock or RealClock()
        self._commands = Commands(link, timeout_s, self._clock)
        self._wanted = speed

    # ---- what a camera driver uses

    def open(self) -> None:
        """Begin a session, at the highest speed up to the wanted one that works.

        Raises:
            CameraTimeoutError: nobody answers
            CameraDisconnectedError: the line has gone
        """
        self._commands.is_patient_again()
        self._begin()

    def reopen(self, link: SerialLink) -> None:
        """Go on over another line; raises as `open`."""
        self.link = self._commands.link = link
        self.open()

    def hears(self) -> bool:
        """Say whether a camera answers one NUL at 19,200 baud; it is in session then.

        Raises:
            CameraDisconnectedError: the line has gone
        """
        self._commands.is_patient_again()
        self.link.write(bytes((NUL,)))
        self._commands.begins()
        return self._is_answered_with_nak()

    def get(self, register: Register, *, picture: int | None = None) -> int:
        """Return an integer register, of the picture of that number where one is given.

        Raises:
            RefusedCommandError: the camera has no such register, or cannot read it now
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        data = self._of_picture(picture, bytes((GET_INTEGER, register)), 4)
        if len(data) != 4:
            raise self._commands.nonsense(f"register {register} has {len(data)} bytes instead of 4")
        return int.from_bytes(data, "little")

    def set(self, register: Register, value: int) -> None:
        """Write an integer register; whether the camera took the value only `get` can tell.

        Raises:
            RefusedCommandError: the camera will not
            CameraTimeoutError, CameraDisconnectedError, CameraProtocolError
        """
        self._exchange(lambda: self._commands.order(setting(register, value)))

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
        self._commands.is_patient_again()
        if self._has_ended():
            raise self._commands.over()
        self._commands.act(bytes((ACT, action, 0)), wait_s)

    def close(self) -> None:
        """End the session, so that the camera goes back to 19,200 baud and to its own buttons."""
        self._commands.is_patient_again()
        self.link.write(command_packet(bytes((ACT, Action.END_SESSION, 0))))
        self._commands.receive(_WAKE_S)
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
            for _ in range(SILENCES):
                self.link.waiting(DRAIN_BYTES)
                self.link.write(bytes((NUL,)))
                if self._is_answered_with_nak():
                    self._commands.begins()
                    return
            self.link.speed = other
            self.link.write(command_packet(bytes((ACT, Action.END_SESSION, 0))))
            drain(self.link)

    def _is_answered_with_nak(self) -> bool:
        for _ in range(BAD_ANSWERS):
            came = self.link.read(1, self._commands.patience(_WAKE_S))
            if came == bytes((NAK,)):
                self._commands.is_patient_again()
                return True
            if not came:
                return False
        drain(self.link)
        return False

    def _speed_works(self, speed: int) -> bool:
        try:
            self._commands.order(setting(Register.SPEED, SPEEDS[speed]))
        except CameraProtocolError:
            return False
        self.link.speed = speed
        self._clock.sleep_until(self._clock.now() + _SWITCH_S)
        try:
            self._commands.ask(bytes((GET_INTEGER, Register.PICTURES)), 4, silences=1)
        except RefusedCommandError:
            return True  # it was understood
        except (CameraProtocolError, CameraTimeoutError, SessionOverError):
            self._wake()
            return False
        return True

    def _exchange(self, once: Callable[[], T]) -> T:
        """Return what `once` does, with the session opened again where it has broken off."""
        self._commands.is_patient_again()
        try:
            if self._has_ended():
                raise self._commands.over()
            return once()
        except (SessionOverError, CameraTimeoutError):
            self._begin()
            return once()

    def _has_ended(self) -> bool:
        return SESSION_END in self.link.waiting(DRAIN_BYTES)

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
                self._commands.order(setting(Register.PICTURE, picture))
            return self._commands.ask(payload, limit, progress)

        return self._exchange(once)
