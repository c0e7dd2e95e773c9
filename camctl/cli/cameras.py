"""`camctl cameras`: the connected cameras."""

from __future__ import annotations

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import option
from camctl.cli.output import format_table, print_json, print_text, print_warning

UDEV_FILE = "/etc/udev/rules.d/70-camctl.rules"


@command(
    examples=(
        ("camctl cameras", "all cameras that can be opened now"),
        ("camctl shoot --camera ID", "shoot with one of them"),
        ("camctl cameras --probe", "also look for cameras on serial ports"),
        (
            f"camctl cameras --udev-rules | sudo tee {UDEV_FILE}",
            "let the person logged in at this computer use USB cameras without being root",
        ),
    )
)
@option("--probe", "Also send commands to devices that may not be cameras, such as serial ports.")
@option(
    "--udev-rules",
    "Print udev rules that give the person logged in at this computer access to USB cameras.",
)
@options.as_json
@click.pass_context
def cameras(context: click.Context, probe: bool, udev_rules: bool, as_json: bool) -> None:
    """List the connected cameras.

    The first column is the id for --camera. Below, each backend with what it looks for.
    """
    if udev_rules:
        options.refuse_together(context, "--udev-rules", {"probe", "as_json"})
        from camctl.drivers.common.usb import UDEV_RULES

        print_text(UDEV_RULES.rstrip("\n"))
        return
    from camctl.interface.backends import list_backends

    backends = list_backends(probe=probe)
    for backend in backends:
        if backend.problem:
            print_warning(f"{backend.name}: {backend.problem}")
    headings: tuple[str, ...] = ("id", "make", "model", "serial", "driver", "remark")
    found = [camera for backend in backends for camera in backend.cameras]
    rows = [[str(getattr(camera, name)) for name in headings] for camera in found]
    if as_json:
        print_json([dict(zip(headings, row, strict=True)) for row in rows])
        return
    if not any(camera.remark for camera in found):
        headings, rows = headings[:-1], [row[:-1] for row in rows]
    print_text(format_table(headings, rows) if rows else "no camera found")
    searches = [
        (
            backend.name,
            "search failed" if backend.problem else str(len(backend.cameras) or "none"),
            backend.about,
        )
        for backend in backends
    ]
    print_text("\n" + format_table(("backend", "found", "cameras"), searches))
