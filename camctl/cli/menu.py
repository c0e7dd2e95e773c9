"""`camctl menu`: the camera menu on a panel."""

from __future__ import annotations

from pathlib import Path

import click

from camctl.cli import options
from camctl.cli.capture_output import new_directory
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, LightOptions
from camctl.cli.output import print_text, print_warning
from camctl.cli.parameter_types import PANEL, PATH
from camctl.errors import UsageError


@command(
    examples=(
        ("camctl menu", "on this terminal, with the simulated camera"),
        ("camctl menu --camera v4l2:/dev/video0 -o pictures", "a real camera; results in pictures"),
    )
)
@options.camera_options
@click.option(
    "--panel",
    "panel_id",
    type=PANEL,
    default="terminal",
    metavar="NAME[:ADDRESS]",
    help="Panel that shows the menu; terminal is this terminal, with the arrow keys.",
)
@options.light_options
@click.option(
    "-o",
    "--output",
    "parent",
    type=PATH,
    default=".",
    metavar="PATH",
    help="Folder in which each capture gets a folder of its own.",
)
def menu(camera: CameraOptions, panel_id: str, light: LightOptions, parent: Path) -> None:
    """Choose a picture in a menu with a few keys, and shoot it.

    First the response, then the dynamic range, then the number of exposures. Each number is shown
    with its total exposure time and the effective levels that it gives.
    """
    from camctl.backends import PANELS, load
    from camctl.captures.request import CaptureRequest
    from menu.app import run
    from menu.camera_job import CameraJob

    name, _, address = panel_id.partition(":")
    kind = load(PANELS, "panel", name)
    try:
        panel = kind(address) if address else kind()
    except TypeError as error:
        problem = "takes no address" if address else "needs an address"
        raise UsageError(
            f"panel '{name}' {problem}",
            hint=f"use --panel {name}{'' if address else ':ADDRESS'}",
        ) from error
    with camera.open() as opened:
        job = CameraJob(
            opened,
            lambda: new_directory(parent),
            request=CaptureRequest(**light.request_fields()),
            source=camera.source(),
        )
        last = run(panel, job)
    if last is not None:
        for note in last.notes:
            print_warning(note)
        print_text(f"the last picture is in {last.folder}")
