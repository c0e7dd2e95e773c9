"""Virtual cameras of several makes in the network, through libgphoto2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from network_bench import camera_on_tcp

import camctl
from camctl.controls import ExposureSetting

#: From one end of the dial to the other, which libgphoto2 does in steps on a Sony.
TIMES_S = (1 / 8000, 1 / 8, 1 / 1000)


@pytest.mark.parametrize("vendor", ["nikon", "canon", "sony"])
def test_frames_are_those_of_ptpip_bit_for_bit(
    vendor: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("VCAMERADIR", raising=False)
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))
    with camera_on_tcp(vendor=vendor, files="dng", repeat_noise=True) as (_, port):
        address = f"ptpip:127.0.0.1:{port}"
        port_of_gphoto2 = f"gphoto2:{address}:{port}"  # of the commands, and of the events
        with camctl.open_camera(port_of_gphoto2, format="raw") as camera:
            dial = camera.controls.time_s
            settings = [ExposureSetting(dial.nearest(time_s)) for time_s in TIMES_S]
            frames = list(camera.shoot(settings))
        with camctl.open_camera(address, format="raw") as camera:
            others = list(camera.shoot(settings))
    assert [frame.applied for frame in frames] == [other.applied for other in others]
    assert all(
        np.array_equal(frame.pixels, other.pixels)
        for frame, other in zip(frames, others, strict=True)
    )
