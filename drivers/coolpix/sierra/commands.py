"""Commands of the Sierra protocol, repeated within limits of attempts and of silence."""

from __future__ import annotations

from camctl.drivers.common.serial_link import SerialLink
from camctl.drivers.coolpix.sierra.packets import (
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
from camctl.errors import CameraProtocolError, CameraTimeoutError
from camctl.interface.clock import Clock

#: Bad answers (NAK, damaged, unexpected) after which a command fails; they come quickly, in bursts.
MAX_BAD_ANSWERS = 6
#: Time-outs after which a command fails.  They take half of the session's time-out; the other half
#: is left for opening the session again.
MAX_SILENCES = 3
_REPLY_SHARE = 1 / (2 * MAX_SILENCES)


class Commands:
    """Sends commands and receives their answers.

    Args:
        link: the line
        timeout_s: time without a valid answer after which a call fails
        clock: measures this time
    """

    def __init__(self, link: SerialLink, timeout_s: float, clock: Clock) -> None:
        self.link = link
        self.timeout_s = timeout_s
        self._clock = clock
        self._reply_s = timeout_s * _REPLY_SHARE
        self._last_answer_s = 0.0
        self._is_first = True

    def restart_timeout(self) -> None:
        """Measure the time without a valid answer from now on."""
        self._last_answer_s = self._clock.now()

    def mark_first(self) -> None:
        """Mark the next command as the first of a session."""
        self._is_first = True

    def send(self, payload: bytes) -> None:
        """Send a command that is answered with ACK."""
        silences = 0
        self._write(payload)
        for _ in range(MAX_BAD_ANSWERS):
            reply = self.receive(self.remaining_s(self._reply_s))
            if reply is None:
                silences += 1
                if silences == MAX_SILENCES:
                    raise self.timeout_error()
            else:
                self._raise_if_refused(reply)
                if reply.kind == ACK:
                    return
                if reply.kind in (ENQ, NUL):
                    continue  # a late answer to an earlier command
            self._write(payload)
        raise self.protocol_error("it does not acknowledge commands")

    def request(
        self,
        payload: bytes,
        limit: int,
        *,
        max_silences: int = MAX_SILENCES,
    ) -> bytes:
        """Send a command that is answered with data packets; acknowledge them, return their data.

        Args:
            payload: of the command
            limit: most bytes that may come
            max_silences: time-outs after which the command fails
        """
        data = bytearray()
        last: bytes | None = None
        expected, bad_answers, silences = 0, 0, 0
        self._write(payload)
        while bad_answers < MAX_BAD_ANSWERS:
            reply = self.receive(self.remaining_s(self._reply_s))
            if reply is None:
                silences += 1
                if silences == max_silences:
                    raise self.timeout_error()
                self._request_again(payload, has_packet=last is not None)
                continue
            self._raise_if_refused(reply)
            if reply.kind not in (DATA, LAST_DATA):
                bad_answers += 1
                if reply.kind is None:
                    self.link.write(bytes((NAK,)))
                elif reply.kind == NAK:
                    self._request_again(payload, has_packet=last is not None)
                continue
            if reply.data == last and reply.sequence == (expected - 1) % 256:
                bad_answers += 1  # our acknowledgement was lost
                self.link.write(bytes((ACK,)))
                continue
            if reply.sequence != expected % 256:
                raise self.protocol_error(
                    f"packet {reply.sequence} came instead of {expected % 256}"
                )
            if reply.kind == DATA and not reply.data:
                raise self.protocol_error("an empty packet that is not the last one")
            data += reply.data
            if len(data) > limit:
                raise self.protocol_error(f"more than {limit} bytes")
            self.link.write(bytes((ACK,)))
            if reply.kind == LAST_DATA:
                return bytes(data)
            last, expected, bad_answers, silences = reply.data, expected + 1, 0, 0
        raise self.protocol_error("damaged packets, repeatedly")

    def perform(self, payload: bytes, wait_s: float) -> None:
        """Send a command that is answered with ACK, and with ENQ after up to `wait_s` more.

        It is repeated only if the camera answers that it did not understand it.
        """
        self._write(payload)
        is_acknowledged = False
        for _ in range(MAX_BAD_ANSWERS):
            silence_s = self.timeout_s + wait_s if is_acknowledged else MAX_SILENCES * self._reply_s
            reply = self.receive(silence_s)
            if reply is None:
                raise self.timeout_error(silence_s)
            self._raise_if_refused(reply)
            if reply.kind == ENQ or (reply.kind == ACK and is_acknowledged):
                return
            if reply.kind == ACK:
                is_acknowledged = True
            elif reply.kind == NAK and not is_acknowledged:
                self._write(payload)
        raise self.protocol_error("it does not report the end of an action")

    def receive(self, silence_s: float) -> Reply | None:
        """Return the next packet or single byte; None if nothing comes for `silence_s`."""
        reply = receive(self.link, silence_s)
        if reply is not None and reply.kind is not None:
            self._last_answer_s = self._clock.now()
            if reply.kind != NAK:
                self._is_first = False
        return reply

    def remaining_s(self, wanted_s: float) -> float:
        """Return how long to wait for the next byte: `wanted_s`, or less before the time-out.

        Raises:
            CameraTimeoutError: the time-out is over
        """
        left_s = self._last_answer_s + self.timeout_s - self._clock.now()
        if left_s <= 0:
            raise self.timeout_error()
        return min(wanted_s, left_s)

    def _write(self, payload: bytes) -> None:
        self.link.write(command_packet(payload, first=self._is_first))

    def _request_again(self, payload: bytes, *, has_packet: bool) -> None:
        """Ask for the last packet again, or for the first one with the whole command."""
        if has_packet:
            self.link.write(bytes((NAK,)))
        else:
            self._write(payload)

    def _raise_if_refused(self, reply: Reply) -> None:
        if reply.kind in SESSION_OVER:
            raise self.session_over_error()
        if reply.kind == DC1:
            raise RefusedCommandError(
                f"the camera at {self.link.url} refused a command", hint="look at its display"
            )

    # ---- errors

    def session_over_error(self) -> SessionOverError:
        """Return the error of a session that the camera has ended."""
        return SessionOverError(
            f"the camera at {self.link.url} has ended the session", hint="try again"
        )

    def timeout_error(self, seconds: float | None = None) -> CameraTimeoutError:
        """Return the error of a camera that has not answered for `seconds` (None: `timeout_s`)."""
        waited_s = self.timeout_s if seconds is None else seconds
        return CameraTimeoutError(
            f"the camera at {self.link.url} has not answered for {waited_s:g} s",
            hint="check that it is on and the cable fits, switch it off and on, then try again",
        )

    def protocol_error(self, what: str) -> CameraProtocolError:
        """Return the error of an invalid answer."""
        return CameraProtocolError(
            f"the camera at {self.link.url} sent an invalid answer: {what}",
            hint="try a lower speed or another cable",
            remedies={"option:speed": 19200},
        )
