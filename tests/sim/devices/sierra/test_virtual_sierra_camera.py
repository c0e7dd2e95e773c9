"""The virtual CoolPix 990 as a host sees it at the other end of a serial line."""

import io
import struct
import time
from contextlib import contextmanager

import cv2
import numpy as np
import pytest
import serial
import tifffile

from camctl.errors import CameraNotFoundError, UsageError
from sim.devices.sierra import device as sierra

ACK, NAK, ENQ, INVALID, SESSION = b"\x06", b"\x15", b"\x05", b"\x11", b"\xfc"


class Host:
    """A host for the Sierra protocol as small as can be."""

    def __init__(self, device):
        self.port = serial.Serial(device.line.path, 19200, timeout=3)
        self.first = True

    def nul(self):
        self.port.write(b"\0")
        return self.port.read()

    @staticmethod
    def packet(head, data, wrong=0):
        total = (sum(data) + wrong) & 0xFFFF
        return head + struct.pack("<H", len(data)) + data + struct.pack("<H", total)

    def command(self, *data, head=None):
        """Send a command; return the first byte that comes."""
        head = head or (b"\x1b\x53" if self.first else b"\x1b\x43")
        self.first = False
        self.port.write(self.packet(head, bytes(data)))
        return self.port.read()

    def rest(self, kind):
        """Return (place, data) of the data packet whose first byte was read."""
        place, length = struct.unpack("<BH", self.port.read(3))
        data = self.port.read(length)
        assert int.from_bytes(self.port.read(2), "little") == sum(data) & 0xFFFF
        assert kind in (b"\x02", b"\x03")
        return place, data

    def text(self, register):
        """Return a text register, or None where it is refused."""
        kind = self.command(4, register)
        if kind == INVALID:
            return None
        data, places = b"", []
        while True:
            place, part = self.rest(kind)
            places.append(place)
            data += part
            self.port.write(ACK)
            if kind == b"\x03":
                assert places == [i % 256 for i in range(len(places))]
                return data
            kind = self.port.read()

    def number(self, register):
        kind = self.command(1, register)
        if kind == INVALID:
            return None
        assert kind == b"\x03"
        _, data = self.rest(kind)
        self.port.write(ACK)
        return int.from_bytes(data, "little")

    def set(self, register, value):
        return self.command(0, register, *struct.pack("<I", value))

    def speed(self, number, baud):
        answer = self.set(17, number)
        if answer == ACK:
            self.port.baudrate = baud
        return answer

    def capture(self):
        assert self.command(2, 2, 0) == ACK
        assert self.port.read() == ENQ


@contextmanager
def coolpix(**config):
    config = {"scene": "ramp", "sensor": "ideal-8", "size": "48x32", **config}
    device = sierra.make({"repeat_noise": True, **config})
    device.attach()
    host = Host(device)
    try:
        yield device, host
    finally:
        host.port.close()
        device.body.wait()
        device.detach()


def test_a_nul_is_answered_at_19200_alone():
    with coolpix() as (_, host):
        assert host.nul() == NAK
        host.port.baudrate = 38400
        host.port.timeout = 0.2
        assert host.nul() == b""


@pytest.mark.parametrize(("number", "baud"), [(1, 9600), (3, 38400), (4, 57600), (5, 115200)])
def test_the_speed_register(number, baud):
    with coolpix() as (device, host):
        assert host.nul() == NAK
        assert host.speed(number, baud) == ACK
        assert device.speed == baud
        assert host.text(27) == b"E990\0"


def test_a_speed_that_it_does_not_have():
    with coolpix(speed_limit=57600) as (device, host):
        assert host.set(17, 5) == INVALID
        assert host.set(17, 9) == INVALID
        device.do("no_speed")
        assert host.set(17, 4) == INVALID
        device.do("ok")
        assert host.set(17, 4) == ACK


def test_silence_ends_the_session_and_the_speed():
    with coolpix(silence_s=0.2) as (device, host):
        host.speed(5, 115200)
        time.sleep(0.6)
        assert device.speed == 19200
        host.port.baudrate = 19200
        assert host.command(1, 16) == SESSION
        assert host.nul() == NAK
        assert host.number(16) == 90


