"""The noise of samples of different responses: of one brightness, of a mosaic, or of colours."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import patch_brightness, patch_differences, photon_noise_ratios
from camctl.evidence.lost_detail import LostDetail, chroma_steps, lost_details
from camctl.evidence.noise import NoiseFit, fit_noise
from camctl.evidence.patches import SIDE, Patches
from camctl.model.block_rounding import BlockRounding
from camctl.model.colour_rounding import ENCODED, ColourRounding
from camctl.model.light import LightTables
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.sensor import SensorModel

#: Steps of frequencies of files in which none are seen.
_FINE = (0.01,) * SIDE**2


def file_roundings(
    steps: NDArray[np.float64] | None,
    responses: Sequence[CameraResponse],
    samples: Sequence[Patches],
    black: int,
) -> list[BlockRounding | None]:
    """Return what a file makes of the noise of each part.

    Args:
        steps: of the frequencies of its brightness, levels; None: they are not known
        responses: of the part, or of red, green and blue
        samples: patches of each frame, part by part
        black: brightness without light, DN
    """
    if steps is None:
        return [None] * len(responses)
    own = tuple(steps.tolist())
    if len(responses) == 1:
        return [BlockRounding(own)]
    others = tuple(chroma_steps(steps).tolist())
    sensors = [SensorModel(each, black) for each in responses]
    photons = [each.light / np.maximum(each.gap, 1e-12) ** 2 for each in sensors]
    return [
        ColourRounding(own, chroma_steps=others, colour=at, noise=tuple(row.tolist()))
        for at, row in enumerate(photon_noise_ratios(samples, photons))
    ]


def noise_contrast(
    green: SensorModel, noise: Sequence[FrameNoise | None], file: BlockRounding | None
) -> tuple[NDArray[np.float32], ...]:
    """Return what the noise of frames shows as contrast of colours, see `ColourRounding.cells`.

    All light has photon noise.  Where none was found, what was found is texture or not only noise,
    and is not told apart from contrast.

    Args:
        green: its sensor
        noise: of green of each frame; None: not known, and none shows
        file: what it makes of the noise of green
    """
    if not isinstance(file, ColourRounding):
        file = ColourRounding(_FINE, chroma_steps=_FINE, colour=1)
    gap = np.maximum(np.square(green.gap), 1e-12)
    alike: dict[FrameNoise | None, NDArray[np.float32]] = {}
    for each in noise:
        if each not in alike:
            square = np.zeros(gap.shape)
            if each is not None and math.isfinite(each.electrons_per_level):
                square = green.variance(green.light, each) / gap + 1 / 12
            alike[each] = np.asarray(file.cells(square), np.float32)
    return tuple(alike[each] for each in noise)


def file_details(
    green: LightTables,
    samples: Sequence[Patches],
    steps: NDArray[np.float64],
    *,
    has_all_chroma: bool,
) -> tuple[tuple[LostDetail, ...], ...]:
    """Return what the file of each frame loses of its brightness, as samples of colours show it.

    Where it has all samples of colours, what it loses of Cb and of Cr follows.

    Args:
        green: tables of green, which noise is known from
        samples: patches of each frame, part by part
        steps: of the frequencies of brightness, levels
        has_all_chroma: whether files have as many samples of Cb and Cr as of brightness
    """
    noise = []
    for light, variances, widths in zip(
        green.irradiance, green.variances, green.steps, strict=True
    ):
        bins = green.bins(light)
        noise.append(np.sqrt(variances.take(bins)) / np.maximum(widths.take(bins), 1e-12))
    shares = np.sqrt(np.square(ENCODED).sum(axis=1))
    planes, of_planes = [[patch_brightness(each) for each in samples]], [steps]
    if has_all_chroma:
        planes += [[patch_differences(each, at) for each in samples] for at in (1, 2)]
        of_planes += [chroma_steps(steps)] * 2
    found = [
        lost_details(blocks, own, [share * each for each in noise])
        for blocks, own, share in zip(planes, of_planes, shares, strict=False)
    ]
    return tuple(zip(*found, strict=True))


def fit_parts(
    responses: Sequence[CameraResponse],
    samples: Sequence[Patches],
    exposures: Sequence[float],
    gains: Sequence[float],
    black: int,
    plain: NDArray[np.bool_] | None,
    files: Sequence[BlockRounding | None],
) -> list[NoiseFit | None]:
    """Return the noise that the patches of each part show, see `fit_noise`.

    In files of colours most noise of red and of blue is the noise of green, through brightness:
    what they have of their own shows how much it is, but not how it changes with the light.
    Without `plain`, all patches show what compression adds.
    """
    count = len(responses)
    of_parts = [[np.array_split(each, count)[at] for each in samples] for at in range(count)]
    every = np.ones(len(samples[0]), np.bool_)
    shown = np.array_split(every if plain is None else plain, count)

    def fitted(at: int, like: NoiseFit | None = None) -> NoiseFit | None:
        response, patches, file = responses[at], of_parts[at], files[at]
        return fit_noise(response, patches, exposures, gains, black, shown[at], file, like)

    if count == 3 and files[1] is not None:
        green = fitted(1)
        like = green if green is not None and green.noise.any() else None
        return [fitted(0, like), green, fitted(2, like)]
    return [fitted(at) for at in range(count)]
