"""Cameras that OpenCV reads: a network camera, a video file, and webcams of other systems."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mjpg_server import SHAPE, NetworkCamera, network_camera, picture

from camctl.captures.sequencer import capture
from camctl.drivers.opencv import video
from camctl.drivers.opencv.backend import OpencvBackend
from camctl.drivers.opencv.camera import OpencvCamera, OpencvOptions
from camctl.drivers.opencv.controls import PropertyExposure
from camctl.drivers.opencv.video import Address, Video
from camctl.errors import (
    CamctlError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraTimeoutError,
    RefusedSettingError,
    UsageError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.interface.backends import is_local
from camctl.interface.camera import Camera, Frame
from camctl.interface.clock import RealClock
from camctl.interface.controls import Choices, ExposureSetting, Layout, ResponseOrigin, Steps
from camctl.testing.conformance import CameraConformance


@pytest.fixture(autouse=True)
def profiles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


@pytest.fixture
def server() -> Iterator[NetworkCamera]:
    with network_camera() as running:
        yield running


def open_network_camera(server: NetworkCamera, **options: Any) -> OpencvCamera:
    chosen = {"response": "linear", "shortest": 1e-4, "longest": 5e-3, **options}
    return OpencvCamera(server.url + "?us={us}", OpencvOptions.parse(chosen)).open()


class TestConformance(CameraConformance):
    run_length = 30  # each frame takes real time

    @pytest.fixture(autouse=True)
    def _server(self, server: NetworkCamera, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(video, "SILENCE_MS", 2000)
        self.server = server

    def open_camera(self) -> Camera:
        return open_network_camera(self.server)

    def middle_s(self, camera: Camera) -> float:
        return 1e-3

    def unplug(self, camera: Camera) -> None:
        self.server.frames = 0

    def silence(self, camera: Camera) -> None:
        self.server.is_silent = True

    def is_lossy(self, camera: Camera, frame: Frame) -> bool:
        return True  # Motion JPEG

    def in_force(self, camera: Camera) -> ExposureSetting:
        return ExposureSetting(self.server.requested[-1] / 1e6)


class TestNetworkStream:
    @pytest.mark.parametrize("old", [0, 1, 5])
    def test_frames_have_the_exposure_of_the_address(self, server: NetworkCamera, old: int) -> None:
        server.old = old
        times_s = (4e-3, 2e-4, 1e-3, 1e-3)
        with open_network_camera(server) as camera:
            assert (camera.controls.shape, camera.controls.layout) == (SHAPE, Layout.RGB)
            for frame in camera.shoot([ExposureSetting(time_s) for time_s in times_s]):
                difference = frame.pixels.astype(int) - picture(frame.applied.time_s * 1e6)
                assert np.abs(difference).max() <= 2  # of JPEG
        assert server.requested[1:] == [4000, 200, 1000]

    def test_a_whole_capture(self, server: NetworkCamera) -> None:
        request = CaptureRequest("linear", ratios=(1.0, 2.0, 4.0), base_s=0.0005)
        with open_network_camera(server) as camera:
            report = capture(camera, request)
        assert report.status == "complete"
        assert report.trustworthy

    def test_what_it_cannot_know_is_noted(self, server: NetworkCamera) -> None:
        with open_network_camera(server) as camera:
            notes = " ".join(camera.controls.notes)
            assert camera.controls.response_origin is ResponseOrigin.STATED  # by an option
        assert "cannot be read back" in notes
        assert "neither time nor exposure of a frame" in notes
        with OpencvCamera(server.url).open() as camera:
            assert "cannot be set; it is unknown" in camera.controls.notes[0]
            assert camera.controls.response_origin is ResponseOrigin.ASSUMED
        with OpencvCamera(server.url, OpencvOptions(time=0.01)).open() as camera:
            assert camera.controls.time_s == Choices((0.01,))

    def test_a_stream_that_ends(self, server: NetworkCamera) -> None:
        server.frames = 4
        with OpencvCamera(server.url, OpencvOptions(time=0.01)).open() as camera:
            frames = camera.shoot([ExposureSetting(0.01)] * 20)
            with pytest.raises(CameraDisconnectedError, match="ended; check the URL"):
                list(frames)

    def test_a_silent_stream(self, server: NetworkCamera, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(video, "SILENCE_MS", 800)
        with OpencvCamera(server.url, OpencvOptions(time=0.01)).open() as camera:
            server.is_silent = True
            with pytest.raises(CameraTimeoutError, match=r"no frame from opencv:http\S+ for \d+ s"):
                list(camera.shoot([ExposureSetting(0.01)] * 1000))

    def test_a_video_file(self, tmp_path: Path) -> None:
        path = str(tmp_path / "stream.avi")
        code = cv2.VideoWriter.fourcc(*"MJPG")
        writer = cv2.VideoWriter(path, code, 20.0, (SHAPE[1], SHAPE[0]))
        for _ in range(12):
            writer.write(picture(800))
        writer.release()
        with OpencvCamera(path, OpencvOptions(time=0.02)).open() as camera:
            assert camera.controls.frame_interval_s == pytest.approx(0.05)
            frames = list(camera.shoot([ExposureSetting(0.02)] * 5))
        assert np.abs(frames[4].pixels.astype(int) - picture(800)).max() < 12


class TestBadInput:
    @pytest.mark.parametrize(
        ("address", "options", "kind", "message"),
        [
            ("", {}, UsageError, "needs an address; give an index, a URL or a GStreamer pipeline"),
            ("nothing.avi", {}, CameraNotFoundError, "OpenCV cannot open nothing.avi; check the"),
            ("http://127.0.0.1:9/", {}, CameraNotFoundError, "OpenCV cannot open http://127"),
            ("97", {}, CameraNotFoundError, "OpenCV cannot open 97; check that the camera is"),
            ("a ! appsink", {}, CameraError, "was built without GStreamer"),
            ("x", {"fps": "3"}, UsageError, "unknown camera option 'fps'"),
            ("x", {"shortest": "0"}, UsageError, "shortest=0; input should be greater than 0"),
            ("x", {"settle": "0"}, UsageError, "settle=0; input should be greater than or equal"),
            ("x", {"size": "5"}, UsageError, "size=5; write WIDTHxHEIGHT"),
            ("x", {"response": "log"}, UsageError, "unknown camera response 'log'"),
        ],
    )
    def test_one_line(
        self, address: str, options: dict[str, str], kind: type[CamctlError], message: str
    ) -> None:
        with pytest.raises(kind) as caught:
            OpencvBackend().open(address, options)
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)

    def test_place_for_the_exposure_without_its_range(self, server: NetworkCamera) -> None:
        with pytest.raises(UsageError, match="needs its range") as caught:
            OpencvCamera(server.url + "?us={us}").open()
        assert caught.value.remedies.keys() == {"option:shortest", "option:longest"}

    def test_nothing_is_printed(self, capfd: pytest.CaptureFixture[str]) -> None:
        with pytest.raises(CameraNotFoundError):
            OpencvCamera("http://127.0.0.1:9/none").open()
        assert capfd.readouterr() == ("", "")

    def test_only_indices_are_devices_of_this_machine(self) -> None:
        assert is_local("opencv:0", {})
        assert not any(is_local(f"opencv:{each}", {}) for each in ("http://a/", "a.avi", "a ! b"))


def test_exposure_in_an_address_has_microseconds_milliseconds_or_seconds() -> None:
    address = Address.parse("x?us={us}&ms={ms}&s={s}")
    assert address.has_exposure
    assert address.at(0.001234) == "x?us=1234&ms=1.234&s=0.001234"
    assert address.at(0.000001) == "x?us=1&ms=0.001&s=1e-06"


class Webcam:
    """The `cv2.VideoCapture` of a webcam on another system."""

    def __init__(self, backend: str, lowest: float, highest: float, sticky: bool = False) -> None:
        self.backend, self.lowest, self.highest, self.sticky = backend, lowest, highest, sticky
        self.values: dict[int, float] = {cv2.CAP_PROP_FPS: 30.0, cv2.CAP_PROP_EXPOSURE: lowest}

    def isOpened(self) -> bool:  # noqa: N802
        return True

    def getBackendName(self) -> str:  # noqa: N802
        return self.backend

    def set(self, name: int, value: float) -> bool:
        if name == cv2.CAP_PROP_EXPOSURE:
            value = self.lowest if self.sticky else min(max(value, self.lowest), self.highest)
        self.values[name] = value
        return True

    def get(self, name: int) -> float:
        return self.values.get(name, -1.0)

    def release(self) -> None:
        pass


def webcam_exposure(monkeypatch: pytest.MonkeyPatch, webcam: Webcam) -> PropertyExposure:
    monkeypatch.setattr(cv2, "VideoCapture", lambda *_: webcam)
    return PropertyExposure(Video(Address.parse("0"), RealClock(), 0.01), 1 / 30)


class TestWebcamOfAnotherSystem:
    def test_logarithmic_exposures(self, monkeypatch: pytest.MonkeyPatch) -> None:
        webcam = Webcam("DSHOW", -11, -2)
        exposure = webcam_exposure(monkeypatch, webcam)
        assert exposure.times == Choices(tuple(2.0**power for power in range(-11, -4)))
        assert webcam.get(cv2.CAP_PROP_AUTO_EXPOSURE) == 0.25
        assert exposure.write(ExposureSetting(2**-7)) == ExposureSetting(2**-7)
        assert webcam.get(cv2.CAP_PROP_EXPOSURE) == -7

    def test_linear_exposures(self, monkeypatch: pytest.MonkeyPatch) -> None:
        exposure = webcam_exposure(monkeypatch, Webcam("V4L2", 3, 5000))
        assert exposure.times == Steps(0.0003, 0.0333, 0.0001)
        assert exposure.write(ExposureSetting(0.0123)).time_s == 0.0123

    def test_a_value_that_is_not_read_back_is_refused(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        webcam = Webcam("V4L2", 3, 5000)
        exposure = webcam_exposure(monkeypatch, webcam)
        webcam.highest = 50
        with pytest.raises(RefusedSettingError) as caught:
            exposure.write(ExposureSetting(0.01))
        assert caught.value.nearest == 0.005

    @pytest.mark.parametrize("backend", ["V4L2", "MSMF"])
    def test_an_exposure_that_does_not_change_is_refused(
        self, monkeypatch: pytest.MonkeyPatch, backend: str
    ) -> None:
        with pytest.raises(CameraError, match="the exposure of opencv:0 cannot be set"):
            webcam_exposure(monkeypatch, Webcam(backend, -6, -6, sticky=True))

    def test_a_backend_of_unknown_unit_is_refused(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with pytest.raises(CameraError, match="AVFOUNDATION, whose unit of exposure is not known"):
            webcam_exposure(monkeypatch, Webcam("AVFOUNDATION", 1, 2))
