"""The streaming driver of docs/how-to/drivers.md works, on a small fake of the maker's library."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from camctl.calibration.delay import measure_delay
from camctl.interface.camera import Camera, PreviewingCamera, StreamingCamera
from camctl.interface.clock import Clock, VirtualClock
from camctl.profiles.profile import change_profile
from camctl.testing.conformance import CameraConformance

PAGE = Path(__file__).parents[2] / "docs/how-to/drivers.md"
DELAY = 3


class FakeDevice:
    """25 frames a second in virtual time; exposures take effect `DELAY` frames late."""

    serial = "1"
    interval_s = 0.04

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._slot = 0
        self._pending = {0: 0.01}  # exposure by the first slot that has it

    def wait_for_frame(self) -> float:
        self._slot = max(self._slot, int(self._clock.now() / self.interval_s)) + 1
        self._clock.sleep_until(self._slot * self.interval_s)
        return self._slot * self.interval_s

    def pixels(self) -> Any:
        exposure_s = self._pending[max(slot for slot in self._pending if slot < self._slot)]
        return np.tile(np.linspace(0, 6000, 64) * exposure_s, (48, 1)).clip(0, 255).astype(np.uint8)

    def set_exposure(self, time_s: float) -> float:
        running = int(self._clock.now() / self.interval_s + 1e-6)
        self._pending[running + 1 + DELAY] = time_s
        return time_s

    def close(self) -> None:
        pass


@pytest.fixture(autouse=True)
def profiles(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def open_example() -> Any:
    (code,) = [
        block
        for block in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
        if "my_sdk" in block
    ]
    library: Any = ModuleType("my_sdk")
    library.Device = FakeDevice
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "my_sdk", library)
        exec(compile(code, str(PAGE), "exec"), names)
    return names["MyCamera"]("my camera", VirtualClock(1.0)).open()


class TestConforms(CameraConformance):
    """Before the delay was measured: the stream settles."""

    def open_camera(self) -> Camera:
        camera: Camera = open_example()
        return camera

    def middle_s(self, camera: Camera) -> float:
        return 0.02


class TestConformsWithMeasuredDelay(TestConforms):
    def open_camera(self) -> Camera:
        with open_example() as camera:
            record = measure_delay(camera)
            change_profile(
                camera.info, lambda profile: profile.delays.update({camera.mode: record})
            )
        return super().open_camera()


def test_delay_is_measured_stored_and_used() -> None:
    with open_example() as camera:
        assert isinstance(camera, PreviewingCamera)
        assert isinstance(camera, StreamingCamera)
        assert camera.controls.delay_frames is None
        assert camera.controls.findings[0].code == "delay_unknown"
        record = measure_delay(camera)
    assert record.frames == DELAY
    change_profile(camera.info, lambda profile: profile.delays.update({camera.mode: record}))
    with open_example() as camera:
        assert camera.controls.delay_frames == DELAY
        assert camera.controls.notes == ()
