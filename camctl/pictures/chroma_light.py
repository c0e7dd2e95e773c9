"""The light of samples whose colours have errors that all frames share, as those of JPEG files.

Colours change within a cell of 2 x 2 pixels where they change around it (`camctl.evidence.chroma`),
most of all beside what is saturated, which has no colour.  There a sample may be saturated that its
file makes darker, and says nothing then.  Frames are joined from the shortest to the longest, each
with the inverse of its variance, and one that contradicts the shorter ones does not count: what
saturation does to a sample makes it darker.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import chroma_variance
from camctl.model.light import Floats32, LightTables
from camctl.model.sensor import CLIPPING_SIGMAS

#: Variance of colours, levels squared, above which it counts: that of rounding is 0.1 to 0.3.
NOTABLE = 0.25
#: Error of colours, levels, from which on a saturated one changes the others: twice a rounding.
_VISIBLE = 1.0
#: Samples of a block, whose arrays stay in a cache; variance that is not less, of full scale.
_BLOCK, _LEAST_VARIANCE = 1 << 14, 1e-16
#: Rounds: in the second one, the noise is that of the light which the first one found.
_ROUNDS = 2


def share_chroma_errors(
    frames: Sequence[NDArray[Any]],
    tables: Sequence[LightTables],
    irradiance: Floats32,
    deviation: Floats32,
) -> None:
    """Replace the light of samples whose colours have notable errors, and its deviation.

    Args:
        frames: the same rows of each, (rows, columns, 3), clipped at white
        tables: of red, green and blue
        irradiance: as if there were none; irradiance at exposure 1
        deviation: likewise; what is not a number stays so
    """
    rows, columns = (length & ~1 for length in irradiance.shape[:2])
    if not rows or not columns:
        return
    errors = [chroma_variance(each[:rows, :columns]) for each in frames]
    notable = np.zeros(errors[0].shape[:2], np.bool_)
    for each in errors:
        notable |= each.max(axis=2) > NOTABLE
    down, across = np.nonzero(notable.repeat(2, axis=0).repeat(2, axis=1))
    top = tables[0].sensor.highest(None)
    for start in range(0, down.size, _BLOCK):
        where = down[start : start + _BLOCK], across[start : start + _BLOCK]
        cells = (where[0] // 2, where[1] // 2)
        seen = [each[where] for each in frames]
        spreads = [np.sqrt(each[cells]) for each in errors]
        # Where a colour is saturated, the file may have made another one darker.
        hidden = [
            (each.max(axis=1) > top) & (spread.max(axis=1) > _VISIBLE)
            for each, spread in zip(seen, spreads, strict=True)
        ]
        for channel, table in enumerate(tables):
            at = (*where, channel)
            light, error = _joined(
                table,
                [each[:, channel] for each in seen],
                [each[:, channel] for each in spreads],
                hidden,
                (irradiance[at], deviation[at]),
            )
            irradiance[at] = light
            deviation[at] = np.where(np.isnan(deviation[at]), np.nan, error)


def _joined(
    tables: LightTables,
    values: Sequence[NDArray[Any]],
    errors: Sequence[NDArray[np.float32]],
    hidden: Sequence[NDArray[np.bool_]],
    first: tuple[Floats32, Floats32],
) -> tuple[Floats32, Floats32]:
    """Return the light of samples, (S,), and its deviation, infinite where all may be saturated.

    Args:
        tables: of their colour
        values: of each frame
        errors: standard deviations of the errors that frames have in common, levels
        hidden: whether another colour of the pixel is saturated
        first: light and deviation without these errors
    """
    exposures, full = tables.exposures, np.float32(tables.sensor.full)
    order = np.argsort(exposures, kind="stable").tolist()
    reach, top = np.float32(CLIPPING_SIGMAS), tables.sensor.highest(None)
    saturated = [each + reach * error > top for each, error in zip(values, errors, strict=True)]
    light, deviation = first
    samples = [row.take(each) for row, each in zip(tables.irradiance, values, strict=True)]
    for _ in range(_ROUNDS):
        bins = tables.bins(light)
        above, weights, own, shared, least = (np.zeros(light.size, np.float32) for _ in range(5))
        for place in order:
            sample, exposure = samples[place], np.float32(exposures[place])
            noise = np.square(tables.spreads[place].take(bins)) + np.float32(_LEAST_VARIANCE)
            error = errors[place] * tables.steps[place].take(bins)
            counts = ~(saturated[place] | tables.clipped[place].take(bins))
            counts &= ~(hidden[place] & (weights == 0))
            # Nothing is known before the first frame that counts.
            total = np.where(weights > 0, weights, np.float32(1))
            known = np.where(weights > 0, own + np.square(shared), np.float32(np.inf))
            mean, known = above / total, known / np.square(total)
            lost = mean - reach * np.sqrt(known) > full / exposure
            spread = np.sqrt(known + noise + np.square(error))
            darker = (sample < mean - reach * spread) & (mean > full / exposure / 4)
            darker |= hidden[place] & (sample < mean - spread)
            # What may be saturated says how much light there is at least, and so do longer ones.
            reached = reach * np.sqrt(noise + np.square(error))
            counts &= ~(lost | darker | (sample + reached < least))
            dim = saturated[place] | hidden[place]
            least = np.where(dim, np.maximum(least, sample - reached), least)
            weight = counts / (noise + np.square(error))
            above += weight * sample
            own += np.square(weight) * noise
            shared += weight * error
            weights += weight
        found = weights > 0
        total = np.where(found, weights, np.float32(1))
        light = np.where(found, np.maximum(above / total, 0), first[0])
    joined = np.sqrt(own + np.square(shared)) / total
    # What is saturated, the shortest frame says best.
    lost = saturated[order[0]] | hidden[order[0]]
    rest = np.where(lost, np.float32(np.inf), deviation)
    return light, np.where(found, joined, rest)
