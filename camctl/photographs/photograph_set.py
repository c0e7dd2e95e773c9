"""Photographs that are to be merged: read, cut to what is valid, checked, and with a response."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path

import numpy as np

from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.series import Series
from camctl.errors import UsageError
from camctl.evidence.contradictions import contradictions
from camctl.evidence.patches import Patches
from camctl.evidence.shown_levels import of_samples
from camctl.findings import Detail, Finding
from camctl.interface.controls import ExposureControls
from camctl.model.response.camera import phase_of_black
from camctl.model.sensor import SensorModel
from camctl.photographs.alignment import Sight
from camctl.photographs.camera import (
    Photograph,
    PhotographCamera,
    at,
    flashes,
    named,
    with_all_stated,
    with_true_exposures,
)
from camctl.photographs.files import PhotographFiles
from camctl.photographs.labels import check_reversed, doubted_labels, wrong_labels
from camctl.photographs.moves import aligned_finding, moves_of
from camctl.photographs.ratios import RatiosToDarker, corrected_exposures
from camctl.photographs.response import (
    ASSUMED,
    FROM_PHOTOGRAPHS,
    OF_THEIR_EXPOSURES,
    known_colour,
    known_controls,
)
from camctl.photographs.selection import (
    Selection,
    Views,
    distinct,
    of_one_colour,
    of_one_view,
)
from camctl.photographs.valid_area import ValidArea
from camctl.system.input_files import check_regular
from camctl.system.memory import share_free_memory
from camctl.system.number_text import time_text

#: Pairs of a label and its true time that are shown.
_MOST_SHOWN = 3


@dataclass(frozen=True)
class PhotographOptions:
    """What is known of photographs beside their files.

    Attributes:
        times: shutter times of the files, s, in their order, a `Fraction` as a person types it
            from a dial; None: as their EXIF data state them, from which ISO and f-number are in
            any case
        labels: "dial": the times are nominal shutter speeds, 1/60 means 1/64 s; "exact": they are
            not, and are not corrected from the pixels, either; "pixels": they are rough, and
            estimated from the pixels; "auto": numbers in `times` are exact, and fractions in it
            or EXIF data are labels where all of them are usual ones
        black: black level, DN; None: stated in raw files, else from the pixels
        white: white level, DN; None: likewise
        curve: response of the camera: a file of two columns, irradiance and brightness, or
            "linear", "srgb", "rec709", "power:GAMMA"; None: linear for raw files, that of the
            profile of the camera that the files name, or estimated
        mask: file of a picture that is black where the photographs are not valid; None: a border
            of one pure colour is cut off
        align: what is done with photographs that do not lie as most do: "shift": they are moved by
            whole pixels; "full": by a homography, which interpolates; "none"
        colour: of the pictures: "bt709": linear BT.709, with the white balance of the first
            photograph, where the files say what their colours are; "camera": as in the files
        deghost: "single": places where things moved are shown as one of the photographs shows
            them; "none": as all do; None: "single", but "none" with the colours of the camera,
            which are for measuring
    """

    times: tuple[float | Fraction, ...] | None = None
    labels: str = "auto"
    black: int | None = None
    white: int | None = None
    curve: str | None = None
    mask: str | None = None
    align: str = "shift"
    colour: str = "bt709"
    deghost: str | None = None

    @property
    def removes_ghosts(self) -> bool:
        """Whether places where things moved are shown as one of the photographs shows them."""
        return self.colour != "camera" if self.deghost is None else self.deghost == "single"

    @property
    def are_exact(self) -> bool:
        """Whether the times are neither labels nor corrected from the pixels."""
        if self.labels != "auto" or self.times is None:
            return self.labels == "exact"
        return not any(isinstance(each, Fraction) for each in self.times)


@dataclass(frozen=True, eq=False)
class OpenedPhotographs:
    """Photographs that were read and checked.

    Attributes:
        camera: of which they are the frames
        patches: samples of each of them, see `sample_patches`
        positions: of its photographs among the files as they were given
        response: where the response is from
        facts: findings that are no warnings
        notes: findings that are; in both, frames are positions of the files as they were given
        displaced: findings, by position in `camera`, of photographs that are not left out, and do
            not lie where others do
    """

    camera: PhotographCamera
    patches: tuple[Patches, ...]
    positions: tuple[int, ...]
    response: str
    facts: tuple[Finding, ...]
    notes: tuple[Finding, ...]
    displaced: dict[int, Finding]


def open_photographs(paths: Sequence[Path], source: PhotographOptions) -> OpenedPhotographs:
    """Read and check photographs, and leave out those that do not fit most others.

    Args:
        paths: of their files
        source: what is known of them

    Raises:
        DataError: a file cannot be read or does not fit the others
        UsageError: an exposure is missing, or an option does not fit the files
    """
    for path in paths[:1]:
        check_regular(path, "")  # it may be a pattern that no file fits
    if len(paths) < 2:
        raise UsageError("one photograph makes no merge", hint="give two or more exposures")
    share_free_memory()  # before the first picture is read
    files = PhotographFiles(paths, source.times)
    given = files.photographs
    photographs, unstated = with_all_stated(given)
    photographs, facts = _with_labels(photographs, source)
    notes = list(files.notes)
    seen = _Seen.of(files, photographs, source, notes)
    notes += [*unstated, *flashes(photographs)]
    if source.align != "none" and (moved := _moved(files, seen, source)) is not None:
        facts.append(moved)
        seen = _Seen.of(files, photographs, source, [])
    area = seen.area
    facts += area.facts
    selection, displaced = of_one_view(seen.selection, seen.views, notes, files.moved)
    series = selection.series
    if source.labels == "pixels":
        selection = _with_rough_exposures(selection)
    else:
        check_reversed(selection.photographs, series.patches, series.white)
        for k, factor in doubted_labels(series).items():  # it must not bend the response
            series.exposures[k] *= factor
    series.find_limits()
    if files.format.is_raw and source.white is None:
        series.find_saturation()  # tables of cameras state it too high
    facts += of_samples(series.findings, files.grid, files.format.black)
    series.findings.clear()
    selection, controls, response = _with_response(files, source, selection, notes, facts)
    patches = [np.minimum(each, controls.white) for each in selection.series.patches]
    scale = SensorModel(controls.levels, controls.black)
    photographs, right = _with_exposures(selection, patches, scale, source, response, notes, facts)
    positions, patches = [selection.positions[k] for k in right], [patches[k] for k in right]
    first = area.seen(files.pixels(positions[0]))
    planes = [each.shape for each in files.format.layout.planes(first)]
    if files.moved or not files.are_upright or first.shape != files.format.shape:
        photographs = [each.without_blocks() for each in photographs]
    exposures = [each.exposure for each in photographs]
    facts += [at(each, positions) for each in contradictions(exposures, patches, scale, planes)]
    colour = known_colour(files, controls.white) if source.colour == "bt709" else None
    controls = replace(controls, colour=colour)
    camera = PhotographCamera(
        photographs,
        lambda k: area.shown(files.taken(positions[k]), controls.black),
        controls,
        files.taken_by,
        metered=lambda k: area.seen(files.pixels(positions[k])),
    )
    return OpenedPhotographs(
        camera,
        tuple(patches),
        tuple(positions),
        response,
        tuple(named(each, given) for each in facts),
        tuple(named(each, given) for each in notes),
        {place: named(displaced[k], given) for place, k in enumerate(right) if k in displaced},
    )


@dataclass(frozen=True, eq=False)
class _Seen:
    """What all photographs show, in the place where they lie.

    Attributes:
        area: what of them is valid
        sights: of those that are no copies
        selection: those
        views: what they show of each other
    """

    area: ValidArea
    sights: list[Sight]
    selection: Selection
    views: Views

    @classmethod
    def of(
        cls,
        files: PhotographFiles,
        photographs: Sequence[Photograph],
        source: PhotographOptions,
        notes: list[Finding],
    ) -> _Seen:
        """Look at photographs; findings are added to `notes`."""
        _, white = _levels(files, source)
        area = ValidArea.of(files, source.mask)
        sights = [
            Sight.of(photograph, area.seen(files.pixels(k)), white)
            for k, photograph in enumerate(photographs)
        ]
        kept = distinct(sights, notes)
        selection = _selection(files, photographs, kept, area, source)
        sights = [sights[k] for k in kept]
        return cls(area, sights, selection, Views.of(selection, sights))


def _moved(files: PhotographFiles, seen: _Seen, source: PhotographOptions) -> Finding | None:
    """Move the photographs that do not lie as most do; return that they were moved, None if not."""
    if not seen.views.displaced:
        return None
    positions = seen.selection.positions
    _, white = _levels(files, source)
    moves = moves_of(
        seen.sights,
        seen.views.chains,
        lambda k: seen.area.seen(files.pixels(positions[k])),
        white,
        files.format.layout,
        full=source.align == "full",
    )
    if not moves:
        return None
    part = seen.area.rows, seen.area.columns
    found = {positions[k]: move.in_whole(*part) for k, move in moves.items()}
    files.move(found)
    return aligned_finding(found, len(positions), files.format.shape)


def _with_exposures(
    selection: Selection,
    patches: Sequence[Patches],
    scale: SensorModel,
    source: PhotographOptions,
    response: str,
    notes: list[Finding],
    facts: list[Finding],
) -> tuple[list[Photograph], list[int]]:
    """Return photographs with the exposures that are used, and their places in the selection.

    Findings are added to `notes` and `facts`.
    """
    photographs, is_exact = selection.photographs, source.are_exact
    if source.labels == "pixels":
        corrected, changed = corrected_exposures(photographs, patches, scale, math.inf)
        facts += [at(each, selection.positions) for each in changed]
        return corrected, list(range(len(corrected)))
    ratios = RatiosToDarker.of(patches, scale)
    if not is_exact and response != ASSUMED:
        corrected, changed = corrected_exposures(photographs, patches, scale)
        # An estimated response has errors that the estimate of exposures takes for theirs.
        if ratios.differ(corrected) < ratios.differ(photographs):
            photographs = corrected
            facts += [at(each, selection.positions) for each in changed]
    if len(photographs) <= 3 and response in OF_THEIR_EXPOSURES:
        facts.append(Finding(code="label_unchecked", remedies={"curve": None}))
    wrong = wrong_labels(
        photographs,
        ratios,
        is_exact=is_exact,
        is_known=source.curve is not None or response not in FROM_PHOTOGRAPHS,
        is_assumed=response == ASSUMED,
    )
    notes += [at(each, selection.positions) for each in wrong.notes]
    facts += [at(each, selection.positions) for each in wrong.facts]
    places = list(range(len(photographs)))
    if is_exact:  # what is named must not falsify the picture
        places = [k for k in places if k not in wrong.factors]
    factors = wrong.unclear if is_exact else wrong.unclear | wrong.factors
    return [
        replace(photographs[k], time_s=photographs[k].time_s * factors[k]) for k in places
    ], places


def _with_rough_exposures(selection: Selection) -> Selection:
    """Return photographs with exposures from their pixels, which show them up to an exponent.

    Raises:
        DataError: they do not show them
    """
    series = selection.series
    free = series.part(range(len(series.names)))
    free.exposures_are_stated = False
    found = np.array(estimate_response(free, is_scene_checked=False, is_rough=True).exposures)
    factors = found / np.array(series.exposures)
    factors /= float(np.median(factors))
    series.exposures[:] = (series.exposures * factors).tolist()
    photographs = [
        replace(each, time_s=each.time_s * factor)
        for each, factor in zip(selection.photographs, factors.tolist(), strict=True)
    ]
    return replace(selection, photographs=photographs)


def _levels(files: PhotographFiles, source: PhotographOptions) -> tuple[int, int]:
    """Return black and white level of the codes of files, as stated or of their format."""
    black = files.format.black if source.black is None else source.black
    white = files.format.white if source.white is None else source.white
    if not 0 <= black < white < 2**files.format.bits:
        raise UsageError(
            f"invalid levels: black {black} and white {white} in files of {files.format.bits} bits",
            hint=f"expected 0 <= black < white < {2**files.format.bits}",
        )
    return files.grid.nearest(black), files.grid.code(white)


def _selection(
    files: PhotographFiles,
    photographs: Sequence[Photograph],
    kept: list[int],
    area: ValidArea,
    source: PhotographOptions,
) -> Selection:
    """Return the photographs at some positions, with their histograms and patches."""
    black, white = _levels(files, source)
    series = Series(
        files.format.layout,
        files.grid.bits(files.format.bits),
        black,
        white,
        phase=phase_of_black(black),
        levels_are_stated=source.black is not None
        or source.white is not None
        or files.format.is_raw,
    )
    for k in kept:
        series.add(area.seen(files.pixels(k)), photographs[k].exposure, photographs[k].name)
    return Selection(kept, [photographs[k] for k in kept], series)


def _with_response(
    files: PhotographFiles,
    source: PhotographOptions,
    selection: Selection,
    notes: list[Finding],
    facts: list[Finding],
) -> tuple[Selection, ExposureControls, str]:
    """Return the photographs of one colour, what is known of them, and where the response is from.

    Findings are added to `notes` and `facts`.
    """
    found: tuple[list[Finding], list[Finding]] = ([], [])
    known = partial(known_controls, files, source.curve, are_exact=source.are_exact)
    controls, response = known(selection.series, *found)
    used = selection if response == ASSUMED else of_one_colour(selection, controls, notes)
    if used is not selection:  # other colours must not bend the response
        found = ([], [])
        controls, response = known(used.series, *found)
    notes += found[0]
    facts += found[1]
    return used, controls, response


def _with_labels(
    photographs: list[Photograph], source: PhotographOptions
) -> tuple[list[Photograph], list[Finding]]:
    """Return photographs with true exposures, and what was changed."""
    is_dial = source.labels == "dial"
    if not is_dial and (source.are_exact or source.labels == "pixels"):
        return photographs, []
    changed = with_true_exposures(photographs)
    if changed is None:
        if is_dial:
            raise UsageError(
                "the times are not nominal shutter speeds",
                hint="take them for exact",
                remedies={"labels": "exact"},
            )
        return photographs, []
    pairs = list(
        dict.fromkeys(  # ISO or aperture brackets have one time
            f"{time_text(before.time_s)} means {time_text(after.time_s)}"
            for before, after in zip(photographs, changed, strict=True)
            if abs(after.time_s / before.time_s - 1) > 1e-3
            and time_text(after.time_s) != time_text(before.time_s)
        )
    )
    if not pairs:
        return changed, []
    more = "" if len(pairs) <= _MOST_SHOWN else " and so on"
    details: dict[str, Detail] = {"times": ", ".join(pairs[:_MOST_SHOWN]) + more}
    return changed, [Finding(code="label_unit", details=details, remedies={"labels": "exact"})]
