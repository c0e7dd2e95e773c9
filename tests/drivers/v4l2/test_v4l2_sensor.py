"""Sensors whose controls are in a node of their own, found through the media controller."""

from __future__ import annotations

import ctypes
import errno
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from v4l2_model import PATH, Model, Register, brightness, put

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.abi import ControlId, ControlType
from camctl.drivers.v4l2.camera import V4l2Camera, V4l2Options
from camctl.errors import CameraError
from camctl.interface.controls import ExposureSetting, Steps

pytestmark = pytest.mark.usefixtures("own_profiles")

VIDEO, SENSOR, IO, LENS = (81, 0), 0x00020001, 0x00010001, 0x00020003
OF_THE_SENSOR = (abi.Request.QUERYCTRL, abi.Request.G_CTRL, abi.Request.S_CTRL,
                 abi.Request.G_EXT_CTRLS, abi.Request.QUERYMENU)  # fmt: skip


@dataclass
class Board(Model):
    """A video node without controls, and the media devices of a board.

    Attributes:
        media: entities by media device: type, major, minor
        columns: that the sensor reads; None: it does not say
        opened: paths by descriptor
    """

    media: dict[str, list[tuple[int, int, int]]] | None = None
    columns: int | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        self.opened: dict[int, str] = {}
        for control in (ControlId.EXPOSURE_AUTO, ControlId.EXPOSURE_ABSOLUTE, ControlId.GAIN):
            del self.controls[control]
        kind = ControlType.INTEGER
        self.controls[ControlId.EXPOSURE] = Register("Exposure", kind, 4, 2000, 1, 100, 100)
        self.controls[ControlId.ANALOGUE_GAIN] = Register("Gain", kind, 0, 232, 1, 0, 7)
        self.controls[ControlId.HBLANK] = Register("Blanking", kind, 92, 92, 1, 92, 92)

    def open(self, path: str) -> int:
        descriptor = super().open(path)
        self.opened[descriptor] = Path(path).name
        return descriptor

    def ioctl(self, descriptor: int, request: abi.Request, argument: ctypes.Structure) -> None:
        name = self.opened[descriptor]
        if request in OF_THE_SENSOR and not name.startswith("v4l-subdev"):
            raise OSError(errno.ENOTTY, os.strerror(errno.ENOTTY))
        argument_: Any = argument
        if request is abi.Request.ENUM_ENTITIES:
            self.next_entity(name, argument_)
        elif request is abi.Request.SUBDEV_G_FMT:
            assert argument_.which == 1
            if self.columns is None:
                self.fail(errno.ENOTTY)
            argument_.width = self.columns
        else:
            super().ioctl(descriptor, request, argument)

    def next_entity(self, name: str, found: Any) -> None:
        """The entity with the next larger id, as MEDIA_ENT_ID_FLAG_NEXT asks for."""
        assert found.id >> 31
        entities = (self.media or {})[name]
        number = found.id & 0x7FFFFFFF
        if number >= len(entities):
            self.fail()
        found.id = number + 1
        found.type, found.major, found.minor = entities[number]
        put(f"part {number}", found.name)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Files of a system with two media devices; the second one has the video node."""
    (tmp_path / "dev").mkdir()
    for name in ("media0", "media1"):
        (tmp_path / "dev" / name).touch()
    number = tmp_path / "sys/class/video4linux" / Path(PATH).name
    number.mkdir(parents=True)
    (number / "dev").write_text("81:0\n")
    for minor in (5, 6):
        folder = tmp_path / f"sys/dev/char/81:{minor}"
        folder.mkdir(parents=True)
        (folder / "uevent").write_text(f"MAJOR=81\nMINOR={minor}\nDEVNAME=v4l-subdev{minor}\n")
    return tmp_path


def board(*, columns: int | None = None, sensors: int = 1) -> Board:
    others = [(IO, 81, 9), (SENSOR, 81, 6)]
    own = [(IO, *VIDEO), (LENS, 81, 4), *[(SENSOR, 81, 5)] * sensors]
    return Board(
        formats=("pRAA",),
        pixel_rate=1_000_000,
        intervals=(),
        planes=1,
        media={"media0": others, "media1": own},
        columns=columns,
    )


def opened(model: Board, root: Path) -> V4l2Camera:
    return V4l2Camera(PATH, V4l2Options(), kernel=model, clock=model.clock, root=root).open()


@pytest.mark.parametrize(("columns", "line_s"), [(None, 1e-4), (108, 2e-4)])
def test_the_sensor_of_the_same_board_sets_the_exposure(
    columns: int | None, line_s: float, root: Path
) -> None:
    """Its line takes as long as the columns that it reads, not those of the frame (8)."""
    model = board(columns=columns)
    with opened(model, root) as camera:
        assert "v4l-subdev5" in model.opened.values()
        assert "v4l-subdev6" not in model.opened.values()
        times = camera.controls.time_s
        assert isinstance(times, Steps)
        assert times.step == pytest.approx(line_s)
        (frame,) = camera.shoot([ExposureSetting(times.nearest(0.0124))])
        lines = round(0.0124 / line_s)
        assert frame.applied.time_s == pytest.approx(lines * line_s)
        assert model.controls[ControlId.EXPOSURE].value == lines
        assert np.array_equal(frame.pixels, brightness(lines, 10))
    assert model.descriptors == 0


@pytest.mark.parametrize("sensors", [0, 2])
def test_no_sensor_and_several_are_errors(sensors: int, root: Path) -> None:
    model = board(sensors=sensors)
    with pytest.raises(CameraError) as error:
        opened(model, root)
    assert ("several sensors" in str(error.value)) == (sensors == 2)
    assert error.value.hint
    assert model.descriptors == 0


def test_without_a_media_controller_there_is_no_sensor(tmp_path: Path) -> None:
    model = board()
    with pytest.raises(CameraError):
        opened(model, tmp_path)
    assert model.descriptors == 0
