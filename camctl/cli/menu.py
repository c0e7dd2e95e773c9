"""`camctl menu`: the camera menu on a panel."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, all_of, option
from camctl.cli.output import print_text, print_warning
from camctl.cli.parameter_types import PANEL, PATH
from camctl.cli.request_options import RequestOptions, request_options
from camctl.errors import UsageError, unknown_name, visible

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from camctl.interface.camera import Camera
    from camctl.menu.live_view import Sight
    from camctl.menu.ports import Job, Panel

# As in `camctl.interface.backends`, which imports numpy.
CAMERAS, PANELS = "camctl.cameras", "camctl.panels"


menu_options = all_of(
    request_options("mains_hz", "use_aperture", "spend_shutter", "estimate_ratios"),
    option(
        "-o --output PATH",
        "Folder in which each capture gets a folder of its own.",
        PATH,
        field="parent",
        default=".",
    ),
    option(
        "--menu-settings FILE",
        "File in which the menu keeps what was selected; else in the user's state folder.",
        PATH,
        field="settings",
    ),
)
"""The options of all that shows the menu."""


@command(
    examples=(
        ("camctl menu", "on this terminal, with the simulated camera"),
        ("camctl menu --camera v4l2:/dev/video0 -o pictures", "a real camera; results in pictures"),
        ("camctl menu --panel web:8080", "in the browser, on http://127.0.0.1:8080"),
    )
)
@options.camera_options
@option(
    "--panel NAME[:ADDRESS]",
    "Panel that shows the menu: terminal (this one, with the arrow keys), "
    "cfa635:/dev/ttyUSB0, hd44780:/dev/i2c-1, luma:ssd1306, drm:/dev/dri/card0, "
    "framebuffer:/dev/fb0, web[:PORT], mqtt:BROKER, image:DIR.",
    PANEL,
    field="panel_id",
    default="terminal",
)
@menu_options
def menu(
    camera: CameraOptions,
    panel_id: str,
    request: RequestOptions,
    parent: Path,
    settings: Path | None,
) -> None:
    """Choose a picture in a menu with a few keys, and shoot it.

    First the response, then the dynamic range, then the number of exposures, a time budget or an
    accuracy. Each choice is shown with its exposure time, the time of the capture, and the
    effective levels that it gives with this camera.
    """
    from camctl.system.memory import use_little_memory

    use_little_memory()
    run_menu(lambda: _panel(panel_id), camera, request, parent, settings)


def run_menu(
    make_panel: Callable[[], Panel],
    camera: CameraOptions,
    request: RequestOptions,
    parent: Path,
    settings: Path | None,
    sight: Sight | None = None,
) -> None:
    """Run the menu on a panel, and print where the last picture is.

    What is wrong with the command line is reported before the panel is made.
    """
    from camctl.menu.app import run
    from camctl.profiles import calibrated

    def open_camera(camera_id: str, profile: str = "all") -> tuple[Camera, dict[str, Any]]:
        if not camera_id or camera_id == camera.camera_id:
            return camera.open(profile=profile), camera.source()
        opened = calibrated.open_camera(camera_id, {"profile": profile})
        return opened, {"camera": camera_id, "options": {}}

    def make_job() -> Job:
        from camctl.menu.camera_job import CameraJob

        wanted = request.request()
        return CameraJob(open_camera, parent, _settings_path(settings), request=wanted, sight=sight)

    camera.source()
    _check_folder(parent)
    _entry_point("camera", CAMERAS, camera.camera_id.partition(":")[0])
    last = run(make_panel(), make_job)
    if last is not None:
        for note in last.notes:
            print_warning(note)
        print_text(f"the last picture is in {visible(last.folder)}")


def _check_folder(parent: Path) -> None:
    """Raise `StorageError` where no folder can be at the path: before anything is shot for it."""
    if not all(each.is_dir() for each in (parent, *parent.parents) if each.exists()):
        from camctl.system.files import storage_error

        raise storage_error(parent, NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR)))


def _panel(panel_id: str) -> Panel:
    """Return the panel of an entry point, not opened yet."""
    name, _, address = panel_id.partition(":")
    point = _entry_point("panel", PANELS, name)
    try:
        kind = point.load()
    except (ImportError, AttributeError):
        from camctl.interface import (
            backends,  # imports numpy, which the first screen does not wait for
        )

        kind = backends.load(PANELS, "panel", name)
    try:
        panel: Panel = kind(address) if address else kind()
    except TypeError as error:
        problem = "takes no address" if address else "needs an address"
        raise UsageError(
            f"panel '{name}' {problem}",
            hint=f"use --panel {name}{'' if address else ':ADDRESS'}",
        ) from error
    return panel


def _entry_point(kind: str, group: str, name: str) -> EntryPoint:
    """Return an entry point without loading it; raise `UsageError` where there is none."""
    from importlib.metadata import entry_points

    found = {point.name: point for point in entry_points(group=group)}
    if name not in found:
        raise unknown_name(kind, name, found)
    return found[name]


def _settings_path(given: Path | None) -> Path:
    """Return the file of the menu's settings."""
    if given is not None:
        return given
    from platformdirs import user_state_path

    return user_state_path("camctl") / "menu.json"
