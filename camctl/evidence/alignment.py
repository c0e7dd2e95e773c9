"""By how much one photograph is shifted, turned or enlarged against another of the same scene.

The brightness of the longer exposure is turned into brightness of the shorter one, by equal ranks
in their histograms: a response need not be known for it, and a shift changes histograms little
(Grossberg and Nayar, "Determining the camera response from images: what is knowable?", 2003).
What remains is the noise of the shorter one, about the same at every brightness, so that least
squares find the shift: at first over all shifts of small copies, by Fourier transformation, and
then in parts of a pixel on the contours, with weights that leave out what moved.  Blocks of the
picture then show whether it is one of the whole frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patch_errors import MOST_BINS
from camctl.evidence.ratio_check import significant_sigmas
from camctl.model.quantiles import NORMAL_MAD, student
from camctl.model.sensor import JPEG_ERROR
from camctl.system.picture_operations import level_counts, looked_up, required_opencv

#: Blocks along each side of a picture, and contour pixels of each that are compared at most.
_BLOCKS, _POINTS = 8, 600
#: Longest side of the copies in which every shift is tried, and the largest share of a side.
_COARSE_SIDE, _LARGEST = 192, 0.25
#: Standard deviation of the blur before differences are taken, pixels.
_BLUR = 1.0
#: The blur makes neighbours alike: so many pixels have one error.
_ALIKE = 4 * math.pi * _BLUR**2
#: Brightness values that are distinguished where two histograms are compared.
_RANKS = 1024
#: Steps of a fit at each size, at most.
_STEPS = 8
#: Values that OpenCV finds in a line, at most.
_MOST_IN_LINE = 32767
#: Standard deviations at which a residual counts half: Cauchy's weights are then as exact as least
#: squares of 95 % of the samples (Holland and Welsch, 1977).
_CAUCHY = 2.385

_Floats = NDArray[np.float32]
_Vector = NDArray[np.float64]
_Mask = NDArray[np.bool_]
_Residuals = tuple[_Floats, _Mask]
_Size = tuple[_Floats, _Floats, _Mask]


def displacement(short: _Floats, long: _Floats) -> _Vector | None:
    """Return by how much `long` is displaced against `short`; None: nothing can be said.

    Args:
        short: grey copy of the shorter exposure, 0 to 1
        long: grey copy of the longer one, of the same shape

    Returns:
        columns and rows at the centre, pixels, angle in radians (positive: clockwise), and relative
        growth; zeros where it is not displaced
    """
    cv2 = required_opencv("merging photographs")
    if min(short.shape) < 24:
        return None
    matched, usable = brightness_matched(short, long)
    blurred = cv2.GaussianBlur(short, (0, 0), _BLUR)
    template = cv2.GaussianBlur(matched, (0, 0), _BLUR)
    reach = 2 * round(2 * _BLUR) + 1
    usable = cv2.erode(usable.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
    sizes = _pyramid(cv2, blurred, template, usable)
    levels = [_Level.of(cv2, *size) for size in sizes]
    if not all(level.beside.size for level in levels):
        return None
    coarse = _coarse(cv2, *sizes[-1]) * 2 ** (len(levels) - 1)
    places = [np.zeros(2), coarse] if coarse.any() else [coarse]
    for power in range(len(levels) - 1, -1, -1):
        best = _best(
            levels[power], [_fitted(levels[power], place / 2**power, 2) for place in places]
        )
        places = [best.place * 2**power]
    return _judged(levels[0], best)


def brightness_matched(short: _Floats, long: _Floats) -> tuple[_Floats, _Mask]:
    """Return the longer exposure with the brightness of the shorter one, and where it is valid."""
    indices = [np.minimum(each * _RANKS, _RANKS - 1).astype(np.uint16) for each in (short, long)]
    counts = [level_counts(each, _RANKS) for each in indices]
    ranks = [np.cumsum(each) / short.size for each in counts]
    # Of equal ranks the middle: many pixels may be black in both.
    middle = ranks[1] - counts[1] / (2 * short.size)
    low = np.interp(middle, *_rising(ranks[0], np.arange(1, _RANKS + 1) / _RANKS))
    return looked_up(low.astype(np.float32), indices[1]), long < 1 - JPEG_ERROR


def misfit(short: _Floats, long: _Floats) -> float:
    """Return the variance of a grey copy that a longer exposure does not explain; NaN: none can."""
    matched, usable = brightness_matched(short, long)
    return float(np.mean(np.square(short - matched)[usable])) if usable.any() else math.nan


def _rising(ranks: _Vector, values: _Vector) -> tuple[_Vector, _Vector]:
    kept = np.concatenate(([True], np.diff(ranks) > 0))
    return ranks[kept], values[kept]


def _pyramid(cv2: ModuleType, image: _Floats, template: _Floats, usable: _Mask) -> list[_Size]:
    """Return image, template and what is valid of it in full size, half of it, and so on."""
    found = [(image, template, usable)]
    while max(image.shape) > _COARSE_SIDE:
        size = image.shape[1] // 2, image.shape[0] // 2
        area = cv2.INTER_AREA
        share = cv2.resize(usable.astype(np.float32), size, interpolation=area)
        halves = [cv2.resize(each, size, interpolation=area) for each in (image, template)]
        image, template, usable = halves[0], halves[1], share > 0.999
        found.append((image, template, usable))
    return found


def _coarse(cv2: ModuleType, image: _Floats, template: _Floats, usable: _Mask) -> _Vector:
    """Return the shift at which small copies correlate best."""
    mask = usable.astype(np.float32)
    height, width = image.shape
    shape = cv2.getOptimalDFTSize(height * 3 // 2), cv2.getOptimalDFTSize(width * 3 // 2)

    def transformed(values: _Floats) -> _Vector:
        wide = np.zeros(shape)
        wide[:height, :width] = values
        return np.asarray(cv2.dft(wide))

    offset = float(image.mean())
    one, other = template - offset, image - offset
    ours = [transformed(mask * one**power) for power in range(3)]
    theirs = [transformed(other**power) for power in range(3)]

    def sums(power: int, other_power: int) -> _Vector:
        product = cv2.mulSpectrums(ours[power], theirs[other_power], 0, conjB=True)
        return np.asarray(cv2.dft(product, flags=cv2.DFT_INVERSE | cv2.DFT_SCALE))

    # At place d: the other shifted by -d.
    count = np.maximum(sums(0, 0), 1)
    covariance = sums(1, 1) - sums(1, 0) * sums(0, 1) / count
    squares = [sums(2, 0) - sums(1, 0) ** 2 / count, sums(0, 2) - sums(0, 1) ** 2 / count]
    least = 1e-6 * count
    correlation = covariance / np.sqrt(
        np.maximum(squares[0], least) * np.maximum(squares[1], least)
    )
    rows, columns = (np.fft.fftfreq(length, 1 / length).astype(int) for length in shape)
    allowed = (np.abs(rows) <= _LARGEST * height)[:, None] & (np.abs(columns) <= _LARGEST * width)
    best = int(np.argmax(np.where(allowed, correlation, -1)))
    row, column = divmod(best, columns.size)
    return np.array([-columns[column], -rows[row]], np.float64)


@dataclass(frozen=True, eq=False)
class _Level:
    """Contours of the template at one size of the copies, and the image that is compared.

    Attributes:
        image: float32, (rows, columns)
        x, y: coordinates of the contours from the centre, pixels, (N,), in the order of brightness
        values: brightness of the template there
        starts: of the bins of brightness
        beside: brightness minus the mean one of its bin
        by_block: places of the points in the order of blocks
        blocks: where each of these starts in that
        slopes: change of the template with (columns, rows, turn, growth), (4, N)
    """

    image: _Floats
    x: _Floats
    y: _Floats
    values: _Floats
    starts: NDArray[np.intp]
    beside: _Floats
    by_block: NDArray[np.intp]
    blocks: NDArray[np.intp]
    slopes: _Floats

    @classmethod
    def of(cls, cv2: ModuleType, image: _Floats, template: _Floats, usable: _Mask) -> _Level:
        """Return the pixels of each block at which the brightness changes most."""
        across = cv2.Sobel(template, cv2.CV_32F, 1, 0, scale=1 / 8)
        down = cv2.Sobel(template, cv2.CV_32F, 0, 1, scale=1 / 8)
        steep = across * across
        steep += down * down
        steep *= usable
        steep[[0, -1]] = steep[:, [0, -1]] = 0
        height, width = (length // _BLOCKS for length in steep.shape)
        blocks = steep[: _BLOCKS * height, : _BLOCKS * width]
        blocks = blocks.reshape(_BLOCKS, height, _BLOCKS, width)
        of_each = blocks.transpose(0, 2, 1, 3).reshape(_BLOCKS**2, -1)
        place = max(0, of_each.shape[1] - _POINTS)
        least = np.partition(of_each, place, axis=1)[:, place]  # argpartition takes longer
        least = np.maximum(least, np.finfo(np.float32).tiny)
        chosen = np.flatnonzero(blocks >= least.reshape(_BLOCKS, 1, _BLOCKS, 1))
        chosen += chosen // (_BLOCKS * width) * (steep.shape[1] - _BLOCKS * width)
        points = chosen[:: 1 + chosen.size // (2 * _MOST_IN_LINE)]  # many may be equally steep
        points = points[: points.size & ~1]  # `residuals` needs two lines
        points = points[np.argsort(template.take(points))]
        rows, columns = np.divmod(points, template.shape[1])
        x = np.asarray(columns - (template.shape[1] - 1) / 2, np.float32)
        y = np.asarray(rows - (template.shape[0] - 1) / 2, np.float32)
        across, down, values = (each.take(points) for each in (across, down, template))
        half = max(template.shape) / 2
        turn, growth = (down * x - across * y) / half, (across * x + down * y) / half
        edges = (
            values[points.size * np.arange(1, MOST_BINS) // MOST_BINS] if points.size else values
        )
        starts = np.unique(np.append(0, np.searchsorted(values, edges, "right")))
        starts = starts[starts < points.size]
        of_blocks = (rows // height * _BLOCKS + columns // width).astype(np.uint8)
        by_block = np.argsort(of_blocks, kind="stable")
        first = np.flatnonzero(np.diff(of_blocks[by_block].astype(int), prepend=-1))
        found = cls(image, x, y, values, starts, values, by_block, first, values)
        beside = values - found.repeated(found.sums(values) / found.counts)
        found = replace(found, beside=beside)
        slopes = np.stack((across, down, turn, growth))
        # What a change of brightness explains is no displacement.
        return replace(found, slopes=found.without_bins(slopes))

    @property
    def half(self) -> float:
        """Half the longer side, pixels."""
        return float(max(self.image.shape)) / 2

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """Points of each bin."""
        return np.diff(self.starts, append=self.values.size)

    def sums(self, values: _Floats) -> _Vector:
        """Return the sum over each bin."""
        return np.asarray(np.add.reduceat(values, self.starts, axis=-1, dtype=np.float64))

    def repeated(self, of_bins: _Vector) -> _Floats:
        """Return for each point what a bin has."""
        return np.repeat(of_bins.astype(np.float32), self.counts, axis=-1)

    def _moments(self, used: _Floats | np.float32) -> tuple[_Vector, _Vector, _Vector]:
        """Return number, mean and sum of squares of `beside` in each bin, see `without_bins`."""
        beside = self.beside * used
        count = np.maximum(self.sums(np.broadcast_to(used, beside.shape)), 1)
        middle = self.sums(beside) / count
        return count, middle, self.sums(beside * self.beside) - count * middle**2

    @cached_property
    def _moments_of_all(self) -> tuple[_Vector, _Vector, _Vector]:
        return self._moments(np.float32(1))

    def without_bins(self, values: _Floats, used: _Mask | None = None) -> _Floats:
        """Return values at the points minus their line over brightness in each bin of it.

        The line is that of points that are used; None: all.  `values` may have more than one line,
        (..., N).
        """
        if used is None or used.all():
            chosen, (count, middle, spread) = values, self._moments_of_all
        else:
            weights = used.astype(np.float32)
            chosen, (count, middle, spread) = values * weights, self._moments(weights)
        means = self.sums(chosen) / count
        slopes = self.sums(chosen * self.beside) - count * middle * means
        slopes /= np.maximum(spread, 1e-12)
        found = values - self.repeated(means - slopes * middle)
        found -= self.repeated(slopes) * self.beside
        return np.asarray(found)

    def residuals(self, place: _Vector) -> _Residuals:
        """Return image minus template at the points, and which are valid.

        `place` is the displacement of the image: columns, rows, and perhaps turn and growth at the
        end of the longer side, in pixels.
        """
        cv2 = required_opencv("merging photographs")
        columns, rows, turn, growth = np.append(place, np.zeros(4 - len(place))).tolist()
        turn, growth = turn / self.half, growth / self.half
        height, width = self.image.shape
        x = self.x * np.float32(1 + growth) - self.y * np.float32(turn)
        y = self.y * np.float32(1 + growth) + self.x * np.float32(turn)
        x += np.float32(columns + (width - 1) / 2)
        y += np.float32(rows + (height - 1) / 2)
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
        # Linear interpolation lessens the noise between pixels: what is displaced by a part of one
        # would fit better than what is at rest.
        lines = x.reshape(2, -1), y.reshape(2, -1)
        values = cv2.remap(self.image, *lines, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        difference = np.ravel(values) - self.values
        return self.without_bins(difference, inside), inside

    def of_blocks(self, values: _Floats) -> _Vector:
        """Return the sum over each block of the picture that has points."""
        by_block = values.take(self.by_block)
        return np.asarray(np.add.reduceat(by_block, self.blocks, dtype=np.float64))


def _noise(residuals: _Floats, valid: _Mask) -> float:
    values = np.abs(residuals[valid])
    middle = values.size // 2
    median = float(np.partition(values, middle)[middle]) if values.size else 0.0
    return max(median / NORMAL_MAD, 12**-0.5 / 255)  # at least the rounding to 8 bits


def _costs(compared: Sequence[_Residuals]) -> tuple[list[_Floats], _Mask]:
    """Return how badly each of several places fits at the points that are valid at all of them.

    The logarithm of Cauchy's distribution is less sensitive to what moved than squares.
    """
    use = np.logical_and.reduce([valid for _, valid in compared])
    scale = _CAUCHY * min(_noise(residuals, use) for residuals, _ in compared)
    return [np.log1p((each * use / scale) ** 2) for each, _ in compared], use


def _best(level: _Level, fits: Sequence[_Fit]) -> _Fit:
    """Return the fit whose residuals are smallest."""
    if len(fits) == 1:
        return fits[0]
    costs, _ = _costs([level.residuals(fit.place) for fit in fits])
    return fits[int(np.argmin([each.sum() for each in costs]))]


@dataclass(frozen=True, eq=False)
class _Fit:
    place: _Vector
    errors: _Vector


def _fitted(level: _Level, start: _Vector, size: int) -> _Fit:
    """Return the displacement of the image that fits best from `start` on, of `size` numbers."""
    place = np.append(start, np.zeros(size - len(start)))
    slopes = level.slopes[:size]
    for _ in range(_STEPS):
        residuals, valid = level.residuals(place)
        noise = _noise(residuals, valid)
        weighted = slopes * (valid / (1 + (residuals / (_CAUCHY * noise)) ** 2))
        matrix = (weighted @ slopes.T).astype(np.float64)
        matrix += np.diag(np.diag(matrix) * 1e-6 + 1e-9)
        step = np.linalg.solve(matrix, weighted @ residuals)
        place = place - step
        errors = noise * np.sqrt(_ALIKE * np.diag(np.linalg.inv(matrix)))
        if (np.abs(step) < errors).all():
            break
    return _Fit(place, errors)


def _is_better(
    level: _Level, before: _Residuals, after: _Residuals, tests: int, tried: int = 1
) -> bool:
    """Return whether the blocks of the picture fit better after than before, and not by chance.

    Their scatter holds what moved in some of them, and what neighbouring pixels have in common.
    Steps of a quantiser are alike in all blocks: they fit better by less than the noise explains.

    Args:
        level: whose residuals they are
        before: those of one place
        after: of the other one
        tests: over which the significance level is divided
        tried: places of which the other one is the best
    """
    (still, moved), _ = _costs((before, after))
    gains = level.of_blocks(still - moved)
    gains = gains[gains != 0]  # of blocks that can be compared
    if gains.size < 2:
        return False
    limit = student(significant_sigmas(tests), gains.size - 1.0) * gains.std(ddof=1)
    # For small residuals the cost is that of normal noise, -ln of the likelihood, in other units.
    chance = significant_sigmas(tests * tried) ** 2 / 2 * _ALIKE * 2 / _CAUCHY**2
    return bool(gains.sum() > max(limit * math.sqrt(gains.size), chance))


def _judged(level: _Level, fit: _Fit) -> _Vector | None:
    """Return the displacement of `fit` where the blocks confirm it."""
    whole = _fitted(level, fit.place, 4)
    still, shifted, turned = map(level.residuals, (np.zeros(2), fit.place, whole.place))
    pairs = ((shifted, turned), (still, turned), (still, shifted))
    # The best of all shifts fits better than none by chance already.
    tried = math.ceil((2 * _LARGEST) ** 2 * level.image.size)
    is_turned, is_either, is_shifted = (
        _is_better(level, *pair, len(pairs), tried) for pair in pairs
    )
    if is_turned and is_either:
        return _inverse(_known(whole) / (1, 1, level.half, level.half))
    if is_shifted:
        return _inverse(np.append(_known(fit), (0, 0)))
    # It is at rest where displacements by the blur fit worse in all directions.
    moves = _BLUR * np.array(((1, 0), (-1, 0), (0, 1), (0, -1)))
    is_at_rest = all(_is_better(level, level.residuals(move), still, 1) for move in moves)
    return np.zeros(4) if is_at_rest else None


def _known(fit: _Fit) -> _Vector:
    """Return what is beyond its error."""
    return np.where(
        np.abs(fit.place) > significant_sigmas(fit.place.size) * fit.errors, fit.place, 0
    )


def _inverse(place: _Vector) -> _Vector:
    """Return the displacement of the longer exposure for one of the shorter exposure."""
    columns, rows, turn, growth = place.tolist()
    back = 1 / complex(1 + growth, turn)
    centre = -complex(columns, rows) * back
    return np.array((centre.real, centre.imag, back.imag, back.real - 1)) + 0.0  # no -0
