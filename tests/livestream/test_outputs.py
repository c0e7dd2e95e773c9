"""Where live results go: pipes, files, a page and a webcam."""

from __future__ import annotations

import ctypes
import errno
import io
import json
import os
import shutil
import subprocess
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import OpenEXR
import pytest
from browser import browser
from numpy.typing import NDArray
from site_client import ask_site

import camctl
from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.loopback import LoopbackDevice
from camctl.errors import StorageError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.livestream.display import Display
from camctl.livestream.outputs import ExrOutput, RawOutput, Y4mOutput, ycbcr
from camctl.livestream.result import LiveResult
from camctl.livestream.stream import Live
from camctl.livestream.web import WebOutput, live_site

GIVEN = CaptureRequest(base_s=0.002, ratios=(1, 4, 16), dynamic_range=256)


@contextmanager
def stream(sensor: str = "standard", **options: Any) -> Iterator[Live]:
    chosen = {"scene": "ramp", "size": "64x48", "sensor": sensor, **options}
    with camctl.open_camera("sim", chosen) as camera, camctl.live(camera, GIVEN) as live:
        yield live


def result(sensor: str = "standard") -> LiveResult:
    with stream(sensor) as live:
        return next(live)


@pytest.mark.parametrize(
    ("sensor", "shape"), [("standard", (48, 64)), ("webcam", (48, 64, 3)), ("phone", (24, 32, 3))]
)
def test_pictures_are_those_of_the_camera_s_colours(sensor: str, shape: tuple[int, ...]) -> None:
    one = result(sensor)
    for look in (False, True):
        picture = Display(look=look).picture(one)
        assert picture.shape == shape
        assert picture.max() > picture.min()
    assert Display(most=16).picture(one).shape[:2] <= (16, 16)


def test_the_mapping_for_looking_follows_slowly() -> None:
    display = Display(look=True)
    with stream() as live:
        first = next(live)
        before = display.picture(first).astype(float).mean()
        first._tables = tuple(  # ten times the light at once
            replace(each, E=each.E * 10, irradiance=each.irradiance * 10) for each in first._tables
        )
        first.time_s += 1 / 30
        after = display.picture(first).astype(float).mean()
        steady = Display(look=True).picture(first).astype(float).mean()
    assert abs(steady - before) < 0.2 * before  # another scene of that light looks alike
    assert after > 1.3 * before  # but the change is not undone within a frame


def test_raw_samples_are_the_desired_response() -> None:
    one, out = result(), io.BytesIO()
    RawOutput(out).write(one)
    assert np.array_equal(np.frombuffer(out.getvalue(), "<u2").reshape(48, 64), one.image)


@pytest.mark.parametrize("kind", ["raw", "y4m"])
def test_a_full_disk_is_an_error_that_says_so(kind: str) -> None:
    with Path("/dev/full").open("wb", buffering=0) as full, stream() as live:
        output = RawOutput(full) if kind == "raw" else Y4mOutput(full, Display(), live)
        with pytest.raises(StorageError, match="the disk is full"):
            output.write(next(live))


@pytest.mark.parametrize(("sensor", "samples"), [("standard", 1), ("webcam", 3)])
def test_a_pipe_has_y4m(sensor: str, samples: int) -> None:
    out = io.BytesIO()
    with stream(sensor) as live:
        output = Y4mOutput(out, Display(), live)
        for _ in range(3):
            output.write(next(live))
    head, _, rest = out.getvalue().partition(b"\n")
    assert head.split()[:4] == [b"YUV4MPEG2", b"W64", b"H48", b"F30:1"]
    assert len(rest) == 3 * (len(b"FRAME\n") + 48 * 64 * samples)


@pytest.mark.parametrize("base_s", [0.0005, 0.002, 0.004, 0.006])
@pytest.mark.parametrize("sensor", ["standard", "phone"])
def test_the_rate_of_a_pipe_is_that_of_the_stream(sensor: str, base_s: float) -> None:
    """Frames take a frame interval, or their exposure, which is up to 96 ms here."""
    options = {"scene": "ramp", "size": "64x48", "sensor": sensor}
    request, out = CaptureRequest(base_s=base_s, ratios=(1, 4, 16), dynamic_range=256), io.BytesIO()
    with camctl.open_camera("sim", options) as camera, camctl.live(camera, request) as live:
        results = [next(live) for _ in range(31)]  # ten rounds
        Y4mOutput(out, Display(), live).write(results[-1])
    taken = results[-1].time_s - results[0].time_s
    above, below = out.getvalue().split()[3][1:].split(b":")
    assert int(above) / int(below) == pytest.approx(30 / taken, rel=1e-6)


