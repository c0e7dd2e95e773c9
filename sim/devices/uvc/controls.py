"""The registers of a virtual webcam's camera terminal and processing unit."""

from __future__ import annotations

import math
from collections.abc import Callable

from sim.devices.usb.device import STALL, Answer
from sim.devices.uvc.descriptors import CONTROLS, MANUAL, ControlSpec

SET, GET = 0x01, 0x81
MINIMUM, MAXIMUM, RESOLUTION, LENGTH, INFO, DEFAULT = 0x82, 0x83, 0x84, 0x85, 0x86, 0x87
CAN_GET_AND_SET, _DISABLED, _CHANGES_ITSELF = 0x03, 0x04, 0x08  # GET_INFO (4.1.2)

_ERROR_CODE = 0x02  # the control interface's selector for why a request was refused (4.2.1.2)
_WRONG_STATE, _OUT_OF_RANGE, _INVALID_CONTROL, _INVALID_REQUEST = 2, 4, 6, 7

TICKS_PER_S = 10_000  # exposure times are counted in 100 us
_GAIN_STEPS = 16  # of the register that make linear gain 1
_METERED_TO = 0.46  # of full scale, what automatic exposure aims at
_EXPOSURE = ("exposure", "gain", "ae_mode")


class Controls:
    """What is set, and what may be set to what; see `sim.devices.uvc.descriptors.CONTROLS`.

    Args:
        changed: called when what belongs to the exposure has been written

    Attributes:
        values: of all controls by name, as the wire has them
        clamp_s: shutter times above it are cut to it without a word
    """

    def __init__(self, changed: Callable[[], None]) -> None:
        self._changed = changed
        self._error = 0
        self.clamp_s = math.inf
        self.values: dict[str, int] = {}
        self.reset()

    def reset(self) -> None:
        """Set everything to its default, all automatics on."""
        self.values = {name: control.default for name, control in CONTROLS.items()}

    @property
    def is_metering(self) -> bool:
        """True while automatic exposure is on."""
        return self.values["ae_mode"] != MANUAL

    @property
    def exposure(self) -> tuple[float, float]:
        """The shutter time, s, and the linear gain that are set."""
        return self.values["exposure"] / TICKS_PER_S, 1 + self.values["gain"] / _GAIN_STEPS

    def answer(self, request: int, entity: int, selector: int, data: bytes) -> Answer:
        """Answer a class request to an entity; 0 is the interface itself."""
        if entity == 0 and selector == _ERROR_CODE and request == GET:
            return bytes([self._error])
        for name, control in CONTROLS.items():
            if (control.entity, control.selector) == (entity, selector):
                return self._answer(name, control, request, data)
        return self._refuse(_INVALID_CONTROL)

    def meter(self, level: float, time_s: float, longest_s: float) -> None:
        """Change the exposure by a frame's mean, 0 to 1, where that is automatic.

        `time_s` is what the frame had: nothing changes until the last change has arrived, or it
        would swing.
        """
        most = max(1, math.floor(min(longest_s, self.clamp_s) * TICKS_PER_S))
        now = min(self.values["exposure"], most)
        if not self.is_metering or round(time_s * TICKS_PER_S) != now:
            return
        wanted = round(now * min(2.0, _METERED_TO / max(level, 0.05)))
        self.values["exposure"] = min(max(1, wanted), most)
        self._changed()

    def _answer(self, name: str, control: ControlSpec, request: int, data: bytes) -> Answer:
        if request == INFO:
            return bytes([self._abilities(name)])
        if request == LENGTH:
            return control.size.to_bytes(2, "little")
        if request == SET:
            return self._set(name, control, data)
        answers = {
            GET: self.values[name],
            MINIMUM: control.minimum,
            MAXIMUM: control.maximum,
            RESOLUTION: control.step,
            DEFAULT: control.default,
        }
        if request not in answers:
            return self._refuse(_INVALID_REQUEST)
        return control.pack(answers[request])

    def _set(self, name: str, control: ControlSpec, data: bytes) -> Answer:
        if self._is_automatic(name):
            return self._refuse(_WRONG_STATE)
        value = int.from_bytes(data[: control.size], "little")
        if len(data) < control.size or not control.allows(value):
            return self._refuse(_OUT_OF_RANGE)
        if name == "exposure" and value > self.clamp_s * TICKS_PER_S:
            value = max(1, math.floor(self.clamp_s * TICKS_PER_S))
        self.values[name] = value
        if name in _EXPOSURE:
            self._changed()
        return b""

    def _is_automatic(self, name: str) -> bool:
        if name in ("exposure", "gain"):
            return self.is_metering
        return name == "wb_temperature" and self.values["wb_auto"] == 1

    def _abilities(self, name: str) -> int:
        changes = _CHANGES_ITSELF if name == "exposure" else 0
        return CAN_GET_AND_SET | changes | (_DISABLED if self._is_automatic(name) else 0)

    def _refuse(self, why: int) -> Answer:
        self._error = why
        return STALL
