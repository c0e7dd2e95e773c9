"""The virtual PTP camera without a maker's extension, as a host sees it, in virtual time."""

from __future__ import annotations

import io
import struct
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from ptp_initiator import BUSY, OK, connected, make_camera, numbers

from camctl.errors import UsageError
from camctl.interface.controls import Layout
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.ptp.camera import configuration_descriptor
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

NO_SESSION, INVALID_HANDLE, NO_PROPERTY = 0x2003, 0x2009, 0x200A
INVALID_FORMAT, FULL, DENIED = 0x200B, 0x200C, 0x200F
INVALID_VALUE, INVALID_PARAMETER = 0x201C, 0x201D
ANY = 0xFFFFFFFF  # storage


def expose(time_s: float, gain: float = 1.0, sensor: str = "ideal-8") -> NDArray[Any]:
    """Return the picture that the camera of `connected` takes."""
    model = load_sensor(sensor)
    camera = VirtualSensor(load_scene("ramp", (32, 48)), model, repeat_noise=True)
    return camera.expose(time_s, gain)


def read_tiff(data: bytes) -> NDArray[Any]:
    return np.asarray(tifffile.imread(io.BytesIO(data)))


def read_text(data: bytes, at: int) -> tuple[str, int]:
    """Return the string at an offset, and the offset behind it."""
    end = at + 1 + 2 * data[at]
    return data[at + 1 : end].decode("utf-16-le").rstrip("\0"), end


def read_device_info(data: bytes) -> tuple[int, list[tuple[int, ...]], list[str]]:
    """Return the extension, the five arrays and the four strings of a device info dataset."""
    version, extension, _ = struct.unpack_from("<HIH", data)
    assert version == 100
    _, at = read_text(data, 8)
    at += 2
    arrays, texts = [], []
    for _ in range(5):
        (count,) = struct.unpack_from("<I", data, at)
        arrays.append(struct.unpack_from(f"<{count}H", data, at + 4))
        at += 4 + 2 * count
    for _ in range(4):
        text, at = read_text(data, at)
        texts.append(text)
    assert at == len(data)
    return extension, arrays, texts


def read_description(data: bytes, kind: str) -> tuple[int, int, int, tuple[int, ...]]:
    """Return (writable, default, value, choices or limits) of a numeric property."""
    size = struct.calcsize(kind)
    _, _, writable, default, value = struct.unpack_from("<HHB" + 2 * kind, data)
    form = data[5 + 2 * size]
    rest = data[6 + 2 * size :]
    if form == 1:
        return writable, default, value, struct.unpack("<3" + kind, rest)
    assert form == 2
    (count,) = struct.unpack_from("<H", rest)
    return writable, default, value, struct.unpack(f"<{count}{kind}", rest[2:])


def units(value: int) -> bytes:
    """Return a value of property 500D, 1e-4 s."""
    return struct.pack("<I", value)


def test_device_info_and_usb_strings_identify_the_camera() -> None:
    device, host = connected(serial="ABC123")
    extension, arrays, texts = read_device_info(host.get(0x1001))
    assert extension == 0
    assert texts == ["camctl", "Virtual PTP camera", "1.0", "ABC123"]
    assert device.strings == ("", "camctl", "Virtual PTP camera", "ABC123")
    operations, events, properties, captures, _ = arrays
    assert {0x1001, 0x1009, 0x100E, 0x1016, 0x101B} <= set(operations)
    assert {0x4002, 0x400D, 0x4006} <= set(events)
    assert {0x500D, 0x500F, 0x5007, 0x5001} <= set(properties)
    assert captures == (0x3801,)


def test_the_usb_interface_has_the_still_image_class() -> None:
    data = configuration_descriptor()
    assert int.from_bytes(data[2:4], "little") == len(data)
    assert tuple(data[14:17]) == (6, 1, 1)


def test_without_a_session_only_the_device_info_can_be_read() -> None:
    _, host = connected()
    host.do(0x1003)
    assert host.response(0x1004) == NO_SESSION
    assert host.response(0x100E, 0, 0) == NO_SESSION
    host.do(0x1001)
    host.do(0x1002, 5)
    assert host.execute(0x1002, 6)[:2] == (0x201E, (5,))


