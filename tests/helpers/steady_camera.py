"""A simulated camera before even light, whose frames say which exposure they have."""

from __future__ import annotations

import numpy as np

from camctl.interface.camera import Frame
from camctl.interface.clock import Clock
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import Sensor, load_sensor

INTERVAL_S = 0.03125  # a binary fraction: virtual time adds up exactly
LIGHT = 100_000.0


def steady_sensor(delay: int = 2, jitter: int = 0) -> Sensor:
    """A noise-free 12-bit sensor: its pixels show each millisecond of exposure."""
    return load_sensor("ideal-12").model_copy(
        update={
            "delay_frames": delay,
            "delay_jitter_frames": jitter,
            "frame_interval_s": INTERVAL_S,
            "line_s": 2.0**-10,
            "time_minimum_s": 2.0**-10,
            "gain_maximum": 4.0,
            "gain_step": 1.0,
        }
    )


def open_steady(
    delay: int = 2,
    jitter: int = 0,
    *,
    clock: Clock | None = None,
    faults: Faults | None = None,
    seed: int = 0,
) -> SimulatedCamera:
    scene = Scene("flat", np.full((2, 3), LIGHT))
    return SimulatedCamera(
        scene, steady_sensor(delay, jitter), clock=clock, faults=faults, seed=seed
    )


def lines(*counts: int) -> list[ExposureSetting]:
    return [ExposureSetting(count * 2.0**-10) for count in counts]


def expected_dn(camera: SimulatedCamera, setting: ExposureSetting) -> int:
    electrons = LIGHT * camera.sensor.quantum_efficiency * setting.time_s
    return min(4095, int(electrons * setting.gain / camera.sensor.electrons_per_dn))


def check_exposure(camera: SimulatedCamera, frame: Frame) -> None:
    """Check by its pixels that a frame has the exposure `applied`; an old frame has another."""
    assert frame.applied == frame.requested
    assert abs(int(frame.pixels[0, 0]) - expected_dn(camera, frame.applied)) <= 1


def works(camera: SimulatedCamera) -> bool:
    frames = list(camera.shoot(lines(15, 25)))
    for frame in frames:
        check_exposure(camera, frame)
    return len(frames) == 2
