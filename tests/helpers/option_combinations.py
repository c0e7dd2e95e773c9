"""Combinations of values at the corners of several options of a command.

`covering` returns rows in which each value of an option meets each value of each other one; a
command is run once with its quick line, and once with its whole numbers at their largest, so that
sets of three and four meet, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from random import Random

Value = tuple[str, str]
"""Name of an option, and the text of its value."""

Row = tuple[Value, ...]

WIDTH = 5
"""Options in a row: with more, most rows hold two that exclude each other, and are refused."""


def pairs_of(row: Row) -> Iterator[frozenset[Value]]:
    """Yield each two values of a row."""
    return (frozenset(pair) for pair in combinations(row, 2))


def all_pairs(values: Mapping[str, list[str]]) -> set[frozenset[Value]]:
    """Return each pair of values of two options."""
    return {
        frozenset(((one, a), (other, b)))
        for one, other in combinations(values, 2)
        for a in values[one]
        for b in values[other]
    }


def covering(values: Mapping[str, list[str]], random: Random) -> Iterator[Row]:
    """Yield rows of at most `WIDTH` values that together hold each pair of values."""
    left = dict.fromkeys(sorted(all_pairs(values), key=sorted))  # in an order that never varies
    while left:
        row = sorted(random.choice(list(left)))
        others = [name for name in values if name not in dict(row)]
        random.shuffle(others)
        for name in others[: WIDTH - 2]:
            gains = [
                (
                    sum(frozenset((each, (name, text))) in left for each in row),
                    random.random(),
                    text,
                )
                for text in values[name]
            ]
            row.append((name, max(gains)[2]))
        for pair in pairs_of(tuple(row)):
            left.pop(pair, None)
        yield tuple(row)
