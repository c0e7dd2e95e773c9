"""From frames and exposures, as arrays, to irradiance, standard deviations and a mask."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camctl.errors import unknown_name
from camctl.evidence.light_ratio import FrameSample, NeighbourCheck
from camctl.evidence.lost_detail import LEVELS, Floats, Steps, file_steps
from camctl.evidence.movement import Movement, find_movement
from camctl.evidence.patches import Patches, sample_patches
from camctl.evidence.residual import Pair, Side
from camctl.evidence.shown_levels import (
    black_level,
    black_of_colours,
    level_finding,
    of_samples,
    saturation_level,
)
from camctl.findings import Finding
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import CameraResponse
from camctl.model.sample_grid import SampleGrid
from camctl.model.sensor import SensorModel
from camctl.pictures.accumulator import Accumulator, sum_dtype
from camctl.pictures.combine_arguments import (
    Noise,
    Response,
    channel_responses,
    checked_frames,
    frame_layout,
    known_gains,
    known_levels,
    known_noise,
    known_steps,
)
from camctl.pictures.frame_light import FrameLight, Part, frame_light, parts_of
from camctl.pictures.render import CONTRADICTING, DARK, SATURATED
from camctl.system.threads import in_threads

METHODS = ("likelihood", "sum")

#: Samples of a strip: two of them are in work.
_STRIP = 1 << 20

_View: TypeAlias = Callable[[NDArray[Any]], NDArray[Any]]


@dataclass(frozen=True, eq=False)
class Combination:
    """The light that frames of one scene show; arrays in the shape of a frame.

    Attributes:
        irradiance: float32; a light that just saturates a frame of exposure e has
            (M + phase of the quantiser) / (M + 1) / e, where M = white - black
        sd: float32, its standard deviation: infinite where every frame is saturated, or may be so
            beside saturated colours of a JPEG file, NaN where the noise is not known
        mask: uint8: 1 no light can be distinguished from black, 2 `sd` is infinite,
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


def combine(
    frames: Iterable[ArrayLike],
    exposures: Sequence[float],
    *,
    response: Response = "linear",
    black: int = 0,
    white: int | None = None,
    noise: Noise | None = None,
    gains: Sequence[float] | None = None,
    layout: Layout | str | None = None,
    method: str = "likelihood",
    few_chroma_samples: bool = False,
    brightness_steps: Sequence[float] | None = None,
) -> Combination:
    """Return the irradiance that frames of one scene at several exposures show.

    Args:
        frames: unsigned integers of up to 16 bits, all of one type and shape: (rows, columns),
            also a Bayer mosaic, or (rows, columns, 3); a sequence, a stack, or what yields one
            after the other.  They are kept while this runs, since the noise is measured first
        exposures: of each frame, in any unit, such as s; irradiance is per unit of it
        response: of the camera: M = white - black levels; or "linear", "srgb", "rec709" or "power"
            (see `standard_response`); or three of R, G and B
        black: brightness without light, DN: the mean of dark frames.  A response by its name has
            steps that are right in the mean then (`phase_of_black`); without black they truncate.
            Where frames of a linear camera show another one, that counts (finding `levels_found`);
            where one colour alone has another one, the finding says so, and its light is wrong
        white: brightness from which samples are saturated, DN; None: black + the levels of
            `response`, or the largest value of 8-bit frames.  Where the frames show that they
            saturate below it, that brightness counts (finding `levels_found`)
        noise: of all frames, or one for each; a `NoiseModel` is taken with exposures in s.  None:
            it is measured in the frames
        gains: of each frame, linear, which its exposure includes: noise differs by it.  None: all 1
        layout: the Bayer pattern, such as "rggb": needed if a mosaic has three responses
        method: "likelihood": maximum likelihood, or the posterior mean where the quantiser or black
            decides; "sum": the posterior mean after the sum of the frames, as in the paper
        few_chroma_samples: colours differ from brightness by fewer samples than it has, as in JPEG
            files of 4:2:0 and 4:2:2; False: the frames show whether they do, if they are sharp
        brightness_steps: of JPEG files, all of one table: what the 64 frequencies of brightness are
            multiples of, row by row; they count where the frames do not show them

    Raises:
        UsageError: an argument does not fit the others
        DataError: the frames are not of one shape and type, or not unsigned integers
    """
    pictures, exposures = checked_frames(frames, exposures)
    gains = known_gains(gains, len(pictures))
    if method not in METHODS:
        raise unknown_name("method", method, METHODS)
    relative = tuple(each / min(exposures) for each in exposures)
    black, top = known_levels(pictures[0].dtype, response, black, white)
    responses = channel_responses(response, black, top)
    kind = frame_layout(pictures[0].shape, len(responses), layout)
    stated = None if brightness_steps is None else known_steps(brightness_steps)
    grid = SampleGrid.of(pictures, top, black)
    pictures = [grid.codes(each) for each in pictures]
    samples, steps = _sampled(pictures, kind, grid.code(top), stated)
    black, responses, findings = _levels(samples, relative, kind, responses, grid, black)
    unit, black = min(exposures) * grid.light_scale(black), grid.nearest(black)
    samples = [np.minimum(each, black + responses[0].M) for each in samples]
    known = None if noise is None else known_noise(noise, exposures, gains, black, grid.step)
    parts = parts_of(kind, responses)
    light = frame_light(
        parts,
        relative,
        known,
        samples,
        black=black,
        unit=unit,
        gains=gains,
        method=method,
        steps=steps,
        stated_steps=stated,
        few_chroma_samples=few_chroma_samples,
    )
    found = _combined(light, pictures, black)
    if method != "sum":
        shown = known or _noise_of_all_light(light, kind)
        is_one_wrong = any("colour" in each.details for each in findings)  # its level is the cause
        marked = _contradictions(
            found.mask, pictures, parts, relative, shown, samples, black, few_chroma_samples
        )
        findings += () if is_one_wrong else marked
    if (unknown := float(np.isnan(found.sd).mean())) > 0:
        findings.append(Finding(code="noise_unknown", value=unknown))
    return replace(_of_samples(found, grid, len(pictures)), findings=tuple(findings))