def test_a_break_ends_the_session():
    with coolpix() as (device, host):
        host.speed(5, 115200)
        device.do("break")
        host.port.baudrate = 19200
        assert host.command(1, 16) == SESSION


@pytest.mark.parametrize(("aperture", "light"), [(0, 1), (1, 1), (2, (2.5 / 4) ** 2)])
def test_a_picture_has_the_exposure_of_the_registers(aperture, light):
    with coolpix() as (device, host):
        assert host.set(1, 0x23) == ACK
        assert host.set(3, 8000) == ACK
        assert host.number(3) == 8000
        assert host.set(5, aperture) == ACK
        host.capture()
        data = host.text(14)
        assert len(data) == host.number(12)
        picture = tifffile.imread(io.BytesIO(data))
        expected = device.body.exposer.expose(0.008 * light)
        assert picture.shape == (32, 48, 3)
        assert all(np.array_equal(picture[..., i], expected) for i in range(3))


def test_a_shutter_time_snaps_and_says_so():
    with coolpix() as (_, host):
        for wanted, there in ((9000, 8000), (12000, 16666), (1, 1000), (99_000_000, 8_000_000)):
            assert host.set(3, wanted) == ACK
            assert host.number(3) == there
        assert host.set(3, 0) == ACK
        assert host.number(3) == 0
    with coolpix(times_us=[500, 12345]) as (_, host):
        host.set(3, 10_000)
        assert host.number(3) == 12345


def test_silent_clamping_and_wrong_exposures():
    with coolpix() as (device, host):
        device.do("clamp", max_s=0.01)
        assert host.set(3, 500_000) == ACK
        assert host.number(3) == 8000
        device.do("ok")
        device.do("wrong", factor=2.0)
        host.set(1, 0x23)
        host.capture()
        picture = tifffile.imread(io.BytesIO(host.text(14)))
        assert np.array_equal(picture[..., 0], device.body.exposer.expose(0.016))


def test_names_folders_and_what_is_said_of_a_picture():
    with coolpix(serial="SN1") as (_, host):
        host.capture()
        assert host.text(79) == b"DSCN0001.JPG\0"
        assert host.text(25) == b"SN1\0"
        sizes = struct.unpack("<8I", host.text(47))
        assert sizes[:3] == (host.number(12), host.number(13), 0)
        assert cv2.imdecode(np.frombuffer(host.text(15), np.uint8), 1).shape == (32, 48, 3)
        assert host.number(10) == 1
        assert host.command(3, 84, *b"\\") == ACK
        assert (host.number(10), host.number(83)) == (0, 1)
        host.set(83, 1)
        assert host.text(84) == b"DCIM\0"
        assert host.command(3, 84, *b"DCIM") == ACK
        assert host.text(84) == b"100NIKON\0"
        assert host.command(3, 84, *b"nothing") == INVALID
        assert host.command(3, 84, *b"100NIKON") == ACK
        assert (host.number(10), host.number(83)) == (1, 0)


def test_choosing_and_deleting_pictures():
    with coolpix() as (device, host):
        for time_us in (4000, 8000):
            host.set(3, time_us)
            host.capture()
        assert host.number(4) == 2
        newest = host.text(14)
        assert host.set(4, 1) == ACK
        assert host.text(79) == b"DSCN0001.JPG\0"
        assert host.text(14) != newest
        assert host.command(2, 7, 0) == ACK
        assert host.port.read() == ENQ
        assert device.do("state")["pictures"] == 1
        assert host.text(14) == newest
        assert host.set(4, 7) == ACK
        assert host.text(14) is None
        assert host.command(2, 1, 0) == ACK
        assert host.port.read() == ENQ
        assert host.number(10) == 0


