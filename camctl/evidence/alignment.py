"""By how much one photograph is shifted, turned or enlarged against another of the same scene.

The brightness of the longer exposure is turned into brightness of the shorter one, by equal ranks
in their histograms: a response need not be known for it, and a shift changes histograms little
(Grossberg and Nayar, "Determining the camera response from images: what is knowable?", 2003).
What remains is the noise of the shorter one, about the same at every brightness, so that least
squares find the shift: at first over all shifts of small copies, by Fourier transformation, and
then in parts of a pixel on the contours, with weights that leave out what moved.  Blocks of the
picture then vote whether it is one of the whole frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from camctl.model.sensor import JPEG_ERROR
from camctl.system.picture_operations import level_counts, required_opencv

#: Blocks along each side of a picture, and contour pixels of each that are compared at most.
_BLOCKS, _POINTS = 8, 600
#: Pixels from which on only every second row is searched for contours.
_MANY = 300_000
#: Longest side of the copies in which every shift is tried, and the largest share of a side.
_COARSE_SIDE, _LARGEST = 192, 0.25
#: Brightness from which on a pixel of a photograph may be saturated; below it, it is compared.
_SATURATED = 1 - JPEG_ERROR
#: Standard deviation of the blur before differences are taken, pixels.
_BLUR = 1.0
#: Shifts tried, how far they are apart in small copies, and the share of a picture that remains.
_CANDIDATES, _APART, _OVERLAP = 2, 3, 0.4
#: Bins of brightness, in each of which the mean residual is left out.
_BINS = 48
#: Brightness values that are distinguished where two histograms are compared.
_RANKS = 1024
#: Of the points every so manyth gives medians.
_SAMPLE = 7
#: Steps smaller than this end a fit, pixels.
_SMALL_STEP = 0.01
#: A fit that costs so many times as much as the best one is given up.
_AS_GOOD = 1.1
#: Residuals of this share of full scale count as noise where fits are compared.
_COST_NOISE = 0.004
#: Neighbouring pixels that have the same error, about.
_NEIGHBOURS = 8
#: Halvings of the copy at which the fit begins, and its steps at each size.
_HALVINGS, _STEPS = 2, 8
#: Residuals are limited to so many standard deviations, and those are at least this share of
#: full scale (a quarter of a level in 8 bits).
_MOST_SIGMAS, _LEAST_NOISE = 3.0, 0.001
#: A block votes where its squared residuals differ by so many standard errors and by this share.
_VOTE_SIGMAS, _VOTE_SHARE = 5.0, 0.08
#: Blocks that must vote for a shift, and the share of all votes.
_LEAST_VOTES, _VOTE_MAJORITY = 3, 0.75
#: Standard errors of a displacement that is real, and one that would be seen, in pixels of copies.
_SIGMAS, _SMALL = 5.0, 2.0
#: Points that are needed.
_LEAST_POINTS = 200

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
    if np.count_nonzero(usable) < _LEAST_POINTS:
        return None
    blurred = cv2.GaussianBlur(short, (0, 0), _BLUR)
    template = cv2.GaussianBlur(matched, (0, 0), _BLUR)
    reach = 2 * round(2 * _BLUR) + 1
    usable = cv2.erode(usable.astype(np.uint8), np.ones((reach, reach), np.uint8)) > 0
    sizes = _pyramid(cv2, blurred, template, usable)
    levels = [_Level.of(cv2, *size) for size in sizes]
    if np.count_nonzero(levels[0].is_valid) < _LEAST_POINTS:
        return None
    places = [np.zeros(2), *_coarse(cv2, sizes)]
    for power in range(len(levels) - 1, -1, -1):
        fits = [_fitted(levels[power], place / 2**power, 2) for place in places]
        fits.sort(key=lambda fit: fit.cost)
        first, *rest = fits
        # One that ends where the best one does, within the blur, would go on as it does.
        others = [fit for fit in rest if np.abs(fit.place - first.place).max() > _BLUR]
        kept = [first, *(fit for fit in others[:1] if fit.cost <= _AS_GOOD * first.cost)]
        places = [fit.place * 2**power for fit in kept]
    return _judged(levels[0], fits[0])


def brightness_matched(short: _Floats, long: _Floats) -> tuple[_Floats, _Mask]:
    """Return the longer exposure with the brightness of the shorter one, and where it is valid."""
    indices = [np.minimum(each * _RANKS, _RANKS - 1).astype(np.uint16) for each in (short, long)]
    counts = [level_counts(each, _RANKS) for each in indices]
    ranks = [np.cumsum(each) / short.size for each in counts]
    # Of equal ranks the middle: many pixels may be black in both.
    middle = ranks[1] - counts[1] / (2 * short.size)
    low = np.interp(middle, *_rising(ranks[0], np.arange(1, _RANKS + 1) / _RANKS))
    return low.astype(np.float32)[indices[1]], long < _SATURATED


def _rising(ranks: _Vector, values: _Vector) -> tuple[_Vector, _Vector]:
    kept = np.concatenate(([True], np.diff(ranks) > 0))
    return ranks[kept], values[kept]


def _pyramid(cv2: ModuleType, image: _Floats, template: _Floats, usable: _Mask) -> list[_Size]:
    """Return image, template and what is valid of it in full, half, and quarter size."""
    found = [(image, template, usable)]
    for _ in range(_HALVINGS):
        image, template, usable = found[-1]
        if min(image.shape) < 96:
            break
        size = image.shape[1] // 2, image.shape[0] // 2
        area = cv2.INTER_AREA
        share = cv2.resize(usable.astype(np.float32), size, interpolation=area)
        halves = [cv2.resize(each, size, interpolation=area) for each in (image, template)]
        found.append((halves[0], halves[1], share > 0.999))
    return found


def _coarse(cv2: ModuleType, sizes: list[_Size]) -> list[_Vector]:
    """Return the shifts at which small copies correlate best, in pixels of the full ones."""
    image, template, usable = sizes[-1]
    full = sizes[0][0].shape
    scale = max(1.0, max(image.shape) / _COARSE_SIDE)
    size = round(image.shape[1] / scale), round(image.shape[0] / scale)
    one, mask, other = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA)
        for each in (template, usable.astype(np.float32), image)
    )
    mask = (mask > 0.99).astype(np.float32)
    height, width = one.shape
    shape = cv2.getOptimalDFTSize(height * 3 // 2), cv2.getOptimalDFTSize(width * 3 // 2)

    def transformed(values: _Floats) -> NDArray[np.complex128]:
        return np.fft.rfft2(values, shape)

    offset = float(other.mean())
    one, other = one - offset, other - offset
    ours = [transformed(mask * one**power) for power in range(3)]
    theirs = [np.conj(transformed(other**power)) for power in range(3)]

    def sums(power: int, other_power: int) -> _Vector:
        return np.asarray(np.fft.irfft2(ours[power] * theirs[other_power], shape))

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
    allowed &= count > _OVERLAP * mask.sum()
    correlation = np.where(allowed, correlation, -1)
    found = []
    for _ in range(_CANDIDATES):
        best = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
        row, column = int(rows[best[0]]), int(columns[best[1]])
        found.append(np.array([-column * full[1] / width, -row * full[0] / height]))
        near = (np.abs(rows - row) <= _APART)[:, None] & (np.abs(columns - column) <= _APART)
        correlation[near] = -1
    return found


@dataclass(frozen=True, eq=False)
class _Level:
    """Contours of the template at one size of the copies, and the image that is compared.

    Attributes:
        image: float32, (rows, columns)
        x, y: coordinates of the contours from the centre, pixels, (blocks, points)
        values: brightness of the template there
        bins: which bin of brightness they are in
        is_valid: whether they are to be compared
        slopes: change of the template with (columns, rows, turn, growth), (blocks, points, 4)
    """

    image: _Floats
    x: _Floats
    y: _Floats
    values: _Floats
    bins: NDArray[np.int32]
    is_valid: NDArray[np.bool_]
    slopes: _Floats

    @classmethod
    def of(cls, cv2: ModuleType, image: _Floats, template: _Floats, usable: _Mask) -> _Level:
        """Return the pixels of each block at which the brightness changes most."""
        across = cv2.Sobel(template, cv2.CV_32F, 1, 0, scale=1 / 8)
        down = cv2.Sobel(template, cv2.CV_32F, 0, 1, scale=1 / 8)
        steep = np.where(usable, across**2 + down**2, -1)
        steep[[0, -1]] = steep[:, [0, -1]] = -1
        every = 2 if template.size > _MANY else 1  # of the rows: neighbours tell the same
        height, width = steep.shape[0] // every // _BLOCKS, steep.shape[1] // _BLOCKS
        blocks = steep[::every][: _BLOCKS * height, : _BLOCKS * width]
        blocks = blocks.reshape(_BLOCKS, height, _BLOCKS, width)
        blocks = blocks.transpose(0, 2, 1, 3).reshape(_BLOCKS**2, -1)
        count = min(_POINTS, blocks.shape[1])
        places = np.argpartition(blocks, blocks.shape[1] - count, axis=1)[:, -count:]
        tops, lefts = np.divmod(np.arange(_BLOCKS**2)[:, None], _BLOCKS)
        rows, columns = every * (places // width + tops * height), places % width + lefts * width
        x = np.asarray(columns - (template.shape[1] - 1) / 2, np.float32)
        y = np.asarray(rows - (template.shape[0] - 1) / 2, np.float32)
        across, down, values = (each[rows, columns] for each in (across, down, template))
        is_valid = steep[rows, columns] > 0
        half = max(template.shape) / 2
        turn, growth = (down * x - across * y) / half, (across * x + down * y) / half
        edges = np.quantile(
            np.append(values[is_valid][::_SAMPLE], 0), np.linspace(0, 1, _BINS + 1)[1:-1]
        )
        bins = np.searchsorted(edges, values).astype(np.int32)
        found = cls(image, x, y, values, bins, is_valid, np.stack((across, down, turn, growth), -1))
        for column in range(4):  # what a change of brightness explains is no displacement
            found.slopes[..., column] = found.without_bins(found.slopes[..., column], is_valid)
        return found

    @property
    def half(self) -> float:
        """Half the longer side, pixels."""
        return float(max(self.image.shape)) / 2

    @cached_property
    def counts(self) -> NDArray[np.intp]:
        """Points of each bin that are to be compared."""
        return np.bincount(self.bins[self.is_valid], minlength=_BINS + 1)

    def without_bins(self, values: _Floats, used: _Mask) -> _Floats:
        """Return values at the points minus their mean of each bin of brightness.

        The mean is that of points that are used, of those that are to be compared.
        """
        sums = np.bincount(self.bins.ravel(), (used * values).ravel(), _BINS + 1)
        is_all = np.count_nonzero(used) == self.counts.sum()
        counts = self.counts if is_all else np.bincount(self.bins[used], minlength=_BINS + 1)
        means = sums / np.maximum(counts, 1)
        return values - means.astype(np.float32)[self.bins]

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
        inside = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1) & self.is_valid
        values = cv2.remap(self.image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return self.without_bins(values - self.values, inside), inside


def _noise(residuals: _Floats, valid: _Mask) -> float:
    values = np.abs(residuals[valid][::_SAMPLE])
    return max(1.48 * float(np.median(values)) if values.size else 0.0, _LEAST_NOISE)


def _cost(residuals: _Floats, valid: _Mask) -> float:
    """Return how well a place fits: the logarithm is less sensitive to what moved than squares."""
    values = residuals[valid]
    if values.size < _LEAST_POINTS:
        return math.inf
    return float(np.mean(np.log1p((values / _COST_NOISE) ** 2)))


@dataclass(frozen=True, eq=False)
class _Fit:
    place: _Vector
    errors: _Vector
    cost: float


def _fitted(level: _Level, start: _Vector, size: int) -> _Fit:
    """Return the displacement of the image that fits best from `start` on, of `size` numbers."""
    place = np.append(start, np.zeros(size - len(start)))
    slopes = level.slopes.reshape(-1, 4)[:, :size]
    for _ in range(_STEPS):
        residuals, valid = level.residuals(place)
        noise = _noise(residuals, valid)
        weights = np.where(valid, 1 / (1 + (residuals / (2 * noise)) ** 2), 0).ravel()
        weighted = slopes * weights[:, None]
        matrix = (weighted.T @ slopes).astype(np.float64)
        matrix += np.diag(np.diag(matrix) * 1e-6 + 1e-9)
        step = np.linalg.solve(matrix, weighted.T @ residuals.ravel())
        place = place - step
        if np.abs(step).max() < _SMALL_STEP:
            break
    residuals, valid = level.residuals(place)
    errors = noise * np.sqrt(np.diag(np.linalg.inv(matrix)))
    return _Fit(place, errors, _cost(residuals, valid))


def _carried(before: _Residuals, after: _Residuals) -> bool:
    """Return whether of the blocks that fit clearly better before or after enough do after."""
    use = after[1] & before[1]
    noise = min(_noise(residuals, use) for residuals, _ in (before, after))
    still, moved = (np.minimum((each / noise) ** 2, _MOST_SIGMAS**2) for each, _ in (before, after))
    count = np.maximum(np.count_nonzero(use, axis=1), 1)
    gains = np.where(use, still - moved, 0)
    mean = gains.sum(axis=1) / count
    deviation = np.sqrt(np.maximum((gains**2).sum(axis=1) / count - mean**2, 0))
    error = deviation * np.sqrt(_NEIGHBOURS / count) + 1e-9
    worse = np.where(use, np.maximum(still, moved), 0).sum(axis=1) / count
    is_sure = (np.abs(mean) > _VOTE_SIGMAS * error) & (np.abs(mean) > _VOTE_SHARE * worse)
    pro, contra = (int(np.count_nonzero(is_sure & (sign * mean > 0))) for sign in (1, -1))
    return pro >= _LEAST_VOTES and pro >= _VOTE_MAJORITY * (pro + contra)


def _judged(level: _Level, fit: _Fit) -> _Vector | None:
    """Return the displacement of `fit` where enough blocks vote for it."""
    whole = _fitted(level, fit.place, 4)
    still, shifted, turned = map(level.residuals, (np.zeros(2), fit.place, whole.place))
    if _carried(shifted, turned) and _carried(still, turned):
        return _known(whole) / (1, 1, level.half, level.half)
    if _carried(still, shifted):
        return np.append(_known(fit), (0, 0))
    # It is at rest where blocks vote against small displacements in all directions.
    moves = np.array(((_SMALL, 0), (-_SMALL, 0), (0, _SMALL), (0, -_SMALL)))
    is_at_rest = all(_carried(level.residuals(move), still) for move in moves)
    return np.zeros(4) if is_at_rest else None


def _known(fit: _Fit) -> _Vector:
    """Return what is beyond its error, from the shorter exposure to the longer one."""
    return np.where(np.abs(fit.place) > _SIGMAS * fit.errors, -fit.place, 0)
