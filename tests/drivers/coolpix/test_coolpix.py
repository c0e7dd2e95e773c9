"""The CoolPix driver on the virtual CoolPix; in virtual time unless a test says otherwise."""

from __future__ import annotations

import os
import select
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial
from coolpix_bench import coolpix_on, virtual_coolpix

from camctl.camera import Camera, Frame
from camctl.controls import Choices, Control, ExposureSetting, Layout
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
    UsageError,
)
from camctl.profile import StillRecord, change_profile, load_profile
from camctl.testing.conformance import CameraConformance
from drivers.common.still_file import read_still
from drivers.coolpix.backend import CoolpixBackend, probe_lines
from drivers.coolpix.camera import CoolpixCamera, CoolpixOptions
from drivers.coolpix.settings import CANDIDATES_US
from drivers.coolpix.sierra.packets import Action, Register
from sim.devices.clock import RealDeviceClock
from sim.devices.sierra.camera import RefusedError
from sim.devices.sierra.config import SHUTTER_US
from sim.devices.sierra.device import SierraDevice

pytestmark = pytest.mark.usefixtures("own_profiles")
SETTINGS = [ExposureSetting(0.002), ExposureSetting(0.008)]
TIMEOUT_S = 12.0  # of the driver, unless it is given another


@pytest.fixture
def device() -> Iterator[SierraDevice]:
    with virtual_coolpix() as device:
        yield device


def shoot(camera: Camera, settings: Sequence[ExposureSetting] = SETTINGS) -> list[Frame]:
    with closing(camera.shoot(settings)) as frames:
        return list(frames)


def learn_format(camera: Camera) -> None:
    """Make the camera learn the format of its files, so that the next picture is a frame."""
    assert camera.controls.shape == (24, 32)


def do_once(camera: CoolpixCamera, method: str, argument: int, act: Callable[[], object]) -> None:
    """Call `act` just before the next call of `method` of the session with this argument."""
    sierra: Any = camera._body.sierra
    plain = getattr(sierra, method)

    def patched(first: int, *others: Any, **named: Any) -> Any:
        if first == argument:
            setattr(sierra, method, plain)
            act()
        return plain(first, *others, **named)

    setattr(sierra, method, patched)


def one_line(error: CameraError) -> str:
    """Return the text of an error, which is one line with a hint."""
    assert error.hint
    assert "\n" not in str(error)
    return str(error)


def choices(control: Control | None) -> tuple[float, ...]:
    assert isinstance(control, Choices)
    return control.values


def data_of(frame: Frame) -> bytes:
    assert frame.original is not None
    return frame.original.data


class TestConformanceTiff(CameraConformance):
    format = "tiff"

    @pytest.fixture(autouse=True)
    def _device(self, device: SierraDevice) -> None:
        self.device = device

    def open_camera(self) -> Camera:
        return coolpix_on(self.device, format=self.format)

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.01)

    def silence(self, camera: Camera) -> None:
        self.device.do("hang")

    def in_force(self, camera: Camera) -> ExposureSetting:
        exposure = self.device.do("state")["exposure"]
        return ExposureSetting(exposure["time_s"], exposure["gain"])


class TestConformanceJpeg(TestConformanceTiff):
    format = "jpeg"


