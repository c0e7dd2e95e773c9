"""The virtual webcam's frames: slots, delays, automatics, formats and faults, in real time."""

import time
from itertools import pairwise

import cv2
import numpy as np
import pytest
import usb.core
from uvc_host import BACKLIGHT, BRIGHTNESS, GAIN, MODE, PRIORITY, TIME, WHITE_AUTO, Host

from camctl.controls import ExposureSetting, Layout
from sim.camera import SimulatedCamera
from sim.devices.scenery import Exposer
from sim.devices.usb.backend import VirtualBackend
from sim.devices.uvc.camera import make
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

ROWS, COLUMNS = 12, 16
BASE = {
    "scene": "ramp",
    "sensor": "standard",
    "seed": 5,
    "size": f"{COLUMNS}x{ROWS}",
    "repeat_noise": True,
    "formats": ["yuyv"],
    "luma": "full",
    "fps": 50,
    "delay": 1,
}


@pytest.fixture
def build():
    cameras = []

    def build(**changes):
        camera = make({**BASE, **changes})
        cameras.append(camera)
        host = Host(VirtualBackend([camera]))
        host.be_manual()
        return camera, host

    yield build
    for camera in cameras:
        camera.detach()


def settled(host, frames=6, timeout=1000):
    for _ in range(frames):
        host.payload(timeout)


def expected(time_s, gain=1.0, sensor="standard"):
    scene = load_scene(BASE["scene"], (ROWS, COLUMNS))
    return Exposer(scene, load_sensor(sensor), seed=5, repeat_noise=True).expose(time_s, gain)


def test_yuyv_is_the_simulated_camera_bit_for_bit(build):
    _, host = build()
    host.start()
    settled(host)
    scene, sensor = load_scene("ramp", (ROWS, COLUMNS)), load_sensor("standard")
    with SimulatedCamera(scene, sensor, seed=5, repeat_noise=True) as camera:
        wanted = next(camera.shoot([ExposureSetting(0.01)])).pixels
    assert np.array_equal(host.luma(ROWS, COLUMNS), wanted)
    assert np.ptp(wanted) > 0


@pytest.mark.parametrize(
    ("form", "sensor"), [("grey", "ideal-8"), ("y12", "machine-vision"), ("y16", "machine-vision")]
)
def test_deep_formats_hold_the_sensors_numbers(build, form, sensor):
    _, host = build(formats=[form], sensor=sensor)
    host.start()
    settled(host)
    data = np.frombuffer(host.payload().data, np.uint8 if form == "grey" else "<u2")
    assert np.array_equal(data.reshape(ROWS, COLUMNS), expected(0.01, sensor=sensor))


def test_bayer_comes_as_the_mosaic(build, tmp_path):
    sensor = load_sensor("ideal-8").model_copy(update={"layout": Layout.RGGB})
    path = tmp_path / "bayer.json"
    path.write_text(sensor.model_dump_json())
    _, host = build(formats=["rggb8"], sensor=str(path))
    host.start()
    settled(host)
    data = np.frombuffer(host.payload().data, np.uint8).reshape(ROWS, COLUMNS)
    assert np.array_equal(data, expected(0.01, sensor=path))


def test_limited_luma_is_mapped(build):
    _, host = build(luma="limited")
    host.start()
    settled(host)
    wanted = np.rint(16 + expected(0.01) * (219 / 255))
    assert np.array_equal(host.luma(ROWS, COLUMNS), wanted)


def test_jpeg_is_near(build):
    _, host = build(formats=["yuyv", "mjpg"], size="64x48")
    host.start(form=2)
    settled(host)
    picture = cv2.imdecode(np.frombuffer(host.payload().data, np.uint8), cv2.IMREAD_GRAYSCALE)
    scene = load_scene(BASE["scene"], (48, 64))
    wanted = Exposer(scene, load_sensor("standard"), seed=5, repeat_noise=True).expose(0.01)
    assert abs(picture.astype(int) - wanted).max() < 16


@pytest.mark.parametrize("delay", [0, 1, 4])
def test_a_setting_is_in_force_so_many_frames_late(build, delay):
    """Written in slot k, between two boundaries, in force from slot k + 1 + delay on."""
    camera, host = build(delay=delay)
    host.start()
    settled(host, delay + 3)
    for ticks in (30, 120, 60):
        host.payload()
        host.set(TIME, ticks)
    settled(host, delay + 3)
    log = camera.do("log")
    by_slot = {frame["slot"]: frame for frame in log["frames"]}
    for write, ticks in zip(log["writes"][-3:], (30, 120, 60), strict=True):
        lands = write["upcoming"] + delay
        assert by_slot[lands]["time_s"] == write["time_s"] == ticks / 10_000
        assert by_slot[lands - 1]["time_s"] != ticks / 10_000
    slots = [frame["slot"] for frame in log["frames"]]
    assert slots == list(range(slots[0], slots[0] + len(slots)))


def test_jitter_lands_between_the_smallest_and_the_largest_delay(build):
    camera, host = build(delay=1, jitter=2)
    host.start()
    settled(host)
    late = set()
    for ticks in range(20, 32):
        host.set(TIME, ticks)
        settled(host, 5)
        log = camera.do("log")
        slot = next(f["slot"] for f in log["frames"] if f["time_s"] == ticks / 10_000)
        late.add(slot - log["writes"][-1]["upcoming"])
    assert late <= {1, 2, 3}
    assert len(late) > 1


