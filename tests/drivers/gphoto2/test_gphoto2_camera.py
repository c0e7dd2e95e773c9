"""Cameras through libgphoto2: its own virtual camera, and bodies that behave in other ways.

The virtual camera (a Nikon D750, in the library of the package gphoto2) answers with one picture,
whatever its shutter time is, and has room for 26.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from camctl.captures.sequencer import capture
from camctl.drivers.gphoto2 import camera as camera_module
from camctl.drivers.gphoto2 import process
from camctl.drivers.gphoto2.backend import Gphoto2Backend, Listed
from camctl.drivers.gphoto2.body import Body
from camctl.drivers.gphoto2.camera import Gphoto2Camera, Gphoto2Options
from camctl.drivers.gphoto2.process import CameraProcess, LibraryError
from camctl.errors import (
    CamctlError,
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    InterruptedCaptureError,
    RefusedSettingError,
    UsageError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.interface.backends import is_local, list_cameras
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import VirtualClock, cancelled_by
from camctl.interface.colour import BT709
from camctl.interface.controls import Choices, ExposureSetting, Layout, ResponseOrigin

PORT = "usb:001,001"
TIMES_S = (0.0012, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 1.0)
PICTURE = np.tile(np.linspace(10, 200, 64).astype(np.uint8)[None, :, None], (48, 1, 3))


def set_up(monkeypatch: pytest.MonkeyPatch, place: Path) -> None:
    """Give libgphoto2's virtual camera a card with one picture."""
    folder = place / "card" / "DCIM" / "100NIKON"
    folder.mkdir(parents=True)
    assert cv2.imwrite(str(folder / "picture.jpg"), PICTURE)
    monkeypatch.setenv("VCAMERADIR", str(place / "card"))
    monkeypatch.setenv("CAMCTL_PROFILES", str(place / "profiles"))


@pytest.fixture(autouse=True)
def virtual_camera(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    set_up(monkeypatch, tmp_path)


@pytest.fixture
def camera() -> Iterator[Gphoto2Camera]:
    with Gphoto2Backend().open(PORT, {"response": "linear"}) as opened:
        yield opened


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Gphoto2Camera]:
    """One camera for the tests after which it works as before: its process takes a second."""
    with pytest.MonkeyPatch.context() as patched:
        set_up(patched, tmp_path_factory.mktemp("shared"))
        opened = Gphoto2Backend().open(PORT, {"response": "linear"})
    with opened:
        yield opened


def settings(*times_s: float) -> list[ExposureSetting]:
    return [ExposureSetting(time_s, f_number=5.6) for time_s in times_s]


