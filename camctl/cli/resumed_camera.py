"""The camera with which `--resume` goes on: the one that the folder names, or one that is named."""

from __future__ import annotations

from collections.abc import Mapping, Set
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.options import CameraOptions
from camctl.errors import DataError
from camctl.records.file_names import resume_command

if TYPE_CHECKING:
    from camctl.interface.camera import Camera


def refuse_other_options(allowed: Set[str] = frozenset()) -> None:
    """Raise `UsageError` where options are given beside --resume that a capture already has.

    Args:
        allowed: parameters that may be given, beside the camera's
    """
    context = click.get_current_context()
    others = options.given(context) - {"resume_directory", "as_json"} - allowed
    others -= options.CAMERA_PARAMETERS if "camera_id" in options.given(context) else set()
    options.refuse_together(
        context, "--resume", others, "the capture continues with the options it was started with"
    )


def resumed_camera(
    camera_options: CameraOptions, source: Mapping[str, Any], directory: Path, file: str
) -> Camera:
    """Open the camera that the command line names, else that of `source`.

    The latter is opened if it is a device of this machine, since anybody may have written `source`.

    Args:
        camera_options: of the command line
        source: what `file` in `directory` says of the camera
        directory: what is resumed
        file: name of the file with `source`

    Raises:
        DataError: the file does not name a camera, or one that must be named by the user
    """
    from camctl.interface.backends import is_local
    from camctl.profiles.calibrated import open_camera

    if "camera_id" in options.given(click.get_current_context()):
        return camera_options.open()
    camera_id, values = source.get("camera"), source.get("options")
    if not isinstance(camera_id, str) or not isinstance(values, dict):
        raise DataError(
            f"{directory}/{file} does not name the camera to open",
            hint=f"name it: {resume_command(directory)} --camera ID",
        )
    if not is_local(camera_id, values):
        raise DataError(
            f"{directory}/{file} names the camera {camera_id[:80]!r}, which is not opened "
            "unless you name it: it may lead to another machine",
            hint=f"if you trust it: {resume_command(directory)} --camera ID",
        )
    return open_camera(camera_id, values)
