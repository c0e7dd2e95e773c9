"""`camctl tradeoff`: accuracy against time."""

from __future__ import annotations

from camctl.cli.commands import LazyGroup

tradeoff = LazyGroup(
    "tradeoff",
    ("capture", "solver", "simulation"),
    package="camctl.cli.tradeoff",
    help="Compare accuracy with the time that it takes.",
    examples=(
        ("camctl tradeoff capture", "pictures of several exposures, chosen in several ways"),
        ("camctl tradeoff solver", "the search for exposures beside general optimisers"),
        ("camctl tradeoff simulation", "fidelity of the simulated sensor against its time"),
    ),
)