def _of_samples(found: Combination, grid: SampleGrid, count: int) -> Combination:
    """Return what `count` frames show in the unit of samples, from what their codes do."""
    if grid.step == 1:
        return found
    dtype = sum_dtype(count, grid.white)
    total = found.sum.astype(dtype) * dtype.type(grid.step) + dtype.type(count * grid.first)
    noise = tuple(
        tuple(replace(each.in_levels(1 / grid.step), black=grid.level(each.black)) for each in some)
        for some in found.noise
    )
    return replace(found, sum=total, noise=noise)


def _noise_of_all_light(light: FrameLight, kind: Layout) -> Sequence[FrameNoise] | None:
    """Return the noise that was measured in frames; None where it does not predict all samples.

    Developed colours have errors at edges, too: they are measured where noise is unknown.  Noise
    without that of photons, which all light has, says nothing of brighter light than it shows.
    """
    if kind is Layout.RGB or not light.noise:
        return None
    return light.noise[0] if math.isfinite(light.noise[0][0].electrons_per_level) else None


def _sampled(
    pictures: list[NDArray[Any]], kind: Layout, top: int, stated: Floats | None
) -> tuple[list[Patches], Steps]:
    """Return patches of the frames, and the steps of their files where those are looked for here.

    Also without a layout the frames may be a mosaic: neighbours of one colour make a patch.  One
    row or column of pixels is none.
    """
    may_be_mosaic = kind is Layout.MONO and min(pictures[0].shape) > 1
    planes = Layout.RGGB.planes if may_be_mosaic else kind.planes
    samples = [sample_patches(planes(each), top) for each in pictures]
    if kind is not Layout.MONO or top != LEVELS - 1:
        return samples, "measure"
    blocks = [sample_patches([each], top) for each in pictures]
    steps = file_steps(blocks, 1, stated)
    return samples if steps is None else blocks, steps  # no file of a mosaic has them


