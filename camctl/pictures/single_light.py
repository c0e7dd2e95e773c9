"""The light that each frame shows by itself, as tables of its samples.

The model of the camera gives it, and its error by noise.  Samples all over the picture show how the
light that all frames show deviates from it: dark samples of a short exposure, or those beside white
of a JPEG file, have errors that the model does not know.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.patches import Patches
from camctl.model.light import Floats32, light_tables
from camctl.model.noise import FrameNoise
from camctl.model.step_posterior import FrameSet
from camctl.pictures.frame_light import FrameLight, Part

#: Samples of a group, whose median has 1/8 of their standard deviation as its error: sqrt(pi/2/N).
_GROUP = 100
#: Ends of the range that holds as many of normal variables as are within a standard deviation.
_WITHIN = (15.87, 84.13)


@dataclass(frozen=True, eq=False)
class SingleLight:
    """The light of a part of each frame; arrays (frames, white + 1) by the value of a sample.

    Attributes:
        part: the samples
        irradiance: float32, in the unit of the pictures
        deviation: float32, of it; infinite where the frame is saturated, NaN where it is not known
        variance: float32, of its logarithm, about; of a saturated sample as if all light up to the
            saturation of the shortest frame were equally probable on a logarithmic scale
    """

    part: Part
    irradiance: Floats32
    deviation: Floats32
    variance: Floats32


def single_lights(
    light: FrameLight, exposures: Sequence[float], samples: Sequence[Patches], black: int
) -> list[SingleLight]:
    """Return the light of each frame, for each part.

    Args:
        light: what estimates the light from all frames
        exposures: of the frames, relative to the shortest
        samples: patches of each frame, plane by plane, see `sample_patches`
        black: brightness without light, DN
    """
    is_known = len(light.noise) == len(light.parts)
    unknown = (FrameNoise(math.inf, 0.0, black=black),) * len(exposures)
    of_parts = zip(*(np.array_split(each, len(light.parts)) for each in samples), strict=True)
    found = []
    for k, ((part, estimator), patches) in enumerate(zip(light.parts, of_parts, strict=True)):
        noise = light.noise[k] if is_known else unknown
        models = [_of_frame(part, each, black) for each in noise]
        white = models[0][0].size - 1
        values = [np.minimum(np.ravel(each), white) for each in patches]
        total = np.asarray(np.sum(values, axis=0, dtype=np.uint32))
        together, _ = estimator.estimate(values, total)
        tables = [
            _corrected(*model, exposure, value, together)
            for model, exposure, value in zip(models, exposures, values, strict=True)
        ]
        irradiance, deviation = (np.stack(each) for each in zip(*tables, strict=True))
        variance = np.log1p(np.square(deviation / irradiance))
        # The mean square of what is even from 0 to L.
        beyond = np.square(np.log(np.array(exposures) / min(exposures))) / 3
        variance = np.where(np.isinf(deviation), beyond[:, np.newaxis], variance)
        known = np.isfinite(np.interp(irradiance, estimator.light, estimator.deviation))
        deviation[~known & np.isfinite(deviation)] = np.nan
        scale = np.float32(1 / light.unit)
        found.append(SingleLight(part, irradiance * scale, deviation * scale, variance))
    return found


def _of_frame(part: Part, noise: FrameNoise, black: int) -> tuple[Floats32, Floats32]:
    """Return the light of each value of a sample at exposure 1, and its deviation."""
    tables = light_tables(FrameSet(part.response, black, (1.0,), (noise,)))
    codes = np.arange(tables.sensor.white + 1, dtype=np.uint16)
    irradiance, deviation = tables.estimate([codes], codes)
    is_compressed = bool(noise.compression_levels or noise.file)
    saturated = tables.sensor.highest(None) + 1 if is_compressed else tables.sensor.white
    irradiance[-1] = part.response.levels[-1]
    deviation[saturated:] = np.inf
    return irradiance, deviation


def _corrected(
    irradiance: Floats32,
    deviation: Floats32,
    exposure: float,
    values: NDArray[Any],
    together: Floats32,
) -> tuple[Floats32, Floats32]:
    """Return the light of each value of a sample, and its deviation, as samples show them.

    Args:
        irradiance: of each value by the model, at exposure 1
        deviation: of it, infinite where the frame is saturated
        exposure: of the frame
        values: of samples in the frame
        together: their light in all frames
    """
    irradiance, deviation = irradiance / np.float32(exposure), deviation / np.float32(exposure)
    # What the model says of samples below black has no logarithm.
    used = (np.isfinite(deviation) & (irradiance > 0))[values] & (together > 0)
    values, together = values[used], together[used]
    order = np.argsort(values, kind="stable")
    if order.size < _GROUP:
        return irradiance, deviation
    errors = np.log(together[order] / irradiance[values[order]])
    count = min(order.size // _GROUP, irradiance.size)
    codes = np.concatenate([each.mean(axis=1) for each in _groups(values[order], count)])
    low, middle, high = np.concatenate(
        [
            np.percentile(each, (_WITHIN[0], 50, _WITHIN[1]), axis=1)
            for each in _groups(errors, count)
        ],
        axis=1,
    )
    every = np.arange(irradiance.size)
    usable = np.isfinite(deviation)
    change = np.exp(np.interp(every, codes, middle)).astype(np.float32)
    spread = np.interp(every, codes, (high - low) / 2)
    irradiance[usable] *= change[usable]
    deviation = np.maximum(deviation, (spread * irradiance).astype(np.float32))
    return irradiance, deviation


def _groups(values: NDArray[Any], count: int) -> list[NDArray[Any]]:
    """Return values in so many groups, as the rows of two arrays: some have one more."""
    size, longer = divmod(values.size, count)
    end = longer * (size + 1)
    return [values[:end].reshape(longer, size + 1), values[end:].reshape(-1, size)]


def least_light(lights: Sequence[SingleLight]) -> float:
    """Return the least light that a frame shows, which has a logarithm."""
    return min(float(each.irradiance[each.irradiance > 0].min()) for each in lights)
