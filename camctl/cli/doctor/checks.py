"""What `camctl doctor` looks at; each check returns what is there, and what to do."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Callable, Iterator
from importlib.metadata import PackageNotFoundError, distribution, requires
from pathlib import Path
from typing import Final, Literal

from pydantic import BaseModel, ConfigDict

import camctl
from camctl.cli.cameras import UDEV_FILE
from camctl.cli.configuration import Configuration, configuration_file
from camctl.errors import CamctlError
from camctl.messages.command_line import COMMANDS, error_hint

State = Literal["ok", "missing", "problem"]


class Check(BaseModel):
    """One thing that was looked at.

    Attributes:
        name: of it
        state: "ok"; "missing": it is optional, and not there; "problem": it is there, or needed,
            and does not work
        found: what is there, one line
        to_do: what to do about it; None: nothing
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    state: State
    found: str
    to_do: str | None = None


class Diagnosis(BaseModel):
    """What `camctl doctor --json` prints.

    Attributes:
        format_version: of this output
        camctl, python, platform: versions
        checks: in the order of the table
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    format_version: Literal[1] = 1
    camctl: str
    python: str
    platform: str
    checks: tuple[Check, ...]


#: Distributions that install the same package, cv2: only one of them can be in one place.
OPENCV: Final = (
    "opencv-contrib-python-headless",
    "opencv-contrib-python",
    "opencv-python-headless",
    "opencv-python",
)
#: Extra of camctl that users may want: what it is for, as docs/how-to/install.md has it.
EXTRAS: Final = {
    "raw": "camera raw files",
    "tiff": "TIFF files of compressions that OpenCV does not read; `picture.avif`",
    "gphoto2": "the cameras of libgphoto2",
    "libcamera": "cameras of the Raspberry Pi",
    "genicam": "machine-vision cameras on x86-64 where Aravis is not installed",
    "hd44780": "character displays at I2C, for the menu",
    "luma": "graphic displays at I2C and SPI, for the menu",
    "gpio": "buttons and rotary encoders at GPIO lines, for the menu",
    "mqtt": "Home Assistant and MQTT, for the menu",
    "plots": "plots: `--plot`, `camctl figures`, `plot` of calibrations",
    "studies": "the other methods in `camctl tradeoff solver`, and plots",
    "fast": "a faster simulated camera, faster merges, and faster sums in long live streams",
    "bluesky": "a detector for bluesky's RunEngine",
    "dask": "studies on a Dask cluster",
}
#: A requirement of an extra in the metadata of a distribution: its name and the extra.
_OF_EXTRA = re.compile(r"""([\w.-]+).*\bextra == ['"]([\w.-]+)['"]""", re.ASCII)
RULES = Path(UDEV_FILE)
DEVICES = Path("/dev")


def _version(name: str) -> str | None:
    """Return the version of a distribution; None where it is not installed."""
    try:
        return distribution(name).version
    except PackageNotFoundError:
        return None


def _missing_files(name: str) -> int:
    """Return how many modules of a distribution are gone, as after another one was removed."""
    files = distribution(name).files or []
    return sum(
        not Path(str(file.locate())).exists() for file in files if file.suffix in (".py", ".so")
    )


def check_opencv() -> Check:
    """Return which cv2 is there, and whether several distributions share its folder."""
    installed = {name: version for name in OPENCV if (version := _version(name)) is not None}
    names = ", ".join(f"{name} {version}" for name, version in installed.items())
    if len(installed) > 1:
        # camctl works with any of them; windows are what other programs may need.
        keep = next((name for name in installed if "headless" not in name), next(iter(installed)))
        remove = " ".join(installed)
        return Check(
            name="OpenCV",
            state="problem",
            found=f"{names}: they overwrite each other's files in one folder cv2",
            to_do=f"keep one: pip uninstall -y {remove} && pip install --no-deps {keep}",
        )
    for name in installed:
        if gone := _missing_files(name):
            return Check(
                name="OpenCV",
                state="problem",
                found=f"{names}: {gone} of its files are gone, as after another OpenCV was removed",
                to_do=f"pip install --force-reinstall --no-deps {name}",
            )
    try:
        import cv2
    except ImportError as error:
        return Check(
            name="OpenCV",
            state="problem" if installed else "missing",
            found=f"{names or 'not installed'}: {error}",
            to_do=f"pip install {OPENCV[0]}; without it no JPEG and PNG files are read, and there "
            "are no MJPG streams and no camctl merge",
        )
    gui = next(
        (line.split()[-1] for line in cv2.getBuildInformation().splitlines() if "GUI:" in line), ""
    )
    windows = "no windows" if gui in ("", "NONE") else f"windows by {gui}"
    charts = "" if hasattr(cv2, "mcc") else "; no Macbeth charts, which need a contrib distribution"
    place = Path(cv2.__file__).parent if cv2.__file__ else "?"
    source = names or "of no distribution that pip knows"
    return Check(
        name="OpenCV",
        state="ok",
        found=f"cv2 {cv2.__version__} in {place}: {source}; {windows}{charts}",
    )


