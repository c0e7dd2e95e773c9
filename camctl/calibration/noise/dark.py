"""Dark current, offsets of the pixels and hot pixels, from frames with the lens cap on.

Two frames or more of each of some shutter times are shot.  What both frames of a time have in
common is the pixels' fixed pattern; its mean grows with time by the dark current.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.intervals import root_of_ratio
from camctl.calibration.light import check_size
from camctl.calibration.limits import DIM, FEW
from camctl.calibration.noise.pattern import HOT
from camctl.errors import DataError
from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureSetting
from camctl.model.quantiles import NORMAL_MAD, Z_95, student
from camctl.model.response.camera import FloatArray
from camctl.profiles.noise import (
    MOST_HOT_PIXELS,
    DarkRecord,
    Figure,
    GainNoise,
    HotPixel,
    NoiseRecord,
)

#: Shutter times, and the longest one unless another is asked for, s.
TIMES, LONGEST_S = 5, 4.0
#: Share of the samples of a frame without light that are not hot.
_NOT_HOT = 0.95
#: Noise of a sample, with rounding, that the frames need, DN.
_LEAST_NOISE = 0.4


@dataclass(eq=False)
class DarkFrames:
    """Sums of frames without light by shutter time: two frames of each time are kept.

    Attributes:
        black: stated brightness without light, DN
        white: brightness from which samples are saturated, DN
        frames: by shutter time, two of each
    """

    black: int
    white: int
    frames: dict[float, list[NDArray[Any]]] = field(default_factory=dict)

    def add(self, pixels: NDArray[Any], time_s: float) -> None:
        """Add a frame; a third frame of a time is not used.

        Raises:
            DataError: the frame is not dark, or has another size than the first
        """
        first = next(iter(self.frames.values()), [pixels])[0]
        check_size(pixels.shape, first.shape, f"the frame of {time_s:.4g} s", "the first one")
        light = float(np.quantile(pixels, _NOT_HOT) - self.black) / (self.white - self.black)
        if light > DIM:
            raise DataError(
                f"the frame of {time_s:.4g} s is not dark: the brightest twentieth of it has "
                f"{light:.0%} of full scale or more",
                hint="put the lens cap on, and cover the viewfinder",
            )
        pair = self.frames.setdefault(time_s, [])
        if len(pair) < 2:
            pair.append(pixels)


def estimate_dark(frames: DarkFrames, at: GainNoise) -> DarkRecord:
    """Return what frames without light show.

    Args:
        frames: two of each of two or more shutter times
        at: the noise at the gain of the frames

    Raises:
        DataError: there are too few frames or times, or noise is cut at black or hidden by rounding
    """
    times = sorted(time_s for time_s, pair in frames.frames.items() if len(pair) == 2)
    if len(times) < 2 or times[-1] < 2 * times[0]:
        raise DataError(
            f"there are pairs of dark frames of {len(times)} shutter times",
            hint="give two frames of each of two or more times, the longest at least twice the "
            "shortest",
        )
    if np.mean(frames.frames[times[0]][0] == 0) > FEW:
        raise DataError(
            "the camera has no black level: the noise around black is cut at 0, so that dark "
            "current and offsets do not show",
            hint="use camera raw files, if it has them",
        )
    pairs = [[each.astype(np.float32) for each in frames.frames[time_s]] for time_s in times]
    noise = float(np.std(pairs[0][0] - pairs[0][1])) / math.sqrt(2)
    if noise < _LEAST_NOISE:
        raise DataError(
            f"the noise without light is {noise:.2f} levels: rounding hides offsets and dark "
            f"current (it takes {_LEAST_NOISE:g})",
            hint="use a camera mode with more bits",
        )
    electrons = at.conversion_e_per_dn
    hot = _hot_pixels(times, pairs, frames.white, electrons.value)
    cool = np.ones(pairs[0][0].shape, np.bool_)
    cool[[each.row for each in hot], [each.column for each in hot]] = False
    means = np.array([[each[cool].mean(dtype=np.float64) for each in pair] for pair in pairs])
    black, current = _line(np.repeat(times, 2), means.ravel())
    shortest, longest = pairs[0], pairs[-1]
    offsets = _deviation(shortest[0], shortest[1], cool)
    # What grows is in the differences, in which the offsets cancel.
    rates = _deviation(longest[0] - shortest[0], longest[1] - shortest[1], cool)
    return DarkRecord(
        gain=at.gain,
        times_s=tuple(times),
        dark_current_e_s=current.times(electrons),
        dsnu_e=offsets.times(electrons),
        dcnu_e_s=rates.scaled(1 / (times[-1] - times[0])).times(electrons),
        black_dn=black,
        hot_pixels=tuple(hot),
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _line(times: FloatArray, means: FloatArray) -> tuple[float, Figure]:
    """Return the brightness at time 0, and its growth: a straight line through the frames.

    What the pixels of a frame share, such as the noise of its rows, is part of the scatter of the
    frames about the line, from which the interval comes.
    """
    centred = times - times.mean()
    slope = float(centred @ means / np.square(centred).sum())
    start = float(means.mean() - slope * times.mean())
    freedom = times.size - 2
    scatter = np.square(means - start - slope * times).sum() / freedom
    half = student(Z_95, freedom) * math.sqrt(float(scatter / np.square(centred).sum()))
    ends = [max(0.0, slope + turn * half) for turn in (-1, 0, 1)]
    return start, Figure(low=ends[0], value=ends[1], high=ends[2])


def _hot_pixels(
    times: Sequence[float],
    pairs: Sequence[Sequence[NDArray[np.float32]]],
    white: int,
    electrons: float,
) -> list[HotPixel]:
    """Return the pixels that are far brighter than others, and more so after a longer time."""
    a, b = pairs[-1]
    noise = float(np.median(np.abs(a - b))) / (NORMAL_MAD * math.sqrt(2))
    lower = np.minimum(a, b)
    middle = float(np.median(lower))
    pattern = float(np.median(np.abs(lower - middle))) / NORMAL_MAD
    excess = HOT * max(pattern, noise, 0.5)
    found = np.nonzero(lower > middle + excess)
    signals = [(first[found] + second[found]) / 2 for first, second in pairs]
    growth = [
        signal - float(np.median(first)) for signal, (first, _) in zip(signals, pairs, strict=True)
    ]
    rates = np.zeros(signals[0].shape)
    for k in range(1, len(times)):  # the longest time at which a pixel is not saturated counts
        rate = (growth[k] - growth[0]) / (times[k] - times[0])
        rates = np.where((signals[k] < white) | (k == 1), rate, rates)
    grows = rates * (times[-1] - times[0]) > excess / 2
    hot: dict[tuple[int, int], float] = {}
    for row, column, rate in zip(*(each[grows] for each in (*found[:2], rates)), strict=True):
        place = (int(row), int(column))
        hot[place] = max(hot.get(place, 0.0), float(rate) * electrons)
    brightest = sorted(hot.items(), key=lambda each: -each[1])[:MOST_HOT_PIXELS]
    return [HotPixel(row=row, column=column, rate_e_s=rate) for (row, column), rate in brightest]


def _deviation(
    first: NDArray[np.float32], second: NDArray[np.float32], counts: NDArray[np.bool_]
) -> Figure:
    """Return the standard deviation of the pattern that two pictures have in common.

    It is the root of their covariance about the mean of each.
    """
    centres = [float(each[counts].mean(dtype=np.float64)) for each in (first, second)]
    products = np.where(counts, (first - centres[0]) * (second - centres[1]), 0.0)
    rows = (each.sum(axis=1, dtype=np.float64) for each in (products, counts))
    return root_of_ratio([np.stack([*rows], axis=1)])


def measure_dark(
    camera: Camera,
    record: NoiseRecord,
    *,
    longest_s: float = LONGEST_S,
    progress: Callable[[float], None] | None = None,
) -> DarkRecord:
    """Shoot frames with the lens cap on, and return what they show.

    Args:
        camera: an open camera with the lens cap on
        record: of the same camera mode, before a scene; of its gains, the lowest is used at which
            noise without light shows beside rounding
        longest_s: longest shutter time, s
        progress: called with the share that is done, 0 to 1

    Raises:
        DataError: the frames are not dark, or cannot show anything; says why and what to do
        CameraError: as `Camera.shoot` raises
    """
    controls = camera.controls
    showing = (
        each
        for each in record.gains
        if each.read_noise_e.value > _LEAST_NOISE * each.conversion_e_per_dn.value
    )
    at = next(showing, record.gains[-1])
    longest = max(controls.time_s.minimum, min(controls.time_s.maximum, longest_s))
    requested = np.linspace(controls.time_s.minimum, longest, TIMES)
    times = sorted({controls.time_s.nearest(float(each)) for each in requested})
    frames = DarkFrames(controls.black, controls.white)
    settings = [ExposureSetting(time_s, at.gain) for time_s in times for _ in (0, 1)]
    for done, frame in enumerate(camera.shoot(settings)):
        frames.add(frame.pixels, frame.requested.time_s)
        if progress is not None:
            progress((done + 1) / len(settings))
    return estimate_dark(frames, at)