@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="apt-get install ffmpeg")
@pytest.mark.parametrize("sensor", ["standard", "webcam"])
def test_ffmpeg_reads_the_pipe(sensor: str) -> None:
    out = io.BytesIO()
    with stream(sensor) as live:
        display = Display()
        output = Y4mOutput(out, display, live)
        pictures = [np.array(display.picture(one)) for one in (next(live), next(live))]
        output.write(next(live))
    format_ = "gray" if sensor == "standard" else "rgb24"
    done = subprocess.run(
        ["ffmpeg", "-v", "error", "-i", "-", "-pix_fmt", format_, "-f", "rawvideo", "-"],
        input=out.getvalue(),
        capture_output=True,
        check=True,
    )
    shown = np.frombuffer(done.stdout, np.uint8).reshape(pictures[0].shape)
    assert np.abs(shown.astype(int) - pictures[0]).mean() < 4


def test_every_kth_result_is_a_file(tmp_path: Path) -> None:
    with stream() as live:
        output = ExrOutput(tmp_path / "some", every=3)
        some = [next(live) for _ in range(7)]
        for one in some:
            output.write(one)
    names = sorted(path.name for path in (tmp_path / "some").iterdir())
    assert names == ["000000.exr", "000003.exr", "000006.exr"]
    file = OpenEXR.File(str(tmp_path / "some" / "000003.exr"), separate_channels=True)
    channels = file.channels()
    assert np.array_equal(channels["Y"].pixels, some[3].irradiance)
    assert np.array_equal(channels["mask.Y"].pixels, some[3].mask)
    with pytest.raises(StorageError):
        ExrOutput(tmp_path / "some")


# ---- the page


@contextmanager
def served(token: str = "", **options: Any) -> Iterator[WebOutput]:
    with stream(time="real", **options) as live:
        output = WebOutput(live, live_site("0", token))
        ends = threading.Event()

        def show() -> None:
            for one in live:
                output.write(one)
                if ends.is_set():
                    break

        thread = threading.Thread(target=show)
        thread.start()
        try:
            while not output.jpeg:
                time.sleep(0.01)
            yield output
        finally:
            ends.set()
            thread.join()
            output.close()


def ask(output: WebOutput, path: str = "", **headers: str) -> tuple[int, bytes]:
    return ask_site(output.site.url + path, headers=headers)


def test_the_page_has_picture_histogram_and_exposures() -> None:
    with served() as output:
        assert ask(output)[0] == 200
        assert ask(output, "picture.jpg")[1][:2] == b"\xff\xd8"
        state = json.loads(ask(output, "state")[1])
        times = [each["time_s"] for each in state["exposures"]]
        assert times == pytest.approx([0.002, 0.008, 0.032])
        assert sum(state["histogram"]) == pytest.approx(1)
        assert state["latency_s"] < 5
        assert ask(output, "other")[0] == 404
        assert ask(output, Host="other.example")[0] == 403


def test_the_page_says_while_the_camera_is_waited_for() -> None:
    with served() as output:
        states = []
        for is_waiting in (False, True):
            output._live.is_waiting = is_waiting
            states.append(json.loads(ask(output, "state")[1])["waiting"])
    assert states == [False, True]


def decoded(data: bytes) -> NDArray[np.uint8]:
    import cv2

    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE), np.uint8)


def test_one_picture_is_of_the_next_result_and_others_are_not_compressed() -> None:
    """Each result is a grey of its own: 8 for the first, 16 for the next one."""
    with stream() as live:
        display = Display()
        output = WebOutput(live, live_site("0", ""), display)
        made: list[int] = []

        def grey(one: LiveResult) -> NDArray[np.uint8]:
            made.append(one.number)
            return np.full((48, 64), 8 * (one.number + 1), np.uint8)

        with mock.patch.object(display, "picture", grey), closing(output):
            for _ in range(20):
                output.write(next(live))
            assert made == [0]
            answers: list[tuple[int, bytes]] = []
            asking = threading.Thread(target=lambda: answers.append(ask(output, "picture.jpg")))
            asking.start()
            ends = time.monotonic() + 20
            while not output.viewers and time.monotonic() < ends:
                time.sleep(0.01)
            output.write(next(live))
            asking.join()
            assert answers[0][0] == 200
            assert np.abs(decoded(answers[0][1]).astype(int) - 8 * 21).max() <= 2
            assert (made, output.viewers) == ([0, 20], 0)
            with mock.patch("camctl.livestream.web._SILENCE_S", 0.1):
                assert ask(output, "picture.jpg")[0] == 503  # an old one is not called new


