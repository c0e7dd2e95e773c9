"""Checks on the pixels that each frame had the exposure that the camera reported."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.captures.report import RatioCheck
from camctl.response.camera import CameraResponse

#: Relative difference that lamps and shutters may cause.
TOLERANCE = 0.03
#: A check with a larger tolerance could not detect an exposure that is wrong by a factor of 2.
LARGEST_TOLERANCE = 0.5
#: Samples of a frame that are compared, and blocks of them that the median is taken over.
_SAMPLES, _BLOCKS = 1 << 16, 64
#: Fewer common samples give no ratio.
_LEAST_SAMPLES = 64
#: Only bright samples are compared: those that reach 16 levels in the shorter frame.  Where fewer
#: than `_ENOUGH_SAMPLES` do, 4 levels are enough, then 1.
_ENOUGH_SAMPLES = 2000
_LEAST_LEVELS = (16, 4, 1)


class NeighbourCheck:
    """Compares neighbouring frames of a capture on a regular sample of their pixels.

    Args:
        real: the camera's response as levels
        black: brightness without light, DN
    """

    def __init__(self, real: CameraResponse, black: int) -> None:
        levels = real.levels
        low, high = real.gaps
        # Irradiance of each brightness above black, at exposure 1, and its largest error.
        self._middle = (low + high) / 2
        self._half = (high - low) / 2
        self._black = black
        self._top = levels.size
        # Light counts as measured from 8 levels on, from fewer on a camera that has few.
        self._measurable = min(8.0, max(1.5, levels.size / 8)) * float(levels[-1]) / levels.size
        self._samples: dict[int, NDArray[np.intp]] = {}

    def add(self, position: int, pixels: Pixels) -> None:
        """Keep a sample of the frame at `position` of the sequence."""
        self._samples[position] = self.sample(pixels)

    def remove(self, position: int) -> None:
        """Forget the frame at `position`: it will be shot again."""
        del self._samples[position]

    def has(self, position: int) -> bool:
        """Return whether the frame at `position` and the one before it were added."""
        return position in self._samples and position - 1 in self._samples

    def check(self, position: int, expected: float) -> RatioCheck:
        """Compare the frame at `position` with the one before it; see `compare`."""
        return self.compare(self._samples[position - 1], self._samples[position], expected)

    def sample(self, pixels: Pixels) -> NDArray[np.intp]:
        """Return the brightness above black of every k-th sample, 0 to M, (N,)."""
        step = max(1, pixels.size // _SAMPLES) | 1  # odd, for samples of all colours of a mosaic
        brightness = pixels.reshape(-1)[::step].astype(np.intp) - self._black
        return np.clip(brightness, 0, self._top)

    def compare(
        self, before: NDArray[np.intp], after: NDArray[np.intp], expected: float
    ) -> RatioCheck:
        """Compare two samples; `expected` is the ratio of their exposures, after over before.

        The measured ratio is the median over blocks of the picture of the ratio of summed light: a
        moving object changes its own blocks only.  The tolerance is `TOLERANCE` and the largest
        rounding error of the sums.
        """
        light, then = self._middle[before], self._middle[after]
        high = 0.9 * float(self._middle[-1])
        one_level = float(self._middle[min(1, self._top)])
        # Samples in range in both frames, judged by either frame alone; the brighter the better.
        in_range = (light >= self._measurable) & (light * expected <= 0.7 * high)
        below_white = (then <= high) & (light <= high)
        usable = [
            in_range | (below_white & (then / expected >= least * one_level))
            for least in _LEAST_LEVELS
        ]
        use = next((m for m in usable if np.count_nonzero(m) >= _ENOUGH_SAMPLES), usable[-1])
        unknown = RatioCheck(
            expected=expected, measured=None, tolerance=LARGEST_TOLERANCE, agrees=True, moved=0.0
        )
        if np.count_nonzero(use) < _LEAST_SAMPLES:
            return unknown
        edges = np.unique(np.linspace(0, use.size, _BLOCKS, endpoint=False).astype(np.intp))
        sums = [
            np.add.reduceat(np.where(use, values, 0.0), edges)
            for values in (light, then, self._half[before], self._half[after])
        ]
        filled = (sums[0] > 0) & (sums[1] > 0)
        if not filled.any():
            return unknown
        first, second, error_first, error_second = (part[filled] for part in sums)
        measured = float(np.median(second / first))
        tolerance = TOLERANCE + float(np.median(error_first / first + error_second / second))
        if tolerance > LARGEST_TOLERANCE:
            return unknown
        agrees = abs(math.log(measured / expected)) <= math.log1p(tolerance)
        rounding = self._half[before] * measured + self._half[after]
        change = np.abs(then - light * measured)
        noise = 3 * (1 + measured) * one_level + 0.1 * then
        moved = np.count_nonzero((change > rounding + noise) & usable[-1])
        return RatioCheck(
            expected=expected,
            measured=measured,
            tolerance=tolerance,
            agrees=agrees,
            moved=moved / np.count_nonzero(usable[-1]),
        )


def suspects(checks: Sequence[RatioCheck | None]) -> list[int]:
    """Return the positions of the frames whose exposure is probably wrong, ascending.

    `checks[k]` compares frame k with frame k - 1.  A frame that disagrees with both neighbours is
    the wrong one; where only one pair disagrees, both frames of it are suspect.
    """
    wrong = [later for later, check in enumerate(checks) if check is not None and not check.agrees]
    between = {later for later in wrong if later + 1 in wrong}
    pairs = [
        (later - 1, later) for later in wrong if later not in between and later - 1 not in between
    ]
    return sorted(between | {position for pair in pairs for position in pair})
