"""The light of frames, estimated from all of them, and what its noise is known from.

Samples of a frame that have one response and one noise are a part.  Colours that a program
developed have their own noise by its white balance; samples of a mosaic have not.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import (
    ROUNDING,
    has_few_chroma_samples,
    patch_chroma_variance,
)
from camctl.evidence.lost_detail import LEVELS, LostDetail, Steps, colour_rounding, file_steps
from camctl.evidence.noise import NoiseFit
from camctl.evidence.part_noise import file_details, file_roundings, fit_parts, noise_contrast
from camctl.evidence.patch_noise import electrons_per_level
from camctl.evidence.patches import SIDE, Patches
from camctl.interface.controls import Layout
from camctl.model.block_rounding import BlockRounding
from camctl.model.distribution import most_read_noise
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import posterior_of
from camctl.model.light import Floats32, LightTables, is_certain, light_tables
from camctl.model.light_memory import Estimate, LightMemory
from camctl.model.noise import FrameNoise
from camctl.model.plain_light import SAMPLES_WORTH_LOADING, plain_light
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.model.sensor import CLIPPING_SIGMAS, JPEG_ERROR, SensorModel
from camctl.model.step_posterior import FrameSet
from camctl.pictures.chroma_light import NOTABLE, light_of_colours
from camctl.pictures.mosaic import LETTERS, colour_of, new_planes
from camctl.system.picture_operations import plane_by_plane

#: Standard deviations that are more uncertain than by this share are not stated: their intervals
#: of 95 % hold 92 to 97 % of the errors.
_MOST_UNCERTAIN = 0.1

#: Electrons at full scale of the photon noise that stands for an unknown noise: as many samples are
#: near saturation with it as `SensorModel.highest` leaves out without a known noise.
_STAND_IN_E = (CLIPPING_SIGMAS / JPEG_ERROR) ** 2

#: Of the samples of a patch every so many-th shows how exact the light is: 40,000 of a picture.
_EVERY = 8

#: Errors that the compression of a file adds where there is contrast, levels, and what it makes of
#: noise.
_Compressed: TypeAlias = tuple[float, BlockRounding | None]


@dataclass(frozen=True, eq=False)
class Estimator:
    """What estimates the light of the samples of a part.

    Attributes:
        estimate: does that
        light: some lights, ascending, irradiance at exposure 1
        deviation: of an estimate at each of them; NaN where it is not known
        gain: the standard deviation of the sum's light over `deviation`, likewise
        tables: that it uses; None: of a sum
    """

    estimate: Estimate
    light: NDArray[np.floating[Any]]
    deviation: NDArray[np.floating[Any]]
    gain: NDArray[np.floating[Any]]
    tables: LightTables | None = None


@dataclass(frozen=True, eq=False)
class Part:
    """The samples of a frame that have one response and one noise.

    Attributes:
        view: (rows, columns[, channels]) of a frame to those samples
        response: of the camera
    """

    view: Callable[[NDArray[Any]], NDArray[Any]]
    response: CameraResponse


def parts_of(layout: Layout, responses: Sequence[CameraResponse]) -> list[Part]:
    """Return the parts of frames, in the order of the planes of their layout.

    Args:
        layout: of the frames
        responses: one, or those of R, G and B
    """
    if layout is Layout.RGB:
        of_colours = responses if len(responses) == 3 else [*responses] * 3
        return [
            Part(lambda each, at=at: each[..., at], real)  # type: ignore[misc]
            for at, real in enumerate(of_colours)
        ]
    if len(responses) == 1:
        return [Part(lambda each: each, responses[0])]
    return [
        Part(
            lambda each, row=row, column=column: each[row::2, column::2],  # type: ignore[misc]
            responses[colour_of(layout, row, column)],
        )
        for row in (0, 1)
        for column in (0, 1)
    ]


class Quality(NamedTuple):
    """How exact the light of frames is.

    Attributes:
        gain: the standard deviation of the light that the sum shows over that of the estimate, the
            median of the samples; None where it is not known
        unknown: share of the samples whose noise is not known
    """

    gain: float | None
    unknown: float


@dataclass(frozen=True, eq=False)
class FrameLight:
    """Estimates the light of frames.

    Attributes:
        parts: of a frame, and what estimates their light
        noise: of each frame, for each part; empty where it is not known
        white: brightness at which frames are clipped, DN
        unit: irradiance in the result times this is irradiance at exposure 1
        chroma: what estimates red, green and blue where files lose of these; empty where they are
            not seen to
        details: what such files lose of Y, and of Cb and Cr if they have all samples of these;
            empty where this is not known
        contrast: what noise shows in each of these, see `chroma_variance`
        beside: estimates the light in blocks of files that hold saturated samples; None: frames
            are not from such files
    """

    parts: tuple[tuple[Part, Estimator], ...]
    noise: tuple[tuple[FrameNoise, ...], ...]
    white: int
    unit: float
    chroma: tuple[LightTables, ...] = ()
    details: tuple[tuple[LostDetail, ...], ...] = ()
    contrast: tuple[NDArray[np.float32], ...] = ()
    beside: Estimate | None = None

    def rows(
        self, frames: Sequence[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32]:
        """Return the irradiance and its standard deviation; arrays in the shape of `total`.

        The deviation is infinite where every frame is or may be saturated, NaN where noise is not
        known.

        Args:
            frames: the same rows of each frame, from a multiple of 8 on, black included
            total: sum of the frames, clipped at white
        """
        clipped = [plane_by_plane(each) for each in self._clipped(frames)]
        if self.chroma:
            firsts = [each.of for each in self._memories]
            unknown = [np.isnan(each.deviation) for _, each in self.parts]
            of_files = self.chroma, self.details, self.contrast, unknown
            irradiance, deviation = light_of_colours(clipped, firsts, *of_files)
        else:
            irradiance, deviation = self._by_sample(clipped, total)
        if self.beside is not None:
            places = np.flatnonzero(_beside_saturated(clipped, self.white))
            values = [np.ravel(each)[places] for each in clipped]
            found = self.beside(values, np.ravel(total)[places])
            for whole, each in zip((irradiance, deviation), found, strict=True):
                np.ravel(whole)[places] = each
        irradiance *= np.float32(1 / self.unit)
        deviation *= np.float32(1 / self.unit)
        return irradiance, deviation

    def by_sample(
        self, frames: Sequence[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> Floats32:
        """Return the irradiance that each sample of any part of the frames shows by itself.

        Errors of colours, which those around it show, are left out.
        """
        clipped = [plane_by_plane(each) for each in self._clipped(frames)]
        irradiance, _ = self._by_sample(clipped, total)
        irradiance *= np.float32(1 / self.unit)
        return irradiance

    def _by_sample(
        self, clipped: Sequence[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32]:
        """Return irradiance at exposure 1, and its deviation, of frames that are clipped."""
        both: list[Floats32] = []
        for (part, _), memory in zip(self.parts, self._memories, strict=True):
            *values, sums = (np.ravel(part.view(each)) for each in (*clipped, total))
            found = memory.of(values, sums)
            if len(self.parts) == 1:  # all samples
                return found[0].reshape(total.shape), found[1].reshape(total.shape)
            both = both or [new_planes(total.shape) for _ in range(2)]
            for whole, each in zip(both, found, strict=True):
                view = part.view(whole)
                view[...] = each.reshape(view.shape)
        return both[0], both[1]

    def load(self, samples: int) -> None:
        """Load compiled code where the light of so many samples takes longer without it."""
        if samples >= SAMPLES_WORTH_LOADING and not self.chroma:
            for (_, each), memory in zip(self.parts, self._memories, strict=True):
                if each.tables is not None:
                    memory.plain = plain_light(each.tables, each.deviation)

    @cached_property
    def _memories(self) -> list[LightMemory]:
        """What estimates the light of each part; parts that are alike have one."""
        keeps = not self.chroma  # a mean takes less than to look for it
        memories = {each: LightMemory(each.estimate, keeps=keeps) for _, each in self.parts}
        return [memories[each] for _, each in self.parts]

    def _clipped(self, frames: Sequence[NDArray[Any]]) -> Sequence[NDArray[Any]]:
        """Return frames clipped at white, or as they are where no sample can be above it."""
        dtype = frames[0].dtype
        if self.white >= np.iinfo(dtype).max:
            return frames
        return [np.minimum(each, dtype.type(self.white)) for each in frames]

    @property
    def deviations(self) -> tuple[float, float]:
        """Return the least and the largest finite standard deviation in the result, about."""
        found = np.concatenate([each.deviation for _, each in self.parts]) / self.unit
        found = found[np.isfinite(found)]
        return (float(found.min()), float(found.max())) if found.size else (0.0, 0.0)

    @property
    def least_relative(self) -> float:
        """Return the least standard deviation as a share of the light, 0 where none is known."""
        shares = [
            each.deviation[known] / np.maximum(each.light[known], 1e-300)
            for _, each in self.parts
            if (known := np.isfinite(each.deviation)).any()
        ]
        return float(np.concatenate(shares).min()) if shares else 0.0

    def quality(self, samples: Sequence[Patches]) -> Quality:
        """Return how exact the light is where these patches are, which are all over a frame."""
        of_parts = zip(*(np.array_split(each, len(self.parts)) for each in samples), strict=True)
        gains, unknown, count = [], 0, 0
        for (_, estimator), patches in zip(self.parts, of_parts, strict=True):
            values = [np.ravel(each[:, ::_EVERY]) for each in patches]
            total = np.asarray(np.sum(values, axis=0, dtype=np.uint32))
            light, deviation = estimator.estimate(values, total)
            unknown += int(np.isnan(deviation).sum())
            count += light.size
            places = np.searchsorted(estimator.light, light[np.isfinite(deviation)])
            gains.append(estimator.gain[np.minimum(places, estimator.gain.size - 1)])
        ratios = np.concatenate(gains)
        return Quality(float(np.median(ratios)) if ratios.size else None, unknown / max(1, count))


def _beside_saturated(frames: Sequence[NDArray[Any]], white: int) -> NDArray[np.bool_]:
    """Return which samples are not saturated, but are in a block of a frame with one that is."""
    shape = frames[0].shape
    firsts = [np.arange(0, length, SIDE) for length in shape]
    found = np.zeros(shape, np.bool_)
    for each in frames:
        is_white = each >= white
        rows = np.logical_or.reduceat(is_white, firsts[0], axis=0)
        blocks = np.logical_or.reduceat(rows, firsts[1], axis=1)
        if blocks.any():
            inside = blocks.repeat(SIDE, axis=0).repeat(SIDE, axis=1)[: shape[0], : shape[1]]
            found |= inside & ~is_white
    return found


def frame_light(
    parts: Sequence[Part],
    exposures: Sequence[float],
    noise: Sequence[FrameNoise] | None,
    samples: Sequence[Patches],
    *,
    black: int,
    unit: float,
    gains: Sequence[float] | None = None,
    method: str = "likelihood",
    prior: DesiredResponse | None = None,
    steps: Steps = "measure",
    stated_steps: NDArray[np.float64] | None = None,
    few_chroma_samples: bool = False,
) -> FrameLight:
    """Return what estimates the light of frames.

    Args:
        parts: of a frame
        exposures: of the frames, relative to the shortest
        noise: of each frame; None: it is measured in the patches
        samples: patches of each frame, plane by plane, see `sample_patches`
        black: brightness without light, DN
        unit: irradiance in the result times this is irradiance at exposure 1
        gains: of each frame, linear; None: all are equal
        method: "likelihood", or "sum": the posterior mean after the sum of the frames
        prior: what a sum is inverted with; None: all light is equally probable
        steps: of the frequencies of brightness in the files of the frames, levels; None: there are
            none; "measure": `samples` show them
        stated_steps: those that the files state, where `samples` do not show them; None: none
        few_chroma_samples: whether files state that they have fewer samples of the differences of
            colours than of brightness; where none does, `samples` show whether they have
    """
    gains = gains or [1.0] * len(exposures)
    is_sum = method == "sum" or (noise is not None and all(each.is_none for each in noise))
    plain, least = None, [0.0] * len(parts)
    highest = SensorModel(parts[0].response, black).highest(None)
    is_of_colours = not is_sum and len(parts) == len(LETTERS)
    if is_of_colours and (few_chroma_samples or has_few_chroma_samples(samples, highest)):
        least = ROUNDING.tolist()
        plain = np.all([patch_chroma_variance(each) <= NOTABLE for each in samples], axis=0)
    is_mosaic = len(parts) > 1 and not is_of_colours
    if is_sum or is_mosaic or black + parts[0].response.M != LEVELS - 1:
        steps = None
    if isinstance(steps, str):
        steps = file_steps(samples, len(parts), stated_steps)
    has_all_chroma = is_of_colours and plain is None and steps is not None
    most_rounding: list[float] = []  # with fewer samples of chroma saturation may do more
    if has_all_chroma and steps is not None:
        least, most_rounding = ROUNDING.tolist(), colour_rounding(steps).tolist()
    responses = [each.response for each in parts]
    files = file_roundings(None if has_all_chroma else steps, responses, samples, black)
    fits: list[NoiseFit | None] = [None] * len(parts)
    if noise is None:
        fits = fit_parts(responses, samples, exposures, gains, black, plain, files)
    has_common = has_all_chroma or plain is not None
    found, noises = [], []
    alike: dict[FrameSet, Estimator] = {}
    for at, (part, file, fit) in enumerate(zip(parts, files, fits, strict=True)):
        frames = _frame_set(part.response, black, exposures, noise, fit, gains, (least[at], file))
        is_known = noise is not None or fit is not None
        if is_known and most_rounding:
            frames = replace(frames, most_rounding=most_rounding[at])
        # By theorem 1 of the paper the sum loses nothing where there is no noise.
        if is_sum:
            estimate = _sum(frames, prior, is_known=is_known)
        else:
            estimate = _likelihood(
                frames, fit, gains, is_known=is_known, is_independent=not has_common
            )
        if fit is None:  # parts of one response and noise share what is found of their samples
            estimate = alike.setdefault(frames, estimate)
        found.append((part, estimate))
        if is_known:
            noises.append(frames.noise)
    white = black + parts[0].response.M
    tables = [each.tables for _, each in found if has_common and each.tables is not None]
    details: tuple[tuple[LostDetail, ...], ...] = ()
    if tables and steps is not None:
        details = file_details(tables[1], samples, steps, has_all_chroma=has_all_chroma)
    known = noises[1] if len(noises) == len(LETTERS) else [None] * len(exposures)
    contrast = noise_contrast(tables[1].sensor, known, files[1]) if tables else ()
    beside = None
    if file is not None and is_known and len(parts) == 1:
        noise = tuple(replace(each, file=replace(file, contrast=1.0)) for each in frames.noise)
        edges = replace(frames, noise=noise, beside_saturated=True)
        beside = _likelihood(edges, None, gains, is_known=True, is_independent=False).estimate
    chroma = tuple(tables), details, contrast
    return FrameLight(tuple(found), tuple(noises), white, unit, *chroma, beside)


def _frame_set(
    response: CameraResponse,
    black: int,
    exposures: Sequence[float],
    known: Sequence[FrameNoise] | None,
    fit: NoiseFit | None,
    gains: Sequence[float],
    compressed: _Compressed,
) -> FrameSet:
    """Return the frames with their noise; photon noise stands for one that is not known.

    `compressed` has the least error that the compression of a file adds, levels.
    """
    compression, file = compressed
    if known is None:
        stand_in = response.M / _STAND_IN_E, 0.0
        if fit is None:
            file = None  # what it makes of noise is not known either
        else:
            compression = max(compression, fit.compression_levels)
            file = file and replace(file, contrast=fit.contrast)
        inverse_square = stand_in if fit is None else fit.noise.tolist()
        known = _frame_noise(inverse_square, response, (compression, file), black, gains)
    elif compression or file:
        known = [replace(each, compression_levels=compression, file=file) for each in known]
    return FrameSet(response, black, tuple(exposures), tuple(known))


def _frame_noise(
    noise: Sequence[float],
    response: CameraResponse,
    compressed: _Compressed,
    black: int,
    gains: Sequence[float],
) -> tuple[FrameNoise, ...]:
    inverse, square = noise
    read = math.sqrt(square)
    return tuple(
        FrameNoise(
            electrons_per_level(inverse * gain),
            min(read * gain, most_read_noise(response)),
            black=black,
            compression_levels=compressed[0],
            file=compressed[1],
        )
        for gain in gains
    )


def _likelihood(
    frames: FrameSet,
    fit: NoiseFit | None,
    gains: Sequence[float],
    *,
    is_known: bool,
    is_independent: bool,
) -> Estimator:
    """Return the estimator from all frames.

    Their exact probabilities are those of frames whose errors are independent.  Errors of colours
    of JPEG files are not: dark ones are black in many frames at once, and each one would count.
    """
    tables = light_tables(frames)
    certain = np.full(tables.deviation.shape, is_known)
    if fit is not None:
        compressed = frames.noise[0].compression_levels, frames.noise[0].file
        noises = (
            _frame_noise(each.tolist(), frames.response, compressed, frames.black, gains)
            for each in fit.neighbours
        )
        others = [replace(frames, noise=each) for each in noises]
        certain = is_certain(frames, others, _MOST_UNCERTAIN)
    is_all_certain = bool(certain.all())
    full = np.float32(frames.response.levels[-1])
    top = len(frames.exposures) * tables.sensor.white

    def estimate(
        values: list[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32]:
        E, deviation = tables.mean(values, total)
        if is_independent:
            tables.refine(values, E, deviation)
        if not is_all_certain:
            deviation[~certain.take(tables.bins(E))] = np.nan
        white = total == top
        if white.any():
            E[white], deviation[white] = full, np.inf
        return E, deviation

    known = np.where(certain, tables.deviation, np.nan)
    return Estimator(
        estimate,
        tables.lights,
        known,
        tables.of_sum / tables.deviation,
        tables,
    )


def _sum(frames: FrameSet, prior: DesiredResponse | None, *, is_known: bool) -> Estimator:
    """Return the estimator from the sum of the frames."""
    if not is_known:
        noise = FrameNoise(math.inf, 0.0, black=frames.black)
        frames = replace(frames, noise=(noise,) * len(frames.noise))
    if prior is None:
        prior = desired_response("linear", frames.response.M * max(frames.exposures))
    camera = EffectiveCamera.of(frames.response, frames.exposures)
    inverse = posterior_of(camera, prior, frames.noise).inverse
    light, deviation = inverse.E.astype(np.float32), inverse.deviation.astype(np.float32)
    if not is_known:
        deviation[:] = np.nan
    light[-1], deviation[-1] = frames.response.levels[-1], np.inf

    def estimate(
        values: list[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32]:
        return light.take(total), deviation.take(total)

    return Estimator(estimate, light, deviation, np.ones(light.size))