@pytest.mark.parametrize(("value", "time_s"), [(100, 0.01), (167, 0.0167), (1, 1 / 8000)])
def test_a_picture_has_the_exposure_time_that_was_set(value: int, time_s: float) -> None:
    _, host = connected(files="tiff", repeat_noise=True)
    host.do(0x1016, 0x500D, data=units(value))
    assert host.get(0x1015, 0x500D) == units(value)
    assert np.array_equal(read_tiff(host.shoot()), expose(time_s))


def test_sensitivity_and_aperture_change_the_exposure() -> None:
    _, host = connected(files="tiff", repeat_noise=True)
    host.do(0x1016, 0x500D, data=units(100))
    host.do(0x1016, 0x500F, data=struct.pack("<H", 400))
    host.do(0x1016, 0x5007, data=struct.pack("<H", 560))
    assert np.array_equal(read_tiff(host.shoot()), expose(0.01 * (280 / 560) ** 2, 4.0))


@pytest.mark.parametrize("sensor", ["ideal-8", "machine-vision"])
def test_a_raw_file_holds_the_pixels_of_the_sensor(sensor: str) -> None:
    rawpy = pytest.importorskip("rawpy", reason="rawpy is not installed: pip install camctl[raw]")
    _, host = connected(files="dng", sensor=sensor, repeat_noise=True)
    host.do(0x1016, 0x500D, data=units(50))
    with rawpy.imread(io.BytesIO(host.shoot())) as raw:
        assert np.array_equal(raw.raw_image, expose(0.005, sensor=sensor))


def test_the_compression_setting_selects_the_files() -> None:
    _, host = connected(files=["jpeg", "tiff", "dng+jpeg"])
    _, _, value, choices = read_description(host.get(0x1014, 0x5004), "B")
    assert (value, choices) == (2, (2, 3, 7))
    assert host.shoot()[:2] == b"\xff\xd8"
    host.do(0x1016, 0x5004, data=b"\x07")
    host.do(0x100E, 0, 0)
    raw, jpeg = host.added_object(), host.added_object()
    assert host.get(0x1009, raw)[:2] == b"II"
    assert host.get(0x1009, jpeg)[:2] == b"\xff\xd8"
    assert host.event()[0] == 0x400D


def test_a_capture_may_name_the_format_of_its_file() -> None:
    _, host = connected(files=["jpeg", "tiff", "dng+jpeg"])
    host.do(0x100E, 0, 0x380D)
    assert host.get(0x1009, host.added_object())[:2] == b"II"
    assert host.response(0x100E, 0, 0x3802) == INVALID_FORMAT
    assert host.shoot()[:2] == b"\xff\xd8"


def test_raw_files_of_an_rgb_sensor_are_refused() -> None:
    with pytest.raises(UsageError, match="an RGB sensor has no raw file"):
        make_camera(scene="colour-chart", files="dng")


def test_the_jpeg_of_a_mono_sensor_is_grey() -> None:
    device, host = connected()
    assert device.body.sensor.layout is Layout.MONO
    picture = cv2.imdecode(np.frombuffer(host.shoot(), np.uint8), cv2.IMREAD_UNCHANGED)
    assert picture is not None
    assert picture.ndim == 2


def test_objects_are_listed_by_folder_and_format() -> None:
    _, host = connected()
    data = host.shoot()
    (store,) = numbers(host.get(0x1004))
    top = numbers(host.get(0x1007, store, 0, 0xFFFFFFFF))
    (middle,) = numbers(host.get(0x1007, store, 0, top[0]))
    (picture,) = numbers(host.get(0x1007, store, 0, middle))
    assert numbers(host.get(0x1007, ANY, 0x3801, 0)) == (picture,)
    assert set(numbers(host.get(0x1007, store, 0, 0))) == {*top, middle, picture}
    assert host.results(0x1006, store, 0, 0) == ((3,), None)
    info = host.get(0x1008, picture)
    _, form, _, size, _, _, _, _, columns, rows, _, parent = struct.unpack_from(
        "<IHHIHIIIIIII", info
    )
    assert (form, size, columns, rows, parent) == (0x3801, len(data), 48, 32, middle)
    assert read_text(info, 52)[0] == "VIRT0001.JPG"
    assert struct.unpack_from("<H", host.get(0x1008, top[0]), 4) == (0x3001,)
    assert host.get(0x100A, picture)[:2] == b"\xff\xd8"


