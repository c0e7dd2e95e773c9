"""The light of combinations of samples, kept: few combinations make up most of a picture.

Of 8 bits and a few exposures, two frames at most places have few probable values each, and the
others are black or white.  One sample in a hundred of 24 million is a combination that did not
occur before, and an estimate takes two to six times as long as a look-up.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.system.picture_operations import interleave

Floats32 = NDArray[np.float32]

Estimate: TypeAlias = Callable[
    [list[NDArray[Any]], NDArray[np.unsignedinteger]], tuple[Floats32, Floats32]
]
"""From samples of each frame up to white, (S,), and their sum: irradiance at exposure 1, and its
standard deviation, of each sample by itself."""

#: Samples that are looked up at a time, so that calls cost little (2^14 take a quarter longer).
_BLOCK = 1 << 16

#: Samples that are estimated at a time: their arrays, some 20 of 4 bytes a sample, stay in a cache
#: of 2 MB.
_ESTIMATED = 1 << 14

#: Combinations that are kept: 2^18, 4 MB.  A number is spread over their places by its product with
#: an odd one without a pattern (2^64 over the golden ratio), and is there or in the place beside
#: it.  Of 100,000 combinations 7 % have no place of their own (17 %, with one place for each).
_PLACES_BITS = 18
_FACTOR = np.uint64(0x9E3779B97F4A7C15)
_SHIFT = np.uint64(64 - _PLACES_BITS)

#: New combinations that are estimated at once: a call costs as much as 3,000 of them.
_AT_ONCE = 1 << 12

#: Integers of 1, 2 and 4 bytes that each version of OpenCV has, and unsigned ones twice as wide.
_NARROW = {1: np.uint8, 2: np.uint16, 4: np.int32}
_WIDE = {1: np.uint16, 2: np.uint32, 4: np.uint64}


class LightMemory:
    """Estimates light, and keeps what it found last; for one thread.

    It stops keeping where most combinations are new, as with 12 bits.

    Args:
        estimate: for combinations that are not known
    """

    def __init__(self, estimate: Estimate) -> None:
        self._estimate = estimate
        self._keys = np.zeros(1 << _PLACES_BITS, np.uint64)
        self._keys[:2] = 1  # 0 would be there, and is not known either
        self._light = np.empty(self._keys.size, np.float32)
        self._deviation = np.empty_like(self._light)
        self._work = np.empty(_BLOCK, np.uint64)
        self._asked = self._new = 0
        self._buffers: list[NDArray[Any]] = []

    def of(
        self, values: Sequence[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32]:
        """Return what `estimate` returns; arguments likewise."""
        light = np.empty(total.size, np.float32)
        deviation = np.empty_like(light)
        if self._asked > self._keys.size and self._new > self._asked / 2:
            self._find(values, total, light, deviation)
            return light, deviation
        self._asked += total.size
        new: list[NDArray[np.intp]] = []
        for start in range(0, total.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            key = self._combined([each[part] for each in values])
            places = self._places(key)
            known = self._keys.take(places, mode="clip") == key
            if not known.all():
                beside = np.flatnonzero(~known)
                places[beside] ^= 1
                is_there = self._keys.take(places[beside]) == key[beside]
                new.append(beside[~is_there] + start)
            self._light.take(places, out=light[part], mode="clip")
            self._deviation.take(places, out=deviation[part], mode="clip")
            if new and (part.stop >= total.size or sum(map(len, new)) >= _AT_ONCE):
                self._add(np.concatenate(new), values, total, light, deviation)
                new = []
        return light, deviation

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
        found = np.empty((2, new.size), np.float32)
        here = [each.take(new) for each in values]
        self._find(here, total.take(new), *found)
        for start in range(0, new.size, _BLOCK):
            part = slice(start, start + _BLOCK)
            key = self._combined([each[part] for each in here])
            places = self._places(key)
            places[self._keys.take(places) > 1] ^= 1
            self._keys[places] = key  # of several the last one, in all three
            self._light[places], self._deviation[places] = found[:, part]
        light[new], deviation[new] = found

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

    def _places(self, key: NDArray[np.uint64]) -> NDArray[np.intp]:
        places = np.multiply(key, _FACTOR, out=self._work[: key.size])
        places >>= _SHIFT
        return places.view(np.intp)

    def _combined(self, values: Sequence[NDArray[Any]]) -> NDArray[np.uint64]:
        """Return a number for each combination: its bytes, or more than 8 of them combined.

        These are as the digits of a number to a base, modulo 2^64: one is another one's number in 1
        of 2^64 cases.
        """
        words, level = list(values), 0
        while (size := words[0].itemsize) < 8:
            if len(words) % 2:
                words.append(words[-1])
            if level == len(self._buffers):
                shape = len(words) // 2, _BLOCK, 2
                self._buffers.append(np.empty(shape, _NARROW[size]))
            narrow = [each.view(_NARROW[size]) for each in words]
            words = []
            for place, out in enumerate(self._buffers[level][:, : values[0].size]):
                interleave(narrow[2 * place], narrow[2 * place + 1], out)
                words.append(out.reshape(-1).view(_WIDE[size]))
            level += 1
        key = words[0]
        for each in words[1:]:
            key = key * _FACTOR + each
        return key
