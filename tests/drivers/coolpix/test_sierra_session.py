"""The Sierra protocol with a small model of a camera, in virtual time."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any, TypeVar, cast

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from camctl.clock import VirtualClock
from camctl.errors import CameraError, CameraProtocolError, CameraTimeoutError, UsageError
from drivers.common.serial_link import SerialLink
from drivers.coolpix.sierra.packets import (
    Action,
    RefusedCommandError,
    Register,
    SessionOverError,
    checksum,
    command_packet,
    receive,
)
from drivers.coolpix.sierra.session import Sierra

ACK, NAK, ENQ, DC1, END = b"\x06", b"\x15", b"\x05", b"\x11", b"\xff"
CODES = {1: 9600, 2: 19200, 3: 38400, 4: 57600, 5: 115200}


Act = TypeVar("Act")


class Line:
    """A line in virtual time, in place of a `SerialLink`: silence passes at once."""

    url = "test://"
    has_speed = True

    def __init__(self, camera: Camera, clock: VirtualClock) -> None:
        self.camera, self.clock, self.speed = camera, clock, 19200
        self.buffer = bytearray()
        self.read_bytes = 0

    def write(self, data: bytes) -> None:
        self.buffer += self.camera.receive(data, self.speed)

    def read(self, count: int, silence_s: float) -> bytes:
        data = bytes(self.buffer[:count])
        del self.buffer[:count]
        self.read_bytes += len(data)
        if len(data) < count:
            self.clock.sleep_until(self.clock.now() + silence_s)
            self.camera.forget_incomplete()
        return data

    def read_waiting(self, limit: int) -> bytes:
        data = bytes(self.buffer[:limit])
        del self.buffer[:limit]
        return data


class Camera:
    """A camera of the protocol with integer registers and registers of data.

    Tests replace the methods `receive`, `command`, `packets` and `transmit`.
    """

    def __init__(self, speeds: Sequence[int] = (1, 2, 3, 4, 5)) -> None:
        self.speed, self.in_session = 19200, False
        self.numbers = {1: 0x13, 3: 0, 4: 0, 5: 0, 10: 0}
        self.data = {27: b"COOLPIX990\0"}
        self.speeds = speeds
        self.taken = 0
        self.outgoing: list[bytes] = []
        self.incoming = bytearray()
        self.commands: list[tuple[int, bytes]] = []
        self.receive: Callable[[bytes, int], bytes] = self._receive
        self.command: Callable[[int, bytes, bytes], bytes] = self._command
        self.packets: Callable[[bytes], bytes] = self._packets
        self.transmit: Callable[[bytes], bytes] = lambda answer: answer

    def forget_incomplete(self) -> None:
        self.incoming.clear()

    def restart(self) -> None:
        self.speed, self.in_session, self.outgoing = 19200, False, []

    def _receive(self, data: bytes, speed: int) -> bytes:
        if speed != self.speed:
            return b""
        self.incoming += data
        answer = b""
        while self.incoming:
            kind = self.incoming[0]
            if kind == 0x1B:
                if len(self.incoming) < 4:
                    break
                length = struct.unpack_from("<H", self.incoming, 2)[0]
                if len(self.incoming) < length + 6:
                    break
                packet = bytes(self.incoming[: length + 6])
                del self.incoming[: length + 6]
                answer += self.command(packet[1], packet[4:-2], packet[-2:])
                continue
            del self.incoming[0]
            if kind == 0x00 and not self.in_session:
                self.in_session = True
                answer += NAK
            elif kind == 0x06 and self.outgoing:
                self.outgoing.pop(0)
                answer += self.outgoing[0] if self.outgoing else b""
            elif kind == 0x15 and self.outgoing:
                answer += self.outgoing[0]
        return self.transmit(answer)

    def _command(self, subtype: int, payload: bytes, tail: bytes) -> bytes:
        if not self.in_session or int.from_bytes(tail, "little") != sum(payload):
            return NAK
        self.commands.append((subtype, payload))
        what, where = payload[0], payload[1]
        self.outgoing = []
        if what == 0:
            value = int.from_bytes(payload[2:], "little")
            if where == 17:
                if value not in self.speeds:
                    return DC1
                self.speed = CODES[value]
            elif where not in self.numbers:
                return DC1
            else:
                self.numbers[where] = value
            return ACK
        if what == 1 and where in self.numbers:
            return self.packets(struct.pack("<I", self.numbers[where]))
        if what == 4 and where in self.data:
            return self.packets(self.data[where])
        if what == 2 and where == 2:
            self.taken += 1
            return ACK + ENQ
        if what == 2 and where == 4:
            self.restart()
            return ACK
        return DC1

    def _packets(self, data: bytes) -> bytes:
        parts = [data[at : at + 2048] for at in range(0, len(data), 2048)] or [b""]
        for number, part in enumerate(parts):
            kind = 3 if number == len(parts) - 1 else 2
            head = struct.pack("<BBH", kind, number % 256, len(part))
            self.outgoing.append(head + part + struct.pack("<H", sum(part) & 0xFFFF))
        return self.outgoing[0]


def line_to(camera: Camera) -> tuple[Line, SerialLink, VirtualClock]:
    """Return a line, the same as the driver takes it, and its clock."""
    clock = VirtualClock()
    line = Line(camera, clock)
    return line, cast(SerialLink, line), clock


def closed_session(camera: Camera, **arguments: Any) -> tuple[Sierra, VirtualClock]:
    _, link, clock = line_to(camera)
    return Sierra(link, clock, **arguments), clock


def session(camera: Camera, **arguments: Any) -> tuple[Sierra, VirtualClock]:
    sierra, clock = closed_session(camera, **arguments)
    sierra.open()
    return sierra, clock


def line_of(sierra: Sierra) -> Line:
    return cast(Line, sierra.link)


def first_time(condition: Callable[[bytes], bool]) -> Callable[[bytes], bool]:
    """Return a condition that holds once: at the first argument that meets `condition`."""
    left = [True]

    def holds(answer: bytes) -> bool:
        return condition(answer) and bool(left) and left.pop()

    return holds


def is_second_packet(answer: bytes) -> bool:
    return answer[:2] == b"\x02\x01"


PICTURE = bytes(range(256)) * 20


class TestPackets:
    def test_a_command_as_in_the_description_of_the_protocol(self) -> None:
        assert command_packet(b"\x00\x11\x05\0\0\0", first=True).hex(" ") == (
            "1b 53 06 00 00 11 05 00 00 00 16 00"
        )

    def test_a_sum_has_16_bits(self) -> None:
        assert checksum(b"\xff" * 258) == 258 * 255 - 65536

    @given(st.binary(max_size=5000))
    @example(b"\x02\x00\xff\xff" + bytes(5000))
    @example(b"\x03\x00\x04\x00abcd\xff\xff")
    def test_arbitrary_bytes_are_packets_or_damaged(self, stream: bytes) -> None:
        line, link, _ = line_to(Camera())
        line.buffer += stream
        for _ in range(len(stream) + 1):
            reply = receive(link, 1.0)
            if reply is None:
                break
            assert reply.kind is None or len(reply.data) <= 2048
        assert not line.buffer
        assert line.read_bytes == len(stream)


class TestSessions:
    def test_the_highest_speed_is_used(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 115200

    def test_only_the_first_command_of_a_session_is_marked(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        sierra.get(Register.PICTURES)
        assert [subtype for subtype, _ in camera.commands] == [0x53, 0x43, 0x43]

    @pytest.mark.parametrize("speed", [9600, 19200, 57600])
    def test_the_requested_speed_is_used(self, speed: int) -> None:
        camera = Camera()
        sierra, _ = session(camera, speed=speed)
        assert sierra.link.speed == camera.speed == speed

    def test_a_refused_speed_is_replaced_by_a_lower_one(self) -> None:
        camera = Camera(speeds=(1, 2, 3))
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 38400

    def test_a_camera_that_refuses_all_speeds_stays_at_the_first(self) -> None:
        camera = Camera(speeds=())
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 19200
        assert sierra.text(Register.MODEL) == "COOLPIX990"

    def test_a_speed_at_which_the_line_fails_is_replaced_by_a_lower_one(self) -> None:
        camera = Camera()

        def receive_slow_only(data: bytes, speed: int) -> bytes:
            if speed > 57600:
                camera.restart()  # as after some seconds without a valid packet
                return b""
            return camera._receive(data, speed)

        camera.receive = receive_slow_only
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 57600

    def test_a_camera_in_a_session_at_another_speed_is_found(self) -> None:
        camera = Camera()
        camera.speed, camera.in_session = 57600, True
        sierra, _ = session(camera)
        assert sierra.text(Register.MODEL) == "COOLPIX990"

    def test_an_incomplete_command_of_another_program_does_no_harm(self) -> None:
        camera = Camera()
        camera.in_session = True
        camera.receive(command_packet(b"\x01\x0a")[:5], 19200)
        camera.in_session = False
        sierra, _ = session(camera)
        assert sierra.get(Register.PICTURES) == 0

    def test_a_silent_line_is_given_up_after_the_time_out(self) -> None:
        camera = Camera()
        camera.receive = lambda data, speed: b""
        sierra, clock = closed_session(camera, timeout_s=7.0)
        with pytest.raises(CameraTimeoutError, match=r"not answered for 7 s; check that it is on"):
            sierra.open()
        assert clock.now() <= 7.5

    def test_a_line_that_echoes_is_given_up_after_the_time_out(self) -> None:
        camera = Camera()
        camera.receive = lambda data, speed: data
        sierra, clock = closed_session(camera, timeout_s=10.0)
        with pytest.raises(CameraTimeoutError):
            sierra.open()
        assert clock.now() <= 10.5

    def test_closing_ends_the_session(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        sierra.close()
        assert camera.speed == sierra.link.speed == 19200
        assert not camera.in_session

    def test_a_speed_that_the_protocol_does_not_have(self) -> None:
        with pytest.raises(UsageError, match=r"invalid speed 230400: expected 9600, .*, 115200 "):
            closed_session(Camera(), speed=230400)

    def test_a_camera_that_restarted_gets_a_new_session(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        sierra.set(Register.SHUTTER_US, 1000)
        camera.restart()
        camera.numbers[3] = 0
        assert sierra.get(Register.SHUTTER_US) == 0
        assert sierra.sessions == 2
        assert sierra.link.speed == camera.speed == 115200

    def test_a_session_that_the_camera_has_ended_is_opened_again_at_once(self) -> None:
        camera = Camera()
        sierra, clock = session(camera)
        camera.restart()
        line_of(sierra).buffer += END
        before = clock.now()
        assert sierra.get(Register.PICTURES) == 0
        assert clock.now() - before < 1.0

    def test_a_new_session_selects_the_picture_again(self) -> None:
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        selected = []
        fails = first_time(is_second_packet)

        def transmit(answer: bytes) -> bytes:
            if fails(answer):
                camera.restart()
                camera.numbers[4] = 0
                return b""
            if answer[:2] == b"\x02\x00":
                selected.append(camera.numbers[4])
            return answer

        camera.transmit = transmit
        assert sierra.read(Register.PICTURE_DATA, 1 << 20, picture=7) == PICTURE
        assert selected == [7, 7]


class TestCommands:
    def test_integers_and_text(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        sierra.set(Register.SHUTTER_US, 8_000_000)
        assert sierra.get(Register.SHUTTER_US) == 8_000_000
        assert sierra.text(Register.MODEL) == "COOLPIX990"

    def test_a_long_register_is_complete_and_its_progress_reported(self) -> None:
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        reports: list[int] = []
        assert sierra.read(Register.PICTURE_DATA, 1 << 20, progress=reports.append) == PICTURE
        assert reports == [2048, 4096, 5120]

    def test_sequence_numbers_of_more_than_256_packets_wrap_around(self) -> None:
        camera = Camera()
        camera.data[14] = bytes(2048 * 300)
        sierra, _ = session(camera)
        assert len(sierra.read(Register.PICTURE_DATA, 1 << 20)) == 2048 * 300

    def test_a_refused_register_has_its_own_error(self) -> None:
        sierra, _ = session(Camera())
        with pytest.raises(RefusedCommandError):
            sierra.get(Register.BATTERY_PERCENT)

    @pytest.mark.parametrize("count", [1, 3, 5])
    def test_a_command_answered_with_nak_is_repeated(self, count: int) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        left = iter(range(count))

        def command(subtype: int, payload: bytes, tail: bytes) -> bytes:
            if next(left, None) is not None:
                return NAK
            return camera._command(subtype, payload, tail)

        camera.command = command
        sierra.set(Register.SHUTTER_US, 4000)
        assert camera.numbers[3] == 4000

    def test_a_command_always_answered_with_nak_is_an_error(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        camera.command = lambda subtype, payload, tail: NAK
        with pytest.raises(CameraProtocolError, match="it does not acknowledge commands"):
            sierra.set(Register.SHUTTER_US, 4000)

    def test_one_action_takes_one_picture(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        sierra.act(Action.TAKE_PICTURE)
        assert camera.taken == 1

    @pytest.mark.parametrize(
        ("answer", "kind"),
        [(b"", CameraTimeoutError), (ACK, CameraTimeoutError), (END, SessionOverError)],
        ids=["silence", "ACK", "end of session"],
    )
    def test_an_action_whose_answer_is_lost_is_not_repeated(
        self, answer: bytes, kind: type[CameraError]
    ) -> None:
        camera = Camera()
        sierra, clock = session(camera, timeout_s=10.0)
        camera.transmit = lambda _: answer
        before = clock.now()
        with pytest.raises(kind):
            sierra.act(Action.TAKE_PICTURE, wait_s=4.0)
        assert camera.taken == 1
        assert clock.now() - before <= 14.5

    def test_an_action_refused_after_its_acknowledgement_is_refused(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        camera.transmit = lambda _: ACK + DC1
        with pytest.raises(RefusedCommandError):
            sierra.act(Action.TAKE_PICTURE)

    @pytest.mark.parametrize("at", [0, 2, 3, 4, 100, 2051, 2052])
    def test_a_damaged_packet_is_requested_again(self, at: int) -> None:
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        fails = first_time(is_second_packet)

        def transmit(answer: bytes) -> bytes:
            if fails(answer):
                return answer[:at] + bytes((answer[at] ^ 0x40,)) + answer[at + 1 :]
            return answer

        camera.transmit = transmit
        assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE

    @pytest.mark.parametrize("kept", [0, 1, 3, 4, 500, 2053])
    def test_an_incomplete_packet_is_requested_again(self, kept: int) -> None:
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        fails = first_time(is_second_packet)
        camera.transmit = lambda answer: answer[:kept] if fails(answer) else answer
        assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE

    def test_a_packet_that_comes_twice_counts_once(self, monkeypatch: pytest.MonkeyPatch) -> None:
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        line = line_of(sierra)
        write = line.write
        is_lost = first_time(lambda data: data == ACK and bool(camera.outgoing))

        def lose_an_acknowledgement(data: bytes) -> None:
            if not is_lost(data):
                write(data)

        monkeypatch.setattr(line, "write", lose_an_acknowledgement)
        assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE

    def test_a_missing_packet_is_an_error(self) -> None:
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)

        def leave_one_out(data: bytes) -> bytes:
            camera._packets(data)
            if len(camera.outgoing) > 2:
                del camera.outgoing[1]
            return camera.outgoing[0]

        camera.packets = leave_one_out
        with pytest.raises(CameraProtocolError, match="packet 2 came instead of 1"):
            sierra.read(Register.PICTURE_DATA, 1 << 20)

    def test_more_data_than_allowed_is_an_error(self) -> None:
        camera = Camera()
        camera.data[14] = bytes(1 << 20)
        sierra, _ = session(camera)
        with pytest.raises(CameraProtocolError, match="more than 5000 bytes"):
            sierra.read(Register.PICTURE_DATA, 5000)
        assert line_of(sierra).read_bytes < 20_000


Damage = tuple[str, bytes]


@st.composite
def damages(draw: st.DrawFn) -> list[Damage]:
    """What a bad line does to one answer after another."""
    kinds = st.sampled_from(["keep", "drop", "cut", "flip", "twice", "noise", "before", "after"])
    return draw(st.lists(st.tuples(kinds, st.binary(min_size=1, max_size=40)), max_size=12))


def damaging(steps: Sequence[Damage]) -> Callable[[bytes], bytes]:
    """Return a `Camera.transmit` that does these damages in turn, and then none."""
    left = iter(steps)

    def transmit(answer: bytes) -> bytes:
        kind, noise = next(left, ("keep", b""))
        if not answer or kind == "keep":
            return answer
        at = noise[0] % len(answer)
        return {
            "drop": b"",
            "cut": answer[:at],
            "flip": answer[:at] + bytes((answer[at] ^ (noise[0] | 1),)) + answer[at + 1 :],
            "twice": answer * 2,
            "noise": noise,
            "before": noise + answer,
            "after": answer + noise,
        }[kind]

    return transmit


def outcome(act: Callable[[], Act]) -> tuple[Act | None, CameraError | None]:
    """Return what `act` returns, or its typed error, which is one line."""
    try:
        return act(), None
    except CameraError as error:
        caught = error
    assert "\n" not in str(caught)
    return None, caught


class TestBadLines:
    @settings(max_examples=300)
    @given(damages())
    def test_data_is_correct_or_a_typed_error(self, steps: list[Damage]) -> None:
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, clock = session(camera)
        camera.transmit = damaging(steps)
        before = clock.now()
        data, error = outcome(lambda: sierra.read(Register.PICTURE_DATA, len(PICTURE), picture=3))
        assert error is None or error.hint
        assert data is None or len(data) <= len(PICTURE)
        if data is not None and all(kind in ("keep", "drop", "cut", "twice") for kind, _ in steps):
            assert data == PICTURE
        assert clock.now() - before < 200
        assert line_of(sierra).read_bytes < 300_000

    @settings(max_examples=100)
    @given(st.binary(min_size=1, max_size=3000))
    def test_a_device_that_always_answers_the_same_is_given_up(self, answer: bytes) -> None:
        camera = Camera()
        sierra, clock = session(camera)
        camera.receive = lambda data, speed: answer
        before = clock.now()
        acts: list[Callable[[], object]] = [
            lambda: sierra.get(Register.PICTURES),
            lambda: sierra.set(Register.SHUTTER_US, 1),
            lambda: sierra.read(Register.PICTURE_DATA, 1 << 16, picture=1),
            lambda: sierra.act(Action.TAKE_PICTURE),
            sierra.open,
        ]
        for act in acts:
            outcome(act)
        assert clock.now() - before < 300
        assert line_of(sierra).read_bytes < 10_000_000
