"""The Sierra protocol against a small model of a camera, in virtual time."""

import struct

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from camctl.clock import VirtualClock
from camctl.errors import CameraError, CameraProtocolError, CameraTimeoutError, UsageError
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


class Line:
    """The far end of a line in virtual time: silence passes at once."""

    url = "test://"
    has_speed = True

    def __init__(self, camera, clock):
        self.camera, self.clock, self.speed = camera, clock, 19200
        self.buffer = bytearray()
        self.read_bytes = 0

    def write(self, data):
        self.buffer += self.camera.hear(data, self.speed)

    def read(self, count, silence_s):
        data = bytes(self.buffer[:count])
        del self.buffer[:count]
        self.read_bytes += len(data)
        if len(data) < count:
            self.clock.sleep_until(self.clock.now() + silence_s)
            self.camera.rest(self.clock.now())
        return data

    def waiting(self, limit):
        data = bytes(self.buffer[:limit])
        del self.buffer[:limit]
        return data


class Camera:
    """A camera of the protocol with integer registers and registers of data."""

    def __init__(self, speeds=(1, 2, 3, 4, 5)):
        self.speed, self.in_session = 19200, False
        self.numbers = {1: 0x13, 3: 0, 4: 0, 5: 0, 10: 0}
        self.data = {27: b"COOLPIX990\0"}
        self.speeds = speeds
        self.taken = 0
        self.outgoing = []
        self.heard = bytearray()
        self.spoil = lambda answer: answer
        self.commands = []

    def rest(self, now_s):
        self.heard.clear()

    def restart(self):
        self.speed, self.in_session, self.outgoing = 19200, False, []

    def hear(self, data, speed):
        if speed != self.speed:
            return b""
        self.heard += data
        answer = b""
        while self.heard:
            kind = self.heard[0]
            if kind == 0x1B:
                if len(self.heard) < 4:
                    break
                length = struct.unpack_from("<H", self.heard, 2)[0]
                if len(self.heard) < length + 6:
                    break
                packet = bytes(self.heard[: length + 6])
                del self.heard[: length + 6]
                answer += self.command(packet[1], packet[4:-2], packet[-2:])
                continue
            del self.heard[0]
            if kind == 0x00 and not self.in_session:
                self.in_session = True
                answer += NAK
            elif kind == 0x06 and self.outgoing:
                self.outgoing.pop(0)
                answer += self.outgoing[0] if self.outgoing else b""
            elif kind == 0x15 and self.outgoing:
                answer += self.outgoing[0]
        return self.spoil(answer)

    def command(self, subtype, payload, tail):
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
            return self.send(struct.pack("<I", self.numbers[where]))
        if what == 4 and where in self.data:
            return self.send(self.data[where])
        if what == 2 and where == 2:
            self.taken += 1
            return ACK + ENQ
        if what == 2 and where == 4:
            self.restart()
            return ACK
        return DC1

    def send(self, data):
        parts = [data[at : at + 2048] for at in range(0, len(data), 2048)] or [b""]
        for number, part in enumerate(parts):
            kind = 3 if number == len(parts) - 1 else 2
            head = struct.pack("<BBH", kind, number % 256, len(part))
            self.outgoing.append(head + part + struct.pack("<H", sum(part) & 0xFFFF))
        return self.outgoing[0]


def session(camera, *, opened=True, **arguments):
    clock = VirtualClock()
    sierra = Sierra(Line(camera, clock), clock=clock, **arguments)
    if opened:
        sierra.open()
    return sierra, clock


PICTURE = bytes(range(256)) * 20


