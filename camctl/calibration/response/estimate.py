"""The response of a camera from an exposure series of a scene that does not move.

Frames are reduced one by one to histograms and patches (`Series`), checked, and the curve of each
channel is estimated by `camctl.calibration.response.fit`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.limits import FEW
from camctl.calibration.response.chart import ChartPatch, chart_findings, chart_samples
from camctl.calibration.response.checks import (
    check_frames,
    check_order_of_patches,
    check_patches,
    check_range,
    shows_exposure,
)
from camctl.calibration.response.colours import NUMBERS, PatchRatios, score, series_matches
from camctl.calibration.response.exponent import (
    Exponent,
    common_exponent,
    expected_exponent,
    exponent_of_chart,
    with_exponent_error,
)
from camctl.calibration.response.fit import (
    ROUGH,
    STATED,
    ChartSamples,
    ResponseFit,
    fit_response,
)
from camctl.calibration.response.labels import LabelCheck, check_labels
from camctl.calibration.response.matches import LEAST_PIXELS, Matches, all_matches
from camctl.calibration.response.noise import correct_matches
from camctl.calibration.response.series import Series
from camctl.calibration.response.spill import spills_over
from camctl.errors import DataError
from camctl.findings import Finding
from camctl.model.response.camera import FloatArray
from camctl.profiles.response import ChannelResponse, ResponseRecord

#: Levels up to which a record keeps all, and of how many it keeps otherwise, at equal steps and at
#: equal factors: lines between these are within 0.01 % of a power.
_KEPT = 512


@dataclass(frozen=True, eq=False)
class ResponseEstimate:
    """An estimated response, and what else the frames say.

    Attributes:
        record: for the camera's profile
        exposures: of the frames relative to the first, as given or as estimated
        residual: root mean square error of matched irradiances, relative
        exponent_error: relative standard deviation of an exponent of the whole curve; None where it
            is unknown
        findings: what the user should know
        is_doubtful: something moved that could not be left out
    """

    record: ResponseRecord
    exposures: tuple[float, ...]
    residual: float
    exponent_error: float | None = None
    findings: tuple[Finding, ...] = ()
    is_doubtful: bool = False


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
    is_kept: bool = False,
    is_rough: bool = False,
    exposure_error: float = STATED,
) -> ResponseEstimate:
    """Return the response of each channel from an exposure series, or from frames of a chart.

    All channels have one curve, unless curves of their own explain the frames better by more than
    their numbers would by chance.

    Args:
        series: frames of different exposure of one scene; with a chart, one is enough
        estimate_ratios: estimate the approximate exposures (30 %), as where they are not stated
        chart: adds the brightness of its patches to what the frames say
        is_scene_checked: False: the caller checks exposures and movement itself
        is_kept: a finding, no refusal, where frames seem to have moved or have wrong exposures
        is_rough: movement, spill and noise are not looked for: for exposures, not for a curve
        exposure_error: standard deviation of the logarithm of an exposure that is stated

    Raises:
        DataError: the frames are not suitable; says why and what to do
    """
    series.find_limits()
    if not series.exposures_are_stated:
        series.guess_exposures()
        estimate_ratios = True
    exposure_error = ROUGH if estimate_ratios else exposure_error
    check_frames(series, has_chart=chart is not None)
    exposures = np.array(series.exposures)
    findings = list(series.findings)
    noted = partial(_noted, findings, is_kept=is_kept)
    if is_scene_checked:
        with noted():
            check_order_of_patches(series)
    is_doubtful = False
    if is_rough:
        channels = _together([_Evidence.of(series, each, chart) for each in series.channels])
    else:
        channels, is_doubtful = _still_evidence(series, chart, findings)
        channels = _without_spill(series, channels, findings)
    exponent = Exponent(1.0, 0.0)
    if estimate_ratios and exposures.size > 1 and (chart or not series.exposures_are_stated):
        exponent = common_exponent([each.exponent(exposures) for each in channels])
        exposures = exposures**exponent.value
        if chart is None:
            missing = {"times": None}
            findings.append(
                Finding(code="exponent_unknown", value=exponent.error, remedies=missing)
            )
    saturating = {name: _saturates(series, name) for name in series.channels}
    if exposures.size > 1 and not is_rough:
        channels = _without_noise(channels, exposures, exposure_error)
    channels, fits = _needed(channels, exposures)
    labels = LabelCheck(np.ones((len(channels), exposures.size)))
    if not estimate_ratios:
        if is_scene_checked:
            labels = _checked_scene(series, exposures, channels, fits, labels, noted)
        if labels.finding is not None:
            findings.append(labels.finding)
        pairs = zip(channels, exposures * labels.corrections, strict=True)
        fits = [each.fit(own, exposure_error) for each, own in pairs]
    for each, fit in zip(channels, fits, strict=True):
        if each.samples is not None:
            findings += chart_findings(each.samples, fit.patch_errors, each.name)
    if not is_rough:
        fits = _with_misfit(series, fits, exposure_error)
    fits = [with_exponent_error(fit, exponent.error + labels.exponent_error) for fit in fits]
    if estimate_ratios:
        exposures = np.exp(np.mean([np.log(fit.exposures) for fit in fits], axis=0))
    record = _record(series, channels, fits, saturating)
    return ResponseEstimate(
        record=record,
        exposures=tuple((exposures / exposures[0]).tolist()),
        residual=max(fit.residual for fit in fits),
        exponent_error=exponent.error or None,
        findings=tuple(each for k, each in enumerate(findings) if each not in findings[:k]),
        is_doubtful=is_doubtful,
    )


def _without_noise(
    channels: Sequence[_Evidence], exposures: FloatArray, exposure_error: float
) -> list[_Evidence]:
    """Return the evidence corrected for noise, by a first fit of all channels together."""
    first = [each.fit(exposures, exposure_error) for each in _together(list(channels))]
    return [
        each.without_noise(fit) for each, fit in zip(channels, first * len(channels), strict=False)
    ]


def _record(
    series: Series,
    channels: Sequence[_Evidence],
    fits: Sequence[ResponseFit],
    saturating: dict[str, bool],
) -> ResponseRecord:
    """Return the record of the fits; one fit is for all channels in `saturating`."""
    found = [each.response(fit) for each, fit in zip(channels, fits, strict=True)]
    if len(found) < len(saturating):
        found *= len(saturating)
    return ResponseRecord(
        channels=tuple(
            each.model_copy(update={"name": name, "saturates": saturates})
            for each, (name, saturates) in zip(found, saturating.items(), strict=True)
        ),
        phase=series.phase,
        frames=len(series.exposures),
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _needed(
    channels: list[_Evidence], exposures: FloatArray
) -> tuple[list[_Evidence], list[ResponseFit]]:
    """Return the evidence and the fit of all channels together, or of each one if it is needed."""
    together = _together(channels)
    fits = [each.fit(exposures, ROUGH) for each in together]
    if len(together) == len(channels):
        return channels, fits
    ratios = PatchRatios.of(channels[0].series)
    misfit, cells = ratios.misfit([fits[0].light], fits[0].exposures.tolist(), 0.0)
    is_enough = misfit <= cells
    if is_enough or any(each.matches.low.size < LEAST_PIXELS for each in channels):
        return together, fits
    apart = [each.fit(exposures, ROUGH) for each in channels]
    common = np.exp(np.mean([np.log(fit.exposures) for fit in apart], axis=0)).tolist()
    better, _ = ratios.misfit([fit.light for fit in apart], common, 0.0)
    is_better = score(better, cells, NUMBERS * len(channels)) < score(misfit, cells, NUMBERS)
    return (channels, apart) if is_better else (together, fits)


def _with_misfit(
    series: Series, fits: list[ResponseFit], exposure_error: float
) -> list[ResponseFit]:
    """Return fits whose deviations hold what patches show beyond the errors of the fit."""
    exposures = np.exp(np.mean([np.log(fit.exposures) for fit in fits], axis=0)).tolist()
    lights = [fit.light for fit in fits]
    misfit, cells = PatchRatios.of(series).misfit(lights, exposures, exposure_error)
    factor = math.sqrt(max(1.0, misfit / max(cells, 1)))
    return [replace(fit, deviation=factor * fit.deviation) for fit in fits]


def _together(channels: list[_Evidence]) -> list[_Evidence]:
    """Return one evidence of all channels; of a chart, which shows each colour, those given."""
    if len(channels) == 1 or channels[0].samples is not None:
        return channels
    main = channels[len(channels) // 2]
    return [replace(main, matches=all_matches([each.matches for each in channels]))]


def _saturates(series: Series, name: str) -> bool:
    """Return whether enough samples of a channel are saturated in one frame."""
    counts = series.counts_between(name, series.black + series.edges)
    return bool(counts[:, -1].max() > FEW * counts[0].sum())


def _checked_scene(
    series: Series,
    exposures: FloatArray,
    channels: Sequence[_Evidence],
    fits: Sequence[ResponseFit],
    labels: LabelCheck,
    noted: Callable[[], AbstractContextManager[None]],
) -> LabelCheck:
    """Check that nothing moved, and the stated exposures, by fits that estimate them, too.

    `labels` are returned where contradictions are kept.
    """
    names = [each.name for each in channels]
    for name, fit in zip(names, fits, strict=True):
        with noted():
            check_patches(series, name, fit)
    judged = np.array([shows_exposure(series, name) for name in names])
    with noted():
        return check_labels(series.names, exposures, names, fits, judged, is_shot=series.is_shot)
    return labels


@contextmanager
def _noted(findings: list[Finding], *, is_kept: bool) -> Iterator[None]:
    """Turn an error of the block into a finding where the user keeps the result all the same."""
    try:
        yield
    except DataError as error:
        if not is_kept:
            raise
        findings.append(Finding(code="response_doubtful", details={"why": error.what}))


def _kept(edges: FloatArray) -> NDArray[np.intp]:
    """Return the places of the levels that a record keeps, so close that lines join them well."""
    if edges.size <= _KEPT:
        return np.arange(edges.size)
    even = np.linspace(0, edges.size - 1, _KEPT // 2).round().astype(np.intp)
    dark = np.searchsorted(edges, np.geomspace(1, edges[-1], _KEPT))
    return np.unique(np.concatenate([even, dark]))


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What the frames say about one channel."""

    series: Series
    name: str
    matches: Matches
    samples: ChartSamples | None

    @classmethod
    def of(cls, series: Series, name: str, chart: Chart | None) -> _Evidence:
        """Return the evidence of a channel."""
        matches = series_matches(series, name)
        samples = None
        if chart is not None:
            samples = chart_samples(chart.frames, series, chart.patches, name)
        return cls(series, name, matches, samples)

    def fit(self, exposures: FloatArray, exposure_error: float) -> ResponseFit:
        return fit_response(
            self.matches,
            exposures.tolist(),
            self.series.edges,
            phase=self.series.phase,
            exposure_error=exposure_error,
            chart=self.samples,
        )

    def without_noise(self, first: ResponseFit) -> _Evidence:
        """Return the evidence with its matches corrected for noise, by a first estimate."""
        return replace(self, matches=correct_matches(self.matches, self.series, self.name, first))

    def without_spill(self) -> _Evidence:
        """Return the evidence without samples near saturated ones."""
        matches = series_matches(self.series, self.name, spill=False)
        # Above, the noise of samples decides which ones are near saturation.
        below = matches.high <= self.series.highest - self.series.black
        return replace(self, matches=matches.part(below))

    def exponent(self, exposures: FloatArray) -> Exponent:
        """Return the exponent of exposures that are known up to one."""
        fit = replace(self, samples=None).fit(exposures, ROUGH)
        if self.samples is None:
            return expected_exponent(fit)
        return exponent_of_chart(fit, self.samples)

    def response(self, fit: ResponseFit) -> ChannelResponse:
        series, kept = self.series, _kept(fit.edges)
        levels = series.white - series.black
        found = [self.matches.low, self.matches.high]
        found += [] if self.samples is None else [self.samples.level]
        seen = np.concatenate(found)
        brightness, measured = (
            (each - series.phase) / (levels + 1)
            for each in (fit.edges[kept], np.array([seen.min(), seen.max()]))
        )
        deviation = fit.deviation[kept].tolist()
        return ChannelResponse(
            name=self.name,
            black=series.black,
            white=series.white,
            saturates=False,
            irradiance=(0.0, *fit.irradiance[kept].tolist(), 1.0),
            brightness=(0.0, *brightness.tolist(), 1.0),
            deviation=(deviation[0], *deviation, deviation[-1]),
            measured=tuple(measured.tolist()),
        )