def test_the_parts_of_an_object_make_the_whole() -> None:
    _, host = connected()
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    whole = host.get(0x1009, handle)
    parts = [host.get(0x101B, handle, at, 100) for at in range(0, len(whole), 100)]
    assert b"".join(parts) == whole
    assert host.results(0x101B, handle, len(whole), 100) == ((0,), b"")


def test_objects_are_deleted_one_by_one_or_all() -> None:
    device, host = connected()
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    host.do(0x100B, handle)
    assert host.response(0x1009, handle) == INVALID_HANDLE
    host.shoot()
    host.do(0x100B, 0xFFFFFFFF)
    assert device.state()["pictures"] == 0
    folder = numbers(host.get(0x1007, ANY, 0, 0))[0]
    assert host.response(0x100B, folder) == DENIED


def test_the_exposure_time_can_be_a_range() -> None:
    _, host = connected(time_form="range")
    expected = (1, 1000, 1000, (1, 600_000, 1))
    assert read_description(host.get(0x1014, 0x500D), "I") == expected
    assert host.response(0x1016, 0x500D, data=units(0)) == INVALID_VALUE


def test_values_that_a_property_does_not_allow_are_refused() -> None:
    _, host = connected(times=["1/100", 0.5, 2])
    assert read_description(host.get(0x1014, 0x500D), "I")[3] == (100, 5000, 20000)
    assert host.response(0x1016, 0x500D, data=units(101)) == INVALID_VALUE
    assert host.response(0x1016, 0x500D, data=b"\1") == 0x201B
    assert host.response(0x1016, 0x5001, data=b"\1") == DENIED
    assert host.response(0x1014, 0x5FFF) == NO_PROPERTY


def test_a_changed_property_is_announced() -> None:
    _, host = connected()
    host.do(0x1016, 0x500D, data=units(80))
    assert host.event() == (0x4006, 0x500D)


def test_the_mode_dial_makes_the_exposure_time_read_only() -> None:
    device, host = connected()
    device.do("mode", dial="auto")
    assert host.event() == (0x4006, 0x500E)
    assert read_description(host.get(0x1014, 0x500D), "I")[0] == 0
    assert host.response(0x1016, 0x500D, data=units(80)) == DENIED


def test_a_capture_without_two_parameters_is_refused() -> None:
    _, host = connected()
    assert host.response(0x100E) == INVALID_PARAMETER
    assert host.response(0x100E, 0) == INVALID_PARAMETER
    assert host.response(0x100E, 0x99, 0) == 0x2008


def test_an_exposure_takes_its_time_and_the_delay() -> None:
    device, host = connected(delay_s=0.1, overlap=False)
    host.do(0x1016, 0x500D, data=units(1000))
    began_s = device.clock.now()
    host.do(0x100E, 0, 0)
    assert host.response(0x1007, ANY, 0, 0) == BUSY
    assert host.response(0x100E, 0, 0) == BUSY
    handle = host.added_object()
    assert device.clock.now() - began_s == pytest.approx(0.2)
    host.do(0x1009, handle)


def test_with_overlap_a_file_is_read_during_the_next_exposure() -> None:
    device, host = connected(delay_s=0.3)
    host.do(0x100E, 0, 0)
    first = host.added_object()
    host.do(0x100E, 0, 0)
    host.do(0x1009, first)
    host.do(0x1016, 0x500D, data=units(80))
    assert device.state()["is_exposing"]
    assert host.response(0x100E, 0, 0) == BUSY
    # A setting that is made during an exposure holds for the next one.
    host.added_object()
    assert device.state()["exposure"]["time_s"] == 0.1


def test_a_bulb_exposure_lasts_until_its_transaction_is_ended() -> None:
    device, host = connected(bulb=True)
    transaction = host.transaction
    host.do(0x101C, 0, 0)
    host.sleep(0.25)
    assert host.response(0x1018, transaction + 1) == 0x2004
    host.do(0x1018, transaction)
    host.added_object()
    assert device.state()["exposure"]["time_s"] == 0.25
    assert host.response(0x1018, transaction) == 0x2004


