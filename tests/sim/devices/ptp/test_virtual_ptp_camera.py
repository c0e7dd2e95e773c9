"""The virtual PTP camera as a host sees it, by the standard's own properties and operations."""

import io
import struct
import time

import cv2
import numpy as np
import pytest
import tifffile
from ptp_initiator import BUSY, OK, camera, numbers

from camctl.controls import Layout
from camctl.errors import UsageError
from sim.devices.ptp import camera as ptp
from sim.devices.ptp.camera import configuration_descriptor
from sim.devices.scenery import Exposer
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

FULL, PROPERTY, SESSION, PARAMETER = 0x200C, 0x200A, 0x2003, 0x201D


def exposer(size=(32, 48), scene="ramp", sensor="ideal-8"):
    return Exposer(load_scene(scene, size), load_sensor(sensor), repeat_noise=True)


def tiff(data):
    return tifffile.imread(io.BytesIO(data))


def text(data, at):
    count = data[at]
    return data[at + 1 : at + 1 + 2 * count].decode("utf-16-le").rstrip("\0"), at + 1 + 2 * count


def device_info(data):
    """Return (lists of operations, events, properties, formats .., texts make, model ..)."""
    version, extension, _ = struct.unpack_from("<HIH", data)
    assert version == 100
    _, at = text(data, 8)
    at += 2
    lists, texts = [], []
    for _ in range(5):
        (count,) = struct.unpack_from("<I", data, at)
        lists.append(struct.unpack_from(f"<{count}H", data, at + 4))
        at += 4 + 2 * count
    for _ in range(4):
        said, at = text(data, at)
        texts.append(said)
    assert at == len(data)
    return extension, lists, texts


def description(data, kind):
    """Return (writable, default, value, choices or limits) of a number."""
    size = struct.calcsize(kind)
    _, _, writable, default, value = struct.unpack_from("<HHB" + 2 * kind, data)
    form = data[5 + 2 * size]
    rest = data[6 + 2 * size :]
    if form == 1:
        return writable, default, value, struct.unpack("<3" + kind, rest)
    assert form == 2
    (count,) = struct.unpack_from("<H", rest)
    return writable, default, value, struct.unpack(f"<{count}{kind}", rest[2:])


def test_who_it_is():
    with camera(serial="ABC123") as (device, host):
        extension, lists, texts = device_info(host.good(0x1001))
        assert extension == 0
        assert texts == ["camctl", "Virtual PTP camera", "1.0", "ABC123"]
        assert device.strings[3] == "ABC123"
        operations, events, properties, captures, _ = lists
        assert {0x1001, 0x1009, 0x100E, 0x1016, 0x101B} <= set(operations)
        assert {0x4002, 0x400D, 0x4006} <= set(events)
        assert {0x500D, 0x500F, 0x5007, 0x5001} <= set(properties)
        assert captures == (0x3801,)


def test_its_interface_is_a_still_cameras():
    data = configuration_descriptor()
    assert int.from_bytes(data[2:4], "little") == len(data)
    assert tuple(data[14:17]) == (6, 1, 1)


def test_nothing_without_a_session_but_who_it_is():
    with camera() as (_, host):
        host.good(0x1003)
        assert host.ask(0x1004)[0] == SESSION
        assert host.ask(0x100E, 0, 0)[0] == SESSION
        host.good(0x1001)
        host.good(0x1002, 5)
        assert host.ask(0x1002, 6)[:2] == (0x201E, (5,))


