"""Options that say which camera exposures are for: its response, and its noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli.options import (
    camera_settings,
    declare,
    declare_as,
    given,
    option_group,
    refuse_together,
)
from camctl.cli.output import print_finding
from camctl.cli.parameter_types import CAMERA, SENSOR, ListOf, Number, Text, WholeNumber
from camctl.errors import DataError, UsageError
from camctl.system.input_files import exists, read_input_text

if TYPE_CHECKING:
    from camctl.exposure.evaluation import Evaluation
    from camctl.model.noise import FrameNoise, NoiseModel
    from camctl.model.response.camera import CameraResponse
    from camctl.model.response.desired import DesiredResponse

STANDARDS = ("srgb", "rec709")


@dataclass(frozen=True)
class RealCameraOptions:
    """A real camera by its number of bits, its quantiser's phase and its response curve."""

    bits: int = declare(
        "--bits B", "Bits per sample of the real camera.", WholeNumber(least=1, most=16), default=8
    )
    phase: float = declare(
        "--phase PHI",
        "Phase of its quantiser in levels, from 0 to below 1: 0 rounds down, 0.5 to nearest.",
        Number("a phase of at least 0 and below 1", least=0, below=1),
        default="0",
    )
    curve: str | None = declare(
        "--curve FILE|NAME",
        "Its response: a text file of two columns, irradiance and brightness, both 0 to 1; "
        "srgb, rec709, or power:GAMMA for brightness = irradiance^(1/GAMMA); or with "
        "--coefficients a response model such as emor.txt.  [default: linear]",
        Text(lambda: (*STANDARDS, "power:"), files=True),
    )
    coefficients: tuple[float, ...] | None = declare(
        "--coefficients A,B,...",
        "Weights of the components that are added to the mean of --curve's response model; 0 "
        "is the mean alone.",
        ListOf(Number("numbers such as 1.5,-0.3")),
    )

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
        raise UsageError(
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


real_camera_options = option_group(RealCameraOptions, "real_camera")


_RESPONSE_OPTIONS = {"bits", "phase", "curve", "coefficients"}


@dataclass(frozen=True)
class KnownCamera:
    """A real camera: its response, and its noise where that is known.

    Attributes:
        response: its response as levels
        noise: its noise; None where it is unknown
        black: its black level, DN
    """

    response: CameraResponse
    noise: NoiseModel | None = None
    black: int = 0

    def frame_noise(
        self, gains: Sequence[float], times_s: Sequence[float] | None = None
    ) -> list[FrameNoise] | None:
        """Return the noise of a frame at each gain; without times, without dark current."""
        if self.noise is None:
            return None
        times = [0.0] * len(gains) if times_s is None else times_s
        return [
            self.noise.frame(gain=gain, time_s=time_s, black=self.black)
            for gain, time_s in zip(gains, times, strict=True)
        ]

    def rate(
        self,
        desired: DesiredResponse,
        exposures: Sequence[float],
        gains: Sequence[float] | None = None,
        times_s: Sequence[float] | None = None,
    ) -> Evaluation:
        """Return the quality of exposures with the camera's noise, at gain 1 by default."""
        from camctl.exposure.evaluation import evaluate

        noise = self.frame_noise(gains or [1.0] * len(exposures), times_s)
        return evaluate(self.response, desired, exposures, noise=noise)


@dataclass(frozen=True)
class NoiseOptions:
    """Whose noise is counted: of a sensor preset, of a camera, or given by two numbers."""

    sensor: str | None = declare(
        "--sensor NAME|FILE.json",
        "Take response and noise of this sensor.  [default: noise unknown]",
        SENSOR,
    )
    camera_id: str | None = declare(
        "--camera ID",
        "Take response and noise of this camera, with what its profile knows of it.",
        CAMERA,
    )
    camera_settings: tuple[tuple[str, str], ...] = declare_as(camera_settings)
    electrons: float | None = declare(
        "--electrons K",
        "Count photon noise in: electrons per brightness level of the linear scale.  "
        "[default: no photon noise]",
        Number("a number of electrons of at least 0.001", least=1e-3),
    )
    read_noise: float | None = declare(
        "--read-noise S",
        "Count read noise in: standard deviation of each frame in brightness levels.  [default: 0]",
        Number("a noise of at least 0", least=0),
    )

    def camera(self, real_camera: RealCameraOptions) -> KnownCamera:
        """Return the camera that these options describe; raise what opening it raises.

        A sensor or a camera brings its own response, which --bits and the like then cannot give.
        """
        context = click.get_current_context()
        if self.camera_id is None and self.camera_settings:
            raise UsageError("--camera-option needs --camera", hint="name the camera")
        if self.sensor is None and self.camera_id is None:
            return KnownCamera(real_camera.response(), self._given())
        option = "--sensor" if self.camera_id is None else "--camera"
        refuse_together(context, option, _RESPONSE_OPTIONS | {"electrons", "read_noise"})
        if self.sensor is not None and self.camera_id not in (None, "sim"):
            refuse_together(context, "--camera", {"sensor"})
        from camctl.profiles.calibrated import open_camera

        settings = dict(self.camera_settings)
        if self.sensor is not None:
            settings |= {"sensor": self.sensor}
            if self.camera_id is None:
                settings |= {"scene": "uniform", "size": "16x16", "profile": "none"}
        with open_camera(self.camera_id or "sim", settings) as camera:
            controls = camera.controls
        for finding in controls.response_findings:
            print_finding(finding)
        return KnownCamera(controls.levels, controls.noise, controls.black)

    @property
    def names_camera(self) -> bool:
        """Whether a certain camera was named."""
        names = _RESPONSE_OPTIONS | {"sensor", "camera_id"}
        return bool(given(click.get_current_context()) & names)

    def _given(self) -> NoiseModel | None:
        from camctl.model.noise import NoiseModel

        if self.electrons is None and self.read_noise is None:
            return None
        electrons = self.electrons or 1.0
        return NoiseModel(
            electrons,
            ((1.0, (self.read_noise or 0.0) * electrons),),
            photon_noise=self.electrons is not None,
        )


noise_options = option_group(NoiseOptions, "noise")
