"""Movement that is found, and samples that are marked although nothing moved.

    python tests/bench/bench_movement.py [WIDTHxHEIGHT]

In one of three frames squares of other brightness are put into a scene at rest, so that
the truth is known.  A sample is changed where its brightness in that frame differs by two standard
deviations of its noise.  Marks of samples at rest are counted apart within 2 pixels of a square,
where a mean of 5 x 5 samples reaches over its edge, and elsewhere, where they are false alarms.
The memorial map is read from $CAMCTL_DATA/memorial where that is set.
"""

from __future__ import annotations

import math
import os
import sys
import time
from collections.abc import Generator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray

import camctl
from camctl.interface.camera import Frame, FrameStream
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.sensors.sensor import load_sensor

RATIOS = (1.0, 8.9, 88.0)
BRACKET = camctl.CaptureRequest("log", 1000.0, ratios=RATIOS)
SIDES, CONTRASTS = (6, 10, 16, 24), (1.2, 1.8, 0.6)
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
SCENES = ("room", "tile-floor", "cloth", "memorial")


@dataclass(frozen=True)
class Found:
    """What one capture shows: samples changed, of those marked, beside squares, and at rest."""

    changed: int
    marked: int
    edge: int
    edge_marked: int
    rest: int
    false: int
    places: int

    def __add__(self, other: Found) -> Found:
        return Found(*(getattr(self, name) + getattr(other, name) for name in vars(self)))

    def __str__(self) -> str:
        share, false = self.marked / max(self.changed, 1), self.false / max(self.rest, 1)
        edge = self.edge_marked / max(self.edge, 1)
        both = (self.false + self.edge_marked) / max(self.rest + self.edge, 1)
        return f"{share:7.2f} {both:9.5f} {edge:9.5f} {false:9.5f} {self.places:7}"


NOTHING = Found(0, 0, 0, 0, 0, 0, 0)


