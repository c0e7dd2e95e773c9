"""Exposure time and gain of a video node, and the automatic functions that are turned off."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass

from camctl.drivers.common.gain_unit import GAIN_LIMIT, GainUnit
from camctl.drivers.v4l2.abi import MANUAL_EXPOSURE, ControlId
from camctl.drivers.v4l2.node import ControlRange, Node
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
    RefusedSettingError,
    UsageError,
)
from camctl.findings import Finding, note
from camctl.interface.controls import Choices, ExposureSetting, Steps

#: The unit of V4L2_CID_EXPOSURE_ABSOLUTE is 100 us.
TICKS_PER_S = 10_000.0
#: Gain steps that are listed at most; registers of real sensors have fewer.
_MOST_GAIN_STEPS = 4096
_REPLUG = "unplug it, plug it in again and try again"


@dataclass(frozen=True)
class Automatic:
    """An automatic function of a camera: its control, and the value that turns it off."""

    control: ControlId
    off: int
    name: str


#: Turned off in this order.  A power-line filter rounds the exposure to periods of the lamps: a
#: request has an option for lamps instead.
AUTOMATICS = (
    Automatic(ControlId.EXPOSURE_AUTO_PRIORITY, 0, "the dynamic frame rate"),
    Automatic(ControlId.AUTO_WHITE_BALANCE, 0, "automatic white balance"),
    Automatic(ControlId.AUTO_N_PRESET_WHITE_BALANCE, 0, "automatic white balance"),
    Automatic(ControlId.AUTOGAIN, 0, "automatic gain"),
    Automatic(ControlId.ISO_SENSITIVITY_AUTO, 0, "automatic sensitivity"),
    Automatic(ControlId.AUTOBRIGHTNESS, 0, "automatic brightness"),
    Automatic(ControlId.BACKLIGHT_COMPENSATION, 0, "backlight compensation"),
    Automatic(ControlId.WIDE_DYNAMIC_RANGE, 0, "the camera's wide dynamic range"),
    Automatic(ControlId.HDR_SENSOR_MODE, 0, "the sensor's HDR mode"),
    Automatic(ControlId.POWER_LINE_FREQUENCY, 0, "the power-line filter"),
    Automatic(ControlId.HUE_AUTO, 0, "automatic hue"),
    Automatic(ControlId.CHROMA_AGC, 0, "automatic chroma gain"),
    Automatic(ControlId.SCENE_MODE, 0, "the scene mode"),
    Automatic(ControlId.IMAGE_STABILIZATION, 0, "image stabilisation"),
    Automatic(ControlId.FOCUS_AUTO, 0, "continuous autofocus"),
)


@dataclass(frozen=True)
class TimeUnit:
    """The control that sets the exposure time, and how many of its units a second has."""

    control: ControlId
    per_s: float


#: The gain of webcams, and the gain of image sensors.
GAINS = (ControlId.GAIN, ControlId.ANALOGUE_GAIN)


#: Controls for the time of an exposure: a node has one of them.
EXPOSURES = (ControlId.EXPOSURE_ABSOLUTE, ControlId.EXPOSURE)


class ExposureControl:
    """The exposure of an open node, set to manual.

    Args:
        node: of the camera, in the mode in which it streams
        columns: of its frames
        gain: what the steps of its gain add; None: the gain stays at its default

    Attributes:
        findings: what could not be turned off, and what is known of the gain

    Raises:
        UsageError: `gain` is given, and the camera has none
        CameraError: the camera has no manual exposure
        CameraProtocolError: a control does not keep the value that was set
    """

    def __init__(self, node: Node, columns: int, gain: GainUnit | None = None) -> None:
        self._node = node
        self.findings: list[Finding] = []
        self._gain_control = next(
            (each for each in GAINS if node.control(each) is not None), ControlId.GAIN
        )
        self._gain_registers: dict[float, int] = {}
        self._current_register: int | None = None
        self._unit = self._time_unit(columns)
        self._set_manual()
        focus = self._focus()
        were_on = [each.name for each in AUTOMATICS if self._turn_off(each)]
        if were_on:
            self._note(f"turned off: {', '.join(dict.fromkeys(were_on))}")
        if focus is not None and "continuous autofocus" in were_on:
            self._hold_focus(focus)
        if gain is None:
            self._hold_gain()
        else:
            self._use_gain(gain)

    @property
    def gains(self) -> Choices:
        """The linear gains; 1 alone where the gain is held at its default."""
        return Choices(tuple(self._gain_registers) or (1.0,))

    def times(self, interval_s: float) -> Steps:
        """Return the exposure times, s, up to the frame interval.

        A longer exposure would lower the frame rate.

        Raises:
            CameraError: the shortest is longer than the interval
            CameraProtocolError: there is none above 0
        """
        per_s = self._unit.per_s
        control = self._node.control(self._unit.control)
        if control is None:
            raise self._not_manual("lost its control for the exposure time")
        step = control.step
        first = control.minimum
        if first <= 0:
            first += step * (-first // step + 1)
        longest = min(control.maximum, math.floor(interval_s * per_s * (1 + 1e-9)))
        if first > control.maximum:
            raise CameraProtocolError(
                f"{self._node.path} offers no exposure above 0 s", hint=_REPLUG
            )
        if longest < first:
            raise CameraError(
                f"the shortest exposure of {self._node.path}, {first / per_s:g} s, is longer "
                f"than a frame of {interval_s:g} s",
                hint="choose a lower frame rate",
                remedies={"option:fps": None},
            )
        last = first + (longest - first) // step * step
        return Steps(first / per_s, last / per_s, step / per_s)

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        """Set a time of `times` and a gain of `gains`; return both as read back.

        Raises:
            RefusedSettingError: the camera applied another value, which is given as the nearest
            CameraProtocolError: the camera read back no exposure time
        """
        return ExposureSetting(self._write_time(setting.time_s), self._write_gain(setting.gain))

    def _write_time(self, time_s: float) -> float:
        per_s = self._unit.per_s
        count = round(time_s * per_s)
        applied = self._node.set(self._unit.control, count)
        if applied <= 0:
            raise CameraProtocolError(
                f"{self._node.path} reports an exposure time of {applied} x {1e6 / per_s:g} us",
                hint=_REPLUG,
            )
        if applied != count:
            raise RefusedSettingError("time_s", time_s, applied / per_s)
        return applied / per_s

    def _write_gain(self, requested: float) -> float:
        registers = self._gain_registers
        if not registers:
            return 1.0
        gain = self.gains.nearest(requested)
        register = registers[gain]
        if register != self._current_register:
            self._current_register = self._node.set(self._gain_control, register)
        if self._current_register != register:
            applied = self._current_register
            nearest = min(registers, key=lambda each: abs(registers[each] - applied))
            raise RefusedSettingError("gain", requested, nearest)
        return gain

    def _note(self, text: str) -> None:
        self.findings.append(note(text))

    def _use_gain(self, unit: GainUnit) -> None:
        control = self._node.control(self._gain_control)
        if control is None or control.is_read_only:
            raise UsageError(
                f"{self._node.path} has no gain that can be set", hint="leave the option gain out"
            )
        self._gain_registers = _gain_registers(control, unit)
        self._write_gain(1.0)
        self._note(
            f"the steps of the gain are as the option gain states, and its lowest, "
            f"{control.minimum}, is gain 1"
        )

    def _hold_gain(self) -> None:
        """Set the gain to its default and leave it there.

        The unit of V4L2_CID_GAIN depends on the vendor: dB, ISO or register values.  The default
        suits the sensor; below it, some sensors do not reach white.
        """
        control = self._node.control(self._gain_control)
        if control is None or control.is_read_only:
            return
        default = control.nearest(control.default)
        if self._node.set(self._gain_control, default) != default:
            self._note("the gain cannot be held: frames with one exposure may differ")
            return
        steps = (control.maximum - control.minimum) // control.step
        self.findings.append(
            note(
                f"the gain is held at its default, {default}, called gain 1: what its {steps} "
                "steps add is not known; give it",
                {"option:gain": None},
            )
        )

    def _time_unit(self, columns: int) -> TimeUnit:
        """Return the control for the exposure time: in units of 100 us, or in lines.

        An image sensor exposes for a number of lines; a line takes (columns + horizontal blanking)
        / pixel rate (Linux, Documentation/userspace-api/media/drivers/camera-sensor.rst).
        """
        if self._node.control(ControlId.EXPOSURE_ABSOLUTE) is not None:
            return TimeUnit(ControlId.EXPOSURE_ABSOLUTE, TICKS_PER_S)
        if self._node.control(ControlId.EXPOSURE) is None:
            raise self._not_manual("has no control for the exposure time")
        blanking = self._node.long_value(ControlId.HBLANK)
        rate = self._node.long_value(ControlId.PIXEL_RATE)
        missing = [
            name
            for name, value in (("pixel rate", rate), ("horizontal blanking", blanking))
            if value is None or value < (name == "pixel rate")
        ]
        if missing or rate is None or blanking is None:
            raise self._not_manual(
                f"sets its exposure in lines, but does not report {' and '.join(missing)}, from "
                "which the time of a line follows"
            )
        unit = TimeUnit(ControlId.EXPOSURE, rate / (columns + blanking))
        self._note(
            f"the exposure is set in lines of {1e6 / unit.per_s:.4g} us, by the pixel rate and "
            "the blanking that the sensor's driver reports"
        )
        return unit

    def _set_manual(self) -> None:
        auto = self._node.control(ControlId.EXPOSURE_AUTO)
        if auto is None:
            self._note(
                "the camera has no switch for automatic exposure: it is assumed to be manual"
            )
            return
        if not self._node.menu_has(ControlId.EXPOSURE_AUTO, MANUAL_EXPOSURE):
            raise self._not_manual("has no manual exposure")
        if self._node.set(ControlId.EXPOSURE_AUTO, MANUAL_EXPOSURE) != MANUAL_EXPOSURE:
            raise self._not_manual("does not leave automatic exposure")

    def _not_manual(self, why: str) -> CameraError:
        return CameraError(
            f"{self._node.path} {why}, so that no exposure can be set",
            hint="use a camera that has the V4L2 control exposure_time_absolute, or exposure with "
            "pixel_rate and horizontal_blanking",
        )

    def _focus(self) -> int | None:
        """Return the place of the focus; None where the camera does not report it."""
        with suppress(CameraProtocolError):
            if self._node.control(ControlId.FOCUS_ABSOLUTE) is not None:
                return self._node.get(ControlId.FOCUS_ABSOLUTE)
        return None

    def _hold_focus(self, place: int) -> None:
        """Keep the focus where it was found: some cameras move it when the autofocus ends."""
        with suppress(CameraProtocolError):
            if self._node.set(ControlId.FOCUS_ABSOLUTE, place) == place:
                self._note(f"the focus is fixed where it was, at {place}")
                return
        self._note("the focus may have moved when the autofocus was turned off")

    def _turn_off(self, automatic: Automatic) -> bool:
        """Turn an automatic function off, or note that this is not possible.

        Returns whether it was on.
        """
        was_on = False
        try:
            control = self._node.control(automatic.control)
            if control is None:
                return False
            off = control.nearest(automatic.off)
            was_on = self._node.get(automatic.control) != off
            is_off = not was_on
            if was_on and not control.is_read_only:
                is_off = self._node.set(automatic.control, off) == off
        except (CameraDisconnectedError, CameraTimeoutError):
            raise
        except CameraError:
            is_off = False
        if not is_off:
            self._note(
                f"{automatic.name} cannot be turned off: frames with one exposure may differ"
            )
        return was_on and is_off


def _gain_registers(control: ControlRange, unit: GainUnit) -> dict[float, int]:
    """Return the register value of each linear gain, ascending; the lowest is gain 1."""
    steps = min((control.maximum - control.minimum) // control.step, _MOST_GAIN_STEPS)
    gains = [(unit.gain(number), number) for number in range(steps + 1)]
    return {
        gain: control.minimum + number * control.step for gain, number in gains if gain < GAIN_LIMIT
    }
