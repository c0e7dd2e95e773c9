"""The objective's integral for p other than 1, by Gauss-Legendre panels in ln E.

In ln E the closed-form slopes are sums of a few exponentials, so that panels of length <= 1 with
`NODES` nodes are exact to rounding for whole p.  For other p the integrand has a branch point where
g' meets h': panels are halved towards it, the last one too short to matter.
"""

from __future__ import annotations

import numpy as np

from camctl.errors import UsageError
from camctl.exposure.desired import DesiredResponse
from camctl.exposure.real import FloatArray

NODES = 16
HALVINGS = 26
CHUNK = 2048


def _panels(p: float, bend: int) -> tuple[FloatArray, FloatArray]:
    """Return edges in 0..1 (panels' starts and lengths), dense towards where g' meets h'."""
    if p == round(p):
        return np.array([0.0]), np.array([1.0])
    powers = 0.5 ** np.arange(HALVINGS + 1)
    edges = np.concatenate([1 - powers, [1.0]])
    if bend > 0:
        edges = (1 - edges)[::-1]
    return edges[:-1], np.diff(edges)


def power_of_excess(
    start: FloatArray,
    stop: FloatArray,
    width: FloatArray,
    desired: DesiredResponse,
    levels_wanted: float,
    p: float,
) -> float:
    """Return the sum over rows of the integral of (g' - 1/width)^p over [start, stop].

    `start`, `stop` and `width` are (K,) float64, with g' >= 1/width throughout.
    """
    if not start.size:
        return 0.0
    if desired.bend == 0:
        height = np.maximum(levels_wanted * desired.slope(start) - 1 / width, 0.0)
        return float(np.sum(height**p * (stop - start)))
    if start[0] <= 0:
        raise UsageError(f"p = {p:g} down to no light at all", hint="give a finite dynamic range")
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    nodes, weights = (nodes + 1) / 2, weights / 2
    offsets, lengths = _panels(p, desired.bend)
    length = np.log1p((stop - start) / start)
    longest = float(length.max())
    total = 0.0
    for first in range(0, start.size, CHUNK):
        rows = slice(first, first + CHUNK)
        parts = int(np.ceil(min(longest, float(length[rows].max())))) or 1
        for part in range(parts):
            for offset, share in zip(offsets, lengths, strict=True):
                place = (part + offset + share * nodes) / parts
                t = length[rows, np.newaxis] * place
                E = start[rows, np.newaxis] * np.exp(t)
                height = levels_wanted * desired.slope(E) - 1 / width[rows, np.newaxis]
                value = np.maximum(height, 0.0) ** p * E
                total += float(np.sum((value @ weights) * length[rows])) * share / parts
    return total
