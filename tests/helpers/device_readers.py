"""Readers of what devices send: datasets and containers of PTP, Sierra packets, V4L2, files."""

from __future__ import annotations

import ctypes
import random
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coolpix_bench import coolpix_on, virtual_coolpix
from input_readers import Reader
from mutations import mutated
from ptp_bench import bench, settings_at
from v4l2_model import PATH, Model

from camctl.drivers.common.serial_link import SerialLink
from camctl.drivers.ptp.datasets import (
    DeviceInfo,
    ObjectInfo,
    PropertyDescription,
    StorageInfo,
)
from camctl.drivers.ptp.maker_datasets import (
    EosEvents,
    parse_nikon_events,
    parse_panasonic_property,
    parse_panasonic_value,
    parse_sony_properties,
)
from camctl.drivers.v4l2.abi import Request
from camctl.drivers.v4l2.camera import V4l2Camera
from camctl.interface.controls import Layout
from camctl.sim.devices.still_files import RawImage, encode
from camctl.stills.decoding import read_still
from camctl.stills.exif import stated_exposure

VENDORS = ("none", "nikon", "canon", "sony")

PARSERS: dict[str, tuple[int, Callable[[bytes], object]]] = {
    "PTP device": (0x1001, DeviceInfo.parse),
    "PTP storage": (0x1005, StorageInfo.parse),
    "PTP object": (0x1008, ObjectInfo.parse),
    "PTP property": (0x1014, PropertyDescription.parse),
    "PTP Canon events": (0x9116, EosEvents.parse),
    "PTP Sony properties": (0x9209, parse_sony_properties),
    "PTP Nikon events": (0x90C7, parse_nikon_events),
    "PTP Panasonic property": (0x9108, partial(parse_panasonic_property, code=0x02000030)),
    "PTP Panasonic value": (0x9402, parse_panasonic_value),
}
"""Operation codes, and what parses the data of their replies."""


@cache
def _ptp_replies() -> dict[int, list[bytes]]:
    """Return the data that cameras of all vendors send, by operation code."""
    found: dict[int, list[bytes]] = {}
    for vendor in (*VENDORS, "panasonic"):
        pair = bench(vendor=vendor)
        execute = pair.device.responder.execute

        def record(code: int, *arguments: Any, execute: Any = execute) -> Any:
            reply = execute(code, *arguments)
            if reply is not None and reply.data:
                found.setdefault(code, []).append(reply.data)
            return reply

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pair.device.responder, "execute", record)
            with pair.camera() as camera:
                list(camera.shoot(settings_at(camera, 1 / 125, 1 / 60)))
    return found


def _dataset_reader(code: int, parse: Callable[[bytes], object]) -> Reader:
    return Reader(lambda: _ptp_replies()[code], lambda data, _folder: parse(data))


@cache
def still_files() -> dict[str, bytes]:
    rng = np.random.default_rng(1)
    mosaic = RawImage(rng.integers(60, 4000, (24, 32), np.uint16), Layout.RGGB, 12, 64, 4000, 0.5)
    picture = RawImage(rng.integers(0, 256, (24, 32, 3), np.uint8), Layout.RGB, 8, 0, 255, 0.5)
    return {
        "a.jpg": encode("jpeg", picture),
        "a.tif": encode("tiff", picture),
        "a.dng": encode("dng", mosaic),
    }


def _still_reader(name: str) -> Reader:
    def read(data: bytes, _folder: Path) -> object:
        return stated_exposure(data), read_still(data, name)

    return Reader(lambda: [still_files()[name]], read)


DEVICES = {
    **{name: _dataset_reader(*parser) for name, parser in PARSERS.items()},
    **{f"still file {name}": _still_reader(name) for name in ("a.jpg", "a.tif", "a.dng")},
}


# ---- whole sessions, in which replies are damaged


def ptp_session(rng: random.Random, rate: float) -> None:
    """Open a camera and shoot; transfers from it are damaged at this rate."""
    pair = bench(vendor=rng.choice(VENDORS))
    bulk_read = pair.backend.bulk_read

    def damaged(handle: Any, endpoint: int, interface: int, buffer: Any, timeout: int) -> int:
        size = bulk_read(handle, endpoint, interface, buffer, timeout)
        if rng.random() > rate:
            return size
        view = memoryview(buffer).cast("B")
        data = mutated(bytes(view[:size]), rng)[: len(view)]
        view[: len(data)] = data
        return len(data)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pair.backend, "bulk_read", damaged)
        with pair.camera() as camera:
            list(camera.shoot(settings_at(camera, 1 / 125, 1 / 60)))


def sierra_session(rng: random.Random, rate: float) -> None:
    """Open a camera and shoot; what is read from the line is damaged at this rate."""
    read = SerialLink.read

    def damaged(link: SerialLink, size: int, silence_s: float) -> bytes:
        data = read(link, size, silence_s)
        return mutated(data, rng)[:size] if data and rng.random() < rate else data

    with virtual_coolpix() as device, pytest.MonkeyPatch.context() as patch:
        patch.setattr(SerialLink, "read", damaged)
        with coolpix_on(device) as camera:
            list(camera.shoot(settings_at(camera, 1 / 125)))


class DamagedReplies(Model):
    """A camera of which some replies are damaged."""

    def __init__(self, rng: random.Random, rate: float) -> None:
        super().__init__()
        self._rng, self._rate = rng, rate

    def ioctl(self, descriptor: int, request: Request, argument: ctypes.Structure) -> None:
        super().ioctl(descriptor, request, argument)
        if self._rng.random() < self._rate:
            size = ctypes.sizeof(argument)
            data = mutated(ctypes.string_at(ctypes.addressof(argument), size), self._rng)
            ctypes.memmove(ctypes.addressof(argument), data.ljust(size, b"\0")[:size], size)


def v4l2_session(rng: random.Random, rate: float) -> None:
    """Open a camera and shoot; replies of the kernel are damaged at this rate."""
    model = DamagedReplies(rng, rate)
    camera = V4l2Camera(PATH, kernel=model, clock=model.clock)
    try:
        with camera:
            list(camera.shoot(settings_at(camera, 1 / 125)))
    finally:
        assert model.descriptors == 0


SESSIONS = {"PTP": ptp_session, "Sierra": sierra_session, "V4L2": v4l2_session}
