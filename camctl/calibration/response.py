"""The response of a camera from an exposure series of a scene that does not move.

Frames are reduced one by one to histograms and patches (`Series`), checked, and the curve of each
channel is estimated by `camctl.calibration.response_fit`.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.chart import ChartPatch
from camctl.calibration.exponent import (
    Exponent,
    common_exponent,
    expected_exponent,
    exponent_of_chart,
    with_exponent_error,
)
from camctl.calibration.response_chart import chart_notes, chart_samples
from camctl.calibration.response_checks import check_frames, check_range, check_scene
from camctl.calibration.response_fit import (
    ROUGH,
    STATED,
    ChartSamples,
    ResponseFit,
    fit_response,
)
from camctl.calibration.response_matches import Matches, match_levels
from camctl.calibration.response_noise import correct_matches
from camctl.calibration.response_series import Series
from camctl.calibration.spill import below_saturation, spills_over
from camctl.camera import Camera
from camctl.controls import ExposureSetting
from camctl.errors import CaptureError, DataError
from camctl.response.camera import FloatArray
from camctl.response_record import ChannelResponse, ResponseRecord

FRAMES = 8
#: Longest shutter time that is used unless another one is asked for, s.
LONGEST_S = 2.0
#: Levels at which a response is estimated, beside the first ones, and those that a record keeps.
_LEVELS, _FIRST_LEVELS = 4096, 256
_KEPT, _FIRST_KEPT = 200, 32
#: Time for the bracket: from the first probe in which this share of the pixels reaches half of full
#: scale, to the first in which all but this share is saturated.
_FEW = 0.01
_PROBE_STEP = 4.0
#: Where neither exposures nor reflectances are known.
_UNKNOWN_EXPONENT = (
    "no exposure is known: the exponent of the curve was chosen so that it is about as steep as "
    "that of sRGB, and may be 20 % wrong for a camera that makes such pictures, and 100 % for raw "
    "ones; give --times of the frames, or put a chart into the picture"
)
#: Where charge spills over from highlights.
_SPILLS = (
    "charge spills over from saturated samples (blooming): they and those near them are left out "
    "of the estimate"
)


@dataclass(frozen=True, eq=False)
class ResponseEstimate:
    """An estimated response, and what else the frames say.

    Attributes:
        record: for the camera's profile
        exposures: of the frames relative to the first: those given, or those estimated
        residual: root mean square error of matched irradiances, relative; None where it is
            unknown
        exponent_error: relative standard deviation of an exponent of the whole curve; None where it
            is unknown
        notes: what the user should know, one line each
    """

    record: ResponseRecord
    exposures: tuple[float, ...]
    residual: float | None
    exponent_error: float | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Chart:
    """A chart before the camera.

    Attributes:
        patches: of known reflectance
        frames: the frames of the series
    """

    patches: tuple[ChartPatch, ...]
    frames: Sequence[NDArray[Any]]


def estimate_response(
    series: Series,
    *,
    estimate_ratios: bool = False,
    chart: Chart | None = None,
    is_scene_checked: bool = True,
) -> ResponseEstimate:
    """Return the response of each channel from an exposure series, or from frames of a chart.

    Args:
        series: frames of different exposure of one scene; with a chart, one is enough
        estimate_ratios: the exposures are approximate (30 %), and are estimated, too, as those of
            a series that does not state them always are
        chart: adds the brightness of its patches to what the frames say
        is_scene_checked: False: the caller checks exposures and movement itself

    Raises:
        DataError: the frames are not suitable; says why and what to do
    """
    series.find_limits()
    if not series.exposures_are_stated:
        series.guess_exposures()
        estimate_ratios = True
    check_frames(series, has_chart=chart is not None, is_scene_checked=is_scene_checked)
    exposures = np.array(series.exposures)
    edges = _edges(series.white - series.black)
    notes = list(series.notes)
    channels = _without_spill(
        series, edges, [_evidence(series, name, edges, chart) for name in series.channels], notes
    )
    exponent = None
    if estimate_ratios and exposures.size > 1 and not (series.exposures_are_stated and not chart):
        exponent = common_exponent(
            [each.exponent(exposures, edges, series.phase) for each in channels]
        )
        exposures = exposures**exponent.value
        if chart is None:
            notes.append(_UNKNOWN_EXPONENT)
    fits = []
    for k, each in enumerate(channels):
        if exposures.size > 1:
            first = each.fit(exposures, edges, series.phase, ROUGH if estimate_ratios else STATED)
            matches = correct_matches(each.matches, series, each.name, edges, first)
            channels[k] = each = dataclasses.replace(each, matches=matches)
        free = each.fit(exposures, edges, series.phase, ROUGH)
        fit = free if estimate_ratios else each.fit(exposures, edges, series.phase, STATED)
        if is_scene_checked and not estimate_ratios:
            notes += check_scene(series, each.name, edges, fit, free)
        if each.samples is not None:
            notes += chart_notes(each.samples, fit.patch_errors, each.name)
        fits.append(fit if exponent is None else with_exponent_error(fit, edges, exponent.error))
    if estimate_ratios:
        exposures = np.exp(np.mean([np.log(fit.exposures) for fit in fits], axis=0))
    return ResponseEstimate(
        record=ResponseRecord(
            channels=tuple(
                each.response(fit, series, edges) for each, fit in zip(channels, fits, strict=True)
            ),
            phase=series.phase,
            frames=len(series.exposures),
            measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
        ),
        exposures=tuple((exposures / exposures[0]).tolist()),
        residual=max(fit.residual for fit in fits),
        exponent_error=None if exponent is None else exponent.error,
        notes=tuple(dict.fromkeys(notes)),
    )


def _edges(levels: int) -> FloatArray:
    first = np.arange(1.0, min(levels, _FIRST_LEVELS) + 1)
    return np.unique(np.concatenate([first, np.round(np.linspace(1, levels, _LEVELS))]))


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What the frames say about one channel."""

    name: str
    saturates: bool
    matches: Matches
    samples: ChartSamples | None

    def fit(
        self, exposures: FloatArray, edges: FloatArray, phase: float, exposure_error: float
    ) -> ResponseFit:
        return fit_response(
            self.matches,
            exposures.tolist(),
            edges,
            phase=phase,
            exposure_error=exposure_error,
            chart=self.samples,
        )

    def exponent(self, exposures: FloatArray, edges: FloatArray, phase: float) -> Exponent:
        """Return the exponent of exposures that are known up to one."""
        without = dataclasses.replace(self, samples=None)
        fit = without.fit(exposures, edges, phase, ROUGH)
        if self.samples is None:
            return expected_exponent(fit, edges)
        return exponent_of_chart(fit, edges, self.samples)

    def response(self, fit: ResponseFit, series: Series, edges: FloatArray) -> ChannelResponse:
        levels = series.white - series.black
        spaced = np.linspace(0, edges.size - 1, _KEPT).round()
        kept = np.unique(
            np.concatenate([np.arange(min(edges.size, _FIRST_KEPT)), spaced]).astype(np.intp)
        )
        brightness = (edges[kept] - series.phase) / (levels + 1)
        found = [self.matches.low, self.matches.high]
        found += [] if self.samples is None else [self.samples.level]
        seen = (np.concatenate(found) - series.phase) / (levels + 1)
        return ChannelResponse(
            name=self.name,
            black=series.black,
            white=series.white,
            saturates=self.saturates,
            irradiance=(0.0, *fit.irradiance[kept].tolist(), 1.0),
            brightness=(0.0, *brightness.tolist(), 1.0),
            deviation=(
                float(fit.deviation[0]),
                *fit.deviation[kept].tolist(),
                float(fit.deviation[-1]),
            ),
            measured=(float(seen.min()), float(seen.max())),
        )