class TestPackets:
    def test_a_command_is_as_the_description_has_it(self):
        assert command_packet(b"\x00\x11\x05\0\0\0", first=True).hex(" ") == (
            "1b 53 06 00 00 11 05 00 00 00 16 00"
        )

    def test_sums_have_sixteen_bits(self):
        assert checksum(b"\xff" * 258) == 258 * 255 - 65536

    @given(st.binary(max_size=5000))
    @example(b"\x02\x00\xff\xff" + bytes(5000))
    @example(b"\x03\x00\x04\x00abcd\xff\xff")
    def test_nothing_that_comes_breaks_the_parser(self, stream):
        line = Line(Camera(), VirtualClock())
        line.buffer += stream
        for _ in range(len(stream) + 1):
            reply = receive(line, 1.0)
            if reply is None:
                break
            assert reply.kind is None or len(reply.data) <= 2048
        assert not line.buffer
        assert line.read_bytes == len(stream)


class TestSessions:
    def test_it_uses_the_highest_speed(self):
        camera = Camera()
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 115200

    def test_only_the_first_command_of_a_session_is_marked(self):
        camera = Camera()
        sierra, _ = session(camera)
        sierra.get(Register.PICTURES)
        assert [subtype for subtype, _ in camera.commands] == [0x53, 0x43, 0x43]

    @pytest.mark.parametrize(("wanted", "got"), [(9600, 9600), (19200, 19200), (57600, 57600)])
    def test_it_uses_the_speed_asked_for(self, wanted, got):
        camera = Camera()
        sierra, _ = session(camera, speed=wanted)
        assert sierra.link.speed == camera.speed == got

    def test_a_refused_speed_falls_back(self):
        camera = Camera(speeds=(1, 2, 3))
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 38400

    def test_a_camera_that_refuses_all_speeds_stays_at_the_first(self):
        camera = Camera(speeds=())
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 19200
        assert sierra.text(Register.MODEL) == "COOLPIX990"

    def test_a_speed_that_the_line_does_not_carry_falls_back(self):
        camera = Camera()
        hear = camera.hear

        def noisy(data, speed):
            if speed > 57600:
                camera.restart()  # it gives up after seconds of rubbish
                return b""
            return hear(data, speed)

        camera.hear = noisy
        sierra, _ = session(camera)
        assert sierra.link.speed == camera.speed == 57600

    def test_a_camera_left_in_a_session_at_another_speed_is_found(self):
        camera = Camera()
        camera.speed, camera.in_session = 57600, True
        sierra, _ = session(camera)
        assert sierra.text(Register.MODEL) == "COOLPIX990"

    def test_a_half_sent_command_of_somebody_else_does_no_harm(self):
        camera = Camera()
        camera.in_session = True
        camera.hear(command_packet(b"\x01\x0a")[:5], 19200)
        camera.in_session = False
        sierra, _ = session(camera)
        assert sierra.get(Register.PICTURES) == 0

    def test_a_dead_line_is_given_up_in_the_stated_time(self):
        camera = Camera()
        camera.hear = lambda data, speed: b""
        sierra, clock = session(camera, opened=False, timeout_s=7.0)
        with pytest.raises(CameraTimeoutError, match=r"not answered for 7 s.*; "):
            sierra.open()
        assert clock.now() <= 7.5

    def test_a_line_that_only_echoes_is_no_camera(self):
        camera = Camera()
        camera.hear = lambda data, speed: data
        sierra, clock = session(camera, opened=False, timeout_s=10.0)
        with pytest.raises(CameraTimeoutError):
            sierra.open()
        assert clock.now() <= 10.5

    def test_closing_gives_the_camera_back(self):
        camera = Camera()
        sierra, _ = session(camera)
        sierra.close()
        assert camera.speed == sierra.link.speed == 19200
        assert not camera.in_session

    def test_a_speed_that_the_protocol_does_not_have(self):
        with pytest.raises(UsageError, match="115200"):
            Sierra(Line(Camera(), VirtualClock()), speed=230400)

    def test_power_off_and_on_in_between_opens_a_new_session(self):
        camera = Camera()
        sierra, _ = session(camera)
        sierra.set(Register.SHUTTER_US, 1000)
        camera.restart()
        camera.numbers[3] = 0
        assert sierra.get(Register.SHUTTER_US) == 0
        assert sierra.sessions == 2
        assert sierra.link.speed == camera.speed == 115200

    def test_a_camera_that_ended_the_session_is_woken_without_waiting(self):
        camera = Camera()
        sierra, clock = session(camera)
        camera.restart()
        sierra.link.buffer += END
        before = clock.now()
        assert sierra.get(Register.PICTURES) == 0
        assert clock.now() - before < 1.0

    def test_a_new_session_chooses_the_picture_again(self):
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        chosen = []
        spoilt = iter([True])

        def spoil(answer):
            if answer[:2] == b"\x02\x01" and next(spoilt, False):
                camera.restart()
                camera.numbers[4] = 0
                return b""
            if answer[:2] == b"\x02\x00":
                chosen.append(camera.numbers[4])
            return answer

        camera.spoil = spoil
        assert sierra.read(Register.PICTURE_DATA, 1 << 20, picture=7) == PICTURE
        assert chosen == [7, 7]