def check_libusb() -> Check:
    """Return whether pyusb finds libusb, which PTP cameras need."""
    import usb.backend.libusb1

    if usb.backend.libusb1.get_backend() is None:
        return Check(
            name="libusb",
            state="missing",
            found="not found: there are no PTP cameras on USB",
            to_do="install it: apt install libusb-1.0-0, dnf install libusb1, brew install libusb",
        )
    return Check(name="libusb", state="ok", found=f"found, with pyusb {_version('pyusb')}")


def check_video_devices() -> Check:
    """Return which /dev/video* may be opened."""
    nodes = sorted(DEVICES.glob("video*"))
    denied = [str(node) for node in nodes if not os.access(node, os.R_OK | os.W_OK)]
    if denied:
        return Check(
            name="video devices",
            state="problem",
            found=f"no permission to open {', '.join(denied)}",
            to_do="join the group of the device and log in again: sudo usermod -aG video $USER",
        )
    return Check(
        name="video devices",
        state="ok" if nodes else "missing",
        found=", ".join(map(str, nodes)) or f"no {DEVICES}/video*",
    )


def check_udev_rules() -> Check:
    """Return whether the rules that give access to USB cameras are there, as this version has."""
    from camctl.drivers.common.usb import UDEV_RULES

    if sys.platform != "linux":
        return Check(name="udev rules", state="ok", found="not needed on this system")
    try:
        text = RULES.read_text(encoding="utf-8")
    except OSError:
        found = f"no {RULES}: USB cameras may need root"
        return Check(name="udev rules", state="missing", found=found, to_do=COMMANDS["udev_rules"])
    if text.strip() != UDEV_RULES.strip():
        found = f"{RULES} has the rules of another version"
        return Check(name="udev rules", state="problem", found=found, to_do=COMMANDS["udev_rules"])
    return Check(name="udev rules", state="ok", found=str(RULES))


def check_profiles() -> Check:
    """Return how many cameras have a profile, and whether each can be read."""
    from camctl.profiles.folder import list_profiles
    from camctl.profiles.profile import profile_directory

    try:
        count = len(list_profiles())
    except CamctlError as error:
        return Check(
            name="profiles", state="problem", found=error.what, to_do=error_hint(error) or None
        )
    found = f"{count} in {profile_directory()}"
    if not count:
        to_do = "measure a camera: camctl calibrate all --camera ID"
        return Check(name="profiles", state="missing", found=found, to_do=to_do)
    return Check(name="profiles", state="ok", found=found)


def check_configuration() -> Check:
    """Return the configuration file, and whether it can be used."""
    path = configuration_file()
    try:
        settings = Configuration.load()
    except CamctlError as error:
        return Check(
            name="configuration", state="problem", found=error.what, to_do=error.hint or None
        )
    if not path.exists():
        return Check(name="configuration", state="ok", found=f"none: no {path}")
    names = ", ".join(settings.given) or "nothing"
    return Check(name="configuration", state="ok", found=f"{path} sets {names}")


def check_cameras() -> Iterator[Check]:
    """Yield what each backend finds."""
    from camctl.interface.backends import list_backends

    for backend in list_backends():
        name = f"cameras, {backend.name}"
        if backend.problem:
            yield Check(name=name, state="problem", found=backend.problem)
        else:
            ids = ", ".join(each.id for each in backend.cameras)
            yield Check(name=name, state="ok" if ids else "missing", found=ids or "none found")


def extra_distributions() -> dict[str, list[str]]:
    """Return the distributions of each extra, from the metadata of the installed camctl."""
    found: dict[str, list[str]] = {extra: [] for extra in EXTRAS}
    for each in requires("camctl") or ():
        match = _OF_EXTRA.match(each)
        if match is not None and match[2] in found:
            found[match[2]].append(match[1])
    return {extra: names for extra, names in found.items() if names}


def check_extras() -> Iterator[Check]:
    """Yield each optional part."""
    for extra, names in extra_distributions().items():
        versions = {name: _version(name) for name in names}
        there = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
        gone = [name for name, version in versions.items() if version is None]
        purpose = EXTRAS[extra].replace("`", "")
        if gone:
            are = "are" if len(gone) > 1 else "is"
            yield Check(
                name=f"extra {extra}",
                state="missing",
                found=f"{' and '.join(gone)} {are} not installed: {purpose}",
                to_do=f"pip install 'camctl[{extra}]'",
            )
        else:
            yield Check(name=f"extra {extra}", state="ok", found=f"{there}: {purpose}")


CHECKS: Final[tuple[Callable[[], Check], ...]] = (
    check_opencv,
    check_libusb,
    check_video_devices,
    check_udev_rules,
    check_configuration,
    check_profiles,
)


def diagnose() -> Diagnosis:
    """Look at everything."""
    return Diagnosis(
        camctl=camctl.__version__,
        python=f"{platform.python_version()} ({sys.executable})",
        platform=platform.platform(),
        checks=(*(check() for check in CHECKS), *check_cameras(), *check_extras()),
    )
