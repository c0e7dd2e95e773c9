"""The errors of camctl: one tree, and each message is one line.

::

    CamctlError                     the task could not be done                    exit status 1
    ├── UsageError                  the request is invalid                        exit status 2
    ├── DataError                   a file or table has invalid content
    ├── StorageError                a result could not be written (disk full, no permission)
    ├── ResourceError               the system refuses a file, a thread or memory
    │   └── OutOfMemoryError        the memory does not suffice; also a MemoryError
    ├── CaptureError                a capture could not be planned or completed
    │   ├── UnreachableExposureError the camera cannot make what is requested     exit status 2
    │   └── InterruptedCaptureError the user stopped it; its frames are kept      exit status 130,
    │                               after SIGTERM and SIGHUP 143 and 129
    └── CameraError                 the camera, or the connection to it, failed
        ├── CameraNotFoundError     no such camera
        ├── CameraBusyError         another process uses it, or it is still working
        ├── CameraDisconnectedError it was disconnected while in use, or is closed
        │   └── CameraClosedError   it was not opened, or its owner closed it
        ├── CameraTimeoutError      it sent nothing for too long
        ├── RefusedSettingError     it cannot do a setting; has the nearest one that it can do
        └── CameraProtocolError     it sent an invalid response

A message says what went wrong and where, and then what to do: ``error.what`` and ``error.hint``.
Neither names an option: ``error.remedies`` has what helps as data, and a front end names it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

#: Bytes of a file name that are not UTF-8 are lone surrogates in Python: 0xff is U+DCFF.
_FIRST_BYTE, _LAST_BYTE = 0xDC80, 0xDCFF


def visible(text: object) -> str:
    r"""Return `text` on one line; characters without a shape are written as in Python.

    >>> print(visible("red \x1b[31m, two\nlines, \u202edlo, a byte \udcff"))
    red \x1b[31m, two\nlines, \u202edlo, a byte \xff
    """
    line = str(text)
    return line if line.isprintable() else "".join(map(_visible_character, line))


def _visible_character(character: str) -> str:
    if character.isprintable():
        return character
    if _FIRST_BYTE <= ord(character) <= _LAST_BYTE:
        return f"\\x{ord(character) - 0xDC00:02x}"
    return repr(character)[1:-1]


class CamctlError(Exception):
    """Base of all errors of camctl; ``str(error)`` is one visible line, whatever names are in it.

    Attributes:
        what: what went wrong, and where
        hint: what to do; may be empty
        remedies: what `hint` asks for, as in `camctl.findings.Finding.remedies`
        exit_status: exit status of a command that ends with the error
    """

    exit_status = 1

    def __init__(
        self, what: str, *, hint: str = "", remedies: Mapping[str, Any] | None = None
    ) -> None:
        self.what, self.hint = visible(what), visible(hint)
        self.remedies = dict(remedies or {})
        super().__init__(f"{self.what}; {self.hint}" if hint else self.what)


class UsageError(CamctlError):
    """The request is invalid: an unknown name, a ratio of -1, a dynamic range below 1."""

    exit_status = 2


class DataError(CamctlError):
    """A file or table has invalid content."""


class StorageError(CamctlError):
    """A result could not be written."""


class ResourceError(CamctlError):
    """The system refuses a resource: a file that cannot be opened, a thread, memory."""


class OutOfMemoryError(ResourceError, MemoryError):
    """The memory does not suffice."""


class CaptureError(CamctlError):
    """A capture could not be planned or completed."""


class UnreachableExposureError(CaptureError):
    """The request asks for exposures that the camera cannot make, or not in so short a time."""

    exit_status = 2


class InterruptedCaptureError(CaptureError):
    """The user stopped the capture; frames that were shot into a folder are kept."""

    exit_status = 130


class CameraError(CamctlError):
    """The camera, or the connection to it, failed."""


class CameraNotFoundError(CameraError):
    """No camera has that id."""


class CameraBusyError(CameraError):
    """Another process uses the camera, or it has not finished its last task."""


class CameraDisconnectedError(CameraError):
    """The camera was disconnected while in use, or it is closed."""


class CameraClosedError(CameraDisconnectedError):
    """The camera is not open: it was not opened, or its owner closed it."""


class CameraTimeoutError(CameraError):
    """The camera sent nothing for longer than its time-out."""


class RefusedSettingError(CameraError):
    """The camera cannot do a requested setting.

    Attributes:
        control: name of the control, a field of `camctl.ExposureSetting`
        requested: the value asked for, in SI units
        nearest: the nearest value that the camera can do, in the same units

    Args:
        remedy: what to do where the camera keeps its setting, `nearest`, whatever is set
    """

    def __init__(self, control: str, requested: float, nearest: float, remedy: str = "") -> None:
        self.control = control
        self.requested = requested
        self.nearest = nearest
        super().__init__(
            f"the camera cannot set {control} to {requested:.9g}",
            hint=f"it keeps {nearest:.9g}; {remedy}"
            if remedy
            else f"the nearest it can do is {nearest:.9g}",
        )


class CameraProtocolError(CameraError):
    """The camera sent a response that its protocol does not allow."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> UsageError:
    """Return the error for an unknown `name`; its hint has similar names, else all known ones."""
    import difflib  # takes memory that only an error needs

    choices = sorted(known)
    by_word = {choice.lstrip("-."): choice for choice in choices}  # all have these in common
    words = difflib.get_close_matches(name.lower().lstrip("-."), by_word, n=3, cutoff=0.5)
    similar = [by_word[word] for word in words]
    hint = f"known: {', '.join(choices)}" if choices else "there are none"
    if similar:
        hint = f"did you mean {' or '.join(similar)}?"
    return UsageError(f"unknown {kind} '{name}'", hint=hint)
