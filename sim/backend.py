"""The road to the simulated camera, for the entry point `camctl.cameras`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from camctl.camera import CameraInfo
from camctl.clock import Clock, RealClock, VirtualClock
from camctl.errors import CameraNotFoundError, UsageError, unknown_name
from sim.camera import SimulatedCamera
from sim.effects.budget import check_tolerance
from sim.scenes.scene import DEFAULT_SCENE, load_scene
from sim.sensors.sensor import DEFAULT_SENSOR, load_sensor

_CLOCKS: Mapping[str, type[VirtualClock] | type[RealClock]] = {
    "virtual": VirtualClock,
    "real": RealClock,
}
_OPTIONS = ("scene", "seed", "sensor", "size", "time", "tolerance")


class SimulatedBackend:
    """Opens ``sim``.

    Options: scene, sensor, seed, size (WIDTHxHEIGHT), time (virtual or real), tolerance (DN).
    """

    about = "a simulated sensor before a scene: nothing to connect"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the one simulated camera: it is always there."""
        return (CameraInfo("sim", "camctl", f"simulated {DEFAULT_SENSOR}", DEFAULT_SENSOR, "sim"),)

    def open(self, address: str, options: Mapping[str, str]) -> SimulatedCamera:
        """Return a simulated camera.

        Raises:
            CameraNotFoundError: there is something behind the colon
            UsageError: an unknown option, scene, sensor or clock, or a bad seed or size
            DataError: a scene or sensor file that cannot be used
        """
        if address:
            raise CameraNotFoundError(f"no camera sim:{address}", hint="its id is sim")
        for option in options:
            if option not in _OPTIONS:
                raise unknown_name("option of the simulated camera", option, _OPTIONS)
        sensor = load_sensor(options.get("sensor", DEFAULT_SENSOR))
        name = options.get("scene", DEFAULT_SCENE)
        shape = parse_size(options["size"]) if "size" in options else None
        scene = load_scene(name, shape, usual=sensor.shape)
        return SimulatedCamera(
            scene,
            sensor,
            clock=_clock(options.get("time", "virtual")),
            seed=_seed(options),
            tolerance_dn=_tolerance(options.get("tolerance", "0")),
        )


def parse_size(text: str) -> tuple[int, int]:
    """Return (rows, columns) of "WIDTHxHEIGHT".

    Raises:
        UsageError: it is not two whole numbers above 0 with an x between
    """
    match = re.fullmatch(r"\s*([1-9]\d{0,8})\s*[xX×]\s*([1-9]\d{0,8})\s*", text)
    if match is None:
        raise UsageError(f"a size of '{text}'", hint="write WIDTHxHEIGHT, such as 640x480")
    return int(match[2]), int(match[1])


def _clock(name: str) -> Clock:
    if name not in _CLOCKS:
        raise unknown_name("kind of time", name, _CLOCKS)
    return _CLOCKS[name]()


def _seed(options: Mapping[str, str]) -> int:
    text = options.get("seed", "0")
    if not re.fullmatch(r"\d{1,19}", text.strip()):
        raise UsageError(f"a seed of '{text}'", hint="seeds are whole numbers, 0 or more")
    return int(text)


def _tolerance(text: str) -> float:
    try:
        return check_tolerance(float(text))
    except ValueError:
        raise UsageError(f"a tolerance of '{text}'", hint="give 0 DN or more") from None
