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
#: Samples of a block, whose arrays stay in a cache.
_BLOCK = 1 << 14
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
    errors = np.stack([chroma_variance(each[:rows, :columns]) for each in frames])
    notable = np.flatnonzero((errors > NOTABLE).any(axis=(0, 1)))
    np.sqrt(errors, out=errors)
    spreads = errors.reshape(len(frames), len(tables), -1)
    seen = [[_by_cells(each[:rows, :columns, k]) for k in range(len(tables))] for each in frames]
    lights, deviations = (
        [_by_cells(each[:rows, :columns, k]) for k in range(len(tables))]
        for each in (irradiance, deviation)
    )
    top = tables[0].sensor.highest(None)
    for start in range(0, notable.size, _BLOCK // 4):
        cells = notable[start : start + _BLOCK // 4]
        samples = [[plane.take(cells, axis=1) for plane in each] for each in seen]
        errors_here = spreads[:, :, cells]
        visible = np.asarray((errors_here > _VISIBLE).any(axis=1))
        # Where a colour is saturated, the file may have made another one darker.
        hidden = [
            (np.maximum(np.maximum(*each[:2]), each[2]) > top) & shown
            for each, shown in zip(samples, visible, strict=True)
        ]
        for channel, table in enumerate(tables):
            first = [each[channel].take(cells, axis=1) for each in (lights, deviations)]
            light, error = _joined(
                table,
                [each[channel] for each in samples],
                errors_here[:, channel],
                hidden,
                (first[0], first[1]),
            )
            lights[channel][:, cells] = light
            deviations[channel][:, cells] = np.where(np.isnan(first[1]), np.nan, error)
    for whole, planes in ((irradiance, lights), (deviation, deviations)):
        for channel, each in enumerate(planes):
            _cells_of(whole[:rows, :columns, channel])[...] = each.reshape(2, 2, rows // 2, -1)


def _cells_of(plane: NDArray[Any]) -> NDArray[Any]:
    """Return a view (2, 2, rows / 2, columns / 2) of a plane: its cells of 2 x 2 samples."""
    cells = plane.reshape(plane.shape[0] // 2, 2, plane.shape[1] // 2, 2)
    return cells.transpose(1, 3, 0, 2)


def _by_cells(plane: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of the samples of a plane, (4, cells)."""
    return np.ascontiguousarray(_cells_of(plane)).reshape(4, -1)


def _joined(
    tables: LightTables,
    values: Sequence[NDArray[Any]],
    errors: NDArray[np.float32],
    hidden: Sequence[NDArray[np.bool_]],
    first: tuple[Floats32, Floats32],
) -> tuple[Floats32, Floats32]:
    """Return the light of samples, (4, C), and its deviation, infinite where all may be saturated.

    Args:
        tables: of their colour
        values: of each frame
        errors: standard deviations of the errors that frames have in common, levels, (n, C)
        hidden: whether another colour of the pixel is saturated
        first: light and deviation without these errors
    """
    exposures, full = tables.exposures, np.float32(tables.sensor.full)
    order = np.argsort(exposures, kind="stable").tolist()
    reach, top = np.float32(CLIPPING_SIGMAS), np.float32(tables.sensor.highest(None))
    saturated = [each > top - reach * error for each, error in zip(values, errors, strict=True)]
    # Frames beyond the last one that is not saturated everywhere say nothing.
    seeing = [k for k, at in enumerate(order) if not saturated[at].all()]
    order = order[: 1 + max(seeing, default=0)]
    light, deviation = first
    samples = {at: tables.irradiance[at].take(values[at]) for at in order}
    for _ in range(_ROUNDS):
        bins = tables.bins(light)
        above, weights, own, shared, least = (np.zeros(light.shape, np.float32) for _ in range(5))
        for at in order:
            sample, saturates = samples[at], np.float32(full / exposures[at])
            noise = tables.variances[at].take(bins)
            error = errors[at] * tables.steps[at].take(bins)
            both = noise + np.square(error)
            dim = saturated[at] | hidden[at]
            counts = ~(saturated[at] | tables.clipped[at].take(bins))
            is_known = weights > 0
            counts &= is_known | ~hidden[at]
            # Nothing is known before the first frame that counts.
            total = np.where(is_known, weights, np.float32(1))
            mean = above / total
            known = np.where(is_known, own + np.square(shared), np.float32(np.inf))
            known /= np.square(total)
            counts &= mean - reach * np.sqrt(known) <= saturates
            spread = np.sqrt(known + both)
            darker = (sample < mean - reach * spread) & (mean > saturates / 4)
            darker |= hidden[at] & (sample < mean - spread)
            # What may be saturated says how much light there is at least, and so do longer ones.
            reached = reach * np.sqrt(both)
            counts &= ~(darker | (sample + reached < least))
            least = np.where(dim, np.maximum(least, sample - reached), least)
            weight = counts / both
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
