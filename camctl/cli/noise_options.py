"""Options that say which camera exposures are for, and with which noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import click

from camctl.cli.options import (
    camera_settings,
    given,
    no_profile,
    option_group,
    option_name,
    refuse_together,
)
from camctl.cli.output import print_warning
from camctl.cli.parameter_types import CAMERA, SENSOR, Number
from camctl.cli.response_options import RealCameraOptions
from camctl.errors import UsageError

if TYPE_CHECKING:
    from camctl.exposure.evaluation import Evaluation
    from camctl.model.noise import FrameNoise, NoiseModel
    from camctl.model.response.camera import CameraResponse
    from camctl.model.response.desired import DesiredResponse

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

    def noise_json(self) -> dict[str, Any] | None:
        """Return the noise model for JSON output."""
        return None if self.noise is None else asdict(self.noise)


@dataclass(frozen=True)
class NoiseOptions:
    """Whose noise is counted: that of a sensor preset, of a camera, or of two numbers."""

    sensor: str | None
    camera_id: str | None
    electrons: float | None
    read_noise: float | None
    camera_settings: tuple[tuple[str, str], ...]
    no_profile: bool

    def camera(self, real_camera: RealCameraOptions) -> KnownCamera:
        """Return the camera that these options describe; raise what opening it raises.

        A sensor or a camera brings its own response, which --bits and the like then cannot give.
        """
        context = click.get_current_context()
        if self.camera_id is None:
            for name in sorted(given(context) & {"camera_settings", "no_profile"}):
                raise UsageError(
                    f"{option_name(context, name)} needs --camera", hint="name the camera"
                )
        if self.sensor is None and self.camera_id is None:
            return KnownCamera(real_camera.response(), self._given())
        option = "--sensor" if self.camera_id is None else "--camera"
        refuse_together(context, option, _RESPONSE_OPTIONS | {"electrons", "read_noise"})
        if self.sensor is not None and self.camera_id not in (None, "sim"):
            refuse_together(context, "--camera", {"sensor"})
        from camctl.profiles.calibrated import open_camera

        settings = dict(self.camera_settings)
        if self.no_profile:
            settings["profile"] = "none"
        if self.sensor is not None:
            settings |= {"sensor": self.sensor}
            if self.camera_id is None:
                settings |= {"scene": "uniform", "size": "16x16", "profile": "none"}
        with open_camera(self.camera_id or "sim", settings) as camera:
            controls = camera.controls
        for warning in controls.response_warnings:
            print_warning(warning)
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


noise_options = option_group(
    NoiseOptions,
    "noise",
    click.option(
        "--sensor",
        type=SENSOR,
        metavar="NAME|FILE.json",
        help="Take response and noise of this sensor.  [default: noise unknown]",
    ),
    click.option(
        "--camera",
        "camera_id",
        type=CAMERA,
        metavar="ID",
        help="Take response and noise of this camera, with what its profile knows of it.",
    ),
    camera_settings,
    no_profile,
    click.option(
        "--electrons",
        type=Number("a number of electrons of at least 0.001", least=1e-3),
        metavar="K",
        help="Count photon noise in: electrons per brightness level of the linear scale.  "
        "[default: no photon noise]",
    ),
    click.option(
        "--read-noise",
        type=Number("a noise from 0 to 64", least=0, most=64),
        metavar="S",
        help="Count read noise in: standard deviation of each frame in brightness levels.  "
        "[default: 0]",
    ),
)
