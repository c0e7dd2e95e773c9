"""The controls of a virtual webcam's camera terminal and processing unit.

Section numbers are from "USB Device Class Definition for Video Devices", revision 1.1.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from camctl.sim.devices.usb.device import STALL, ControlReply

CAMERA, PROCESSING = 1, 2  # entities: camera terminal, processing unit

SET, GET = 0x01, 0x81  # requests SET_CUR and GET_CUR, then GET_MIN to GET_DEF (A.8)
MINIMUM, MAXIMUM, RESOLUTION, LENGTH, INFO, DEFAULT = 0x82, 0x83, 0x84, 0x85, 0x86, 0x87
CAN_GET_AND_SET, _DISABLED, _AUTO_UPDATED = 0x03, 0x04, 0x08  # GET_INFO (4.1.2)

_ERROR_CODE = 0x02  # selector of the reason of the last refusal, on the interface (4.2.1.2)
_WRONG_STATE, _OUT_OF_RANGE, _INVALID_CONTROL, _INVALID_REQUEST = 2, 4, 6, 7

TICKS_PER_S = 10_000  # exposure times are in units of 100 us (4.2.2.1.4)
_GAIN_STEPS = 16  # register steps per unit of linear gain
_TARGET_LEVEL = 0.46  # mean that automatic exposure aims at, share of full scale
_DARKEST_LEVEL = 0.05  # below it automatic exposure takes the mean for this


@dataclass(frozen=True)
class ControlSpec:
    """A control of an entity (sections 4.2.2.1 and 4.2.2.3).

    Attributes:
        entity, selector: its address
        bit: its bit in the entity's bmControls
        size: bytes
        minimum, maximum, step, default: its range; for a bitmap `step` is the set of choices
        is_bitmap: exactly one bit of `step` is set
    """

    entity: int
    selector: int
    bit: int
    size: int
    minimum: int
    maximum: int
    step: int
    default: int
    is_bitmap: bool = False

    def pack(self, value: int) -> bytes:
        return value.to_bytes(self.size, "little")

    def allows(self, value: int) -> bool:
        if self.is_bitmap:
            return value.bit_count() == 1 and bool(value & self.step)
        return self.minimum <= value <= self.maximum


MANUAL, APERTURE_PRIORITY = 1, 8  # of ae_mode's bitmap
CONTROLS: Mapping[str, ControlSpec] = {
    "ae_mode": ControlSpec(
        CAMERA, 0x02, 1, 1, 1, 8, MANUAL | APERTURE_PRIORITY, APERTURE_PRIORITY, is_bitmap=True
    ),
    "ae_priority": ControlSpec(CAMERA, 0x03, 2, 1, 0, 1, 1, 1),
    "exposure": ControlSpec(CAMERA, 0x04, 3, 4, 1, 100_000, 1, 157),  # 100 us
    "backlight": ControlSpec(PROCESSING, 0x01, 8, 2, 0, 2, 1, 1),
    "brightness": ControlSpec(PROCESSING, 0x02, 0, 2, 0, 255, 1, 128),
    "gain": ControlSpec(PROCESSING, 0x04, 9, 2, 0, 240, 1, 0),  # linear gain 1 + value / 16
    "mains": ControlSpec(PROCESSING, 0x05, 10, 1, 0, 2, 1, 1),
    "wb_temperature": ControlSpec(PROCESSING, 0x0A, 6, 2, 2800, 6500, 10, 4000),
    "wb_auto": ControlSpec(PROCESSING, 0x0B, 12, 1, 0, 1, 1, 1),
}
_EXPOSURE_CONTROLS = ("exposure", "gain", "ae_mode")


class Controls:
    """The values of `CONTROLS`, and the replies to requests for them.

    Args:
        exposure_changed: called when a control that changes the exposure has been set

    Attributes:
        values: register value of each control by name
        longest_s: longer shutter times are silently cut to this
    """

    def __init__(self, exposure_changed: Callable[[], None]) -> None:
        self._exposure_changed = exposure_changed
        self._error = 0
        self.longest_s = math.inf
        self.values: dict[str, int] = {}
        self.reset()

    def reset(self) -> None:
        """Set all controls to their defaults: all automatic modes on."""
        self.values = {name: control.default for name, control in CONTROLS.items()}

    @property
    def is_metering(self) -> bool:
        return self.values["ae_mode"] != MANUAL

    @property
    def exposure(self) -> tuple[float, float]:
        """The shutter time, s, and the linear gain that are set."""
        return self.values["exposure"] / TICKS_PER_S, 1 + self.values["gain"] / _GAIN_STEPS

    def reply(self, request: int, entity: int, selector: int, data: bytes) -> ControlReply:
        """Return the reply to a class request for an entity; entity 0 is the interface itself."""
        if entity == 0 and selector == _ERROR_CODE and request == GET:
            return bytes([self._error])
        for name, control in CONTROLS.items():
            if (control.entity, control.selector) == (entity, selector):
                return self._reply(name, control, request, data)
        return self._refuse(_INVALID_CONTROL)

    def meter(self, level: float, time_s: float, longest_s: float) -> None:
        """Adapt an automatic exposure to a frame of mean `level`, 0 to 1.

        `time_s` is the frame's exposure: a change is made only when the last one is in force, so
        that the exposure does not oscillate.
        """
        most = max(1, math.floor(min(longest_s, self.longest_s) * TICKS_PER_S))
        ticks = min(self.values["exposure"], most)
        if not self.is_metering or round(time_s * TICKS_PER_S) != ticks:
            return
        ideal = round(ticks * min(2.0, _TARGET_LEVEL / max(level, _DARKEST_LEVEL)))
        self.values["exposure"] = min(max(1, ideal), most)
        self._exposure_changed()

    def _reply(self, name: str, control: ControlSpec, request: int, data: bytes) -> ControlReply:
        if request == INFO:
            return bytes([self._info(name)])
        if request == LENGTH:
            return control.size.to_bytes(2, "little")
        if request == SET:
            return self._set(name, control, data)
        values = {
            GET: self.values[name],
            MINIMUM: control.minimum,
            MAXIMUM: control.maximum,
            RESOLUTION: control.step,
            DEFAULT: control.default,
        }
        if request not in values:
            return self._refuse(_INVALID_REQUEST)
        return control.pack(values[request])

    def _set(self, name: str, control: ControlSpec, data: bytes) -> ControlReply:
        if self._is_automatic(name):
            return self._refuse(_WRONG_STATE)
        value = int.from_bytes(data[: control.size], "little")
        if len(data) < control.size or not control.allows(value):
            return self._refuse(_OUT_OF_RANGE)
        if name == "exposure" and value > self.longest_s * TICKS_PER_S:
            value = max(1, math.floor(self.longest_s * TICKS_PER_S))
        self.values[name] = value
        if name in _EXPOSURE_CONTROLS:
            self._exposure_changed()
        return b""

    def _is_automatic(self, name: str) -> bool:
        if name in ("exposure", "gain"):
            return self.is_metering
        return name == "wb_temperature" and self.values["wb_auto"] == 1

    def _info(self, name: str) -> int:
        auto_updated = _AUTO_UPDATED if name == "exposure" else 0
        return CAN_GET_AND_SET | auto_updated | (_DISABLED if self._is_automatic(name) else 0)

    def _refuse(self, reason: int) -> ControlReply:
        self._error = reason
        return STALL
