"""The virtual CoolPix 990 as a host sees it, on a line in memory and in virtual time."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import pytest
import serial
import tifffile
from sierra_host import (
    ACK,
    CAPTURE,
    DELETE,
    DELETE_ALL,
    ENQ,
    FIRST,
    INVALID,
    LAST,
    NAK,
    NEXT,
    SESSION_ERROR,
    Host,
    connected,
)

from camctl.errors import UsageError


def test_silence_ends_the_session_and_resets_the_speed() -> None:
    device, host = connected(silence_s=5.0)
    host.set_speed(5, 115200)
    host.sleep(4.9)
    assert host.number(16) == 90
    host.sleep(4.9)
    assert device.do("state")["speed"] == 115200
    host.sleep(0.1)
    assert device.do("state")["speed"] == 19200
    host.port.baudrate = 19200
    assert host.command(1, 16) == SESSION_ERROR
    assert host.send_nul() == NAK
    assert host.number(16) == 90


@pytest.mark.parametrize(("aperture", "light"), [(0, 1), (1, 1), (2, (2.5 / 4) ** 2)])
def test_a_picture_has_the_exposure_of_the_registers(aperture: int, light: float) -> None:
    device, host = connected()
    assert host.set(1, 0x23) == ACK
    assert host.set(3, 8000) == ACK
    assert host.number(3) == 8000
    assert host.set(5, aperture) == ACK
    host.act(CAPTURE)
    data = host.file()
    assert len(data) == host.number(12)
    picture = tifffile.imread(io.BytesIO(data))
    expected = device.body.sensor.expose(0.008 * light)
    assert picture.shape == (32, 48, 3)
    assert all(np.array_equal(picture[..., i], expected) for i in range(3))


@pytest.mark.parametrize(
    ("requested", "applied"),
    [(9000, 8000), (12000, 16666), (1, 1000), (99_000_000, 8_000_000), (0, 0)],
)
def test_a_shutter_time_is_rounded_and_read_back(requested: int, applied: int) -> None:
    _, host = connected()
    assert host.set(3, requested) == ACK
    assert host.number(3) == applied


def test_a_picture_has_a_name_and_a_size() -> None:
    _, host = connected(serial="SN1")
    host.act(CAPTURE)
    assert host.text(79) == b"DSCN0001.JPG\0"
    assert host.text(25) == b"SN1\0"
    assert struct.unpack("<8I", host.file(47))[:3] == (host.number(12), 0, 0)


def test_pictures_are_counted_in_their_folder_only() -> None:
    _, host = connected()
    host.act(CAPTURE)
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


def test_pictures_are_selected_and_deleted() -> None:
    device, host = connected()
    for time_us in (4000, 8000):
        host.set(3, time_us)
        host.act(CAPTURE)
    assert host.number(4) == 2
    newest = host.text(14)
    assert host.set(4, 1) == ACK
    assert host.text(79) == b"DSCN0001.JPG\0"
    assert host.text(14) != newest
    host.act(DELETE)
    assert device.do("state")["pictures"] == 1
    assert host.text(14) == newest
    assert host.set(4, 7) == ACK
    assert host.text(14) is None
    host.act(DELETE_ALL)
    assert host.number(10) == 0


def test_an_exposure_takes_its_time_and_the_delay() -> None:
    device, host = connected(delay_s=0.1)
    host.set(3, 250_000)
    began_s = device.clock.now()
    host.act(CAPTURE)
    assert device.clock.now() == pytest.approx(began_s + 0.35)
    host.sleep(1.0)
    host.text(14)
    (shot,) = device.do("log")["shots"]
    times = [shot["began_s"], shot["ended_s"], shot["downloaded_s"]]
    assert times == pytest.approx([began_s, began_s + 0.25, began_s + 1.35])


def test_commands_during_an_exposure_are_answered_after_it() -> None:
    _, host = connected()
    host.set(3, 250_000)
    assert host.command(2, CAPTURE, 0) == ACK
    host.port.write(Host.packet(NEXT, bytes([1, 10])))
    assert bytes(host.port.read()) == ENQ
    assert bytes(host.port.read()) == LAST
    assert host.data_packet()[1] == struct.pack("<I", 1)


def test_a_packet_with_a_wrong_sum_is_not_executed() -> None:
    _, host = connected()
    host.port.write(Host.packet(FIRST, bytes([1, 16]), sum_error=1))
    assert bytes(host.port.read()) == NAK


def test_a_paced_line_takes_its_time() -> None:
    device, host = connected(is_paced=True, files="tiff")
    host.send_nul()
    host.set_speed(3, 38400)
    host.act(CAPTURE)
    began_s = device.clock.now()
    data = host.file()
    packets = -(-len(data) // 2048)
    expected_s = (len(data) + 6 * packets) * 10 / 38400
    assert device.clock.now() - began_s == pytest.approx(expected_s)


def test_a_line_has_one_host() -> None:
    device, host = connected()
    with pytest.raises(serial.SerialException, match="another host"):
        Host(device)
    host.port.close()
    assert Host(device).number(16) == 90


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"files": "dng"}, "invalid camera option files=dng"),
        ({"times_us": [0]}, "invalid camera option times_us="),
        ({"zeal": 1}, "unknown camera option 'zeal'"),
    ],
)
def test_an_invalid_configuration_is_an_error_of_one_line(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError) as caught:
        connected(**options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
