"""The devices of the laboratory, and words to speak of them."""

from __future__ import annotations

import fcntl
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import usb.core

from camctl.backends import open_camera
from camctl.camera import Camera, StreamingCamera
from camctl.captures.report import CaptureReport
from camctl.cli import main
from camctl.controls import ExposureSetting
from camctl.errors import CamctlError
from camctl.profile import DelayRecord, change_profile
from sim.devices.hub import Hub

# The tests run as two processes side by side, streams in one and all else in the other: most of
# the time goes by in time-outs.  Each has devices of its own.
STREAMS = os.environ.get("CAMCTL_LAB_PART") == "streams"
DIRECTORY = Path("/run/laboratory", "streams" if STREAMS else "stills")
SIZE, SHAPE = "160x120", (120, 160)

# All look at the same ramp of light and draw the same noise for every frame, so that a frame
# depends on its exposure alone.
BEFORE_THE_RAMP = {"scene": "ramp", "seed": 5, "size": SIZE, "repeat_noise": True}
EIGHT_BITS = {**BEFORE_THE_RAMP, "sensor": "standard"}
TWELVE_BITS = {**BEFORE_THE_RAMP, "sensor": "machine-vision"}
# V4L2 tells nobody of a black level, so that this one has none.
TWELVE_BITS_WITHOUT_BLACK = {**BEFORE_THE_RAMP, "sensor": "ideal-12"}


@dataclass(frozen=True)
class Device:
    """A virtual device: what it is, and what our driver has to be told of it."""

    name: str
    kind: str
    model: dict[str, Any]
    options: dict[str, str]

    @property
    def serial(self) -> str:
        return f"LAB-{self.name}"

    @property
    def delays(self) -> tuple[int, int]:
        """The smallest and the largest delay of a streaming camera's controls, frames."""
        return self.model["delay"], self.model["delay"] + self.model.get("jitter", 0)

    @property
    def config(self) -> dict[str, Any]:
        return {"name": self.name, "kind": self.kind, "serial": self.serial, **self.model}


LINEAR = {"response": "linear"}
WEB = Device(
    "web",
    "uvc",
    {**EIGHT_BITS, "formats": ["yuyv", "mjpg"], "fps": [15, 5], "delay": 2, "luma": "full"},
    {**LINEAR, "format": "yuyv", "range": "full", "fps": "15"},
)
MACHINE = Device(
    "machine",
    "uvc",
    {**TWELVE_BITS_WITHOUT_BLACK, "formats": ["y16"], "fps": [15, 5], "delay": 1},
    {**LINEAR, "format": "y16", "bits": "12", "fps": "15"},
)
SHAKY = Device(
    "shaky",
    "uvc",
    {**EIGHT_BITS, "formats": ["yuyv"], "fps": [15], "delay": 1, "jitter": 2, "luma": "full"},
    {**LINEAR, "format": "yuyv", "range": "full"},
)
STILL = Device(
    "still",
    "ptp",
    {**EIGHT_BITS, "files": ["tiff"], "time_form": "range"},
    {**LINEAR, "format": "tiff"},
)
RAW = Device("raw", "ptp", {**TWELVE_BITS, "files": ["dng"]}, {"format": "raw"})
SNAPSHOT = Device("snapshot", "ptp", {**EIGHT_BITS, "files": ["jpeg"]}, LINEAR)
COOLPIX = Device(
    "coolpix",
    "sierra",
    {**EIGHT_BITS, "files": ["tiff", "jpeg"], "line": "/dev/ttyGS0"},
    {**LINEAR, "format": "tiff", "speed": "115200"},
)
SPARE = Device(
    "spare", "uvc", {**EIGHT_BITS, "formats": ["yuyv"], "fps": [15], "delay": 2}, WEB.options
)
DEVICES = (WEB, MACHINE, SHAKY) if STREAMS else (STILL, RAW, SNAPSHOT, COOLPIX, SPARE)

# Exposures that all roads have exactly; half of the ramp is saturated in the longest.
EXPOSURES_S = (0.002, 0.008, 0.125)
BRACKET = ("--ratios", "1,4,62.5", "--base", "0.002")
# The same for streams of 15 frames a second.
SHORT_EXPOSURES_S = (0.002, 0.008, 0.032)
SHORT_BRACKET = ("--ratios", "1,4,16", "--base", "0.002")


