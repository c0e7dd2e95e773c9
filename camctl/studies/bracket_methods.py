"""Ways to choose the exposures of a bracket, each as the settings of one camera.

All begin at the same metered base: full scale of the shortest exposure is E = 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from camctl.errors import CaptureError, UsageError
from camctl.exposure.build import look_up
from camctl.exposure.goal import ACCURACY, CaptureRequest
from camctl.exposure.search.front import Front, gain_choices
from camctl.exposure.search.wall_time import predicted_wall_s
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.noise import NoiseModel
from camctl.model.response.desired import DesiredResponse
from camctl.studies.noise_optimal import NoiseOptimalProblem, noise_optimal
from camctl.studies.paper_table import PRINTED_TABLE


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

    @property
    def noise(self) -> NoiseModel:
        """The noise of the camera; raises `UsageError` where it is unknown."""
        if self.controls.noise is None:
            raise UsageError(
                "the noise of this camera is not known, and these methods need it: accuracy, "
                "quick, hasinoff",
                hint="leave them out, or measure the noise",
                remedies={"methods": "xi,paper,doubling,equal", "calibrate_noise": None},
            )
        return self.controls.noise

    @property
    def longest(self) -> float:
        """The longest shutter time in units of the base."""
        return self.controls.time_s.maximum / self.base_s

    def accurate(self, budget_s: float | None = None) -> tuple[ExposureSetting, ...]:
        """Return the most accurate settings with the camera's noise, in no more than `budget_s`."""
        assert self.noise  # or it raises
        request = replace(self.request, base_s=None, objective=ACCURACY, time_budget_s=budget_s)
        front = Front(self.controls, self.desired, self.base_s, request=request, before=self.before)
        return front.chosen.settings

    def at_gain(self, exposures: tuple[float, ...]) -> tuple[ExposureSetting, ...]:
        """Return settings at gain 1 for relative exposures; gain extends the longest time."""
        time, gain = self.controls.time_s, self.controls.gain
        lowest = gain.nearest(1.0)
        settings = []
        for exposure in exposures:
            more = max(1.0, exposure / self.longest)
            if lowest * more > gain.maximum * (1 + 1e-6):
                raise CaptureError(
                    f"an exposure of {exposure:.4g} x {self.base_s:.4g} s is beyond the camera's "
                    "longest time and largest gain",
                    hint="take fewer exposures or a smaller range",
                )
            applied_gain = gain.nearest(lowest * more)
            time_s = time.nearest(exposure * self.base_s * lowest / applied_gain)
            settings.append(ExposureSetting(time_s, applied_gain))
        return tuple(settings)


def _accuracy(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    return bracket.accurate()


def _quick(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    """At equal time: the most accurate set in the time of 1, 2, 4, ... of as many exposures."""
    doubling = _doubling(bracket)
    return bracket.accurate(predicted_wall_s(bracket.controls, doubling, before=bracket.before))


def _total_s(settings: Iterable[ExposureSetting]) -> float:
    return math.fsum(setting.time_s for setting in settings)


def _xi(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    row = look_up(bracket.controls.levels, bracket.desired, bracket.count)
    return bracket.at_gain(tuple(row.exposures))


def _paper(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    return bracket.at_gain(PRINTED_TABLE[bracket.desired.key, bracket.count])


def _doubling(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    return bracket.at_gain(tuple(2.0**place for place in range(bracket.count)))


def _equal(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    return bracket.at_gain((1.0,) * bracket.count)


def _hasinoff(bracket: Bracket) -> tuple[ExposureSetting, ...]:
    """At equal time: the budget is the time of the most accurate set of as many exposures."""
    controls, accurate = bracket.controls, bracket.accurate()
    base_s = min(setting.exposure for setting in accurate)  # as applied
    problem = NoiseOptimalProblem(
        noise=bracket.noise,
        full_scale_levels=controls.levels.M + 1,
        e_min=bracket.desired.e_min,
        gains=gain_choices(controls.gain),
        longest=controls.time_s.maximum / base_s,
        budget=_total_s(accurate) / base_s * (1 + 1e-9),
        unit_s=base_s,
    )
    found = noise_optimal(problem, bracket.count)
    return tuple(
        ExposureSetting(controls.time_s.nearest(time * base_s), gain)
        for time, gain in zip(found.times, found.gains, strict=True)
    )


METHODS: dict[str, Callable[[Bracket], tuple[ExposureSetting, ...]]] = {
    "accuracy": _accuracy,
    "quick": _quick,
    "xi": _xi,
    "paper": _paper,
    "doubling": _doubling,
    "equal": _equal,
    "hasinoff": _hasinoff,
}
"""Each returns the settings of a bracket, by ascending exposure."""

NEED_NOISE = frozenset({"accuracy", "quick", "hasinoff"})
"""Methods that cannot choose without the noise of the camera."""

LABELS = {
    "accuracy": "most accurate with noise",
    "quick": "best in the time of 1, 2, 4, ...",
    "xi": "least missing levels",
    "paper": "printed in the paper",
    "doubling": "1, 2, 4, ...",
    "equal": "equal exposures",
    "hasinoff": "best worst-case SNR",
}
"""What each method is, for people."""


def offers(method: str, desired: DesiredResponse, count: int) -> bool:
    """Return whether a method has exposures for this response and number."""
    return method != "paper" or (desired.key, count) in PRINTED_TABLE


def bracket_settings(method: str, bracket: Bracket) -> tuple[ExposureSetting, ...]:
    """Return the settings that `method` chooses.

    Raises:
        UsageError: the noise is unknown and needed
        CaptureError: an exposure is beyond the camera's controls
    """
    times = bracket.controls.time_s
    if not times.minimum * 0.99 <= bracket.base_s <= times.maximum * 1.01:
        raise CaptureError(
            f"a shortest exposure of {bracket.base_s:.6g} s is beyond the camera's "
            f"{times.minimum:.6g} to {times.maximum:.6g} s"
        )
    return tuple(sorted(METHODS[method](bracket), key=lambda setting: setting.exposure))
