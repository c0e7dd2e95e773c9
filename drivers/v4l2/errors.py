"""What the operating system says of a camera, as errors of `camctl.errors`: all in one place."""

from __future__ import annotations

import errno
import os

from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from drivers.common import device_holders as holders

PLUG_IN = "plug it in and open it again"
_SEE_CAMERAS = "camctl cameras lists what is connected"
_MOST_HOLDERS = 3

_Words = tuple[type[CameraError], str, str]
#: errno: kind of error, what it means, what to do.
_MEANINGS: dict[int, _Words] = {
    errno.ENOENT: (CameraNotFoundError, "there is no such device", _SEE_CAMERAS),
    errno.ENOTDIR: (CameraNotFoundError, "there is no such device", _SEE_CAMERAS),
    errno.EISDIR: (CameraNotFoundError, "it is a folder, not a camera", _SEE_CAMERAS),
    errno.ENOTTY: (CameraNotFoundError, "it is not a video device", _SEE_CAMERAS),
    errno.ENODEV: (CameraDisconnectedError, "it went away", PLUG_IN),
    errno.ENXIO: (CameraDisconnectedError, "it went away", PLUG_IN),
    errno.ESHUTDOWN: (CameraDisconnectedError, "it went away", PLUG_IN),
    errno.EIO: (
        CameraProtocolError,
        "the USB transfer failed",
        "unplug it, plug it in again, and try another socket or cable",
    ),
    errno.EPIPE: (
        CameraProtocolError,
        "the camera rejected the request",
        "unplug it, plug it in again and try again",
    ),
    errno.ETIMEDOUT: (
        CameraTimeoutError,
        "the camera does not answer",
        "unplug it, plug it in again and try again",
    ),
}
_DENIED = (
    "you are not allowed to use it",
    "join its group (sudo usermod -aG video $USER, then log in again) or add a udev rule: "
    'SUBSYSTEM=="video4linux", TAG+="uaccess"',
)
_UNKNOWN = "try again; if it stays, unplug the camera and plug it in again"


def camera_error(error: OSError, path: str, doing: str) -> CameraError:
    """Return what to raise for `error`, which came while `doing` something with the node `path`."""
    number = error.errno or 0
    if number in (errno.EACCES, errno.EPERM):
        return CameraError(f"cannot {doing} {path}: {_DENIED[0]}", hint=_DENIED[1])
    if number == errno.EBUSY:
        return busy_error(path)
    kind, what, hint = _MEANINGS.get(
        number, (CameraProtocolError, os.strerror(number) if number else str(error), _UNKNOWN)
    )
    return kind(f"cannot {doing} {path}: {what}", hint=hint)


def busy_error(path: str, names: list[str] | None = None) -> CameraBusyError:
    """Return the error for a node that another process streams from, naming the process."""
    names = holding(path) if names is None else names
    who = ", ".join(names[:_MOST_HOLDERS]) or "another process"
    return CameraBusyError(f"{who} is using {path}", hint="close it there and try again")


def holding(path: str) -> list[str]:
    """Return "process 123 (name)" for each process that has the node `path` open."""
    found = holders.holding(os.path.realpath(path))
    return [f"process {each.process} ({each.program})" for each in found]