class TestCommands:
    def test_integers_and_words(self):
        camera = Camera()
        sierra, _ = session(camera)
        sierra.set(Register.SHUTTER_US, 8_000_000)
        assert sierra.get(Register.SHUTTER_US) == 8_000_000
        assert sierra.text(Register.MODEL) == "COOLPIX990"

    def test_a_long_register_comes_whole_and_is_told_of(self):
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        told = []
        assert sierra.read(Register.PICTURE_DATA, 1 << 20, progress=told.append) == PICTURE
        assert told == [2048, 4096, 5120]

    def test_more_than_256_packets_are_counted_round(self):
        camera = Camera()
        camera.data[14] = bytes(2048 * 300)
        sierra, _ = session(camera)
        assert len(sierra.read(Register.PICTURE_DATA, 1 << 20)) == 2048 * 300

    def test_a_refused_register_is_its_own_error(self):
        sierra, _ = session(Camera())
        with pytest.raises(RefusedCommandError):
            sierra.get(Register.BATTERY_PERCENT)

    @pytest.mark.parametrize("count", [1, 3, 5])
    def test_naks_are_answered_by_sending_again(self, count):
        camera = Camera()
        sierra, _ = session(camera)
        left = iter(range(count))
        command = camera.command
        camera.command = lambda *words: NAK if next(left, None) is not None else command(*words)
        sierra.set(Register.SHUTTER_US, 4000)
        assert camera.numbers[3] == 4000

    def test_naks_without_end_are_given_up(self):
        camera = Camera()
        sierra, _ = session(camera)
        camera.command = lambda *words: NAK
        with pytest.raises(CameraProtocolError):
            sierra.set(Register.SHUTTER_US, 4000)

    def test_a_picture_is_taken_once(self):
        camera = Camera()
        sierra, _ = session(camera)
        sierra.act(Action.TAKE_PICTURE)
        assert camera.taken == 1

    @pytest.mark.parametrize(
        ("answer", "error"),
        [(b"", CameraTimeoutError), (ACK, CameraTimeoutError), (END, SessionOverError)],
    )
    def test_a_picture_is_not_taken_twice_where_the_answer_is_lost(self, answer, error):
        camera = Camera()
        sierra, clock = session(camera, timeout_s=10.0)
        camera.spoil = lambda _: answer
        before = clock.now()
        with pytest.raises(error):
            sierra.act(Action.TAKE_PICTURE, wait_s=4.0)
        assert camera.taken == 1
        assert clock.now() - before <= 14.5

    def test_an_action_that_fails_after_it_was_taken_up_is_refused(self):
        camera = Camera()
        sierra, _ = session(camera)
        camera.spoil = lambda _: ACK + DC1
        with pytest.raises(RefusedCommandError):
            sierra.act(Action.TAKE_PICTURE)

    @pytest.mark.parametrize("at", [0, 2, 3, 4, 100, 2051, 2052])
    def test_a_damaged_packet_is_asked_for_again(self, at):
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        spoilt = iter([True])

        def spoil(answer):
            if answer[:2] == b"\x02\x01" and next(spoilt, False):
                return answer[:at] + bytes((answer[at] ^ 0x40,)) + answer[at + 1 :]
            return answer

        camera.spoil = spoil
        assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE

    @pytest.mark.parametrize("keep", [0, 1, 3, 4, 500, 2053])
    def test_a_packet_cut_short_is_asked_for_again(self, keep):
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        spoilt = iter([True])
        camera.spoil = lambda answer: (
            answer[:keep] if answer[:2] == b"\x02\x01" and next(spoilt, False) else answer
        )
        assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE

    def test_a_packet_that_comes_twice_counts_once(self):
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        line = sierra.link
        write = line.write

        lost = iter([True])

        def lose_an_acknowledgement(data):
            if data == ACK and camera.outgoing[:1] and next(lost, False):
                return
            write(data)

        line.write = lose_an_acknowledgement
        assert sierra.read(Register.PICTURE_DATA, 1 << 20) == PICTURE

    def test_a_lost_packet_is_not_passed_over(self):
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, _ = session(camera)
        send = camera.send

        def leave_one_out(data):
            send(data)
            if len(camera.outgoing) > 2:
                del camera.outgoing[1]
            return camera.outgoing[0]

        camera.send = leave_one_out
        with pytest.raises(CameraProtocolError, match="packet 2 came instead of 1"):
            sierra.read(Register.PICTURE_DATA, 1 << 20)

    def test_more_than_was_announced_is_refused(self):
        camera = Camera()
        camera.data[14] = bytes(1 << 20)
        sierra, _ = session(camera)
        with pytest.raises(CameraProtocolError, match="more than 5000 bytes"):
            sierra.read(Register.PICTURE_DATA, 5000)
        assert sierra.link.read_bytes < 20_000


