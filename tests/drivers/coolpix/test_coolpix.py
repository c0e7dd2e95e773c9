"""The CoolPix driver against the virtual CoolPix on a pseudo-terminal."""

import os
import select
import socket
import threading
import time
from contextlib import closing, contextmanager

import numpy as np
import pytest
import serial

from camctl.controls import ExposureSetting, Layout
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
from camctl.profile import StillRecord, change_profile, load_profile, profile_directory
from camctl.testing.conformance import CameraConformance
from drivers.common.still_file import read_still
from drivers.coolpix.backend import CoolpixBackend
from drivers.coolpix.camera import CoolpixCamera
from drivers.coolpix.discovery import ask
from drivers.coolpix.settings import CANDIDATES_US
from drivers.coolpix.sierra.packets import Action, Register
from sim.devices.sierra.camera import RefusedError
from sim.devices.sierra.config import SHUTTER_US
from sim.devices.sierra.device import make

SEEN = {"scene": "ramp", "sensor": "standard", "seed": 3, "size": "32x24", "repeat_noise": True}
SETTINGS = [ExposureSetting(time_s) for time_s in (0.002, 0.008)]


@contextmanager
def virtual(**config):
    device = make({"name": "coolpix", "kind": "sierra", **SEEN, **config})
    device.attach()
    try:
        yield device
    finally:
        device.detach()


@pytest.fixture(autouse=True)
def own_profiles(tmp_path, monkeypatch):
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


@pytest.fixture
def device():
    with virtual() as device:
        yield device


def opened(device, **arguments):
    arguments = {"format": "tiff", "response": "linear", "timeout_s": 2.0, **arguments}
    return CoolpixCamera(device.line.path, **arguments)


def shoot(camera, settings=SETTINGS):
    with closing(camera.shoot(settings)) as frames:
        return list(frames)


def once(camera, how, what, act):
    """Let `act` happen just before the session is next asked `how` (get, read, act) for `what`."""
    sierra = camera._body.sierra
    plain = getattr(sierra, how)

    def after_it(which, *words, **named):
        if which == what:
            setattr(sierra, how, plain)
            act()
        return plain(which, *words, **named)

    setattr(sierra, how, after_it)


def one_line(error):
    assert error.hint
    assert "\n" not in str(error)
    return str(error)


class TestTiff(CameraConformance):
    format = "tiff"

    @pytest.fixture(autouse=True)
    def _device(self, device):
        self.device = device

    def open_camera(self):
        return opened(self.device, format=self.format)

    def middle_s(self, camera):
        return camera.controls.time_s.nearest(0.01)


class TestJpeg(TestTiff):
    format = "jpeg"


