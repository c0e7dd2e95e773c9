"""`camctl cameras`: what is connected."""

from __future__ import annotations

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import say, say_json, table, warn


@command(
    examples=(
        ("camctl cameras", "every camera that can be opened now"),
        ("camctl shoot --camera ID", "shoot with one of them"),
    )
)
@options.as_json
def cameras(as_json: bool) -> None:
    """List the cameras that are connected.

    The first column is the id that --camera takes.
    """
    from camctl.registry import discover_cameras

    found, problems = discover_cameras()
    for problem in problems:
        warn(problem)
    if as_json:
        say_json(
            [
                {
                    "id": camera.id,
                    "make": camera.make,
                    "model": camera.model,
                    "serial": camera.serial,
                    "driver": camera.driver,
                }
                for camera in found
            ]
        )
        return
    if not found:
        say("no camera found")
        return
    say(
        table(
            ("id", "make", "model", "serial", "driver"),
            [(each.id, each.make, each.model, each.serial, each.driver) for each in found],
        )
    )
