"""The real roads through the command line: what goes well, and one line for what goes wrong."""

from __future__ import annotations

import errno
import functools
import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import serial
import usb.backend.libusb1
import usb.core
from ptp_bench import bench
from v4l2_model import Model

import drivers.coolpix.camera
from camctl.profile import list_profiles
from drivers.common.usb import UDEV_RULES
from drivers.v4l2 import backend as v4l2
from drivers.v4l2.abi import Linux
from sim.devices.clock import RealDeviceClock
from sim.devices.ptp.camera import PtpCamera as VirtualStill
from sim.devices.sierra.device import SierraDevice, make
from sim.devices.usb.backend import VirtualBackend

if TYPE_CHECKING:
    from conftest import Run

BASE = ("--base", "1/125", "--ratios", "1,2,4")


def refusal(run: Run, *words: str) -> str:
    """Return the one line of a command that has to fail, soon and before it leaves anything."""
    began = time.monotonic()
    ran = run(*words)
    assert ran.status in (1, 2)
    assert time.monotonic() - began < 15
    assert ";" in ran.error, "the line ends with what to do next"
    assert list(Path().iterdir()) == []
    return ran.error


# Nothing is connected.


@pytest.mark.parametrize(
    ("camera", "said"),
    [
        ("v4l2:/dev/video9999", "cannot open /dev/video9999: there is no such device; camctl cam"),
        ("v4l2:/dev/null", "it is not a video device; camctl cameras lists"),
        ("v4l2:/tmp", "it is a folder, not a camera; camctl cameras lists"),
        ("coolpix", "needs its serial port; give it, such as coolpix:/dev/ttyUSB0"),
        ("coolpix:/dev/ttyUSB9999", "there is no such port; camctl cameras --probe asks"),
        ("coolpix:/dev/null", "it is not a serial port; camctl cameras --probe asks"),
        ("coolpix:nonsense://x", "'nonsense://x' is not a serial port"),
        ("coolpix:socket://localhost:1", "no server listens at that address; start the program"),
    ],
)
@pytest.mark.parametrize("command", [("shoot",), ("calibrate", "delay")])
def test_no_such_camera(run: Run, command: tuple[str, ...], camera: str, said: str) -> None:
    assert said in refusal(run, *command, "--camera", camera)


@pytest.mark.parametrize(
    ("camera", "option", "said"),
    [
        ("v4l2:/dev/video0", "fromat=y16", "unknown camera option 'fromat'; did you mean format?"),
        ("v4l2:/dev/video0", "size=wide", "invalid camera option size=wide; write WIDTHxHEIGHT"),
        ("v4l2:/dev/video0", "fps=fast", "option fps=fast; input should be a valid number"),
        ("v4l2:/dev/video0", "bits=many", "option bits=many; input should be a valid integer"),
        ("ptp:1", "scene=room", "unknown camera option 'scene'"),
        ("ptp:1", "bulb=long", "invalid camera option bulb=long; input should be a valid number"),
        ("coolpix:/dev/ttyUSB0", "sped=9600", "unknown camera option 'sped'; did you mean speed"),
        ("coolpix:/dev/ttyUSB0", "speed=1", "invalid camera option speed=1; the camera has the"),
    ],
)
def test_unknown_options(run: Run, camera: str, option: str, said: str) -> None:
    assert said in refusal(run, "shoot", "--camera", camera, "-O", option)


