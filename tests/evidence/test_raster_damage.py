"""Lines that were lost or shifted are found; things that move and wrong exposures are not that."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest

from camctl.evidence.light_ratio import NeighbourCheck
from camctl.evidence.patches import patch_places
from camctl.evidence.raster_damage import (
    damaged_lines,
    is_wrong_alone,
    light_limits,
    wrong_lines,
)
from camctl.interface.camera import Pixels
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.sim.damage import DAMAGES, damaged
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

SHORTEST_S = {"tile-floor": 0.01}  # of other scenes 3 ms


def settings(scene: str) -> list[ExposureSetting]:
    time_s = SHORTEST_S.get(scene, 0.003)
    return [ExposureSetting(time_s), ExposureSetting(4 * time_s)]


@lru_cache
def taken(scene: str, sensor: str) -> tuple[SimulatedCamera, list[Pixels]]:
    camera = SimulatedCamera(load_scene(scene, (240, 320)), load_sensor(sensor), seed=1)
    return camera, [frame.pixels for frame in camera.shoot(settings(scene))]


def found(scene: str, sensor: str, second: Pixels | None = None, ratio: float = 4.0) -> bool:
    """Return whether the two frames, or the first one and `second`, have wrong lines."""
    camera, frames = taken(scene, sensor)
    controls = camera.controls
    check = NeighbourCheck(controls.levels, controls.black, controls.layout)
    noise = controls.frame_noise(settings(scene))
    pair = (
        check.sample(frames[0], noise[0]),
        check.sample(frames[1] if second is None else second, noise[1]),
    )
    planes = controls.layout.planes(frames[0])
    rows, columns, _ = patch_places([each.shape for each in planes])
    one, other = (light_limits(each, check.scale) for each in pair)
    return wrong_lines((one, other), ratio, (rows.size, columns.size))


def test_a_broken_jpeg_file_prints_nothing() -> None:
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    lines = (
        "import numpy as np",
        "from camctl.sim.damage import damaged",
        "pixels = (np.indices((40, 60)).sum(axis=0) * 3).astype(np.uint8)",
        "for seed in range(4): damaged(pixels, 'jpeg', seed, 255)",
    )
    ran = subprocess.run([sys.executable, "-c", "\n".join(lines)], capture_output=True, check=True)
    assert (ran.stdout, ran.stderr) == (b"", b"")


@pytest.mark.parametrize("kind", sorted(set(DAMAGES) - {"corrupt"}))
@pytest.mark.parametrize(
    ("scene", "sensor"), [("tile-floor", "machine-vision"), ("cloth", "phone")]
)
def test_damaged_lines_are_found(kind: str, scene: str, sensor: str) -> None:
    if kind == "jpeg":
        pytest.importorskip("cv2", reason="OpenCV is blocked")
    camera, frames = taken(scene, sensor)
    white = camera.controls.white
    results = [found(scene, sensor, damaged(frames[1], kind, n, white)) for n in range(4)]
    assert sum(results) >= 3


@pytest.mark.parametrize("scene", ["tile-floor", "cloth", "moving-target", "ball", "night-street"])
@pytest.mark.parametrize("sensor", ["machine-vision", "complete"])
def test_frames_that_are_whole_have_no_wrong_lines(scene: str, sensor: str) -> None:
    assert not found(scene, sensor)


def test_a_wrong_exposure_is_wrong_everywhere() -> None:
    assert not found("tile-floor", "machine-vision", ratio=2.0)


def test_a_thing_that_covers_half_of_the_width_is_no_line() -> None:
    frame = taken("tile-floor", "machine-vision")[1][1].copy()
    frame[100:180, :160] = np.roll(frame, 20, axis=1)[100:180, :160] // 2
    assert not found("tile-floor", "machine-vision", frame)


def is_second_wrong(scene: str, sensor: str, changed: Callable[[list[Pixels]], None]) -> bool:
    """Return whether the second of three frames is wrong alone, after `changed` has them."""
    camera = SimulatedCamera(load_scene(scene, (240, 320)), load_sensor(sensor), seed=2)
    first = settings(scene)
    chosen = [*first, ExposureSetting(4 * first[1].time_s)]
    frames, controls = [frame.pixels for frame in camera.shoot(chosen)], camera.controls
    changed(frames)
    check = NeighbourCheck(controls.levels, controls.black, controls.layout)
    noise = controls.frame_noise(chosen)
    one, other, last = (
        light_limits(check.sample(*each), check.scale) for each in zip(frames, noise, strict=True)
    )
    return is_wrong_alone((one, other, last), (1.0, 4.0, 16.0))


@pytest.mark.parametrize("kind", sorted(set(DAMAGES) - {"corrupt", "jpeg"}))
@pytest.mark.parametrize("scene", ["tile-floor", "cloth"])
def test_damage_of_one_frame_is_in_it_alone(kind: str, scene: str) -> None:
    def damage(frames: list[Pixels]) -> None:
        frames[1] = damaged(frames[1], kind, 0, 255)

    assert is_second_wrong(scene, "standard", damage)


@pytest.mark.parametrize("scene", ["tile-floor", "cloth", "moving-target", "night-street"])
def test_what_is_at_rest_or_moves_on_is_in_no_frame_alone(scene: str) -> None:
    def moved(frames: list[Pixels]) -> None:
        frames[1:] = [np.roll(each, 4 * k, axis=(0, 1)) for k, each in enumerate(frames[1:], 1)]

    assert not is_second_wrong(scene, "standard", lambda frames: None)
    assert not is_second_wrong(scene, "standard", moved)


@lru_cache
def bracket(scene: str) -> tuple[SimulatedCamera, list[ExposureSetting], list[Pixels]]:
    """Return five frames, each of twice the exposure of the one before."""
    camera = SimulatedCamera(load_scene(scene, (240, 320)), load_sensor("standard"), seed=3)
    chosen = [ExposureSetting(SHORTEST_S.get(scene, 0.003) * 2**k) for k in range(5)]
    return camera, chosen, [frame.pixels for frame in camera.shoot(chosen)]


def lines_of(scene: str, changed: Callable[[int, Pixels], Pixels]) -> dict[int, tuple[int, int]]:
    """Return the damaged lines of the frames of `bracket`, after `changed` of each."""
    camera, chosen, frames = bracket(scene)
    controls = camera.controls
    check = NeighbourCheck(controls.levels, controls.black, controls.layout)
    limits = [
        light_limits(check.sample(changed(k, frame), noise), check.scale)
        for k, (frame, noise) in enumerate(zip(frames, controls.frame_noise(chosen), strict=True))
    ]
    planes = controls.layout.planes(frames[0])
    rows, columns, _ = patch_places([each.shape for each in planes])
    return damaged_lines(limits, [2.0**k for k in range(5)], (rows.size, columns.size))


@pytest.mark.parametrize("kind", ["truncate", "shift"])
@pytest.mark.parametrize("scene", ["tile-floor", "cloth"])
def test_two_frames_with_damaged_lines_do_not_hide_each_other(kind: str, scene: str) -> None:
    def changed(k: int, frame: Pixels) -> Pixels:
        return damaged(frame, kind, k, 255) if k in {1, 2} else frame

    assert set(lines_of(scene, changed)) == {1, 2}


def shifted(frame: Pixels, rows: int, columns: int) -> Pixels:
    """Return what a camera sees that was moved by so many pixels."""
    down, across = (
        np.clip(np.arange(length) + by, 0, length - 1)
        for length, by in zip(frame.shape, (rows, columns), strict=False)
    )
    found: Pixels = frame[down[:, np.newaxis], across]
    return found


def with_person(frame: Pixels, left: int) -> Pixels:
    """Return a frame with something in it, 70 pixels wide, from a third of the height on."""
    found = frame.copy()
    found[80:, left : left + 70] = np.roll(frame, 90, axis=1)[80:, left : left + 70] // 2
    return found


@pytest.mark.parametrize("scene", ["tile-floor", "cloth", "moving-target", "night-street"])
def test_what_moves_is_no_damage(scene: str) -> None:
    assert not lines_of(scene, lambda k, frame: frame)
    assert not lines_of(scene, lambda k, frame: with_person(frame, 120) if k == 2 else frame)
    assert not lines_of(scene, lambda k, frame: with_person(frame, 120) if k > 2 else frame)
    assert not lines_of(scene, lambda k, frame: with_person(frame, 50 * k))
    assert not lines_of(scene, lambda k, frame: shifted(frame, 6, 4) if k == 2 else frame)
