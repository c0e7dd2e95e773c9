"""The virtual devices of the guest, and functions for tests that use them."""

from __future__ import annotations

import functools
import json
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import usb.core
from guest_processes import Forked, clock_in_step, spawner, wait_for

from camctl import CaptureReport, read_report
from camctl.findings import Finding
from camctl.interface.camera import Camera, StreamingCamera
from camctl.interface.controls import ExposureSetting
from camctl.profiles.calibrated import open_camera
from camctl.profiles.profile import DelayRecord, change_profile, load_profile
from camctl.records.frame import FrameRecord
from camctl.sim.devices.hub import Hub
from camctl.sim.devices.hub import main as hub_main

DIRECTORY = Path("/run/virtual-devices")
SIZE, SHAPE = "96x72", (72, 96)  # emulated, each pixel takes ten times as long or more

# All cameras see the same ramp of light and draw the same noise for every frame, so that a frame
# depends on its exposure alone.
RAMP = {"scene": "ramp", "seed": 5, "size": SIZE, "repeat_noise": True}
EIGHT_BITS = {**RAMP, "sensor": "standard"}
TWELVE_BITS = {**RAMP, "sensor": "machine-vision"}
# V4L2 does not report a black level, so this sensor has none.
TWELVE_BITS_WITHOUT_BLACK = {**RAMP, "sensor": "ideal-12"}


