"""`camctl evaluate`: how good given exposures are."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.output import (
    format_fields,
    format_number,
    format_objective,
    format_request,
    print_json,
    print_text,
    print_warning,
)
from camctl.cli.parameter_types import Number, Ratios
from camctl.cli.response_options import (
    DesiredOptions,
    ObjectiveOptions,
    RealCameraOptions,
    desired_options,
    levels_wanted,
    objective_options,
    real_camera_options,
)
from camctl.cli.sensitivity import sensitivity_json, sensitivity_text

if TYPE_CHECKING:
    from camctl.exposure.objective import Evaluation
    from camctl.exposure.robustness import Robustness
    from camctl.response.camera import CameraResponse
    from camctl.response.desired import DesiredResponse

QUICK_LEVELS = 2**16
"""Up to this many levels in all frames together, --sensitivity takes less than a second."""


@dataclass(frozen=True)
class FrameNoise:
    """Photon noise as electrons per brightness level, and read noise in levels."""

    electrons: float | None
    read_noise: float | None


frame_noise_options = options.option_group(
    FrameNoise,
    "frame_noise",
    click.option(
        "--electrons",
        type=Number("a number of electrons above 0", above=0),
        metavar="K",
        help="Include photon noise: electrons per brightness level of the linear scale.  "
        "[default: no photon noise]",
    ),
    click.option(
        "--read-noise",
        type=Number("a noise of at least 0", least=0),
        metavar="S",
        help="Include read noise: standard deviation of each frame in brightness levels.  "
        "[default: 0]",
    ),
)


@command(
    examples=(
        ("camctl evaluate --ratios 1,2,4", "the usual bracket in steps of one stop"),
        ("camctl evaluate --ratios 1,9.91,88.38", "for equal contrast: far better"),
        ("camctl evaluate --ratios 1,2,4 --response gamma --phase 0.5", "an ADC that rounds"),
        (
            "camctl evaluate --ratios 1,9.91,88.38 --electrons 40 --read-noise 0.3",
            "with the noise of a sensor of 40 electrons per level",
        ),
    )
)
@click.option(
    "--ratios",
    type=Ratios(),
    required=True,
    metavar="A,B,...",
    help="Exposures, relative to each other.",
)
@desired_options()
@real_camera_options
@levels_wanted
@objective_options
@frame_noise_options
@click.option(
    "--sensitivity/--no-sensitivity",
    default=None,
    help="Show the effective levels with exposure errors, noise, and other phases of the "
    "quantiser.  [default: shown up to 65,536 levels in all frames, where it takes less than a "
    "second]",
)
@options.as_json
def evaluate(
    ratios: tuple[float, ...],
    desired: DesiredOptions,
    real_camera: RealCameraOptions,
    levels_wanted: float | None,
    objective: ObjectiveOptions,
    frame_noise: FrameNoise,
    sensitivity: bool | None,
    as_json: bool,
) -> None:
    """Rate given exposures.

    Compare sets of exposures for one desired picture: fewer missing levels (xi) and more effective
    levels are better; a longer total exposure time is the price. The table below shows how many
    effective levels remain with exposure errors, noise, and other quantisers.
    """
    from camctl.exposure.objective import Objective
    from camctl.exposure.objective import evaluate as evaluate_exposures

    real = real_camera.response()
    for note in real.notes:
        print_warning(note)
    response = desired.desired()
    score = Objective(levels_wanted, objective.p, objective.noise_term(), objective.jitter)
    quality = evaluate_exposures(real, response, ratios, objective=score)
    robustness = None
    if quality.levels <= QUICK_LEVELS if sensitivity is None else sensitivity:
        from camctl.exposure.robustness import sensitivity as robustness_of

        robustness = robustness_of(real, response, ratios, levels_wanted=quality.levels_wanted)
    result = _Result(real, response, ratios, quality, frame_noise, robustness)
    if as_json:
        print_json(result.to_json())
    else:
        print_text(result.to_text(counts_levels=objective.counts_levels))


@dataclass(frozen=True)
class _Result:
    """The quality of one set of exposures."""

    real: CameraResponse
    desired: DesiredResponse
    exposures: tuple[float, ...]
    quality: Evaluation
    frame_noise: FrameNoise
    robustness: Robustness | None

    def with_noise(self) -> tuple[float, float] | None:
        """Return the effective levels with noise, and those of equal exposures, if noise is given.

        The equal exposures are as many, each as long as the shortest.
        """
        if self.frame_noise.electrons is None and self.frame_noise.read_noise is None:
            return None
        from camctl.exposure.effective import EffectiveCamera
        from camctl.exposure.noise import noisy_effective_levels

        electrons = self.frame_noise.electrons
        equal = [self.exposures[0]] * len(self.exposures)
        with_noise, of_equal = (
            noisy_effective_levels(
                EffectiveCamera.of(self.real, exposures),
                self.desired,
                read_noise_levels=self.frame_noise.read_noise or 0.0,
                electrons_per_level=math.inf if electrons is None else electrons,
            )
            for exposures in (self.exposures, equal)
        )
        return with_noise, of_equal

    def to_json(self) -> dict[str, Any]:
        """Return the JSON output."""
        result: dict[str, Any] = {
            **asdict(self.quality),
            "exposures": self.exposures,
            "response": self.desired.name,
            "dynamic_range": self.desired.dynamic_range,
            "camera": self.real.name,
        }
        if noisy := self.with_noise():
            result["with_noise"] = {
                "electrons_per_level": self.frame_noise.electrons,
                "read_noise_levels": self.frame_noise.read_noise or 0.0,
                "effective_levels": noisy[0],
                "effective_levels_equal_exposures": noisy[1],
            }
        if self.robustness is not None:
            result["sensitivity"] = sensitivity_json(self.robustness)
        return result

    def to_text(self, *, counts_levels: bool) -> str:
        """Return the text output."""
        quality, n = self.quality, len(self.exposures)
        coinciding = quality.levels - quality.levels_distinct
        rows = [
            ("desired", format_request(self.desired.name, self.desired.dynamic_range, n)),
            ("camera", self.real.name),
            ("exposures", "  ".join(map(format_number, self.exposures))),
            format_objective(quality.xi, quality.levels_wanted, counts_levels=counts_levels),
            ("effective levels", format_number(quality.effective_levels, 4)),
        ]
        if noisy := self.with_noise():
            equal = f" ({n} equal exposures: {format_number(noisy[1], 4)})" if n > 1 else ""
            rows.append(("  with that noise", f"{format_number(noisy[0], 4)}{equal}"))
        rows += [
            (
                "levels",
                f"{quality.levels_distinct} distinct"
                + (f", {coinciding} coincide with others" if coinciding else ""),
            ),
            (
                "total exposure time",
                f"{format_number(quality.total_exposure)} x the shortest exposure",
            ),
        ]
        text = format_fields(rows)
        if self.robustness is None:
            return text
        return f"{text}\n\n{sensitivity_text(self.robustness, self.exposures)}"