def _evidence(series: Series, name: str, edges: FloatArray, chart: Chart | None) -> _Evidence:
    counts = series.counts_between(name, series.black + edges)
    matches = match_levels(lambda *pair: counts[list(pair)], series.exposures, edges)
    samples = None
    if chart is not None:
        samples = chart_samples(chart.frames, series, chart.patches, name)
    check_range(series, name, matches, samples)
    saturates = bool(counts[:, -1].max() > _FEW * counts[0].sum())
    return _Evidence(name, saturates, matches, samples)


def _without_spill(
    series: Series, edges: FloatArray, channels: list[_Evidence], notes: list[str]
) -> list[_Evidence]:
    """Return the evidence without samples near saturated ones, where charge spills over.

    Where none does, or where the rest does not show the response, all samples count.
    """

    def clean(each: _Evidence) -> _Evidence:
        matches = match_levels(
            lambda *pair: series.counts_without_spill(each.name, series.black + edges, pair),
            series.exposures,
            edges,
        )
        return dataclasses.replace(each, matches=below_saturation(matches, float(edges[-1])))

    found = [clean(each) for each in channels]
    pairs = zip(channels, found, strict=True)
    if not any(spills_over(before.matches, after.matches) for before, after in pairs):
        return channels
    with suppress(DataError):
        for each in found:
            check_range(series, each.name, each.matches, each.samples)
        notes.append(_SPILLS)
        return found
    return channels


