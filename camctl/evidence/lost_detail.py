"""Detail that JPEG files lose, the same of it in all frames of a scene.

JPEG rounds the frequencies of blocks of 8 x 8 pixels to multiples of steps (ITU-T T.81).  Those of
brightness are seen in decoded pictures, since every frequency is such a multiple again.  Most high
frequencies are rounded to 0, and what they showed is lost: as all frames have nearly the same
detail, it neither shows in their differences, nor does it average out.

How large frequencies were that are 0 now is known from those that are not.  Blocks of a class have
about as many of these, and Laplacian frequencies, whose scale is one of the class times one of the
frequency; both are found by maximum likelihood from how many are not 0.  Noise takes part in what
is kept: it leaves errors that frames have not in common.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.chroma import NOISE_OF_Y, ROUNDING, brightness, differences, patch_brightness
from camctl.evidence.patches import SIDE, Patches
from camctl.interface.layout import BRIGHTNESS_STEPS
from camctl.model.colour_rounding import DECODED

Floats = NDArray[np.float64]

Steps: TypeAlias = Floats | Literal["measure"] | None
"""Steps of the frequencies of brightness in files, (64,), levels; None where there are none."""

LEVELS = 256
"""Levels of brightness."""

#: Steps of brightness that the standard gives as an example (ITU-T T.81, table K.1).
_EXAMPLE = (
    (16, 11, 10, 16, 24, 40, 51, 61),
    (12, 12, 14, 19, 26, 58, 60, 55),
    (14, 13, 16, 24, 40, 57, 69, 56),
    (14, 17, 22, 29, 51, 87, 80, 62),
    (18, 22, 37, 56, 68, 109, 103, 77),
    (24, 35, 55, 64, 81, 104, 113, 92),
    (49, 64, 78, 87, 103, 121, 120, 101),
    (72, 92, 95, 98, 112, 100, 103, 99),
)

#: Those of the differences of colours (table K.2); all others are the last one.
_EXAMPLE_OF_CHROMA = np.full((SIDE, SIDE), 99.0)
_EXAMPLE_OF_CHROMA[:4, :4] = (17, 18, 24, 47), (18, 21, 26, 66), (24, 26, 56, 99), (47, 66, 99, 99)

#: Standard deviation of frequencies by rounded brightness and then colours, bins of a level,
#: and what rounding makes of 0 at most: 4 of these.
_ROUNDED, _OF_LEVEL = math.sqrt((1 + NOISE_OF_Y**2) / 12), 4
_NEAR_ZERO = 4 * _ROUNDED
#: Blocks that are looked at, about, and the size of frequencies: few are larger.
_BLOCKS, _LARGEST_SIZE = 1 << 14, 512
#: Share of the frequencies that are no multiple of the step, as where a sample is clipped.
_OTHERS = 1e-3
#: Frequencies that must show their step for the others to be known from them.
_LEAST_KNOWN = 3
#: Rounds of the fit of scales, and bisections of each, from 1/20,000 to 20,000 levels.
_ROUNDS, _HALVINGS, _REACH = 12, 24, 10.0
#: Levels of brightness with one noise.
NOISE_BINS = 16
#: Octave of each number of frequencies, up to 63.
OCTAVES = np.ceil(np.log2(1 + np.arange(SIDE * SIDE))).astype(np.intp)


@dataclass(frozen=True, eq=False)
class LostDetail:
    """What the file of a frame loses.

    Attributes:
        steps: of the frequencies, levels, (64,)
        variance: that is lost of each frequency by class of block and brightness, levels squared,
            where it is 0, (classes, bins, 64)
        rounded: the same where it is not 0, (bins, 64)
    """

    steps: Floats
    variance: NDArray[np.float32]
    rounded: NDArray[np.float32]

    def of(self, blocks: NDArray[np.float32], light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the variance of what blocks lose, levels squared, (blocks,).

        Args:
            blocks: of brightness, or of a difference of colours, (blocks, 8, 8)
            light: brightness of the same blocks, by which their noise is known
        """
        found = frequencies(blocks)
        kept = np.abs(found, out=found) > (self.steps / 2).astype(np.float32)
        bins = _noise_bins(light)
        classes = np.minimum(_classes(kept), len(self.variance) - 1)
        places = classes * len(self.rounded) + bins
        by_kept = self.more_by_kept.take(places, axis=0)
        more = np.einsum("bf,bf->b", by_kept, kept, dtype=np.float32)
        return np.asarray(np.maximum(self.all_lost.take(places) + more, 0), np.float32)

    @cached_property
    def all_lost(self) -> NDArray[np.float32]:
        """What a block loses that keeps nothing, by class and brightness, (classes * bins,)."""
        return self._in_quanta(self.variance.mean(axis=2).ravel())

    @cached_property
    def more_by_kept(self) -> NDArray[np.float32]:
        """What it loses more for each frequency that is kept, (classes * bins, 64)."""
        return self._in_quanta((self.rounded - self.variance).reshape(-1, SIDE * SIDE) / SIDE**2)

    def _in_quanta(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return values of which float32 has all sums: in any order they are the same."""
        most = float(self.variance.max(initial=0) + self.rounded.max(initial=0))
        quantum = 2.0 ** math.ceil(math.log2(max(most, 1e-30)) - np.finfo(np.float32).nmant)
        return np.asarray(np.rint(values / quantum) * quantum, np.float32)

    def of_picture(
        self, plane: NDArray[np.float32], light: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """Return the same of the blocks of a picture, (rows / 8, columns / 8), both rounded up."""
        of_light = _blocks_of(light)
        blocks = of_light if plane is light else _blocks_of(plane)
        return self.of(blocks, of_light).reshape(-(-plane.shape[0] // SIDE), -1)


def stated_steps(details: Iterable[Mapping[str, Any]]) -> Floats | None:
    """Return the steps that the files of frames state, by their details, if all have the same."""
    stated = {tuple(each.get(BRIGHTNESS_STEPS, ())) for each in details}
    steps = stated.pop() if len(stated) == 1 else ()
    return np.asarray(steps, np.float64) if len(steps) == SIDE * SIDE else None


def file_steps(
    samples: Sequence[Patches], colours: int, stated: Floats | None = None
) -> Floats | None:
    """Return the steps of the frequencies of brightness in files, levels; None if none are known.

    Args:
        samples: patches of each frame of 8 bits, see `sample_patches`
        colours: 1, or 3
        stated: those that the files state, which count where none are seen
    """
    if samples[0].shape[1] != SIDE * SIDE:
        return stated
    every = max(1, len(samples) * len(samples[0]) // colours // _BLOCKS)
    found = []
    for patches in samples:
        of_colours = patches.reshape(colours, -1, SIDE * SIDE)[:, ::every]
        is_whole = (of_colours.min(axis=(0, 2)) > 0) & (of_colours.max(axis=(0, 2)) < LEVELS - 1)
        some = of_colours[:, is_whole].reshape(-1, SIDE * SIDE)
        is_grey = colours == 1
        blocks = some.reshape(-1, SIDE, SIDE) if is_grey else patch_brightness(some)
        found.append(frequencies(blocks.astype(np.float32, copy=False)))
    seen = quantisation(found)
    return stated if seen is None else seen


def quantisation(frames: Sequence[NDArray[np.float32]]) -> Floats | None:
    """Return the steps of the frequencies that blocks of frames show, levels; None if they do not.

    Args:
        frames: frequencies of blocks of each frame, (blocks, 64), without clipped samples
    """
    known = _steps(frames)
    shown = known > 0
    if np.count_nonzero(shown) < _LEAST_KNOWN:
        return None
    example = np.ravel(_EXAMPLE)
    scale = known[shown].sum() / example[shown].sum()
    return np.where(shown, known, np.maximum(np.rint(scale * example), 1))


def chroma_steps(steps: Floats) -> Floats:
    """Return the steps of Cb and Cr in a file whose steps of brightness these are.

    Both tables are then the standard's example times one number, as encoders have it.
    """
    scale = steps.sum() / np.sum(_EXAMPLE)
    return np.asarray(np.maximum(np.rint(scale * _EXAMPLE_OF_CHROMA.ravel()), 1))


def colour_rounding(steps: Floats) -> Floats:
    """Return the standard deviation of red, green and blue where a file rounds all frequencies.

    It has all samples of Cb and Cr; where there is less contrast, less is rounded.

    Args:
        steps: of brightness in the file, levels
    """
    brightness_error, chroma_error = (
        np.square(each).mean() / 12 for each in (steps, chroma_steps(steps))
    )
    variance = np.square(DECODED) @ (brightness_error, chroma_error, chroma_error)
    return np.asarray(np.sqrt(variance + np.square(ROUNDING)))


def _lost_detail(scales: Floats, steps: Floats, noise: Floats) -> LostDetail:
    """Return what the file of a frame loses.

    Args:
        scales: of its frequencies by class, (classes, 64), levels
        steps: of the frequencies
        noise: standard deviation of the brightness at each one, levels, (256,)
    """
    noise = noise.reshape(NOISE_BINS, -1).mean(axis=1)
    square = np.square(noise)[:, np.newaxis]
    in_steps = square / np.square(steps)
    # Of the error of a rounded value, Widrow and Kollar, Quantization Noise, 2008.
    rounded = np.square(steps) / 12 * np.exp(-4 * np.square(np.pi) * in_steps)
    # In the mean, noise keeps a share of a small value, the density of what it lifts to a step.
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        share = np.sqrt(2 / np.pi / in_steps) * np.exp(-1 / (8 * in_steps))
    missed = np.square(1 - np.minimum(np.nan_to_num(share), 1))
    below = steps / 2 / scales[:, np.newaxis]
    decay = np.exp(-below)
    inside = 2 - decay * (below * below + 2 * below + 2)
    spread = np.square(scales[:, np.newaxis]) * inside / np.maximum(1 - decay, 1e-12)
    of_scene = np.maximum(1 - square / (2 * np.square(scales[:, np.newaxis])), 0)
    lost = spread * of_scene * missed
    lost[..., 0] = rounded[..., 0]
    return LostDetail(steps, lost.astype(np.float32), rounded.astype(np.float32))


def lost_details(
    blocks: Sequence[NDArray[np.float32]], steps: Floats, noise: Sequence[Floats]
) -> tuple[LostDetail, ...]:
    """Return what the files of frames lose.

    Args:
        blocks: brightness of blocks all over each frame, (blocks, 8, 8)
        steps: of their frequencies, levels
        noise: standard deviation of the brightness of each frame at each one, levels, (256,)
    """
    scales = _scales([np.abs(frequencies(each) / steps) > 0.5 for each in blocks], steps)
    return tuple(_lost_detail(each, steps, own) for each, own in zip(scales, noise, strict=True))


def lost_of_colours(colours: NDArray[Any], details: Sequence[LostDetail]) -> NDArray[np.float32]:
    """Return what a file with all samples of Cb and Cr loses of these, as red, green and blue.

    Args:
        colours: red, green and blue of a picture, (3, rows, columns)
        details: what the file loses of Y, Cb and Cr

    Returns:
        variance of blocks, levels squared, (3, rows / 8, columns / 8), both rounded up
    """
    Y = brightness(colours)
    lost = [
        detail.of_picture(differences(colours, at), Y) for at, detail in enumerate(details[1:], 1)
    ]
    return np.asarray(np.einsum("kc,crb->krb", np.square(DECODED[:, 1:]), lost), np.float32)


def for_cells(blocks: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return what blocks have for each of their cells of 2 x 2 samples, in a shape of these."""
    cells = blocks.repeat(SIDE // 2, axis=0).repeat(SIDE // 2, axis=1)
    return cells[: shape[0], : shape[1]]


def frequencies(brightness: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the frequencies of blocks, (blocks, 64)."""
    return np.asarray((brightness - np.float32(128)).reshape(-1, SIDE * SIDE) @ _cosines())


@lru_cache(maxsize=1)
def _cosines() -> NDArray[np.float32]:
    """Return the cosine transform of a block (ITU-T T.81, A.3.3), (64 pixels, 64 frequencies)."""
    return np.asarray(np.kron(cosines(), cosines()).T, np.float32)


def cosines() -> Floats:
    """Return the cosine transform of a row of a block, (8 frequencies, 8 pixels)."""
    pixel, frequency = np.arange(SIDE), np.arange(SIDE)[:, np.newaxis]
    rows = np.cos((2 * pixel + 1) * frequency * (math.pi / (2 * SIDE))) * math.sqrt(2 / SIDE)
    rows[0] *= math.sqrt(0.5)
    return np.asarray(rows)


def _classes(kept: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the class of each block: the octave of how many frequencies it keeps."""
    words = kept.view(np.uint64)  # of 8 bytes, each 0 or 1
    counts = np.add.reduce(words, axis=1).view(np.uint8).reshape(len(kept), 8)
    return np.asarray(OCTAVES.take(counts.sum(axis=1, dtype=np.uint8) - kept[:, 0]))


def _blocks_of(plane: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the blocks of a plane, (blocks, 8, 8); those at its end have its border beyond."""
    rest = [(0, -length % SIDE) for length in plane.shape]
    whole = np.pad(plane, rest, mode="edge") if any(each[1] for each in rest) else plane
    rows, columns = (length // SIDE for length in whole.shape)
    return whole.reshape(rows, SIDE, columns, SIDE).swapaxes(1, 2).reshape(-1, SIDE, SIDE)


def _noise_bins(brightness: NDArray[np.float32]) -> NDArray[np.intp]:
    mean = np.clip(brightness.mean(axis=(1, 2)), 0, LEVELS - 1)
    return np.asarray(mean * (NOISE_BINS / LEVELS), np.intp)


def _steps(frames: Sequence[NDArray[np.float32]]) -> Floats:
    """Return the most probable step of each frequency, (64,); 0 where it is not seen."""
    counts = np.zeros((SIDE * SIDE, _LARGEST_SIZE * _OF_LEVEL))
    for values in frames:
        places = np.abs(values) * np.float32(_OF_LEVEL) + np.float32(0.5)
        np.minimum(places, counts.shape[1] - 1, out=places)
        index = places.astype(np.intp) + np.arange(SIDE * SIDE) * counts.shape[1]
        counts += np.bincount(index.ravel(), minlength=counts.size).reshape(counts.shape)
    # Of the multiples, 0 is any step's, and how frequent it is shows none.
    first = math.ceil(_NEAR_ZERO * _OF_LEVEL)
    likely, shown = _likelihoods()[first:-1], counts[:, first:-1]
    number = np.maximum(shown.sum(axis=1), 1)
    size = np.arange(first, counts.shape[1] - 1) / _OF_LEVEL
    rate = 1 / np.maximum(shown @ size / number - _NEAR_ZERO, 1 / _OF_LEVEL)[:, np.newaxis]
    step = np.arange(1, LEVELS)
    # Where sizes decrease exponentially within a step, its first multiple has more than a share.
    exponent = rate * (_NEAR_ZERO - step) + np.square(rate * _ROUNDED) / 2
    first_share = step * rate * np.exp(exponent) / -np.expm1(-rate * step)
    share = np.maximum((1 - _OTHERS) * first_share + _OTHERS, 1.0)
    evidence = shown @ likely - number[:, np.newaxis] * np.log(share)
    best = evidence.argmax(axis=1)
    known = (evidence.max(axis=1) > math.log(evidence.size)) & (best > 0)
    known[0] = False
    return np.where(known, best + 1.0, 0.0)


@lru_cache(maxsize=1)
def _likelihoods() -> Floats:
    """Return the logarithm of the likelihood of each step, from 1, at each size of a frequency.

    It is that over the one of a frequency that may be any number, (bins, steps).
    """
    size = np.arange(_LARGEST_SIZE * _OF_LEVEL)[:, np.newaxis] / _OF_LEVEL
    step = np.arange(1, LEVELS)
    multiple = np.maximum(np.rint(size / step), 1)
    variance = _ROUNDED**2 + 1 / (12 * _OF_LEVEL**2)
    square = np.square(size - multiple * step) / variance
    found = step * np.exp(-square / 2) / math.sqrt(2 * math.pi * variance)
    # Rounding hides steps of 1.
    found[:, 0] = 1.0
    return np.asarray(np.log((1 - _OTHERS) * found + _OTHERS))


def _scales(kept: Sequence[NDArray[np.bool_]], steps: Floats) -> list[Floats]:
    """Return the scales of Laplacian frequencies of frames by class, (classes, 64), levels.

    Those of all frames are found at once: one array for each takes as long.

    Args:
        kept: which frequencies of blocks are not 0, of each frame, (blocks, 64)
        steps: of the frequencies, levels
    """
    classes = [_classes(each) for each in kept]
    count = 1 + max(int(each.max()) for each in classes)
    blocks = np.stack([np.bincount(each, minlength=count) for each in classes])[..., np.newaxis]
    seen = np.stack(
        [
            [each[of == k].sum(axis=0, dtype=np.float64) for k in range(count)]
            for each, of in zip(kept, classes, strict=True)
        ]
    )
    half = steps / 2
    own, frequency = np.zeros(blocks.shape), np.log(half / 3)[np.newaxis, np.newaxis]

    def expected(x: Floats, y: Floats) -> Floats:
        return np.asarray(blocks * np.exp(-half * np.exp(-x - y)))

    of_class = np.maximum(seen[..., 1:].sum(axis=2, keepdims=True), 0.5)
    of_frequency = np.maximum(seen.sum(axis=1, keepdims=True), 0.5)
    for _ in range(_ROUNDS):
        own = _solved(
            lambda x, y=frequency: expected(x, y)[..., 1:].sum(axis=2, keepdims=True),  # type: ignore[misc]
            of_class,
        )
        frequency = _solved(
            lambda x, y=own: expected(x, y).sum(axis=1, keepdims=True),  # type: ignore[misc]
            of_frequency,
        )
    return [_shown(*each) for each in zip(own[..., 0], frequency[:, 0], blocks, seen, strict=True)]


def _shown(own: Floats, frequency: Floats, blocks: Floats, seen: Floats) -> Floats:
    """Return the scales of a frame by logarithms of those of classes and of frequencies.

    Args:
        own: of the classes, (classes,)
        frequency: of the frequencies, (64,)
        blocks: number of blocks of each class, (classes, 1)
        seen: number of blocks that keep a frequency, (classes, 64)
    """
    never = seen[:, 1:].sum(axis=0) == 0
    if np.count_nonzero(~never) > 3:
        # What no block shows is less than it could hide: ln(detail) is a parabola of ln(frequency).
        octave = np.log(np.hypot(*np.divmod(np.arange(1, SIDE * SIDE), SIDE)))
        line = np.polyfit(octave[~never], frequency[1:][~never], 2)
        frequency[1:][never] = np.minimum(frequency[1:], np.polyval(line, octave))[never]
    used = np.flatnonzero(blocks)
    own = np.interp(np.arange(len(own)), used, own[used])
    return np.asarray(np.exp(own[:, np.newaxis] + frequency))


def _solved(ascending: Callable[[Floats], Floats], wanted: Floats) -> Floats:
    """Return where an ascending function has some values."""
    low, high = np.full(wanted.shape, -_REACH), np.full(wanted.shape, _REACH)
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        is_less = ascending(middle) < wanted
        low, high = np.where(is_less, middle, low), np.where(is_less, high, middle)
    return low
