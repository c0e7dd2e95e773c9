"""Webcams and machine-vision cameras through Video4Linux: the camera and the road to it.

Frames come through OpenCV (`drivers.v4l2.capture`); controls, formats and names through ioctls on
a descriptor of our own (`drivers.v4l2.node`); which frame had which exposure is told by
`drivers.v4l2.stream`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from camctl.camera import CameraInfo
from camctl.errors import (
    CameraNotFoundError,
    unknown_name,
)
from drivers.v4l2.camera import V4l2Camera
from drivers.v4l2.controls import parse_gain
from drivers.v4l2.discovery import DRIVER, find_cameras, node_paths
from drivers.v4l2.modes import parse_rate, parse_size, parse_whole

OPTIONS = ("bits", "black", "format", "fps", "gain", "range", "response", "size")


class V4l2Backend:
    """Opens ``v4l2:/dev/v4l/by-id/...`` and ``v4l2:/dev/videoN``.

    Options: format, size (WIDTHxHEIGHT), fps, bits, black, gain, range, response; see `V4l2Camera`.
    """

    about = "webcams and machine-vision cameras that Linux shows as /dev/video0 and so on"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras whose nodes can be opened; no stream is started."""
        return find_cameras()

    def open(self, address: str, options: Mapping[str, str]) -> V4l2Camera:
        """Return the camera at a node; without an address, the only one there is.

        Raises:
            UsageError: an unknown option, or a value that is none
            CameraError: see `V4l2Camera`

        """
        for option in options:
            if option not in OPTIONS:
                raise unknown_name("option of V4L2 cameras", option, OPTIONS)
        return V4l2Camera(
            address or _only_node(),
            format=options.get("format", "auto").lower(),
            size=parse_size(options["size"]) if "size" in options else None,
            fps=parse_rate(options["fps"]) if "fps" in options else None,
            bits=parse_whole("bits", options["bits"]) if "bits" in options else None,
            black=parse_whole("black", options["black"]) if "black" in options else None,
            gain=parse_gain(options["gain"]) if "gain" in options else None,
            range=options.get("range", "auto").lower(),
            response=options.get("response", "auto").lower(),
        )


def _only_node() -> str:
    found = [camera.id.partition(":")[2] for camera in find_cameras()] if node_paths() else []
    if len(found) == 1:
        return found[0]
    if not found:
        raise CameraNotFoundError("no V4L2 camera is connected", hint="plug one in")
    raise CameraNotFoundError(
        f"{len(found)} V4L2 cameras are connected",
        hint=f"name one of them: {', '.join(f'{DRIVER}:{path}' for path in found)}",
    )