@st.composite
def mischief(draw):
    """What a bad line does to one answer after the other, over and over."""
    kinds = st.sampled_from(["keep", "drop", "cut", "flip", "twice", "noise", "before", "after"])
    return draw(st.lists(st.tuples(kinds, st.binary(min_size=1, max_size=40)), max_size=12))


def spoilt_by(steps):
    left = iter(steps)

    def spoil(answer):
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

    return spoil


def outcome(act):
    """Return what `act` returns, and its typed error of one line."""
    try:
        return act(), None
    except CameraError as error:
        text = str(error)
        return (None, error) if "\n" not in text else pytest.fail(text)


class TestBadLines:
    @settings(max_examples=300)
    @given(mischief())
    def test_what_comes_is_right_or_a_typed_error(self, steps):
        camera = Camera()
        camera.data[14] = PICTURE
        sierra, clock = session(camera)
        camera.spoil = spoilt_by(steps)
        before = clock.now()
        data, error = outcome(lambda: sierra.read(Register.PICTURE_DATA, len(PICTURE), picture=3))
        assert error is None or error.hint
        assert data is None or len(data) <= len(PICTURE)
        if data is not None and all(kind in ("keep", "drop", "cut", "twice") for kind, _ in steps):
            assert data == PICTURE
        assert clock.now() - before < 200
        assert sierra.link.read_bytes < 300_000

    @settings(max_examples=100)
    @given(st.binary(min_size=1, max_size=3000))
    def test_a_device_that_always_answers_the_same_ends(self, answer):
        camera = Camera()
        sierra, clock = session(camera)
        camera.hear = lambda data, speed: answer
        before = clock.now()
        for act in (
            lambda: sierra.get(Register.PICTURES),
            lambda: sierra.set(Register.SHUTTER_US, 1),
            lambda: sierra.read(Register.PICTURE_DATA, 1 << 16, picture=1),
            lambda: sierra.act(Action.TAKE_PICTURE),
            sierra.open,
        ):
            outcome(act)
        assert clock.now() - before < 300
        assert sierra.link.read_bytes < 10_000_000