def test_the_page_of_a_live_camera_needs_its_token() -> None:
    with served("secret-of-this-page") as output:
        assert ask(output, "state")[0] == 403
        assert ask(output, "state?token=wrong")[0] == 403
        assert ask(output, "state?token=secret-of-this-page")[0] == 200
        assert ask(output, "video")[0] == 403
        assert ask(output, "state", Cookie="camctl_token=secret-of-this-page")[0] == 200


@pytest.mark.parametrize("address", ["x", "99999", "0.0.0.0:8080"])
def test_addresses_that_others_reach_are_refused(address: str) -> None:
    with pytest.raises(UsageError):
        live_site(address, "")


def test_opencv_and_a_lost_reader_take_the_stream() -> None:
    import cv2

    with served() as output:
        with urllib.request.urlopen(output.site.url + "video", timeout=20) as answer:
            first = answer.read(4096)
        assert b"Content-Type: image/jpeg" in first
        capture = cv2.VideoCapture(output.site.url + "video")
        found, picture = capture.read()
        capture.release()
        assert found
        assert picture.shape == (48, 64, 3)
        ends = time.monotonic() + 20
        while output.viewers and time.monotonic() < ends:
            time.sleep(0.05)
        assert output.viewers == 0


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("chromedriver") is None, reason="apt-get install chromium chromium-driver"
)
def test_chromium_shows_the_page() -> None:
    with served() as output, browser("--window-size=1280,800") as call:
        call("POST", "url", url=output.site.url)
        script = (
            "const video = document.getElementById('video'); return [video.naturalWidth, "
            "document.querySelectorAll('#exposures tr').length, "
            "document.querySelectorAll('#histogram rect').length, "
            "document.getElementById('note').textContent];"
        )
        ends = time.monotonic() + 30
        while time.monotonic() < ends:
            width, rows, bars, note = call("POST", "execute/sync", script=script, args=[])
            if width and rows:
                break
            time.sleep(0.2)
    assert (width, rows, note) == (64, 3, "")
    assert bars > 60


# ---- the webcam


class FakeOutput:
    """A v4l2loopback device: takes a format and pictures."""

    def __init__(self, *, is_output: bool = True, fixed: tuple[int, int] | None = None) -> None:
        self.is_output, self.fixed = is_output, fixed
        self.pictures: list[NDArray[np.uint8]] = []
        self.is_open = False
        self.error: int | None = None

    def open(self, path: str) -> int:
        if self.error is not None:
            raise OSError(self.error, os.strerror(self.error))
        self.is_open = True
        return 3

    def ioctl(self, descriptor: int, request: abi.Request, argument: ctypes.Structure) -> None:
        if isinstance(argument, abi.Capability):
            argument.device_caps = 2 if self.is_output else 1
        elif isinstance(argument, abi.Format) and self.fixed is not None:
            argument.width, argument.height = self.fixed

    def map(self, descriptor: int, offset: int, length: int) -> NDArray[np.uint8]:
        raise NotImplementedError

    def wait(self, descriptor: int, timeout_s: float) -> bool:
        raise NotImplementedError

    def write(self, descriptor: int, data: NDArray[np.uint8]) -> None:
        self.pictures.append(data.copy())

    def close(self, descriptor: int) -> None:
        self.is_open = False


def test_a_webcam_gets_yuyv_of_limited_range_as_opencv_takes_it() -> None:
    cv2 = pytest.importorskip("cv2")
    kernel = FakeOutput()
    device = LoopbackDevice("/dev/video9", (4, 129), kernel)
    grey = np.tile(np.arange(129, dtype=np.uint8) * 2, (4, 1))
    device.write(grey)
    pairs = np.repeat(grey[:, ::2], 2, axis=1)[:, :129]  # of two pixels one has a colour
    colour = np.stack([pairs, 255 - pairs, pairs // 2 + 60], axis=-1)
    device.write(ycbcr(colour))
    device.close()
    assert not kernel.is_open
    for given, written in zip((grey[..., None], colour), kernel.pictures, strict=True):
        assert written.shape == (4, 128, 2)
        found = cv2.cvtColor(written, cv2.COLOR_YUV2RGB_YUYV).astype(int)
        assert np.abs(found - given[:, :128]).max() <= 4


def test_a_webcam_that_takes_no_pictures_is_one_line() -> None:
    for kernel in (FakeOutput(is_output=False), FakeOutput(fixed=(640, 480))):
        with pytest.raises(StorageError):
            LoopbackDevice("/dev/video9", (4, 8), kernel)
        assert not kernel.is_open
    for number in (errno.ENOENT, errno.EBUSY, errno.EACCES):
        kernel = FakeOutput()
        kernel.error = number
        with pytest.raises(StorageError):
            LoopbackDevice("/dev/video9", (4, 8), kernel)
