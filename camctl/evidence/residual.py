"""The normalised residual between two frames of different exposure.

The brightness of the longer frame predicts the light of the shorter one, with a variance.  The
residual is what the shorter frame shows beyond it, over the standard deviation: of a single sample
and of the mean of 5 x 5, in which noise averages out and what neighbours share does not.

Where the noise is known, the sensor model predicts the variance; one factor for the variance of
samples and one for the variance of means hold what it lacks (lag, rows that differ).  Where it is
unknown, as for photographs, variance and mean error are measured as functions of brightness in
patches at rest: parts that `camctl.evidence.unknown_response` finds are left out, and others lose
their weight by iterated trimming.  Photographs have errors at edges besides: see
`camctl.evidence.edges`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import has_few_chroma_samples
from camctl.evidence.edges import Ranges, edge_levels, mixed_colours, ranges_at
from camctl.evidence.patch_errors import (
    LEAST_PATCHES,
    MEAN_SAMPLES,
    PatchErrors,
    fitted_model,
    fitted_tables,
)
from camctl.evidence.patches import Patches
from camctl.evidence.unknown_response import moved_patches
from camctl.interface.camera import Pixels
from camctl.model.noise import FrameNoise
from camctl.model.sensor import (
    CLIPPING_SIGMAS,
    JPEG_BLOCK_ERROR,
    RESPONSE_ERROR,
    SensorModel,
)
from camctl.system.picture_operations import opencv

FrameRows = Callable[[int, slice], Pixels]
"""Returns some rows of a frame by its position, black included."""
_Floats = NDArray[np.float64]
_Places = tuple[NDArray[np.intp], ...]


@dataclass(frozen=True)
class Side:
    """One of two frames that are compared.

    Attributes:
        position: of the frame in the capture
        exposure: relative to the shortest frame
        noise: of the frame; None where it is unknown
    """

    position: int
    exposure: float
    noise: FrameNoise | None


@dataclass(frozen=True, eq=False)
class Tables:
    """The prediction by the brightness of the longer frame, (colours, white + 1) each.

    Attributes:
        mean: light of the shorter frame
        sample: standard deviation of a sample
        square: standard deviation of the mean of 5 x 5, times 5: as if it were of a sample
        skewness: of a sample
    """

    mean: _Floats
    sample: _Floats
    square: _Floats
    skewness: _Floats


@dataclass(frozen=True, eq=False)
class Pair:
    """A shorter and a longer exposure.

    Args:
        sensor: light of each brightness
        short, long: the frames
        ratio: of the light in the longer frame to that in the shorter one, as most patches show
        samples: patches of both frames, colour by colour
        colours: of a pixel, 1 or 3: planes that may differ where the noise is unknown
        few_chroma_samples: as in `camctl.pictures.frame_light.frame_light`
    """

    sensor: SensorModel
    short: Side
    long: Side
    ratio: float
    samples: tuple[Patches, Patches]
    colours: int = 1
    few_chroma_samples: bool = False

    @property
    def is_known(self) -> bool:
        """Whether the noise of both frames is known."""
        return self.short.noise is not None and self.long.noise is not None

    @property
    def is_processed(self) -> bool:
        """Whether a program made the frames: pixels have three colours, and unknown noise."""
        return self.colours > 1 and not self.is_known

    @cached_property
    def saturated(self) -> int:
        """Brightness from which samples of the longer frame may be saturated ones."""
        return self.sensor.highest(self.long.noise) + 1

    @cached_property
    def is_measured(self) -> bool:
        """Whether the variance is known, or enough patches at rest have shown it."""
        return self.is_known or all(part.size >= LEAST_PATCHES for part in self._parts)

    @cached_property
    def tables(self) -> Tables:
        """Mean and standard deviations, fitted to the patches at rest."""
        prediction = self.sensor.neighbour(self.ratio, self.short.noise, self.long.noise)
        fit = fitted_model if self.is_known else fitted_tables
        fits = [fit(part, prediction) for part in self._parts]
        fits = fits * (self.colours // len(fits))
        mean, own, shared, skewness = (
            np.stack(tables)
            for tables in zip(
                *((each.mean, each.own, each.shared, each.skewness) for each in fits), strict=True
            )
        )
        shared = shared + np.square([[each.black_error] for each in fits])
        if self.is_processed:
            block = JPEG_BLOCK_ERROR / 255 * self.sensor.white * self.sensor.step(mean)
            shared = np.maximum(shared, np.square(block))
        shared = shared + np.square(RESPONSE_ERROR * mean)
        squares = own + MEAN_SAMPLES * shared
        for table in (mean, own, shared, squares):  # of saturated samples: at least
            table[:, self.saturated :] = table[:, [self.saturated - 1]]
        return Tables(mean, np.sqrt(own + shared), np.sqrt(squares), skewness)

    @cached_property
    def _parts(self) -> list[PatchErrors]:
        """Patches in range in both frames: of all colours together if the noise is known."""
        prediction = self.sensor.neighbour(self.ratio, self.short.noise, self.long.noise)
        before, after = self.samples
        count = 1 if self.is_known else self.colours
        rests = np.ones(len(before), np.bool_)
        if not self.is_known:
            sensor = self.sensor
            rests = ~moved_patches(before, after, self.colours, sensor.black, sensor.white)
        return [
            PatchErrors.of(self.sensor, prediction, (self.saturated,) * 2, *each)
            for each in zip(
                *(np.array_split(a, count) for a in (before, after, rests)), strict=True
            )
        ]

    @cached_property
    def lights(self) -> _Floats:
        """Light by the brightness of the shorter frame, (colours, white + 1).

        Files have errors of what saturated the longer frame, too: it is no farther from what that
        shows than white is.
        """
        found = np.tile(self.sensor.light, (len(self.tables.mean), 1))
        return np.minimum(found, self._white) if self.is_processed else found

    @cached_property
    def _white(self) -> _Floats:
        """Light that white in the longer frame shows, (colours, 1)."""
        return np.asarray(self.tables.mean.max(axis=1, keepdims=True))

    @cached_property
    def clipped(self) -> _Floats:
        """What saturation clips off in the longer frame, levels of the shorter one, like `lights`.

        Responses are about powers of the light.  Files with all samples of colours mix none of it.
        """
        few = self.few_chroma_samples or has_few_chroma_samples(self.samples, self.saturated - 1)
        codes = np.arange(self.sensor.white + 1) * few
        most = np.interp(self._white, self.sensor.light, codes)
        return np.maximum(codes - most, 0.0)

    def codes(
        self, places: _Places, short: Pixels, long: Pixels
    ) -> tuple[NDArray[np.intp], tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Return brightness of samples in the shorter frame, and the place in tables of each."""
        colour = places[2] if len(self.tables.mean) > 1 else np.zeros_like(places[0])
        before, after = (
            np.minimum(each[places], self.sensor.white).astype(np.intp) for each in (short, long)
        )
        return before, (colour, after)

    def beyond_edges(
        self,
        sigmas: float,
        sizes: _Floats,
        deviations: _Floats,
        places: _Places,
        short: Pixels,
        long: Pixels,
        ranges: Ranges,
        *,
        samples: int = 1,
        has_neighbours: bool = True,
    ) -> tuple[NDArray[np.intp], _Floats]:
        """Return which residuals of photographs errors at edges leave, and their sizes then.

        Args:
            sigmas: size from which on residuals contradict
            sizes: of residuals, in standard deviations, (N,)
            deviations: these, light
            places: of them in a part of the frames
            short: brightness of the part in the shorter frame
            long: in the longer one
            ranges: of brightness around each
            samples: on the side of the square that each is the mean of
            has_neighbours: whether pixels of the part are neighbours in the frame
        """
        before, after = self.codes(places, short, long)
        steps = samples * self._edge_steps(before, after)
        levels = edge_levels(ranges, self.sensor.white)
        found = sizes * (deviations / np.hypot(deviations, levels * steps))
        used = np.flatnonzero(found > sigmas)
        if has_neighbours and used.size and self.clipped[:, short.max()].any():
            some = tuple(each[used] for each in places)
            more = np.hypot(levels[used], mixed_colours(self.clipped, short, some))
            deviations = deviations[used]
            left = sizes[used] * (deviations / np.hypot(deviations, more * steps[used]))
            found[used], used = left, used[left > sigmas]
        return used, found[used]

    def _edge_steps(self, before: NDArray[np.intp], after: tuple[NDArray[np.intp], ...]) -> _Floats:
        """Return the light of one level of error at edges.

        Both frames have errors, but where the shorter one shows more than saturates the longer one,
        that of the longer one alone counts.
        """
        mean, steps = self.tables.mean[after], self.sensor.step(self.tables.mean[after])
        beyond = self.sensor.light[before] - mean
        share = (self.lights[after[0], before] - mean) / np.where(beyond > 0, beyond, np.inf)
        own = np.gradient(self.tables.mean, axis=1)[after]
        is_less = self.sensor.light[before] > self.lights[after[0], before]
        return np.where(is_less, np.minimum(steps, np.maximum(own, share * steps)), steps)

    def limits(self, sigmas: float) -> Limits:
        """Return the brightness that holds the light within `sigmas` standard deviations.

        Where the longer frame is saturated there is no largest brightness.
        """
        white, tables, light = self.sensor.white, self.tables, self.sensor.light
        # Few photons are more often many more than their mean than a normal variable is (Cornish
        # and Fisher, 1938).
        beyond = sigmas + (sigmas**2 - 1) / 6 * tables.skewness
        low = np.searchsorted(light, tables.mean - sigmas * tables.sample)
        high = np.searchsorted(light, tables.mean + beyond * tables.sample, side="right") - 1
        if not self.is_measured:
            low[:], high[:] = 0, white
        if self.is_processed:
            high[light[high] >= self._white] = white
        high[:, self.saturated :] = white
        least, most = (np.clip(each, 0, white).astype(np.uint16) for each in (low, high))
        return Limits(least, np.maximum(most, least), self, sigmas)

    @property
    def contradicting(self) -> float:
        """Share of the samples of the patches that contradict: by noise alone 1 of 500."""
        parts = [np.array_split(each, self.colours) for each in self.samples]
        limits = self.limits(CLIPPING_SIGMAS)
        found = [
            (before < limits.low[k][after]) | (before > limits.high[k][after])
            for k, (before, after) in enumerate(zip(*parts, strict=True))
        ]
        return float(np.mean(np.concatenate(found)))


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of the brightness of the shorter frame.

    Attributes:
        low, high: least and largest one by the brightness of the longer frame, (colours, white + 1)
        pair: of frames
        sigmas: standard deviations that they are away from the mean
    """

    low: NDArray[np.uint16]
    high: NDArray[np.uint16]
    pair: Pair
    sigmas: float

    def outside(
        self,
        short: Pixels,
        long: Pixels,
        ranges: Ranges | None = None,
        first: tuple[int, int] = (0, 0),
        every: tuple[int, int] | None = None,
    ) -> NDArray[np.bool_]:
        """Return which samples of a shorter exposure contradict the longer one.

        Args:
            short: brightness, (rows, columns) or (rows, columns, colours)
            long: likewise, of the same shape
            ranges: `local_ranges` of the longer frame, for limits at edges
            first: row and column of the frame where they begin
            every: distance of their rows and of their columns in it; None: they are neighbours
        """
        found = outside_limits(self.low, self.high, short, long)
        if ranges is not None:
            self.leave_out_edges(found, short, long, ranges, first, every)
        return found

    def leave_out_edges(
        self,
        found: NDArray[np.bool_],
        short: Pixels,
        long: Pixels,
        ranges: Ranges,
        first: tuple[int, int],
        every: tuple[int, int] | None = None,
    ) -> None:
        """Leave out of `found`, samples outside limits, those that errors at edges explain."""
        places = np.unravel_index(np.flatnonzero(found), found.shape)
        if places[0].size:
            around = ranges_at(ranges, places, first, every or (1, 1))
            found[places] = self._outside_edges(
                places, short, long, around, has_neighbours=every is None
            )

    def outside_at(
        self,
        places: _Places,
        short: Pixels,
        long: Pixels,
        ranges: Ranges | None,
        first: tuple[int, int],
    ) -> NDArray[np.bool_]:
        """Return which of some samples, (N,), contradict.

        Args:
            places: of the samples in their part of the frame
            short: brightness of the part in the shorter frame
            long: in the longer one
            ranges: `local_ranges` of the longer frame, for limits at edges
            first: row and column of the frame where the part begins
        """
        before, after = self.pair.codes(places, short, long)
        found = (before < self.low[after]) | (before > self.high[after])
        if ranges is not None and found.any():
            some = tuple(each[found] for each in places)
            around = ranges_at(ranges, some, first)
            found[found] = self._outside_edges(some, short, long, around, has_neighbours=True)
        return np.asarray(found)

    def _outside_edges(
        self, places: _Places, short: Pixels, long: Pixels, ranges: Ranges, *, has_neighbours: bool
    ) -> NDArray[np.bool_]:
        """Return which samples, (N,), contradict with these ranges of brightness around them."""
        pair = self.pair
        before, after = pair.codes(places, short, long)
        sample = pair.tables.sample[after]
        sizes = np.abs(pair.lights[after[0], before] - pair.tables.mean[after]) / sample
        used = np.zeros(sizes.size, np.bool_)
        left, _ = pair.beyond_edges(
            self.sigmas, sizes, sample, places, short, long, ranges, has_neighbours=has_neighbours
        )
        used[left] = True
        return used


def outside_limits(
    low: NDArray[np.uint16], high: NDArray[np.uint16], short: Pixels, long: Pixels
) -> NDArray[np.bool_]:
    """Return which samples are outside of limits, (colours, white + 1) each."""
    if short.dtype == long.dtype == np.uint8 and (cv2 := opencv()) is not None:
        # Five times as fast.  What is below the least brightness wraps to a large one; what is
        # above white counts as white.
        white = low.shape[1] - 1
        codes = np.minimum(np.arange(256), white)
        low, high = low[:, codes], np.where(high == white, 255, high)[:, codes]
        least, span = low.astype(np.uint8), (high - low).astype(np.uint8)
        # Tables that differ from channel to channel are slower than planes.
        planes = [[short], [long]] if len(low) == 1 else [cv2.split(short), cv2.split(long)]
        found = []
        for before, after, *tables in zip(*planes, least, span, strict=True):
            lowest, widest = (cv2.LUT(after, table) for table in tables)
            np.subtract(before, lowest, out=lowest)
            found.append(np.greater(lowest, widest, out=widest.view(np.bool_)))
        if len(found) == 1:
            return np.asarray(found[0])
        return np.asarray(cv2.merge([each.view(np.uint8) for each in found])).view(np.bool_)
    short, long = (np.minimum(each, low.shape[1] - 1) for each in (short, long))
    if len(low) == 1:
        return np.asarray((short < low[0][long]) | (short > high[0][long]))
    parts = (
        outside_limits(low[[k]], high[[k]], short[..., k], long[..., k]) for k in range(len(low))
    )
    return np.stack(list(parts), axis=-1)
