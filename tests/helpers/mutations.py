"""Damage to valid files and replies: what a broken disk, line or editor, or a hostile hand does."""

from __future__ import annotations

import random
import re
from collections.abc import Callable, Sequence
from typing import TypeAlias

Change: TypeAlias = Callable[[bytes, random.Random, Sequence[bytes]], bytes]

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_VALUE = re.compile(rb'"[^"\n]{0,80}"|\btrue\b|\bfalse\b|\bnull\b|\[[^\[\]]{0,200}\]')

NUMBERS = (
    *(b"0", b"-0", b"-1", b"1", b"2", b"0.5", b"1e308", b"-1e308", b"1e999", b"5e-324", b"1e-300"),
    *(b"NaN", b"nan", b"Infinity", b"-inf", b"1e7", b"255", b"256", b"65535", b"65536", b"16"),
    *(b"2147483648", b"4294967296", b"18446744073709551616", b"9" * 400, b"9" * 5000, b"0x10"),
)
VALUES = (
    *(b"null", b"true", b"[]", b"{}", b'""', b'"x"', b"[[]]", b'"\\u0000"', b'"\\ud800"', b"-1"),
    *(b"[" * 300 + b"]" * 300, b'"' + b"x" * 5000 + b'"', b'"../../x"', b'"\\u001b[2J"', b"[1, 2]"),
)
_WORDS = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)

_HEADER = 600
"""Bytes at the start of a file, where damage has the largest effects."""


def mutated(data: bytes, rng: random.Random, others: Sequence[bytes] = ()) -> bytes:
    """Return damaged `data`, with pieces of itself and `others`; sometimes all is random."""
    if rng.random() < 0.05:
        return rng.randbytes(rng.randrange(400))
    for _ in range(rng.choice((1, 1, 2, 3, 5))):
        data = rng.choice(_CHANGES)(data, rng, [data, *others])
    return data


def _position(data: bytes, rng: random.Random) -> int:
    reach = len(data) if rng.random() < 0.5 else min(_HEADER, len(data))
    return rng.randrange(reach) if reach else 0


def _flip_bits(data: bytes, rng: random.Random, _others: Sequence[bytes]) -> bytes:
    changed = bytearray(data)
    for _ in range(rng.randint(1, 4) if data else 0):
        changed[_position(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _cut(data: bytes, rng: random.Random, _others: Sequence[bytes]) -> bytes:
    return data[: _position(data, rng)]


def _remove(data: bytes, rng: random.Random, _others: Sequence[bytes]) -> bytes:
    at = _position(data, rng)
    return data[:at] + data[at + rng.choice((1, 2, 4, 30)) :]


def _splice(data: bytes, rng: random.Random, others: Sequence[bytes]) -> bytes:
    other = rng.choice(others)
    start, at = _position(other, rng), _position(data, rng)
    piece = other[start : start + rng.choice((1, 4, 16, 100, 1000))]
    kept = at + (len(piece) if rng.random() < 0.5 else 0)  # over what is there, or in between
    return data[:at] + piece * rng.choice((1, 1, 1, 20)) + data[kept:]


def _write_word(data: bytes, rng: random.Random, _others: Sequence[bytes]) -> bytes:
    """Overwrite an integer of 1, 2, 4 or 8 bytes with an extreme or a random one."""
    size = rng.choice((1, 2, 4, 8))
    word = rng.choice(_WORDS) if rng.random() < 0.7 else rng.getrandbits(8 * size)
    if rng.random() < 0.2:
        word = -word
    packed = (word % (1 << 8 * size)).to_bytes(size, rng.choice(("little", "big")))
    at = _position(data, rng)
    return data[:at] + packed + data[at + size :]


def _change_text(pattern: re.Pattern[bytes], values: Sequence[bytes]) -> Change:
    def change(data: bytes, rng: random.Random, _others: Sequence[bytes]) -> bytes:
        found = list(pattern.finditer(data))
        if not found:
            return _flip_bits(data, rng, _others)
        match = rng.choice(found)
        return data[: match.start()] + rng.choice(values) + data[match.end() :]

    return change


_CHANGES = (
    *(_flip_bits, _cut, _remove, _splice, _write_word, _write_word),
    *(_change_text(_NUMBER, NUMBERS), _change_text(_VALUE, VALUES)),
)
