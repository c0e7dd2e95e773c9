"""Exposure settings, and the description of what a camera can set.

A camera describes its controls in `ExposureControls` and accepts lists of `ExposureSetting`.
Values are in SI units: shutter time in seconds, linear gain, f-number.  Times are true times, not
the rounded labels of a dial (1/30 on a dial of third stops is 1/32 s).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol

from camctl.errors import DataError, RefusedSettingError, UsageError
from camctl.findings import Finding
from camctl.interface.clock import CaptureTiming
from camctl.interface.colour import CameraColour
from camctl.interface.control_values import Choices as Choices
from camctl.interface.control_values import Control as Control
from camctl.interface.control_values import Steps as Steps
from camctl.interface.layout import Layout as Layout
from camctl.messages.plain import sentence
from camctl.model.noise import FrameNoise, NoiseModel
from camctl.model.response.camera import CameraResponse, linear_response, phase_of_black


class ResponseOrigin(StrEnum):
    """From where a camera's response is known."""

    STATED = "stated"  # by the format, the maker or the user
    MEASURED = "measured"
    ASSUMED = "assumed"  # not known: a usual one is taken


@dataclass(frozen=True)
class ExposureSetting:
    """Settings of one exposure.

    Attributes:
        time_s: shutter time, s
        gain: linear gain
        f_number: f-number; None where the aperture is not controlled
    """

    time_s: float
    gain: float = 1.0
    f_number: float | None = None

    @property
    def exposure(self) -> float:
        """Exposure, which is time x gain / f-number^2, in arbitrary but constant units."""
        return self.time_s * self.gain / (self.f_number or 1.0) ** 2


class ExposureCorrection(Protocol):
    """The true exposure of a setting over the stated one, and its 95 % confidence interval."""

    @property
    def factor(self) -> float:
        """True over stated exposure."""

    @property
    def low(self) -> float:
        """Lower end of the interval."""

    @property
    def high(self) -> float:
        """Upper end of the interval."""


class TrueExposures(Protocol):
    """The true exposures of settings, as a calibration has measured them."""

    def correction(self, setting: ExposureSetting) -> ExposureCorrection | None:
        """Return the correction of a setting; None where it was not measured."""


_FIXED_GAIN = Choices((1.0,))