def wait_for(what: str, condition: Any, seconds: float = 20.0) -> Any:
    """Return what `condition` returns as soon as that is true."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError(f"no {what} after {seconds:g} s")


def modprobe(*words: str) -> None:
    subprocess.run(["modprobe", *words], check=True)


def video_node(device: Device) -> Path | None:
    return next(Path("/dev/v4l/by-id").glob(f"*{device.serial}*-video-index0"), None)


def usb_device(device: Device) -> Any:
    """Return the pyusb device; None where it is not there."""
    found = usb.core.find(find_all=True)
    return next((each for each in found if each.serial_number == device.serial), None)


def tty_node() -> Path | None:
    return next(Path("/dev/serial/by-id").glob("*Gadget_Serial*"), None)


def is_there(device: Device) -> bool:
    """Say whether the kernel has made of the device what its driver opens."""
    if device.kind == "uvc":
        return video_node(device) is not None
    if device.kind == "ptp":
        return any(
            path.read_text().strip() == device.serial
            for path in Path("/sys/bus/usb/devices").glob("*/serial")
        )
    return tty_node() is not None


def camera_id(device: Device) -> str:
    """Return what stands after --camera."""
    if device.kind == "uvc":
        return f"v4l2:{video_node(device)}"
    if device.kind == "ptp":
        return f"ptp:{device.serial}"
    return f"coolpix:{tty_node()}"


def opened(device: Device, **options: str) -> Camera:
    """Return the camera behind a device, opened as a user's words would."""
    return open_camera(camera_id(device), {**device.options, **options})


def make_well(hub: Hub, device: Device) -> None:
    """Plug a device in again and end its faults."""
    hub.do(device.name, "ok")
    if not is_there(device):
        hub.do(device.name, "plug")
    wait_for(device.name, lambda: is_there(device))


def unplug(hub: Hub, device: Device) -> None:
    """Pull a device's plug; the kernel has noticed it when this returns."""
    hub.do(device.name, "unplug")
    wait_for(f"end of {device.name}", lambda: not is_there(device))


def know_delay(device: Device, smallest: int, largest: int) -> None:
    """Write a camera's delay into its profile, as `camctl calibrate delay` would."""
    with opened(device) as camera:
        assert isinstance(camera, StreamingCamera)
        info, mode = camera.info, camera.mode
    record = DelayRecord(
        frames=smallest if smallest == largest else None,
        smallest=smallest,
        largest=largest,
        trials=9,
        measured_at="2026-01-01T00:00:00+00:00",
    )
    change_profile(info, lambda profile: profile.delays.update({mode: record}))


@contextmanager
def delayed(hub: Hub, device: Device, delay: int) -> Iterator[None]:
    """Let the controls of a device be `delay` frames late, and its profile say so."""
    hub.do(device.name, "delay", frames=delay)
    know_delay(device, delay, delay)
    try:
        yield
    finally:
        smallest, largest = device.delays
        hub.do(device.name, "delay", frames=smallest, jitter=largest - smallest)
        know_delay(device, smallest, largest)


@dataclass(frozen=True)
class Used:
    """What a list of exposures cost.

    Attributes:
        settings: how many there were
        frames: slots of the device from the first that had not begun when the first setting was
            written to the one that had the last setting
        by_timestamps: the same, as the timestamps of the driver's frames tell it
        slots: the slot that had each setting
    """

    settings: int
    frames: int
    by_timestamps: int
    slots: list[int]


