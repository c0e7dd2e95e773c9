"""The light of frames that are joined one after the other, where each may be partly saturated.

Frames are joined from the shortest to the longest, each with the inverse of its variance, and one
that contradicts the shorter ones does not count: what saturation does to a sample makes it darker.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.model.distribution import normal_cdf
from camctl.model.light import Floats32
from camctl.model.sensor import CLIPPING_SIGMAS

REACH = np.float32(CLIPPING_SIGMAS)
"""Deviations that no sample is off by."""

#: Exponent of odds that are beyond doubt.
_LARGEST_EXPONENT = 50.0


class Cells(NamedTuple):
    """Samples of one colour of frames, in cells of 2 x 2 pixels.

    Attributes:
        values: (n, 4, C)
        hidden: whether another colour of the pixel is saturated, likewise
        errors: standard deviations of the errors that frames have in common, levels, (n, C)
        of_chroma: variances of those by fewer samples of colours alone, likewise
        light, deviation: without these errors, (4, C)
        common: what they add to the deviation where they are small, (C,)
    """

    values: NDArray[Any]
    hidden: NDArray[np.bool_]
    errors: Floats32
    of_chroma: Floats32
    light: Floats32
    deviation: Floats32
    common: Floats32


class CellsLight(NamedTuple):
    """The light of samples of cells, (4, C) each, as `camctl.pictures.chroma_light` has it.

    Attributes:
        light, deviation: of them, without what frames have in common
        common: standard deviation of that
        scatter: of the frames, and what noise makes of it, (2, 4, C)
    """

    light: Floats32
    deviation: Floats32
    common: Floats32
    scatter: Floats32


class SeenFrame(NamedTuple):
    """Samples of a frame beside the light that is known.

    Attributes:
        sample: their light, (4, C) or (S,)
        noise: variance of it at the known light
        error: standard deviation of the error that frames have in common, as light
        dim: that in levels, and how many levels are left to white; None: none may be darkened
        saturated: which of them may be saturated
        unseen: which of them this or another colour may hide; None: none
        least_error: of those that saturation may make darker, as light; None: there are none
        full: light that just saturates the frame
    """

    sample: Floats32
    noise: Floats32
    error: Floats32
    dim: tuple[NDArray[Any], NDArray[Any]] | None
    saturated: NDArray[np.bool_]
    unseen: NDArray[np.bool_] | None
    least_error: Floats32 | None
    full: np.float32


class JoinedFrames:
    """What frames add to the light of samples, from the shortest frame to the longest.

    Attributes:
        above, weights: sums of weight x light, and of weights
        own, shared: what noise, and errors in common, add to the variance and the deviation of both
        more: what the errors of samples that saturation may make darker add besides
        squares, count: weighted squares of the light, and what is expected of them
    """

    def __init__(self, shape: tuple[int, ...], *, is_last: bool) -> None:
        self.above, self.weights, self.own, self.shared, self.more, self.squares, self.count = (
            np.zeros((7, *shape), np.float32)
        )
        self._least: Any = None  # light that there is at least; nothing yet
        self._is_last = is_last  # of the rounds: no other one needs the last three sums

    def add(self, frame: SeenFrame, counts: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Add those samples of a frame that count beside shorter frames, and return which they are.

        Args:
            frame: the next longer one
            counts: which of its samples are seen
        """
        sample, both = frame.sample, frame.noise + np.square(frame.error)
        # Nothing is known, and these are not numbers, before the first frame that counts.
        mean = self.above / self.weights
        bright = mean > frame.full / 4
        if frame.dim is not None or bright.any():  # else no frame is darker than the mean
            counts &= (self.weights > 0) | ~frame.saturated
            known = np.sqrt(self.own + np.square(self.shared)) / self.weights
            counts &= ~(mean - REACH * known > frame.full)
            spread = np.sqrt(np.square(known) + both)
            counts &= ~((sample < mean - REACH * spread) & bright)
        # What may be saturated says how much light there is at least, and so do longer ones.
        if self._least is not None or frame.unseen is not None:
            reached = REACH * np.sqrt(both)
            least = np.float32(0) if self._least is None else self._least
            counts &= ~(sample + reached < least)
            if frame.unseen is not None:
                self._least = np.maximum(least, (sample - reached) * frame.unseen)
        weight = np.asarray(counts / both, np.float32)
        if frame.dim is not None:
            levels, below = frame.dim
            others = (mean, known, spread, sample, frame.error, below, levels)
            _lessen(weight, counts & frame.saturated, others, frame.full)
        weighted = weight * sample
        self.above += weighted
        self.own += np.square(weight) * frame.noise
        self.shared += weight * frame.error
        self.weights += weight
        if self._is_last:
            self.squares += weighted * sample
            self.count += weight * both
            if frame.least_error is not None:
                self.more += weight * np.maximum(frame.least_error - frame.error, 0)
        return counts


def _lessen(
    weight: Floats32, chosen: NDArray[np.bool_], shown: Sequence[NDArray[Any]], saturates: Any
) -> None:
    """Multiply weights of chosen samples by the chance that they are seen; see there for the rest.

    What is `shown` may be that of cells, (C,), for samples (4, C).
    """
    some = np.flatnonzero(chosen)
    if some.size:
        cells = some % weight.shape[-1]
        here = [each.ravel().take(some if each.size == weight.size else cells) for each in shown]
        weight.ravel()[some] *= _chance_of_seeing(here, saturates)


def _chance_of_seeing(shown: Sequence[NDArray[Any]], saturates: np.float32) -> NDArray[Any]:
    """Return the probability that samples are not saturated and then made darker by their file.

    These are the likelihoods of both for what other frames show, a normal variable.

    Args:
        shown: light that other frames show, its standard deviation, that of its difference from
            the samples; light of these, and the errors of their colours as light; how many levels
            they are below saturation, and the errors of their colours as levels
        saturates: light that saturates them
    """
    mean, known, spread, sample, error, below, levels = shown
    is_above = normal_cdf(((mean - saturates) / known).astype(np.float64))
    exponent = (np.square((sample - mean) / spread) - np.square(below / levels)) / 2
    is_saturated = is_above * np.exp(np.minimum(exponent, _LARGEST_EXPONENT)) * spread
    # Where levels coincide, no error of colours is a difference of light.
    either = np.where(error > 0, error + is_saturated, 1)
    return np.asarray(error / either, np.float32)
