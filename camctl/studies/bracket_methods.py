"""Ways to choose the exposures of a bracket, each as the settings of one camera.

All begin at the same metered base: full scale of the shortest exposure is E = 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from camctl.errors import CaptureError, UnreachableExposureError
from camctl.exposure.brackets import bracket as fixed_steps
from camctl.exposure.brackets import near_gain_1
from camctl.exposure.build import look_up
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.search.front import Front
from camctl.exposure.search.wall_time import gain_choices
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.response.desired import DesiredResponse
from camctl.studies.noise_optimal import NoiseOptimalProblem, noise_optimal

PRINTED_TABLE: dict[tuple[str, int], tuple[float, ...]] = {
    ("linear", 2): (1, 1.003),
    ("linear", 3): (1, 1.003, 2.985),
    ("linear", 4): (1, 1.015, 1.019, 3.672),
    ("linear", 5): (1, 1.003, 1.007, 1.166, 4.975),
    ("linear", 6): (1, 1.003, 1.007, 1.031, 1.078, 5.636),
    ("gamma", 2): (1, 3.094),
    ("gamma", 3): (1, 1.003, 5.146),
    ("gamma", 4): (1, 1.003, 3.019, 11.23),
    ("gamma", 5): (1, 1.003, 1.006, 5.049, 18.56),
    ("gamma", 6): (1, 1.003, 1.006, 2.866, 8.564, 33.7),
    ("log", 2): (1, 20.24),
    ("log", 3): (1, 9.91, 88.38),
    ("log", 4): (1, 4.689, 37.23, 280),
    ("log", 5): (1, 4.831, 29.18, 144.9, 763.5),
    ("log", 6): (1, 3.979, 16.01, 64.22, 305.4, 1130),
}
"""Printed exposures by desired response (gamma is 1/2) and number of exposures."""


@dataclass(frozen=True)
class Bracket:
    """What the methods choose exposures for.

    Attributes:
        controls: of the camera
        request: the response, the range and the number of exposures
        base_s: longest shutter time of the shortest exposure at gain 1, as metered, s
        before: the setting of the frame before, such as the metering frame
    """

    controls: ExposureControls
    request: CaptureRequest
    base_s: float
    before: ExposureSetting | None = None

    @property
    def desired(self) -> DesiredResponse:
        """The desired response."""
        desired = self.request.desired
        assert desired is not None  # "auto" is no response of a study
        return desired

    @property
    def count(self) -> int:
        """The number of exposures."""
        assert self.request.count is not None  # it is given
        return self.request.count

    def at_gain(self, exposures: Sequence[float]) -> tuple[ExposureSetting, ...]:
        """Return settings at gain 1 for relative exposures; gain extends the longest time."""
        return near_gain_1(self.controls, self.base_s, exposures)


def _xi(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    row = look_up(bracket.controls.levels, bracket.desired, bracket.count)
    return bracket.at_gain(tuple(row.exposures))


def _stops(stops: float, bracket: Bracket) -> tuple[ExposureSetting, ...]:
    return fixed_steps(bracket.controls, bracket.base_s, bracket.count, stops)


def _hasinoff(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    """At equal time: the shutter time of the most accurate set of as many exposures."""
    controls, noise = bracket.controls, bracket.controls.noise
    if noise is None:
        raise CaptureError("it needs the noise of the camera, which is not known")
    count = CaptureRequest(count=bracket.count)
    front = Front(controls, bracket.desired, bracket.base_s, request=count, before=bracket.before)
    accurate = front.chosen.settings
    base_s = min(setting.exposure for setting in accurate)  # as applied
    problem = NoiseOptimalProblem(
        noise=noise,
        full_scale_levels=controls.levels.M + 1,
        e_min=bracket.desired.e_min,
        gains=gain_choices(controls.gain),
        longest=controls.time_s.maximum / base_s,
        budget=math.fsum(setting.time_s for setting in accurate) / base_s * (1 + 1e-9),
        unit_s=base_s,
    )
    found = noise_optimal(problem, bracket.count)
    return tuple(
        ExposureSetting(controls.time_s.nearest(time * base_s), gain)
        for time, gain in zip(found.times, found.gains, strict=True)
    )


FRONT = "front"
"""The method of the curve that all others are compared with; its runs have their settings."""

METHODS: dict[str, Callable[[Bracket], tuple[ExposureSetting, ...]]] = {
    "xi": _xi,
    "paper": lambda each: each.at_gain(PRINTED_TABLE[each.desired.key, each.count]),
    "hasinoff": _hasinoff,
    "equal": partial(_stops, 0),
    "doubling": partial(_stops, 1),
    "2-stop": partial(_stops, 2),
    "3-stop": partial(_stops, 3),
}
"""Each returns the settings of a bracket, by ascending exposure."""

COUNTS = {
    **dict.fromkeys(METHODS, range(1, 7)),
    "doubling": range(1, 8),
    **dict.fromkeys(("2-stop", "3-stop"), (3, 5, 7)),
}
"""Numbers of exposures if none are asked for: those of the paper's table, and the 3, 5 or 7 frames
that the exposure bracketing of many cameras takes, 1, 2 or 3 stops apart."""

LABELS = {
    FRONT: "most accurate in its time",
    "xi": "least missing levels (xi)",
    "paper": "printed in the paper",
    "hasinoff": "best worst-case SNR (Hasinoff 2010)",
    "equal": "equal exposures",
    "doubling": "1, 2, 4, ...; cameras: 3, 5, 7",
    "2-stop": "1, 4, 16, ... on cameras",
    "3-stop": "1, 8, 64, ... on cameras",
}
"""What each method is, for people."""


def offers(method: str, desired: DesiredResponse, count: int) -> bool:
    """Return whether a method has exposures for this response and number."""
    return method != "paper" or (desired.key, count) in PRINTED_TABLE


def bracket_settings(method: str, bracket: Bracket) -> tuple[ExposureSetting, ...]:
    """Return the settings that `method` chooses.

    Raises:
        CaptureError: an exposure is beyond the camera's controls, or the method needs the noise
            of the camera, and it is unknown
    """
    check_base(bracket.controls, bracket.base_s)
    return tuple(sorted(METHODS[method](bracket), key=lambda setting: setting.exposure))


def check_base(controls: ExposureControls, base_s: float) -> None:
    """Raise `CaptureError` where a shortest exposure is beyond the camera's shutter times."""
    times = controls.time_s
    if not times.minimum * 0.99 <= base_s <= times.maximum * 1.01:
        raise UnreachableExposureError(
            f"a shortest exposure of {base_s:.6g} s is beyond the camera's "
            f"{times.minimum:.6g} to {times.maximum:.6g} s"
        )