class TestPictures:
    def test_a_tiff_is_the_sensors_own_numbers_and_kept_byte_for_byte(self, device):
        with opened(device) as camera:
            frames = shoot(camera)
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)
            assert frame.original.suffix == ".tif"
            assert frame.original.data in [picture.data for picture in device.camera.pictures]
            assert np.array_equal(read_still(frame.original.data, "x.tif").pixels, frame.pixels)

    def test_jpeg_unless_asked_otherwise(self, device):
        with CoolpixCamera(device.line.path) as camera:
            (frame,) = shoot(camera, SETTINGS[1:])
            notes = "\n".join(camera.controls.notes)
        assert frame.original.suffix == ".jpg"
        assert frame.details == {"name_on_card": device.camera.pictures[-1].name}
        assert "sRGB" in notes
        assert "JPEG loses levels" in notes

    def test_only_times_that_are_read_back_unchanged_are_offered(self, device):
        with opened(device) as camera:
            assert camera.controls.time_s.values == tuple(us / 1e6 for us in SHUTTER_US)

    def test_a_camera_that_takes_all_times_offers_the_standard_ones(self):
        with virtual(times_us=CANDIDATES_US) as device, opened(device) as camera:
            values = camera.controls.time_s.values
        assert values == tuple(us / 1e6 for us in CANDIDATES_US)

    def test_a_dials_label_is_met_by_the_cameras_time(self, device):
        with opened(device) as camera:
            (frame,) = shoot(camera, [ExposureSetting(1 / 60)])
        assert frame.requested.time_s == 1 / 60
        assert frame.applied.time_s == 0.016666

    def test_the_aperture_is_set_when_asked_and_only_then(self, device):
        settings = [ExposureSetting(0.002), ExposureSetting(0.008, f_number=7.0), *SETTINGS[:1]]
        with opened(device) as camera:
            assert camera.controls.f_number.values == (2.5, 4.0, 7.0)
            plain, small, again = shoot(camera, settings)
            notes = "\n".join(camera.controls.notes)
        assert (plain.applied.f_number, small.applied.f_number) == (None, 7.0)
        assert np.array_equal(plain.pixels, again.pixels)
        light = device.body.sensor.expose(0.008 * (2.5 / 7.0) ** 2)
        assert np.array_equal(small.pixels[..., 0], light)
        assert "assumed" in notes
        assert "its aperture is fixed at f/2.5" in notes

    def test_the_notes_say_how_long_a_tiff_takes(self, device):
        with opened(device, speed=9600) as camera:
            # 32 x 24 pixels of three bytes, 10 bits each on the line, at 9,600 bits a second
            assert "takes 2.4 s over the line at 9600 baud" in camera.controls.notes[0]
            record = StillRecord(rows=1536, columns=2048, layout="rgb", bits=8, black=0, white=255)
            change_profile(camera.info, lambda found: found.stills.update(tiff=record))
        with opened(device) as camera:
            assert "(tiff, about 9.4 MB) takes 14 minutes" in camera.controls.notes[0]

    def test_the_camera_is_given_back_as_it_was_found(self, device):
        before = device.do("state")
        with opened(device) as camera:
            shoot(camera)
        after = device.do("state")
        for what in ("shutter_us", "aperture", "quality", "speed", "session"):
            assert after[what] == before[what]

    def test_progress_is_told(self, device):
        told = []
        with opened(device, progress=lambda *words: told.append(words)) as camera:
            shoot(camera, SETTINGS[:1])
        name, come, size = told[-1]
        assert name == device.camera.pictures[-1].name
        assert come == size == len(device.camera.pictures[-1].data)


class TestWhatFilesAre:
    def test_a_picture_is_taken_for_it_where_nothing_is_known(self, device):
        with opened(device) as camera:
            controls = camera.controls
            assert "was taken to see what its files are" in "\n".join(controls.notes)
            assert camera.controls.notes == controls.notes
        assert len(device.camera.pictures) == 1
        assert (controls.shape, controls.layout) == ((24, 32), Layout.RGB)

    def test_the_newest_picture_of_the_same_kind_tells_it(self, device):
        with opened(device) as camera:
            shoot(camera, SETTINGS[:1])
        taken = len(device.camera.pictures)
        for path in profile_directory().glob("*.json"):
            path.unlink()
        with opened(device) as camera:
            assert "on its card" in "\n".join(camera.controls.notes)
        assert len(device.camera.pictures) == taken

    def test_a_picture_of_another_kind_tells_nothing(self, device):
        with opened(device) as camera:
            shoot(camera, SETTINGS[:1])
        with opened(device, format="jpeg") as camera:
            assert "was taken to see" in "\n".join(camera.controls.notes)

    def test_the_profile_tells_it_the_next_time(self, device):
        with opened(device) as camera:
            info = camera.info
            shoot(camera, SETTINGS[:1])
        taken = len(device.camera.pictures)
        assert load_profile(info).stills["tiff"].columns == 32
        with opened(device) as camera:
            assert camera.controls.shape == (24, 32)
        assert len(device.camera.pictures) == taken

    def test_a_profile_that_is_wrong_is_set_right_and_the_frame_is_kept(self, device):
        record = StillRecord(rows=1, columns=2, layout="rgb", bits=8, black=0, white=255)
        with opened(device) as camera:
            info = camera.info
        change_profile(info, lambda found: found.stills.update(tiff=record))
        with opened(device) as camera:
            assert camera.controls.shape == (1, 2)
            (frame,) = shoot(camera, SETTINGS[:1])
            assert frame.pixels.shape == (24, 32, 3)
            assert camera.controls.shape == (24, 32)
        assert load_profile(info).stills["tiff"].rows == 24


