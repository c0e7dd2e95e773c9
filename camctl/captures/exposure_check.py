"""Did each frame get the exposure that the camera says?  The pixels tell."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from camctl.camera import Pixels
from camctl.captures.report import RatioCheck
from camctl.response.camera import CameraResponse

#: Relative difference that lamps and shutters are granted.
TOLERANCE = 0.03
#: A check that could not tell a frame from one twice as bright is no check.
USELESS = 0.5
_SAMPLES = 1 << 16
_BLOCKS = 64
_ENOUGH = 64
#: Levels that the light is wanted to reach in the shorter frame, and the pixels that suffice.
_LEAST_LEVELS = (16, 4, 1)
_PLENTY = 2000


class NeighbourCheck:
    """Compares neighbouring frames of a capture on a regular sample of their pixels.

    Args:
        real: the camera's response as levels
        black: brightness without light, DN

    """

    def __init__(self, real: CameraResponse, black: int) -> None:
        levels = real.levels
        low, high = real.gaps
        #: Irradiance of each brightness above black, at exposure 1, and how far off it may be.
        self._middle = (low + high) / 2
        self._half = (high - low) / 2
        self._black = black
        self._top = levels.size
        # A scene's light reaches 8 levels in the shorter frame, less on a camera that has few.
        self._lit = min(8.0, max(1.5, levels.size / 8)) * float(levels[-1]) / levels.size

    def sample(self, pixels: Pixels) -> NDArray[np.intp]:
        """Return the brightness above black of every k-th sample, 0 to M, (N,)."""
        step = max(1, pixels.size // _SAMPLES) | 1  # odd: all colours of a mosaic take part
        brightness = pixels.reshape(-1)[::step].astype(np.intp) - self._black
        return np.clip(brightness, 0, self._top)

    def compare(
        self, before: NDArray[np.intp], after: NDArray[np.intp], expected: float
    ) -> RatioCheck:
        """Compare two samples; `expected` is the ratio of their exposures, after over before.

        The measured ratio is the median over blocks of the picture of the ratio of summed light, so
        that a thing that moves spoils its own blocks only.  The tolerance adds to `TOLERANCE` what
        rounding can do at worst to the sums.
        """
        light, then = self._middle[before], self._middle[after]
        high = 0.9 * float(self._middle[-1])
        one_level = float(self._middle[min(1, self._top)])
        # Light that either frame alone says must be readable in both; the brighter the better.
        told_before = (light >= self._lit) & (light * expected <= 0.7 * high)
        below_white = (then <= high) & (light <= high)
        readable = [
            told_before | (below_white & (then / expected >= least * one_level))
            for least in _LEAST_LEVELS
        ]
        use = next((mask for mask in readable if np.count_nonzero(mask) >= _PLENTY), readable[-1])
        nothing = RatioCheck(
            expected=expected, measured=None, tolerance=USELESS, agrees=True, moved=0.0
        )
        if np.count_nonzero(use) < _ENOUGH:
            return nothing
        edges = np.unique(np.linspace(0, use.size, _BLOCKS, endpoint=False).astype(np.intp))
        sums = [
            np.add.reduceat(np.where(use, values, 0.0), edges)
            for values in (light, then, self._half[before], self._half[after])
        ]
        filled = (sums[0] > 0) & (sums[1] > 0)
        if not filled.any():
            return nothing
        first, second, slack_first, slack_second = (part[filled] for part in sums)
        measured = float(np.median(second / first))
        tolerance = TOLERANCE + float(np.median(slack_first / first + slack_second / second))
        if tolerance > USELESS:
            return nothing
        agrees = abs(math.log(measured / expected)) <= math.log1p(tolerance)
        slack = self._half[before] * measured + self._half[after]
        change = np.abs(then - light * measured)
        noise = 3 * (1 + measured) * one_level + 0.1 * then
        moved = np.count_nonzero((change > slack + noise) & readable[-1])
        return RatioCheck(
            expected=expected,
            measured=measured,
            tolerance=tolerance,
            agrees=agrees,
            moved=moved / np.count_nonzero(readable[-1]),
        )
