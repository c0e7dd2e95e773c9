"""Everything that camctl raises on purpose: one tree.

::

    CamctlError                     it could not be done                        exit status 1
    ├── UsageError                  the words of the request are off            exit status 2
    ├── DataError                   a file says something that cannot be used
    ├── StorageError                a result could not be written (disk full, no permission)
    ├── CaptureError                a capture could not be planned or completed
    │   └── InterruptedCaptureError somebody stopped it; what was shot is kept  exit status 130
    └── CameraError                 something between us and the camera
        ├── CameraNotFoundError     no such camera
        ├── CameraBusyError         another process holds it, or it is still working
        ├── CameraDisconnectedError it went away in the middle
        ├── CameraTimeoutError      it has been silent for too long
        ├── RefusedSettingError     it cannot do that setting; carries the nearest one it can
        └── CameraProtocolError     it answered nonsense

Every message is one line that says what went wrong and where, and ends with what to do next.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class CamctlError(Exception):
    """Base of the tree.  ``str(error)`` is one line: what, where, what to do."""

    exit_status = 1

    def __init__(self, what: str, *, hint: str = "") -> None:
        self.what = what
        self.hint = hint
        super().__init__(f"{what}; {hint}" if hint else what)


class UsageError(CamctlError):
    """The request itself makes no sense: an unknown name, a ratio of -1, a range below 1."""

    exit_status = 2


class DataError(CamctlError):
    """A file or table from outside holds something that cannot be used."""


class StorageError(CamctlError):
    """A result could not be written."""


class CaptureError(CamctlError):
    """A capture could not be planned or completed."""


class InterruptedCaptureError(CaptureError):
    """A person stopped the capture; what was shot is kept."""

    exit_status = 130


class CameraError(CamctlError):
    """Something between the controller and the camera."""


class CameraNotFoundError(CameraError):
    """No camera answers to that name."""


class CameraBusyError(CameraError):
    """The camera is held by another process or has not finished its last task."""


class CameraDisconnectedError(CameraError):
    """The camera went away while it was in use."""


class CameraTimeoutError(CameraError):
    """The camera has been silent for longer than its time-out."""


class RefusedSettingError(CameraError):
    """The camera cannot do a requested setting.

    Attributes:
        control: name of the control, a field of `camctl.controls.ExposureSetting`
        requested: the value asked for, in SI units
        nearest: the nearest value that the camera can do, in the same units
    """

    def __init__(self, control: str, requested: float, nearest: float) -> None:
        self.control = control
        self.requested = requested
        self.nearest = nearest
        super().__init__(
            f"the camera cannot set {control} to {requested:.9g}",
            hint=f"the nearest it can do is {nearest:.9g}",
        )


class CameraProtocolError(CameraError):
    """The camera answered something that its protocol does not allow."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """The error for an unknown `name`, with the near ones or, failing that, all of them."""
    choices = sorted(known)
    near = difflib.get_close_matches(name.lower(), choices, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known: {', '.join(choices)}"
    return UsageError(f"unknown {kind} '{name}'", hint=hint)