class TestFaults:
    @pytest.mark.parametrize("verb", ["nak", "garbage", "truncate"])
    @pytest.mark.parametrize("count", [1, 3])
    def test_what_passes_by_itself_costs_no_frame(self, device, verb, count):
        with opened(device, timeout_s=10.0) as camera:
            camera.controls  # noqa: B018 - what its files are is known before the fault
            frames = camera.shoot(SETTINGS)
            first = next(frames)
            device.do(verb, count=count)
            second = next(frames)
            frames.close()
        assert [f.applied.time_s for f in (first, second)] == [0.002, 0.008]
        assert np.array_equal(second.pixels[..., 0], device.body.sensor.expose(0.008))
        assert len(device.camera.pictures) == 3

    def test_a_download_cut_short_is_asked_for_again(self, device):
        with opened(device, timeout_s=10.0) as camera:
            camera.controls  # noqa: B018
            once(camera, "read", Register.PICTURE_DATA, lambda: device.do("truncate", count=1))
            (frame,) = shoot(camera, SETTINGS[:1])
        assert np.array_equal(frame.pixels[..., 0], device.body.sensor.expose(0.002))
        assert len(device.camera.pictures) == 2

    def test_a_refused_speed_is_only_slow(self, device):
        device.do("no_speed")
        with opened(device) as camera:
            assert len(shoot(camera)) == 2
            assert "at 19200 baud" in camera.controls.notes[0]

    def test_a_slow_line_is_used_at_its_speed(self):
        with virtual(speed_limit=38400) as device, opened(device) as camera:
            assert "at 38400 baud" in camera.controls.notes[0]

    def test_a_hanging_camera_is_given_up_in_the_stated_time(self, device):
        with opened(device) as camera:
            camera.controls  # noqa: B018
            frames = camera.shoot(SETTINGS)
            next(frames)
            device.do("hang")
            began = time.monotonic()
            with pytest.raises(CameraTimeoutError) as caught:
                next(frames)
            took_s = time.monotonic() - began
        assert took_s < 5.0
        one_line(caught.value)

    def test_no_camera_at_the_other_end(self):
        master, slave = os.openpty()
        try:
            began = time.monotonic()
            with pytest.raises(CameraTimeoutError, match="not answered for 1 s") as caught:
                CoolpixCamera(os.ttyname(slave), timeout_s=1.0)
            assert time.monotonic() - began < 2.0
            one_line(caught.value)
        finally:
            os.close(master)
            os.close(slave)

    @pytest.mark.parametrize(
        ("verb", "words"), [("card_full", "card .* is full"), ("battery_low", r"battery .*\(3 %")]
    )
    def test_no_picture_says_why(self, device, verb, words):
        with opened(device) as camera:
            camera.controls  # noqa: B018
            device.do(verb)
            with pytest.raises(CameraError, match=words) as caught:
                shoot(camera)
            one_line(caught.value)
            device.do("ok")
            assert len(shoot(camera)) == 2

    def test_a_refusal_without_a_reason_points_at_the_display(self, device):
        with opened(device) as camera:
            camera.controls  # noqa: B018
            device.camera.check_ready = refuse
            with pytest.raises(CameraError, match="lens cap") as caught:
                shoot(camera)
            one_line(caught.value)

    def test_silent_clamping_is_not_believed(self, device):
        with opened(device) as camera:
            camera.controls  # noqa: B018
            device.do("clamp", max_s=0.005)
            with pytest.raises(RefusedSettingError, match=r"nearest it can do is 0.004") as caught:
                shoot(camera)
            one_line(caught.value)

    def test_a_time_that_only_the_file_tells_is_not_believed(self, device):
        with opened(device) as camera:
            camera.controls  # noqa: B018
            release = device.body.release
            device.body.release = lambda exposure, done: release(
                type(exposure)(0.004, exposure.gain, exposure.light, exposure.formats), done
            )
            with pytest.raises(CameraProtocolError, match=r"exposed for 0\.004 s, not for 0\.008"):
                shoot(camera, SETTINGS[1:])

    def test_an_automatic_camera_is_said(self, device):
        device.camera._set_shutter = lambda value: None
        with pytest.raises(CameraError, match=r"takes no shutter time.*dial to M") as caught:
            opened(device)
        one_line(caught.value)

    def test_a_format_that_it_does_not_have(self):
        with virtual(files="jpeg") as device, pytest.raises(CameraError, match="HI is tiff"):
            opened(device)


