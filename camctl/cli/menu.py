"""`camctl menu`: the camera menu on a panel."""

from __future__ import annotations

from pathlib import Path

import click

from camctl.cli import options
from camctl.cli import parameters as kinds
from camctl.cli.capture_output import fresh_directory, source_of
from camctl.cli.commands import command
from camctl.cli.output import say, warn
from camctl.errors import UsageError


@command(
    examples=(
        ("camctl menu", "on this terminal, with the simulated camera"),
        ("camctl menu --camera v4l2:/dev/video0 -o pictures", "a real camera; results in pictures"),
    )
)
@options.camera
@options.camera_words
@click.option(
    "--panel",
    "panel_id",
    default="terminal",
    metavar="NAME[:ADDRESS]",
    help="Which panel; terminal is this one, with arrow keys.",
)
@options.shooting
@options.simulation
@click.option(
    "-o",
    "--output",
    "parent",
    type=kinds.PATH,
    default=".",
    metavar="PATH",
    help="Folder in which each capture gets a folder of its own.",
)
def menu(
    camera_id: str,
    words: tuple[tuple[str, str], ...],
    panel_id: str,
    mains: str | None,
    use_aperture: bool,
    spend_shutter: bool,
    scene: str | None,
    sensor: str | None,
    size: str | None,
    seed: int | None,
    real_time: bool,
    parent: Path,
) -> None:
    """Pick a picture on a panel with a few keys, and shoot it.

    First the response, then the range, then the number of exposures.  Beside each number stands
    what it costs: how long the shutter is open, and how many effective levels that buys.
    """
    from camctl.backends import PANELS, load, open_camera
    from camctl.captures.request import CaptureRequest
    from menu.app import run
    from menu.camera_job import CameraJob

    name, _, address = panel_id.partition(":")
    kind = load(PANELS, "panel", name)
    try:
        panel = kind(address) if address else kind()
    except TypeError as error:
        needs = "takes no address" if address else "needs an address"
        raise UsageError(
            f"panel '{name}' {needs}", hint=f"say --panel {name}{'' if address else ':ADDRESS'}"
        ) from error
    beside = options.camera_options(
        words, scene=scene, sensor=sensor, size=size, seed=seed, real_time=real_time
    )
    request = CaptureRequest(
        use_aperture=use_aperture,
        mains_hz=None if mains is None else float(mains),
        spend_shutter=spend_shutter,
    )
    with open_camera(camera_id, beside) as camera:
        job = CameraJob(
            camera,
            lambda: fresh_directory(parent),
            request=request,
            source=source_of(camera_id, beside),
        )
        last = run(panel, job)
    if last is not None:
        for note in last.notes:
            warn(note)
        say(f"the last picture is in {last.folder}")