def _left_out(what: str, share: float | None = None) -> Finding:
    return Finding(code="left_out", value=share, details={"what": what})


def _still_evidence(
    series: Series, chart: Chart | None, findings: list[Finding]
) -> tuple[list[_Evidence], bool]:
    """Return the evidence of each channel without what moved, if the rest shows the response.

    Return whether it does not, too.
    """
    series.find_moved()
    is_doubtful = bool(series.moved_share)
    if is_doubtful:
        share = series.moved_share
        with suppress(DataError):
            found = [_Evidence.of(series, name, chart) for name in series.channels]
            _check_ranges(series, found)
            findings.append(_left_out("movement", share))
            return found, False
        series.forget_moved()
        findings.append(_left_out("none", share))
    found = [_Evidence.of(series, name, chart) for name in series.channels]
    _check_ranges(series, found)
    return found, is_doubtful


def _check_ranges(series: Series, channels: list[_Evidence]) -> None:
    """Check that all channels together show enough of the curve; raises `DataError`."""
    for each in _together(channels):
        check_range(series, each.name, each.matches, each.samples)


def _without_spill(
    series: Series, channels: list[_Evidence], findings: list[Finding]
) -> list[_Evidence]:
    """Return the evidence without samples near saturated ones, where charge spills over.

    Where none does, or where the rest does not show the response, all samples count.
    """
    found = [each.without_spill() for each in channels]
    pairs = zip(channels, found, strict=True)
    if not any(spills_over(before.matches, after.matches) for before, after in pairs):
        return channels
    with suppress(DataError):
        _check_ranges(series, found)
        findings.append(_left_out("saturation"))
        return found
    return channels
