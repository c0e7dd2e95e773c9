"""`camctl table`: show the exposure table, or build one for another camera."""

from __future__ import annotations

from camctl.cli.commands import LazyGroup

table = LazyGroup(
    "table",
    ("show", "build"),
    package="camctl.cli.table",
    help="Show the exposure table, or build one for another camera.",
    examples=(
        ("camctl table show", "the built-in table, for an 8-bit linear camera"),
        ("camctl table build --bits 10 -o ten-bit.json", "one for a 10-bit camera"),
    ),
)
