"""The command line with the drivers on virtual hardware: captures, and one line per error."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import serial
import usb.backend.libusb1
import usb.core
from command_line import Run
from ptp_bench import bench
from v4l2_model import Model
from virtual_usb_bus import VirtualBackend

from camctl.drivers.common.usb import UDEV_RULES
from camctl.drivers.v4l2 import backend as v4l2
from camctl.drivers.v4l2.camera import V4l2Camera, V4l2Options
from camctl.drivers.v4l2.kernel import Linux
from camctl.profiles.folder import list_profiles
from camctl.sim.devices.clock import RealDeviceClock
from camctl.sim.devices.ptp.camera import PtpCamera as VirtualStill
from camctl.sim.devices.sierra.device import SierraDevice, make

BASE = ("--base", "1/125", "--ratios", "1,2,4")


def error_of(run: Run, *arguments: str) -> str:
    """Return the error of a command that must fail with a hint and leave no files."""
    ran = run(*arguments)
    assert ran.status in (1, 2)
    message, separator, hint = ran.error.partition("; ")
    assert message
    assert separator
    assert hint
    assert list(Path().iterdir()) == []
    return ran.error


# Nothing is connected.


@pytest.mark.parametrize(
    ("camera", "message"),
    [
        (
            "v4l2:/dev/video9999",
            "there is no such device; list the cameras",
        ),
        ("v4l2:/dev/null", "it is not a video device; list the cameras"),
        ("v4l2:/tmp", "it is a folder, not a camera; list the cameras"),
        ("coolpix", "needs its serial port; give it, such as coolpix:/dev/ttyUSB0"),
        ("coolpix:/dev/ttyUSB9999", "there is no such port; look for a camera at"),
        ("coolpix:/dev/null", "it is not a serial port; look for a camera at"),
        ("coolpix:nonsense://x", "'nonsense://x' is not a serial port"),
        ("coolpix:socket://localhost:1", "no server listens at that address; start the program"),
    ],
)
def test_camera_that_does_not_exist(run: Run, camera: str, message: str) -> None:
    assert message in error_of(run, "calibrate", "delay", "--camera", camera)


@pytest.mark.parametrize(
    ("camera", "option", "message"),
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
def test_invalid_camera_option(run: Run, camera: str, option: str, message: str) -> None:
    assert message in error_of(run, "shoot", "--camera", camera, "-O", option)


def deny(*_: object, **__: object) -> None:
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def test_missing_permission_is_explained(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr(Linux, "open", deny)
        error = error_of(run, "shoot", "--camera", "v4l2:/dev/video0")
    assert "not allowed" in error
    assert "sudo usermod -aG video" in error
    monkeypatch.setattr(serial, "serial_for_url", deny)
    error = error_of(run, "shoot", "--camera", "coolpix:/dev/ttyUSB0")
    assert "no permission" in error
    assert "sudo usermod -aG dialout" in error


def test_other_backends_are_listed_without_libusb(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing(**_: object) -> None:
        raise usb.core.NoBackendError("No backend available")

    monkeypatch.setattr(usb.core, "find", missing)
    assert "libusb is not installed" in error_of(run, "shoot", "--camera", "ptp:1")
    ran = run("cameras")
    assert ran.status == 0
    assert "camctl: warning: ptp: libusb is not installed" in ran.err
    assert "sudo apt-get install libusb-1.0-0" in ran.err
    (line,) = [line for line in ran.out.splitlines() if line.startswith("ptp ")]
    assert "search failed" in line
    assert any(line.startswith("sim ") for line in ran.out.splitlines())


def test_every_backend_has_a_description(run: Run) -> None:
    lines = run("cameras").out.split("\n\n")[1].splitlines()[1:]
    assert {line.split()[0] for line in lines} >= {"coolpix", "ptp", "sim", "v4l2"}
    assert all(len(line.split()) > 5 for line in lines)


def test_udev_rules_are_all_that_is_printed(run: Run) -> None:
    ran = run("cameras", "--udev-rules")
    assert ran.out == UDEV_RULES
    assert ran.err == ""
    assert 'TAG+="uaccess"' in ran.out


# A webcam, by a model of the kernel.


@pytest.fixture
def webcam(monkeypatch: pytest.MonkeyPatch) -> Model:
    model = Model()

    def on_the_model(path: str, options: V4l2Options) -> V4l2Camera:
        return V4l2Camera(path, options, clock=model.clock, kernel=model)

    monkeypatch.setattr(v4l2, "V4l2Camera", on_the_model)
    return model


def test_webcam_without_measured_delay_shoots_with_a_warning(run: Run, webcam: Model) -> None:
    arguments = ("shoot", "--camera", "v4l2:/dev/video0", *BASE, "-o", "here")
    ran = run(*arguments, "--json")
    assert ran.json["status"] == "complete"
    (note,) = [text for text in ran.json["warnings"] if "control delay not measured" in text]
    assert note == "control delay not measured: the stream settles after each exposure"
    assert ran.err.count(note) == 1
    kept = json.loads(Path("here/report.json").read_text())
    assert note in kept["warnings"]


def test_constant_delay_of_a_webcam_is_measured_kept_and_used(run: Run, webcam: Model) -> None:
    webcam.delay = 2
    camera = ("--camera", "v4l2:/dev/video0")
    output = run("calibrate", "delay", *camera, "--json").json
    assert output["frames"] == 2
    (kept,) = list_profiles()
    assert kept.delays[output["mode"]].frames == 2
    ran = run("shoot", *camera, *BASE, "-o", "here", "--json")
    assert ran.json["status"] == "complete"
    codes = {finding["code"] for finding in ran.json["findings"]}
    assert not codes & {"delay_unknown", "delay_varies", "delay_contradicts"}


# A still camera on a virtual bus.


@pytest.fixture
def still(monkeypatch: pytest.MonkeyPatch) -> Callable[..., VirtualStill]:
    def plugged(**config: Any) -> VirtualStill:
        pair = bench(clock=RealDeviceClock(), **config)
        monkeypatch.setattr(usb.backend.libusb1, "get_backend", lambda *_, **__: pair.backend)
        return pair.device

    return plugged


def test_still_camera_is_listed_and_shoots(run: Run, still: Callable[..., VirtualStill]) -> None:
    still(files="tiff", serial="A77")
    listed = {each["id"]: each for each in run("cameras", "--json").json["cameras"]}
    assert listed["ptp:A77"]["driver"] == "ptp"
    arguments = ("shoot", "--camera", "ptp:A77", *BASE, "-o", "here", "-O", "response=linear")
    output = run(*arguments, "--json").json
    assert output["status"] == "complete"
    assert output["camera"]["serial"] == "A77"
    for frame in output["frames"]:
        assert Path("here", frame["original"]).suffix == ".tif"


def test_a_still_camera_is_not_live(run: Run, still: Callable[..., VirtualStill]) -> None:
    still(files="tiff", serial="A77")
    error = run("live", "--camera", "ptp:A77", "--output", "http:0", "-n", "2").error
    assert error.startswith("ptp:A77 takes single pictures, and does not stream; take pictures")


def test_still_camera_has_times_and_no_delay_and_meters_only_with_the_option(
    run: Run, still: Callable[..., VirtualStill]
) -> None:
    still(files="tiff")
    ran = run("calibrate", "delay", "--camera", "ptp")
    assert ran.status == 0
    assert "control delay       none: a still camera" in ran.out
    assert "picture to picture" in ran.out
    assert "--meter" in error_of(run, "shoot", "--camera", "ptp")


def test_still_camera_without_permission_needs_the_udev_rules(
    run: Run, monkeypatch: pytest.MonkeyPatch, still: Callable[..., VirtualStill]
) -> None:
    still(files="tiff")

    def refuse(*_: object) -> None:
        raise usb.core.USBError("Access denied (insufficient permissions)", -3, errno.EACCES)

    monkeypatch.setattr(VirtualBackend, "open_device", refuse)
    assert "camctl cameras --udev-rules | sudo tee" in error_of(run, "shoot", "--camera", "ptp")


# A CoolPix on a pseudo-terminal.


@pytest.fixture
def coolpix() -> Iterator[SierraDevice]:
    scenery = {"scene": "ramp", "sensor": "standard", "size": "32x24", "repeat_noise": True}
    device = make({"name": "coolpix", "kind": "sierra", **scenery})
    device.attach()
    yield device
    device.detach()


def test_coolpix_shoots(run: Run, coolpix: SierraDevice) -> None:
    arguments = ("shoot", "--camera", f"coolpix:{coolpix.line.path}", *BASE, "-o", "here")
    output = run(*arguments, "-O", "format=tiff", "-O", "response=linear", "--json").json
    assert output["status"] == "complete"
    assert output["source"]["options"] == {"format": "tiff", "response": "linear"}


def test_coolpix_is_found_only_with_probe(
    run: Run, coolpix: SierraDevice, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camctl.drivers.coolpix.backend.serial_ports", lambda: [coolpix.line.path])
    # Long enough for a busy machine; the camera answers at once.
    monkeypatch.setattr("camctl.drivers.coolpix.backend._PROBE_S", 60.0)
    monkeypatch.setattr("camctl.drivers.coolpix.backend._PORT_TIMEOUT_S", 60.0)
    assert "coolpix" not in {each["driver"] for each in run("cameras", "--json").json["cameras"]}
    assert coolpix.camera is not None
    found = {each["driver"] for each in run("cameras", "--probe", "--json").json["cameras"]}
    assert "coolpix" in found
