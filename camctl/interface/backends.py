"""Camera backends and panels, found through entry points; the built-in ones are found like others.

A package adds a camera by naming a `CameraBackend` class in the entry-point group
``camctl.cameras``.  The name of the entry point is the part of a camera id before the colon
(``v4l2:/dev/video0``).  Panels are callables in the group ``camctl.panels``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any, Protocol, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from camctl.errors import CamctlError, UsageError, unknown_name
from camctl.interface.camera import Camera, CameraInfo

CAMERAS = "camctl.cameras"
PANELS = "camctl.panels"

#: Modules of the standard library that exist on Linux (and other POSIX systems) only.
_POSIX_MODULES = frozenset({"curses", "fcntl", "grp", "pwd", "resource", "termios", "tty"})


def _parse_size(value: object) -> object:
    if not isinstance(value, str):
        return value
    match = re.fullmatch(r"\s*([1-9]\d{0,8})\s*[xX×]\s*([1-9]\d{0,8})\s*", value, re.ASCII)
    if match is None:
        raise ValueError("write WIDTHxHEIGHT, such as 640x480")
    return int(match[2]), int(match[1])


FrameShape = Annotated[tuple[int, int], BeforeValidator(_parse_size)]
"""(rows, columns) of a frame; as a string, WIDTHxHEIGHT."""


def _lower_case(value: object) -> object:
    return value.strip().lower() if isinstance(value, str) else value


LowerCase = BeforeValidator(_lower_case)
"""Converts the value of an option to lower case before it is checked."""


class BackendOptions(BaseModel):
    """Base of the options of one backend: a field for each name after ``-O``.

    Values come as strings from the command line and as Python values from programs.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def parse(cls, options: Mapping[str, Any]) -> Self:
        """Return the validated options.

        Raises:
            UsageError: an unknown name, or a value that its field does not accept
        """
        for name in options:
            if name not in cls.model_fields:
                raise unknown_name("camera option", name, cls.model_fields)
        try:
            return cls.model_validate(dict(options))
        except ValidationError as error:
            first = error.errors()[0]
            name = str(first["loc"][0]) if first["loc"] else ""
            reason = first["msg"].removeprefix("Value error, ")
            raise UsageError(
                f"invalid camera option {name}={options.get(name)}",
                hint=reason[:1].lower() + reason[1:],
            ) from None


class CameraBackend(Protocol):
    """One way to reach cameras: a bus, a protocol, or a simulation.

    A backend may have two attributes: `about`, one line about the cameras it reaches, and
    `local_address`, a regular expression for addresses of devices of this machine; see `is_local`.
    It may have a method `record(address)`, which returns what the camera at an address says of
    itself, as an object for JSON without serial numbers and pictures, for `record_cameras`.
    """

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras that can be opened now, within a second.

        `probe` allows sending data to devices that may be no cameras, such as whatever is connected
        to a serial port; without it nothing is sent to them.
        """

    def open(self, address: str, options: Mapping[str, Any]) -> Camera:
        """Return the camera at `address`, opened.

        `address` is the part of the camera id after the colon, "" without a colon.  `options` are
        what the user gave beside the id, by name; `BackendOptions.parse` validates them.

        Raises:
            UsageError: an option that the backend does not have, or an invalid value
            CameraNotFoundError, CameraBusyError: the camera cannot be opened
        """


@cache
def _entry_points(group: str) -> dict[str, EntryPoint]:
    """Return what installed packages have in a group; what is installed later is not seen."""
    return {point.name: point for point in entry_points(group=group)}


def load(group: str, kind: str, name: str) -> Any:
    """Return the object that the entry point `name` of `group` names.

    `kind` is what error messages call it, such as "camera".

    Raises:
        UsageError: no such entry point, or it cannot be imported
    """
    found = _entry_points(group)
    if name not in found:
        raise unknown_name(kind, name, found)
    try:
        return found[name].load()
    except (ImportError, AttributeError) as error:
        raise _load_error(kind, found[name], error) from error


def _load_error(kind: str, point: EntryPoint, error: Exception) -> UsageError:
    """Return the error for an entry point that cannot be loaded, with the probable reason."""
    missing = error.name if isinstance(error, ImportError) else None
    if missing in _POSIX_MODULES:
        return UsageError(
            f"{kind} '{point.name}' needs Linux: this Python has no module {missing}",
            hint=f"choose another {kind}",
        )
    return UsageError(
        f"{kind} '{point.name}' cannot be loaded: {error}",
        hint="install the packages that it needs",
    )


def is_local(camera_id: str, options: Mapping[str, Any]) -> bool:
    """Return whether a camera may be opened because a file names it, and not the user.

    That holds for devices of this machine by the names that the system gives them, and for options
    as they come from a command line; never for a URL, which may connect to another machine or
    write a file.  A backend without `local_address` has no such cameras.
    """
    name, _, address = camera_id.partition(":")
    if name not in _entry_points(CAMERAS):
        return False
    pattern = getattr(load(CAMERAS, "camera", name), "local_address", None)
    is_device = pattern is not None and re.fullmatch(pattern, address, re.ASCII) is not None
    return is_device and all(isinstance(value, str) for value in options.values())


@dataclass(frozen=True)
class BackendListing:
    """One backend and the cameras it has found.

    Attributes:
        name: the part of a camera id before the colon
        about: one line about the cameras it reaches
        cameras: the cameras that can be opened now
        problem: the reason, in one line, if it could not search for cameras, else empty
    """

    name: str
    about: str
    cameras: tuple[CameraInfo, ...] = ()
    problem: str = ""


def list_backends(*, probe: bool = False) -> list[BackendListing]:
    """Return all backends with the cameras they find; `probe`: see `CameraBackend.discover`."""
    listings = []
    for name in sorted(_entry_points(CAMERAS)):
        about = ""
        try:
            backend = load(CAMERAS, "camera", name)
            about = getattr(backend, "about", "")
            cameras = tuple(backend().discover(probe=probe))
            listings.append(BackendListing(name, about, cameras))
        except CamctlError as error:
            listings.append(BackendListing(name, about, problem=str(error)))
    return listings


def record_cameras(*, probe: bool = False) -> list[dict[str, Any]]:
    """Return what the cameras say that can be found now, for those who write the drivers.

    Cameras of backends that cannot record are left out.  Each is opened, and no picture is taken.
    """
    found = []
    for listing in list_backends(probe=probe):
        backend = load(CAMERAS, "camera", listing.name)()
        if hasattr(backend, "record"):
            found += [
                {"backend": listing.name, **backend.record(camera.id.partition(":")[2])}
                for camera in listing.cameras
            ]
    return found


def list_cameras(*, probe: bool = False) -> list[CameraInfo]:
    """Return the cameras that can be opened now; `probe`: see `CameraBackend.discover`.

    Backends that cannot search for cameras are left out; `list_backends` gives the reasons.
    """
    return [camera for listing in list_backends(probe=probe) for camera in listing.cameras]
