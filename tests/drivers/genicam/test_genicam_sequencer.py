"""The upload of a cycle to a sequencer whose sets hold only the features that were chosen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import cast

import pytest

from camctl.drivers.genicam import sequencer
from camctl.drivers.genicam.controls import ExposureControl
from camctl.drivers.genicam.port import Kind, OpenDevice, Value
from camctl.interface.controls import ExposureSetting

KINDS = {
    "SequencerFeatureSelector": Kind.ENUMERATION,
    "SequencerFeatureEnable": Kind.BOOLEAN,
    "SequencerTriggerSource": Kind.ENUMERATION,
}


class ChoosingDevice:
    """Saves into a set what is enabled for it, as SFNC's SequencerFeatureEnable says.

    Attributes:
        saved: of each set, the values of the enabled features
    """

    def __init__(self) -> None:
        self.values: dict[str, Value] = {}
        self.enabled = {"Gain": False, "ExposureTime": False, "OffsetX": True}
        self.saved: list[dict[str, Value]] = []

    def kind(self, name: str) -> Kind | None:
        return KINDS.get(name)

    def entries(self, name: str) -> Sequence[str]:
        return list(self.enabled) if name == "SequencerFeatureSelector" else ["FrameStart"]

    def write(self, name: str, value: Value) -> None:
        self.values[name] = value
        if name == "SequencerFeatureEnable":
            self.enabled[str(self.values["SequencerFeatureSelector"])] = bool(value)

    def execute(self, name: str) -> None:
        assert name == "SequencerSetSave"
        kept = [feature for feature, is_on in self.enabled.items() if is_on]
        self.saved.append({feature: self.values[feature] for feature in kept})


class Exposure:
    """Writes the features of an exposure."""

    time_name, gain_name = "ExposureTime", "Gain"

    def __init__(self, device: ChoosingDevice) -> None:
        self._device = device

    def forget(self) -> None:
        """Nothing is remembered."""

    def write(self, setting: ExposureSetting) -> ExposureSetting:
        self._device.write("ExposureTime", setting.time_s * 1e6)
        self._device.write("Gain", setting.gain)
        return setting


def test_the_sets_hold_time_and_gain_and_nothing_else() -> None:
    device = ChoosingDevice()
    settings = [ExposureSetting(0.001, 2.0), ExposureSetting(0.004, 1.0)]
    exposure = cast(ExposureControl, Exposure(device))
    sequencer.upload(cast(OpenDevice, device), settings, exposure, "genicam:1")
    assert [each["ExposureTime"] for each in device.saved] == pytest.approx([1000.0, 4000.0])
    assert [each["Gain"] for each in device.saved] == [2.0, 1.0]
    assert all(each.keys() == {"ExposureTime", "Gain"} for each in device.saved)
