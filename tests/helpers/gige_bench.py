"""Virtual GigE Vision cameras on addresses of their own, and this project's driver for them."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from camctl.drivers.genicam import GenicamCamera, GenicamOptions
from camctl.drivers.genicam.aravis_calls import load
from camctl.drivers.genicam.libraries import library
from camctl.drivers.genicam.port import FoundDevice, Library
from camctl.interface.controls import ExposureSetting
from camctl.sim.devices.gige.camera import GigeCamera, make

#: A ramp of light that half of the frames reach, and noise that is the same in every frame.
SCENE = {"scene": "ramp", "size": "64x48", "seed": 5, "sensor": "machine-vision"}
#: Black and white level of that sensor, DN; its pixels are full before the converter is.
BLACK, WHITE = 60, 4018
LEVELS = {"black": str(BLACK), "white": str(WHITE)}

_numbers = itertools.count(1)


def new_address() -> str:
    """Return an address of this machine that no other test uses at the same time."""
    worker = int(os.environ.get("PYTEST_XDIST_WORKER", "gw0").removeprefix("gw"))
    number = next(_numbers)
    return f"127.{20 + worker}.{number // 250}.{number % 250 + 1}"


@contextmanager
def virtual_camera(**config: Any) -> Iterator[GigeCamera]:
    """Run a virtual camera at `config.ip`, until the end of the block."""
    camera = make({**SCENE, "ip": new_address(), **config})
    camera.attach()
    try:
        yield camera
    finally:
        camera.detach()


def installed(name: str) -> Library:
    """Return a library, or skip the test."""
    if name == "aravis" and load() is None:
        pytest.skip("Aravis is not installed: apt-get install libaravis-0.8-0")
    if name == "viva":
        pytest.importorskip("viva_genicam", reason="viva-genicam is not installed")
    return library(name)


def found(device: GigeCamera) -> FoundDevice:
    """Return a virtual camera as a search finds it; searching would take a second."""
    ip = device.config.ip
    return FoundDevice(ip, "camctl", "virtual GigE camera", device.config.serial, ip, "GigE Vision")


@contextmanager
def opened(
    device: GigeCamera, using: Library, *, silence_s: float = 60.0, **options: str
) -> Iterator[GenicamCamera]:
    """Open the driver's camera for a virtual one.

    Frames come in real time, later on a busy computer: only a test of silence has a short limit.
    """
    chosen = GenicamOptions.parse({**(LEVELS if "format" not in options else {}), **options})
    with GenicamCamera(using, found(device), chosen, silence_s=silence_s) as camera:
        yield camera


def settings(camera: GenicamCamera, *times_s: float, gain: float = 1.0) -> list[ExposureSetting]:
    """Return settings of a camera near these times."""
    controls = camera.controls
    return [
        ExposureSetting(controls.time_s.nearest(each), controls.gain.nearest(gain))
        for each in times_s
    ]


def exposed(device: GigeCamera, frame_id: int) -> float:
    """Return the exposure time, s, that the virtual camera gave to a frame."""
    log = device.do("log")["frames"]
    return next(float(each["time_s"]) for each in reversed(log) if each["block"] == frame_id)