class TestPictures:
    def test_a_picture_in_another_folder_is_found(self) -> None:
        """Register 10 counts the first folder on; registers 4 and 79 tell the new picture."""
        settings = [ExposureSetting(t) for t in (0.002, 0.008, 0.002, 0.004, 0.008)]
        with virtual_coolpix(folder_pictures=2) as device, coolpix_on(device) as camera:
            learn_format(camera)
            frames = shoot(camera, settings)
            assert device.camera.read(10) == 2
            stored = device.camera.pictures[-len(settings) :]
        assert [data_of(frame) for frame in frames] == [picture.data for picture in stored]

    def test_tiff_samples_are_those_of_the_sensor_and_the_file_is_kept(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device) as camera:
            frames = shoot(camera)
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)
            assert frame.original is not None
            assert frame.original.suffix == ".tif"
            assert data_of(frame) in [picture.data for picture in device.camera.pictures]
            assert np.array_equal(read_still(data_of(frame), "x.tif").pixels, frame.pixels)

    def test_jpeg_is_the_default(self, device: SierraDevice) -> None:
        with CoolpixCamera(device.line.path, clock=device.clock) as camera:
            (frame,) = shoot(camera, SETTINGS[1:])
            notes = "\n".join(camera.controls.notes)
        assert frame.original is not None
        assert frame.original.suffix == ".jpg"
        assert frame.details == {"name_on_card": device.camera.pictures[-1].name}
        assert "assumed to be sRGB" in notes
        assert "JPEG loses levels" in notes

    def test_only_times_that_are_read_back_unchanged_are_offered(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device) as camera:
            assert choices(camera.controls.time_s) == tuple(us / 1e6 for us in SHUTTER_US)

    def test_a_camera_that_accepts_all_times_offers_the_standard_ones(self) -> None:
        with virtual_coolpix(times_us=CANDIDATES_US) as device, coolpix_on(device) as camera:
            values = choices(camera.controls.time_s)
        assert values == tuple(us / 1e6 for us in CANDIDATES_US)

    def test_the_label_of_a_time_is_within_the_tolerance(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            (frame,) = shoot(camera, [ExposureSetting(1 / 60)])
        assert frame.requested.time_s == 1 / 60
        assert frame.applied.time_s == 0.016666

    def test_the_aperture_is_set_only_if_requested(self, device: SierraDevice) -> None:
        settings = [ExposureSetting(0.002), ExposureSetting(0.008, f_number=7.0), *SETTINGS[:1]]
        with coolpix_on(device) as camera:
            assert choices(camera.controls.f_number) == (2.5, 4.0, 7.0)
            plain, small, again = shoot(camera, settings)
            notes = "\n".join(camera.controls.notes)
        assert (plain.applied.f_number, small.applied.f_number) == (None, 7.0)
        assert np.array_equal(plain.pixels, again.pixels)
        light = device.body.sensor.expose(0.008 * (2.5 / 7.0) ** 2)
        assert np.array_equal(small.pixels[..., 0], light)
        assert "its apertures low, medium and high are assumed to be f/2.5, f/4, f/7" in notes
        assert "its aperture is set to f/2.5" in notes

    def test_notes_state_how_long_a_transfer_takes(self, device: SierraDevice) -> None:
        with coolpix_on(device, speed=9600) as camera:
            # 32 x 24 pixels of three bytes, 10 bits each on the line, at 9,600 bits a second
            assert "takes 2.4 s over the line at 9600 baud" in camera.controls.notes[0]
            record = StillRecord(
                rows=1536, columns=2048, layout=Layout.RGB, bits=8, black=0, white=255
            )
            change_profile(camera.info, lambda found: found.stills.update(tiff=record))
        with coolpix_on(device) as camera:
            assert "(tiff, about 9.4 MB) takes 14 minutes" in camera.controls.notes[0]

    def test_closing_restores_the_settings_of_the_camera(self, device: SierraDevice) -> None:
        before = device.do("state")
        with coolpix_on(device) as camera:
            shoot(camera)
        after = device.do("state")
        for what in ("shutter_us", "aperture", "quality", "speed", "session"):
            assert after[what] == before[what]

    def test_progress_is_reported(self, device: SierraDevice) -> None:
        reports: list[tuple[str, int, int]] = []
        with coolpix_on(device, progress=lambda *report: reports.append(report)) as camera:
            shoot(camera, SETTINGS[:1])
        name, received, size = reports[-1]
        assert name == device.camera.pictures[-1].name
        assert received == size == len(device.camera.pictures[-1].data)


class TestFileFormat:
    """The format of the frames is known before the first frame."""

    def test_a_new_camera_takes_one_test_picture(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            controls = camera.controls
            assert "was taken to learn the format of its files" in "\n".join(controls.notes)
            assert camera.controls.notes == controls.notes
        assert len(device.camera.pictures) == 1
        assert (controls.shape, controls.layout) == ((24, 32), Layout.RGB)

    def test_the_newest_picture_of_the_same_format_replaces_the_test_picture(
        self, device: SierraDevice, own_profiles: Path
    ) -> None:
        with coolpix_on(device) as camera:
            shoot(camera, SETTINGS[:1])
        taken = len(device.camera.pictures)
        for path in own_profiles.glob("*.json"):
            path.unlink()
        with coolpix_on(device) as camera:
            assert "was learnt from DSCN0002.TIF on its card" in "\n".join(camera.controls.notes)
        assert len(device.camera.pictures) == taken

    def test_a_picture_of_another_format_does_not(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            shoot(camera, SETTINGS[:1])
        with coolpix_on(device, format="jpeg") as camera:
            assert "was taken to learn" in "\n".join(camera.controls.notes)

    def test_the_profile_replaces_the_test_picture(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            info = camera.info
            shoot(camera, SETTINGS[:1])
        taken = len(device.camera.pictures)
        assert load_profile(info).stills["tiff"].columns == 32
        with coolpix_on(device) as camera:
            assert camera.controls.shape == (24, 32)
        assert len(device.camera.pictures) == taken

    def test_a_wrong_profile_is_corrected_and_the_frame_is_kept(self, device: SierraDevice) -> None:
        record = StillRecord(rows=1, columns=2, layout=Layout.RGB, bits=8, black=0, white=255)
        with coolpix_on(device) as camera:
            info = camera.info
        change_profile(info, lambda found: found.stills.update(tiff=record))
        with coolpix_on(device) as camera:
            assert camera.controls.shape == (1, 2)
            (frame,) = shoot(camera, SETTINGS[:1])
            assert frame.pixels.shape == (24, 32, 3)
            assert camera.controls.shape == (24, 32)
        assert load_profile(info).stills["tiff"].rows == 24

    def test_a_damaged_profile_is_noted(self, device: SierraDevice, own_profiles: Path) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
        (path,) = own_profiles.glob("*.json")
        path.write_text("{")
        with coolpix_on(device) as camera:
            notes = "\n".join(camera.controls.notes)
        assert f"{path} is damaged" in notes
        assert "could not be saved in its profile" in notes


class TestFaults:
    @pytest.mark.parametrize("verb", ["nak", "garbage", "truncate"])
    @pytest.mark.parametrize("count", [1, 3])
    def test_a_passing_fault_loses_no_frame(
        self, device: SierraDevice, verb: str, count: int
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            frames = camera.shoot(SETTINGS)
            first = next(frames)
            device.do(verb, count=count)
            second = next(frames)
            frames.close()
        assert [f.applied.time_s for f in (first, second)] == [0.002, 0.008]
        assert np.array_equal(second.pixels[..., 0], device.body.sensor.expose(0.008))
        assert len(device.camera.pictures) == 3

    def test_an_incomplete_download_is_repeated(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            do_once(camera, "read", Register.PICTURE_DATA, lambda: device.do("truncate", count=1))
            (frame,) = shoot(camera, SETTINGS[:1])
        assert np.array_equal(frame.pixels[..., 0], device.body.sensor.expose(0.002))
        assert len(device.camera.pictures) == 2

    def test_a_camera_that_refuses_all_speeds_is_used_at_the_first(
        self, device: SierraDevice
    ) -> None:
        device.do("no_speed")
        with coolpix_on(device) as camera:
            assert len(shoot(camera)) == 2
            assert "at 19200 baud" in camera.controls.notes[0]

    def test_the_highest_speed_of_the_camera_is_used(self) -> None:
        with virtual_coolpix(speed_limit=38400) as device, coolpix_on(device) as camera:
            assert "at 38400 baud" in camera.controls.notes[0]

    def test_a_camera_that_hangs_is_reported_in_time(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            frames = camera.shoot(SETTINGS)
            next(frames)
            device.do("hang")
            began_s = device.clock.now()
            with pytest.raises(CameraTimeoutError, match="has not answered for 12 s") as caught:
                next(frames)
            assert TIMEOUT_S <= device.clock.now() - began_s < TIMEOUT_S + 1
        one_line(caught.value)

    def test_a_line_without_a_camera_is_reported_in_time(self, device: SierraDevice) -> None:
        device.do("hang")
        with pytest.raises(CameraTimeoutError, match="has not answered for 5 s") as caught:
            coolpix_on(device, timeout_s=5.0)
        assert 5.0 <= device.clock.now() < 6.0
        one_line(caught.value)

    @pytest.mark.parametrize(
        ("verb", "message"),
        [("card_full", "the card of .* is full; make room"), ("battery_low", r"low \(3 %\); ch")],
    )
    def test_the_reason_of_a_missing_picture_is_reported(
        self, device: SierraDevice, verb: str, message: str
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            device.do(verb)
            with pytest.raises(CameraError, match=message) as caught:
                shoot(camera)
            one_line(caught.value)
            device.do("ok")
            assert len(shoot(camera)) == 2

    def test_a_refusal_without_a_reason_refers_to_the_display(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def refuse() -> None:
            raise RefusedError

        with coolpix_on(device) as camera:
            learn_format(camera)
            monkeypatch.setattr(device.camera, "check_ready", refuse)
            with pytest.raises(CameraError, match="took no picture; look at its display") as caught:
                shoot(camera)
            one_line(caught.value)

    def test_a_silently_changed_time_is_refused(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            device.do("clamp", max_s=0.005)
            with pytest.raises(RefusedSettingError, match=r"nearest it can do is 0\.004") as caught:
                shoot(camera)
            one_line(caught.value)

    def test_a_file_with_another_exposure_time_is_an_error(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            release = device.body.release
            monkeypatch.setattr(
                device.body,
                "release",
                lambda exposure, done: release(replace(exposure, time_s=0.004), done),
            )
            with pytest.raises(CameraProtocolError, match=r"0\.004 s, but 0\.008 s was set"):
                shoot(camera, SETTINGS[1:])

    def test_an_automatic_mode_is_an_error_on_opening(
        self, device: SierraDevice, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(device.camera, "_set_shutter", lambda value: None)
        with pytest.raises(CameraError, match=r"accepts no shutter time; turn its dial") as caught:
            coolpix_on(device)
        one_line(caught.value)

    def test_a_format_that_the_camera_does_not_have_is_an_error_on_opening(self) -> None:
        with (
            virtual_coolpix(files="jpeg") as device,
            pytest.raises(CameraError, match=r"cannot be set to tiff; .*HI is tiff"),
        ):
            coolpix_on(device)


class TestDisconnection:
    def test_an_unplugged_line_is_reported(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            frames = camera.shoot(SETTINGS)
            next(frames)
            device.do("unplug")
            with pytest.raises(CameraDisconnectedError) as caught:
                next(frames)
        one_line(caught.value)

    def test_a_picture_taken_before_the_disconnection_is_downloaded_after(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            do_once(camera, "read", Register.PICTURE_DATA, lambda: device.do("unplug"))
            with pytest.raises(
                CameraDisconnectedError, match=r"a picture of 0\.002 s that was not downloaded"
            ) as caught:
                shoot(camera, SETTINGS[:1])
            one_line(caught.value)
            taken = len(device.camera.pictures)
            device.do("plug")
            first, second = shoot(camera)
        assert first.details["found_again"] is True
        assert data_of(first) == device.camera.pictures[taken - 1].data
        assert "found_again" not in second.details
        assert len(device.camera.pictures) == taken + 1

    def test_a_picture_with_another_setting_is_left_on_the_card(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            do_once(camera, "read", Register.PICTURE_DATA, lambda: device.do("unplug"))
            with pytest.raises(CameraDisconnectedError):
                shoot(camera, SETTINGS[:1])
            left = device.camera.pictures[-1].name
            device.do("plug")
            (frame,) = shoot(camera, SETTINGS[1:])
        assert frame.applied.time_s == 0.008
        assert frame.details["left_on_card"] == left

    @pytest.mark.parametrize(
        ("method", "argument"),
        [
            ("read", Register.PICTURE_NAME),
            ("get", Register.SHUTTER_US),
            ("get", Register.APERTURE),
            ("act", Action.TAKE_PICTURE),
            ("get", Register.PICTURE_BYTES),
            ("read", Register.PICTURE_DATA),
        ],
    )
    def test_switching_off_and_on_loses_no_frame(
        self, device: SierraDevice, method: str, argument: int
    ) -> None:
        def switch_off_and_on() -> None:
            with device.lock:
                device._end_session()
                device.camera._quality = 0x13
                device.camera._set_shutter(0)
                device.camera._aperture = 3
                device.camera._selected = 0

        with coolpix_on(device) as camera:
            learn_format(camera)
            taken = len(device.camera.pictures)
            do_once(camera, method, argument, switch_off_and_on)
            frames = shoot(camera)
        assert [frame.applied.time_s for frame in frames] == [0.002, 0.008]
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)
        assert len(device.camera.pictures) == taken + 2

    def test_a_session_that_ends_before_the_exposure_loses_no_frame(
        self, device: SierraDevice
    ) -> None:
        with coolpix_on(device, speed=19200) as camera:
            learn_format(camera)
            do_once(camera, "act", Action.TAKE_PICTURE, lambda: device.do("break"))
            assert len(shoot(camera)) == 2
        assert len(device.camera.pictures) == 3


@contextmanager
def served(path: str) -> Iterator[str]:
    """Serve a terminal on a socket, at the speed at which a camera begins; yield the URL."""
    line = serial.Serial(path, 19200, timeout=0)
    listener = socket.create_server(("127.0.0.1", 0))
    over = threading.Event()

    def serve() -> None:
        client, _ = listener.accept()
        with client:
            while not over.is_set():
                ready, _, _ = select.select([client, line.fileno()], [], [], 0.05)
                if client in ready:
                    # Or each of our acknowledgements waits 40 ms for that of the server.
                    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
                    line.write(client.recv(4096))
                if line.fileno() in ready:
                    client.sendall(line.read(4096))

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
    finally:
        over.set()
        thread.join()
        listener.close()
        line.close()


class TestRealTime:
    """On pseudo-terminals of the kernel, in real time."""

    @pytest.fixture
    def device(self) -> Iterator[SierraDevice]:
        with virtual_coolpix(RealDeviceClock(), line="pty") as device:
            yield device

    def test_a_pseudo_terminal(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            frames = shoot(camera)
            assert "at 115200 baud" in camera.controls.notes[0]
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)

    def test_a_socket(self, device: SierraDevice) -> None:
        with served(device.line.path) as url, coolpix_on(device, url) as camera:
            (frame,) = shoot(camera, SETTINGS[:1])
            assert "at 19200 baud" in camera.controls.notes[0]
        assert np.array_equal(frame.pixels[..., 0], device.body.sensor.expose(0.002))

    def test_a_url_that_logs_the_traffic(
        self, device: SierraDevice, capsys: pytest.CaptureFixture[str]
    ) -> None:
        url = f"spy://{device.line.path}"
        with coolpix_on(device, url) as camera:
            assert camera.info.id == f"coolpix:{url}"
            assert len(shoot(camera)) == 2
        assert "1B 53" in capsys.readouterr().err

    def test_an_unplugged_line_is_reported(self, device: SierraDevice) -> None:
        with coolpix_on(device) as camera:
            learn_format(camera)
            frames = camera.shoot(SETTINGS)
            next(frames)
            device.do("unplug")
            with pytest.raises(CameraDisconnectedError) as caught:
                next(frames)
        one_line(caught.value)

    def test_a_second_program_is_refused(self, device: SierraDevice) -> None:
        with (
            coolpix_on(device),
            pytest.raises(CameraBusyError, match="another process holds it") as caught,
        ):
            coolpix_on(device)
        one_line(caught.value)


class TestOpening:
    def test_the_constructor_sends_nothing_and_open_can_be_repeated(
        self, device: SierraDevice
    ) -> None:
        camera = CoolpixCamera(device.line.path, CoolpixOptions(format="tiff"), clock=device.clock)
        assert device.do("state")["packets"] == 0
        for use in (lambda: camera.controls, lambda: camera.info, lambda: camera.shoot([])):
            with pytest.raises(CameraDisconnectedError, match="is not open; open it first"):
                use()
        for _ in range(2):
            with camera:
                assert len(shoot(camera)) == 2
            assert not device.do("state")["session"]

    def test_options_of_the_command_line(self, device: SierraDevice) -> None:
        options = CoolpixOptions.parse(
            {"format": "TIFF", "speed": "19200", "response": "power:2.2"}
        )
        with CoolpixCamera(device.line.path, options, clock=device.clock) as camera:
            assert camera.controls.response is not None
            assert camera.controls.response.M == 255
            assert "at 19200 baud" in camera.controls.notes[0]

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"size": "1x1"}, "unknown camera option 'size'"),
            ({"format": "raw"}, "invalid camera option format=raw; .* 'jpeg' or 'tiff'"),
            ({"speed": "1200"}, "invalid camera option speed=1200; the camera has the speeds 9600"),
            ({"response": "film"}, "unknown camera response 'film'"),
            ({"response": "power:x"}, "invalid response 'power:x'"),
            ({"response": "power:0"}, "expected 0.05 to 20"),
            ({"response": "srgb:2"}, "unknown camera response 'srgb:2'"),
        ],
    )
    def test_invalid_options_are_usage_errors_before_the_line_is_opened(
        self, options: dict[str, str], message: str
    ) -> None:
        with pytest.raises(UsageError, match=message):
            CoolpixBackend().open("/dev/no-such-port", options)

    def test_the_port_is_required(self) -> None:
        with pytest.raises(CameraNotFoundError, match="ttyUSB0"):
            CoolpixBackend().open("", {})


class TestProbing:
    """In real time, since each port is asked in a thread of its own."""

    def test_ports_are_left_alone_without_probe(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail() -> list[str]:
            raise AssertionError("ports were listed")

        monkeypatch.setattr("drivers.coolpix.backend.serial_ports", fail)
        assert CoolpixBackend().discover() == ()

    def test_a_camera_is_found_among_other_ports(self, monkeypatch: pytest.MonkeyPatch) -> None:
        clock = RealDeviceClock()
        with virtual_coolpix(clock) as device, virtual_coolpix(clock) as dead:
            dead.do("hang")
            urls = [device.line.path, dead.line.path, "/dev/no-such-port"]
            monkeypatch.setattr("drivers.coolpix.backend.serial_ports", lambda: urls)
            monkeypatch.setattr("drivers.coolpix.backend._PROBE_S", 60.0)
            monkeypatch.setattr("drivers.coolpix.backend._PORT_TIMEOUT_S", 60.0)
            (found,) = CoolpixBackend().discover(probe=True)
            assert found.id == f"coolpix:{device.line.path}"
            assert (found.make, found.model, found.serial) == ("NIKON", "E990", "CP990001")
            with coolpix_on(device) as camera:
                assert camera.info == found

    def test_a_port_that_blocks_is_not_waited_for(self, monkeypatch: pytest.MonkeyPatch) -> None:
        end = threading.Event()

        def blocking(url: str, speed: int) -> None:
            end.wait()
            raise CameraNotFoundError(f"there is no {url}")

        monkeypatch.setattr("drivers.coolpix.backend.SerialLink", blocking)
        try:
            assert probe_lines(["/dev/ttyS0"], 0.05) == []
        finally:
            end.set()

    def test_a_device_that_is_no_camera_receives_one_byte(self) -> None:
        near, far = os.openpty()
        try:
            assert probe_lines([os.ttyname(far)], 60.0) == []
            os.set_blocking(near, False)
            assert os.read(near, 100) == b"\0"
        finally:
            os.close(near)
            os.close(far)