def _combined(light: FrameLight, pictures: list[NDArray[Any]], black: int) -> Combination:
    """Return what all frames show, without findings; strips are estimated in threads."""
    shape, count = pictures[0].shape, len(pictures)
    total = Accumulator(shape, pictures[0].dtype, count, light.white)
    for picture in pictures:
        total.accumulate(picture)
    irradiance, sd = np.empty(shape, np.float32), np.empty(shape, np.float32)
    mask = np.zeros(shape, np.uint8)

    def fill(rows: slice) -> None:
        sums = total.total[rows]
        found = light.rows([each[rows] for each in pictures], sums)
        irradiance[rows], sd[rows] = found
        mask[rows][(sums <= count * black) | (sd[rows] >= irradiance[rows])] = DARK
        mask[rows][(sums == count * light.white) | np.isinf(sd[rows])] = SATURATED

    step = max(8, _STRIP // math.prod(shape[1:]) & ~7)  # blocks of JPEG files
    strips = (slice(first, first + step) for first in range(0, shape[0], step))
    for _ in in_threads(fill, strips):
        pass
    return Combination(irradiance, sd, mask, total.total, light.noise, ())


def _levels(
    samples: list[Patches],
    exposures: Sequence[float],
    layout: Layout,
    responses: tuple[CameraResponse, ...],
    grid: SampleGrid,
    stated: int,
) -> tuple[int, tuple[CameraResponse, ...], list[Finding]]:
    """Return the black level that frames show, DN, responses of codes, and what is not as stated.

    Args:
        samples: codes of the frames
        exposures: of the frames, relative to the shortest
        layout: of the frames
        responses: as levels of brightness
        grid: of the samples
        stated: brightness without light, DN
    """
    findings, level = [], stated
    black, white = grid.nearest(stated), grid.code(grid.white)
    responses = tuple(grid.response(each, stated) for each in responses)
    shown = black_level(samples, exposures, responses[0], black, white)
    if shown is not None:
        black, level = shown, grid.level(shown)
        findings.append(level_finding("black", level, stated))
        linear = channel_responses("linear", level, grid.white)
        responses = tuple(grid.response(each, level) for each in linear)
    of_colours = black_of_colours(samples, exposures, layout, responses, black, white)
    findings += of_samples(of_colours, grid, level)
    parts = parts_of(layout, responses)
    of_parts = zip(*(np.split(each, len(parts)) for each in samples), strict=True)
    levels = [
        saturation_level(frames, exposures, part.response, black, white)
        for part, frames in zip(parts, of_parts, strict=True)
    ]
    top = min((each for each in levels if each is not None), default=None)
    if top is not None:
        findings.append(level_finding("white", grid.level(top), grid.white))
        responses = tuple(each.up_to(top - black) for each in responses)
    return level, responses, findings


def _contradictions(
    mask: NDArray[np.uint8],
    pictures: list[NDArray[Any]],
    parts: list[Part],
    exposures: Sequence[float],
    noise: Sequence[FrameNoise] | None,
    samples: list[Patches],
    black: int,
    few_chroma_samples: bool,
) -> list[Finding]:
    """Mark where frames contradict each other, and return what there is to know about it."""
    ratios, findings = _ratios(parts, exposures, noise, samples, black)
    for movement, view in _movements(
        pictures, parts, exposures, noise, samples, black, ratios, few_chroma_samples
    ):
        marks = view(mask)
        marks |= movement.rows(0, len(marks)) * np.uint8(CONTRADICTING)
        findings += movement.found.findings
    return findings


def _ratios(
    parts: list[Part],
    exposures: Sequence[float],
    noise: Sequence[FrameNoise] | None,
    samples: list[Patches],
    black: int,
) -> tuple[dict[tuple[int, int], float], list[Finding]]:
    """Return the ratios of light of frames that do not fit their exposures, and that they do not.

    Frames are neighbours in exposure, the shorter one first; things that moved change a part.
    """
    if len({part.response.fingerprint for part in parts}) > 1:
        return {}, []
    check = NeighbourCheck(parts[0].response, black, pairs=len(exposures) - 1)
    shots = [
        FrameSample(each, None if noise is None else noise[k]) for k, each in enumerate(samples)
    ]
    ratios, findings = {}, []
    for before, after in pairwise(np.argsort(exposures, kind="stable").tolist()):
        found = check.compare(shots[before], shots[after], exposures[after] / exposures[before])
        if not found.is_of_whole_picture or found.measured is None:
            continue
        ratios[before, after] = found.measured
        findings.append(
            Finding(
                code="exposure_differs",
                frames=(before, after),
                value=found.measured / found.expected,
                details={
                    "expected": found.expected,
                    "certain": found.contradicts,
                    "name": f"frame {after + 1}",
                    "before": f"frame {before + 1}",
                },
            )
        )
    return ratios, findings


def _movements(
    pictures: list[NDArray[Any]],
    parts: list[Part],
    exposures: Sequence[float],
    noise: Sequence[FrameNoise] | None,
    samples: list[Patches],
    black: int,
    ratios: dict[tuple[int, int], float],
    few_chroma_samples: bool,
) -> list[tuple[Movement, _View]]:
    """Return where the frames contradict each other, and which samples that is about.

    Samples of a mosaic with responses of their own are compared apart, and those of colours where
    the noise is measured from brightness to brightness, as if it were unknown.
    """
    apart = len(parts) if pictures[0].ndim == 2 else 1
    if len({part.response.fingerprint for part in parts}) > 1 and apart == 1:
        noise = None
    colours = 3 if noise is None and pictures[0].ndim == 3 else 1
    order = np.argsort(exposures, kind="stable").tolist()
    found = []
    for at in range(apart):
        part = parts[at if apart > 1 else len(parts) // 2]
        view: _View = part.view if apart > 1 else np.asarray
        sensor = SensorModel(part.response, black)
        patches = [np.array_split(each, apart)[at] for each in samples]
        sides = [Side(k, exposures[k], None if noise is None else noise[k]) for k in order]
        pairs = [
            Pair(
                sensor,
                short,
                long,
                ratios.get((short.position, long.position), long.exposure / short.exposure),
                (patches[short.position], patches[long.position]),
                colours,
                few_chroma_samples,
            )
            for short, long in pairwise(sides)
        ]
        planes = [view(picture) for picture in pictures]
        moved = find_movement(partial(_rows_of, planes), planes[0].shape, pairs)
        if moved is not None:
            found.append((moved, view))
    return found


def _rows_of(frames: Sequence[Pixels], position: int, part: slice) -> Pixels:
    return frames[position][part]