@dataclass(frozen=True)
class ExposureControls:
    """What a camera can set, and the properties of its frames.

    Attributes:
        time_s: shutter times, s
        gain: linear gains; `Choices((1.0,))` where gain cannot be set
        f_number: f-numbers; None where the aperture cannot be set
        shape: (rows, columns) of a frame
        layout: pixel layout of a frame
        bits: bit depth of a sample, 1 to 16
        black: black level: brightness without light, DN
        white: white level: brightness from which a sample counts as saturated, DN
        phase: phase of the quantiser in levels: 0 truncates, 1/2 rounds; a black level that is not
            a whole number gives values between; None: see `quantiser_phase`
        response: as levels between black and white; None: linear; where the colours have responses
            of their own, the response of green
        response_origin: whether the response is stated, measured or only assumed; every driver must
            say it
        responses: the responses of R, G and B where they differ; else none
        delay_frames: frames from setting an exposure to the first frame that has it; None where
            this delay is not constant, so that the driver waits until each setting takes effect
        frame_interval_s: shortest time between two frames, s; 0: a still camera
        timing: what else takes time in a capture; None where this is not known yet
        sensitivity: full scales (white - black + 1) that one second at gain 1 (and f/1 where the
            aperture can be set) gives for each unit of the scene's irradiance; None where this is
            unknown, and irradiance is then relative
        noise: the noise of its frames; None where this is unknown
        tolerance: largest relative error of a setting that counts as exact
        true_exposures: the measured exposures of its settings; None: as stated
        hot_pixels: (row, column) of the pixels whose brightness does not show the light
        findings: what a person must know of its pictures, such as `camctl.findings.note`
        profile: what a calibration of this camera has replaced above, one line; None: nothing
        pixel_format: of the stream where the layout does not say all, such as yuyv or mjpg
        colour: what R, G and B of its frames are, so that pictures are in linear BT.709; None: this
            is not known, or pictures are to have the camera's own colours
        exposures_exact: the true exposures are as stated, to `tolerance`; False: they may differ
        repeatable: a frame can be shot again, and others at other settings; False: there are no
            frames beside those that are there

    Raises:
        ValueError: the bit depth, black level and white level do not fit together
    """

    time_s: Control
    shape: tuple[int, int]
    layout: Layout
    bits: int
    gain: Control = _FIXED_GAIN
    f_number: Control | None = None
    black: int = 0
    white: int = 0
    phase: float | None = None
    response: CameraResponse | None = None
    delay_frames: int | None = None
    frame_interval_s: float = 0.0
    timing: CaptureTiming | None = None
    sensitivity: float | None = None
    noise: NoiseModel | None = None
    tolerance: float = 1e-6
    findings: tuple[Finding, ...] = ()
    responses: tuple[CameraResponse, ...] = ()
    true_exposures: TrueExposures | None = None
    hot_pixels: tuple[tuple[int, int], ...] = ()
    profile: str | None = None
    pixel_format: str = ""
    colour: CameraColour | None = None
    exposures_exact: bool = True
    repeatable: bool = True
    response_origin: ResponseOrigin = field(kw_only=True)

    def __post_init__(self) -> None:
        if not (1 <= self.bits <= 16 and 0 <= self.black < self.white < 2**self.bits):
            raise ValueError(
                f"invalid frames of {self.bits} bit with black {self.black} and white "
                f"{self.white}: expected 1 to 16 bit and 0 <= black < white < 2^bits"
            )

    @property
    def levels(self) -> CameraResponse:
        """The camera's response as levels, by which exposures are looked up."""
        if self.response is not None:
            return self.response
        levels = self.white - self.black
        return linear_response(self.bits, phase=self.quantiser_phase, levels=levels)

    @property
    def quantiser_phase(self) -> float:
        """The phase of the quantiser in levels, as `phase_of_black` where none is stated."""
        return phase_of_black(self.black) if self.phase is None else self.phase

    @property
    def plane_levels(self) -> tuple[CameraResponse, ...]:
        """The response of each plane of a frame, in the order of `Layout.planes`."""
        colours = {Layout.MONO: "G", Layout.RGB: "RGB"}.get(self.layout, self.layout.upper())
        responses = self.responses or (self.levels,) * 3
        return tuple(responses["RGB".index(each)] for each in colours)

    @property
    def has_assumed_response(self) -> bool:
        """Whether the response is only assumed."""
        return self.response_origin is ResponseOrigin.ASSUMED

    @property
    def notes(self) -> tuple[str, ...]:
        """The plain sentences of `findings`."""
        return tuple(map(sentence, self.findings))

    @property
    def response_findings(self) -> tuple[Finding, ...]:
        """A finding where the response is only assumed; none where it is known."""
        if not self.has_assumed_response:
            return ()
        name = "linear" if self.response is None else self.response.name.partition(",")[0]
        return (
            Finding(
                code="response_assumed",
                details={"response": name},
                remedies={"calibrate_response": None},
            ),
        )

    def check_response(self, measured: str) -> None:
        """Check that the response is known, without which `measured` cannot be measured.

        Args:
            measured: what is measured: "exposure" or "noise"

        Raises:
            DataError: the response is only assumed
        """
        if self.has_assumed_response:
            raise DataError(
                "the response of the camera is only assumed, and without the true one its "
                f"{measured} cannot be measured",
                hint="measure the response first, or name it if you know it",
                remedies={"calibrate_response": None, "response": None},
            )

    def exposure(self, setting: ExposureSetting) -> float:
        """Return the true exposure of a setting, in the unit of `ExposureSetting.exposure`."""
        correction = (
            None if self.true_exposures is None else self.true_exposures.correction(setting)
        )
        return setting.exposure * (1.0 if correction is None else correction.factor)

    def nearest_time(self, true_s: float, gain: float) -> float:
        """Return the shutter time whose true exposure is nearest to `true_s`, at a gain."""
        stated = ExposureSetting(self.time_s.nearest(true_s), gain)
        return self.time_s.nearest(true_s * stated.exposure / self.exposure(stated))

    def relative_exposures(self, settings: Sequence[ExposureSetting]) -> tuple[float, ...]:
        """Return true exposures relative to the smallest, in the order of `settings`."""
        exposures = [self.exposure(setting) for setting in settings]
        return tuple(exposure / min(exposures) for exposure in exposures)

    def frame_noise(self, settings: Sequence[ExposureSetting]) -> tuple[FrameNoise, ...]:
        """Return the noise of a frame at each setting; no noise where it is not known."""
        if self.noise is None:
            return (FrameNoise(math.inf, 0.0, black=self.black),) * len(settings)
        return tuple(
            self.noise.frame(gain=each.gain, time_s=each.time_s, black=self.black)
            for each in settings
        )

    def check(self, setting: ExposureSetting) -> None:
        """Check that the camera can set `setting` within its tolerance.

        Raises:
            UsageError: a value is not positive and finite, or its control does not exist
            RefusedSettingError: the camera cannot set a value; carries the nearest one that it can
        """
        for name in ("time_s", "gain", "f_number"):
            requested: float | None = getattr(setting, name)
            control: Control | None = getattr(self, name)
            if requested is None:
                continue
            if not (math.isfinite(requested) and requested > 0):
                raise UsageError(f"invalid {name} {requested}: expected a positive, finite number")
            if control is None:
                raise UsageError(
                    f"this camera cannot set {name}", hint=f"leave {name} out of the setting"
                )
            nearest = control.nearest(requested)
            if abs(nearest - requested) > self.tolerance * requested:
                raise RefusedSettingError(name, requested, nearest)


def resting_setting(
    controls: ExposureControls, settings: Sequence[ExposureSetting]
) -> ExposureSetting | None:
    """Return the setting in which a stream rests after `settings`; None: as after the last one.

    After frames that take longer than the usual interval, where the camera has one, it has a time
    below that.
    """
    usual_s = controls.frame_interval_s
    if not settings or not usual_s or settings[-1].time_s <= usual_s:
        return None
    return replace(settings[-1], time_s=controls.time_s.nearest(usual_s / 2))
