"""The light of samples whose colours have errors that all frames share, as those of JPEG files.

Colours change within a cell of 2 x 2 pixels where they change around it (`camctl.evidence.chroma`),
most of all beside what is saturated, which has no colour.  There a sample may be saturated that its
file makes darker, and says nothing then: its weight is multiplied by the chance that it is not, as
the other frames show it (`camctl.model.joined_frames`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import brightness, chroma_variance
from camctl.evidence.lost_detail import LostDetail, for_cells, lost_of_colours
from camctl.model.joined_frames import REACH, Cells, CellsLight, JoinedFrames, SeenFrame
from camctl.model.light import Floats32, LightTables, cut_at_zero
from camctl.model.light_memory import Estimate
from camctl.model.sensor import FILE_OFFSET
from camctl.system.compiled_functions import has_compiler
from camctl.system.picture_operations import box_means, looked_up

#: Variance of colours, levels squared, above which it counts: that of rounding is 0.1 to 0.3.
NOTABLE = 0.25
#: Error of colours, levels, from which on a saturated one changes the others: twice a rounding.
_VISIBLE = 1.0
#: Square of the errors of colours over that of the noise up to which they do not change weights:
#: these would lessen the variance by less than a tenth.
_SMALL = 0.1
#: Cells on each side in which frames differ from their mean alike: those of a block of JPEG; sum of
#: squares, over their variance, that the noise is known from besides.
_AROUND, _KNOWN = 2, 1.0
#: Samples of a block, whose arrays stay in a cache.
_BLOCK = 1 << 14
#: More than any light.
_BEYOND = np.float32(1e30)
#: Rounds: in the second one, the noise is that of the light which the first one found.
_ROUNDS = 2
#: Samples of a colour of all frames in a strip from which compiled functions are loaded: those of a
#: picture take as long without them as loading does.
_WORTH_LOADING = 1 << 18


def light_of_colours(
    frames: Sequence[NDArray[Any]],
    estimates: Sequence[Estimate],
    tables: Sequence[LightTables],
    details: Sequence[Sequence[LostDetail]],
    noises: Sequence[NDArray[np.float32]],
    unknown: Sequence[NDArray[np.bool_]],
) -> tuple[Floats32, Floats32]:
    """Return the light of samples and its standard deviation, (rows, columns, 3) each.

    Args:
        frames: the same rows of each, (rows, columns, 3), clipped at white, from a block on
        estimates: the light of red, green and blue as if there were no errors in common
        tables: of these
        details: what the file of each frame loses of Y, and of Cb and Cr if it has all samples of
            these; empty where this is not known
        noises: what the noise of each frame shows, see `chroma_variance`
        unknown: bins of light in which the deviation of each colour is not known, (B,) each
    """
    rows, columns = frames[0].shape[:2]
    if rows & 1 or columns & 1:
        # A file has whole cells, whose other samples are about those at the border.
        rest = (0, rows & 1), (0, columns & 1), (0, 0)
        padded = [np.pad(each, rest, mode="edge") for each in frames]
        whole = light_of_colours(padded, estimates, tables, details, noises, unknown)
        return whole[0][:rows, :columns], whole[1][:rows, :columns]
    shape, count = (rows // 2, columns // 2), len(frames)
    compiled = _compiled(rows * columns * count)
    if compiled is not None:
        seen = compiled.in_cells(frames)
    else:
        seen = np.empty((len(tables), count, 4, math.prod(shape)), frames[0].dtype)
        for place, frame in enumerate(frames):
            for channel, planes in enumerate(seen):
                planes[place] = _by_cells(frame[..., channel])
    if details and len(details[0]) > 1:
        of_chroma = _of_all_chroma(frames, details, shape)
    elif compiled is not None:
        of_chroma = compiled.chroma_variance(seen.reshape(*seen.shape[:3], *shape), noises)
    else:
        of_chroma = np.stack(
            [
                chroma_variance(cells.reshape(-1, 4, *shape), noise)
                for cells, noise in zip(seen.swapaxes(0, 1), noises, strict=True)
            ],
            axis=1,
        )
    if compiled is not None and details:
        spreads = compiled.spreads(frames, [each[0] for each in details], of_chroma)
    else:
        spreads = of_chroma.copy()
        by_frame = spreads.swapaxes(0, 1)
        for frame, detail, error in zip(frames, details, by_frame, strict=bool(details)):
            Y = brightness(np.moveaxis(frame, 2, 0))
            error += for_cells(detail[0].of_picture(Y, Y), shape)
        np.sqrt(spreads, out=spreads)
    of_chroma, spreads = (each.reshape(len(tables), count, -1) for each in (of_chroma, spreads))
    limits = tables[0].sensor.highest(None), _VISIBLE, REACH
    beside, hidden = (compiled.beside_saturated if compiled else _beside_saturated)(
        seen, spreads, *limits
    )
    found = np.empty((2, len(tables), rows, columns), np.float32)
    for k, table in enumerate(tables):
        light, deviation = _first_light(compiled, table, estimates[k], seen[k], unknown[k])
        small, is_large = _small_errors(compiled, table, spreads[k], light)
        cells = Cells(seen[k], hidden, spreads[k], of_chroma[k], light, deviation, small)
        _replace(compiled, table, cells, beside | is_large, *found[:, k])
    irradiance, deviation = np.moveaxis(found, 1, 3)
    return irradiance, deviation


def _first_light(
    compiled: ModuleType | None,
    tables: LightTables,
    estimate: Estimate,
    values: NDArray[Any],
    unknown: NDArray[np.bool_],
) -> tuple[Floats32, Floats32]:
    """Return the light of samples, (n, 4, C), without errors in common, (4, C) each."""
    samples = values.reshape(len(values), -1)
    if compiled is None:
        found = estimate(list(samples), samples.sum(axis=0, dtype=np.uint32))
    else:
        found = compiled.first_light(tables, samples, unknown)
        if found[2].size:
            some = samples[:, found[2]]
            of_some = estimate(list(some), some.sum(axis=0, dtype=np.uint32))
            found[0][found[2]], found[1][found[2]] = of_some
    light, deviation = (each.reshape(4, -1) for each in found[:2])
    return light, deviation


def _of_all_chroma(
    frames: Sequence[NDArray[Any]], details: Sequence[Sequence[LostDetail]], shape: tuple[int, int]
) -> NDArray[np.float32]:
    """Return what files lose of all samples of Cb and Cr, (3, n, rows / 2, columns / 2)."""
    found = np.empty((3, len(frames), *shape), np.float32)
    for place, (frame, detail) in enumerate(zip(frames, details, strict=True)):
        lost = lost_of_colours(np.moveaxis(frame, 2, 0), detail)
        for of_colour, blocks in zip(found, lost, strict=True):
            of_colour[place] = for_cells(blocks, shape)
    return found


def _replace(
    compiled: ModuleType | None,
    tables: LightTables,
    cells: Cells,
    chosen: NDArray[np.bool_],
    light: Floats32,
    deviation: Floats32,
) -> None:
    """Set the light of one colour and its deviation.

    Args:
        compiled: what joins cells in compiled code; None: numpy does
        tables: of the colour
        cells: of it
        chosen: cells whose errors change weights, or that are beside what is saturated, (C,)
        light: (rows, columns)
        deviation: likewise
    """
    if compiled is not None:
        joined = compiled.join_cells(tables, cells, chosen)
        scatter = _around(joined.scatter, light.shape[0])
        compiled.put(scatter, _KNOWN, cells, joined, light, deviation)
        return
    empty = np.empty((5, *cells.light.shape), np.float32)
    found = CellsLight(empty[0], empty[1], empty[2], empty[3:])
    _join_cells(tables, cells, chosen, found)
    measured, expected = _around(found.scatter.sum(axis=1), light.shape[0])
    ratio = np.sqrt((measured + _KNOWN) / (expected + _KNOWN))
    own = found.deviation * np.where(chosen, ratio, np.float32(1))
    # Four times as fast as `np.hypot`; none of them is so small that its square vanishes.
    own = np.sqrt(np.square(own) + np.square(found.common))
    for whole, each in ((light, found.light), (deviation, own)):
        _cells_of(whole)[...] = each.reshape(2, 2, *_cells_of(whole).shape[2:])


def _around(scatter: Floats32, rows: int) -> Floats32:
    """Return the means of values of cells, (2, C), of those around each, in so many rows."""
    planes = scatter.reshape(2, rows // 2, -1)
    return np.stack([box_means(each, _AROUND) for each in planes]).reshape(2, -1)


def _compiled(size: int) -> ModuleType | None:
    """Return what does it in compiled code; None where there is none, or that takes longer."""
    if size < _WORTH_LOADING or not has_compiler():
        return None
    from camctl.pictures import compiled_chroma

    return compiled_chroma


def _join_cells(
    tables: LightTables,
    cells: Cells,
    chosen: NDArray[np.bool_],
    found: CellsLight,
) -> None:
    """Find the light of chosen cells; that of those that another colour hides sample by sample."""
    top = tables.top
    may_be_white = _above(cells.values.max(axis=1), top - REACH * cells.errors)
    may_be_white &= cells.values.min(axis=1) <= top  # else all of the cell is
    mixed = np.asarray((cells.hidden.any(axis=1) & may_be_white).any(axis=0))
    found.light[...], found.deviation[...] = cells.light, cells.deviation
    found.common[...], found.scatter[...] = cells.common, 0

    def join(places: NDArray[np.intp], *, by_cell: bool) -> NDArray[np.intp]:
        """Find the light of cells or samples; return the cells that have no weights for all."""
        shape = (4, -1) if by_cell else (-1,)

        def here(plane: NDArray[Any]) -> NDArray[Any]:
            return plane.reshape(shape).take(places, axis=-1)

        seen, of_cells = [here(each) for each in cells.values], places % chosen.size
        order = _seeing(tables.exposures, seen, top)
        joined, is_even = _joined(
            tables,
            {at: seen[at] for at in order},
            {at: cells.errors[at].take(of_cells) for at in order},
            {at: cells.of_chroma[at].take(of_cells) for at in order},
            {at: here(cells.hidden[at]) for at in order},
            (here(cells.light), here(cells.deviation), cells.common.take(of_cells)),
            by_cell=by_cell,
        )
        rows = 4 if by_cell else 1
        planes = *found[:3], *found.scatter
        for plane, each in zip(planes, joined, strict=True):
            # Row by row, in half of the time.
            for row, own in zip(plane.reshape(rows, -1), each.reshape(rows, -1), strict=True):
                row[places] = own
        return places[~is_even] if by_cell else places[:0]

    whole = _alike(np.flatnonzero(chosen & ~mixed), cells.light.min(axis=0), _BLOCK // 4)
    rest = [join(each, by_cell=True) for each in whole]
    uneven = np.concatenate([*rest, np.flatnonzero(chosen & mixed)])
    samples = (uneven + chosen.size * np.arange(4)[:, np.newaxis]).ravel()
    for some in _alike(samples, cells.light.ravel(), _BLOCK):
        join(some, by_cell=False)


def _alike(places: NDArray[np.intp], light: Floats32, count: int) -> Iterator[NDArray[np.intp]]:
    """Yield places, so many at a time, of about the same light.

    More frames are saturated in all of them then, or show nothing, and are not looked at.
    """
    # The upper half of positive floats is in their order, and sorted ten times as fast: by radix.
    keys = (light[places].view(np.uint32) >> 16).astype(np.uint16)
    places = places[np.argsort(keys, kind="stable")]
    for start in range(0, places.size, count):
        yield places[start : start + count]


def _beside_saturated(
    seen: NDArray[Any], spreads: Floats32, top: int, visible: float, reach: np.float32
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return where frames are saturated and have errors of colours.

    Returns:
        the cells in which one is or may be, (C,); for each frame the samples, (n, 4, C), of which
        it has another colour saturated, so that the file may have made them darker
    """
    found, hidden = np.zeros(spreads.shape[2], np.bool_), np.empty(seen.shape[1:], np.bool_)
    for place in range(len(hidden)):
        largest = spreads[:, place].max(axis=0)
        brightest = seen[:, place].max(axis=0)
        is_visible = largest > visible
        np.logical_and(brightest > top, is_visible, out=hidden[place])
        found |= is_visible & (brightest.max(axis=0) + reach * largest > top)
    return found, hidden


