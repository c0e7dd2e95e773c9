"""Numbers that no sensor or scene has are refused, or give a frame: never another error."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from camctl.errors import CamctlError
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.sensors.sensor import load_sensor

EXTREMES = (0, -1, 5e-324, 1e-300, 1e-15, 1e-6, 1e6, 1e15, 1e300, 1e308, 10**400, 2**31, 2**63)


def built_in(kind: str, name: str) -> Any:
    return json.loads((resources.files("camctl.sim") / kind / f"{name}.json").read_text())


def places(data: Any) -> Iterator[tuple[Any, Any]]:
    """Yield (dict or list, key) of each number in JSON data."""
    items = data.items() if isinstance(data, dict) else enumerate(data)
    for key, value in list(items):
        if isinstance(value, dict | list):
            yield from places(value)
        elif isinstance(value, int | float):
            yield data, key


def take_frames(camera: SimulatedCamera) -> None:
    """Take a short and a long exposure."""
    time, gain = camera.controls.time_s, camera.controls.gain
    for setting in (
        ExposureSetting(time.minimum, gain.minimum),
        ExposureSetting(time.maximum, gain.maximum),
    ):
        frame = camera.preview(setting)
        assert frame.pixels.shape[:2] == camera.controls.shape


@pytest.mark.parametrize(
    "name",
    [
        *("phone", "consumer", "ideal-6"),
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("complete", "ccd", "security")),
    ],
)
def test_sensors_with_extreme_numbers(tmp_path: Path, name: str) -> None:
    data = built_in("sensors", name)
    path = tmp_path / "sensor.json"
    light = np.linspace(0, 1, 30, dtype=np.float32).reshape(5, 6)
    problems = []
    for place, key in places(data):
        before = place[key]
        for value in EXTREMES:
            place[key] = value
            path.write_text(json.dumps(data))
            try:
                with suppress(CamctlError):
                    sensor = load_sensor(path)
                    with SimulatedCamera(Scene("s", light, photons_per_unit=1e6), sensor) as camera:
                        take_frames(camera)
            except Exception as error:
                problems.append(f"{key} = {str(value)[:20]}: {error!r}"[:200])
        place[key] = before
    assert problems == []


@pytest.mark.parametrize("name", ["night-street", "moving-target", "pwm-lamp", "room"])
def test_scenes_with_extreme_numbers(tmp_path: Path, name: str) -> None:
    data = {"shape": [6, 8], **built_in("scenes", name)}
    path = tmp_path / "scene.json"
    sensor = load_sensor("complete")
    problems = []
    for place, key in places(data):
        before = place[key]
        for value in EXTREMES:
            place[key] = value
            path.write_text(json.dumps(data))
            shape = None if place is data["shape"] and value in (0, -1) else (6, 8)
            try:
                with (
                    suppress(CamctlError),
                    SimulatedCamera(load_scene(path, shape), sensor) as camera,
                ):
                    take_frames(camera)
            except Exception as error:
                problems.append(f"{key} = {str(value)[:20]}: {error!r}"[:200])
        place[key] = before
    assert problems == []
