"""Exposure time and gain of a GenICam camera, and the automatic functions that are turned off."""

from __future__ import annotations

import math
from dataclasses import dataclass

from camctl.drivers.common.gain_unit import GAIN_LIMIT, GainUnit
from camctl.drivers.genicam.port import FeatureError, Kind, OpenDevice, Value
from camctl.errors import CameraError, RefusedSettingError, UsageError
from camctl.findings import Finding, note
from camctl.interface.controls import Choices, ExposureSetting, Steps

#: Names of SFNC, and those of cameras that are older than it.
_TIMES = ("ExposureTime", "ExposureTimeAbs")
_GAINS = ("Gain", "GainAbs", "GainRaw")
US_PER_S = 1e6
#: Decimals of exposure times that are written, us: 0.1 ns is below any camera's step.
_DECIMALS = 4
#: Exposure times that are written to find their step begin here, us: most cameras have it.
_PROBED_US = 2000.0
#: Increments that are tried for that: from this one, us, each twice the one before.
_FIRST_INCREMENT_US, _INCREMENTS = 1e-3, 24
#: A step is measured over so many, which makes it as exact as a float of 32 bits.
_STEPS_MEASURED = 64
#: Gains are offered in steps of so many dB where the camera states none: 1.2 % of light.
_GAIN_STEP_DB = 0.1
#: Gains that are listed at most.
_MOST_GAINS = 1024
#: Relative error of a setting that counts as exact: a float of 32 bits has 6e-8, and exposure times
#: are rounded to 1 ns at most.
TOLERANCE = 1e-4
#: Numbers that differ by less are the same float of 32 bits.
_SAME = 1e-7


@dataclass(frozen=True)
class Automatic:
    """A function of a camera that changes its pictures: its feature, and the value without it."""

    feature: str
    off: Value
    name: str


#: Turned off in this order; the sequencer first, as it locks the others.
AUTOMATICS = (
    Automatic("SequencerMode", "Off", "the sequencer"),
    Automatic("SequencerConfigurationMode", "Off", "the sequencer's configuration"),
    Automatic("ExposureMode", "Timed", "another exposure mode"),
    Automatic("ExposureAuto", "Off", "automatic exposure"),
    Automatic("GainAuto", "Off", "automatic gain"),
    Automatic("BlackLevelAuto", "Off", "automatic black level"),
    Automatic("BalanceWhiteAuto", "Off", "automatic white balance"),
    Automatic("GammaEnable", False, "gamma"),
    Automatic("Gamma", 1.0, "gamma"),
    Automatic("LUTEnable", False, "the look-up table"),
    Automatic("SharpnessEnable", False, "sharpening"),
    Automatic("SharpeningEnable", False, "sharpening"),
    Automatic("SaturationEnable", False, "saturation"),
    Automatic("HueEnable", False, "hue"),
    Automatic("ColorTransformationEnable", False, "the colour transformation"),
    Automatic("NoiseReductionEnable", False, "noise reduction"),
    Automatic("MultiExposureEnable", False, "multiple exposures in a frame"),
)


