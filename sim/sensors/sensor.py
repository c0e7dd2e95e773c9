"""What a simulated sensor is: from light to digital numbers, with the field's own parameters.

In the terms of EMVA 1288: photons become electrons by the quantum efficiency; the well holds
`full_well_e` of them; reading adds `read_noise_e`; the gain multiplies after the well, so that a
digital number (DN) stands for ``electrons_per_dn / gain`` electrons; the ADC adds `black` and its
phase, floors, and clips at ``2^bits - 1``.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from camctl.controls import Choices, Control, ExposureControls, Layout, Steps
from camctl.errors import CamctlError, DataError, unknown_name
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.measured import measured_response
from sim.noise import largest_noise
from sim.sensors.parts import (
    Dark,
    Lens,
    Matrix,
    NotNegative,
    Pixels,
    Positive,
    ReadOut,
    photons_per_candela,
)

DEFAULT_SENSOR = "standard"

# A well far from the ADC's range is a slip of the pen: most levels would never be seen, or most
# of the well.
_WELL_RANGE = (0.25, 4.0)

_PARTS = (("lens",), ("dark",), ("pixels",), ("read_out",))


@dataclass(frozen=True)
class SensorNoise:
    """What predicts the noise of a frame at gain 1, in brightness levels.

    Attributes:
        electrons_per_level: electrons that make one level; infinite without photon noise
        read_noise_levels: standard deviation of read noise, levels
    """

    electrons_per_level: float
    read_noise_levels: float


class Sensor(BaseModel):
    """One sensor; a JSON file with these fields is one too.

    Attributes:
        name: what a person calls it
        bits: of the ADC, 4 to 16
        layout: how colour lies in a frame; None follows the scene: RGB for a coloured one, else
            mono
        shape: (rows, columns) that a built-in scene is drawn at unless a size is asked for
        full_well_e: electrons that a pixel holds
        electrons_per_dn: K, electrons for one DN at gain 1; left out, the well just fills the ADC
        photon_noise: False for an ideal sensor
        read_noise_e: standard deviation of reading, electrons
        black: brightness without light, DN
        phase: of the quantiser: 0 floor, 1/2 rounding
        curve: "linear", "srgb", the exponent of a power curve (brightness = irradiance^exponent),
            or a list of (irradiance, brightness) from (0, 0) to (1, 1)
        quantum_efficiency: electrons a photon
        time_minimum_s, time_maximum_s, line_s: shutter times; all are whole numbers of lines
        gain_maximum, gain_step: linear gain from 1 up; step 0 is continuous
        delay_frames: frames from setting an exposure to the frame that has it
        delay_jitter_frames: up to so many more, at random; 0 for a constant delay
        frame_interval_s: least time from frame to frame
        spectrum: what the sensor's red, green and blue make of the scene's, three rows; None
            is each its own
        lens, dark, pixels, read_out: see `sim.sensors.parts`; left out, their effects are absent
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    bits: int = Field(ge=4, le=16)
    layout: Layout | None = None
    shape: tuple[Annotated[int, Field(ge=1)], Annotated[int, Field(ge=1)]] = (480, 640)
    full_well_e: Positive
    electrons_per_dn: Positive
    photon_noise: bool = True
    read_noise_e: NotNegative = 0.0
    black: int = Field(default=0, ge=0)
    phase: float = Field(default=0.0, ge=0, lt=1)
    curve: Literal["linear", "srgb"] | Positive | tuple[tuple[float, float], ...] = "linear"
    quantum_efficiency: Positive = 0.5
    time_minimum_s: Positive = 1e-5
    time_maximum_s: Positive = 60.0
    line_s: Positive = 1e-5
    gain_maximum: float = Field(default=1.0, ge=1, allow_inf_nan=False)
    gain_step: NotNegative = 0.0
    delay_frames: int = Field(default=2, ge=0, le=30)
    delay_jitter_frames: int = Field(default=0, ge=0, le=30)
    frame_interval_s: Positive = 1 / 30
    spectrum: Matrix | None = None
    lens: Lens = Lens()
    dark: Dark = Dark()
    pixels: Pixels = Pixels()
    read_out: ReadOut = ReadOut()

    @model_validator(mode="before")
    @classmethod
    def _fill_in_gain(cls, data: object) -> object:
        if isinstance(data, dict) and data.get("electrons_per_dn") is None:
            bits, black, well = (data.get(key) for key in ("bits", "black", "full_well_e"))
            black = 0 if black is None else black
            # Anything else is left for the fields themselves to refuse.
            if (
                isinstance(bits, int)
                and isinstance(black, int)
                and isinstance(well, int | float)
                and 1 <= bits <= 16
                and black < 2**bits
            ):
                return {**data, "electrons_per_dn": well / (2**bits - black)}
        return data

    @model_validator(mode="after")
    def _agrees_with_itself(self) -> Self:
        if self.black >= 2**self.bits - 1:
            raise ValueError(f"a black level of {self.black} leaves no room in {self.bits} bits")
        filled = self.full_well_e / self.adc_range_e
        if not _WELL_RANGE[0] <= filled <= _WELL_RANGE[1]:
            raise ValueError(
                f"full_well_e {self.full_well_e:g} contradicts electrons_per_dn"
                f" {self.electrons_per_dn:g} x {2**self.bits - self.black} levels"
                f" = {self.adc_range_e:g} electrons"
            )
        if self.white <= self.black:
            raise ValueError("the noise of reading is as large as the well")
        if self.curve != "linear" and self.white < 2**self.bits - 1:
            raise ValueError("a sensor with a curve needs a well beyond the ADC's range")
        if self.curve != "linear" and self.black:
            raise ValueError("a sensor with a curve has no black level: leave black at 0")
        _ = self.response  # a bad curve is refused here and not in the middle of a shot
        self._parts_agree()
        if self.time_minimum_s > self.time_maximum_s:
            raise ValueError("time_minimum_s is above time_maximum_s")
        lines = self.time_minimum_s / self.line_s
        if lines < 1 - 1e-9 or abs(lines - round(lines)) > 1e-6 * lines:
            raise ValueError("time_minimum_s must be a whole number of line_s")
        return self

    def _parts_agree(self) -> None:
        bow = self.read_out.nonlinearity_dn
        if bow > (2**self.bits - self.black) / 8:
            raise ValueError("nonlinearity_dn is more than an eighth of the ADC's range")
        if self.curve != "linear" and bow:
            raise ValueError("a sensor with a curve has its nonlinearity in the curve")

    @property
    def _uncertainty_e(self) -> float:
        """Most that reading can add to or take from a full well, electrons."""
        added = self.read_noise_e + self.pixels.dsnu_e
        added += self.read_out.row_noise_e + self.read_out.column_noise_e
        return largest_noise() * added

    @property
    def photons_per_candela(self) -> float:
        """Photons a pixel a second for a luminance of 1 cd/m^2, through its lens."""
        return photons_per_candela(self.lens, self.pixels)

    @property
    def adc_range_e(self) -> float:
        """Electrons from black to the top of the ADC at gain 1."""
        return float(self.electrons_per_dn * (2**self.bits - self.black))

    @property
    def white(self) -> int:
        """Brightness from which a sample is saturated, DN, at every gain.

        The top of the ADC, or where the well clips if that lies lower.  A full well still varies
        by the read noise, which is bounded: white lies so far below that each sample of a full
        pixel reads at least white, and what it reads beyond white means nothing.
        """
        full_e = self.full_well_e - self._uncertainty_e
        # Half a part in a million lower, against rounding in float32.
        full = self.black + self.phase + full_e / self.electrons_per_dn * (1 - 5e-7)
        return min((1 << self.bits) - 1, math.floor(full))

    @property
    def full_scale_e(self) -> float:
        """Electrons at gain 1 where irradiance E = 1 lies: level white + 1 of a linear sensor."""
        return self.electrons_per_dn * (self.white - self.black + 1)

    @cached_property
    def response(self) -> CameraResponse | None:
        """The response as levels; None for a linear sensor."""
        if self.curve == "linear":
            return None
        irradiance, brightness = _curve_samples(self.curve)
        label = self.curve if isinstance(self.curve, str) else "curve of " + self.name
        levels = self.white - self.black
        return measured_response(
            irradiance, brightness, bits=self.bits, phase=self.phase, levels=levels, name=label
        )

    @property
    def noise(self) -> SensorNoise:
        """What predicts the noise of its frames at gain 1."""
        return self.noise_at(1.0)

    def noise_at(self, gain: float) -> SensorNoise:
        """Return what predicts the noise of its frames at a linear `gain`."""
        per_dn = self.electrons_per_dn / gain
        return SensorNoise(per_dn if self.photon_noise else math.inf, self.read_noise_e / per_dn)

    @property
    def times(self) -> Steps:
        """The shutter times."""
        return Steps(self.time_minimum_s, self.time_maximum_s, self.line_s)

    @property
    def gains(self) -> Control:
        """The linear gains."""
        if self.gain_maximum == 1:
            return Choices((1.0,))
        return Steps(1.0, self.gain_maximum, self.gain_step)

    def layout_for(self, is_coloured: bool) -> Layout:
        """Return the layout of frames of a scene that is coloured or grey."""
        return self.layout or (Layout.RGB if is_coloured else Layout.MONO)

    def controls(
        self,
        shape: tuple[int, int],
        *,
        is_coloured: bool,
        photons_per_unit: float,
        notes: tuple[str, ...] = (),
    ) -> ExposureControls:
        """Return what a camera with this sensor says of itself before a scene.

        `photons_per_unit` is photons a pixel a second for one unit of the scene's irradiance;
        `notes` are what there is to say of the scene.
        """
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
            delay_frames=None if self.delay_jitter_frames else self.delay_frames,
            frame_interval_s=self.frame_interval_s,
            sensitivity=photons_per_unit * self.quantum_efficiency / self.full_scale_e,
            notes=notes,
        )


