"""The Sierra protocol with a virtual CoolPix on a damaged line, in virtual time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from sierra_model import ACK, DC1, END, NUL, PICTURE, Camera, session

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


def check_second_packet(damage: Callable[[bytes], bytes]) -> None:
    """Read a picture whose second packet is damaged once."""
    camera = Camera(PICTURE)
    sierra = session(camera)
    fails = first_time(is_second_packet)
    camera.transmit = lambda answer: damage(answer) if fails(answer) else answer
    assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE


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
        camera = Camera()
        link = camera.link()
        camera.send(stream)
        for _ in range(len(stream) + 1):
            reply = receive(link, 1.0)
            if reply is None:
                break
            assert reply.kind is None or len(reply.data) <= 2048
        assert not link.read_waiting(1)


class TestSessions:
    def test_only_the_first_command_of_a_session_is_marked(self) -> None:
        camera = Camera()
        subtypes: list[int] = []

        def receive(data: bytes) -> None:
            subtypes.extend(data[1:2] if data[:1] == b"\x1b" else b"")
            camera.device.received(data)

        camera.receive = receive
        session(camera).get(Register.PICTURES)
        assert subtypes == [0x53, 0x43, 0x43]

    def test_a_refused_speed_is_replaced_by_a_lower_one(self) -> None:
        camera = Camera(speed_limit=38400)
        assert session(camera).link.speed == camera.device.speed == 38400

    def test_a_camera_that_refuses_all_speeds_stays_at_the_first(self) -> None:
        camera = Camera()
        camera.device.do("no_speed")
        sierra = session(camera)
        assert sierra.link.speed == camera.device.speed == 19200
        assert sierra.text(Register.MODEL) == "E990"

    def test_a_speed_at_which_the_line_fails_is_replaced_by_a_lower_one(self) -> None:
        camera = Camera()

        def receive_slow_only(data: bytes) -> None:
            if (camera.host_speed or 0) > 57600:
                camera.device.do("break")  # as after some seconds without a valid packet
            else:
                camera.device.received(data)

        camera.receive = receive_slow_only
        assert session(camera).link.speed == camera.device.speed == 57600

    def test_a_camera_in_a_session_at_another_speed_is_found(self) -> None:
        camera = Camera(silence_s=3600.0)
        camera.device.received(NUL)
        camera.device.speed = 57600
        assert session(camera).text(Register.MODEL) == "E990"

    def test_an_incomplete_command_of_another_program_does_no_harm(self) -> None:
        camera = Camera()
        camera.device.received(NUL + command_packet(b"\x01\x0a")[:5])
        assert session(camera).get(Register.PICTURES) == 0

    def test_a_silent_line_is_given_up_after_the_time_out(self) -> None:
        camera = Camera()
        camera.device.do("hang")
        with pytest.raises(CameraTimeoutError, match=r"not answered for 7 s; check that it is on"):
            session(camera, timeout_s=7.0)
        assert camera.clock.now() <= 7.5

    def test_a_line_that_echoes_is_given_up_after_the_time_out(self) -> None:
        camera = Camera()
        camera.receive = camera.send
        with pytest.raises(CameraTimeoutError):
            session(camera, timeout_s=10.0)
        assert camera.clock.now() <= 10.5

    def test_a_session_that_the_camera_has_ended_is_opened_again_at_once(self) -> None:
        camera = Camera()
        sierra = session(camera)
        camera.device.do("break")
        camera.send(END)
        before = camera.clock.now()
        assert sierra.get(Register.PICTURES) == 0
        assert camera.clock.now() - before < 1.0

    def test_a_new_session_selects_the_picture_again(self) -> None:
        camera = Camera(PICTURE, PICTURE)
        sierra = session(camera)
        selected = []
        fails = first_time(is_second_packet)

        def transmit(answer: bytes) -> bytes:
            if fails(answer):
                camera.device.do("break")
                camera.device.camera.write(Register.PICTURE, 0)
                return b""
            if answer[:2] == b"\x02\x00":
                selected.append(camera.device.camera.read(Register.PICTURE))
            return answer

        camera.transmit = transmit
        assert sierra.read(Register.PICTURE_DATA, 1 << 20, picture=1) == PICTURE
        assert selected == [1, 1]


class TestCommands:
    def test_sequence_numbers_of_more_than_256_packets_wrap_around(self) -> None:
        sierra = session(Camera(bytes(2048 * 300)))
        assert len(sierra.read(Register.PICTURE_DATA, 1 << 20)) == 2048 * 300

    def test_a_refused_register_has_its_own_error(self) -> None:
        with pytest.raises(RefusedCommandError):
            session(Camera()).get(Register.PICTURE_BYTES)

    def test_a_command_always_answered_with_nak_is_an_error(self) -> None:
        camera = Camera()
        sierra = session(camera)
        camera.device.do("nak", count=1000)
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
        sierra = session(camera, timeout_s=10.0)
        answers = iter([answer])
        camera.transmit = lambda _: next(answers, b"")
        before = camera.clock.now()
        with pytest.raises(kind):
            sierra.act(Action.TAKE_PICTURE, wait_s=4.0)
        assert camera.clock.now() - before <= 14.5
        camera.device.body.wait()
        assert len(camera.device.camera.pictures) == 1

    def test_an_action_refused_after_its_acknowledgement_is_refused(self) -> None:
        camera = Camera()
        sierra = session(camera)
        camera.transmit = lambda _: ACK + DC1
        with pytest.raises(RefusedCommandError):
            sierra.act(Action.TAKE_PICTURE)

    @pytest.mark.parametrize("at", [0, 2, 3, 4, 100, 2051, 2052])
    def test_a_damaged_packet_is_requested_again(self, at: int) -> None:
        check_second_packet(
            lambda answer: answer[:at] + bytes((answer[at] ^ 0x40,)) + answer[at + 1 :]
        )

    @pytest.mark.parametrize("kept", [0, 1, 3, 4, 500, 2053])
    def test_an_incomplete_packet_is_requested_again(self, kept: int) -> None:
        check_second_packet(lambda answer: answer[:kept])

    def test_a_packet_that_comes_twice_counts_once(self) -> None:
        camera = Camera(PICTURE)
        sierra = session(camera)
        is_lost = first_time(lambda data: data == ACK and bool(camera.device._outgoing))

        def lose_an_acknowledgement(data: bytes) -> None:
            if not is_lost(data):
                camera.device.received(data)

        camera.receive = lose_an_acknowledgement
        assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE

    def test_a_missing_packet_is_an_error(self) -> None:
        camera = Camera(PICTURE)
        sierra = session(camera)

        def leave_one_out(answer: bytes) -> bytes:
            if answer[:2] == b"\x02\x00":
                del camera.device._outgoing[1]
            return answer

        camera.transmit = leave_one_out
        with pytest.raises(CameraProtocolError, match="packet 2 came instead of 1"):
            sierra.read(Register.PICTURE_DATA, 1 << 20)

    def test_more_data_than_allowed_is_an_error(self) -> None:
        camera = Camera(bytes(1 << 20))
        sierra = session(camera)
        with pytest.raises(CameraProtocolError, match="more than 5000 bytes"):
            sierra.read(Register.PICTURE_DATA, 5000)
        assert camera.sent < 20_000
