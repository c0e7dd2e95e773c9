"""Our V4L2 driver on the model of a device, in virtual time."""

from __future__ import annotations

from typing import Any

import pytest
from v4l2_model import PATH, Model

from camctl.camera import Frame
from camctl.controls import ExposureSetting
from camctl.errors import CamctlError
from drivers.v4l2.camera import V4l2Camera, V4l2Options


def open_model(model: Model, **options: Any) -> V4l2Camera:
    chosen = V4l2Options.parse(options)
    return V4l2Camera(PATH, chosen, kernel=model, clock=model.clock).open()


def opening_error(kind: type[CamctlError], model: Model, **options: Any) -> str:
    """Return the message with which opening fails; nothing is left open."""
    with pytest.raises(kind) as caught:
        open_model(model, **options)
    assert model.descriptors == 0
    message = str(caught.value)
    assert "\n" not in message
    assert caught.value.hint
    return message


def one_frame(camera: V4l2Camera, ticks: int = 100) -> Frame:
    return next(camera.shoot([ExposureSetting(ticks / 10_000)]))
