"""A video node in the operating system: its names, its USB device, its users, and its errors."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from camctl.drivers.common import device_holders
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.camera import CameraInfo

DRIVER = "v4l2"
PLUG_IN = "plug it in and open it again"

_LIST_CAMERAS = "list the cameras that are connected"
_SMALLER = "give the camera a USB port of its own, or choose a smaller size"
_REPLUG = "unplug it, plug it in again and try again"
#: Processes that are named at most in an error message of one line.
_MOST_PROCESSES = 3
#: Folders from the USB interface of a node up to its USB device: interface, device, and one spare.
_USB_LEVELS = 3
#: Bytes of a USB attribute that are read at most; USB strings have up to 126 characters.
_LONGEST_ATTRIBUTE = 200
#: The length of all descriptors of a configuration is a number of 16 bits.
_MOST_DESCRIPTORS = 1 << 16
_ATTRIBUTES = ("manufacturer", "product", "serial")

_GONE = (CameraDisconnectedError, "it was unplugged", PLUG_IN)
_MISSING = (CameraNotFoundError, "there is no such device", _LIST_CAMERAS)
#: errno: error class, meaning, what to do.
_MEANINGS: dict[int, tuple[type[CameraError], str, str]] = {
    errno.ENOENT: _MISSING,
    errno.ENOTDIR: _MISSING,
    errno.EISDIR: (CameraNotFoundError, "it is a folder, not a camera", _LIST_CAMERAS),
    errno.ENOTTY: (CameraNotFoundError, "it is not a video device", _LIST_CAMERAS),
    errno.ENODEV: _GONE,
    errno.ENXIO: _GONE,
    errno.ESHUTDOWN: _GONE,
    errno.EIO: (
        CameraProtocolError,
        "the USB transfer failed",
        "unplug it, plug it in again, and try another socket or cable",
    ),
    errno.EPIPE: (CameraProtocolError, "the camera rejected the request", _REPLUG),
    errno.ENOSPC: (
        CameraProtocolError,
        "the USB bus has no bandwidth left",
        _SMALLER,
    ),
    errno.ETIMEDOUT: (CameraTimeoutError, "the camera does not respond", _REPLUG),
}

#: Remedies of the hints that have some.
_REMEDIES = {_LIST_CAMERAS: {"cameras": None}, _SMALLER: {"option:size": None}}


def camera_error(error: OSError, path: str, action: str) -> CameraError:
    """Return the error for `error`, raised by an `action` ("open") on the node `path`."""
    number = error.errno or 0
    if number in (errno.EACCES, errno.EPERM):
        return CameraError(
            f"cannot {action} {path}: you are not allowed to use it",
            hint="join its group (sudo usermod -aG video $USER, then log in again) or add a udev "
            'rule: SUBSYSTEM=="video4linux", TAG+="uaccess"',
        )
    if number == errno.EBUSY:
        return busy_error(path, processes_using(path))
    kind, meaning, hint = _MEANINGS.get(
        number,
        (
            CameraProtocolError,
            os.strerror(number) if number else str(error),
            "try again; if that does not help, unplug the camera and plug it in again",
        ),
    )
    return kind(f"cannot {action} {path}: {meaning}", hint=hint, remedies=_REMEDIES.get(hint))


def busy_error(path: str, processes: list[str]) -> CameraBusyError:
    """Return the error for a node that other processes stream from."""
    names = ", ".join(processes[:_MOST_PROCESSES]) or "another process"
    return CameraBusyError(f"{names} is using {path}", hint="close it there and try again")


def processes_using(path: str) -> list[str]:
    """Return "process 123 (name)" for each process that has the node `path` open."""
    found = device_holders.holding(os.path.realpath(path))
    return [f"process {each.process} ({each.program})" for each in found]


def node_paths(root: Path = Path("/")) -> list[Path]:
    """Return one path for each video node: its link in /dev/v4l/by-id, or else /dev/videoN."""
    links = _links(root)
    numbered = sorted(
        (path for path in (root / "dev").glob("video*") if re.fullmatch(r"video\d+", path.name)),
        key=lambda path: int(path.name[5:]),
    )
    paths = [links.get(os.path.realpath(path), path) for path in numbered]
    return list(dict.fromkeys(paths))


def stable_path(path: str, root: Path = Path("/")) -> str:
    """Return the path of a node that stays the same after replugging; `path` if there is none."""
    return str(_links(root).get(os.path.realpath(path), path))


def camera_info(path: str, driver: str, card: str, root: Path = Path("/")) -> CameraInfo:
    """Return the identity of the camera at a node, from sysfs or else from the node itself.

    `driver` and `card` are what the node reports, see `camctl.drivers.v4l2.node.Identity`.
    """
    usb = {name: _usb_attribute(path, name, root) for name in _ATTRIBUTES}
    # uvcvideo reports "product: product" for a camera without a shorter name.
    name = card.partition(":")[0].strip()
    return CameraInfo(
        id=f"{DRIVER}:{stable_path(path, root)}",
        make=usb["manufacturer"] or driver,
        model=usb["product"] or name or driver or "camera",
        serial=usb["serial"],
        driver=DRIVER,
    )


def _links(root: Path) -> dict[str, Path]:
    """Return the first link in /dev/v4l/by-id to each node."""
    found: dict[str, Path] = {}
    for link in sorted((root / "dev/v4l/by-id").glob("*"), reverse=True):
        found[os.path.realpath(link)] = link
    return found


def _usb_attribute(path: str, name: str, root: Path) -> str:
    """Return an attribute of the USB device that a node belongs to; "" where there is none."""
    for folder in _device_folders(path, root):
        try:
            raw = (folder / name).read_bytes()[:_LONGEST_ATTRIBUTE]
        except OSError:
            continue
        decoded = raw.decode("utf-8", "replace")
        return "".join(letter if letter.isprintable() else " " for letter in decoded).strip()
    return ""


def usb_descriptors(path: str, root: Path = Path("/")) -> str:
    """Return the descriptors of the USB device that a node belongs to, hexadecimal; "" without.

    They state the numbers of its texts, and not the texts.
    """
    for folder in _device_folders(path, root):
        with suppress(OSError):
            return (folder / "descriptors").read_bytes()[:_MOST_DESCRIPTORS].hex()
    return ""


def _device_folders(path: str, root: Path) -> Iterator[Path]:
    """Yield the sysfs folder of a node's device, a USB interface, and its parents."""
    device = root / "sys/class/video4linux" / Path(os.path.realpath(path)).name / "device"
    folder = Path(os.path.realpath(device))
    for _ in range(_USB_LEVELS):
        yield folder
        folder = folder.parent
