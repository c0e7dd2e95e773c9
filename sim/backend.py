"""The backend of the simulated camera, for the entry point `camctl.cameras`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, InstanceOf

from camctl.errors import CameraNotFoundError
from camctl.interface.backends import BackendOptions, FrameShape
from camctl.interface.camera import CameraInfo
from camctl.interface.clock import Clock, RealClock, VirtualClock
from camctl.sim.camera import SimulatedCamera
from camctl.sim.faults import Faults, fault_fields
from camctl.sim.recorded_stream import load_stream
from camctl.sim.scenes.scene import DEFAULT_SCENE, Scene, check_shape, load_scene, scene_of
from camctl.sim.sensors.sensor import DEFAULT_SENSOR, load_sensor


def _scene_value(value: object) -> object:
    """Return names and scenes as they are, a path as a name, an array as a scene."""
    if isinstance(value, str | Scene):
        return value
    return str(value) if isinstance(value, Path) else scene_of(value)  # type: ignore[arg-type]


class SimulatedOptions(BackendOptions):
    """Options of the simulated camera.

    Attributes:
        scene: a built-in scene, a scene file, a radiance map, or from Python relative irradiance as
            an array, (rows, columns[, 3]), or a `Scene`
        sensor: a built-in sensor or a sensor file
        seed: of all noise
        size: of a frame; None: the scene's own, or else the sensor's
        time: whether the camera waits in real time, or on a clock of its own and thus not at all
        tolerance: see `tolerance_dn` of `SimulatedCamera`, DN
        unknown: the camera states neither response, noise, sensitivity nor control delay, like a
            webcam; a calibration measures them
        stated: the camera states the exposure of each frame, as cameras of libcamera and of GenICam
            do in metadata and chunks
        stream: a recorded one (`camctl.sim.recorded_stream`), as in which frames are lost and late
        faults: of the hardware, for tests: `Faults`, a dict of its fields, or a text such as
            unplug@3,wrong@1=0.5
    """

    scene: Annotated[str | InstanceOf[Scene], BeforeValidator(_scene_value)] = DEFAULT_SCENE
    sensor: str = DEFAULT_SENSOR
    seed: int = Field(default=0, ge=0, lt=2**64)
    size: FrameShape | None = None
    time: Literal["virtual", "real"] = "virtual"
    tolerance: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    unknown: bool = False
    stated: bool = False
    stream: str | None = None
    faults: Annotated[Faults, BeforeValidator(fault_fields)] = Faults()


class SimulatedBackend:
    """Opens ``sim``; see `SimulatedOptions`."""

    about = "a simulated sensor in front of a scene: nothing to connect"
    local_address = ""

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return the one simulated camera, which always exists."""
        return (CameraInfo("sim", "camctl", f"simulated {DEFAULT_SENSOR}", DEFAULT_SENSOR, "sim"),)

    def open(self, address: str, options: Mapping[str, Any]) -> SimulatedCamera:
        if address:
            raise CameraNotFoundError(f"no camera sim:{address} exists", hint="its id is sim")
        chosen = SimulatedOptions.parse(options)
        sensor = load_sensor(chosen.sensor)
        scene = chosen.scene
        if isinstance(scene, str):
            scene = load_scene(scene, chosen.size, usual=sensor.shape)
        else:
            check_shape(scene.name, scene.shape, chosen.size)
        clock: Clock = RealClock() if chosen.time == "real" else VirtualClock()
        return SimulatedCamera(
            scene,
            sensor,
            clock=clock,
            seed=chosen.seed,
            faults=chosen.faults,
            tolerance_dn=chosen.tolerance,
            is_unknown=chosen.unknown,
            states=chosen.stated,
            stream=None if chosen.stream is None else load_stream(chosen.stream),
        )
