"""`camctl resume`: complete a capture or a series that was interrupted."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.capture_output import Complete, capture_progress, show_capture
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions
from camctl.cli.output import print_warning
from camctl.cli.parameter_types import CAMERA, PATH
from camctl.cli.series.run import HookOptions, check_keys, hook_options, run_series
from camctl.errors import DataError, UsageError
from camctl.messages.command_line import word
from camctl.records import REPORT, SERIES

if TYPE_CHECKING:
    from camctl.interface.camera import Camera
    from camctl.records.report import CaptureReport

_AS_BEGUN = "the capture goes on with the options that it was begun with"


_camera_options = options.option_group(
    CameraOptions,
    "camera",
    camera_id=options.declare(
        "--camera ID",
        "Camera; `camctl cameras` lists the ids.  [default: the camera of the capture]",
        CAMERA,
        default="sim",
        show_default=False,
    ),
)


@command(
    examples=(
        ("camctl resume hall", "shoot the missing frames, with the camera of the capture"),
        ("camctl resume day --hook './upload'", "continue a series"),
        ("camctl resume hall --camera v4l2:/dev/video2", "the camera has another name now"),
    ),
    others_refused=_AS_BEGUN,
)
@click.argument("directory", type=PATH, metavar="DIR")
@_camera_options
@hook_options
@options.as_json
def resume(directory: Path, camera: CameraOptions, hook: HookOptions, as_json: bool) -> None:
    """Complete a capture or a series that was interrupted.

    Shoots what is missing in DIR, with the options that it was begun with. It opens the camera of
    the capture, unless --camera and its options name it again. The command of --hook is not kept
    and must be given again.
    """
    given = options.given(click.get_current_context())
    if "camera_id" not in given and (others := sorted(options.CAMERA_PARAMETERS & given)):
        name = options.option_name(click.get_current_context(), others[0])
        raise UsageError(
            f"{name} needs --camera here",
            hint=_AS_BEGUN,
        )
    hook.check()
    if (directory / SERIES).exists():
        _go_on(directory, camera, hook, as_json=as_json)
        return
    if given & {"hook", "hook_limit_s"}:
        raise UsageError("--hook belongs to a series", hint="leave it out")
    show_capture(
        lambda complete: _completed(directory, camera, complete), directory, as_json=as_json
    )


def _completed(directory: Path, camera_options: CameraOptions, complete: Complete) -> CaptureReport:
    from camctl.captures.sequencer import already_complete, resume
    from camctl.records.folder_store import read_capture

    report = read_capture(directory)
    if report.status == "complete":
        raise already_complete(directory, report)
    if not report.repeatable:
        raise DataError(
            f"{directory} is no capture of a camera, but was begun by camctl merge",
            hint="merge the photographs again, with --force",
        )
    opened = _camera(camera_options, report.source, directory, REPORT)
    with opened as camera, capture_progress() as progress:
        return complete(resume(camera, directory, progress=progress))


def _go_on(
    directory: Path, camera_options: CameraOptions, hook: HookOptions, *, as_json: bool
) -> None:
    """Continue the series in a folder, and print how it ended."""
    from camctl.records.journal import read_series
    from camctl.records.report_file import check_same_camera

    journal = read_series(directory)
    if journal.is_done():
        raise DataError(
            f"the series in {directory} is complete: {journal.completed} of "
            f"{len(journal.sets)} sets were taken",
            hint="take another one with camctl series --repeat N",
        )
    if journal.has_hook and hook.hook is None:
        print_warning("the series was begun with --hook, which is not kept: give it again")
    check_keys(needed=journal.options.on_key)
    with _camera(camera_options, journal.source, directory, SERIES) as camera:
        check_same_camera(journal.camera, camera.info, directory)
        run_series(camera, journal, hook, directory, as_json=as_json)


def _camera(
    camera_options: CameraOptions, source: Mapping[str, Any], directory: Path, file: str
) -> Camera:
    """Open the camera that the command line names, else the one in `source`.

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
    again = f"camctl resume {word(str(directory))} --camera ID"
    if not isinstance(camera_id, str) or not isinstance(values, dict):
        raise DataError(
            f"{directory}/{file} does not name the camera to open", hint=f"name it: {again}"
        )
    if not is_local(camera_id, values):
        raise DataError(
            f"{directory}/{file} names the camera {camera_id[:80]!r}, which is not opened "
            "unless you name it: it may lead to another machine",
            hint=f"if you trust it: {again}",
        )
    return open_camera(camera_id, values)