def measure_response(
    camera: Camera,
    *,
    count: int = FRAMES,
    longest_s: float = LONGEST_S,
    frames: list[NDArray[Any]] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Series:
    """Shoot an exposure series that suits the light before the camera; return it.

    The exposures are the true ones where the camera's controls know them, else those stated.

    Args:
        camera: an open camera
        count: number of frames, at least 2
        longest_s: longest shutter time, s
        frames: a list to which the frames are added
        progress: called with the share that is done, 0 to 1

    Raises:
        CaptureError: the scene is too dark or too bright for the camera's shutter times
        CameraError: as `Camera.shoot` raises
    """
    controls = camera.controls
    gain = controls.gain.nearest(1.0)
    settings = [ExposureSetting(time_s, gain) for time_s in _bracket(camera, count, longest_s)]
    series = Series(
        controls.layout,
        controls.bits,
        controls.black,
        controls.white,
        phase=controls.phase,
        levels_are_stated=True,
    )
    for frame in camera.shoot(settings):
        exposure = controls.exposure(frame.applied)
        series.add(frame.pixels, exposure, f"the frame of {frame.applied.time_s:.4g} s")
        if frames is not None:
            frames.append(frame.pixels)
        if progress is not None:
            progress(len(series.names) / len(settings))
    return series


def _bracket(camera: Camera, count: int, longest_s: float) -> list[float]:
    """Return up to `count` shutter times from dark frames to nearly saturated ones."""
    controls = camera.controls
    gain = controls.gain.nearest(1.0)
    shortest = controls.time_s.minimum
    longest = max(shortest, min(controls.time_s.maximum, longest_s))
    probes = 1 + max(1, math.ceil(math.log(longest / shortest, _PROBE_STEP)))
    times = sorted(
        {controls.time_s.nearest(float(each)) for each in np.geomspace(shortest, longest, probes)}
    )
    first, last = None, times[-1]
    half = controls.black + (controls.white - controls.black) / 2
    for frame in camera.shoot([ExposureSetting(time_s, gain) for time_s in times]):
        if first is None and np.mean(frame.pixels >= half) >= _FEW:
            first = frame.applied.time_s / _PROBE_STEP
        if np.mean(frame.pixels >= controls.white) >= 1 - 2 * _FEW:
            last = frame.applied.time_s
            break
    if first is None:
        raise CaptureError(
            f"the scene is too dark: it does not reach half of full scale at {times[-1]:.4g} s",
            hint="take the lens cap off, light the scene, or allow longer times (--longest)",
        )
    if last == times[0]:
        raise CaptureError(
            f"the scene is too bright: it is white even at {times[0]:.4g} s",
            hint="close the aperture, or put a filter in front of the lens",
        )
    wanted = np.geomspace(max(first, shortest), last, count)
    return sorted({controls.time_s.nearest(float(each)) for each in wanted})
