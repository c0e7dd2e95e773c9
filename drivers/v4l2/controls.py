"""What the steps of a camera's gain do, which V4L2 does not tell and a person may know."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from camctl.controls import Choices, ExposureSetting, Steps
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
    UsageError,
)
from drivers.v4l2.abi import MANUAL_EXPOSURE, ControlId
from drivers.v4l2.modes import ControlRange
from drivers.v4l2.node import Node

_MOST_STEPS = 4096
_MOST_GAIN = 1e4


@dataclass(frozen=True)
class GainUnit:
    """What one step of a gain register adds.

    Attributes:
        is_decibel: `step` is in dB (20 log10 of the linear gain); else it is linear
        step: what each step above the lowest adds
    """

    is_decibel: bool
    step: float

    def gain(self, steps: int) -> float:
        """Return the linear gain `steps` above the lowest, which is 1."""
        added = self.step * steps
        return 10 ** min(added / 20, 300) if self.is_decibel else 1 + added


def parse_gain(text: str) -> GainUnit:
    """Return the unit that "linear:STEP" or "db:STEP" names; raises `UsageError`."""
    match = re.fullmatch(r"(linear|db):(\d*\.?\d+(?:e-?\d+)?)", text.strip().lower(), re.ASCII)
    if match is None or not 0 < float(match[2]) <= _MOST_GAIN:
        raise UsageError(
            f"a gain of '{text}'",
            hint="say what one step of the camera's gain adds: linear:0.0625 or db:0.1",
        )
    return GainUnit(match[1] == "db", float(match[2]))


def registers(control: ControlRange, unit: GainUnit) -> dict[float, int]:
    """Return the linear gains of a camera, ascending, and the register value of each.

    The lowest value is called gain 1.  Values that give absurd gains are left out.
    """
    steps = min((control.maximum - control.minimum) // control.step, _MOST_STEPS)
    gains = [(unit.gain(number), number) for number in range(steps + 1)]
    return {
        gain: control.minimum + number * control.step for gain, number in gains if gain < _MOST_GAIN
    }


#: Unit of V4L2_CID_EXPOSURE_ABSOLUTE is 100 us.
TICKS_PER_S = 10_000


@dataclass(frozen=True)
class Automatic:
    """Something that a camera changes by itself, its control, and the value that turns it off."""

    control: ControlId
    off: int
    name: str


#: What is turned off, in this order.  The power-line filter stays: what it does to the shutter
#: depends on the light, which the user knows and we do not.
AUTOMATICS = (
    Automatic(ControlId.EXPOSURE_AUTO_PRIORITY, 0, "the changing frame rate"),
    Automatic(ControlId.AUTO_WHITE_BALANCE, 0, "automatic white balance"),
    Automatic(ControlId.AUTO_N_PRESET_WHITE_BALANCE, 0, "automatic white balance"),
    Automatic(ControlId.AUTOGAIN, 0, "automatic gain"),
    Automatic(ControlId.ISO_SENSITIVITY_AUTO, 0, "automatic sensitivity"),
    Automatic(ControlId.AUTOBRIGHTNESS, 0, "automatic brightness"),
    Automatic(ControlId.BACKLIGHT_COMPENSATION, 0, "backlight compensation"),
    Automatic(ControlId.WIDE_DYNAMIC_RANGE, 0, "the camera's own dynamic range"),
    Automatic(ControlId.HDR_SENSOR_MODE, 0, "the sensor's own dynamic range"),
)


class ExposureControl:
    """The exposure of an open node, made manual.

    Args:
        node: the camera's node, streaming or not

        gain: what the steps of its gain do; None: the gain is held

    Attributes:
        notes: what could not be turned off, and what the gain is

    Raises:
        UsageError: `gain` is given, and the camera has none
        CameraError: the camera has no manual exposure
        CameraProtocolError: a control does not keep what it was set to

    """

    def __init__(self, node: Node, gain: GainUnit | None = None) -> None:
        self._node = node
        self.notes: list[str] = []
        self._registers: dict[float, int] = {}
        self._gain_set: int | None = None
        self._be_manual()
        for automatic in AUTOMATICS:
            self._turn_off(automatic)
        if gain is None:
            self._hold_gain()
        else:
            self._take_gain(gain)

    @property
    def gains(self) -> Choices:
        """The linear gains; 1 alone where it is held."""
        return Choices(tuple(self._registers) or (1.0,))

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set a time of `times` and a gain of `gains`; return both as read back.

        Raises:
            RefusedSettingError: the camera took another one, which is the nearest
            CameraProtocolError: the camera read back no exposure time at all

        """
        return ExposureSetting(self._write_time(setting.time_s), self._write_gain(setting.gain))

    def _write_gain(self, wanted: float) -> float:
        if not self._registers:
            return 1.0
        gain = self.gains.nearest(wanted)
        register = self._registers[gain]
        if register != self._gain_set:
            self._gain_set = self._node.set(ControlId.GAIN, register)
        if self._gain_set != register:
            applied = self._gain_set
            nearest = min(self._registers, key=lambda each: abs(self._registers[each] - applied))
            raise RefusedSettingError("gain", wanted, nearest)
        return gain

    def _take_gain(self, unit: GainUnit) -> None:
        gain = self._node.control(ControlId.GAIN)
        if gain is None or gain.is_read_only:
            raise UsageError(f"{self._node.path} has no gain that can be set", hint="leave it out")
        self._registers = registers(gain, unit)
        self._write_gain(1.0)
        self.notes.append(
            f"the gain is what -O gain says of its steps, and 1 at its lowest, {gain.minimum}"
        )

    def _write_time(self, time_s: float) -> float:
        ticks = round(time_s * TICKS_PER_S)
        applied = self._node.set(ControlId.EXPOSURE_ABSOLUTE, ticks)
        if applied <= 0:
            raise CameraProtocolError(
                f"{self._node.path} says that its exposure takes {applied} x 100 us",
                hint="unplug it, plug it in again and try again",
            )
        if applied != ticks:
            raise RefusedSettingError("time_s", time_s, applied / TICKS_PER_S)
        return applied / TICKS_PER_S

    def _be_manual(self) -> None:
        auto = self._node.control(ControlId.EXPOSURE_AUTO)
        if self._node.control(ControlId.EXPOSURE_ABSOLUTE) is None:
            raise self._not_manual("has no control for the exposure time in seconds")
        if auto is None:
            self.notes.append("the camera has no switch for automatic exposure: taken as manual")
            return
        if not self._node.menu_has(ControlId.EXPOSURE_AUTO, MANUAL_EXPOSURE):
            raise self._not_manual("has no manual exposure")
        if self._node.set(ControlId.EXPOSURE_AUTO, MANUAL_EXPOSURE) != MANUAL_EXPOSURE:
            raise self._not_manual("does not leave automatic exposure")

    def _not_manual(self, why: str) -> CameraError:
        return CameraError(
            f"{self._node.path} {why}, so that no exposure can be set",
            hint="use a camera whose exposure_time_absolute v4l2-ctl --list-ctrls shows",
        )

    def _turn_off(self, automatic: Automatic) -> None:
        """Turn one automatic off, or note that it cannot be."""
        try:
            control = self._node.control(automatic.control)
            if control is None:
                return
            off = control.nearest(automatic.off)
            if control.is_read_only:
                is_off = self._node.get(automatic.control) == off
            else:
                is_off = self._node.set(automatic.control, off) == off
        except (CameraDisconnectedError, CameraTimeoutError):
            raise
        except CameraError:
            is_off = False
        if not is_off:
            self.notes.append(
                f"{automatic.name} cannot be turned off: frames of one exposure may differ"
            )

    def _hold_gain(self) -> None:
        """Set the gain to its default and keep it there.

        The unit of V4L2_CID_GAIN is the vendor's secret: steps may be dB, ISO or register values.
        Its default is what the camera was made for; below it some sensors no longer reach white.
        """
        gain = self._node.control(ControlId.GAIN)
        if gain is None or gain.is_read_only:
            return
        default = gain.nearest(gain.default)
        if self._node.set(ControlId.GAIN, default) != default:
            self.notes.append("the gain cannot be held: frames of one exposure may differ")
            return
        self.notes.append(
            f"gain is held at its default, {default}, called 1: what its other "
            f"{(gain.maximum - gain.minimum) // gain.step} steps do is not known (-O gain says it)"
        )

    def times(self, interval_s: float) -> Steps:
        """Return the exposure times, s.

        They end at the frame interval, which no exposure may exceed where frames keep their rate.

        Raises:
            CameraError: the shortest is longer than a frame
            CameraProtocolError: there is none

        """
        control = self._node.control(ControlId.EXPOSURE_ABSOLUTE)
        if control is None:
            raise self._not_manual("lost its control for the exposure time")
        step = control.step
        first = control.minimum
        if first <= 0:
            first += step * (-first // step + 1)
        longest = min(control.maximum, math.floor(interval_s * TICKS_PER_S * (1 + 1e-9)))
        if first > control.maximum:
            raise CameraProtocolError(
                f"{self._node.path} offers no exposure above 0 s",
                hint="unplug it, plug it in again and try again",
            )
        if longest < first:
            raise CameraError(
                f"the shortest exposure of {self._node.path}, {first / TICKS_PER_S:g} s, is longer "
                f"than a frame of {interval_s:g} s",
                hint="choose a lower frame rate with -O fps=...",
            )
        last = first + (longest - first) // step * step
        return Steps(first / TICKS_PER_S, last / TICKS_PER_S, step / TICKS_PER_S)