@dataclass(frozen=True)
class Device:
    """A virtual device.

    Attributes:
        name: its name in the hub
        kind: its kind in the hub: uvc, ptp or sierra
        model: its configuration in the hub, without name, kind and serial number
        options: the camera options (-O) that its driver needs
    """

    name: str
    kind: str
    model: dict[str, Any]
    options: dict[str, str]

    @property
    def serial(self) -> str:
        return f"VIRTUAL-{self.name}"

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
# OpenCV cannot open a camera that offers nothing but these frames.
MOSAIC_SENSOR = {"name": "mosaic", "bits": 12, "layout": "rggb", "full_well_e": 21000}
MOSAIC = Device(
    "mosaic",
    "uvc",
    {
        **RAMP,
        "sensor": str(DIRECTORY / "mosaic.json"),
        "formats": ["rggb16"],
        "fps": [15, 5],
        "delay": 2,
    },
    {"format": "bayer16", "bits": "12", "fps": "15"},
)
UNSTEADY = Device(
    "unsteady",
    "uvc",
    {**EIGHT_BITS, "formats": ["yuyv"], "fps": [15], "delay": 1, "jitter": 2, "luma": "full"},
    {**LINEAR, "format": "yuyv", "range": "full"},
)
# A sensor whose response no driver assumes, and whose noise is new in each frame.
CURVED_SENSOR = {
    "name": "curved",
    "bits": 8,
    "layout": "mono",
    "curve": 0.55,
    "full_well_e": 21000,
    "electrons_per_dn": 80.0,
    "read_noise_e": 8.0,
}
CURVED = Device(
    "curved",
    "uvc",
    {
        **RAMP,
        "size": "160x120",  # its ramp is compared column by column
        "sensor": str(DIRECTORY / "curved.json"),
        "repeat_noise": False,
        "formats": ["yuyv"],
        "fps": [15],
        "delay": 2,
        "luma": "full",
    },
    {"format": "yuyv", "range": "full", "fps": "15"},
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
# Cameras with the operations of a make, for the tests that connect them beside the others.
NIKON, CANON, SONY = MAKES = tuple(
    Device(vendor, "ptp", {**TWELVE_BITS, "vendor": vendor, "files": ["dng"]}, {"format": "raw"})
    for vendor in ("nikon", "canon", "sony")
)
DEVICES = (WEB, MACHINE, MOSAIC, UNSTEADY, CURVED, STILL, RAW, SNAPSHOT, COOLPIX)

# Exposures that all backends have exactly; half of the ramp is saturated in the longest.
EXPOSURES_S = (0.002, 0.008, 0.125)
BRACKET = ("--ratios", "1,4,62.5", "--base", "0.002")
# The same for streams of 15 frames a second.
SHORT_EXPOSURES_S = (0.002, 0.008, 0.032)
SHORT_BRACKET = ("--ratios", "1,4,16", "--base", "0.002")

# Commands of the hub that change nothing.
_READ_ONLY = ("log", "state")


class RecordingHub(Hub):
    """A hub that remembers which devices a test has changed.

    Attributes:
        changed: names of devices that were sent a command that may change them
    """

    def __init__(self, directory: Path) -> None:
        super().__init__(directory)
        self.changed: set[str] = set()

    def do(self, device: str, command: str, **arguments: Any) -> dict[str, Any]:
        """Send a command; see `Hub.do`."""
        if command not in _READ_ONLY:
            self.changed.add(device)
        return super().do(device, command, **arguments)


@contextmanager
def running_hub(
    devices: Sequence[Device] = DEVICES, directory: Path = DIRECTORY
) -> Iterator[RecordingHub]:
    """Run the devices in a process of their own, connected to this kernel's drivers."""
    with clock_in_step():
        process = _start_hub(devices, directory)
        for device in devices:
            wait_for(device.name, functools.partial(is_connected, device))
        usb_device(devices[0])  # loads libusb
    try:
        yield RecordingHub(directory)
    finally:
        process.terminate()


def _start_hub(devices: Sequence[Device], directory: Path) -> Forked:
    directory.mkdir(exist_ok=True, parents=True)
    for sensor in (CURVED_SENSOR, MOSAIC_SENSOR):
        (DIRECTORY / f"{sensor['name']}.json").write_text(json.dumps(sensor))
    config = directory / "config.json"
    config.write_text(json.dumps({"devices": [device.config for device in devices]}))
    modprobe("-a", "vhci-hcd", "uvcvideo", "dummy_hcd", "cdc-acm")
    modprobe("g_serial", "use_acm=1")
    wait_for("/dev/ttyGS0", Path("/dev/ttyGS0").exists)
    process = spawner().start(hub_main, ["--dir", str(directory), str(config)])

    def is_listening() -> bool:
        assert process.status is None, process.err
        return (directory / "ctl").exists()

    wait_for("hub", is_listening)
    return process


def modprobe(*words: str) -> None:
    subprocess.run(["modprobe", *words], check=True)


def video_node(device: Device) -> Path | None:
    """Return the stable name of a webcam's node; None where it is not connected."""
    return next(Path("/dev/v4l/by-id").glob(f"*{device.serial}*-video-index0"), None)


def usb_device(device: Device) -> Any:
    """Return the pyusb device; None where it is not connected."""
    for found in usb.core.find(find_all=True):
        with suppress(ValueError, usb.core.USBError):  # unplugged just now
            if found.serial_number == device.serial:
                return found
    return None


def tty_node() -> Path | None:
    """Return the stable name of the serial port; None where it is not connected."""
    return next(Path("/dev/serial/by-id").glob("*Gadget_Serial*"), None)


def serial_port() -> Path:
    """Return the stable name of the serial port, which is connected."""
    node = tty_node()
    assert node is not None
    return node


def is_connected(device: Device) -> bool:
    """Return whether the kernel has made what the device's driver opens."""
    if device.kind == "uvc":
        return video_node(device) is not None
    if device.kind == "ptp":
        return any(
            path.read_text().strip() == device.serial
            for path in Path("/sys/bus/usb/devices").glob("*/serial")
        )
    return tty_node() is not None


def camera_id(device: Device) -> str:
    """Return the value of --camera for a device."""
    if device.kind == "uvc":
        return f"v4l2:{video_node(device)}"
    if device.kind == "ptp":
        return f"ptp:{device.serial}"
    return f"coolpix:{tty_node()}"


def open_device(device: Device, **options: str) -> Camera:
    """Return the opened camera of a device, opened as on a user's command line."""
    return open_camera(camera_id(device), {**device.options, **options})


def restore(hub: RecordingHub) -> None:
    """End the faults of all devices that were changed, and plug them in again."""
    for device in (each for each in DEVICES if each.name in hub.changed):
        hub.do(device.name, "ok")
        if not is_connected(device):
            hub.do(device.name, "plug")
        wait_for(device.name, functools.partial(is_connected, device))
    hub.changed.clear()


def unplug(hub: Hub, device: Device) -> None:
    """Unplug a device; the kernel has noticed it when this returns."""
    hub.do(device.name, "unplug")
    wait_for(f"end of {device.name}", lambda: not is_connected(device))


def record_delay(device: Device, smallest: int, largest: int) -> None:
    """Write a camera's control delay into its profile, as `camctl calibrate delay` would."""
    with open_device(device) as camera:
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


def recorded_delay(camera: Camera) -> DelayRecord:
    """Return the control delay in a camera's profile."""
    assert isinstance(camera, StreamingCamera)
    return load_profile(camera.info).delays[camera.mode]


@contextmanager
def control_delay(hub: Hub, device: Device, delay: int, gain: int | None = None) -> Iterator[None]:
    """Make a device's controls `delay` frames late, and record that in its profile.

    The delay of its gain is not recorded, where that is another.
    """
    hub.do(device.name, "delay", frames=delay, gain=gain)
    record_delay(device, delay, delay)
    try:
        yield
    finally:
        smallest, largest = device.delays
        hub.do(device.name, "delay", frames=smallest, jitter=largest - smallest)
        record_delay(device, smallest, largest)


@dataclass(frozen=True)
class FrameCost:
    """How many frames a list of exposures took.

    Attributes:
        settings: number of exposures
        frames: slots of the device, from the first that had not begun when the first setting was
            written to the one that had the last setting
        by_timestamps: the same, by the timestamps of the driver's frames
        slots: the slot that had each setting
    """

    settings: int
    frames: int
    by_timestamps: int
    slots: list[int]


def frame_cost(hub: Hub, device: Device) -> FrameCost:
    """Shoot six exposures that no other frame has; return how many frames they took."""
    times_s = [0.0021, 0.0043, 0.0087, 0.0033, 0.0065, 0.0129]
    with open_device(device) as camera:
        settings = [setting(camera, time_s) for time_s in times_s]
        with closing(camera.shoot(settings)) as stream:
            stamps = [frame.timestamp_s for frame in stream]
        interval_s = camera.controls.frame_interval_s
        log = hub.do(device.name, "log")
    first = next(w for w in reversed(log["writes"]) if w["time_s"] == pytest.approx(times_s[0]))
    # With a delay of -1 the slot that was exposed at the write has the first setting.
    since = [frame for frame in log["frames"] if frame["slot"] >= first["upcoming"]]
    frames = iter([each for each in log["frames"] if each["slot"] >= first["upcoming"] - 1])
    slots = [
        next(frame["slot"] for frame in frames if round(frame["time_s"], 6) == time_s)
        for time_s in times_s
    ]
    begin_s = since[0]["ended_s"] - interval_s
    return FrameCost(
        settings=len(times_s),
        frames=slots[-1] - first["upcoming"] + 1,
        by_timestamps=round((stamps[-1] - begin_s) / interval_s),
        slots=slots,
    )


def completed_frames(directory: str) -> list[FrameRecord]:
    """Return the frames of a capture that is complete and whose frames agree with each other."""
    report = read_report(Path(directory))
    assert report.status == "complete"
    frames = [frame for frame in report.frames if frame is not None]
    assert len(frames) == len(report.frames)
    assert all(frame.ratio is not None and frame.ratio.agrees for frame in frames[1:])
    return frames


def distrust_warnings(report: CaptureReport) -> list[Finding]:
    """Return where a capture's frames do not have the exposures they should."""
    return [finding for finding in report.findings if finding.code == "exposure_differs"]


def setting(camera: Camera, time_s: float) -> ExposureSetting:
    """Return the setting of a camera that is nearest to a shutter time."""
    return ExposureSetting(camera.controls.time_s.nearest(time_s))


def camera_arguments(device: Device, **options: str) -> list[str]:
    """Return the arguments that name a device's camera to `camctl shoot`."""
    words = ["--camera", camera_id(device)]
    for name, value in {**device.options, **options}.items():
        words += ["-O", f"{name}={value}"]
    return words
