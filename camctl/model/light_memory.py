"""The light of combinations of samples, kept: few combinations make up most of a picture.

Of 8 bits and a few exposures, two frames at most places have few probable values each, and the
others are black or white.  One sample in a hundred of 24 million is a combination that did not
occur before, and an estimate takes two to six times as long as a look-up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.model.light import Floats32
from camctl.model.plain_light import Plain
from camctl.system.picture_operations import interleave

Estimate: TypeAlias = Callable[
    [list[NDArray[Any]], NDArray[np.unsignedinteger]], tuple[Floats32, Floats32]
]
"""From samples of each frame up to white, (S,), and their sum: irradiance at exposure 1, and its
standard deviation, of each sample by itself."""

#: Samples that are looked up at a time, so that calls cost little (2^14 take a quarter longer).
_BLOCK = 1 << 16

#: Samples that are estimated at a time: their arrays, some 20 of 4 bytes a sample, stay in a cache
#: of 2 MB, nearly (2^14 take a fifth longer).
_ESTIMATED = 1 << 15

#: Combinations that are kept: 2^19, 8 MB.  Of five frames of 24 megapixels a fifth fewer are new
#: than with 2^18, and with 2^20 3 % fewer still.  A number is spread over their places by its
#: product with an odd one without a pattern (2^64 over the golden ratio), and is there or in the
#: place beside it.  Of 200,000 combinations 7 % have no place of their own (17 %, with one place
#: for each).
_PLACES_BITS = 19
_FACTOR = np.uint64(0x9E3779B97F4A7C15)
_SHIFT = np.uint64(64 - _PLACES_BITS)

#: New combinations that are estimated at once: a call costs as much as 3,000 of them.
_AT_ONCE = 1 << 12

#: Bytes of a word.
_WORD = 8

#: A combination, and what was estimated of it: 16 bytes, which numpy takes at once.
_ENTRY = np.dtype([("key", np.uint64), ("light", np.float32), ("deviation", np.float32)])


class LightMemory:
    """Estimates light, and keeps what it found last; threads share it.

    It stops keeping where most combinations are new, as with 12 bits.

    Args:
        estimate: for combinations that are not known
        keeps: whether any are kept

    Attributes:
        plain: makes the light of most samples instead; None: nothing does
    """

    def __init__(self, estimate: Estimate, *, keeps: bool = True) -> None:
        self._estimate, self._keeps = estimate, keeps
        self.plain: Plain | None = None
        if not keeps:
            return
        self._known = np.zeros(1 << _PLACES_BITS, _ENTRY)
        self._known["key"][:2] = 1  # 0 would be there, and is not known either
        self._lock = Lock()  # an entry is written in two steps
        self._asked = self._new = 0

    def of(
        self, values: Sequence[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32]:
        """Return what `estimate` returns; arguments likewise."""
        light, deviation = np.empty((2, total.size), np.float32)
        if self.plain is None:
            self._look_up(values, total, light, deviation)
        else:
            others = self.plain(values, total, light, deviation)
            here = np.empty((2, others.size), np.float32)
            self._look_up([each.take(others) for each in values], total.take(others), *here)
            light[others], deviation[others] = here
        return light, deviation

    def _look_up(
        self,
        values: Sequence[NDArray[Any]],
        total: NDArray[np.unsignedinteger],
        light: Floats32,
        deviation: Floats32,
    ) -> None:
        """Set the light of samples, as it is kept or new."""
        if not self._keeps or (self._asked > self._known.size and self._new > self._asked / 2):
            self._find(values, total, light, deviation)
            return
        self._asked += total.size
        taken = np.empty(min(_BLOCK, total.size), _ENTRY)
        new: list[NDArray[np.intp]] = []
        for start in range(0, total.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            key = _combined([each[part] for each in values])
            places = _places(key)
            with self._lock:
                found = self._known.take(places, out=taken[: key.size], mode="clip")
            known = found["key"] == key
            if not known.all():
                others = np.flatnonzero(~known)
                with self._lock:
                    beside = self._known.take(places[others] ^ 1)
                is_there = beside["key"] == key[others]
                found[others] = beside
                new.append(others[~is_there] + start)
            light[part], deviation[part] = found["light"], found["deviation"]
            if new and (part.stop >= total.size or sum(map(len, new)) >= _AT_ONCE):
                self._add(np.concatenate(new), values, total, light, deviation)
                new = []

    def _add(
        self,
        new: NDArray[np.intp],
        values: Sequence[NDArray[Any]],
        total: NDArray[np.unsignedinteger],
        light: Floats32,
        deviation: Floats32,
    ) -> None:
        """Estimate the light of samples `new`, and keep it."""
        self._new += new.size
        entries = np.empty(new.size, _ENTRY)
        here = [each.take(new) for each in values]
        self._find(here, total.take(new), entries["light"], entries["deviation"])
        light[new], deviation[new] = entries["light"], entries["deviation"]
        keys = self._known["key"]
        for start in range(0, new.size, _BLOCK):
            part = entries[start : start + _BLOCK]
            part["key"] = key = _combined([each[start : start + _BLOCK] for each in here])
            places = _places(key)
            with self._lock:
                places[keys[places] > 1] ^= 1  # `take` would copy all keys
                self._known[places] = part  # of several the last one

    def _find(
        self,
        values: Sequence[NDArray[Any]],
        total: NDArray[np.unsignedinteger],
        light: Floats32,
        deviation: Floats32,
    ) -> None:
        for start in range(0, total.size, _ESTIMATED):
            part = slice(start, start + _ESTIMATED)
            light[part], deviation[part] = self._estimate(
                [each[part] for each in values], total[part]
            )


def _places(key: NDArray[np.uint64]) -> NDArray[np.intp]:
    """Return the place of each combination."""
    places = key * _FACTOR
    places >>= _SHIFT
    return places.view(np.intp)


def _combined(values: Sequence[NDArray[Any]]) -> NDArray[np.uint64]:
    """Return a number for each combination: its bytes, or more than 8 of them combined.

    These are as the digits of a number to a base, modulo 2^64: one is another one's number in 1 of
    2^64 cases.
    """
    count, dtype = _WORD // values[0].itemsize, values[0].dtype
    out = np.empty((values[0].size, _WORD), np.uint8)
    word = out.view(np.uint64).reshape(-1)
    key = word
    for first in range(0, len(values), count):
        some = list(values[first : first + count])
        interleave((some * count)[:count], out.view(dtype))  # repeated, they spread better
        if len(values) > count:
            key = key * _FACTOR + word if first else word.copy()
    return key