def refuse():
    raise RefusedError


class TestBrokenLines:
    @pytest.fixture
    def device(self, tmp_path):
        with virtual(link=str(tmp_path / "tty")) as device:
            device.name = str(tmp_path / "tty")
            yield device

    def open(self, device):
        return CoolpixCamera(device.name, format="tiff", response="linear", timeout_s=2.0)

    def test_an_unplugged_line_is_typed(self, device):
        with self.open(device) as camera:
            camera.controls  # noqa: B018
            frames = camera.shoot(SETTINGS)
            next(frames)
            device.do("unplug")
            with pytest.raises(CameraDisconnectedError) as caught:
                next(frames)
        one_line(caught.value)

    def test_a_picture_taken_before_the_line_broke_is_fetched_after(self, device):
        with self.open(device) as camera:
            camera.controls  # noqa: B018
            once(camera, "read", Register.PICTURE_DATA, lambda: device.do("unplug"))
            with pytest.raises(CameraDisconnectedError, match="may be on its card") as caught:
                shoot(camera, SETTINGS[:1])
            one_line(caught.value)
            taken = len(device.camera.pictures)
            device.do("plug")
            first, second = shoot(camera)
        assert first.details["found_again"] is True
        assert first.original.data == device.camera.pictures[taken - 1].data
        assert "found_again" not in second.details
        assert len(device.camera.pictures) == taken + 1

    def test_a_picture_that_may_be_another_is_not_taken_for_it(self, device):
        with self.open(device) as camera:
            camera.controls  # noqa: B018
            once(camera, "read", Register.PICTURE_DATA, lambda: device.do("unplug"))
            with pytest.raises(CameraDisconnectedError):
                shoot(camera, SETTINGS[:1])
            left = device.camera.pictures[-1].name
            device.do("plug")
            (frame,) = shoot(camera, SETTINGS[1:])
        assert frame.applied.time_s == 0.008
        assert frame.details["left_on_card"] == left

    @pytest.mark.parametrize(
        ("how", "what"),
        [
            ("read", Register.PICTURE_NAME),
            ("get", Register.SHUTTER_US),
            ("get", Register.APERTURE),
            ("act", Action.TAKE_PICTURE),
            ("get", Register.PICTURE_BYTES),
            ("read", Register.PICTURE_DATA),
        ],
    )
    def test_power_off_and_on_in_between_costs_no_frame(self, device, monkeypatch, how, what):
        monkeypatch.setattr("drivers.coolpix.body.WRITING_S", 0.5)

        def cycle():
            with device.lock:
                device._end_session()
                device.camera._quality = 0x13
                device.camera._set_shutter(0)
                device.camera._aperture = 3
                device.camera._selected = 0

        with self.open(device) as camera:
            camera.controls  # noqa: B018
            taken = len(device.camera.pictures)
            once(camera, how, what, cycle)
            frames = shoot(camera)
        assert [frame.applied.time_s for frame in frames] == [0.002, 0.008]
        for frame, setting in zip(frames, SETTINGS, strict=True):
            exposed = device.body.sensor.expose(setting.time_s)
            assert np.array_equal(frame.pixels[..., 0], exposed)
        assert len(device.camera.pictures) == taken + 2

    def test_a_session_that_ends_before_the_shutter_opens_costs_no_frame(self, device, monkeypatch):
        monkeypatch.setattr("drivers.coolpix.body.WRITING_S", 0.5)
        linear = {"format": "tiff", "response": "linear"}
        with CoolpixCamera(device.name, speed=19200, timeout_s=2.0, **linear) as camera:
            camera.controls  # noqa: B018
            once(camera, "act", Action.TAKE_PICTURE, lambda: device.do("break"))
            assert len(shoot(camera)) == 2
        assert len(device.camera.pictures) == 3

    def test_a_second_program_is_told_that_the_port_is_held(self, device):
        with self.open(device), pytest.raises(CameraBusyError, match="another process") as caught:
            self.open(device)
        one_line(caught.value)


