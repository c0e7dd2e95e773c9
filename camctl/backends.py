"""Cameras and panels are found through entry points, the built-in ones like anybody else's.

A package adds a camera by naming a `CameraBackend` class in the entry-point group ``camctl.cameras``;
the entry point's name is what stands before the colon of a camera id (``v4l2:/dev/video0``).
Panels are callables in ``camctl.panels``.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Annotated, Any, Protocol, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, ValidationError

from camctl.camera import Camera, CameraInfo
from camctl.errors import CamctlError, UsageError, unknown_name

CAMERAS = "camctl.cameras"
PANELS = "camctl.panels"


def _parse_size(value: object) -> object:
    if not isinstance(value, str):
        return value
    match = re.fullmatch(r"\s*([1-9]\d{0,8})\s*[xX×]\s*([1-9]\d{0,8})\s*", value, re.ASCII)
    if match is None:
        raise ValueError("write WIDTHxHEIGHT, such as 640x480")
    return int(match[2]), int(match[1])


FrameShape = Annotated[tuple[int, int], BeforeValidator(_parse_size)]
"""(rows, columns) of a frame; a person writes WIDTHxHEIGHT."""


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

    A road may have an attribute `about`, one line that says which cameras it leads to.
    """

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the cameras that can be opened now, within a second.

        `probe` allows speaking to devices that may be no cameras, such as whatever hangs on a
        serial port; without it they are left alone.
        """
        ...

    def open(self, address: str, options: Mapping[str, str]) -> Camera:
        """Open the camera at `address`, what follows the colon of its id ("" if nothing does).

        `options` holds what the user said beside the id, by option name; a road raises `UsageError`
        for one that it cannot use, so that nothing is ignored silently.
        """
        ...


def _found(group: str) -> dict[str, EntryPoint]:
    return {point.name: point for point in entry_points(group=group)}


def load(group: str, kind: str, name: str) -> Any:
    """Return what the entry point `name` of `group` names; `kind` is the word for it in errors."""
    found = _found(group)
    if name not in found:
        raise unknown_name(kind, name, found)
    try:
        return found[name].load()
    except (ImportError, AttributeError) as error:
        raise UsageError(
            f"{kind} '{name}' cannot be loaded: {error}", hint="install what it needs"
        ) from error


def open_camera(camera_id: str, options: Mapping[str, str] | None = None) -> Camera:
    """Open a camera by its id: the name of its road, and an address after a colon."""
    road_name, _, address = camera_id.partition(":")
    road: CameraBackend = load(CAMERAS, "camera", road_name)()
    return road.open(address, options or {})


@dataclass(frozen=True)
class Look:
    """What one road found: `problem` is one line where it could not look, else empty."""

    road: str
    about: str
    cameras: tuple[CameraInfo, ...] = ()
    problem: str = ""


def look_for_cameras(*, probe: bool = False) -> list[Look]:
    """Return what each road finds; `probe`: see `CameraBackend.discover`."""
    looks = []
    for name in sorted(_found(CAMERAS)):
        about = ""
        try:
            kind = load(CAMERAS, "camera", name)
            about = getattr(kind, "about", "")
            looks.append(Look(name, about, tuple(kind().discover(probe=probe))))
        except CamctlError as error:
            looks.append(Look(name, about, problem=str(error)))
    return looks
