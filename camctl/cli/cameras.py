"""`camctl cameras`: what is connected."""

from __future__ import annotations

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import say, say_json, table, warn
from camctl.errors import UsageError

RULES = "/etc/udev/rules.d/70-camctl.rules"


@command(
    examples=(
        ("camctl cameras", "every camera that can be opened now"),
        ("camctl shoot --camera ID", "shoot with one of them"),
        ("camctl cameras --probe", "ask serial ports, too, whether a camera hangs on them"),
        (
            f"camctl cameras --udev-rules | sudo tee {RULES}",
            "let the person at the desk use USB cameras without being root",
        ),
    )
)
@click.option(
    "--probe",
    is_flag=True,
    help="Also speak to devices that may be no cameras, such as whatever hangs on a serial port.",
)
@click.option(
    "--udev-rules",
    is_flag=True,
    help="Write the rules that give the person at the desk access to USB cameras, and no more.",
)
@options.as_json
def cameras(probe: bool, udev_rules: bool, as_json: bool) -> None:
    """List the cameras that are connected, and the roads that lead to cameras.

    The first column is the id that --camera takes.
    """
    if udev_rules:
        if probe or as_json:
            raise UsageError("--udev-rules goes alone")
        from drivers.common.usb import UDEV_RULES

        say(UDEV_RULES.rstrip("\n"))
        return
    from camctl.backends import list_backends

    looks = list_backends(probe=probe)
    for look in looks:
        if look.problem:
            warn(f"{look.name}: {look.problem}")
    heads = ("id", "make", "model", "serial", "driver")
    found = [camera for look in looks for camera in look.cameras]
    rows = [[str(getattr(camera, name)) for name in heads] for camera in found]
    if as_json:
        say_json([dict(zip(heads, row, strict=True)) for row in rows])
        return
    say(table(heads, rows) if rows else "no camera found")
    roads = [
        (
            look.name,
            "cannot look" if look.problem else str(len(look.cameras) or "none"),
            look.about,
        )
        for look in looks
    ]
    say("\n" + table(("road", "found", "cameras"), roads))
