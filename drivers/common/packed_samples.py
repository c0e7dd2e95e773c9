"""Samples of more than 8 bits as sensors pack them into bytes, after MIPI CSI-2."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import Pixels

#: Different codes of a frame from which it shows how many of its bits are used.
_LEAST_CODES = 64


def mipi(bits: int, count: int, data: NDArray[np.uint8], shape: tuple[int, int]) -> Pixels:
    """Unpack groups of bytes: the upper 8 bits of `count` samples, then all their lower bits.

    The lower bits are one little-endian number, with the bits of the first sample lowest.

    Args:
        bits: of a sample
        count: samples of a group
        data: bytes of all lines, whole groups
        shape: (rows, columns)
    """
    lower_bits = bits - 8
    groups = data.reshape(-1, count * bits // 8).astype(np.uint32)
    places = np.arange(count, dtype=np.uint32)
    tail = groups[:, count:]
    number = np.zeros(len(groups), np.uint32)
    for place in range(tail.shape[1]):
        number |= tail[:, place] << 8 * place
    lower = number[:, None] >> places * lower_bits & 2**lower_bits - 1
    return lines((groups[:, :count] << lower_bits | lower).astype(np.uint16), shape)


def lines(groups: Pixels, shape: tuple[int, int]) -> Pixels:
    """Return samples line by line, without those that fill up the last group of a line."""
    rows, columns = shape
    return groups.reshape(rows, -1)[:, :columns]


def used_bits(pixels: Pixels, stated: int | None = None) -> int:
    """Return how many upper bits of a 16-bit frame are used; 16 where it shows too little.

    Args:
        pixels: the frame
        stated: how many of its bits are used, the upper or the lower ones; None: it is not known
    """
    # Where it is known, two codes are enough: noise of lower bits changes the lowest one.
    codes = np.count_nonzero(np.bincount(pixels.reshape(-1)))
    if codes < (_LEAST_CODES if stated is None else 2):
        return 16
    together = int(np.bitwise_or.reduce(pixels, axis=None))
    found = 17 - (together & -together).bit_length()
    if stated is None:
        return found
    return stated if found <= stated else 16