def test_frames_keep_their_rate_and_alternate_their_id(build):
    camera, host = build(fps=[50, 25])
    host.start(interval=400_000)
    first = host.payload()
    began = time.monotonic()
    ids = [first.frame_id] + [host.payload().frame_id for _ in range(10)]
    assert time.monotonic() - began == pytest.approx(0.4, abs=0.1)
    assert all(a != b for a, b in pairwise(ids))
    assert first.header == bytes([2, 0x82 | first.frame_id])
    ends = [frame["ended_s"] for frame in camera.do("log")["frames"]]
    assert np.diff(ends) == pytest.approx(0.04, abs=1e-6)


def test_gain_is_in_sixteenths(build):
    camera, host = build()
    host.set(GAIN, 24)
    host.start()
    settled(host)
    assert camera.do("log")["frames"][-1]["gain"] == 2.5
    assert np.array_equal(host.luma(ROWS, COLUMNS), expected(0.01, 2.5))


def test_an_exposure_ends_with_its_slot_whatever_is_read_back(build):
    camera, host = build()
    host.set(TIME, 5000)
    host.start()
    settled(host)
    assert host.ask(TIME) == 5000
    assert camera.do("log")["frames"][-1]["time_s"] == 0.02


@pytest.mark.parametrize(("control", "value"), [(WHITE_AUTO, 1), (BACKLIGHT, 2), (BRIGHTNESS, 150)])
def test_what_is_left_on_shows(build, control, value):
    _, host = build()
    host.set(control, value)
    host.start()
    settled(host, 8)
    assert not np.array_equal(host.luma(ROWS, COLUMNS), expected(0.01))


def test_automatic_exposure_meters_and_may_slow_down(build):
    camera, host = build(scene="uniform")
    host.set(MODE, 8)
    host.start()
    settled(host, 20)
    level = host.luma(ROWS, COLUMNS).mean() / 255
    frames = camera.do("log")["frames"]
    assert level == pytest.approx(0.46, abs=0.04)
    assert 0.0002 < frames[-1]["time_s"] < 0.02
    assert len({frame["time_s"] for frame in frames}) > 1
    assert frames[-1]["slot"] - frames[-2]["slot"] == 1
    host.set(PRIORITY, 1)
    settled(host, 4)
    frames = camera.do("log")["frames"]
    assert frames[-1]["slot"] - frames[-2]["slot"] == 2


def test_freezing_and_thawing(build):
    camera, host = build()
    host.start()
    settled(host)
    camera.do("freeze")
    with pytest.raises(usb.core.USBTimeoutError):
        settled(host, 2, timeout=200)  # one may have been on its way
    camera.do("thaw")
    host.payload()


def test_wrong_light_for_so_many_frames(build):
    camera, host = build()
    host.start()
    settled(host)
    camera.do("wrong", factor=2.0, count=2)
    seen = [host.luma(ROWS, COLUMNS) for _ in range(8)]
    right, wrong = expected(0.01), expected(0.02)
    assert sum(np.array_equal(each, wrong) for each in seen) == 2
    assert sum(np.array_equal(each, right) for each in seen) == 6
    log = [frame for frame in camera.do("log")["frames"] if frame["light"] == 2]
    assert [frame["time_s"] for frame in log] == [0.01, 0.01]


def test_half_a_frame_and_rubbish(build):
    camera, host = build()
    host.start()
    settled(host)
    whole = ROWS * COLUMNS * 2
    camera.do("truncate")
    sizes = [len(host.payload().data) for _ in range(5)]
    assert sorted(sizes)[:2] == [whole // 2 - 1, whole]
    camera.do("garbage")
    headers = [bytes(host.usb.read(0x81, 512, 1000)[:1]) for _ in range(5)]
    assert sum(header != b"\x02" for header in headers) == 1
    camera.do("truncate", count=100)
    camera.do("ok")
    assert len({len(host.payload().data) for _ in range(3)} - {whole}) <= 1


def test_a_slow_host_loses_whole_frames_and_is_told_in_the_state(build):
    camera, host = build()
    host.start()
    settled(host)
    time.sleep(0.2)
    assert camera.do("state")["late"] >= 5
    ids = [host.payload().frame_id for _ in range(4)]
    assert all(a != b for a, b in pairwise(ids))


def test_stopping_does_not_wait_for_a_frame_and_starting_again_begins_at_slot_0(build):
    camera, host = build(fps=100)
    for _ in range(10):
        host.start()
        host.payload()
        began = time.monotonic()
        host.stop()
        assert time.monotonic() - began < 0.5
        assert camera.pending(1) == 0
    assert not camera.do("state")["is_streaming"]
    host.start()
    host.payload()
    assert camera.do("log")["frames"][0]["slot"] == 0


def test_unplugging_in_the_middle_of_a_frame(build):
    camera, host = build()
    host.start()
    settled(host)
    camera.do("unplug")
    with pytest.raises(usb.core.USBError) as info:
        host.payload()
    assert info.value.errno == 19
    assert not camera.do("state")["is_streaming"]


def test_another_delay_from_the_next_stream_on(build):
    camera, host = build(delay=1)
    camera.do("delay", frames=4)
    host.start()
    settled(host, 8)
    host.set(TIME, 30)
    settled(host, 8)
    log = camera.do("log")
    slot = next(frame["slot"] for frame in log["frames"] if frame["time_s"] == 0.003)
    assert slot - log["writes"][-1]["upcoming"] == 4
