"""The effective camera, live, through the kernel: a UVC camera's cycle, and v4l2loopback."""

from __future__ import annotations

import os
import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path

import cv2
import guest_processes as guest
import numpy as np
import pytest
import virtual_devices as rig
from numpy.typing import NDArray

import camctl
from camctl.cli import main
from camctl.drivers.v4l2.loopback import LoopbackDevice
from camctl.errors import StorageError
from camctl.interface.cycle import CyclingCamera

NODE, SHAPE = Path("/dev/video40"), (48, 64)
SETTINGS = (0.002, 0.008, 0.032)

Picture = NDArray[np.uint8]


class NoPictureError(Exception):
    """Nobody writes."""


@pytest.fixture(scope="module")
def loopback() -> Path:
    """The node of v4l2loopback, to which a program writes and from which others read."""
    module = os.environ.get("CAMCTL_LOOPBACK_MODULE")
    if module is None:
        pytest.skip("no module v4l2loopback: apt-get install gcc make")
    rig.modprobe("videodev")
    options = ("video_nr=40", "exclusive_caps=1", "card_label=camctl")
    subprocess.run(["insmod", module, *options], check=True)
    guest.wait_for("node of v4l2loopback", NODE.exists)
    return NODE


@contextmanager
def written(path: Path, picture: Picture) -> Iterator[None]:
    """Write a picture again and again."""
    is_over = threading.Event()
    device = LoopbackDevice(str(path), SHAPE)

    def write() -> None:
        while not is_over.wait(0.02):
            device.write(picture)

    thread = threading.Thread(target=write)
    thread.start()
    try:
        yield
    finally:
        is_over.set()
        thread.join()
        device.close()


def by_opencv(path: Path) -> Picture:
    """Return a picture, R, G and B, as OpenCV's own class reads it."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_V4L2)
    try:
        found, picture = capture.read()
        if not found:
            raise NoPictureError(path)
    finally:
        capture.release()
    return np.asarray(picture[..., ::-1], np.uint8)


def by_ffmpeg(path: Path) -> Picture:
    """Return a picture, R, G and B, as ffmpeg reads it."""
    if shutil.which("ffmpeg") is None:
        pytest.skip("ffmpeg is missing: apt-get install ffmpeg")
    command = ["ffmpeg", "-v", "error", "-f", "v4l2", "-i", str(path), "-frames:v", "1"]
    command += ["-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    done = subprocess.run(
        command, capture_output=True, check=True, stdin=subprocess.DEVNULL, timeout=60
    )
    return np.frombuffer(done.stdout, np.uint8).reshape(*SHAPE, 3)


READERS = pytest.mark.parametrize("read", [by_opencv, by_ffmpeg])


@READERS
def test_foreign_programs_read_the_picture_that_is_written(
    loopback: Path, read: Callable[[Path], Picture]
) -> None:
    grey = np.linspace(0, 255, SHAPE[1], dtype=np.uint8)
    with written(loopback, np.tile(grey, (SHAPE[0], 1))):
        (found,) = guest.wait_for("picture", lambda: _read(read, loopback))
    found = found.astype(int)
    assert found.shape == (*SHAPE, 3)
    # Rounded to limited range and back.
    np.testing.assert_allclose(found, np.broadcast_to(grey[:, None], found.shape), atol=3)


@READERS
def test_camctl_live_is_a_webcam(loopback: Path, read: Callable[[Path], Picture]) -> None:
    words = ["live", "--scene", "ramp", "-O", "size=64x48", "--base", "0.002"]
    words += ["--ratios", "1,4,16", "--range", "256", "--output", f"v4l2:{loopback}"]
    running = guest.spawner().start(main, words)
    try:
        (picture,) = guest.wait_for("picture", lambda: _read(read, loopback, running))
    finally:
        running.terminate()
    assert running.status == 143, running.err
    with camctl.open_camera("sim", scene="ramp", size="64x48") as camera:
        request = camctl.CaptureRequest(base_s=0.002, ratios=(1, 4, 16), dynamic_range=256)
        image = camctl.capture(camera, request).image() / 257
    # The mean of a column has little noise.
    difference = picture.mean((0, 2)) - image.mean(0)
    assert np.abs(difference).max() < 8


def _read(
    read: Callable[[Path], Picture], path: Path, running: guest.Forked | None = None
) -> list[Picture]:
    """Return a picture, or nothing before the program that writes has begun."""
    if running is not None:
        assert running.status is None, running.err
    try:
        return [read(path)]
    except (NoPictureError, subprocess.SubprocessError):
        return []


def test_a_device_that_takes_no_pictures_is_one_line(
    hub: rig.RecordingHub, loopback: Path, tmp_path: Path
) -> None:
    camera = rig.video_node(rig.WEB)
    assert camera is not None
    for path, shown in (
        (tmp_path / "video", "No such file"),
        (camera, "is a camera, and takes no pictures"),
        (Path("/dev/null"), "takes no pictures"),
    ):
        with pytest.raises(StorageError, match=shown) as caught:
            LoopbackDevice(str(path), SHAPE)
        assert "\n" not in str(caught.value)
    with written(loopback, np.zeros(SHAPE, np.uint8)):
        with pytest.raises(StorageError) as caught:
            LoopbackDevice(str(loopback), (24, 32))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("device", [rig.WEB, rig.MACHINE], ids=lambda device: device.name)
def test_each_frame_of_a_cycle_has_its_exposure(hub: rig.RecordingHub, device: rig.Device) -> None:
    """These cameras repeat their noise: a frame depends on its exposure alone."""
    with rig.open_device(device) as camera:
        assert isinstance(camera, CyclingCamera)
        settings = [rig.setting(camera, time_s) for time_s in SETTINGS]
        shot = {frame.applied: frame.pixels for frame in camera.shoot(settings)}
        cycle = camera.cycle(settings)
        frames = list(islice(cycle, 12))
        cycle.exchange(settings[:2])
        frames += islice(cycle, 10)
        cycle.close()
    for frame in frames:
        np.testing.assert_array_equal(frame.pixels, shot[frame.applied])
    assert [frame.applied for frame in frames[:12]] == [*shot] * 4
    assert {frame.applied for frame in frames[-4:]} == {*shot} - {frames[2].applied}


def test_results_of_a_uvc_camera_are_live(hub: rig.RecordingHub) -> None:
    request = camctl.CaptureRequest(base_s=0.002, ratios=(1, 4, 16), dynamic_range=256)
    with rig.open_device(rig.WEB) as camera:
        total = sum(
            frame.pixels.astype(int)
            for frame in camera.shoot([rig.setting(camera, time_s) for time_s in SETTINGS])
        )
        with camctl.live(camera, request, fps=15, policy="all") as results:
            some = list(islice(results, 12))
    for each in some:
        np.testing.assert_array_equal(each.sum, total)
    assert [each.number for each in some] == list(range(12))


def test_the_stream_goes_on_after_the_camera_was_unplugged(hub: rig.RecordingHub) -> None:
    request = camctl.CaptureRequest(base_s=0.002, ratios=(1, 4, 16), dynamic_range=256)
    with (
        rig.open_device(rig.WEB) as camera,
        camctl.live(camera, request, fps=15, policy="all") as results,
    ):
        first = list(islice(results, 6))
        rig.unplug(hub, rig.WEB)
        thread = threading.Timer(1.0, lambda: hub.do(rig.WEB.name, "plug"))
        thread.start()
        more = list(islice(results, 6))
        thread.join()
    np.testing.assert_array_equal(more[-1].sum, first[-1].sum)
