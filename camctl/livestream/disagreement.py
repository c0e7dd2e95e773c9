"""Where the frames of a window contradict each other: what moved between two exposures.

As in `camctl.evidence`, the longer of two frames neighbouring in exposure predicts the shorter one.
Here single samples decide, by two tables for each pair: means over areas, which show weaker
contradictions, take longer than a frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from camctl.evidence.edges import local_ranges
from camctl.evidence.light_ratio import NeighbourCheck
from camctl.evidence.marks import FALSE_ALARMS
from camctl.evidence.patches import sample_patches
from camctl.evidence.residual import Limits, Pair, Side
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.model.noise import FrameNoise
from camctl.model.sensor import SensorModel

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


def contradict(controls: ExposureControls, frames: Sequence[Frame]) -> bool:
    """Return whether frames show other exposures than theirs, as a picture of them would say."""
    check = NeighbourCheck(controls.levels, controls.black, controls.layout, len(frames))
    noise = controls.frame_noise([frame.applied for frame in frames])
    samples = [
        check.sample(frame.pixels, each if controls.noise else None)
        for frame, each in zip(frames, noise, strict=True)
    ]
    exposures = [controls.exposure(frame.applied) for frame in frames]
    order = sorted(range(len(frames)), key=exposures.__getitem__)
    return any(
        check.compare(samples[a], samples[b], exposures[b] / exposures[a]).shows_another_exposure(
            exposures_exact=controls.exposures_exact
        )
        for a, b in pairwise(order)
    )
