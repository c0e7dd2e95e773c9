"""A Fujifilm camera under control by a computer, as libgphoto2 describes it.

Standard properties, with the shutter time in microseconds; the shutter button is a property, which
the standard's capture operation executes: half pressed it focuses, then it takes the picture.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

from camctl.sim.devices.ptp.config import Identity
from camctl.sim.devices.ptp.properties import DeviceProperty
from camctl.sim.devices.ptp.protocol import (
    Event,
    Handler,
    Operation,
    Property,
    Reply,
    Response,
    Type,
)
from camctl.sim.devices.ptp.responder import Responder

_BY_CAMERA, _BY_HOST = 1, 2  # property D207
_HALF_PRESSED, _FULLY_PRESSED = 0x0200, 0x0304  # property D208
_FOCUSING, _FOCUSED = 1, 2  # property D209
_THIRDS = range(-39, 19)  # of a stop from 1 s
_LONGEST_US = 64_000_000  # of exact times; higher numbers are labels of minutes


class FujiResponder(Responder):
    """A camera that the host controls once property D207 says so."""

    identity: ClassVar[Identity] = Identity(0x04CB, 0x02E3, "FUJIFILM", "X-T3 (virtual)", 0x0E, 100)
    events: ClassVar[tuple[int, ...]] = (Event.FUJI_OBJECT_ADDED, Event.CAPTURE_COMPLETE)
    added: ClassVar[int] = Event.FUJI_OBJECT_ADDED
    is_completion_announced: ClassVar[bool] = False

    def make_properties(self) -> list[DeviceProperty]:
        items = [i for i in super().make_properties() if i.code != Property.EXPOSURE_TIME]
        times = tuple(math.floor(1e6 * 2 ** (third / 3)) for third in _THIRDS)
        is_writable = self.config.mode != "auto"
        shutter = DeviceProperty(
            Property.EXPOSURE_TIME, Type.UINT32, 15625, times, is_writable=is_writable
        )
        buttons = (_HALF_PRESSED, _FULLY_PRESSED, 4)
        return [
            *items,
            shutter,
            DeviceProperty(Property.FUJI_PRIORITY, Type.UINT16, _BY_CAMERA, (_BY_CAMERA, _BY_HOST)),
            DeviceProperty(Property.FUJI_BUTTON, Type.UINT16, buttons[2], buttons),
            DeviceProperty(Property.FUJI_FOCUS_STATE, Type.UINT16, _FOCUSED, is_writable=False),
        ]

    def make_operations(self) -> dict[int, Handler]:
        return {**super().make_operations(), Operation.INITIATE_CAPTURE: self._execute_button}

    def set_number(self, item: DeviceProperty, value: int) -> Response:
        priority = self.properties[Property.FUJI_PRIORITY]
        if item is not priority and priority.value != _BY_HOST:
            return Response.ACCESS_DENIED
        return super().set_number(item, value)

    def time_of(self, code: int, value: int) -> float | None:
        """Return the time of a number of microseconds: the third of a stop that it stands for."""
        if code != Property.EXPOSURE_TIME or not 0 < value <= _LONGEST_US:
            return None
        third = round(3 * math.log2(value / 1e6))
        return float(2 ** (third / 3))

    def _execute_button(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        state = self.properties[Property.FUJI_FOCUS_STATE]
        button = self.properties.number(Property.FUJI_BUTTON)
        if button == _HALF_PRESSED:
            state.value = _FOCUSING
            self.body.call_later(0.3, self._focus_found)  # s
            return Reply()
        if button != _FULLY_PRESSED or state.value == _FOCUSING:
            return Reply(Response.DEVICE_BUSY)
        return self.release()

    def _focus_found(self) -> None:
        self.properties[Property.FUJI_FOCUS_STATE].value = _FOCUSED
