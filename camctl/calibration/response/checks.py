"""Checks of an exposure series: whether it can show a response, and what would help where not."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.light import all_saturated, moved
from camctl.calibration.limits import DIM, FEW, LEAST_PATCHES, MOST_MOVED
from camctl.calibration.response.fit import ChartSamples, ResponseFit
from camctl.calibration.response.matches import Matches
from camctl.calibration.response.series import Series
from camctl.errors import DataError
from camctl.findings import Finding
from camctl.model.quantiles import Z_95, median
from camctl.model.response.camera import FloatArray
from camctl.profiles.response import ResponseRecord

#: Distance from both ends, share of full scale, up to which a response must be measured, and the
#: same with a chart, whose darkest patch has brightness 0.2 in sRGB.
_ENDS, _ENDS_OF_CHART = 0.15, 0.3
#: Brightness, shares of full scale, between which the 95 % interval of a response is judged.
_JUDGED = (0.05, 0.95)
#: Half the 95 % interval of irradiance, relative, up to which a response is kept: it changes a
#: logarithmic picture over 1:1,000 by 1 % of its range.
KEPT = 0.07
#: Factor between exposures that is wide: larger ones show less of the curve (bench_response.py).
_WIDE_STEP = 2.5
#: Patches whose light deviates by this much have moved, relative.
_MOVED = 0.12
#: Share of the pairs of patches in reversed order from which the scene moved: a thing that covers
#: this share of the picture reverses about as many.  Most patches that are compared.
_MOST_REVERSED, _MOST_PATCHES = 0.05, 600


def check_frames(series: Series, *, has_chart: bool = False) -> None:
    """Check that there are different frames with different exposures and something to see.

    With a chart a single frame is enough.

    Raises:
        DataError: there are not
    """
    exposures = np.array(series.exposures)
    if not has_chart and (exposures.size < 2 or exposures.max() < 1.05 * exposures.min()):
        count = len(np.unique(exposures))
        raise DataError(
            f"{exposures.size} frame{'s' * (exposures.size != 1)} with {count} different "
            f"exposure{'s' * (count != 1)}: a response needs at least 2",
            hint="give 3 or more frames of one scene, each with 2 to 4 times the exposure of the "
            "one before",
        )
    span = series.white - series.black
    lit = [np.mean(each > series.black + DIM * span) for each in series.patches]
    if max(lit) < FEW:
        raise DataError(
            "all frames are black", hint="take the lens cap off, light the scene, or expose longer"
        )
    if min(np.mean(each >= series.white) for each in series.patches) > 1 - FEW:
        raise all_saturated()
    for first, second in combinations(range(exposures.size), 2):
        if not np.array_equal(series.patches[first], series.patches[second]):
            continue
        same = f"{series.names[first]} and {series.names[second]} are the same picture"
        if exposures[first] != exposures[second]:
            raise DataError(
                f"{same}, but their exposures differ",
                hint=(
                    "use a scene with dark and bright parts and many shades"
                    if series.is_shot
                    else "leave one of them out, or correct its exposure"
                ),
            )
        names = {"first": series.names[first], "second": series.names[second]}
        series.findings.append(
            Finding(code="left_out", frames=(first, second), details={"what": "copy", **names})
        )
    _check_order(series, exposures)


def _check_order(series: Series, exposures: FloatArray) -> None:
    order = np.argsort(exposures)
    limit = 0.02 * (series.white - series.black)
    middles = [median(each.mean(axis=1)) for each in series.patches]
    for short, long in pairwise(order.tolist()):
        if exposures[long] < 1.05 * exposures[short]:
            continue
        if middles[short] - middles[long] > limit:
            raise DataError(
                f"{series.names[short]} is brighter than {series.names[long]}, though its exposure "
                "is shorter",
                hint=(
                    "use daylight or a lamp that does not flicker, before a scene that does not "
                    "move"
                    if series.is_shot
                    else "check the order of the exposures and of the frames, that the light is "
                    "steady, and that no file is damaged"
                ),
            )


def check_range(
    series: Series, channel: str, matches: Matches, chart: ChartSamples | None = None
) -> None:
    """Check that the matches, and the patches of a chart, reach from dark to bright.

    The fit knows how certain the curve is in a gap between them.

    Raises:
        DataError: they do not; says which exposures would help
    """
    exposures = np.array(series.exposures)
    shortest, longest = exposures.min(), exposures.max()
    levels = (
        [matches.low, matches.high] if chart is None else [matches.low, matches.high, chart.level]
    )
    found = np.unique(np.concatenate(levels)) / (series.white - series.black)
    ends = _ENDS if chart is None else _ENDS_OF_CHART
    where = f"channel {channel}: " if len(series.channels) > 1 else ""
    if found.size == 0:
        raise DataError(
            f"{where}no brightness occurs in two frames",
            hint=f"{helpful_exposures(series.exposures, 1.0)}, and use a scene with many shades",
        )
    if found[-1] < 1 - ends:
        raise DataError(
            f"{where}the frames show the response only up to {found[-1]:.0%} of full scale",
            hint=f"add frames of exposure {2 * longest:.3g} and {4 * longest:.3g}, or a brighter "
            "object",
        )
    if found[0] > ends:
        raise DataError(
            f"{where}the frames show the response only from {found[0]:.0%} of full scale on",
            hint=f"add frames of exposure {shortest / 2:.3g} and {shortest / 4:.3g}, or a darker "
            "object",
        )


class Intervals(NamedTuple):
    """Halves of the 95 % intervals of irradiance, relative, of a response.

    Attributes:
        widest: the largest of them
        brightness: where it is, a share of full scale
    """

    widest: float
    brightness: float


def intervals_of(record: ResponseRecord) -> Intervals | None:
    """Return the intervals between `_JUDGED` of full scale, where the frames show the response.

    Of the channel with the widest one; None where the method gives none.
    """
    found = []
    for channel in record.channels:
        if channel.deviation is None:
            return None
        low, high = np.clip(channel.measured, *_JUDGED).tolist()
        brightness = np.linspace(low, high, 181)
        half = Z_95 * np.interp(brightness, channel.brightness, channel.deviation)
        found.append(Intervals(float(half.max()), float(brightness[half.argmax()])))
    return max(found)


def inexactness(
    record: ResponseRecord, exposures: Sequence[float], *, has_profile: bool
) -> Finding | None:
    """Return why a response is not exact enough for a profile; None where it is."""
    intervals = intervals_of(record)
    if intervals is None or intervals.widest <= KEPT:
        return None
    return Finding(
        code="response_inexact",
        value=intervals.widest,
        details={
            "brightness": intervals.brightness,
            "needed": KEPT,
            "help": helpful_exposures(exposures, intervals.brightness),
            "has_profile": has_profile,
        },
        remedies={"keep": True} if has_profile else {},
    )


def helpful_exposures(exposures: Sequence[float], brightness: float) -> str:
    """Return which exposures would make a response better known at a brightness, a share."""
    ordered = np.unique(exposures)
    if ordered.size < 2:
        return f"add frames of exposure {ordered[0] / 2:.3g} and {ordered[0] * 2:.3g}"
    widest = int(np.argmax(ordered[1:] / ordered[:-1]))
    if ordered[widest + 1] > _WIDE_STEP * ordered[widest]:
        return f"add a frame of exposure {np.sqrt(ordered[widest] * ordered[widest + 1]):.3g}"
    if brightness > 1 / 2:
        return f"add a frame of exposure {2 * ordered[-1]:.3g}, or a brighter object"
    return f"add a frame of exposure {ordered[0] / 2:.3g}, or a darker object"


def shows_exposure(series: Series, channel: str) -> NDArray[np.bool_]:
    """Return whether enough samples of a channel are well exposed in each frame, (J,)."""
    least = series.black + DIM * (series.white - series.black)
    shares = []
    for position in range(len(series.exposures)):
        samples = series.channel_patches(position, channel)
        shares.append(np.mean((samples > least) & (samples <= series.highest)))
    return np.array(shares) >= 2 * FEW


def check_order_of_patches(series: Series) -> None:
    """Check that the scene stood still, whatever the response and the exposures are.

    Every response keeps the order of quantiles: a patch whose lower quartile is above the upper one
    of another patch is the brighter one in every frame.

    Raises:
        DataError: such patches have another order in the next frame
    """
    for channel in series.channels:
        for pair in series.neighbours(channel):
            # Of many patches some are taken.
            levels = pair.levels[:, :: 1 + pair.levels.shape[1] // _MOST_PATCHES]
            low, high = np.quantile(levels, (0.25, 0.75), axis=2)
            brighter = low[:, :, None] > high[:, None, :]
            certain = np.all(brighter | brighter.transpose(0, 2, 1), axis=0)
            turned = np.count_nonzero(brighter[0] & brighter[1].T)
            if turned > _MOST_REVERSED * max(np.count_nonzero(certain) / 2, LEAST_PATCHES):
                names = f"{series.names[pair.short]} and {series.names[pair.long]}"
                raise moved(f"{names} do not show the same")


def check_patches(series: Series, channel: str, fit: ResponseFit) -> None:
    """Check that the scene stood still, by the light of patches in neighbouring exposures.

    A factor that all patches have does not count: it is one of the exposure or of the light.  Nor
    does what noise, or a curve that is hardly known, may be.

    Args:
        series: the frames
        channel: name of the channel
        fit: the response when the exposures are estimated, too

    Raises:
        DataError: scene or camera moved
    """
    for pair in series.neighbours(channel):
        if pair.levels.shape[1] < LEAST_PATCHES:
            continue
        low, high = fit.light[pair.levels]
        ratios = high.mean(axis=1) / low.mean(axis=1)
        scatter = (high - ratios[:, None] * low).std(axis=1) / high.mean(axis=1)
        curve = np.interp(pair.levels, fit.edges, fit.deviation).mean(axis=2)
        deviations = np.sqrt(scatter**2 / low.shape[1] + np.square(curve).sum(axis=0))
        errors = np.abs(np.log(ratios / median(ratios)))
        share = float(np.mean(errors > _MOVED + Z_95 * deviations))
        if share > MOST_MOVED:
            names = f"{series.names[pair.short]} and {series.names[pair.long]}"
            raise moved(f"{share:.0%} of the picture differs between {names}")
