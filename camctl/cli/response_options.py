"""Options for the desired response, the real camera's response, and the objective of a search."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from camctl.cli.options import (
    Decorator,
    given,
    option_group,
    refuse_together,
)
from camctl.cli.parameter_types import (
    FILE,
    DynamicRange,
    ListOf,
    Name,
    NameOrFile,
    Number,
    Text,
    WholeNumber,
)
from camctl.errors import DataError, UsageError
from camctl.exposure.goal import AUTO, RANGE_WITHOUT_LIGHT, Goal
from camctl.model.response.names import RESPONSES
from camctl.system.input_files import exists, read_input_text

if TYPE_CHECKING:
    from camctl.exposure.noise import NoiseTerm
    from camctl.model.response.camera import CameraResponse
    from camctl.model.response.desired import DesiredResponse

STANDARDS = ("srgb", "rec709")
NOISE_KINDS = ("paper", "time", "aperture", "gain")

RESPONSE = Name("response", RESPONSES)


@dataclass(frozen=True)
class DesiredOptions:
    """The desired response: a name and a dynamic range, any gamma, or a file that has both."""

    response: str
    gamma: float | None
    desired_file: str | None
    dynamic_range: float | Literal["auto"]

    def resolve(self) -> DesiredOptions:
        """Return the same, with `response` and `desired_file` as --gamma and files imply.

        Raises:
            UsageError: two of the options contradict each other
        """
        context = click.get_current_context()
        response, file = self.response, self.desired_file
        if file is not None:
            self._refuse_beside_file("--desired", {"response"})
        elif response not in (*RESPONSES, "auto"):
            response, file = "curve", response
            self._refuse_beside_file("--response FILE", set())
        elif self.gamma is not None:
            if "response" in given(context) and response != "gamma":
                raise UsageError(
                    f"--gamma cannot be combined with --response {response}",
                    hint="leave one of them out",
                )
            response = "gamma"
        return DesiredOptions(
            response if file is None else "curve", self.gamma, file, self.dynamic_range
        )

    def _refuse_beside_file(self, option: str, more: set[str]) -> None:
        refuse_together(
            click.get_current_context(),
            option,
            {"gamma", "dynamic_range"} | more,
            "the file defines response and range",
        )

    def desired(self) -> DesiredResponse:
        """Return the desired response; raise `UsageError`, or `DataError` for a file."""
        from camctl.model.response.desired import desired_response
        from camctl.model.response.measured import read_desired

        resolved = self.resolve()
        if resolved.desired_file is not None:
            return read_desired(resolved.desired_file)
        given = resolved.dynamic_range
        dynamic_range = RANGE_WITHOUT_LIGHT if given == AUTO else given
        return desired_response(resolved.response, dynamic_range, gamma=resolved.gamma)

    def request_fields(self) -> dict[str, Any]:
        """Return the fields of a `CaptureRequest`; raise as `desired` does."""
        from camctl.model.response.measured import read_columns, read_desired

        resolved = self.resolve()
        values: dict[str, Any] = {
            "response": resolved.response,
            "dynamic_range": resolved.dynamic_range,
            "gamma": resolved.gamma,
        }
        if resolved.desired_file is not None:
            values["dynamic_range"] = read_desired(resolved.desired_file).dynamic_range
            columns = read_columns(resolved.desired_file, "u")
            values["desired_curve"] = tuple(zip(*columns, strict=True))
        return values


def desired_options(*, auto: bool = False, has_light: bool = False) -> Decorator:
    """Return the options of `DesiredOptions`; their defaults are those of `Goal`.

    Args:
        auto: also --response auto
        has_light: light of a scene decides the range unless it is given
    """
    names = (*RESPONSES, "auto") if auto else RESPONSES
    explanation = (
        ", auto gives most levels to the brightnesses that are most frequent in the scene"
        if auto
        else ""
    )
    return option_group(
        DesiredOptions,
        "desired",
        click.option(
            "--response",
            type=Name("response", names) if auto else NameOrFile("response", names),
            default=Goal.response,
            metavar="|".join(names),
            help="How brightness depends on light: log gives equal contrast in shadows and "
            f"highlights{explanation}.",
        ),
        click.option(
            "--gamma",
            type=Number("an exponent from 0.01 to 100", least=0.01, most=100),
            metavar="Q",
            help="Exponent of a gamma response, brightness = light^Q; implies --response gamma.  "
            "[default: 0.5]",
        ),
        click.option(
            "--desired",
            "desired_file",
            type=FILE,
            metavar="FILE",
            help="Desired response as a text file of two columns, irradiance and u (desired "
            "brightness); instead of --response and --range.",
        ),
        click.option(
            "--range",
            "dynamic_range",
            type=DynamicRange(auto=True),
            default=str(Goal.dynamic_range),
            metavar="low|medium|high|auto|NUMBER",
            help="Dynamic range of the picture, brightest over darkest light: 256, 1,000, 16,000, "
            f"or any NUMBER; auto is {'what the scene holds' if has_light else 'medium'}.",
        ),
    )


@dataclass(frozen=True)
class RealCameraOptions:
    """A real camera by its number of bits, its quantiser's phase and its response curve."""

    bits: int
    phase: float
    curve: str | None
    coefficients: tuple[float, ...] | None

    def response(self) -> CameraResponse:
        """Return the camera's levels.

        Raises:
            UsageError, DataError: the curve is unknown, or the file cannot be used
        """
        from camctl.model.response.camera import linear_response, standard_response
        from camctl.model.response.measured import read_curve

        if self.curve is None:
            if self.coefficients is not None:
                raise UsageError(
                    "--coefficients needs --curve", hint="name a response model, such as emor.txt"
                )
            return linear_response(self.bits, phase=self.phase)
        path = Path(self.curve)
        if exists(path):
            if _is_response_model(path):
                return self._model_response(path)
            if self.coefficients is None:
                return read_curve(path, bits=self.bits, phase=self.phase)
            raise DataError(
                f"{path} is not a response model",
                hint="--coefficients needs a file with blocks E =, f0 =, h(1) =, such as emor.txt",
            )
        if self.coefficients is not None:
            raise DataError(
                f"response model {path} does not exist", hint="give a file such as emor.txt"
            )
        name, _, gamma = self.curve.partition(":")
        if name == "power":
            if not gamma:
                raise UsageError("--curve power needs a gamma", hint="for example power:2.2")
            value = Number("a gamma from 0.05 to 20", least=0.05, most=20).parse(
                gamma, "--curve power"
            )
            return standard_response(name, self.bits, phase=self.phase, gamma=value)
        if self.curve in STANDARDS:
            return standard_response(self.curve, self.bits, phase=self.phase)
        raise DataError(
            f"unknown curve '{self.curve}'",
            hint=f"give an existing file of two columns, or {', '.join(STANDARDS)}, power:GAMMA",
        )

    def _model_response(self, path: Path) -> CameraResponse:
        from camctl.model.response.measured import read_response_model

        if self.coefficients is None:
            raise DataError(
                f"{path} is a response model, which holds many curves",
                hint="choose one with --coefficients 1.5,-0.3, or the mean with --coefficients 0",
            )
        weights = ",".join(f"{value:g}" for value in self.coefficients)
        name = f"{path.name} {weights}"
        model = read_response_model(path)
        try:
            return model.response(self.coefficients, bits=self.bits, phase=self.phase, name=name)
        except DataError as error:
            raise DataError(error.what, hint="take --coefficients nearer to 0, the mean") from error


