"""From frames and exposures, as arrays, to irradiance, standard deviations and a mask."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camctl.errors import UsageError, unknown_name
from camctl.evidence.noise import NoiseFit, electrons_per_level, fit_noise
from camctl.evidence.patches import Patches, sample_patches
from camctl.findings import Finding
from camctl.interface.controls import Layout
from camctl.model.distribution import MAX_READ_NOISE
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Inverse, Posterior
from camctl.model.light import Floats32, is_certain, light_tables
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.response.desired import desired_response
from camctl.model.step_posterior import FrameSet
from camctl.pictures.combine_arguments import (
    Noise,
    Response,
    channel_responses,
    checked_frames,
    known_noise,
    white_level,
)
from camctl.pictures.render import CONTRADICTING, DARK, SATURATED

METHODS = ("likelihood", "sum")

#: Samples of a block: its arrays, some 20 of 4 bytes a sample, stay in a cache of some megabytes.
_BLOCK = 1 << 18

#: Standard deviations that are more uncertain than by this share are not stated: their intervals
#: of 95 % hold 92 to 97 % of the errors.
_MOST_UNCERTAIN = 0.1

_LETTERS = "RGB"


@dataclass(frozen=True, eq=False)
class Combination:
    """The light that frames of one scene show; arrays in the shape of a frame.

    Attributes:
        irradiance: float32; a light that just saturates a frame of exposure e has
            (M + phase of the quantiser) / (M + 1) / e, where M = white - black
        sd: float32, its standard deviation: infinite where every frame is saturated, NaN where the
            noise is not known
        mask: uint8: 1 no light can be distinguished from black, 2 saturated in every frame,
            4 frames contradict each other, as where something moved (not with method "sum")
        sum: uint16 or uint32, the sum of min(frame, white), black included
        noise: of each frame, for each channel that has its own; empty where it is not known
        findings: what there is to know about the result
    """

    irradiance: NDArray[np.float32]
    sd: NDArray[np.float32]
    mask: NDArray[np.uint8]
    sum: NDArray[np.unsignedinteger]
    noise: tuple[tuple[FrameNoise, ...], ...]
    findings: tuple[Finding, ...]


_Estimate: TypeAlias = Callable[
    [list[NDArray[Any]], NDArray[np.unsignedinteger]],
    tuple[Floats32, Floats32, NDArray[np.uint8]],
]
"""From samples of each frame up to white, (S,), and their sum: irradiance at exposure 1, standard
deviation and mask."""


@dataclass(frozen=True, eq=False)
class _Part:
    """The samples of a frame that have one response and one noise.

    Attributes:
        view: (rows, columns[, channels]) of a frame to those samples
        response: of the camera
        planes: of the same samples to one plane a colour, for patches of equal light
    """

    view: Callable[[NDArray[Any]], NDArray[Any]]
    response: CameraResponse
    planes: Callable[[NDArray[Any]], list[NDArray[Any]]]


def combine(
    frames: Iterable[ArrayLike],
    exposures: Sequence[float],
    *,
    response: Response = "linear",
    black: int = 0,
    white: int | None = None,
    noise: Noise | None = None,
    layout: Layout | str | None = None,
    method: str = "likelihood",
) -> Combination:
    """Return the irradiance that frames of one scene at several exposures show.

    Args:
        frames: unsigned integers of up to 16 bits, all of one type and shape: (rows, columns),
            also a Bayer mosaic, or (rows, columns, 3); a sequence, a stack, or what yields one
            after the other.  They are kept while this runs, since the noise is measured first
        exposures: of each frame, in any unit, such as s; irradiance is per unit of it
        response: of the camera: M = white - black levels; or "linear", "srgb", "rec709" or "power"
            (see `standard_response`); or three of R, G and B
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN; None: black + the levels of
            `response`, or the largest value of 8-bit frames
        noise: of all frames, or one for each; a `NoiseModel` is taken at gain 1, with exposures in
            s.  None: it is measured in the frames
        layout: the Bayer pattern, such as "rggb": needed if a mosaic has three responses
        method: "likelihood": maximum likelihood, or the posterior mean where the quantiser or black
            decides; "sum": the posterior mean after the sum of the frames, as in the paper

    Raises:
        UsageError: an argument does not fit the others
        DataError: the frames are not of one shape and type, or not unsigned integers
    """
    pictures = checked_frames(frames, exposures)
    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
    shortest = min(exposures)
    relative = tuple(each / shortest for each in exposures)
    top = white_level(pictures[0].dtype, response, black, white)
    parts = _parts(pictures[0], channel_responses(response, black, top), layout)
    known = None if noise is None else known_noise(noise, exposures, black)
    total = np.zeros(pictures[0].shape, sum_dtype(len(pictures), top))
    irradiance = np.empty(total.shape, np.float32)
    sd, mask = np.empty_like(irradiance), np.empty(total.shape, np.uint8)
    noises, findings = [], []
    for part in parts:
        fit = None if known else _fit(part, pictures, relative, black, top)
        is_known = known is not None or fit is not None
        found = _frame_set(part.response, black, relative, known, fit)
        if method == "sum":
            estimate = _sum(found, is_known=is_known)
        else:
            estimate = _likelihood(found, fit, is_known=is_known)
        views = [part.view(each) for each in (*pictures, total, irradiance, sd, mask)]
        _fill(views, len(pictures), top, estimate)
        if is_known:
            noises.append(found.noise)
    irradiance /= np.float32(shortest)
    sd /= np.float32(shortest)
    if np.isnan(sd).any():
        findings.append(Finding(code="noise_unknown", value=float(np.isnan(sd).mean())))
    return Combination(irradiance, sd, mask, total, tuple(noises), tuple(findings))


def sum_dtype(count: int, white: int) -> np.dtype[np.unsignedinteger]:
    """Return the narrowest unsigned type that holds the sum of `count` samples of up to `white`.

    Raises:
        UsageError: 32 bits are not enough
    """
    for kind in (np.uint16, np.uint32):
        if count * white <= np.iinfo(kind).max:
            return np.dtype(kind)
    raise UsageError(
        f"the sum of {count} exposures of up to {white} does not fit in 32 bits",
        hint=f"take at most {np.iinfo(np.uint32).max // white} exposures",
    )


def _parts(
    picture: NDArray[Any], responses: tuple[CameraResponse, ...], layout: Layout | str | None
) -> list[_Part]:
    """Return the parts of the frames: colours have their own noise, samples of a mosaic have not.

    Developed colours were multiplied by a white balance.
    """
    if picture.ndim == 3:
        of_colours = responses if len(responses) == 3 else responses * 3
        return [
            _Part(lambda each, at=at: each[..., at], real, lambda each: [each])  # type: ignore[misc]
            for at, real in enumerate(of_colours)
        ]
    if len(responses) == 1:
        return [_Part(lambda each: each, responses[0], Layout.RGGB.planes)]
    mosaic = Layout(layout) if layout is not None else Layout.MONO
    if not mosaic.is_mosaic:
        raise UsageError(
            "three responses for frames of one channel", hint="give the layout, such as rggb"
        )
    return [
        _Part(
            lambda each, row=row, column=column: each[row::2, column::2],  # type: ignore[misc]
            responses[_LETTERS.index(mosaic.value.upper()[2 * row + column])],
            lambda each: [each],
        )
        for row in (0, 1)
        for column in (0, 1)
    ]


def _fit(
    part: _Part,
    pictures: list[NDArray[Any]],
    exposures: tuple[float, ...],
    black: int,
    white: int,
) -> NoiseFit | None:
    """Return the noise that the frames show; None where they do not."""
    samples: list[Patches] = [
        sample_patches(part.planes(part.view(each)), white) for each in pictures
    ]
    return fit_noise(part.response, samples, exposures, [1.0] * len(exposures), black)


def _frame_set(
    response: CameraResponse,
    black: int,
    exposures: tuple[float, ...],
    known: tuple[FrameNoise, ...] | None,
    fit: NoiseFit | None,
) -> FrameSet:
    """Return the frames with their noise; photon noise stands for one that is not known."""
    if known is not None:
        return FrameSet(response, black, exposures, known)
    noise = (1.0, 0.0) if fit is None else fit.noise.tolist()
    return FrameSet(response, black, exposures, (_frame_noise(noise, black),) * len(exposures))


def _frame_noise(noise: Sequence[float], black: int) -> FrameNoise:
    inverse, square = noise
    read = min(math.sqrt(square), MAX_READ_NOISE)
    return FrameNoise(electrons_per_level(inverse), read, black=black)


def _likelihood(frames: FrameSet, fit: NoiseFit | None, *, is_known: bool) -> _Estimate:
    """Return the estimator from all frames."""
    tables = light_tables(frames)
    certain = np.full(tables.deviation.shape, is_known)
    if fit is not None:
        others = [
            replace(frames, noise=(_frame_noise(each.tolist(), frames.black),) * len(frames.noise))
            for each in fit.neighbours
        ]
        certain = is_certain(frames, others, _MOST_UNCERTAIN)
    full = np.float32(frames.response.levels[-1])
    black_total = len(frames.exposures) * frames.black
    top = black_total + len(frames.exposures) * frames.response.M

    def estimate(
        values: list[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32, NDArray[np.uint8]]:
        E, deviation, contradicts = tables.estimate(values)
        if not certain.all():
            deviation[~certain.take(tables.bins(E))] = np.nan
        mask = contradicts * np.uint8(CONTRADICTING)
        mask[(total <= black_total) | (deviation >= E)] |= DARK
        white = total == top
        if white.any():
            E[white], deviation[white], mask[white] = full, np.inf, SATURATED
        return E, deviation, mask

    return estimate


def _sum(frames: FrameSet, *, is_known: bool) -> _Estimate:
    """Return the estimator from the sum of the frames."""
    noise = frames.noise
    if not is_known:
        noise = (FrameNoise(math.inf, 0.0, black=frames.black),) * len(noise)
    inverse = _inverse(replace(frames, noise=noise))
    light, deviation = inverse.E.astype(np.float32), inverse.deviation.astype(np.float32)
    if not is_known:
        deviation[:] = np.nan
    light[-1], deviation[-1] = frames.response.levels[-1], np.inf
    mask = np.zeros(light.shape, np.uint8)
    mask[(np.arange(light.size) <= len(noise) * frames.black) | (deviation >= light)] = DARK
    mask[-1] = SATURATED

    def estimate(
        values: list[NDArray[Any]], total: NDArray[np.unsignedinteger]
    ) -> tuple[Floats32, Floats32, NDArray[np.uint8]]:
        return light.take(total), deviation.take(total), mask.take(total)

    return estimate


@lru_cache(maxsize=16)
def _inverse(frames: FrameSet) -> Inverse:
    """Return the inverse of the sum for a prior that is flat in the light, as `LightTables` has."""
    longest = max(frames.exposures)
    desired = desired_response("linear", frames.response.M * longest)
    camera = EffectiveCamera.of(frames.response, frames.exposures)
    return Posterior(camera, desired, frames.noise).inverse


def _fill(views: list[NDArray[Any]], count: int, white: int, estimate: _Estimate) -> None:
    """Estimate the last four views (sum, irradiance, sd, mask) from `count` frames, in blocks."""
    clips = white < np.iinfo(views[0].dtype).max
    for rows in _blocks(views[0].shape):
        values = [np.ravel(each[rows]) for each in views[:count]]
        if clips:
            values = [np.minimum(each, each.dtype.type(white)) for each in values]
        total, irradiance, sd, mask = (each[rows] for each in views[count:])
        added = values[0].astype(total.dtype)
        for each in values[1:]:
            added += each
        total[...] = added.reshape(total.shape)
        light, deviation, marks = estimate(values, added)
        irradiance[...] = light.reshape(irradiance.shape)
        sd[...] = deviation.reshape(sd.shape)
        mask[...] = marks.reshape(mask.shape)


def _blocks(shape: tuple[int, ...]) -> Iterator[slice]:
    rows = max(1, _BLOCK // math.prod(shape[1:]))
    for first in range(0, shape[0], rows):
        yield slice(first, first + rows)
