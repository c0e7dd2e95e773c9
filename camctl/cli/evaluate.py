"""`camctl evaluate`: how good given exposures are."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import option
from camctl.cli.output import (
    format_effective,
    format_fields,
    format_number,
    format_objective,
    format_request,
    print_json,
    print_text,
    print_warning,
)
from camctl.cli.real_camera import (
    KnownCamera,
    NoiseOptions,
    RealCameraOptions,
    noise_options,
    real_camera_options,
)
from camctl.cli.request_options import RequestOptions, named, request_options
from camctl.cli.search_options import ObjectiveOptions, objective_options
from camctl.cli.sensitivity import sensitivity_json, sensitivity_text

if TYPE_CHECKING:
    from camctl.exposure.evaluation import Evaluation
    from camctl.exposure.robustness import Robustness
    from camctl.model.response.desired import DesiredResponse

QUICK_LEVELS = 2**16
"""Up to this many levels in all frames together, --sensitivity takes less than a second."""


@command(
    examples=(
        ("camctl evaluate --ratios 1,2,4", "the usual bracket in steps of one stop"),
        ("camctl evaluate --ratios 1,9.91,88.38", "for equal contrast: far better"),
        ("camctl evaluate --ratios 1,2,4 --response gamma --phase 0.5", "an ADC that rounds"),
        (
            "camctl evaluate --ratios 1,9.91,88.38 --electrons 40 --read-noise 0.3",
            "with the noise of a sensor of 40 electrons per level",
        ),
        ("camctl evaluate --ratios 1,9.91,88.38 --sensor webcam", "with the noise of a sensor"),
    )
)
@named("ratios", "Exposures, relative to each other.", required=True)
@request_options("response", "gamma", "dynamic_range", "levels_wanted")
@real_camera_options
@objective_options
@noise_options
@option(
    "--sensitivity/--no-sensitivity",
    "Show the effective levels with exposure errors, noise, and other phases of the "
    "quantiser.  [default: shown up to 65,536 levels in all frames, where it takes less than a "
    "second]",
    default=None,
)
@options.as_json
def evaluate(
    ratios: tuple[float, ...],
    request: RequestOptions,
    real_camera: RealCameraOptions,
    objective: ObjectiveOptions,
    noise: NoiseOptions,
    sensitivity: bool | None,
    as_json: bool,
) -> None:
    """Rate given exposures.

    Compare sets of exposures for one desired picture: fewer missing levels (xi) and more effective
    levels are better; a longer total exposure time is the price. The table below shows how many
    effective levels remain with exposure errors, noise, and other quantisers.
    """
    from camctl.exposure.evaluation import evaluate as evaluate_exposures
    from camctl.exposure.objective import Objective

    camera = noise.camera(real_camera)
    real = camera.response
    for note in real.notes:
        print_warning(note)
    response, wanted = request.desired(), request.get("levels_wanted")
    score = Objective(wanted, objective.p, objective.noise_term(), objective.jitter)
    quality = evaluate_exposures(
        real, response, ratios, objective=score, noise=camera.frame_noise([1.0] * len(ratios))
    )
    robustness = None
    if quality.levels <= QUICK_LEVELS if sensitivity is None else sensitivity:
        from camctl.exposure.robustness import sensitivity as robustness_of

        robustness = robustness_of(real, response, ratios, levels_wanted=quality.levels_wanted)
    result = _Result(camera, response, ratios, quality, robustness)
    if as_json:
        print_json(result.to_json())
    else:
        print_text(result.to_text(counts_levels=objective.counts_levels))


@dataclass(frozen=True)
class _Result:
    """The quality of one set of exposures."""

    camera: KnownCamera
    desired: DesiredResponse
    exposures: tuple[float, ...]
    quality: Evaluation
    robustness: Robustness | None

    def of_equal_exposures(self) -> float:
        """Return the effective levels of as many exposures, each as long as the shortest."""
        equal = [self.exposures[0]] * len(self.exposures)
        return self.camera.rate(self.desired, equal).effective_levels

    def to_json(self) -> dict[str, Any]:
        """Return the JSON output."""
        result: dict[str, Any] = {
            **asdict(self.quality),
            "exposures": self.exposures,
            "response": self.desired.name,
            "dynamic_range": self.desired.dynamic_range,
            "camera": self.camera.response.name,
            "noise": self.camera.noise,
        }
        if self.camera.noise is not None:
            result["effective_levels_equal_exposures"] = self.of_equal_exposures()
        if self.robustness is not None:
            result["sensitivity"] = sensitivity_json(self.robustness)
        return result

    def to_text(self, *, counts_levels: bool) -> str:
        """Return the text output."""
        quality, n = self.quality, len(self.exposures)
        noise_known = self.camera.noise is not None
        coinciding = quality.levels - quality.levels_distinct
        rows = [
            ("desired", format_request(self.desired.name, self.desired.dynamic_range, n)),
            ("camera", self.camera.response.name),
            ("exposures", "  ".join(map(format_number, self.exposures))),
            format_objective(quality.xi, quality.levels_wanted, counts_levels=counts_levels),
            ("effective levels", format_effective(quality, noise_known=noise_known)),
        ]
        if noise_known and n > 1:
            of_equal = f"{format_number(self.of_equal_exposures(), 4)} with noise"
            rows.append((f"  of {n} equal exposures", of_equal))
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
