"""`camctl schema`: JSON schemas of what commands print."""

from __future__ import annotations

import click

from camctl.cli.commands import command
from camctl.cli.output import print_json, print_text
from camctl.errors import unknown_name


@command(
    examples=(
        ("camctl schema", "the names of the schemas: commands, and error for a failure of any"),
        ("camctl schema shoot", "of camctl shoot --json and of report.json"),
        ("camctl schema calibrate noise > noise.json", "for a validator, or to generate types"),
    )
)
@click.argument("names", nargs=-1, metavar="[COMMAND]...")
def schema(names: tuple[str, ...]) -> None:
    """Print the JSON schema of what a command prints with --json.

    It is an object with a format_version, which changes when a field is removed or gets another
    meaning, not when one is added.
    """
    from camctl.cli.schema.types import schema as schema_of
    from camctl.cli.schema.types import schema_names

    known = schema_names()
    name = " ".join(names)
    if not name:
        print_text("\n".join(known))
    elif name not in known:
        raise unknown_name("schema", name, known)
    else:
        print_json(schema_of(name))