class MovingCamera:
    """A camera that takes one of the frames of another scene; its noise may be unknown."""

    def __init__(
        self, cameras: tuple[SimulatedCamera, SimulatedCamera], moved: int, *, known: bool
    ) -> None:
        self._cameras, self._moved, self._known = cameras, moved, known
        self._moving: ExposureSetting | None = None
        self.info, self.clock = cameras[0].info, cameras[0].clock

    @property
    def controls(self) -> ExposureControls:
        """Those of the camera, without its noise where it is unknown."""
        controls = self._cameras[0].controls
        return controls if self._known else replace(controls, noise=None)

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Shoot both scenes."""
        return self._frames(settings)

    def _frames(self, settings: Sequence[ExposureSetting]) -> Generator[Frame]:
        both = [list(camera.shoot(settings)) for camera in self._cameras]
        if len(settings) == len(RATIOS):
            self._moving = settings[self._moved]
        for setting, frame, other in zip(settings, *both, strict=True):
            # It is still so where the frame is shot again.
            yield replace(frame, pixels=other.pixels) if setting == self._moving else frame

    def close(self) -> None:
        """Leave the cameras open."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def squares(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return by what the light of each pixel is multiplied: squares all over the picture."""
    found = np.ones(shape, np.float32)
    pitch = max(SIDES) * 2
    for row in range(shape[0] // pitch):
        for column in range(shape[1] // pitch):
            number = row * 7 + column
            if number % 4 == 3:
                continue
            side = SIDES[number // 2 % len(SIDES)]
            top, left = row * pitch + pitch // 4, column * pitch + pitch // 4
            found[top : top + side, left : left + side] = CONTRASTS[number % 3]
    return found


def visible(sensor: Any, setting: Any, lights: Sequence[NDArray[Any]]) -> NDArray[np.bool_]:
    """Return which samples differ by two standard deviations in a frame of two lights."""
    full = sensor.full_well_e / setting.gain
    electrons = [np.minimum(light * setting.time_s, full) for light in lights]
    noise = np.sqrt(np.minimum(*electrons) + sensor.read_noise_e**2)
    noise = np.hypot(noise, sensor.electrons_per_dn / setting.gain / math.sqrt(12))
    return np.asarray(np.abs(electrons[0] - electrons[1]) > 2 * noise)


def squares_in(
    sensor_name: str, scene: Scene, *, known: bool, changes: NDArray[np.float32]
) -> Found:
    """Return what is found of changes of the light in each of three frames of one scene."""
    sensor = load_sensor(sensor_name)
    light = scene.irradiance if scene.irradiance.ndim == 2 else scene.irradiance @ LUMINANCE
    scene = replace(scene, picture=light)
    moving = replace(scene, picture=light * changes)
    total = NOTHING
    still = changes == 1
    rest = cv2.erode(still.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    for moved in range(len(RATIOS)):
        with (
            SimulatedCamera(scene, sensor, seed=moved) as calm,
            SimulatedCamera(moving, sensor, seed=100 + moved) as other,
        ):
            plan = camctl.plan_capture(calm, BRACKET)
            setting = plan.settings[moved]
            # Electrons a second for the light: from what the frame of the longest exposure shows.
            rate = electrons_per_light(calm, sensor, plan.settings[0], light)
            camera = MovingCamera((calm, other), moved, known=known)
            report = camctl.capture(camera, BRACKET, plan=plan)
        marks = (report.mask() & 4) != 0
        seen = visible(sensor, setting, [light * rate, light * changes * rate])
        total += Found(
            int(seen.sum()),
            int((marks & seen).sum()),
            int((still & ~rest).sum()),
            int((marks & still & ~rest).sum()),
            int(rest.sum()),
            int((marks & rest).sum()),
            len(report.movement.places) if report.movement else 0,
        )
    return total


def electrons_per_light(
    camera: SimulatedCamera, sensor: Any, setting: Any, light: NDArray[np.float32]
) -> float:
    """Return the electrons a second for a light of 1, from a frame that is not saturated."""
    (frame,) = camera.shoot([setting])
    pixels = frame.pixels.astype(np.float64) - frame.black
    inside = frame.pixels < frame.white
    levels = float(pixels[inside].sum()) / float(light[inside].sum(dtype=np.float64))
    electrons = levels * float(sensor.electrons_per_dn)
    return electrons / float(setting.time_s * setting.gain)


def print_squares(size: str) -> None:
    """Print a table: share marked of the changed, of the others, and of those by their place."""
    columns, rows = map(int, size.split("x"))
    print(
        f"{'sensor':15} {'noise':8} {'scene':10} {'marked':>7} {'unmoved':>9} "
        f"{'beside':>9} {'far':>9} {'places':>7} time"
    )
    for known in (True, False):
        for sensor in ("standard", "machine-vision"):
            total, began = NOTHING, time.perf_counter()
            word = "known" if known else "unknown"
            for name in SCENES:
                if name == "memorial" and "CAMCTL_DATA" not in os.environ:
                    continue
                path = Path(os.environ.get("CAMCTL_DATA", ""), "memorial", "memorial.hdr")
                scene = (
                    load_scene(path) if name == "memorial" else load_scene(name, (rows, columns))
                )
                found = squares_in(sensor, scene, known=known, changes=squares(scene.shape))
                total += found
                print(f"{sensor:15} {word:8} {name:10} {found}", flush=True)
            took_s = time.perf_counter() - began
            print(f"{sensor:15} {word:8} {'all':10} {total} {took_s:.1f} s", flush=True)
    scene = load_scene("tile-floor", (rows, columns))
    for known in (True, False):
        found = squares_in("standard", scene, known=known, changes=one_thing(scene.shape))
        print(f"one thing of 60 pixels, noise {'known' if known else 'unknown'}: {found}")


def one_thing(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return factors of the light with one thing of 60 pixels, 1.8 times as bright."""
    found = np.ones(shape, np.float32)
    found[100:106, 150:160] = 1.8
    return found


if __name__ == "__main__":
    print_squares(sys.argv[1] if len(sys.argv) > 1 else "320x240")
