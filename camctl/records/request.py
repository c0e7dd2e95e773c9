"""What a user asks of a capture: a goal, and how to shoot it."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real

from camctl.errors import UsageError
from camctl.exposure.goal import (
    ACCURACY,
    AUTO,
    RANGE_WITHOUT_LIGHT,
    Goal,
    check_positive,
    plain_numbers,
)

MAX_COMPENSATION_STOPS = 64.0
"""No camera has so many stops between its shortest and its longest exposure."""


@dataclass(frozen=True)
class CaptureRequest(Goal):
    """A goal, and how to shoot it; everything else is looked up, metered or measured.

    The fields of the goal, with their defaults, are fields of `camctl.exposure.goal.Goal`.

    Attributes:
        ratios: the exposures, relative to each other, instead of looked-up ones; `count` is not
            used then
        base_s: shutter time of the shortest exposure, s; None: metered
        compensation_stops: shift of the shortest exposure, in stops, -64 to 64
        use_aperture: change the aperture where shutter time and gain do not reach
        estimate_ratios: compute the pictures with exposures estimated from the pixels, where these
            are more certain than what the camera states
        mains_hz: frequency of the mains that feeds the lamps (50 or 60); None: daylight
        spend_shutter: meter with full exposures on a camera that has no preview

    Raises:
        UsageError: a value is out of its range, or two fields contradict each other
    """

    ratios: tuple[float, ...] | None = None
    base_s: float | None = None
    compensation_stops: float = 0.0
    use_aperture: bool = False
    estimate_ratios: bool = False
    mains_hz: float | None = None
    spend_shutter: bool = False

    def __post_init__(self) -> None:
        self._set("ratios", plain_numbers(self.ratios))
        self._check_types("base_s", "compensation_stops", "mains_hz")
        super().__post_init__()

    @property
    def given_range(self) -> float | None:
        """The desired dynamic range; None where the metered light decides it ("auto")."""
        given = super().given_range
        return RANGE_WITHOUT_LIGHT if given is None and self.base_s is not None else given

    def _check_numbers(self) -> None:
        super()._check_numbers()
        if self.ratios is not None:
            if not all(isinstance(ratio, Real) for ratio in self.ratios):
                raise UsageError(
                    f"invalid ratios {self.ratios!r}: expected numbers such as (1, 2, 4)"
                )
            if not self.ratios:
                raise UsageError("no exposure ratios: expected at least one, such as 1,2,4")
            for ratio in self.ratios:
                check_positive("exposure ratio", ratio)
        for name, value in (
            ("base exposure in seconds", self.base_s),
            ("mains frequency", self.mains_hz),
        ):
            if value is not None:
                check_positive(name, value)
        if not abs(self.compensation_stops) <= MAX_COMPENSATION_STOPS:
            raise UsageError(
                f"invalid compensation {self.compensation_stops:g}: expected "
                f"-{MAX_COMPENSATION_STOPS:g} to {MAX_COMPENSATION_STOPS:g} stops"
            )

    def _check_combinations(self) -> None:
        super()._check_combinations()
        if self.accuracy is not None or self.objective == ACCURACY:
            self._refuse_beside("a choice by accuracy", "ratios", "use_aperture")
        if self.tolerance is not None:
            self._refuse_beside("a tolerance", "ratios")
        if self.response == AUTO:
            self._refuse_beside("an automatic response", "ratios")
        if self.base_s is not None:
            for name, value in (
                ("an automatic response", self.response == AUTO),
                ("a share of clipped samples", self.clip_percent is not None),
            ):
                if value:
                    raise UsageError(
                        f"{name} needs metering, and the base exposure is given",
                        hint="leave the base exposure out, or this",
                        remedies={"base_s": None},
                    )
