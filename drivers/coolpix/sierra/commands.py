"""Commands of the Sierra protocol: asking again, within bounds of tries and of silence."""

from __future__ import annotations

from collections.abc import Callable

from camctl.clock import Clock
from camctl.errors import CameraProtocolError, CameraTimeoutError
from drivers.common.serial_link import SerialLink
from drivers.coolpix.sierra.packets import (
    ACK,
    DATA,
    DC1,
    ENQ,
    LAST_DATA,
    NAK,
    NUL,
    SESSION_OVER,
    RefusedCommandError,
    Reply,
    SessionOverError,
    command_packet,
    receive,
)

# Bad answers (NAK, damaged, stray) come at once and may come in bursts; silence costs time.
BAD_ANSWERS = 6
# Half of the patience goes into asking again, the rest is left for opening the session again.
SILENCES = 3
_REPLY_SHARE = 1 / (2 * SILENCES)


class Commands:
    """Sends commands and takes their answers.

    Args:
        link: the line
        timeout_s: seconds without a valid answer after which a call gives up
        clock: what they are counted on
    """

    def __init__(self, link: SerialLink, timeout_s: float, clock: Clock) -> None:
        self.link = link
        self.timeout_s = timeout_s
        self._clock = clock
        self._reply_s = timeout_s * _REPLY_SHARE
        self._heard_s = 0.0
        self._is_first = True

    def is_patient_again(self) -> None:
        """Count silence from now on."""
        self._heard_s = self._clock.now()

    def begins(self) -> None:
        """Mark the next command as the first of a session."""
        self._is_first = True

    def order(self, payload: bytes) -> None:
        """Send a command that is answered with ACK."""
        silences = 0
        self._send(payload)
        for _ in range(BAD_ANSWERS):
            reply = self.receive(self.patience(self._reply_s))
            if reply is None:
                silences += 1
                if silences == SILENCES:
                    raise self.silent()
            else:
                self._raise_if_refused(reply)
                if reply.kind == ACK:
                    return
                if reply.kind in (ENQ, NUL):
                    continue  # a late word on something earlier
            self._send(payload)
        raise self.nonsense("it does not acknowledge what it is sent")

    def ask(
        self,
        payload: bytes,
        limit: int,
        progress: Callable[[int], None] | None = None,
        *,
        silences: int = SILENCES,
    ) -> bytes:
        """Send a command that is answered with data packets; acknowledge and return them."""
        data = bytearray()
        last: bytes | None = None
        expected, bad, silent = 0, 0, 0
        self._send(payload)
        while bad < BAD_ANSWERS:
            reply = self.receive(self.patience(self._reply_s))
            if reply is None:
                silent += 1
                if silent == silences:
                    raise self.silent()
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
                raise self.nonsense(f"packet {reply.sequence} came instead of {expected % 256}")
            if reply.kind == DATA and not reply.data:
                raise self.nonsense("an empty packet that is not the last one")
            data += reply.data
            if len(data) > limit:
                raise self.nonsense(f"more than {limit} bytes")
            self.link.write(bytes((ACK,)))
            if progress is not None:
                progress(len(data))
            if reply.kind == LAST_DATA:
                return bytes(data)
            last, expected, bad, silent = reply.data, expected + 1, 0, 0
        raise self.nonsense("its packets come damaged, again and again")

    def act(self, payload: bytes, wait_s: float) -> None:
        """Send a command that is answered with ACK, and with ENQ within `wait_s` more.

        It is sent again only where the camera says that it did not understand it.
        """
        self._send(payload)
        is_taken = False
        for _ in range(BAD_ANSWERS):
            patience_s = self.timeout_s + wait_s if is_taken else SILENCES * self._reply_s
            reply = self.receive(patience_s)
            if reply is None:
                raise self.silent(patience_s)
            self._raise_if_refused(reply)
            if reply.kind == ENQ or (reply.kind == ACK and is_taken):
                return
            if reply.kind == ACK:
                is_taken = True
            elif reply.kind == NAK and not is_taken:
                self._send(payload)
        raise self.nonsense("it does not say whether it has done what it was told")

    def _send(self, payload: bytes) -> None:
        self.link.write(command_packet(payload, first=self._is_first))

    def _send_again(self, payload: bytes, *, is_answered: bool) -> None:
        """Ask for the last packet again, or for the first one by the whole command."""
        if is_answered:
            self.link.write(bytes((NAK,)))
        else:
            self._send(payload)

    def receive(self, silence_s: float) -> Reply | None:
        """Return the next packet or single byte, None where the line stays silent."""
        reply = receive(self.link, silence_s)
        if reply is not None and reply.kind is not None:
            self._heard_s = self._clock.now()
            if reply.kind != NAK:
                self._is_first = False
        return reply

    def patience(self, wanted_s: float) -> float:
        """Return how long to wait for the next byte."""
        left_s = self._heard_s + self.timeout_s - self._clock.now()
        if left_s <= 0:
            raise self.silent()
        return min(wanted_s, left_s)

    def _raise_if_refused(self, reply: Reply) -> None:
        if reply.kind in SESSION_OVER:
            raise self.over()
        if reply.kind == DC1:
            raise RefusedCommandError(
                f"the camera at {self.link.url} will not do what it is told",
                hint="see what its display says",
            )

    def over(self) -> SessionOverError:
        """Return the error of a session that the camera has ended."""
        return SessionOverError(
            f"the camera at {self.link.url} has ended the session", hint="try again"
        )

    def silent(self, seconds: float | None = None) -> CameraTimeoutError:
        """Return the error of a camera that has not answered, for `timeout_s` if not said."""
        waited_s = self.timeout_s if seconds is None else seconds
        return CameraTimeoutError(
            f"the camera at {self.link.url} has not answered for {waited_s:g} s",
            hint="see that it is on and the cable fits, switch it off and on, then try again",
        )

    def nonsense(self, what: str) -> CameraProtocolError:
        """Return the error of an answer that makes no sense."""
        return CameraProtocolError(
            f"the camera at {self.link.url} answers nonsense: {what}",
            hint="try a lower speed (-O speed=19200) or another cable",
        )
