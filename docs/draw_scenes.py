"""Draw the pictures of the built-in scenes: ``python docs/draw_scenes.py``.

Each is one frame of the sensor `complete` at 1024 x 768 with every effect, reduced in size and
converted to sRGB; the stars are by `ccd`, the sun and the switched lamps by `security`.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import load_sensor

TIMES_S = {
    "ball": 0.02,
    "cloth": 0.013,
    "colour-chart": 0.065,
    "grey-steps": 0.005,
    "moving-target": 0.03,
    "night-street": 2.0,
    "outdoor-sun": 0.0006,
    "pwm-lamp": 0.002,
    "ramp": 0.016,
    "room": 10.0,
    "slanted-edge": 0.04,
    "stars": 240.0,
    "tile-floor": 0.1,
    "uniform": 0.01,
}
STARTS_S = {"moving-target": 0.7}
SENSORS = {"outdoor-sun": "security", "pwm-lamp": "security", "stars": "ccd"}


def main() -> None:
    """Write docs/pictures/scenes/*.png."""
    folder = Path(__file__).parent / "pictures/scenes"
    folder.mkdir(exist_ok=True)
    for name, time_s in TIMES_S.items():
        sensor = load_sensor(SENSORS.get(name, "complete"))
        if (
            sensor.layout is not None and sensor.layout.is_mosaic
        ):  # three colours a pixel instead of a mosaic
            sensor = sensor.model_copy(update={"layout": None})
        renderer = Renderer(View.of(load_scene(name, (768, 1024)), sensor), sensor)
        shot = renderer.shot(time_s, 1.0, 0, start_s=STARTS_S.get(name, 0.0))
        pixels = renderer.expose(shot, renderer.plan(shot))
        light = (pixels.astype(np.float32) - sensor.black) / (sensor.white - sensor.black)
        small = np.clip(cv2.resize(light, (240, 180), interpolation=cv2.INTER_AREA), 0, 1)
        shown = np.where(small < 0.0031308, 12.92 * small, 1.055 * small ** (1 / 2.4) - 0.055)
        picture = np.round(shown * 255).astype(np.uint8)
        if picture.ndim == 3:
            picture = picture[..., ::-1]
        cv2.imwrite(str(folder / f"{name}.png"), picture, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main()