def forbid(*_: object, **__: object) -> None:
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def test_no_permission_says_how_to_get_it(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(Linux, "open", forbid)
        said = refusal(run, "shoot", "--camera", "v4l2:/dev/video0")
    assert "not allowed" in said
    assert "sudo usermod -aG video" in said
    monkeypatch.setattr(serial, "serial_for_url", forbid)
    said = refusal(run, "shoot", "--camera", "coolpix:/dev/ttyUSB0")
    assert "no permission" in said
    assert "sudo usermod -aG dialout" in said


def test_without_libusb_the_other_roads_are_listed(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(**_: object) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", missing)
    assert "libusb is not installed" in refusal(run, "shoot", "--camera", "ptp:1")
    ran = run("cameras")
    assert ran.status == 0
    assert "camctl: warning: ptp: libusb is not installed" in ran.err
    assert "sudo apt-get install libusb-1.0-0" in ran.err
    (line,) = [line for line in ran.out.splitlines() if line.startswith("ptp ")]
    assert "cannot look" in line
    assert any(line.startswith("sim ") for line in ran.out.splitlines())


def test_every_road_says_what_it_is(run: Run) -> None:
    roads = run("cameras").out.split("\n\n")[1].splitlines()[1:]
    assert {road.split()[0] for road in roads} >= {"coolpix", "ptp", "sim", "v4l2"}
    assert all(len(road.split()) > 5 for road in roads)


def test_udev_rules_come_alone(run: Run) -> None:
    ran = run("cameras", "--udev-rules")
    assert ran.out == UDEV_RULES
    assert ran.err == ""
    assert 'TAG+="uaccess"' in ran.out


# A webcam, by a model of the kernel.


@pytest.fixture
def webcam(monkeypatch: pytest.MonkeyPatch) -> Model:
    model = Model()
    real = v4l2.V4l2Camera

    def on_the_model(path: str, options: v4l2.V4l2Options) -> v4l2.V4l2Camera:
        return real(path, options, clock=model.clock, kernel=model, opener=model.video)

    monkeypatch.setattr(v4l2, "V4l2Camera", on_the_model)
    return model


def test_a_webcam_shoots_and_says_that_it_settles(run: Run, webcam: Model) -> None:
    words = ("shoot", "--camera", "v4l2:/dev/video0", *BASE, "-o", "here")
    ran = run(*words, "--json")
    assert ran.json["status"] == "complete"
    (note,) = [text for text in ran.json["warnings"] if "control delay not measured" in text]
    assert "camctl calibrate delay --camera v4l2:/dev/video0" in note
    assert ran.err.count(note) == 1
    kept = json.loads(Path("here/report.json").read_text())
    assert note in kept["warnings"]


@pytest.mark.parametrize("delay", [0, 2, 5])
def test_a_webcams_delay_is_measured_kept_and_used(run: Run, webcam: Model, delay: int) -> None:
    webcam.delay = delay
    camera = ("--camera", "v4l2:/dev/video0")
    told = run("calibrate", "delay", *camera, "--json").json
    assert told["frames"] == delay
    (kept,) = list_profiles()
    assert kept.delays[told["mode"]].frames == delay
    ran = run("shoot", *camera, *BASE, "-o", "here", "--json")
    assert ran.json["status"] == "complete"
    assert not [text for text in ran.json["warnings"] if "delay" in text]


def test_a_webcam_whose_delay_varies_settles_and_says_so(run: Run, webcam: Model) -> None:
    webcam.delays = lambda number: 1 + number // 2 % 2
    camera = ("--camera", "v4l2:/dev/video0")
    ran = run("calibrate", "delay", *camera, "--trials", "24")
    assert "1 to 2 frames, not constant" in ran.out
    shot = run("shoot", *camera, *BASE, "-o", "here", "--json")
    assert shot.json["status"] == "complete"
    assert any("not constant (1 to 2 frames)" in text for text in shot.json["warnings"])


# A still camera on a virtual bus.


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> Callable[..., VirtualStill]:
    def plugged(**config: Any) -> VirtualStill:
        pair = bench(clock=RealDeviceClock(), **config)
        monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda *_, **__: pair.backend)
        return pair.device

    return plugged


def test_a_still_camera_is_listed_and_shoots(run: Run, still: Callable[..., VirtualStill]) -> None:
    still(files="tiff", serial="A77")
    listed = {each["id"]: each for each in run("cameras", "--json").json}
    assert listed["ptp:A77"]["driver"] == "ptp"
    words = ("shoot", "--camera", "ptp:A77", *BASE, "-o", "here", "-O", "response=linear")
    told = run(*words, "--json").json
    assert told["status"] == "complete"
    assert told["camera"]["serial"] == "A77"
    for frame in told["frames"]:
        assert Path("here", frame["original"]).suffix == ".tif"


def test_a_still_camera_needs_no_delay_and_asks_before_it_meters(
    run: Run, still: Callable[..., VirtualStill]
) -> None:
    still(files="tiff")
    said = refusal(run, "calibrate", "delay", "--camera", "ptp")
    assert said == "this camera does not stream; a still camera has no control delay"
    assert "--meter" in refusal(run, "shoot", "--camera", "ptp")


@pytest.mark.parametrize(
    ("config", "verb", "said"),
    [
        ({"mode": "auto"}, None, "turn the mode dial to m"),
        ({}, "card_full", "card"),
        ({}, "battery_low", "batter"),
    ],
)
def test_what_a_person_must_see_to_at_the_camera(
    run: Run,
    still: Callable[..., VirtualStill],
    config: dict[str, str],
    verb: str | None,
    said: str,
) -> None:
    device = still(files="tiff", **config)
    if verb is not None:
        device.do(verb)
    ran = run("shoot", "--camera", "ptp", *BASE, "-o", "here")
    assert ran.status == 1
    line = ran.err.splitlines()[-1]
    assert said in line.lower()
    assert line.startswith("camctl: ")
    assert ";" in line


def test_another_still_camera_is_named(run: Run, still: Callable[..., VirtualStill]) -> None:
    still(files="tiff", serial="A77")
    said = refusal(run, "shoot", "--camera", "ptp:B")
    assert said == "there is no still camera ptp:B; connected: ptp:A77"


def test_a_still_camera_without_permission_names_the_rules(
    run: Run, monkeypatch: pytest.MonkeyPatch, still: Callable[..., VirtualStill]
) -> None:
    still(files="tiff")

    def denied(*_: object) -> None:
        raise usb.core.USBError("Access denied (insufficient permissions)", -3, errno.EACCES)

    monkeypatch.setattr(VirtualBackend, "open_device", denied)
    assert "camctl cameras --udev-rules | sudo tee" in refusal(run, "shoot", "--camera", "ptp")


# A CoolPix on a pseudo-terminal.


@pytest.fixture
def coolpix() -> Iterator[SierraDevice]:
    seen = {"scene": "ramp", "sensor": "standard", "size": "32x24", "repeat_noise": True}
    device = make({"name": "coolpix", "kind": "sierra", **seen})
    device.attach()
    yield device
    device.detach()


def test_a_coolpix_shoots(run: Run, coolpix: SierraDevice) -> None:
    words = ("shoot", "--camera", f"coolpix:{coolpix.line.path}", *BASE, "-o", "here")
    told = run(*words, "-O", "format=tiff", "-O", "response=linear", "--json").json
    assert told["status"] == "complete"
    assert told["source"]["options"] == {"format": "tiff", "response": "linear"}


def test_a_line_that_answers_nonsense_is_no_camera(
    run: Run, coolpix: SierraDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    hurried = functools.partial(drivers.coolpix.CoolpixCamera, timeout_s=0.5)
    monkeypatch.setattr(drivers.coolpix.backend, "CoolpixCamera", hurried)
    coolpix.do("garbage", count=1_000_000)
    said = refusal(run, "shoot", "--camera", f"coolpix:{coolpix.line.path}", *BASE)
    assert coolpix.line.path in said


def test_probing_finds_a_coolpix_and_looking_leaves_the_line_alone(
    run: Run, coolpix: SierraDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("drivers.coolpix.backend.serial_ports", lambda: [coolpix.line.path])
    # Long enough for a busy machine; the camera answers at once.
    monkeypatch.setattr("drivers.coolpix.backend._PROBE_S", 60.0)
    monkeypatch.setattr("drivers.coolpix.backend._PORT_TIMEOUT_S", 60.0)
    assert "coolpix" not in {each["driver"] for each in run("cameras", "--json").json}
    assert coolpix.camera is not None
    found = {each["driver"] for each in run("cameras", "--probe", "--json").json}
    assert "coolpix" in found