def frames_used(hub: Hub, device: Device) -> Used:
    """Shoot six exposures that no other frame has; return what they cost."""
    wanted = [0.0021, 0.0043, 0.0087, 0.0033, 0.0065, 0.0129]
    with opened(device) as camera:
        settings = [setting(camera, time_s) for time_s in wanted]
        with closing(camera.shoot(settings)) as stream:
            stamps = [frame.timestamp_s for frame in stream]
        interval_s = camera.controls.frame_interval_s
        log = hub.do(device.name, "log")
    first = next(w for w in reversed(log["writes"]) if w["time_s"] == pytest.approx(wanted[0]))
    since = [frame for frame in log["frames"] if frame["slot"] >= first["upcoming"]]
    frames = iter(since)
    slots = [
        next(frame["slot"] for frame in frames if round(frame["time_s"], 6) == time_s)
        for time_s in wanted
    ]
    begin_s = since[0]["ended_s"] - interval_s
    return Used(
        settings=len(wanted),
        frames=slots[-1] - first["upcoming"] + 1,
        by_timestamps=round((stamps[-1] - begin_s) / interval_s),
        slots=slots,
    )


def start_devices(devices: Sequence[Device] = DEVICES) -> tuple[subprocess.Popen[bytes], Hub]:
    """Start all devices in a process of their own; they are there when this returns."""
    DIRECTORY.mkdir(exist_ok=True, parents=True)
    config = DIRECTORY / "config.json"
    config.write_text(json.dumps({"devices": [device.config for device in devices]}))
    # Two processes that look for a free port at once would take the same one.
    with (DIRECTORY.parent / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        modprobe("-a", "vhci-hcd", "uvcvideo", "dummy_hcd", "cdc-acm")
        modprobe("g_serial", "use_acm=1")
        wait_for("/dev/ttyGS0", Path("/dev/ttyGS0").exists)
        process = subprocess.Popen(
            [sys.executable, "-m", "sim.devices", "--dir", str(DIRECTORY), str(config)]
        )
        wait_for("hub", (DIRECTORY / "ctl").exists, 60)
    for device in devices:
        wait_for(device.name, lambda device=device: is_there(device))
    return process, Hub(DIRECTORY)


@contextmanager
def once_a_frame_is_kept(directory: Path, strike: Callable[[], Any]) -> Iterator[None]:
    """Let `strike` happen in a thread as soon as a capture has kept its first frame."""
    with once(directory / "frames", "*.npy", strike):
        yield


@contextmanager
def once(folder: Path, pattern: str, strike: Callable[[], Any]) -> Iterator[None]:
    """Let `strike` happen in a thread as soon as a file of that pattern lies in `folder`."""
    over = threading.Event()

    def watch() -> None:
        while not over.is_set():
            if next(folder.glob(pattern), None) is not None:
                strike()
                return
            time.sleep(0.005)

    thread = threading.Thread(target=watch)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


@contextmanager
def once_a_frame_is_rejected(directory: Path, strike: Callable[[], Any]) -> Iterator[None]:
    """Let `strike` happen in a thread as soon as a capture has rejected a frame."""
    with once(directory / "frames", "*-rejected-*.npy", strike):
        yield


def timed(act: Callable[[], str]) -> tuple[str, float]:
    """Return what `act` returns, and how long it took, s."""
    began = time.monotonic()
    return act(), time.monotonic() - began


def one_line(error: CamctlError) -> str:
    """Return the text of an error that is one line with a next step."""
    assert error.hint
    assert "\n" not in str(error)
    return str(error)


def distrusted(report: CaptureReport) -> list[str]:
    """Return the warnings that a capture's frames do not have the exposures they should."""
    return [warning for warning in report.warnings if "do not trust" in warning]


def here() -> Path:
    """Return the test's own folder, which commands are run in."""
    return Path.cwd()


def setting(camera: Camera, time_s: float) -> ExposureSetting:
    return ExposureSetting(camera.controls.time_s.nearest(time_s))


@dataclass(frozen=True)
class Ran:
    """What a command line left behind."""

    status: int
    out: str
    err: str
    seconds: float


def camctl(capfd: Any, *words: object) -> Ran:
    """Run a command line of camctl in this process."""
    capfd.readouterr()
    began = time.monotonic()
    status = main([str(word) for word in words])
    seconds = time.monotonic() - began
    out, err = capfd.readouterr()
    return Ran(status, out, err, seconds)


def words_of(device: Device, **options: str) -> list[str]:
    """Return the words that name a device's camera to `camctl shoot`."""
    words = ["--camera", camera_id(device)]
    for name, value in {**device.options, **options}.items():
        words += ["-O", f"{name}={value}"]
    return words
