"""Which video nodes there are, by names that survive replugging, and whose they are."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from camctl.camera import CameraInfo
from camctl.errors import CameraError, CameraNotFoundError
from drivers.v4l2.modes import Identity
from drivers.v4l2.node import Kernel, Node

DRIVER = "v4l2"
_USB_LEVELS = 3
_LONGEST = 200


def find_cameras(root: Path = Path("/"), kernel: Kernel | None = None) -> list[CameraInfo]:
    """Return the cameras whose nodes can be opened; no stream is started.

    A UVC camera has a node for metadata beside the one for video: only the latter counts.

    Raises:
        CameraError: there are nodes, and none may be opened

    """
    cameras: list[CameraInfo] = []
    refusal: CameraError | None = None
    for path in node_paths(root):
        try:
            with Node(str(path), kernel) as node:
                cameras.append(describe(str(path), node.check_capture(), root))
        except CameraNotFoundError:
            continue
        except CameraError as error:
            refusal = error
    if refusal is not None and not cameras:
        raise refusal
    return cameras


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
    """Return the name of a node that survives replugging, or `path` where there is none."""
    return str(_links(root).get(os.path.realpath(path), path))


def describe(path: str, identity: Identity, root: Path = Path("/")) -> CameraInfo:
    """Return who the camera at the node `path` is, by sysfs and by what it says itself."""
    known = {name: _usb_attribute(path, name, root) for name in _ATTRIBUTES}
    # uvcvideo makes the card's name "product: product" where there is no shorter one.
    card = identity.card.partition(":")[0].strip()
    return CameraInfo(
        id=f"{DRIVER}:{stable_path(path, root)}",
        make=known["manufacturer"] or identity.driver,
        model=known["product"] or card or identity.driver or "camera",
        serial=known["serial"],
        driver=DRIVER,
    )


_ATTRIBUTES = ("manufacturer", "product", "serial")


def _links(root: Path) -> dict[str, Path]:
    """Return links by the node that they lead to; the first in order where there are several."""
    found: dict[str, Path] = {}
    for link in sorted((root / "dev/v4l/by-id").glob("*"), reverse=True):
        found[os.path.realpath(link)] = link
    return found


def _usb_attribute(path: str, name: str, root: Path) -> str:
    """Return an attribute of the USB device that a node belongs to, "" where there is none."""
    for folder in _devices(path, root):
        try:
            raw = (folder / name).read_bytes()[:_LONGEST]
        except OSError:
            continue
        spelt = raw.decode("utf-8", "replace")
        return "".join(letter if letter.isprintable() else " " for letter in spelt).strip()
    return ""


def _devices(path: str, root: Path) -> Iterator[Path]:
    """Yield the device of a node, which is a USB interface, and those it is part of."""
    device = root / "sys/class/video4linux" / Path(os.path.realpath(path)).name / "device"
    folder = Path(os.path.realpath(device))
    for _ in range(_USB_LEVELS):
        yield folder
        folder = folder.parent
