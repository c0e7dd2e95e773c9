"""Where the frames of a window contradict each other: what moved between two exposures.

As in `camctl.evidence`, the longer of two frames neighbouring in exposure predicts the shorter one.
Here single samples decide, by two tables for each pair: means over areas, which show weaker
contradictions, take longer than a frame.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import NormalDist
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.edges import local_ranges
from camctl.evidence.light_ratio import MOST_CHANGE, NeighbourCheck
from camctl.evidence.marks import FALSE_ALARMS
from camctl.evidence.patches import sample_patches
from camctl.evidence.ratio_check import RatioCheck
from camctl.evidence.residual import Limits, Pair, Side
from camctl.findings import Finding
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.model.noise import FrameNoise
from camctl.model.sensor import SensorModel
from camctl.system.number_text import time_text

_Mask = NDArray[np.bool_]
_Settings = tuple[ExposureSetting, ExposureSetting]

#: Pairs of settings whose limits are kept: of two lists of 16.
_KEPT = 32


class Disagreement:
    """Compares the frames of one result after the other; a pair is compared once.

    Args:
        controls: of the camera
    """

    def __init__(self, controls: ExposureControls) -> None:
        self._controls = controls
        self._sensor = SensorModel(controls.levels, controls.black)
        self._limits: dict[tuple[_Settings, int], Limits] = {}
        self._found: dict[tuple[int, int], tuple[Frame, Frame, _Mask]] = {}

    def mask(self, frames: Sequence[Frame]) -> _Mask | None:
        """Return where frames contradict, in the shape of a frame; None: there is only one."""
        controls = self._controls
        ordered = sorted(frames, key=lambda frame: controls.exposure(frame.applied))
        pairs = list(pairwise(ordered))
        found: dict[tuple[int, int], tuple[Frame, Frame, _Mask]] = {}
        for short, long in pairs:
            key = id(short), id(long)
            # The frames are kept with the mask, so that their ids stay theirs.
            found[key] = self._found.get(key) or (
                short,
                long,
                self._compare(short, long, len(pairs)),
            )
        self._found = found
        masks = [mask for _, _, mask in found.values()]
        if len(masks) < 2:
            return masks[0] if masks else None
        total = masks[0] | masks[1]
        for mask in masks[2:]:
            total |= mask
        return total

    def _compare(self, short: Frame, long: Frame, pairs: int) -> _Mask:
        key = (short.applied, long.applied), pairs
        limits = self._limits.get(key)
        if limits is None:
            if len(self._limits) >= _KEPT:
                del self._limits[next(iter(self._limits))]
            limits = self._limits[key] = self._limits_of(short, long, pairs)
        ranges = None
        if limits.pair.is_processed:
            ranges = local_ranges(long.pixels, self._controls.white)
        return limits.outside(short.pixels, long.pixels, ranges)

    def _limits_of(self, short: Frame, long: Frame, pairs: int) -> Limits:
        controls = self._controls
        both = short, long
        exposures = [controls.exposure(each.applied) for each in both]
        noise: Sequence[FrameNoise | None] = (None, None)
        if controls.noise is not None and len(controls.responses) < 2:
            noise = controls.frame_noise([each.applied for each in both])
        colours = 3 if noise[0] is None and controls.layout is Layout.RGB else 1
        before, after = (
            sample_patches(controls.layout.planes(each.pixels), controls.white) for each in both
        )
        pair = Pair(
            self._sensor,
            Side(0, exposures[0], noise[0]),
            Side(1, exposures[1], noise[1]),
            exposures[1] / exposures[0],
            (before, after),
            colours,
        )
        return pair.limits(-NormalDist().inv_cdf(FALSE_ALARMS / 2 / pairs))


@dataclass(frozen=True)
class OtherExposures:
    """Frames of a round that show other exposures than theirs.

    Attributes:
        exposures: that they should have, in the order of the cycle
        pairs: positions of two frames neighbouring in exposure whose ratio of light is known, and
            what their checks found; some contradict their exposures
    """

    exposures: tuple[float, ...]
    pairs: dict[tuple[int, int], RatioCheck]

    @property
    def come_late(self) -> bool:
        """Whether they fit exposures that were set some frames before their own."""
        count = len(self.exposures) if self.pairs else 0
        return any(
            all(
                self._off(check, self.exposures[b - late] / self.exposures[a - late]) == 0
                for (a, b), check in self.pairs.items()
            )
            for late in range(1, count)
        )

    @property
    def may_be_lamps(self) -> bool:
        """Whether lamps that flicker explain all of them."""
        wrong = [check for check in self.pairs.values() if not check.agrees]
        return bool(wrong) and all(check.may_be_lamps for check in wrong)

    def reason(self, before: OtherExposures) -> Literal["exposures", "light", "delay"]:
        """Return why frames of two looks in a row have other exposures than theirs."""
        if self.are_those_of(before) and not self.come_late:
            return "exposures"  # that the camera does not make
        lamps = self.may_be_lamps and before.may_be_lamps
        return "light" if lamps and not (self.come_late and before.come_late) else "delay"

    def is_of_plan(self, other: OtherExposures) -> bool:
        """Return whether they should have the exposures of others."""
        return self.exposures == other.exposures

    def are_those_of(self, other: OtherExposures) -> bool:
        """Return whether other frames of the same plan have the same exposures."""
        return bool(self.pairs) and all(
            self._off(check, other.pairs[pair].measured or 0.0) == 0
            for pair, check in self.pairs.items()
            if pair in other.pairs
        )

    @staticmethod
    def _off(check: RatioCheck, ratio: float) -> float:
        """Return by how much more than noise a ratio differs from a measured one, as logarithm."""
        assert check.measured is not None  # of all pairs
        off = abs(math.log(max(ratio, 1e-9) / check.measured))
        return max(0.0, off - 2 * math.log1p(check.tolerance))

    def finding(self, settings: Sequence[ExposureSetting]) -> Finding:
        """Return the largest difference; `settings` are those of the plan."""
        pair = max(self.pairs, key=lambda pair: self.pairs[pair].factor)
        check = self.pairs[pair]
        before, name = (f"the frame of {time_text(settings[k].time_s)}" for k in pair)
        return Finding(
            code="exposure_differs",
            frames=pair,
            value=(check.measured or 0.0) / check.expected,
            details={
                "expected": check.expected,
                "certain": not self.may_be_lamps,
                "name": name,
                "before": before,
            },
        )


def other_exposures(controls: ExposureControls, frames: Sequence[Frame]) -> OtherExposures | None:
    """Return what frames show, in the order of the cycle, if they show other exposures."""
    check = NeighbourCheck(controls.levels, controls.black, controls.layout, len(frames))
    noise = controls.frame_noise([frame.applied for frame in frames])
    samples = [
        check.sample(frame.pixels, each if controls.noise else None)
        for frame, each in zip(frames, noise, strict=True)
    ]
    exposures = [controls.exposure(frame.applied) for frame in frames]
    order = sorted(range(len(frames)), key=exposures.__getitem__)
    checks = {
        (a, b): check.compare(samples[a], samples[b], exposures[b] / exposures[a])
        for a, b in pairwise(order)
    }
    known = {pair: found for pair, found in checks.items() if found.measured is not None}
    # Little of a dim picture can be compared.  Things that move there give no ratio that stays.
    if not any(
        found.shows_another_exposure(exposures_exact=controls.exposures_exact)
        or (not found.agrees and found.is_one_ratio and found.factor > MOST_CHANGE)
        for found in checks.values()
    ):
        return None
    return OtherExposures(tuple(exposures), known)
