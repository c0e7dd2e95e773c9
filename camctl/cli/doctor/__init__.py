"""`camctl doctor`: what is installed and reachable, and what to do."""

from __future__ import annotations

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import format_table, print_error, print_json, print_text

PROBLEM = 1
"""Exit status where something that is used does not work."""


@command(
    examples=(
        ("camctl doctor", "before you ask for help, or when a camera is not found"),
        ("camctl doctor --json", "for a report of a fault, or a script"),
    )
)
@options.as_json
@click.pass_context
def doctor(context: click.Context, as_json: bool) -> None:
    """Show what is installed and reachable, and what to do.

    Looks at OpenCV, libusb, permissions of devices, udev rules, the configuration file, profiles,
    cameras and optional parts. The exit status is 1 if something that is there does not work.
    """
    from camctl.cli.doctor.checks import diagnose

    found = diagnose()
    problems = [check.name for check in found.checks if check.state == "problem"]
    if as_json:
        print_json(found)
    else:
        print_text(f"camctl {found.camctl}, Python {found.python}, {found.platform}\n")
        rows = [(each.name, each.state, each.found) for each in found.checks]
        print_text(format_table(("", "state", "found"), rows))
        todo = [(each.name, each.to_do) for each in found.checks if each.to_do is not None]
        if todo:
            print_text("\n" + format_table(("", "what to do"), todo))
    if problems:
        print_error(f"there are problems: {', '.join(problems)}")
        context.exit(PROBLEM)
