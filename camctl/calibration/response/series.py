"""An exposure series, reduced frame by frame to what the estimate of a response needs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.light import check_size
from camctl.calibration.limits import DIM, LEAST_PATCHES
from camctl.calibration.response.matches import INDEPENDENT, guess_exposures, neighbour_steps
from camctl.calibration.response.spill import SampleGrid, grid_counts
from camctl.errors import UsageError
from camctl.evidence.patches import Patches, sample_patches
from camctl.evidence.shown_levels import level_finding, saturation_level
from camctl.evidence.unknown_response import moved_samples
from camctl.findings import Finding
from camctl.interface.controls import Layout
from camctl.model.quantiles import median
from camctl.model.response.camera import FloatArray, linear_response, phase_of_black
from camctl.model.sensor import CLIPPING_SIGMAS, SensorModel
from camctl.system.picture_operations import level_counts, plane_by_plane

#: Levels at which a response is estimated, evenly spread, and of how many first ones at all.
_LEVELS, _FIRST_LEVELS = 4096, 256
#: A level has this share of the pixels of a frame, and this many times the mean of the levels
#: below it, where the frame is clipped there.
_CLIPPED_SHARE, _CLIPPED_EXCESS, _LEVELS_BELOW = 2e-3, 8.0, 16
#: Samples of a colour that are counted of a large frame: which ones they are adds less than a
#: quarter to the variance of their number, which matches state.
_MOST_COUNTED = 4 * INDEPENDENT
#: Share of the patches that are the darkest.
_DARK_SHARE = 0.02
#: Share of a picture of which samples are subtracted from those of all pixels where it moved; where
#: more moved, the rest of the grid is counted.
_LITTLE = 0.1
#: Bands of brightness, of a factor of 1.5 in 8 bits; median over quartile of the variances of the
#: patches in one that are noise alone: 1.22 by chi-squared of 25 degrees of freedom, as many as the
#: 48 second differences of a patch have; texture makes it 1.4 to 500.
_BANDS, _NOISE_ALONE = 15, 1.3
#: Black levels that are looked for, as shares of full scale: cameras have 1/64 to 1/16.
_LEAST_BLACK, _MOST_BLACK = 1 / 128, 1 / 8


class Neighbours(NamedTuple):
    """Patches of two frames of neighbouring exposure.

    Attributes:
        short, long: positions of the frames
        levels: (2, patches, samples) brightness above black in both
    """

    short: int
    long: int
    levels: NDArray[np.intp]


@dataclass(eq=False)
class Series:
    """Frames of one scene and one camera mode with different exposures.

    Attributes:
        layout: pixel layout
        bits: bit depth of a sample
        black: brightness without light, DN
        white: brightness from which a sample is saturated, DN
        phase: of the quantiser: 0 truncates, 1/2 rounds
        levels_are_stated: black and white are known; else `find_limits` looks for them
        exposures_are_stated: the exposures are known, at least roughly; else `guess_exposures`
            replaces them
        is_shot: camctl has shot the frames itself: no file or label of the user's can be wrong
        has_measured_exposures: whether the exposures are from the camera's profile
        names: of the frames in messages
        exposures: of the frames, in any common unit
        patches: of each frame: (patches, samples), channel by channel as `Layout.planes`
        findings: what differs from what was stated
    """

    layout: Layout
    bits: int
    black: int = 0
    white: int = 0
    phase: float = 0.0
    levels_are_stated: bool = False
    exposures_are_stated: bool = True
    is_shot: bool = False
    has_measured_exposures: bool = False
    names: list[str] = field(default_factory=list)
    exposures: list[float] = field(default_factory=list)
    patches: list[Patches] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    _counts: list[dict[str, NDArray[np.int64]]] = field(default_factory=list)
    _grids: list[SampleGrid] = field(default_factory=list)
    _moved: dict[int, NDArray[np.bool_]] = field(default_factory=dict)
    _shape: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        self.white = self.white or 2**self.bits - 1

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the frames, (rows, columns) or (rows, columns, 3); empty before the first."""
        return self._shape

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels: Y, or R, G and B."""
        return ("Y",) if self.layout is Layout.MONO else ("R", "G", "B")

    def colours(self) -> str:
        """Return the channel of each plane of `Layout.planes`, one letter each."""
        return {Layout.MONO: "Y", Layout.RGB: "RGB"}.get(self.layout, self.layout.upper())

    def add(self, pixels: NDArray[Any], exposure: float, name: str) -> None:
        """Add a frame; its pixels are not kept.

        Raises:
            UsageError: the exposure is not positive and finite
            DataError: the frame has another size than the first one
        """
        if not (math.isfinite(exposure) and exposure > 0):
            raise UsageError(f"invalid exposure {exposure} of {name}: expected a positive number")
        if self.names:
            check_size(pixels.shape, self._shape, name, self.names[0])
        self._shape = pixels.shape
        counts = {channel: np.zeros(2**self.bits, np.int64) for channel in self.channels}
        pixels = plane_by_plane(pixels)
        planes = self.layout.planes(pixels)
        for letter, plane in zip(self.colours(), planes, strict=True):
            counts[letter] += level_counts(_counted(plane), 2**self.bits)
        self._counts.append(counts)
        self._grids.append(SampleGrid.of(pixels, self.layout))
        self.patches.append(sample_patches(planes, 2**self.bits - 1))
        self.names.append(name)
        self.exposures.append(exposure)

    def counts_between(self, channel: str, edges: FloatArray) -> NDArray[np.int64]:
        """Return the pixels of each frame below, between and from edges, (frames, edges + 1)."""
        places = np.concatenate([[0], edges.astype(np.intp)])
        return np.array([np.add.reduceat(counts[channel], places) for counts in self._counts])

    def counts_of_pair(
        self, channel: str, edges: FloatArray, pair: tuple[int, int], *, spill: bool = True
    ) -> NDArray[np.int64]:
        """Return the like of two frames, (2, edges + 1), without what moved between them.

        Args:
            channel: its name
            edges: ascending levels, DN
            pair: the frames
            spill: False: also without samples near saturated ones
        """
        found = [self._moved[k] for k in pair if k in self._moved]
        moved = reduce(np.logical_or, found) if found else None
        places = np.concatenate([[0], edges.astype(np.intp)])
        whole = np.array([np.add.reduceat(self._counts[k][channel], places) for k in pair])
        if spill and moved is None:
            return whole
        colours = [k for k, letter in enumerate(self.colours()) if letter == channel]
        frames = [self._grids[k] for k in pair]
        below = None if spill else self.white
        if spill and moved is not None and np.count_nonzero(moved) < _LITTLE * moved.size:
            inside = grid_counts(frames, colours, places, moved=~moved)
            scale = whole[0].sum() / sum(self._grids[0].planes[k].size for k in colours)
            left: NDArray[np.int64] = np.rint(whole - scale * inside).astype(np.int64)
            return np.maximum(left, 0)
        return grid_counts(frames, colours, places, below=below, moved=moved)

    def find_moved(self) -> None:
        """Find what moved between frames, so that `counts_of_pair` leaves it out.

        Frames of neighbouring exposure are compared.  A frame of which samples contradict another
        one is not compared in them with any: beside a third one the thing that moved may look as if
        it belonged to the scene.
        """
        self._moved.clear()
        for pair in pairwise(np.argsort(self.exposures, kind="stable").tolist()):
            short, long = (self._grids[frame].planes for frame in pair)
            if (moved := moved_samples(short, long, self.black, self.white)) is not None:
                for frame in pair:
                    self._moved[frame] = self._moved.get(frame, np.zeros_like(moved)) | moved

    def forget_moved(self) -> None:
        """Count what moved, too."""
        self._moved.clear()

    @property
    def moved_share(self) -> float:
        """The largest share of a frame in which something moved before it or after it."""
        return max((float(each.mean()) for each in self._moved.values()), default=0.0)

    @property
    def edges(self) -> FloatArray:
        """Levels above black at which a response is estimated, ascending, (K,); the last is M."""
        levels = self.white - self.black
        first = np.arange(1.0, min(levels, _FIRST_LEVELS) + 1)
        return np.unique(np.concatenate([first, np.round(np.linspace(1, levels, _LEVELS))]))

    @property
    def highest(self) -> int:
        """The largest brightness that is certainly not saturated, DN; of no known response."""
        levels = linear_response(self.bits, levels=self.white - self.black)
        return SensorModel(levels, self.black).highest(None)

    def neighbours(self, channel: str, darkest: float = DIM) -> Iterator[Neighbours]:
        """Yield the patches of a channel that two frames of neighbouring exposure expose well.

        Their samples are not saturated, and their means above the share `darkest` of full scale.
        """
        order = np.argsort(self.exposures, kind="stable").tolist()
        for short, long in pairwise(order):
            patches = np.stack([self.channel_patches(k, channel) for k in (short, long)])
            levels = patches.astype(np.intp) - self.black
            used = levels.mean(axis=2) > darkest * (self.white - self.black)
            used &= patches.max(axis=2) <= self.highest
            yield Neighbours(short, long, np.maximum(levels[:, used.all(axis=0)], 0))

    def darkest(self, channel: str) -> float:
        """Return the least level that noise does not clip at black, above which histograms hold.

        Below it, more samples of a level come from lighter places than the other way round.  The
        noise is the second difference of neighbouring samples, in patches that show noise alone.
        """
        every = np.concatenate(
            [self.channel_patches(k, channel) for k in range(len(self.exposures))]
        )
        side = math.isqrt(every.shape[1])
        if self.black or side < 3:
            return 0.0
        levels = every.reshape(len(every), -1, side).astype(np.float32)
        # Its variance is 1 + 4 + 1 times that of a sample.
        bends = levels[..., 2:] - 2 * levels[..., 1:-1] + levels[..., :-2]
        variance = np.einsum("prs,prs->p", bends, bends) / (6 * bends[0].size)
        mean = every.mean(axis=1) - self.black
        edges = np.geomspace(1, self.white - self.black, _BANDS)
        band = np.searchsorted(edges, mean, side="right")
        is_clipped = False
        for place in range(1, _BANDS):
            members = band == place
            if np.count_nonzero(members) >= LEAST_PATCHES:
                quarter, half = np.quantile(variance[members], (0.25, 0.5))
                middle = median(mean[members])
                is_noise = half <= _NOISE_ALONE * quarter
                if not is_noise or CLIPPING_SIGMAS * math.sqrt(quarter) < middle:
                    return middle if is_clipped else 0.0
                is_clipped = True
        return 0.0

    def channel_patches(self, position: int, channel: str) -> Patches:
        """Return the patches of one channel of a frame."""
        parts = np.split(self.patches[position], len(self.colours()))
        used = [
            part for letter, part in zip(self.colours(), parts, strict=True) if letter == channel
        ]
        return np.concatenate(used)

    def find_limits(self) -> None:
        """Find the black level and the white level in the frames, where they are not stated.

        Where the darkest patches hardly change with the exposure, what they have at exposure 0 is
        the black level.  A brightness that many pixels have and none exceeds is the white level.
        """
        if self.levels_are_stated:
            return
        if not self.exposures_are_stated and len(self.exposures) > 1:
            self.guess_exposures()
        order = np.argsort(self.exposures)
        if self.black == 0 and len(order) > 1:
            black = self._dark_level(order.tolist())
            if _LEAST_BLACK <= black / self.white <= _MOST_BLACK:
                self.findings.append(level_finding("black", round(black), self.black))
                self.black = round(black)
                self.phase = phase_of_black(self.black)
        found = self._clipped_level()
        if found is not None and self.black < found < self.white:
            self.findings.append(level_finding("white", found, self.white))
            self.white = found

    def find_saturation(self) -> None:
        """Find the brightness at which frames of linear response saturate, if it is below white."""
        levels = self.white - self.black
        response = linear_response(self.bits, phase=self.phase, levels=levels)
        found = saturation_level(self.patches, self.exposures, response, self.black, self.white)
        if found is not None:
            self.findings.append(level_finding("white", found, self.white))
            self.white = found

    def guess_exposures(self) -> None:
        """Replace the exposures by guesses from the pixels, about as if the response were sRGB.

        Raises:
            DataError: two frames have too little in common
        """
        self.exposures = guess_exposures(*self._counts_of_levels()).tolist()

    def connected(self) -> list[int]:
        """Return the positions of the most frames whose neighbours share brightness levels.

        They are in the order of their brightness, the darkest first.
        """
        runs: list[list[int]] = []
        for dark, bright, step in neighbour_steps(*self._counts_of_levels()):
            runs = runs or [[dark]]
            runs = [*runs, [bright]] if step is None else [*runs[:-1], [*runs[-1], bright]]
        return max(runs, key=len, default=[0])

    def part(self, positions: Sequence[int]) -> Series:
        """Return a series of some of the frames, without findings."""

        def chosen(values: list[Any]) -> list[Any]:
            return [values[k] for k in positions]

        return replace(
            self,
            names=chosen(self.names),
            exposures=chosen(self.exposures),
            patches=chosen(self.patches),
            findings=[],
            _counts=chosen(self._counts),
            _grids=chosen(self._grids),
            _moved={},
        )

    def _counts_of_levels(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the samples of all channels of each frame at each level, and the levels."""
        edges = np.arange(1.0, self.white - self.black + 1)
        counts = [self.counts_between(name, self.black + edges) for name in self.channels]
        return np.asarray(np.sum(counts, axis=0)), edges

    def _dark_level(self, order: Sequence[int]) -> float:
        """Return the brightness that the darkest patches have at exposure 0; 0 where unknown."""
        means = np.array([self.patches[k].mean(axis=1) for k in order])
        darkest = np.argsort(means.mean(axis=0))[: max(8, int(_DARK_SHARE * means.shape[1]))]
        levels = means[:, darkest].mean(axis=1)
        ratios = np.array(self.exposures)[list(order)] / self.exposures[order[0]]
        near = ratios <= 16
        if np.count_nonzero(near) < 2 or ratios[near][-1] < 2:
            return 0.0
        slope, start = np.polyfit(ratios[near], levels[near], 1)
        # The toe is a line from the black level; where light dominates, nothing is known.
        return float(start) if slope * ratios[near][-1] < start else 0.0

    def _clipped_level(self) -> int | None:
        """Return the brightness that many pixels have and none exceeds; None if there is none."""
        total = sum(counts[channel] for counts in self._counts for channel in self.channels)
        assert not isinstance(total, int)
        top = int(np.flatnonzero(total)[-1])
        below = total[max(0, top - _LEVELS_BELOW) : top]
        is_pile = total[top] >= _CLIPPED_EXCESS * max(1.0, float(below.mean() if below.size else 0))
        return top if is_pile and total[top] >= _CLIPPED_SHARE * total.sum() else None


def _counted(plane: NDArray[Any]) -> NDArray[Any]:
    """Return the rows of a plane of which the samples are counted, evenly spread.

    Their step is odd, so that they are as many of each row of the blocks of a JPEG file: its first
    rows alone, at quality 90, have numbers of levels wrong by four standard deviations.
    """
    return plane[:: max(0, plane.size // _MOST_COUNTED - 1) | 1]
