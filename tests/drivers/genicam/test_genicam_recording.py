"""What `camctl cameras --record` keeps of a GenICam camera, and its replay."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from gige_bench import installed, virtual_camera

from camctl import errors
from camctl.drivers.genicam import GenicamCamera
from camctl.drivers.genicam.port import (
    FeatureError,
    FoundDevice,
    Kind,
    Limits,
    PacketCounts,
    Received,
    Value,
)
from camctl.drivers.genicam.recording import described, record


class ReplayedDevice:
    """A device that gives the recorded answer to each call: the next one, else the last before."""

    name = "replay"

    def __init__(self, recorded: Mapping[str, Any]) -> None:
        self._recorded = recorded
        self._calls: Sequence[Mapping[str, Any]] = recorded["calls"]
        self._place = -1

    def search(self) -> Sequence[FoundDevice]:
        return ()

    def open(self, device: FoundDevice) -> ReplayedDevice:
        return self

    def _answer(self, call: str, *arguments: Any) -> Any:
        later = range(self._place + 1, len(self._calls))
        for place in (*later, *range(self._place, -1, -1)):
            entry = self._calls[place]
            if entry["call"] == call and entry.get("arguments", []) == list(arguments):
                self._place = place
                if "error" in entry:
                    kind = getattr(errors, entry["error"], FeatureError)
                    raise kind("refused", hint="as recorded")
                return entry["answer"]
        raise AssertionError(f"the recording has no {call} {arguments}")

    def kind(self, name: str) -> Kind | None:
        found = self._answer("kind", name)
        return None if found is None else Kind(found)

    def read(self, name: str) -> Value:
        found: Value = self._answer("read", name)
        return found

    def write(self, name: str, value: Value) -> None:
        self._answer("write", name, value)

    def execute(self, name: str) -> None:
        self._answer("execute", name)

    def limits(self, name: str) -> Limits:
        return Limits(**self._answer("limits", name))

    def entries(self, name: str) -> Sequence[str]:
        found: Sequence[str] = self._answer("entries", name)
        return found

    def unit(self, name: str) -> str:
        return str(self._answer("unit", name))

    def description(self) -> str:
        return str(self._recorded["description"])

    def start(self, buffers: int) -> None: ...

    def stop(self) -> None: ...

    def close(self) -> None: ...

    def receive(self, timeout_s: float) -> Received | None:
        if not timeout_s:
            return None
        found = dict(self._answer("receive"))
        data = np.zeros(found.pop("bytes"), np.uint8)
        return Received(data=data, arrived_s=0.0, **{**found, "shape": tuple(found["shape"])})

    def packets(self) -> PacketCounts:
        return PacketCounts(0, 0)


@pytest.mark.parametrize("library", ["aravis", "viva"])
def test_a_recorded_camera_opens_as_it_did(library: str) -> None:
    with virtual_camera(serial="PRIVATE123") as device:
        kept = record(installed(library), device.config.ip)
    text = json.dumps(kept)
    assert "PRIVATE123" not in text
    assert kept["description"].startswith("<?xml")
    assert kept["found"]["mode"] == "mono12p-64x48-software"
    again = json.loads(text)
    replay = ReplayedDevice(again)
    found = FoundDevice("again", "camctl", "virtual GigE camera", "", "", "GigE Vision")
    with GenicamCamera(replay, found) as camera:
        assert described(camera) == {**again["found"], "model": "virtual GigE camera"}


def test_a_camera_that_cannot_be_opened_is_recorded_with_the_reason() -> None:
    with virtual_camera(refused=["ExposureTime"]) as device:
        kept = record(installed("aravis"), device.config.ip)
    assert kept["found"] == {"error": "FeatureError"}
    assert any("error" in call for call in kept["calls"])