def test_an_exposure_takes_its_time():
    with coolpix(delay_s=0.1) as (device, host):
        host.set(3, 250_000)
        began = time.monotonic()
        host.capture()
        assert 0.35 <= time.monotonic() - began < 1.5
        host.text(14)
        time.sleep(0.05)
        (shot,) = device.do("log")["shots"]
        assert shot["downloaded_s"] > shot["ended_s"] > shot["began_s"]


def test_what_is_asked_during_an_exposure_is_answered_after_it():
    with coolpix() as (_, host):
        host.set(3, 250_000)
        assert host.command(2, 2, 0) == ACK
        host.port.write(Host.packet(b"\x1b\x43", bytes([1, 10])))
        assert host.port.read() == ENQ
        assert host.rest(host.port.read())[1] == struct.pack("<I", 1)


def test_a_wrong_sum_and_a_packet_that_is_sent_again():
    with coolpix() as (_, host):
        host.port.write(Host.packet(b"\x1b\x53", bytes([1, 16]), wrong=1))
        assert host.port.read() == NAK
        host.capture()
        kind = host.command(4, 14)
        first = host.rest(kind)
        host.port.write(NAK)
        assert host.rest(host.port.read()) == first


def test_half_a_packet_is_forgotten():
    with coolpix() as (_, host):
        host.port.write(Host.packet(b"\x1b\x53", bytes([1, 16]))[:5])
        assert host.port.read() == NAK
        assert host.number(16) == 90


def test_faults():
    with coolpix() as (device, host):
        assert host.nul() == NAK
        device.do("nak", count=2)
        assert [host.command(1, 16) for _ in range(2)] == [NAK, NAK]
        device.do("garbage")
        host.port.timeout = 0.3
        host.command(1, 16)
        assert len(host.port.read(100)) == 22
        device.do("truncate")
        host.capture()
        host.command(4, 14)
        assert len(host.port.read(5000)) < len(device.camera.pictures[0].data)
        device.do("hang")
        assert host.command(1, 16) == b""
        assert host.nul() == b""
        device.do("ok")
        host.port.reset_input_buffer()
        assert host.number(16) == 90


def test_a_full_card_and_a_low_battery():
    with coolpix() as (device, host):
        device.do("card_full")
        assert host.command(2, 2, 0) == INVALID
        assert (host.number(11), host.number(28)) == (0, 0)
        device.do("ok")
        device.do("battery_low")
        assert host.command(2, 2, 0) == INVALID
        assert host.number(16) == 3
        device.do("ok")
        host.capture()
    with coolpix(card_bytes=1000) as (_, host):
        assert host.command(2, 2, 0) == INVALID


def test_unplugged_and_plugged_in_again(tmp_path):
    link = tmp_path / "camera"
    with coolpix(link=str(link)) as (device, host):
        host.capture()
        device.do("unplug")
        assert not link.exists()
        with pytest.raises(OSError):  # noqa: PT011 - a SerialException, or the terminal's own
            host.command(1, 10) or host.port.read()
        device.do("plug")
        assert device.do("state")["path"] == str(link.resolve())
        again = Host(device)
        assert again.number(10) == 1
        again.port.close()


def test_bytes_take_their_time_where_they_are_to():
    with coolpix(is_paced=True, files="tiff") as (_, host):
        host.nul()
        host.speed(3, 38400)
        host.capture()
        began = time.monotonic()
        data = host.text(14)
        assert time.monotonic() - began >= 0.9 * len(data) * 10 / 38400


@pytest.mark.parametrize("bad", [{"files": "dng"}, {"times_us": [0]}, {"zeal": 1}])
def test_a_bad_configuration_is_one_line(bad):
    with pytest.raises(UsageError) as caught:
        sierra.make({"scene": "ramp", "size": "48x32", **bad})
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("node", ["/dev/nothing", "/dev/null"])
def test_a_line_that_is_not_there(node):
    device = sierra.make({"scene": "ramp", "size": "48x32", "line": node})
    with pytest.raises(CameraNotFoundError, match=node):
        device.attach()
    device.detach()


def test_an_unknown_verb():
    with coolpix() as (device, _), pytest.raises(UsageError, match="unknown verb 'unplg'"):
        device.do("unplg")