def _curve_samples(
    curve: str | float | tuple[tuple[float, float], ...],
) -> tuple[FloatArray, FloatArray]:
    if isinstance(curve, tuple):
        table = np.array(curve, dtype=np.float64)
        return table[:, 0], table[:, 1]
    # Even in brightness, so that the steep foot of the curve is sampled as finely as the rest.
    brightness = np.linspace(0.0, 1.0, 4097)
    if curve == "srgb":
        toe, power = brightness / 12.92, ((brightness + 0.055) / 1.055) ** 2.4
        return np.where(brightness <= 0.04045, toe, power), brightness
    return brightness ** (1 / float(curve)), brightness


def _presets() -> dict[str, str]:
    folder = resources.files("sim") / "sensors"
    return {
        item.name.removesuffix(".json"): item.read_text(encoding="utf-8")
        for item in folder.iterdir()
        if item.name.endswith(".json")
    }


def sensor_names() -> tuple[str, ...]:
    """Return the names of the sensors that come with the program."""
    return tuple(sorted(_presets()))


def load_sensor(name_or_path: str | Path) -> Sensor:
    """Return a sensor by its name or from a JSON file.

    Raises:
        UsageError: no sensor of that name
        DataError: the file is missing, is not JSON, or contradicts itself
    """
    name = str(name_or_path)
    path = Path(name)
    if path.suffix != ".json":
        presets = _presets()
        if name not in presets:
            raise unknown_name("sensor", name, presets)
        return read_sensor(presets[name], source=f"sensor {name}")
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file", hint="give a sensor's name or file") from error
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{path}: cannot be read ({error})", hint="give a JSON file") from error
    return read_sensor(text, source=str(path))


def read_sensor(text: str, *, source: str) -> Sensor:
    """Return the sensor that the JSON `text` describes; `source` names it in errors (DataError)."""
    try:
        return Sensor.model_validate(json.loads(text))
    except json.JSONDecodeError as error:
        raise DataError(f"{source}: not JSON, line {error.lineno}: {error.msg}") from error
    except CamctlError as error:
        raise DataError(f"{source}: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        # For a union the last part names the branch that was tried: nothing a user wrote.
        depth = 2 if first["loc"][:1] in _PARTS else 1
        place = ".".join(str(part) for part in first["loc"][:depth])
        message = first["msg"].removeprefix("Value error, ")
        raise DataError(f"{source}: {place + ': ' if place else ''}{message}") from error