def _small_errors(
    compiled: ModuleType | None,
    tables: LightTables,
    errors: NDArray[np.float32],
    light: Floats32,
) -> tuple[Floats32, NDArray[np.bool_]]:
    """Return what errors of colours add to the deviation of cells where they are small beside it.

    The light of these stays: weights with such an error in them would hardly differ.

    Args:
        compiled: does it in compiled code; None: numpy does
        tables: of the colour
        errors: standard deviations of the errors that frames have in common, levels, (n, cells)
        light: of the samples, (4, cells)

    Returns:
        standard deviation of their light by these errors, and the other cells, (cells,) each
    """
    if compiled is not None:
        small: tuple[Floats32, NDArray[np.bool_]]
        small = compiled.small_errors(tables, errors, light, NOTABLE, _SMALL)
        return small
    bins = tables.bins(light.mean(axis=0))
    common = np.zeros(bins.shape, np.float32)
    for weight, steps, error in zip(tables.weights, tables.steps, errors, strict=True):
        notable = error * (np.square(error) > NOTABLE)
        common += weight.take(bins) * steps.take(bins) * notable
    return common, np.square(common) > _SMALL * np.square(tables.deviation.take(bins))


def _cells_of(plane: NDArray[Any]) -> NDArray[Any]:
    """Return a view (2, 2, rows / 2, columns / 2) of a plane: its cells of 2 x 2 samples."""
    cells = plane.reshape(plane.shape[0] // 2, 2, plane.shape[1] // 2, 2)
    return cells.transpose(1, 3, 0, 2)


def _by_cells(plane: NDArray[Any]) -> NDArray[Any]:
    """Return a copy of the samples of a plane, (4, cells)."""
    return np.ascontiguousarray(_cells_of(plane)).reshape(4, -1)


class _Joined(NamedTuple):
    """The light of samples, of cells (4, C) or (S,).

    Attributes:
        light: of them
        own: its standard deviation by what each frame has of its own; infinite where all may be
            saturated
        common: that by what frames have in common
        scatter: sum of the squared differences of the frames from the light, over their variance
        expected: what the noise makes of that
    """

    light: Floats32
    own: Floats32
    common: Floats32
    scatter: Floats32
    expected: Floats32


def _above(values: NDArray[Any], limit: Floats32) -> NDArray[np.bool_]:
    """Return which whole numbers, (..., S), are above a limit below the largest one, (S,).

    Numbers of a byte are compared in a quarter of the time that those take which are converted.
    """
    return np.asarray(values >= (np.floor(np.maximum(limit, -1)) + 1).astype(values.dtype))


def _seeing(exposures: NDArray[Any], values: Sequence[NDArray[Any]], top: int) -> list[int]:
    """Return the frames from the shortest to the last one in which a sample may count."""
    order: list[int] = np.argsort(exposures, kind="stable").tolist()
    seeing = [k for k, at in enumerate(order) if values[at].min() <= top]
    return order[: 1 + max(seeing, default=0)]


@np.errstate(divide="ignore", invalid="ignore")
def _joined(
    tables: LightTables,
    values: Mapping[int, NDArray[Any]],
    errors: Mapping[int, NDArray[np.float32]],
    of_chroma: Mapping[int, NDArray[np.float32]],
    hidden: Mapping[int, NDArray[np.bool_]],
    first: tuple[Floats32, Floats32, Floats32],
    *,
    by_cell: bool,
) -> tuple[_Joined, NDArray[np.bool_]]:
    """Return the light of samples, and where all of a cell are of the same, agreeing frames, (C,).

    Args:
        tables: of their colour
        values: of some frames, from the shortest to the longest, of cells (4, C) or samples (S,)
        errors: standard deviations of the errors that frames have in common, levels, (C,) or (S,)
        of_chroma: variances of those by fewer samples of colours alone
        hidden: whether another colour of the pixel is saturated
        first: light and deviation without these errors, and what they add to it
        by_cell: with the noise of a cell's mean light, whose errors choose weights less
    """
    top = tables.top
    saturated = {at: _above(each, top - REACH * errors[at]) for at, each in values.items()}
    light = first[0]
    samples = {at: looked_up(tables.irradiance[at], each) for at, each in values.items()}
    unseen = {at: each | hidden[at] for at, each in saturated.items()}
    apart, least_errors = _contradiction(tables, samples, values, (errors, of_chroma), unseen)
    is_dim, is_unseen = ({at: bool(x.any()) for at, x in e.items()} for e in (saturated, unseen))
    is_even = np.ones(light.shape[-1], np.bool_)
    rounds = 1 if by_cell else _ROUNDS
    for number in range(rounds):
        bins = tables.bins(light.mean(axis=0) if by_cell else light)
        lowest, highest = int(bins.min()), int(bins.max()) + 1
        joined = JoinedFrames(light.shape, is_last=number == rounds - 1)
        for at, sample in samples.items():
            counts = values[at] <= top
            if tables.clipped[at, lowest:highest].any():
                counts &= ~tables.clipped[at].take(bins)
            if not (is_unseen[at] or counts.any()):
                continue
            frame = SeenFrame(
                sample,
                tables.variances[at].take(bins),
                errors[at] * tables.steps[at].take(bins),
                (errors[at], tables.sensor.white - values[at]) if is_dim[at] else None,
                saturated[at],
                unseen[at] if is_unseen[at] else None,
                least_errors.get(at),
                np.float32(tables.sensor.full / tables.exposures[at]),
            )
            counts = joined.add(frame, counts)
            if by_cell:
                is_even &= (counts == counts[0]).all(axis=0)
        weights, above, own, shared = joined.weights, joined.above, joined.own, joined.shared
        found = weights > 0
        total = weights + ~found
        light = np.asarray(above / total + ~found * first[0], np.float32)
        spread, narrower = np.sqrt(1 / total), np.ones(light.shape, np.float32)
        near = np.nonzero(found & (light < REACH * spread))
        if near[0].size:
            narrower[near] = cut_at_zero(light, spread[near].astype(np.float64), near)
    scatter = np.maximum(joined.squares - np.square(above) / total, 0)
    expected = joined.count - (own + np.square(shared)) / total
    # Where frames contradict each other, their mean is no better than any of them.
    common = np.maximum(narrower * (shared + joined.more) / total, apart / 2) + ~found * first[2]
    # What is saturated, the shortest frame says best.
    missing = np.where(next(iter(unseen.values())), np.float32(np.inf), first[1])
    deviation = np.where(found, np.asarray(narrower * np.sqrt(own) / total, np.float32), missing)
    deviation[np.isnan(first[1])] = np.nan
    is_even &= (found & (apart == 0)).all(axis=0)
    return _Joined(light, deviation, common, scatter, expected), is_even


def _contradiction(
    tables: LightTables,
    samples: Mapping[int, Floats32],
    values: Mapping[int, NDArray[Any]],
    errors: tuple[Mapping[int, NDArray[np.float32]], Mapping[int, NDArray[np.float32]]],
    unseen: Mapping[int, NDArray[np.bool_]],
) -> tuple[Floats32, dict[int, Floats32]]:
    """Return how far the light of frames is apart where they contradict each other, else 0.

    Their errors are those at the light of each frame.  At the light of all, which the longest
    frames decide, errors of shorter ones are smaller or larger than they are.  Each frame may have
    another offset, which in the shortest ones is a multiple of the light of what is dark.

    All frames lose the same light of colours, but where it saturates them, they show less contrast
    of it, and even less error: what shorter frames show beyond their noise is lost in these, too.

    Args:
        tables: of the colour
        samples: light of some frames, from the shortest to the longest
        values: of these
        errors: standard deviations of the errors that frames have in common, levels, and variances
            of those by fewer samples of colours alone
        unseen: what may be saturated

    Returns:
        that, and the least errors of the light of frames where saturation may make them darker
    """
    sensor = tables.sensor
    offset = (FILE_OFFSET / 255 * (sensor.white - sensor.black)) ** 2
    shape = next(iter(samples.values())).shape
    low, high = np.zeros(shape, np.float32), np.full(shape, _BEYOND)
    levels = (tables.top - np.arange(sensor.white + 1)) / REACH
    to_saturation = (tables.of_values[0] * np.square(levels)).astype(np.float32)
    lost, least_errors = np.zeros(shape, np.float32), {}
    for at, sample in samples.items():
        square, noise = (looked_up(each[at], values[at]) for each in tables.of_values)
        may_be = looked_up(to_saturation[at], values[at]) < lost
        if may_be.any():
            least_errors[at] = np.sqrt(lost * may_be)
        of_chroma = square * errors[1][at]
        of_chroma -= noise
        np.maximum(lost, of_chroma, out=lost)
        square *= np.square(errors[0][at]) + np.float32(offset)
        square += noise
        reached = np.sqrt(square, out=square)
        reached *= REACH
        least, most = sample - reached, sample + reached
        if unseen[at].any():
            least, most = least * ~unseen[at], most + unseen[at] * _BEYOND
        np.maximum(low, least, out=low)
        np.minimum(high, most, out=high)
    apart = np.zeros(shape, np.float32)
    contrary = np.nonzero(low > high)
    if contrary[0].size:
        brightest = np.zeros(contrary[0].size, np.float32)
        darkest = np.full_like(brightest, _BEYOND)
        for at, sample in samples.items():
            here, hides = sample[contrary], unseen[at][contrary]
            brightest = np.maximum(brightest, here * ~hides)
            darkest = np.minimum(darkest, here + hides * _BEYOND)
        apart[contrary] = brightest - darkest
    return apart, least_errors
