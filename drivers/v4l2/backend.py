"""The backend of V4L2 cameras, for the entry point `camctl.cameras`."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from camctl.drivers.v4l2.camera import V4l2Camera, V4l2Options
from camctl.drivers.v4l2.kernel import Kernel
from camctl.drivers.v4l2.node import Node
from camctl.drivers.v4l2.recording import record
from camctl.drivers.v4l2.system import DRIVER, camera_info, node_paths
from camctl.errors import CameraError, CameraNotFoundError
from camctl.interface.camera import CameraInfo


class V4l2Backend:
    """Opens ``v4l2:/dev/v4l/by-id/...`` and ``v4l2:/dev/videoN``; see `V4l2Options`."""

    about = "webcams and machine-vision cameras that Linux shows as /dev/video0 and so on"
    local_address = r"(/dev/(video\d+|v4l/by-(id|path)/[\w.:+-]+))?"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras whose nodes can be opened; no stream is started."""
        _check_system()
        return find_cameras()

    def record(self, address: str) -> dict[str, Any]:
        """Return what the camera says of itself; see `CameraBackend`."""
        return record(address)

    def open(self, address: str, options: Mapping[str, Any]) -> V4l2Camera:
        _check_system()
        chosen = V4l2Options.parse(options)
        return V4l2Camera(address or _only_node(), chosen).open()


def _check_system() -> None:
    """Raise `CameraError` on another system than Linux."""
    if sys.platform != "linux" or find_spec("fcntl") is None:
        raise CameraError("V4L2 cameras need Linux", hint="choose another camera")


def find_cameras(root: Path = Path("/"), kernel: Kernel | None = None) -> list[CameraInfo]:
    """Return the cameras whose nodes can be opened; no stream is started.

    A UVC camera has a node for metadata beside its node for video; only the latter counts.

    Raises:
        CameraError: there are nodes, and none can be opened
    """
    cameras: list[CameraInfo] = []
    failure: CameraError | None = None
    for path in node_paths(root):
        try:
            with Node(str(path), kernel) as node:
                found = node.capture_identity()
                cameras.append(camera_info(str(path), found.driver, found.card, root))
        except CameraNotFoundError:
            continue
        except CameraError as error:
            failure = error
    if failure is not None and not cameras:
        raise failure
    return cameras


def _only_node() -> str:
    found = [camera.id.partition(":")[2] for camera in find_cameras()]
    if len(found) == 1:
        return found[0]
    if not found:
        raise CameraNotFoundError("no V4L2 camera is connected", hint="plug one in")
    raise CameraNotFoundError(
        f"{len(found)} V4L2 cameras are connected",
        hint=f"name one of them: {', '.join(f'{DRIVER}:{path}' for path in found)}",
    )
