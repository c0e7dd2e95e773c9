"""Radiance pictures that were once sent as text, brought back as far as that can be done.

A transfer in text mode writes every line end as CR LF, and in a picture every byte 10 and 13 looks
like a line end.  Each CR LF of such a file was a byte 10, a byte 13, or both.  The run lengths say
which: after a wrong guess a scan line does not end where the next one begins.  For the mantissas
that remain unsure the nearer to the neighbours is taken, at most 2.4 % of the pixel's brightest
channel off; where a run held both bytes together, their place in it is the likeliest one.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple, TypeAlias

_LF, _CR = 10, 13
_LINE_END = -1  # one CR LF of the damaged file
_MOST_PAIRS = 12  # CR LF that were two bytes, in one scan line

_Run: TypeAlias = tuple[list[int], int]  # tokens as they stand, and how many CR LF are two bytes
_Chain: TypeAlias = "tuple[_Chain | None, _Run] | None"


def was_sent_as_text(data: bytes) -> bool:
    """Return whether no byte 10 and no 13 stands alone: in a whole picture that is no chance."""
    ends = data.count(b"\r\n")
    return ends > 0 and data.count(b"\n") == ends and data.count(b"\r") == ends


def repair(data: bytes, rows: int, columns: int) -> bytes | None:
    """Return run-length coded scan lines as they once were, or None where no reading fits.

    `data` starts at the first scan line.
    """
    tokens: list[int] = []
    for piece in data.split(b"\r\n"):
        tokens.extend(piece)
        tokens.append(_LINE_END)
    tokens.pop()
    whole = bytearray()
    position = 0
    for _ in range(rows):
        for pairs in range(_MOST_PAIRS + 1):
            line = _scan_line(tokens, position, columns, pairs)
            if line is not None:
                break
        else:
            return None
        coded, position = line
        whole += coded
    return bytes(whole)


class _State(NamedTuple):
    """How far a reading of one scan line has come; `pairs` more CR LF may be two bytes."""

    position: int
    channel: int
    filled: int
    pairs: int
    has_lf: bool = False  # the LF of a pair is still to be read

    def ended(self, columns: int) -> _State:
        """Go to the next channel where this one is full."""
        if self.filled < columns:
            return self
        return _State(self.position, self.channel + 1, 0, self.pairs, self.has_lf)


def _scan_line(
    tokens: list[int], position: int, columns: int, pairs: int
) -> tuple[bytes, int] | None:
    """Return the first reading of a scan line that ends where the next begins, and that place."""
    start = [2, 2, columns >> 8, columns & 255]
    if not _matches(tokens[position : position + 4], start):
        return None
    stack: list[tuple[_State, _Chain]] = [(_State(position + 4, 0, 0, pairs), (None, (start, 0)))]
    seen: set[_State] = set()
    while stack:
        state, chain = stack.pop()
        if state in seen:
            continue
        seen.add(state)
        if state.channel == 4:
            follows = tokens[state.position : state.position + 4]
            if not state.has_lf and (not follows or _matches(follows, start)):
                return _joined(chain), state.position
            continue
        choices = list(_next_run(tokens, state, columns))
        stack += [(after, (chain, run)) for after, run in reversed(choices)]
    return None


def _matches(tokens: list[int], wanted: list[int]) -> bool:
    return len(tokens) == len(wanted) and all(
        token == value or (token == _LINE_END and value in (_LF, _CR))
        for token, value in zip(tokens, wanted, strict=True)
    )


def _joined(chain: _Chain) -> bytes:
    runs = []
    while chain is not None:
        chain, (tokens, pairs) = chain
        runs.append(bytes(_settled(tokens, pairs)))
    return b"".join(reversed(runs))


def _next_byte(tokens: list[int], state: _State) -> Iterator[tuple[int, _State]]:
    """Yield what the next byte can be, and the state after it, likely ones first."""
    position, channel, filled, pairs = state.position, state.channel, state.filled, state.pairs
    if state.has_lf:
        yield _LF, _State(position, channel, filled, pairs)
        return
    if position >= len(tokens):
        return
    after = _State(position + 1, channel, filled, pairs)
    if tokens[position] != _LINE_END:
        yield tokens[position], after
        return
    yield _LF, after
    yield _CR, after
    if pairs:
        yield _CR, _State(position + 1, channel, filled, pairs - 1, has_lf=True)


def _next_run(tokens: list[int], state: _State, columns: int) -> Iterator[tuple[_State, _Run]]:
    """Yield what the next run can be, and the state after it."""
    for count, inside in _next_byte(tokens, state):
        length = count - 128 if count > 128 else count
        filled = state.filled + length
        if length == 0 or filled > columns:
            continue
        if count > 128:
            for value, after in _next_byte(tokens, inside):
                ahead = _State(after.position, state.channel, filled, after.pairs, after.has_lf)
                yield ahead.ended(columns), ([count, value], 0)
            continue
        first = [_LF] if inside.has_lf else []
        for pairs in range(inside.pairs + 1):
            end = inside.position + length - len(first) - pairs
            literal = tokens[inside.position : end]
            if end > len(tokens) or literal.count(_LINE_END) < pairs:
                break
            ahead = _State(end, state.channel, filled, inside.pairs - pairs)
            yield ahead.ended(columns), ([count, *first, *literal], pairs)


def _settled(literal: list[int], pairs: int) -> list[int]:
    """Return the bytes of a literal run; the `pairs` line ends that fit best are two bytes."""

    def neighbour(place: int, other: int) -> int:
        inside = 0 <= place < len(literal) and literal[place] != _LINE_END
        return literal[place] if inside else other

    def misfit(place: int) -> int:
        return abs(neighbour(place - 1, _CR) - _CR) + abs(neighbour(place + 1, _LF) - _LF)

    ends = [place for place, token in enumerate(literal) if token == _LINE_END]
    doubled = set(sorted(ends, key=misfit)[:pairs])
    settled: list[int] = []
    for place, token in enumerate(literal):
        if token != _LINE_END:
            settled.append(token)
        elif place in doubled:
            settled += [_CR, _LF]
        else:
            around = neighbour(place - 1, _LF) + neighbour(place + 1, _LF)
            settled.append(_CR if around > _LF + _CR else _LF)
    return settled
