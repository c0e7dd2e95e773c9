"""An Olympus or OM System camera under control by a computer, as libgphoto2 describes it.

The maker's properties are read and set by the standard's operations once the control mode is set;
one operation presses the shutter button and releases it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from camctl.sim.devices.ptp.config import Identity
from camctl.sim.devices.ptp.properties import DeviceProperty, battery
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

_BY_CAMERA, _BY_HOST = 2, 1  # property D052
_PRESS, _RELEASE = 3, 6  # parameters of the capture
_SPECIAL = 0xFFFF_FFF0  # shutter numbers from here on: bulb, time, composite


class OlympusResponder(Responder):
    """A camera with shutter times as numerator << 16 | denominator and f-numbers in tenths."""

    identity: ClassVar[Identity] = Identity(0x07B4, 0x0130, "OLYMPUS", "E-M1MarkII (virtual)", 0)
    shutter_codes: ClassVar[tuple[int, ...]] = (Property.OLYMPUS_SHUTTER,)
    iso_code: ClassVar[int] = Property.OLYMPUS_ISO
    automatic_iso: ClassVar[int] = 0xFFF0
    aperture_code: ClassVar[int] = Property.OLYMPUS_APERTURE
    aperture_units: ClassVar[int] = 10
    program_code: ClassVar[int] = Property.OLYMPUS_PROGRAM
    manual: ClassVar[int] = 0x8100
    events: ClassVar[tuple[int, ...]] = (Event.OLYMPUS_OBJECT_ADDED,)
    added: ClassVar[int] = Event.OLYMPUS_OBJECT_ADDED
    is_completion_announced: ClassVar[bool] = False

    def make_properties(self) -> list[DeviceProperty]:
        config = self.config
        times = tuple(t.numerator << 16 | t.denominator for t in sorted(config.times, reverse=True))
        stops = tuple(number // 10 for number in config.f_numbers) or (28,)
        isos = config.isos or (200,)
        return [
            battery(),
            DeviceProperty(Property.OLYMPUS_SHUTTER, Type.UINT32, times[0], times),
            DeviceProperty(Property.OLYMPUS_APERTURE, Type.UINT16, min(stops), stops),
            DeviceProperty(Property.OLYMPUS_ISO, Type.UINT16, isos[0], isos),
            DeviceProperty(Property.OLYMPUS_PROGRAM, Type.UINT16, self.manual, is_writable=False),
            DeviceProperty(
                Property.OLYMPUS_CONTROL_MODE, Type.UINT16, _BY_CAMERA, (_BY_HOST, _BY_CAMERA)
            ),
        ]

    def make_operations(self) -> dict[int, Handler]:
        operations = super().make_operations()
        del operations[Operation.INITIATE_CAPTURE]
        return {**operations, Operation.OLYMPUS_CAPTURE: self._capture}

    def set_number(self, item: DeviceProperty, value: int) -> Response:
        if item.code != Property.OLYMPUS_CONTROL_MODE and not self._is_by_host:
            return Response.ACCESS_DENIED
        return super().set_number(item, value)

    @property
    def _is_by_host(self) -> bool:
        return self.properties[Property.OLYMPUS_CONTROL_MODE].value == _BY_HOST

    def time_of(self, code: int, value: int) -> float | None:
        if code != Property.OLYMPUS_SHUTTER or value >= _SPECIAL or not value & 0xFFFF:
            return None
        return (value >> 16) / (value & 0xFFFF)

    def _capture(self, parameters: Sequence[int], data: bytes) -> Reply | None:
        if not self._is_by_host:
            return Reply(Response.ACCESS_DENIED)
        action = parameters[0] if parameters else 0
        if action == _PRESS:
            return self.release()
        return Reply() if action == _RELEASE else Reply(Response.INVALID_PARAMETER)
