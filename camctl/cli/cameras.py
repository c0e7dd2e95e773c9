"""`camctl cameras`: the connected cameras."""

from __future__ import annotations

import json
from pathlib import Path

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import option
from camctl.cli.output import format_table, print_json, print_text, print_warning
from camctl.cli.parameter_types import PATH
from camctl.errors import UsageError

UDEV_FILE = "/etc/udev/rules.d/70-camctl.rules"


@command(
    examples=(
        ("camctl cameras", "all cameras that can be opened now"),
        ("camctl shoot --camera ID", "shoot with one of them"),
        ("camctl cameras --probe", "also look for cameras on serial ports"),
        (
            "camctl cameras --record cameras.json",
            "what to send to the developers where a camera does not work",
        ),
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
@option(
    "--record FILE",
    "Write what USB cameras say when they are opened, for a report to the developers: without "
    "pictures and serial numbers.",
    PATH,
)
@options.force
@options.as_json
@click.pass_context
def cameras(
    context: click.Context,
    probe: bool,
    udev_rules: bool,
    record: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """List the connected cameras.

    The first column is the id for --camera. Below, each backend states what it looks for.
    """
    if udev_rules:
        options.refuse_together(context, "--udev-rules", {"probe", "record", "force", "as_json"})
        from camctl.drivers.common.usb import UDEV_RULES

        print_text(UDEV_RULES.rstrip("\n"))
        return
    if record is not None:
        options.refuse_together(context, "--record", {"as_json"})
        _record(record, probe=probe, force=force)
        return
    if force:
        raise UsageError("--force is for --record", hint="leave it out")
    from camctl.interface.backends import list_backends

    backends = list_backends(probe=probe)
    for backend in backends:
        if backend.problem:
            print_warning(f"{backend.name}: {backend.problem}")
    headings: tuple[str, ...] = ("id", "make", "model", "serial", "driver", "remark")
    found = [camera for backend in backends for camera in backend.cameras]
    rows = [[str(getattr(camera, name)) for name in headings] for camera in found]
    if as_json:
        print_json({"cameras": [dict(zip(headings, row, strict=True)) for row in rows]})
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


def _record(file: Path, *, probe: bool, force: bool) -> None:
    """Write what the cameras say of themselves."""
    from camctl import __version__
    from camctl.errors import visible
    from camctl.interface.backends import record_cameras
    from camctl.system.files import check_new, write_bytes

    check_new(file, overwrite=force)
    found = record_cameras(probe=probe)
    record = {"format_version": 1, "camctl": __version__, "cameras": found}
    write_bytes(file, f"{json.dumps(record, indent=1)}\n".encode())
    print_text(f"{len(found)} cameras: wrote {visible(file)}")
