"""The options that describe a real camera, and the response that they mean."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli.options import all_of
from camctl.cli.parameters import Coefficients, Number, Whole
from camctl.errors import DataError, UsageError

if TYPE_CHECKING:
    from camctl.response.camera import CameraResponse

STANDARDS = ("srgb", "rec709")

real_camera = all_of(
    click.option(
        "--bits",
        type=Whole("a whole number of bits, 1 to 16", least=1, most=16),
        default=8,
        metavar="B",
        help="Bits a sample of the real camera.",
    ),
    click.option(
        "--phase",
        type=Number("a phase of at least 0 and below 1", least=0, below=1),
        default=0.0,
        show_default="0",
        metavar="PHI",
        help="Phase of its quantiser, in levels from 0 to below 1: 0 cuts off, 0.5 rounds.",
    ),
    click.option(
        "--curve",
        metavar="FILE",
        help="Its response: a file of two columns, irradiance and brightness, both 0 to 1; srgb, "
        "rec709, or power:GAMMA for brightness = irradiance^(1/GAMMA); or with --coefficients a "
        "response model such as emor.txt.  [default: linear]",
    ),
    click.option(
        "--coefficients",
        type=Coefficients(),
        metavar="A,B,...",
        help="Weights of the components that --curve's response model adds to its mean; 0 is the "
        "mean alone.",
    ),
)


def real_response(
    bits: int, phase: float, curve: str | None, coefficients: tuple[float, ...] | None
) -> CameraResponse:
    """Return the camera that `real_camera` describes."""
    from camctl.response.camera import linear_response, standard_response
    from camctl.response.measured import read_curve

    if curve is None:
        if coefficients is not None:
            raise UsageError(
                "--coefficients needs --curve", hint="name the response model, such as emor.txt"
            )
        return linear_response(bits, phase=phase)
    if Path(curve).exists():
        if _is_response_model(Path(curve)):
            return _modelled(Path(curve), bits, phase, coefficients)
        if coefficients is None:
            return read_curve(curve, bits=bits, phase=phase)
        raise DataError(
            f"curve {curve} is no response model",
            hint="--coefficients goes with a file of E =, f0 = and h(1) =, such as emor.txt",
        )
    if coefficients is not None:
        raise DataError(f"no response model '{curve}'", hint="give a file such as emor.txt")
    name, _, gamma = curve.partition(":")
    if name == "power":
        if not gamma:
            raise UsageError("--curve power lacks its gamma", hint="for example power:2.2")
        value = Number("a gamma from 0.05 to 20", least=0.05).read(gamma, "--curve power")
        return standard_response(name, bits, phase=phase, gamma=value)
    if curve in STANDARDS:
        return standard_response(curve, bits, phase=phase)
    raise DataError(
        f"no curve '{curve}'",
        hint=f"give a file of two columns, or {', '.join(STANDARDS)}, power:GAMMA",
    )


def _is_response_model(path: Path) -> bool:
    """Return whether a file holds the headings of a response model; a curve holds no '='."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError):
        return False  # whoever reads it as a curve says why
    return any("=" in line.partition("#")[0] for line in lines)


def _modelled(
    path: Path, bits: int, phase: float, coefficients: tuple[float, ...] | None
) -> CameraResponse:
    from camctl.response.measured import read_response_model

    if coefficients is None:
        raise DataError(
            f"curve {path} is a response model, not one curve",
            hint="say --coefficients 1.5,-0.3 for a curve of it, or --coefficients 0 for its mean",
        )
    weights = ",".join(f"{value:g}" for value in coefficients)
    model = read_response_model(path)
    try:
        return model.response(coefficients, bits=bits, phase=phase, name=f"{path.name} {weights}")
    except DataError as error:
        raise DataError(error.what, hint="take --coefficients nearer to 0, the mean") from error