def _is_response_model(path: Path) -> bool:
    """Return whether a file has the headings of a response model; a curve contains no '='."""
    lines = read_input_text(path, "curve").splitlines()
    return any("=" in line.partition("#")[0] for line in lines)


real_camera_options = option_group(
    RealCameraOptions,
    "real_camera",
    click.option(
        "--bits",
        type=WholeNumber(least=1, most=16),
        default=8,
        metavar="B",
        help="Bits per sample of the real camera.",
    ),
    click.option(
        "--phase",
        type=Number("a phase of at least 0 and below 1", least=0, below=1),
        default="0",
        metavar="PHI",
        help="Phase of its quantiser in levels, from 0 to below 1: 0 rounds down, 0.5 to nearest.",
    ),
    click.option(
        "--curve",
        type=Text(lambda: (*STANDARDS, "power:"), files=True),
        metavar="FILE|NAME",
        help="Its response: a text file of two columns, irradiance and brightness, both 0 to 1; "
        "srgb, rec709, or power:GAMMA for brightness = irradiance^(1/GAMMA); or with "
        "--coefficients a response model such as emor.txt.  [default: linear]",
    ),
    click.option(
        "--coefficients",
        type=ListOf(Number("numbers such as 1.5,-0.3")),
        metavar="A,B,...",
        help="Weights of the components that are added to the mean of --curve's response model; 0 "
        "is the mean alone.",
    ),
)


levels_wanted = click.option(
    "--levels",
    "levels_wanted",
    type=Number("a number of levels from 1 to 1e7", least=1, most=1e7),
    metavar="G",
    help="Desired number of brightness levels in the picture.  "
    "[default: as many as the frames hold together]",
)


@dataclass(frozen=True)
class ObjectiveOptions:
    """The objective beyond the count of missing levels: its power, noise and exposure errors."""

    p: float
    noise: float | None
    noise_weight: float
    noise_kind: str
    jitter: float

    @property
    def counts_levels(self) -> bool:
        """Whether the objective is the number of missing levels."""
        return self.p == 1 and self.noise is None and self.jitter == 0

    def noise_term(self) -> NoiseTerm | None:
        """Return the noise term; None without --noise."""
        from camctl.exposure.noise import NoiseTerm

        if self.noise is None:
            return None
        return NoiseTerm(self.noise, self.noise_weight, self.noise_kind)


objective_options = option_group(
    ObjectiveOptions,
    "objective",
    click.option(
        "--p",
        type=Number("a number from 1 to 16", least=1, most=16),
        default="1",
        metavar="P",
        help="Power of the objective, 1 to 16; only with 1 does it count missing levels.",
    ),
    click.option(
        "--noise",
        type=Number("a number from 0 to 1000", least=0, most=1e3),
        metavar="SIGMA",
        help="Add the cost of noise; SIGMA is its standard deviation at exposure 1 relative to "
        "full scale.  [default: not added]",
    ),
    click.option(
        "--noise-weight",
        type=Number("a number from 0 to 1e15", least=0, most=1e15),
        default="1",
        metavar="C",
        help="Cost, in levels, of a noise variance of one squared full scale.",
    ),
    click.option(
        "--noise-kind",
        type=Name("noise term", NOISE_KINDS),
        default="paper",
        metavar="|".join(NOISE_KINDS),
        help="How noise depends on exposure: as in the paper, or as read noise does where "
        "exposures differ in shutter time, aperture or gain.",
    ),
    click.option(
        "--jitter",
        type=Number("a fraction from 0 to 0.2", least=0, most=0.2),
        default="0",
        metavar="FRACTION",
        help="Average over exposures with random errors of this relative size, up to 0.2; for "
        "example 0.01.",
    ),
)
