"""The virtual PTP camera without a maker's extension, as a host sees it, in virtual time."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from ptp_initiator import connected, make_camera, numbers

from camctl.errors import UsageError
from camctl.sim.devices.common import VirtualSensor
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


def test_sensitivity_and_aperture_change_the_exposure() -> None:
    _, host = connected(files="tiff", repeat_noise=True)
    host.do(0x1016, 0x500D, data=units(100))
    host.do(0x1016, 0x500F, data=struct.pack("<H", 400))
    host.do(0x1016, 0x5007, data=struct.pack("<H", 560))
    assert np.array_equal(read_tiff(host.shoot()), expose(0.01 * (280 / 560) ** 2, 4.0))


def test_raw_files_of_an_rgb_sensor_are_refused() -> None:
    with pytest.raises(UsageError, match="an RGB sensor has no raw file"):
        make_camera(scene="colour-chart", files="dng")


def test_objects_are_listed_by_folder_and_format() -> None:
    _, host = connected()
    data = host.shoot()
    (store,) = numbers(host.get(0x1004))
    top = numbers(host.get(0x1007, store, 0, 0xFFFFFFFF))
    (middle,) = numbers(host.get(0x1007, store, 0, top[0]))
    (picture,) = numbers(host.get(0x1007, store, 0, middle))
    assert numbers(host.get(0x1007, ANY, 0x3801, 0)) == (picture,)
    assert set(numbers(host.get(0x1007, store, 0, 0))) == {*top, middle, picture}
    info = host.get(0x1008, picture)
    _, form, _, size, _, _, _, _, columns, rows, _, parent = struct.unpack_from(
        "<IHHIHIIIIIII", info
    )
    assert (form, size, columns, rows, parent) == (0x3801, len(data), 48, 32, middle)
    assert read_text(info, 52)[0] == "VIRT0001.JPG"
    assert struct.unpack_from("<H", host.get(0x1008, top[0]), 4) == (0x3001,)


def test_pictures_are_deleted_and_folders_are_not() -> None:
    device, host = connected()
    host.do(0x100E, 0, 0)
    handle = host.added_object()
    host.do(0x100B, handle)
    assert host.response(0x1009, handle) == INVALID_HANDLE
    assert device.state()["pictures"] == 0
    folder = numbers(host.get(0x1007, ANY, 0, 0))[0]
    assert host.response(0x100B, folder) == DENIED


def test_values_that_a_property_does_not_allow_are_refused() -> None:
    _, host = connected(times=["1/100", 0.5, 2])
    assert read_description(host.get(0x1014, 0x500D), "I")[3] == (100, 5000, 20000)
    assert host.response(0x1016, 0x500D, data=units(101)) == INVALID_VALUE
    assert host.response(0x1016, 0x500D, data=b"\1") == 0x201B
    assert host.response(0x1016, 0x5001, data=b"\1") == DENIED
    assert host.response(0x1014, 0x5FFF) == NO_PROPERTY


def test_a_capture_without_two_parameters_is_refused() -> None:
    _, host = connected()
    assert host.response(0x100E) == INVALID_PARAMETER
    assert host.response(0x100E, 0) == INVALID_PARAMETER
    assert host.response(0x100E, 0x99, 0) == 0x2008


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
