"""What a node says of its formats and controls, call by call, to be sent and replayed."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import Any

from camctl.drivers.v4l2.abi import ControlId, Request
from camctl.drivers.v4l2.kernel import Kernel, Linux
from camctl.drivers.v4l2.node import Node
from camctl.drivers.v4l2.system import usb_descriptors
from camctl.errors import CameraError

#: More sizes or intervals say nothing new.
_MOST_SIZES = 40
#: Entries of a menu; a number of a control of another kind is refused by the kernel.
_MOST_ENTRIES = 8


class RecordingKernel(Linux):
    """The running kernel, or another one, whose answers are kept.

    Args:
        kernel: the other one

    Attributes:
        calls: request, bytes before and after the call, and the number of its error or 0
    """

    def __init__(self, kernel: Kernel | None = None) -> None:
        super().__init__()
        self._kernel = kernel or Linux()
        self.calls: list[tuple[int, str, str, int]] = []

    def open(self, path: str) -> int:
        """Open the node."""
        return self._kernel.open(path)

    def close(self, descriptor: int) -> None:
        self._kernel.close(descriptor)

    def ioctl(self, descriptor: int, request: Request, argument: ctypes.Structure) -> None:
        """Ask the kernel, and keep what it answers."""
        before, failure = bytes(argument).hex(), 0
        try:
            self._kernel.ioctl(descriptor, request, argument)
        except OSError as error:
            failure = error.errno or -1
            raise
        finally:
            self.calls.append((int(request), before, bytes(argument).hex(), failure))


def record(path: str, kernel: Kernel | None = None, root: Path = Path("/")) -> dict[str, Any]:
    """Return the answers of a node about all its formats, sizes, rates and controls.

    No stream is started and nothing is set.  The descriptors of a USB camera hold no serial number.
    """
    recording = RecordingKernel(kernel)
    found: dict[str, Any] = {}
    try:
        with Node(path, recording) as node:
            found = described(node)
    except CameraError as error:
        found = {"error": str(error)}
    return {"descriptors": usb_descriptors(path, root), "calls": recording.calls, "found": found}


def described(node: Node) -> dict[str, Any]:
    """Return what an open node offers: formats with sizes and intervals, and its controls."""
    identity = node.capture_identity()
    formats = {}
    for each in node.formats():
        grid = node.sizes(each)
        shapes = grid.listed[:_MOST_SIZES]
        formats[str(each)] = [
            [list(shape), list(node.intervals(each, shape)[:_MOST_SIZES])] for shape in shapes
        ]
    controls = {}
    for control in ControlId:
        found = node.control(control)
        if found is None:
            continue
        controls[control.name] = [found.minimum, found.maximum, found.step, found.default]
        for entry in range(max(found.minimum, 0), min(found.maximum, _MOST_ENTRIES) + 1):
            node.menu_has(control, entry)
    return {"driver": identity.driver, "formats": formats, "controls": controls}