class TestVirtualCamera:
    def test_its_response_is_assumed_unless_it_is_given(self, camera: Gphoto2Camera) -> None:
        assert camera.controls.response_origin is ResponseOrigin.STATED
        camera.close()
        with Gphoto2Backend().open("", {}) as other:
            assert other.controls.response_origin is ResponseOrigin.ASSUMED
            assert (other.controls.colour is BT709) == (other.controls.layout is Layout.RGB)

    def test_it_is_listed_with_the_backend_to_use(self) -> None:
        (found,) = (each for each in list_cameras() if each.driver == "gphoto2")
        remark = "ptp: is the faster way to a Nikon; this one is for models that ptp: refuses"
        assert found == CameraInfo(f"gphoto2:{PORT}", "", "Nikon DSC D750", "", "gphoto2", remark)
        assert is_local(found.id, {})

    def test_its_dials_have_true_values(self, shared: Gphoto2Camera) -> None:
        """Its label 0.0001s stands for anything from 0.05 to 0.15 ms, and is left out."""
        controls = shared.controls
        assert controls.time_s == Choices(TIMES_S)
        assert controls.f_number is not None
        assert (controls.f_number.minimum, controls.f_number.maximum) == (2.8, 22.0)
        assert controls.shape == (48, 64)
        assert shared.info.serial == "0.1"

    def test_a_time_between_two_labels_is_refused(self, shared: Gphoto2Camera) -> None:
        with pytest.raises(RefusedSettingError) as caught:
            shared.shoot(settings(0.01, 0.003))
        assert caught.value.nearest == 0.0025

    def test_frames_are_its_files_and_state_what_was_read_back(self, shared: Gphoto2Camera) -> None:
        times_s = (0.0025, 1.0, 0.0012, 0.0025)
        frames = list(shared.shoot(settings(*times_s)))
        assert [frame.applied for frame in frames] == settings(*times_s)
        assert [frame.index for frame in frames] == [0, 1, 2, 3]
        for frame in frames:
            assert np.abs(frame.pixels.astype(int) - PICTURE).max() < 8
            assert frame.original is not None
            assert frame.original.suffix == ".jpg"
            assert frame.original.data.startswith(b"\xff\xd8")
        times = [frame.timestamp_s for frame in frames]
        assert times == sorted(times)

    def test_a_capture_finds_that_every_frame_is_the_same(self, shared: Gphoto2Camera) -> None:
        """The virtual camera shows one picture for all exposures; no such picture is trusted."""
        report = capture(shared, CaptureRequest("linear", ratios=(1.0, 4.0, 20.0), base_s=0.0025))
        assert [frame.applied_s for frame in report.frames if frame] == [0.0025, 0.01, 0.05]
        assert not report.trustworthy

    @pytest.mark.parametrize(
        ("options", "deleted"),
        [({"target": "ram"}, 4), ({"target": "card"}, 0), ({"target": "card", "delete": "yes"}, 4)],
    )
    def test_fetched_files_are_deleted_from_the_memory(
        self, monkeypatch: pytest.MonkeyPatch, options: dict[str, str], deleted: int
    ) -> None:
        """Three frames, and the picture that was taken to learn the format."""
        asked: list[str] = []
        ask = CameraProcess.ask

        def recorded(self: CameraProcess, do: str, **arguments: Any) -> Any:
            asked.append(do)
            return ask(self, do, **arguments)

        monkeypatch.setattr(CameraProcess, "ask", recorded)
        with Gphoto2Camera(PORT, Gphoto2Options.parse(options)) as camera:
            list(camera.shoot(settings(0.01, 0.1, 1.0)))
        assert asked.count("delete") == deleted

    @pytest.mark.parametrize("target", ["ram", "card"])
    def test_the_file_that_is_not_fetched_is_deleted_from_the_memory_and_left_on_a_card(
        self, monkeypatch: pytest.MonkeyPatch, target: str
    ) -> None:
        """Of raw and JPEG one is fetched; the other one may come late."""
        twins, deleted = iter([[["/", "late.nef"]], [["/", "later.nef"]]]), []
        ask = CameraProcess.ask

        def with_twins(self: CameraProcess, do: str, **arguments: Any) -> Any:
            if do == "delete":
                deleted.append(arguments["name"])
            found = ask(self, do, **arguments)
            return [*found, *next(twins, [])] if do == "added" else found

        options = {"response": "linear", "format": "jpeg", "target": target}
        with Gphoto2Camera(PORT, Gphoto2Options.parse(options)) as camera:
            assert camera.controls.shape == (48, 64)
            monkeypatch.setattr(CameraProcess, "ask", with_twins)
            list(camera.shoot(settings(0.01, 0.1)))
        late = {"late.nef", "later.nef"}
        assert late & set(deleted) == (late if target == "ram" else set())

    def test_a_full_memory_is_emptied_once(
        self, camera: Gphoto2Camera, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        list(camera.shoot(settings(0.01)))
        asked: list[str] = []
        ask_once = CameraProcess._ask_once

        def full(self: CameraProcess, do: str, arguments: Any, *waits_s: float) -> Any:
            asked.append(do)
            if do == "capture" and "delete" not in asked:
                raise LibraryError(-115, "Not enough free space")
            return ask_once(self, do, arguments, *waits_s)

        monkeypatch.setattr(CameraProcess, "_ask_once", full)
        assert len(list(camera.shoot(settings(0.1)))) == 1
        assert asked.count("capture") == 2

    def test_a_full_card(self) -> None:
        with (
            Gphoto2Camera(PORT, Gphoto2Options(target="card")) as camera,
            pytest.raises(CameraError, match="has no memory left for a picture") as caught,
        ):
            list(camera.shoot(settings(*[0.01] * 40)))
        assert caught.value.hint == "delete pictures, or change its card"

    def test_two_cameras_have_a_process_each(self, camera: Gphoto2Camera) -> None:
        with Gphoto2Camera(PORT) as other:
            assert camera._process.process_id != other._process.process_id
            pairs = zip(
                camera.shoot(settings(0.01, 0.1)), other.shoot(settings(0.1, 0.01)), strict=True
            )
            assert [(a.applied.time_s, b.applied.time_s) for a, b in pairs] == [
                (0.01, 0.1),
                (0.1, 0.01),
            ]

    def test_a_process_that_dies_is_an_error_and_the_camera_opens_again(
        self, camera: Gphoto2Camera
    ) -> None:
        frames = camera.shoot(settings(0.01, 0.1, 1.0))
        next(frames)
        os.kill(camera._process.process_id, signal.SIGKILL)
        with pytest.raises(CameraDisconnectedError, match="ended with status -9; switch"):
            list(frames)
        camera.close()
        with camera.open():
            assert len(list(camera.shoot(settings(0.01)))) == 1

    def test_a_process_that_hangs_is_ended(self, camera: Gphoto2Camera) -> None:
        os.kill(camera._process.process_id, signal.SIGSTOP)
        with pytest.raises(CameraTimeoutError, match="does not answer for 1 s"):
            camera._process.ask("widgets", silence_s=1.0)

    def test_a_cancelled_picture_that_never_comes_does_not_keep_the_camera_open(
        self, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
    ) -> None:
        """It is said that the exposure is waited for, which libgphoto2 cannot end."""
        monkeypatch.setattr(camera_module, "_CANCELLED_S", 0.5)
        camera = Gphoto2Camera(PORT).open()
        (setting,) = settings(0.01)
        os.kill(camera._process.process_id, signal.SIGSTOP)
        with pytest.raises(InterruptedCaptureError), cancelled_by(lambda: True):
            camera._release(setting.time_s)
        began_s = time.monotonic()
        with caplog.at_level("INFO"):
            camera.close()
        assert time.monotonic() - began_s < 2
        assert "waiting for the end of what gphoto2:usb:001,001 does, for up to" in caplog.text

    def test_a_closed_camera_leaves_no_process(self, camera: Gphoto2Camera) -> None:
        number = camera._process.process_id
        camera.close()
        assert not Path("/proc", str(number)).exists()

    def test_a_file_of_another_exposure_is_an_error(
        self, shared: Gphoto2Camera, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """What the file states decides, as with every still camera."""
        list(shared.shoot(settings(0.01)))
        monkeypatch.setattr(
            "camctl.drivers.common.known_format.stated_exposure",
            lambda data: type("Stated", (), {"time_s": 0.5, "gain": None, "f_number": None}),
        )
        with pytest.raises(CameraProtocolError, match=r"states an exposure time of 0\.5 s, but"):
            list(shared.shoot(settings(0.01)))


class TestBadInput:
    @pytest.mark.parametrize(
        ("address", "options", "kind", "message"),
        [
            (PORT, {"format": "gif"}, UsageError, "format=gif; input should be 'auto', 'raw'"),
            (PORT, {"target": "disk"}, UsageError, "target=disk; input should be"),
            (PORT, {"bulb": "3"}, UsageError, "unknown camera option 'bulb'"),
            ("usb:009,001", {}, CamctlError, "gphoto2:usb:009,001 has no such port"),
            ("nonsense", {}, CameraNotFoundError, "gphoto2:nonsense has no such port"),
        ],
    )
    def test_one_line(
        self, address: str, options: dict[str, str], kind: type[CamctlError], message: str
    ) -> None:
        with pytest.raises(kind) as caught:
            Gphoto2Backend().open(address, options)
        assert message in str(caught.value)
        assert "\n" not in str(caught.value)
        assert caught.value.hint

    def test_without_the_package(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(process, "find_spec", lambda name: None)
        assert Gphoto2Backend().discover() == []
        with pytest.raises(CameraError, match=r"needs the package gphoto2; pip install"):
            Gphoto2Camera(PORT).open()

    def test_no_camera(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delenv("VCAMERADIR")
        with pytest.raises(CameraNotFoundError, match="no cameras for gphoto2 are connected"):
            Gphoto2Backend().open("", {})


class TestListing:
    @pytest.mark.parametrize(
        ("captures", "vendor", "remark"),
        [
            (True, 0x04A9, "ptp: is the faster way to a Canon; this one is for models that"),
            (True, 0x0A17, "the way to this make, whose operations ptp: does not know"),
            (False, 0x04A9, "libgphoto2 cannot take pictures with this model"),
        ],
    )
    def test_remark(self, captures: bool, vendor: int, remark: str) -> None:
        listed = Listed(model="A", port=PORT, captures=captures, configures=True, usb_vendor=vendor)
        assert listed.remark.startswith(remark)


class Bench:
    """A process whose camera has other settings than the virtual one.

    Attributes:
        widgets: its settings
        snaps: the value that it takes instead of the one that is set
    """

    name = "gphoto2:usb:001,007"

    def __init__(self, make: str, **widgets: Any) -> None:
        self.widgets: dict[str, dict[str, Any]] = {}
        self.snaps: dict[str, str] = {}
        self.add(manufacturer=make, cameramodel="Body", serialnumber="7", **widgets)

    def add(self, **widgets: Any) -> None:
        for name, found in widgets.items():
            choices = found if isinstance(found, list) else [found]
            self.widgets[name] = {
                "label": name.title(),
                "kind": "choice",
                "value": choices[0],
                "choices": choices,
                "is_read_only": False,
            }

    def ask(self, do: str, **arguments: Any) -> Any:
        if do == "widgets":
            return self.widgets
        assert do == "apply"
        for name, value in arguments["values"].items():
            assert value in self.widgets[name]["choices"]
            self.widgets[name]["value"] = self.snaps.get(name, value)
        return {name: self.widgets[name]["value"] for name in arguments["values"]}


CANON = ["bulb", "30", "15", "1", "0.8", "0.3", "1/15", "1/60", "1/125", "1/8000"]


def body_of(bench: Bench, target: str = "auto") -> Body:
    return Body(bench, target)  # type: ignore[arg-type]  # stands for a `CameraProcess`


class TestBody:
    def test_labels_of_canon_are_exact_stops(self) -> None:
        body = body_of(Bench("Canon Inc.", shutterspeed=CANON, iso=["Auto", "100", "125", "400"]))
        assert body.time_s.labels[1 / 64] == "1/60"
        assert body.time_s.labels[2 ** (-5 / 3)] == "0.3"
        assert body.time_s.control.maximum == 32
        assert body.gain is not None
        assert body.gain.control.values == (1.0, 2 ** (1 / 3), 4.0)

    def test_labels_of_nikon_are_taken_as_they_are(self) -> None:
        body = body_of(
            Bench(
                "Nikon Corporation",
                shutterspeed=["0.0166s", "0.0002s"],
                shutterspeed2=["1/60", "1/4000", "Bulb", "x 200"],
                **{"f-number": ["f/3.5", "f/8"]},
            )
        )
        assert body.time_s.control.values == (1 / 4000, 1 / 60)
        assert body.f_number is not None
        assert body.f_number.control.values == (3.5, 8.0)

    def test_modes_are_switched_to_manual(self) -> None:
        bench = Bench("Nikon", shutterspeed2=["1/60"], isoauto=["On", "Off"], expprogram=["A", "M"])
        body_of(bench)
        assert bench.widgets["isoauto"]["value"] == "Off"
        assert bench.widgets["expprogram"]["value"] == "M"

    def test_a_mode_dial_that_forbids_manual_exposure(self) -> None:
        bench = Bench("Nikon", shutterspeed2=["1/60"], expprogram="Auto")
        bench.widgets["expprogram"]["is_read_only"] = True
        with pytest.raises(CameraError, match=r"is in mode Auto .*; turn the mode dial to M"):
            body_of(bench)

    @pytest.mark.parametrize(
        ("changed", "what", "hint"),
        [
            ({"batterylevel": "3%"}, "its battery has 3 % of its charge", "charge it"),
            ({"expprogram": "Movie (P)"}, "it is in mode Movie (P) (expprogram)", "turn the mode"),
            ({"focusmode": "AF-S"}, "its autofocus is on (AF-S)", "manual focus"),
            ({"focusmode": "Automatic"}, "its autofocus is on (Automatic)", "manual focus"),
            ({"focusmode": "Manual"}, None, ""),
            ({"focusmode": "Preset MF"}, None, ""),
        ],
    )
    def test_what_a_sony_that_gives_no_reason_shows_of_it(
        self, changed: dict[str, str], what: str | None, hint: str
    ) -> None:
        bench = Bench("Sony Corporation", shutterspeed=["1/60"], expprogram="M", focusmode="Manual")
        bench.widgets["expprogram"]["is_read_only"] = True
        body = body_of(bench)
        bench.add(**changed)
        bench.widgets["expprogram"]["is_read_only"] = True
        found = body.why_no_picture(is_silent=False)
        if what is None:
            assert found is None
        else:
            assert found is not None
            assert found[0].startswith(what)
            assert hint in found[1]
            assert (body.why_no_picture(is_silent=True) is None) == ("batterylevel" not in changed)

    def test_a_body_without_shutter_time(self) -> None:
        bench = Bench("Canon", shutterspeed=["auto"])
        with pytest.raises(CameraError, match=r"no shutter time that libgphoto2 can set; turn the"):
            body_of(bench)

    def test_a_snapped_time_is_refused_with_the_one_that_was_taken(self) -> None:
        bench = Bench("Canon", shutterspeed=CANON)
        body = body_of(bench)
        bench.snaps["shutterspeed"] = "1/125"
        with pytest.raises(RefusedSettingError) as caught:
            body.apply(ExposureSetting(1 / 64))
        assert caught.value.nearest == 1 / 128

    def test_a_dial_turned_to_automatic(self) -> None:
        bench = Bench("Canon", shutterspeed=CANON, iso=["100", "Auto"])
        body = body_of(bench)
        bench.snaps["iso"] = "Auto"
        with pytest.raises(CameraProtocolError, match="changed its gain to 'Auto'; turn the mode"):
            body.apply(ExposureSetting(1 / 64, 1.0))

    @pytest.mark.parametrize(
        ("target", "expected"), [("auto", "ram"), ("ram", "ram"), ("card", "card")]
    )
    def test_pictures_go_to_the_memory_or_the_card(self, target: str, expected: str) -> None:
        bench = Bench("Canon", shutterspeed=CANON, capturetarget=["Memory card", "Internal RAM"])
        assert body_of(bench, target).target == expected


class TestBusy:
    @pytest.fixture
    def clock(self) -> VirtualClock:
        return VirtualClock(100.0)

    def busy(self, monkeypatch: pytest.MonkeyPatch, count: int) -> list[str]:
        asked: list[str] = []

        def ask_once(self: CameraProcess, do: str, arguments: Any, *waits_s: float) -> str:
            asked.append(do)
            if len(asked) <= count:
                raise LibraryError(-110, "I/O in progress")
            return "done"

        monkeypatch.setattr(CameraProcess, "_ask_once", ask_once)
        return asked

    def test_a_busy_camera_is_asked_again(
        self, clock: VirtualClock, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        asked = self.busy(monkeypatch, 5)
        with CameraProcess("gphoto2:x", clock) as running:
            assert running.ask("capture", busy_s=30.0) == "done"
        assert len(asked) == 6
        assert clock.now() == pytest.approx(100 + 0.05 + 0.1 + 0.2 + 0.4 + 0.8)

    def test_not_for_ever(self, clock: VirtualClock, monkeypatch: pytest.MonkeyPatch) -> None:
        self.busy(monkeypatch, 10**6)
        with (
            CameraProcess("gphoto2:x", clock) as running,
            pytest.raises(CameraBusyError, match=r"gphoto2:x is busy \(libgphoto2: I/O in"),
        ):
            running.ask("capture", busy_s=30.0)
        assert 30 <= clock.now() - 100 < 33
