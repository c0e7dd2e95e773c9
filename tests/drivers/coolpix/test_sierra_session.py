"""The Sierra protocol with a small model of a camera, in virtual time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from sierra_model import (
    ACK,
    DC1,
    END,
    NAK,
    PICTURE,
    Camera,
    closed_session,
    line_of,
    line_to,
    session,
)

from camctl.drivers.coolpix.sierra.packets import (
    Action,
    RefusedCommandError,
    Register,
    SessionOverError,
    checksum,
    command_packet,
    receive,
)
from camctl.errors import CameraError, CameraProtocolError, CameraTimeoutError


def first_time(condition: Callable[[bytes], bool]) -> Callable[[bytes], bool]:
    """Return a condition that holds once: at the first argument that meets `condition`."""
    left = [True]

    def holds(answer: bytes) -> bool:
        return condition(answer) and bool(left) and left.pop()

    return holds


def is_second_packet(answer: bytes) -> bool:
    return answer[:2] == b"\x02\x01"


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
    def test_only_the_first_command_of_a_session_is_marked(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        sierra.get(Register.PICTURES)
        assert [subtype for subtype, _ in camera.commands] == [0x53, 0x43, 0x43]

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
    def test_sequence_numbers_of_more_than_256_packets_wrap_around(self) -> None:
        camera = Camera()
        camera.data[14] = bytes(2048 * 300)
        sierra, _ = session(camera)
        assert len(sierra.read(Register.PICTURE_DATA, 1 << 20)) == 2048 * 300

    def test_a_refused_register_has_its_own_error(self) -> None:
        sierra, _ = session(Camera())
        with pytest.raises(RefusedCommandError):
            sierra.get(Register.BATTERY_PERCENT)

    def test_a_command_always_answered_with_nak_is_an_error(self) -> None:
        camera = Camera()
        sierra, _ = session(camera)
        camera.command = lambda subtype, payload, tail: NAK
        with pytest.raises(CameraProtocolError, match="it does not acknowledge commands"):
            sierra.set(Register.SHUTTER_US, 4000)

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
