"""The frames of the virtual webcam: slots, delays, automatic modes, formats and faults.

In virtual time: the host's reads let the time pass.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import usb.core
from numpy.typing import NDArray
from uvc_host import BACKLIGHT, BRIGHTNESS, GAIN, MODE, PRIORITY, TIME, WHITE_AUTO, Control, Host
from virtual_usb_bus import VirtualBackend

from camctl.interface.controls import Layout
from camctl.sim.devices.clock import DeviceClock, RealDeviceClock, VirtualDeviceClock
from camctl.sim.devices.common import VirtualSensor
from camctl.sim.devices.uvc.camera import UvcCamera, make
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

ROWS, COLUMNS = 12, 16
FRAME_S = 0.02
APERTURE_PRIORITY = 8
BASE: dict[str, Any] = {
    "scene": "ramp",
    "sensor": "standard",
    "seed": 5,
    "size": f"{COLUMNS}x{ROWS}",
    "repeat_noise": True,
    "formats": ["yuyv"],
    "luma": "full",
    "fps": 1 / FRAME_S,
    "delay": 1,
}
SETTLED = 6  # frames until the settings at the start are in force


def connected(clock: DeviceClock | None = None, **config: Any) -> tuple[UvcCamera, Host]:
    """Return a webcam with all automatic modes off, 0.01 s, and its host."""
    camera = make({**BASE, **config}, clock if clock is not None else VirtualDeviceClock())
    host = Host(VirtualBackend([camera]))
    host.set_manual()
    return camera, host


def streaming(**config: Any) -> tuple[UvcCamera, Host]:
    """Return a webcam as `connected` does, after the first frames of its stream."""
    camera, host = connected(**config)
    host.start()
    skip(host)
    return camera, host


def skip(host: Host, frames: int = SETTLED) -> None:
    for _ in range(frames):
        host.payload()


def sleep(camera: UvcCamera, time_s: float) -> None:
    camera.clock.sleep_until(camera.clock.now() + time_s)


def frames_of(camera: UvcCamera) -> list[dict[str, Any]]:
    frames: list[dict[str, Any]] = camera.do("log")["frames"]
    return frames


def expose(
    time_s: float, gain: float = 1.0, sensor: str | Path = "standard", scale: int = 1
) -> NDArray[Any]:
    """Return the picture that the webcam of `connected` takes."""
    scene = load_scene(BASE["scene"], (scale * ROWS, scale * COLUMNS))
    model = load_sensor(str(sensor))
    return VirtualSensor(scene, model, seed=5, repeat_noise=True).expose(time_s, gain)


@pytest.mark.parametrize(
    ("form", "sensor"), [("grey", "ideal-8"), ("y12", "machine-vision"), ("y16", "machine-vision")]
)
def test_grey_formats_hold_the_pixels_of_the_sensor(form: str, sensor: str) -> None:
    _, host = streaming(formats=[form], sensor=sensor)
    data = np.frombuffer(host.payload().data, np.uint8 if form == "grey" else "<u2")
    assert np.array_equal(data.reshape(ROWS, COLUMNS), expose(0.01, sensor=sensor))


def test_bayer_formats_hold_the_mosaic(tmp_path: Path) -> None:
    model = load_sensor("ideal-8").model_copy(update={"layout": Layout.RGGB})
    path = tmp_path / "bayer.json"
    path.write_text(model.model_dump_json())
    _, host = streaming(formats=["rggb8"], sensor=str(path))
    data = np.frombuffer(host.payload().data, np.uint8).reshape(ROWS, COLUMNS)
    assert np.array_equal(data, expose(0.01, sensor=path))


def test_limited_luma_is_mapped_to_16_to_235() -> None:
    _, host = streaming(luma="limited")
    expected = np.rint(16 + expose(0.01) * (219 / 255))
    assert np.array_equal(host.luma(ROWS, COLUMNS), expected)


def test_a_jpeg_is_near_the_pixels_of_the_sensor() -> None:
    scale = 4
    _, host = connected(formats=["yuyv", "mjpg"], size=f"{scale * COLUMNS}x{scale * ROWS}")
    host.start(form=2)
    skip(host)
    data = np.frombuffer(host.payload().data, np.uint8)
    picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    assert abs(picture.astype(int) - expose(0.01, scale=scale)).max() < 16


@pytest.mark.parametrize(("delay", "gain"), [(-1, None), (0, 2), (1, -1), (4, 0), (2, 5)])
def test_a_setting_written_in_slot_k_is_in_force_from_slot_k_plus_1_plus_delay(
    delay: int, gain: int | None
) -> None:
    camera, host = connected(delay=delay, gain_delay=gain)
    late = {"time_s": delay, "gain": delay if gain is None else gain}
    host.start()
    skip(host, 8)
    for ticks, register in ((30, 16), (120, 4), (60, 48)):
        host.payload()
        # In the middle of a slot, not at its beginning.
        sleep(camera, FRAME_S / 2)
        host.set(TIME, ticks)
        host.set(GAIN, register)
    skip(host, 9)
    log = camera.do("log")
    by_slot = {frame["slot"]: frame for frame in log["frames"]}
    for write in log["writes"][-5::2]:  # each control is a write of its own
        for name, value in late.items():
            in_force = write["upcoming"] + value
            assert by_slot[in_force][name] == write[name]
            assert by_slot[in_force - 1][name] != write[name]
    slots = [frame["slot"] for frame in log["frames"]]
    assert slots == list(range(slots[0], slots[0] + len(slots)))


def test_jitter_makes_the_delay_vary() -> None:
    camera, host = streaming(delay=1, jitter=2)
    delays = set()
    for ticks in range(20, 32):
        host.set(TIME, ticks)
        skip(host, 5)
        log = camera.do("log")
        slot = next(f["slot"] for f in log["frames"] if f["time_s"] == ticks / 10_000)
        delays.add(slot - log["writes"][-1]["upcoming"])
    assert delays == {1, 2, 3}


def test_frames_keep_their_rate_and_alternate_their_id() -> None:
    camera, host = connected(fps=[50, 25])
    host.start(interval=400_000)
    first = host.payload()
    began_s = camera.clock.now()
    ids = [first.frame_id] + [host.payload().frame_id for _ in range(10)]
    assert camera.clock.now() - began_s == pytest.approx(0.4)
    assert all(a != b for a, b in pairwise(ids))
    assert first.header == bytes([2, 0x82 | first.frame_id])
    assert np.diff([frame["ended_s"] for frame in frames_of(camera)]) == pytest.approx(0.04)


def test_gain_has_steps_of_a_sixteenth() -> None:
    camera, host = connected()
    host.set(GAIN, 24)
    host.start()
    skip(host)
    assert frames_of(camera)[-1]["gain"] == 2.5
    assert np.array_equal(host.luma(ROWS, COLUMNS), expose(0.01, 2.5))


def test_a_shutter_time_beyond_the_slot_is_read_back_but_cut() -> None:
    camera, host = connected()
    host.set(TIME, 5000)
    host.start()
    skip(host)
    assert host.get(TIME) == 5000
    assert frames_of(camera)[-1]["time_s"] == FRAME_S


@pytest.mark.parametrize(
    ("control", "value"),
    [(WHITE_AUTO, 1), (BACKLIGHT, 2), (BRIGHTNESS, 150)],
    ids=["white balance", "backlight", "brightness"],
)
def test_other_controls_change_the_picture(control: Control, value: int) -> None:
    _, host = connected()
    host.set(control, value)
    host.start()
    skip(host, 8)
    assert not np.array_equal(host.luma(ROWS, COLUMNS), expose(0.01))


def test_automatic_exposure_reaches_its_target() -> None:
    camera, host = connected(scene="uniform")
    host.set(MODE, APERTURE_PRIORITY)
    host.start()
    skip(host, 20)
    level = host.luma(ROWS, COLUMNS).mean() / 255
    frames = frames_of(camera)
    assert level == pytest.approx(0.46, abs=0.04)
    assert 0.0002 < frames[-1]["time_s"] < FRAME_S
    assert len({frame["time_s"] for frame in frames}) > 1


def test_automatic_exposure_with_priority_halves_the_frame_rate() -> None:
    camera, host = connected(scene="uniform")
    host.set(MODE, APERTURE_PRIORITY)
    host.start()
    skip(host, 4)
    first, second = frames_of(camera)[-2:]
    assert second["slot"] - first["slot"] == 1
    host.set(PRIORITY, 1)
    skip(host, 4)
    first, second = frames_of(camera)[-2:]
    assert second["slot"] - first["slot"] == 2


def test_a_frozen_camera_sends_no_frames_until_ok() -> None:
    camera, host = streaming()
    camera.do("freeze")
    with pytest.raises(usb.core.USBTimeoutError):
        host.payload(timeout_ms=60_000)
    camera.do("ok")
    host.payload()


def test_wrong_exposure_of_two_frames() -> None:
    camera, host = streaming()
    camera.do("wrong_exposure", factor=2.0, count=2)
    right, wrong = expose(0.01), expose(0.02)
    frames = [host.luma(ROWS, COLUMNS) for _ in range(8)]
    assert [np.array_equal(frame, wrong) for frame in frames] == [True] * 2 + [False] * 6
    assert [np.array_equal(frame, right) for frame in frames] == [False] * 2 + [True] * 6
    log = [frame for frame in frames_of(camera) if frame["light"] == 2]
    assert [frame["time_s"] for frame in log] == [0.01, 0.01]


def test_half_of_a_frame_is_sent() -> None:
    camera, host = streaming()
    whole = 2 + ROWS * COLUMNS * 2  # with the header
    camera.do("truncate")
    payloads = [host.payload() for _ in range(3)]
    sizes = [len(payload.header) + len(payload.data) for payload in payloads]
    assert sizes == [whole // 2, whole, whole]


def test_random_bytes_instead_of_a_frame() -> None:
    camera, host = streaming()
    camera.do("garbage")
    first_bytes = [bytes(host.usb.read(0x81, 512, 1000)[:1]) for _ in range(3)]
    assert [byte == b"\x02" for byte in first_bytes] == [False, True, True]


def test_a_slow_host_misses_whole_frames_and_the_state_counts_them() -> None:
    camera, host = streaming()
    sleep(camera, 10 * FRAME_S)
    assert camera.do("state")["late"] == 9
    ids = [host.payload().frame_id for _ in range(4)]
    assert all(a != b for a, b in pairwise(ids))


def test_each_start_begins_at_slot_0_without_old_frames() -> None:
    camera, host = connected(fps=100)
    for _ in range(10):
        host.start()
        host.payload()
        assert frames_of(camera)[0]["slot"] == 0
        host.stop()
        assert camera.pending(1) == 0
        assert not camera.do("state")["is_streaming"]
        sleep(camera, 1.0)
        assert camera.pending(1) == 0


def test_the_control_delay_can_be_changed_for_the_next_stream() -> None:
    camera, host = connected(delay=1)
    camera.do("delay", frames=4)
    host.start()
    skip(host, 8)
    host.set(TIME, 30)
    skip(host, 8)
    log = camera.do("log")
    slot = next(frame["slot"] for frame in log["frames"] if frame["time_s"] == 0.003)
    assert slot - log["writes"][-1]["upcoming"] == 4


def test_in_real_time_frames_are_sent_at_their_rate() -> None:
    camera, host = connected(RealDeviceClock())
    began_s = camera.clock.now()
    host.start()
    for _ in range(5):
        assert len(host.payload(timeout_ms=60_000).data) == ROWS * COLUMNS * 2
    assert camera.clock.now() - began_s >= 5 * FRAME_S
    camera.detach()
