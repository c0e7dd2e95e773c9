"""Brightness levels of equal irradiance in the frames of an exposure series, from their histograms.

The pixels below brightness k in a frame of exposure t have an irradiance below E_k / t.  In another
frame of the same scene an equal number of pixels lies below some brightness k', thus E_k / t =
E_k' / t' (Grossberg and Nayar, "What Can Be Known about the Radiometric Response from Images?",
ECCV 2002).  No pixel is compared with a pixel: small movements do not matter, and all pixels count.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import Field, dataclass, fields, replace
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.model.quantiles import median
from camctl.model.response.camera import FloatArray, srgb_to_linear
from camctl.model.sensor import CLIPPING_SIGMAS

#: Brightness levels at which frames are matched.
_NODES = 254
#: Noise of a sample, unknown here, and the width over which histograms are flat: full scale / 256.
NOISE_STEPS = 256
#: Pixels within that width that a match needs, and the share of full scale below which noise and
#: clipping at black distort the histogram.
LEAST_PIXELS, DARKEST = 20, 0.006
#: Pixels of a frame that count as independent: neighbours share the blur of the lens, the block of
#: a JPEG file and the errors of a response.  The number does not decide, as the fit measures what
#: no curve explains: sRGB is found within 0.004 stops (median) at 6 MP with 2^16 and 2^22, at 24 MP
#: with 2^19 and without a limit (tests/bench/bench_photographs.py with --megapixels).
INDEPENDENT = 1 << 19
#: Frames whose exposures differ more are not matched: few pixels are in range in both.
LARGEST_RATIO = 100.0
#: Each frame is matched with so many of the next exposures: of all pairs of J frames J - 1 are
#: independent.
_NEXT = 5
#: Brightness, share of full scale, between which unknown exposures are guessed, and the number of
#: nodes that are needed.
_GUESSED, LEAST_NODES = (0.03, 0.97), 5


PairCounts: TypeAlias = Callable[[int, int], NDArray[np.int64]]
"""Returns (2, K + 1): the pixels of two frames below the first edge, between edges, and from the
last edge on (saturated); of the same places in both frames."""


@dataclass(frozen=True, eq=False)
class Matches:
    """Pairs of brightness levels that the same irradiance has in two frames.

    Attributes:
        short: (N,) index of the frame of shorter exposure
        long: (N,) index of the other
        low: (N,) brightness in the shorter, levels
        high: (N,) brightness in the longer, levels
        low_variance: (N,) variance of `low`, levels squared
        high_variance: (N,) variance of `high`
        shift: (N,) what noise adds to ln(irradiance at `high`) over that at `low`
        alike: neighbouring matches have pixels in common: so many count as one
    """

    short: NDArray[np.intp]
    long: NDArray[np.intp]
    low: FloatArray
    high: FloatArray
    low_variance: FloatArray
    high_variance: FloatArray
    shift: FloatArray
    alike: float = 3.0

    @property
    def pairs(self) -> NDArray[np.intp]:
        """(N,) number of the pair of frames."""
        return np.asarray(self.short + (1 + self.long.max(initial=0)) * self.long)

    def part(self, rows: NDArray[np.bool_]) -> Matches:
        """Return some of the matches."""
        columns: dict[str, Any] = {each.name: getattr(self, each.name)[rows] for each in _columns()}
        return replace(self, **columns)


def _columns() -> list[Field[Any]]:
    return [each for each in fields(Matches) if each.name != "alike"]


def all_matches(parts: Sequence[Matches]) -> Matches:
    """Return the matches of several channels as those of one, of each channel some in turn."""
    count = len(parts)
    columns: dict[str, Any] = {
        name.name: np.concatenate(
            [getattr(each, name.name)[place::count] for place, each in enumerate(parts)]
        )
        for name in _columns()
    }
    return replace(parts[0], **columns, alike=max(1.0, parts[0].alike / count))


def match_levels(
    counts_of: PairCounts, exposures: Sequence[float], edges: FloatArray, darkest: float = 0.0
) -> Matches:
    """Return the brightness levels of equal irradiance in all pairs of frames.

    Args:
        counts_of: pixels of two frames, given by their indices
        exposures: relative exposures of the frames
        edges: (K,) levels, ascending; the last is M
        darkest: level up to which noise distorts the histograms, as it is clipped at black
    """
    levels = edges[-1] + 1
    width = max(1.0, levels / NOISE_STEPS)
    lowest = max(1.0, DARKEST * edges[-1])
    nodes: FloatArray = np.unique(np.round(np.linspace(lowest + 1, edges[-1], _NODES)))
    found: list[tuple[FloatArray, ...]] = []
    for short, long in matched_pairs(exposures):
        pixels = counts_of(short, long)
        counts = pixels * float(min(1.0, INDEPENDENT / max(1, int(pixels[0].sum()))))
        (below_short, below_long), places = _below(counts, edges)
        number = np.interp(nodes, places, below_long)
        low = np.interp(number, below_short, places)
        low_pixels, low_variance = _spread(below_short, places, low, width)
        high_pixels, high_variance = _spread(below_long, places, nodes, width)
        used = (low > lowest) & (number > 0) & (number < counts[1].sum())
        used &= np.minimum(low_pixels, high_pixels) >= LEAST_PIXELS
        pair = np.full((2, int(used.sum())), [[short], [long]], np.float64)
        for level, variance in ((low, low_variance), (nodes, high_variance)):
            # They are shifted by as much as the noise there, all alike: together they are one.
            dark = level < darkest
            number = np.count_nonzero(dark & used)
            variance[dark] += number * (darkest / CLIPPING_SIGMAS) ** 2
        values = (low, nodes, low_variance, high_variance, np.zeros(low.size))
        found.append((*pair, *(each[used] for each in values)))
    if not found:
        found = [(np.zeros(0),) * 7]
    columns = [np.concatenate(column) for column in zip(*found, strict=True)]
    short_, long_ = (each.astype(np.intp) for each in columns[:2])
    low_, high_, *variances, shift = columns[2:]
    return Matches(short_, long_, low_, high_, variances[0], variances[1], shift)


def matched_pairs(exposures: Sequence[float]) -> Iterator[tuple[int, int]]:
    """Yield frames that are matched, the shorter exposure first: each with the next longer ones."""
    order = sorted(range(len(exposures)), key=exposures.__getitem__)
    for place, short in enumerate(order):
        ratios = [(k, exposures[k] / exposures[short]) for k in order[place + 1 :]]
        longer = [k for k, ratio in ratios if 1.0 + 1e-6 < ratio <= LARGEST_RATIO]
        yield from ((short, long) for long in longer[:_NEXT])


def _spread(
    below: FloatArray, places: FloatArray, at: FloatArray, width: float
) -> tuple[FloatArray, FloatArray]:
    """Return the pixels within `width`, and the variance of a level at which a count is reached.

    Noise carries pixels across a level, at random: sigma / sqrt(pi) times the density of pixels is
    the variance of their number.  Where the density changes, noise shifts the count (half its
    variance times the relative slope of the density), and the place between two edges is unknown.
    """
    middle = np.interp(at, places, below)
    left = middle - np.interp(at - width, places, below)
    right = np.interp(at + width, places, below) - middle
    density = np.maximum((left + right) / (2 * width), 1e-9)
    change = np.minimum(np.abs(right - left) / (width * density), 2.0)
    counting = width / math.sqrt(math.pi) / density
    return (left + right) / 2, counting + np.minimum(change, 1) ** 2 / 12 + (
        change * width / 4
    ) ** 2


def guess_exposures(counts: NDArray[np.int64], edges: FloatArray) -> FloatArray:
    """Return exposures of frames about which nothing is known, as if the response were sRGB, (J,).

    Frames with neighbouring mean brightness are compared.

    Args:
        counts: (J, K + 1) pixels of each frame, as `PairCounts` returns them of two
        edges: as `match_levels` takes them

    Raises:
        DataError: two neighbours have too few brightness levels in common
    """
    logs = np.zeros(len(counts))
    for dark, bright, step in neighbour_steps(counts, edges):
        if step is None:
            raise DataError(
                "the exposures cannot be estimated: two frames have too few brightness levels in "
                "common",
                hint="add a frame between them, use a scene with many shades, or give the times",
                remedies={"times": None},
            )
        logs[bright] = logs[dark] + step
    return np.asarray(np.exp(logs))


def neighbour_steps(
    counts: NDArray[np.int64], edges: FloatArray
) -> Iterator[tuple[int, int, float | None]]:
    """Yield frames of neighbouring mean brightness, and their ratio as if the response were sRGB.

    Arguments as of `guess_exposures`.

    Yields:
        position of the darker one, of the brighter one, and the logarithm of the ratio of their
        exposures; None where they have too few brightness levels in common
    """
    levels = edges[-1] + 1
    below, places = _below(counts, edges)
    order = np.argsort(-below.sum(axis=1))
    nodes = np.linspace(*_GUESSED, _NODES) * levels
    for dark, bright in pairwise(order.tolist()):
        number = np.interp(nodes, places, below[bright])
        low = np.interp(number, below[dark], places)
        used = (low > _GUESSED[0] * levels) & (low < _GUESSED[1] * levels)
        used &= np.gradient(number, nodes) * levels / NOISE_STEPS >= LEAST_PIXELS
        if np.count_nonzero(used) < LEAST_NODES:
            yield dark, bright, None
            continue
        steps = np.log(srgb_to_linear(nodes[used] / levels) / srgb_to_linear(low[used] / levels))
        yield dark, bright, median(steps)


def _below(counts: NDArray[Any], edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the pixels of each frame below brightness levels, (J, K + 1), and these levels."""
    below = np.concatenate([np.zeros((len(counts), 1)), np.cumsum(counts[:, :-1], axis=1)], axis=1)
    return below, np.concatenate([[0.0], edges])