class ExposureControl:
    """The exposure of an open device, set to manual.

    Args:
        device: in the mode in which it streams
        name: of the device, for errors
        gain: what the values of its gain mean; None: dB where it says so, else the gain is held

    Attributes:
        findings: what was turned off, or could not be, and what is known of the gain
        time_name: of the feature for the exposure time
        gain_name: of the feature for the gain; "": the gain is held

    Raises:
        UsageError: `gain` is given, and the camera has none
        CameraError: the camera has no manual exposure
    """

    def __init__(self, device: OpenDevice, name: str, gain: GainUnit | None = None) -> None:
        self._device = device
        self._name = name
        self.findings: list[Finding] = []
        were_on = [each.name for each in AUTOMATICS if self._turn_off(each)]
        if were_on:
            self._note(f"turned off: {', '.join(dict.fromkeys(were_on))}")
        self.time_name = self._first(_TIMES) or ""
        if not self.time_name:
            raise CameraError(
                f"{name} has no feature ExposureTime, so that no exposure can be set",
                hint="use a camera that has it",
            )
        self.gain_name = ""
        self._gains: dict[float, float] = {}  # value of the feature by linear gain
        self._choose_gain(gain)
        self._current: dict[str, float] = {}

    @property
    def gains(self) -> Choices:
        """The linear gains; 1 alone where the gain is held."""
        return Choices(tuple(self._gains) or (1.0,))

    def times(self, longest_s: float | None = None) -> Steps:
        """Return the exposure times, s, in the steps to which the camera rounds them."""
        limits = self._device.limits(self.time_name)
        step = limits.step if limits.step > 1 / US_PER_S else self._measured_step()
        least, most = limits.minimum, limits.maximum
        if longest_s is not None:
            most = min(most, longest_s * US_PER_S)
        if least <= 0:
            least = step or 1.0
        if step:
            self._device.write(self.time_name, least)
            least = self._number(self.time_name)
            most = least + (most - least) // step * step
        self._current.clear()
        return Steps(least / US_PER_S, max(least, most) / US_PER_S, step / US_PER_S)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set a time of `times` and a gain of `gains`; return both as read back.

        Raises:
            RefusedSettingError: the camera applied another value, which is given as the nearest
        """
        # Some cameras cut decimals off: 4999.9999999 us is meant to be 5000.
        time_us = self._set(self.time_name, round(setting.time_s * US_PER_S, _DECIMALS))
        applied_s = time_us / US_PER_S
        if math.isclose(applied_s, setting.time_s, rel_tol=_SAME):
            applied_s = setting.time_s
        if abs(applied_s / setting.time_s - 1) > TOLERANCE:
            raise RefusedSettingError("time_s", setting.time_s, applied_s)
        if not self._gains:
            return ExposureSetting(applied_s)
        gain = self.gains.nearest(setting.gain)
        value = self._set(self.gain_name, self._gains[gain])
        if abs(value - self._gains[gain]) > TOLERANCE * max(1.0, abs(value)):
            nearest = min(self._gains, key=lambda each: abs(self._gains[each] - value))
            raise RefusedSettingError("gain", setting.gain, nearest)
        return ExposureSetting(applied_s, gain)

    def stated(self, time_us: float | None, value: float | None) -> ExposureSetting | None:
        """Return the setting that a frame states by its chunks; None: it states none."""
        if time_us is None or time_us <= 0:
            return None
        if value is None or not self._gains:
            return ExposureSetting(time_us / US_PER_S)
        gain = min(self._gains, key=lambda each: abs(self._gains[each] - value))
        return ExposureSetting(time_us / US_PER_S, gain)

    def forget(self) -> None:
        """Write the next setting in any case: something else has changed the features."""
        self._current.clear()

    def _set(self, name: str, value: float) -> float:
        """Set a number and return it as read back; nothing is written where it is set already."""
        if self._current.get(name) != value:
            self._device.write(name, value)
            applied = self._number(name)
            if abs(applied - value) <= TOLERANCE * abs(value):
                self._current[name] = value
            return applied
        return value

    def _number(self, name: str) -> float:
        return float(self._device.read(name))

    def _first(self, names: tuple[str, ...]) -> str | None:
        numbers = (Kind.FLOAT, Kind.INTEGER)
        return next((each for each in names if self._device.kind(each) in numbers), None)

    def _measured_step(self) -> float:
        """Return the step to which the camera rounds exposure times, us; 0: none is found."""
        limits, name = self._device.limits(self.time_name), self.time_name
        start = min(max(_PROBED_US, limits.minimum), limits.maximum / 2)
        self._device.write(name, start)
        first = self._number(name)
        for doubling in range(_INCREMENTS):
            increment = _FIRST_INCREMENT_US * 2**doubling
            self._device.write(name, first + increment)
            found = self._number(name)
            if found == first:
                continue
            if doubling == 0:
                return 0.0
            rough = found - first
            self._device.write(name, first + _STEPS_MEASURED * rough)
            return (self._number(name) - first) / _STEPS_MEASURED
        return 0.0

    def _choose_gain(self, unit: GainUnit | None) -> None:
        device, name = self._device, self._first(_GAINS)
        if device.kind("GainSelector") is Kind.ENUMERATION:
            selectors = device.entries("GainSelector")
            for each in ("All", "AnalogAll", "DigitalAll"):
                if each in selectors:
                    device.write("GainSelector", each)
                    break
        if name is None:
            if unit is not None:
                raise UsageError(
                    f"{self._name} has no gain that can be set", hint="leave the option gain out"
                )
            return
        if unit is None and device.unit(name).strip().lower() == "db":
            unit = GainUnit(True, 1.0)
        if unit is None:
            value = self._number(name)
            self.findings.append(
                note(
                    f"the gain is held at {value:g}, called gain 1: what its values mean is not "
                    "known; give it",
                    {"option:gain": None},
                )
            )
            return
        self.gain_name = name
        self._gains = self._readable_gains(unit)

    def _readable_gains(self, unit: GainUnit) -> dict[float, float]:
        """Return the values that the gain reads back, by linear gain; the lowest is gain 1."""
        limits = self._device.limits(self.gain_name)
        step = limits.step
        if not step:
            step = _GAIN_STEP_DB if unit.is_decibel else (limits.maximum - limits.minimum) / 100
        count = min(int((limits.maximum - limits.minimum) / step * (1 + 1e-9)), _MOST_GAINS - 1)
        found: dict[float, float] = {}
        for number in range(count, -1, -1):  # the lowest last: it stays
            self._device.write(self.gain_name, limits.minimum + number * step)
            value = self._number(self.gain_name)
            gain = unit.gain(value - limits.minimum)
            if gain < GAIN_LIMIT:
                found[gain] = value
        return dict(sorted(found.items()))

    def _note(self, text: str) -> None:
        self.findings.append(note(text))

    def _turn_off(self, automatic: Automatic) -> bool:
        """Turn a function off, or note that this is not possible; return whether it was on."""
        device, feature = self._device, automatic.feature
        kind = device.kind(feature)
        if kind is None or (
            kind is Kind.ENUMERATION and automatic.off not in device.entries(feature)
        ):
            return False
        try:
            if device.read(feature) == automatic.off:
                return False
            device.write(feature, automatic.off)
            if device.read(feature) == automatic.off:
                return True
        except FeatureError:
            pass  # it is noted below
        self._note(f"{automatic.name} cannot be turned off: frames with one exposure may differ")
        return False
