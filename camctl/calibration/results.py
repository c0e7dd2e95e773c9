"""What calibrations measure, as typed results: a record for the profile, of which camera, and how.

A result has the fields of its record.  ``camctl calibrate ... --json`` prints it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Literal, Self, TypeVar

from pydantic import BaseModel, ConfigDict, computed_field

from camctl.calibration import emva
from camctl.calibration.plots import draw_exposures, draw_response, draw_transfer, panel
from camctl.calibration.steps import StepResult
from camctl.errors import UsageError
from camctl.findings import Finding
from camctl.interface.camera import CameraInfo
from camctl.model.quantiles import Z_95
from camctl.profiles.colour import ColourRecord
from camctl.profiles.exposures import ExposureRecord
from camctl.profiles.noise import Figure, NoiseRecord
from camctl.profiles.profile import DelayRecord, FrameTiming, Profile, change_profile
from camctl.profiles.response import ChannelResponse, ResponseRecord

_ModelT = TypeVar("_ModelT", bound=BaseModel)


def _part(model: type[_ModelT], whole: BaseModel) -> _ModelT:
    """Return the fields of a model that another one has, too."""
    return model.model_validate({name: getattr(whole, name) for name in model.model_fields})


class Result(BaseModel):
    """What every result has.

    Attributes:
        format_version: of the JSON output
        camera: identity of the camera; None where frames do not name it
        mode: of the camera; "" likewise
        file: the profile in which the result is kept; None: it is not
        findings: what the user should know
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    format_version: Literal[1] = 1
    camera: CameraInfo | None = None
    mode: str = ""
    file: Path | None = None
    findings: tuple[Finding, ...] = ()

    def save(self) -> Self:
        """Keep the result in the profile of its camera; return it with the file.

        Raises:
            UsageError: it is not known which camera has taken the frames
            DataError, StorageError: the profile cannot be read or written
        """
        if self.camera is None:
            raise UsageError(
                "the frames do not say which camera has taken them",
                hint="measure the camera itself, or a capture",
            )
        return self.model_copy(update={"file": change_profile(self.camera, self._keep)})

    def _keep(self, profile: Profile) -> None:
        """Add the result to the profile of its camera."""
        raise NotImplementedError


class ChannelResult(ChannelResponse):
    """The response of one channel, as a table of its levels, too.

    Attributes:
        levels: irradiance that a sample of brightness 0, 1, ... white shows, (white + 1,)
        confidence: half of the 95 % interval of ln(irradiance) of each point of the curve; None
            where it is not known
    """

    levels: tuple[float, ...]
    confidence: tuple[float, ...] | None

    @classmethod
    def of(cls, channel: ChannelResponse, phase: float) -> Self:
        """Return the result of a record's channel."""
        return cls(
            **{name: getattr(channel, name) for name in ChannelResponse.model_fields},
            levels=tuple(channel.level_table(phase).tolist()),
            confidence=None
            if channel.deviation is None
            else tuple(Z_95 * each for each in channel.deviation),
        )


class ResponseResult(ResponseRecord, Result):
    """The response of a camera.

    Attributes:
        channels: each with its curve and its table of levels
        exposures: of the frames, relative to the first, as given or as estimated
        exponent_error: relative standard deviation of an exponent of the whole curve; None where it
            is unknown
        residual: root mean square error of matched irradiances, relative
    """

    channels: tuple[ChannelResult, ...]
    exposures: tuple[float, ...]
    exponent_error: float | None
    residual: float

    @property
    def is_exact(self) -> bool:
        """Whether nothing says that the curve is too uncertain for a profile."""
        return all(each.code != "response_inexact" for each in self.findings)

    def plot(self, path: str | Path) -> None:
        """Draw the curves to an SVG or PNG file; raises as `camctl.system.plots.plot` does."""
        with panel(Path(path), "Brightness of irradiance, from black to saturation.") as axes:
            draw_response(axes, self.mode or "these frames", self)

    def _keep(self, profile: Profile) -> None:
        channels = tuple(_part(ChannelResponse, each) for each in self.channels)
        fields = {name: getattr(self, name) for name in ResponseRecord.model_fields}
        profile.responses[self.mode] = ResponseRecord.model_validate(
            {**fields, "channels": channels}
        )


class NoiseResult(NoiseRecord, Result):
    """The noise of a camera; `findings` are those of the record."""

    findings: tuple[Finding, ...] = ()

    @computed_field  # type: ignore[prop-decorator]  # mypy does not know properties of pydantic
    @property
    def conversion_e_per_dn(self) -> Figure:
        """Electrons of one level of the linear scale, at the gain nearest to 1."""
        return self.reference.conversion_e_per_dn

    @computed_field  # type: ignore[prop-decorator]
    @property
    def read_noise_e(self) -> Figure:
        """Noise without light, without quantisation, electrons, at the gain nearest to 1."""
        return self.reference.read_noise_e

    @computed_field  # type: ignore[prop-decorator]
    @property
    def emva1288(self) -> dict[str, Figure]:
        """Least signal, dynamic range and largest signal to noise, as ratios of amplitudes."""
        return self.emva()

    def emva_figures(self) -> tuple[emva.EmvaFigure, ...]:
        """Return the figures of EMVA 1288, with their units."""
        return emva.figures(self)

    def emva_report(self) -> str:
        """Return the figures of EMVA 1288 and the photon transfer curve, in Markdown."""
        camera = self.camera
        name = "" if camera is None else f"{camera.name} {camera.serial}".strip()
        return emva.report(self, name, self.mode)

    def plot(self, path: str | Path) -> None:
        """Draw the photon transfer curves, and signal over noise, to an SVG or PNG file.

        Raises as `camctl.system.plots.plot` does.
        """
        caption = "Variance of the noise of a sample at its brightness; line: the fit."
        with panel(Path(path), caption) as axes:
            draw_transfer(axes, self.mode or "these frames", self)

    def _keep(self, profile: Profile) -> None:
        profile.add_noise(self.mode, _part(NoiseRecord, self))


class ExposureResult(ExposureRecord, Result):
    """The true exposures of a camera's settings."""

    def plot(self, path: str | Path) -> None:
        """Draw true over stated exposure with the 95 % intervals to an SVG or PNG file.

        Raises as `camctl.system.plots.plot` does.
        """
        with panel(Path(path), "True over stated exposure, with 95 % intervals.") as axes:
            draw_exposures(axes, self.mode or "these frames", self)

    def _keep(self, profile: Profile) -> None:
        profile.add_exposures(self.mode, _part(ExposureRecord, self))


class ColourResult(ColourRecord, Result):
    """The colours of a camera."""

    def _keep(self, profile: Profile) -> None:
        profile.colours[self.mode] = _part(ColourRecord, self)


class DelayResult(DelayRecord, Result):
    """The control delay of a camera that streams."""

    def _keep(self, profile: Profile) -> None:
        profile.delays[self.mode] = _part(DelayRecord, self)


class StillTiming(Result):
    """What a still camera, which has no control delay, needs from picture to picture.

    Attributes:
        frames: None: there is no delay
        timing: beside the exposure
    """

    frames: None = None
    timing: FrameTiming

    def save(self) -> Self:
        """Return the result: nothing of it is kept, since captures measure it themselves."""
        return self


class StepsResult(Result):
    """What `camctl calibrate all` has measured; each result is in the profile.

    Attributes:
        steps: in their order, with one line on each result or on why there is none
        name: of the profile
    """

    steps: tuple[StepResult, ...]
    name: str