def test_a_bulb_exposure_that_nobody_ends_stops_by_itself() -> None:
    device, host = connected(bulb=True)
    host.do(0x101C, 0, 0)
    host.sleep(1000.0)
    assert device.state()["exposure"]["time_s"] == 120.0


def test_a_camera_without_bulb_refuses_an_open_capture() -> None:
    _, host = connected()
    assert host.response(0x101C, 0, 0) == 0x2005


@pytest.mark.parametrize("order", ["after", "before"])
def test_events_are_sent_after_or_before_the_response(order: str) -> None:
    _, host = connected(event_order=order, delay_s=0.05, folder_event=True)
    host.do(0x100E, 0, 0)
    assert (not host.events) == (order == "after")
    folder, picture = host.added_object(), host.added_object()
    assert struct.unpack_from("<H", host.get(0x1008, folder), 4) == (0x3001,)
    assert struct.unpack_from("<H", host.get(0x1008, picture), 4) == (0x3801,)
    assert host.event()[0] == 0x400D


def test_a_camera_may_send_no_events() -> None:
    device, host = connected(event_order="never")
    host.do(0x100E, 0, 0)
    device.body.wait()
    assert len(numbers(host.get(0x1007, ANY, 0x3801, 0))) == 1
    assert not host.events


@pytest.mark.parametrize("zlp", ["always", "never"])
@pytest.mark.parametrize("split_header", [False, True])
def test_a_data_phase_of_whole_packets_ends_with_an_empty_packet_or_without(
    zlp: str, split_header: bool
) -> None:
    size = 2048 if split_header else 2048 - 12
    _, host = connected(zlp=zlp, split_header=split_header, object_bytes=size)
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    host.write(1, 0x1009, struct.pack("<I", handle))
    if split_header:
        assert len(host.must_read()[1]) == 12
    # A read for more bytes ends at the empty packet; without one it includes the response.
    error, data = host.must_read(1 << 20)
    assert error == 0
    assert len(data) == 2048 + (12 if zlp == "never" else 0)


def test_a_large_object_in_short_reads() -> None:
    _, host = connected(object_bytes=100_000)
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    host.write(1, 0x1009, struct.pack("<I", handle))
    data = b""
    while len(data) < 100_012:
        data += host.must_read(16384)[1]
    assert struct.unpack_from("<IHH", data) == (100_012, 2, 0x1009)
    assert len(host.must_read(16384)[1]) == 12


def test_a_full_card_refuses_captures_until_files_are_deleted() -> None:
    device, host = connected(card_bytes=200_000, object_bytes=60_000)
    responses = []
    for _ in range(5):
        responses.append(host.response(0x100E, 0, 0))
        device.body.wait()
    assert responses[0] == OK
    assert responses[-1] == FULL
    host.do(0x100B, 0xFFFFFFFF)
    host.do(0x100E, 0, 0)


def test_class_requests_for_status_reset_and_cancel() -> None:
    device, host = connected()
    assert device.request(0xA1, 0x67, 0, 0, 64, b"") == struct.pack("<HH", 4, OK)
    host.write(1, 0x1007, struct.pack("<I", ANY))
    assert device.request(0x21, 0x64, 0, 0, 6, struct.pack("<HI", 0x4001, 0)) == b""
    assert host.read(timeout_s=60.0) is None
    host.transaction += 1
    host.do(0x1004)
    assert device.request(0x21, 0x66, 0, 0, 0, b"") == b""
    assert host.response(0x1004) == NO_SESSION
    host.do(0x1002, 1)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vendor": "leica"}, "invalid camera option vendor=leica"),
        ({"files": "png"}, "invalid camera option files=png"),
        ({"times": ["0"]}, "shutter time 0 s is not a fraction of numbers from 1 to 65535"),
        ({"times": ["1/70000"]}, "shutter time 1/70000 s is not a fraction"),
        ({"zpl": "never"}, "unknown camera option 'zpl'; did you mean zlp?"),
        ({"isos": [0]}, "invalid camera option isos="),
        ({"size": "wide"}, "write WIDTHxHEIGHT"),
        ({"sensor": "nothing"}, "nothing"),
    ],
)
def test_an_invalid_configuration_is_an_error_of_one_line(
    options: dict[str, Any], message: str
) -> None:
    with pytest.raises(UsageError) as caught:
        make_camera(**options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)