@contextmanager
def served(path):
    """Serve a terminal on a socket, at the speed that a camera begins with; yield the URL."""
    line = serial.Serial(path, 19200, timeout=0)
    listener = socket.create_server(("127.0.0.1", 0))
    over = threading.Event()

    def serve():
        client, _ = listener.accept()
        with client:
            while not over.is_set():
                ready, _, _ = select.select([client, line.fileno()], [], [], 0.05)
                if client in ready:
                    # Or each acknowledgement of ours waits 40 ms for the server's own.
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


class TestUrls:
    def test_a_socket(self, device):
        linear = {"format": "tiff", "response": "linear"}
        with served(device.line.path) as url, CoolpixCamera(url, **linear) as camera:
            (frame,) = shoot(camera, SETTINGS[:1])
            assert "at 19200 baud" in camera.controls.notes[0]
        assert np.array_equal(frame.pixels[..., 0], device.body.sensor.expose(0.002))

    def test_a_line_that_is_listened_in_on(self, device, capsys):
        url = f"spy://{device.line.path}"
        with CoolpixCamera(url, format="tiff", response="linear") as camera:
            assert camera.info.id == f"coolpix:{url}"
            assert len(shoot(camera)) == 2
        assert "1B 53" in capsys.readouterr().err


class TestRoad:
    def test_nothing_is_asked_without_probing(self, monkeypatch):
        monkeypatch.setattr(
            "drivers.coolpix.backend.ports", lambda: pytest.fail("ports were listed")
        )
        assert CoolpixBackend().discover() == ()

    def test_probing_finds_the_camera_within_a_second(self, device, monkeypatch):
        silent, dead = os.openpty()
        urls = [device.line.path, os.ttyname(dead), "/dev/no-such-port"]
        monkeypatch.setattr("drivers.coolpix.backend.ports", lambda: urls)
        try:
            began = time.monotonic()
            (found,) = CoolpixBackend().discover(probe=True)
            assert time.monotonic() - began < 1.0
        finally:
            os.close(silent)
            os.close(dead)
        assert found.id == f"coolpix:{device.line.path}"
        assert (found.make, found.model, found.serial) == ("NIKON", "E990", "CP990001")
        with opened(device) as camera:
            assert camera.info == found

    def test_what_is_no_camera_hears_one_byte_only(self):
        master, slave = os.openpty()
        try:
            assert ask([os.ttyname(slave)]) == []
            os.set_blocking(master, False)
            assert os.read(master, 100) == b"\0"
        finally:
            os.close(master)
            os.close(slave)

    def test_options(self, device):
        options = {"format": "tiff", "speed": "19200", "response": "power:2.2"}
        with CoolpixBackend().open(device.line.path, options) as camera:
            assert camera.controls.response.M == 255
            assert "at 19200 baud" in camera.controls.notes[0]

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            ({"size": "1x1"}, "option"),
            ({"format": "raw"}, "format"),
            ({"speed": "1200"}, "speed"),
            ({"response": "film"}, "response"),
            ({"response": "power:x"}, "response"),
            ({"response": "power:0"}, "gamma"),
            ({"response": "srgb:2"}, "response"),
        ],
    )
    def test_bad_options_are_told_before_the_line_is_opened(self, options, words):
        with pytest.raises(UsageError, match=words):
            CoolpixBackend().open("/dev/no-such-port", options)

    def test_the_port_must_be_named(self):
        with pytest.raises(CameraNotFoundError, match="ttyUSB0"):
            CoolpixBackend().open("", {})