@pytest.mark.parametrize(("units", "time_s"), [(100, 0.01), (167, 0.0167), (1, 1 / 8000)])
def test_a_picture_has_the_exposure_of_the_wire(units, time_s):
    with camera(files="tiff", repeat_noise=True) as (_, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", units))
        assert host.good(0x1015, 0x500D) == struct.pack("<I", units)
        assert np.array_equal(tiff(host.shoot()), exposer().expose(time_s))


def test_sensitivity_and_aperture_change_the_light():
    with camera(files="tiff", repeat_noise=True) as (_, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", 100))
        host.good(0x1016, 0x500F, data=struct.pack("<H", 400))
        host.good(0x1016, 0x5007, data=struct.pack("<H", 560))
        expected = exposer().expose(0.01 * (280 / 560) ** 2, 4.0)
        assert np.array_equal(tiff(host.shoot()), expected)


@pytest.mark.parametrize("sensor", ["ideal-8", "machine-vision"])
def test_a_raw_file_is_the_sensors(sensor):
    rawpy = pytest.importorskip("rawpy", reason="rawpy is not installed: pip install camctl[raw]")
    with camera(files="dng", sensor=sensor, repeat_noise=True) as (_, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", 50))
        with rawpy.imread(io.BytesIO(host.shoot())) as raw:
            expected = exposer(sensor=sensor).expose(0.005)
            assert np.array_equal(raw.raw_image, expected)


def test_several_kinds_of_files_and_two_of_one_exposure():
    with camera(files=["jpeg", "tiff", "dng+jpeg"]) as (_, host):
        _, _, value, choices = description(host.good(0x1014, 0x5004), "B")
        assert (value, choices) == (2, (2, 3, 7))
        assert host.shoot()[:2] == b"\xff\xd8"
        host.good(0x1016, 0x5004, data=b"\x07")
        host.good(0x100E, 0, 0)
        raw, jpeg = host.added(), host.added()
        assert host.good(0x1009, raw)[:2] == b"II"
        assert host.good(0x1009, jpeg)[:2] == b"\xff\xd8"
        assert host.event()[0] == 0x400D
        # The format that a capture names counts for it alone.
        host.good(0x100E, 0, 0x380D)
        assert host.good(0x1009, host.added())[:2] == b"II"
        assert host.ask(0x100E, 0, 0x3802)[0] == 0x200B


def test_an_rgb_sensor_has_no_raw_file():
    with pytest.raises(UsageError, match="raw files of an RGB sensor"):
        ptp.make({"scene": "colour-chart", "sensor": "ideal-8", "size": "48x32", "files": "dng"})


def test_a_mono_sensors_jpeg_is_grey():
    with camera() as (device, host):
        assert device.body.exposer.layout is Layout.MONO
        assert cv2.imdecode(np.frombuffer(host.shoot(), np.uint8), -1).ndim == 2


def test_objects_in_folders():
    with camera() as (_, host):
        data = host.shoot()
        (store,) = numbers(host.good(0x1004))
        top = numbers(host.good(0x1007, store, 0, 0xFFFFFFFF))
        (middle,) = numbers(host.good(0x1007, store, 0, top[0]))
        (picture,) = numbers(host.good(0x1007, store, 0, middle))
        assert numbers(host.good(0x1007, 0xFFFFFFFF, 0x3801, 0)) == [picture]
        assert set(numbers(host.good(0x1007, store, 0, 0))) == {*top, middle, picture}
        assert host.good(0x1006, store, 0, 0) == (3,)
        info = host.good(0x1008, picture)
        _, form, _, size, _, _, _, _, columns, rows, _, parent = struct.unpack_from(
            "<IHHIHIIIIIII", info
        )
        assert (form, size, columns, rows, parent) == (0x3801, len(data), 48, 32, middle)
        assert text(info, 52)[0] == "VIRT0001.JPG"
        assert struct.unpack_from("<H", host.good(0x1008, top[0]), 4) == (0x3001,)
        assert host.good(0x100A, picture)[:2] == b"\xff\xd8"


def test_parts_of_an_object_make_the_whole():
    with camera() as (_, host):
        host.good(0x100E, 0, 0)
        handle = host.added()
        whole = host.good(0x1009, handle)
        parts = [host.good(0x101B, handle, at, 100) for at in range(0, len(whole), 100)]
        assert b"".join(parts) == whole
        assert host.ask(0x101B, handle, len(whole), 100)[1:] == ((0,), b"")


def test_deleting():
    with camera() as (device, host):
        host.good(0x100E, 0, 0)
        handle = host.added()
        host.good(0x100B, handle)
        assert host.ask(0x1009, handle)[0] == 0x2009
        host.shoot()
        host.good(0x100B, 0xFFFFFFFF)
        assert device.state()["pictures"] == 0
        folder = numbers(host.good(0x1007, 0xFFFFFFFF, 0, 0))[0]
        assert host.ask(0x100B, folder)[0] == 0x200F


def test_forms_of_properties():
    with camera(time_form="range") as (_, host):
        writable, default, value, limits = description(host.good(0x1014, 0x500D), "I")
        assert (writable, default, value, limits) == (1, 1000, 1000, (1, 600_000, 1))
        assert host.ask(0x1016, 0x500D, data=struct.pack("<I", 0))[0] == 0x201C
    with camera(times=["1/100", 0.5, 2]) as (_, host):
        assert description(host.good(0x1014, 0x500D), "I")[3] == (100, 5000, 20000)
        assert host.ask(0x1016, 0x500D, data=struct.pack("<I", 101))[0] == 0x201C
        assert host.ask(0x1016, 0x500D, data=b"\1")[0] == 0x201B
        assert host.ask(0x1016, 0x5001, data=b"\1")[0] == 0x200F
        assert host.ask(0x1014, 0x5FFF)[0] == PROPERTY


def test_a_change_is_told():
    with camera() as (_, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", 80))
        assert host.event() == (0x4006, 0x500D)


def test_the_mode_dial():
    with camera() as (device, host):
        device.do("mode", dial="auto")
        assert host.event() == (0x4006, 0x500E)
        assert description(host.good(0x1014, 0x500D), "I")[0] == 0
        assert host.ask(0x1016, 0x500D, data=struct.pack("<I", 80))[0] == 0x200F


def test_a_capture_without_two_parameters_is_refused():
    with camera() as (_, host):
        assert host.ask(0x100E)[0] == PARAMETER
        assert host.ask(0x100E, 0)[0] == PARAMETER
        assert host.ask(0x100E, 0x99, 0)[0] == 0x2008


def test_an_exposure_takes_its_time():
    with camera(delay_s=0.1, overlap=False) as (_, host):
        host.good(0x1016, 0x500D, data=struct.pack("<I", 1000))
        began = time.monotonic()
        host.good(0x100E, 0, 0)
        assert host.ask(0x1007, 0xFFFFFFFF, 0, 0)[0] == BUSY
        assert host.ask(0x100E, 0, 0)[0] == BUSY
        handle = host.added()
        assert 0.2 <= time.monotonic() - began < 1.0
        host.good(0x1009, handle)


def test_with_overlap_a_file_is_fetched_while_the_next_is_exposed():
    with camera(delay_s=0.3) as (device, host):
        host.good(0x100E, 0, 0)
        first = host.added()
        host.good(0x100E, 0, 0)
        host.good(0x1009, first)
        host.good(0x1016, 0x500D, data=struct.pack("<I", 80))
        assert device.state()["is_exposing"]
        assert host.ask(0x100E, 0, 0)[0] == BUSY
        # What is set during an exposure is the next one's.
        host.added()
        assert device.state()["exposure"]["time_s"] == 0.1


def test_bulb():
    with camera(bulb=True) as (device, host):
        transaction = host.transaction
        host.good(0x101C, 0, 0)
        time.sleep(0.2)
        assert host.ask(0x1018, transaction + 1)[0] == 0x2004
        host.good(0x1018, transaction)
        host.added()
        assert 0.2 <= device.state()["exposure"]["time_s"] < 0.5
        assert host.ask(0x1018, transaction)[0] == 0x2004
    with camera() as (_, host):
        assert host.ask(0x101C, 0, 0)[0] == 0x2005


@pytest.mark.parametrize("order", ["after", "before"])
def test_events_come_after_or_before_the_response(order):
    with camera(event_order=order, delay_s=0.05, folder_event=True) as (_, host):
        host.good(0x100E, 0, 0)
        assert host.events.empty() == (order == "after")
        folder, picture = host.added(), host.added()
        assert struct.unpack_from("<H", host.good(0x1008, folder), 4) == (0x3001,)
        assert struct.unpack_from("<H", host.good(0x1008, picture), 4) == (0x3801,)
        assert host.event()[0] == 0x400D


def test_events_may_never_come():
    with camera(event_order="never") as (device, host):
        host.good(0x100E, 0, 0)
        device.body.wait()
        assert numbers(host.good(0x1007, 0xFFFFFFFF, 0x3801, 0))
        assert host.events.empty()


@pytest.mark.parametrize("zlp", ["always", "never"])
@pytest.mark.parametrize("split_header", [False, True])
def test_how_a_data_phase_ends(zlp, split_header):
    size = 2048 - 12 if not split_header else 2048
    with camera(zlp=zlp, split_header=split_header, object_bytes=size) as (_, host):
        host.good(0x100E, 0, 0)
        handle = host.added()
        host.write(1, 0x1009, struct.pack("<I", handle))
        if split_header:
            assert len(host.read()[1]) == 12
        # Of a read that is larger than what comes, an empty packet is the end; without one
        # the response follows in the same read.
        error, data = host.read(1 << 20)
        assert error == 0
        assert len(data) == 2048 + (12 if zlp == "never" else 0)


def test_a_long_object_in_short_reads():
    with camera(object_bytes=100_000) as (_, host):
        host.good(0x100E, 0, 0)
        handle = host.added()
        host.write(1, 0x1009, struct.pack("<I", handle))
        data = b""
        while len(data) < 100_012:
            data += host.read(16384)[1]
        assert struct.unpack_from("<IHH", data) == (100_012, 2, 0x1009)
        assert len(host.read(16384)[1]) == 12


def test_the_card_gets_full():
    with camera(card_bytes=200_000, object_bytes=60_000) as (device, host):
        codes = []
        for _ in range(5):
            codes.append(host.ask(0x100E, 0, 0)[0])
            device.body.wait()
        assert codes[0] == OK
        assert codes[-1] == FULL
        host.good(0x100B, 0xFFFFFFFF)
        host.good(0x100E, 0, 0)


def test_status_reset_and_cancel():
    with camera() as (device, host):
        assert device.request(0xA1, 0x67, 0, 0, 64, b"") == struct.pack("<HH", 4, OK)
        host.write(1, 0x1007, struct.pack("<I", 0xFFFFFFFF))
        assert device.request(0x21, 0x64, 0, 0, 6, struct.pack("<HI", 0x4001, 0)) == b""
        assert host.read(timeout_s=0.05) is None
        host.transaction += 1
        host.good(0x1004)
        assert device.request(0x21, 0x66, 0, 0, 0, b"") == b""
        assert host.ask(0x1004)[0] == SESSION
        host.good(0x1002, 1)


@pytest.mark.parametrize(
    "bad",
    [
        {"vendor": "leica"},
        {"files": "png"},
        {"times": ["0"]},
        {"times": ["1/70000"]},
        {"zpl": "never"},
        {"isos": [0]},
        {"size": "wide"},
        {"sensor": "nothing"},
    ],
)
def test_a_bad_configuration_is_one_line(bad):
    with pytest.raises(UsageError) as caught:
        ptp.make({"scene": "ramp", "size": "48x32", **bad})
    assert "\n" not in str(caught.value)
