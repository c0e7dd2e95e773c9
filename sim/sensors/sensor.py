"""A simulated sensor: its parameters, and what a camera with it can do.

In the terms of EMVA 1288: photons become electrons by the quantum efficiency; the well holds
`full_well_e` of them; reading adds `read_noise_e`; the gain multiplies after the well, so that a
digital number (DN) stands for ``electrons_per_dn / gain`` electrons; the ADC adds `black` and its
phase, floors, and clips at ``2^bits - 1``.
"""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from camctl.errors import unknown_name
from camctl.interface.camera import MeasuredDelay
from camctl.interface.controls import (
    Choices,
    Control,
    ExposureControls,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import CameraResponse
from camctl.model.response.measured import measured_response
from camctl.sim.data_files import (
    FileModel,
    NotNegative,
    NotTiny,
    PictureShape,
    Positive,
    Seconds,
    built_in_files,
    read_file,
    read_text,
)
from camctl.sim.noise import largest_noise
from camctl.sim.sensors.curve import curve_samples
from camctl.sim.sensors.parts import Dark, Lens, Pixels, ReadOut

DEFAULT_SENSOR = "standard"

_LEAST_WELL, _MOST_WELL = 0.25, 4.0
"""Full well over the ADC's range.  Outside of these limits most levels would never occur, or most
of the well could not be used, so that one of the numbers must be wrong."""

ROUNDING_SHARE = 5e-7
"""How much lower a full well may read than in exact arithmetic: about 8 roundings in float32."""

_PHOTONS_PER_LUX_S_UM2 = 4091.0
"""Photons of 555 nm a second and square micrometre in one lux: 1 lx = 1/683 W/m^2 there, over
h c / wavelength = 3.579e-19 J, times 1e-12 m^2."""

_MOST_AIRY_PX = 32.0  # first dark ring; the third one then is within 86 pixels
_LONGEST_UM = 0.6  # wavelength of red

_MOST_CHARGE_E = 1e9  # in a pixel

Weights = tuple[NotNegative, NotNegative, NotNegative]


class Sensor(FileModel):
    """One sensor; a JSON file with these fields describes one too.

    Attributes:
        name: of the sensor
        bits: of the ADC, 1 to 16
        layout: pixel layout of its frames; None follows the scene: RGB for a coloured one,
            otherwise mono
        shape: (rows, columns) that a drawn scene has unless a size is requested
        full_well_e: electrons that a pixel holds
        electrons_per_dn: K, electrons for one DN at gain 1; left out, the full well just fills the
            range of the ADC
        photon_noise: False for an ideal sensor
        read_noise_e: standard deviation of reading, electrons
        black: brightness without light, DN
        phase: of the quantiser: 0 floors, 1/2 rounds
        curve: "linear", "srgb", the exponent of a power curve (brightness = irradiance^exponent),
            or a list of (irradiance, brightness) from (0, 0) to (1, 1)
        quantum_efficiency: electrons for one photon
        time_minimum_s, time_maximum_s, line_s: exposure times; all are whole numbers of lines
        gain_maximum, gain_step: linear gain from 1 up; step 0 is continuous
        delay_frames: frames from setting an exposure to the frame that has it; -1: the frame that
            is being exposed has it already
        gain_delay_frames: of the gain; None: as of the exposure time
        delay_jitter_frames: up to so many frames more, at random; 0 for a constant delay
        frame_interval_s: least time from frame to frame
        spectrum: three rows, the sensor's red, green and blue as weights of the scene's red, green
            and blue; None if they are the same
        lens, dark, pixels, read_out: see `camctl.sim.sensors.parts`; left out, their effects are
        absent
    """

    name: Annotated[str, StringConstraints(max_length=200)]
    bits: int = Field(ge=1, le=16)
    layout: Layout | None = None
    shape: PictureShape = (480, 640)
    full_well_e: Annotated[Positive, Field(le=_MOST_CHARGE_E)]
    electrons_per_dn: Positive = Field(default=None, validate_default=True)
    photon_noise: bool = True
    read_noise_e: NotNegative = 0.0
    black: int = Field(default=0, ge=0)
    phase: float = Field(default=0.0, ge=0, lt=1)
    curve: Literal["linear", "srgb"] | Positive | tuple[tuple[float, float], ...] = "linear"
    quantum_efficiency: Annotated[Positive, Field(le=1e3)] = 0.5
    time_minimum_s: Seconds = 1e-5
    time_maximum_s: Seconds = 60.0
    line_s: Seconds = 1e-5
    gain_maximum: float = Field(default=1.0, ge=1, le=1e6, allow_inf_nan=False)
    gain_step: Annotated[NotNegative, NotTiny] = 0.0
    delay_frames: int = Field(default=2, ge=-1, le=30)
    gain_delay_frames: int | None = Field(default=None, ge=-1, le=30)
    delay_jitter_frames: int = Field(default=0, ge=0, le=30)
    frame_interval_s: Seconds = 1 / 30
    spectrum: tuple[Weights, Weights, Weights] | None = None
    lens: Lens = Lens()
    dark: Dark = Dark()
    pixels: Pixels = Pixels()
    read_out: ReadOut = ReadOut()

    @model_validator(mode="before")
    @classmethod
    def _fill_in_gain(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("electrons_per_dn") is None:
            bits, black, well = data.get("bits"), data.get("black") or 0, data.get("full_well_e")
            # Values that are invalid are left for the checks of their own fields.
            if (
                isinstance(bits, int)
                and isinstance(black, int)
                and isinstance(well, int | float)
                and well <= _MOST_CHARGE_E
                and 1 <= bits <= 16
                and 0 <= black < 2**bits
            ):
                return {**data, "electrons_per_dn": well / (2**bits - black)}
        return data

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.black >= 2**self.bits - 1:
            raise ValueError(f"a black level of {self.black} leaves no room in {self.bits} bits")
        filled = self.full_well_e / self.adc_range_e
        if not _LEAST_WELL <= filled <= _MOST_WELL:
            raise ValueError(
                f"full_well_e {self.full_well_e:g} contradicts electrons_per_dn"
                f" {self.electrons_per_dn:g} x {2**self.bits - self.black} levels"
                f" = {self.adc_range_e:g} electrons: expected {_LEAST_WELL:g} to {_MOST_WELL:g}"
                " times that"
            )
        if self.white <= self.black:
            raise ValueError("read noise and offsets are as large as the full well")
        if self.lens.diffraction and self.airy_radius_px(_LONGEST_UM) > _MOST_AIRY_PX:
            raise ValueError(
                f"an Airy disk with a radius of {self.airy_radius_px(_LONGEST_UM):.3g} pixels:"
                f" expected at most {_MOST_AIRY_PX:g}; enlarge pitch_um or lower f_number"
            )
        if self.time_minimum_s > self.time_maximum_s:
            raise ValueError("time_minimum_s is above time_maximum_s")
        lines = self.time_minimum_s / self.line_s
        if lines < 1 - 1e-9 or abs(lines - round(lines)) > 1e-6 * lines:
            raise ValueError("time_minimum_s must be a whole number of line_s")
        if self.read_out.nonlinearity_dn > (2**self.bits - self.black) / 8:
            raise ValueError("read_out.nonlinearity_dn is more than an eighth of the ADC's range")
        if self.curve != "linear":
            self._check_curve()
        return self

    def _check_curve(self) -> None:
        if self.white < 2**self.bits - 1:
            raise ValueError("a sensor with a curve needs a full well beyond the ADC's range")
        if self.black:
            raise ValueError("a sensor with a curve has no black level: leave black at 0")
        if self.read_out.nonlinearity_dn:
            raise ValueError(
                "a sensor with a curve has no other non-linearity: leave out"
                " read_out.nonlinearity_dn"
            )
        _ = self.response  # raises for an invalid curve

    @property
    def delay(self) -> MeasuredDelay:
        """Bounds of the control delay, frames."""
        time, more = self.delay_frames, self.delay_jitter_frames
        gain = time if self.gain_delay_frames is None else self.gain_delay_frames
        return MeasuredDelay(
            min(time, gain), max(time, gain) + more, (time, time + more), (gain, gain + more)
        )

    @property
    def _largest_read_noise_e(self) -> float:
        """Largest error of the charge by reading, electrons."""
        added = self.read_noise_e + self.pixels.dsnu_e
        added += self.read_out.row_noise_e + self.read_out.column_noise_e
        added += self.read_out.adc_noise_e
        stepped = self.read_out.rts_e if self.read_out.rts_share > 0 else 0.0
        return largest_noise() * added + stepped

    @property
    def photons_per_candela(self) -> float:
        """Photons a pixel a second for a luminance of 1 cd/m^2 (as 555 nm light).

        The illuminance of the sensor by a distant scene is ``pi L T / (4 N^2)`` lux.
        """
        illuminance = math.pi * self.lens.transmission / (4 * self.lens.f_number**2)
        return illuminance * _PHOTONS_PER_LUX_S_UM2 * self.pixels.pitch_um**2

    def airy_radius_px(self, wavelength_um: float) -> float:
        """Radius of the first dark ring of the Airy disk, pixels."""
        return 1.22 * wavelength_um * self.lens.f_number / self.pixels.pitch_um

    @property
    def adc_range_e(self) -> float:
        """Electrons from black to the top of the ADC at gain 1."""
        return float(self.electrons_per_dn * (2**self.bits - self.black))

    @property
    def white(self) -> int:
        """Brightness from which a sample is saturated, DN, at every gain.

        The top of the ADC, or less if the well clips first.  The brightness of a full well varies
        with the noise of reading, which is bounded: white is the highest level that every sample
        of a full pixel reaches for certain.  Brightness beyond white contains no information.
        """
        full_e = self.full_well_e - self._largest_read_noise_e
        full = self.black + self.phase + full_e / self.electrons_per_dn * (1 - ROUNDING_SHARE)
        return min((1 << self.bits) - 1, math.floor(full))

    @property
    def full_scale_e(self) -> float:
        """Electrons at gain 1 for irradiance E = 1, which is level white + 1 if linear."""
        return self.electrons_per_dn * (self.white - self.black + 1)

    @cached_property
    def response(self) -> CameraResponse | None:
        """The response as levels; None for a linear sensor.

        Raises:
            DataError: the curve is no response
        """
        if self.curve == "linear":
            return None
        label = self.curve if isinstance(self.curve, str) else "curve of " + self.name
        levels = self.white - self.black
        return measured_response(
            *curve_samples(self.curve), bits=self.bits, phase=self.phase, levels=levels, name=label
        )

    @property
    def noise_model(self) -> NoiseModel:
        """The noise that its parameters give; row and column noise count as read noise and DSNU."""
        temporal_e, adc_e = (
            (self.read_noise_e, self.read_out.row_noise_e),
            self.read_out.adc_noise_e,
        )
        count = math.ceil(2 * math.log2(self.gain_maximum)) + 1 if adc_e > 0 else 1
        gains = [2 ** (step / 2) for step in range(count)]
        return NoiseModel(
            conversion_e_per_dn=self.electrons_per_dn,
            read_noise_e=tuple((gain, math.hypot(*temporal_e, adc_e / gain)) for gain in gains),
            full_well_e=self.full_well_e,
            dark_current_e_s=self.dark.current_e_s * self.dark.rate_factor,
            prnu=self.pixels.prnu,
            dsnu_e=math.hypot(self.pixels.dsnu_e, self.read_out.column_noise_e),
            dcnu_e_s=self.dark.dcnu_e_s * self.dark.rate_factor,
            photon_noise=self.photon_noise,
        )

    @property
    def times(self) -> Steps:
        return Steps(self.time_minimum_s, self.time_maximum_s, self.line_s)

    @property
    def gains(self) -> Control:
        most = self.gain_maximum
        return Steps(1.0, most, self.gain_step) if most > 1 else Choices((1.0,))

    def layout_for(self, is_coloured: bool) -> Layout:
        """Return the layout of frames of a scene that is coloured or grey."""
        return self.layout or (Layout.RGB if is_coloured else Layout.MONO)

    def controls(
        self,
        shape: tuple[int, int],
        *,
        is_coloured: bool,
        photons_per_unit: float,
    ) -> ExposureControls:
        """Return the exposure controls of a camera with this sensor in front of a scene.

        Args:
            shape: (rows, columns) of its frames
            is_coloured: whether the scene has colours
            photons_per_unit: photons a pixel a second for one unit of the scene's irradiance
        """
        delay = self.delay
        return ExposureControls(
            time_s=self.times,
            gain=self.gains,
            shape=shape,
            layout=self.layout_for(is_coloured),
            bits=self.bits,
            black=self.black,
            white=self.white,
            phase=self.phase,
            response=self.response,
            response_origin=ResponseOrigin.STATED,
            delay_frames=delay.largest if delay.smallest == delay.largest else None,
            frame_interval_s=self.frame_interval_s,
            sensitivity=photons_per_unit * self.quantum_efficiency / self.full_scale_e,
            noise=self.noise_model,
        )


def sensor_names() -> tuple[str, ...]:
    """Return the names of the built-in sensors."""
    return tuple(sorted(built_in_files("sensors")))


def load_sensor(name_or_path: str | Path) -> Sensor:
    """Return a built-in sensor by its name, or one from a JSON file.

    Raises:
        UsageError: no sensor of that name
        DataError: the file is missing, is not JSON, or describes no sensor
    """
    name = str(name_or_path)
    if Path(name).suffix == ".json":
        return read_file(Sensor, Path(name))
    built_in = built_in_files("sensors")
    if name not in built_in:
        raise unknown_name("sensor", name, built_in)
    return read_text(Sensor, built_in[name], source=f"sensor {name}")
