"""Our V4L2 driver on the model of a device, in virtual time."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest
from v4l2_model import PATH, Model, ticks_of

from camctl.drivers.v4l2.camera import V4l2Camera, V4l2Options
from camctl.errors import CamctlError
from camctl.interface.camera import CameraInfo, Frame
from camctl.interface.controls import ExposureSetting
from camctl.profiles.profile import DelayRecord, Profile, save_profile

#: Exposures of a list of settings, x 100 us.
TICKS = (40, 10, 160, 20, 80, 40, 320, 11)


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


def open_streaming(model: Model) -> V4l2Camera:
    """Return our camera at 10 frames a second, with a linear response."""
    return open_model(model, response="linear", fps="10")


def save_delay(frames: int | None, smallest: int = 0, largest: int = 0) -> None:
    """Store a measured delay in the profile of the model: `frames`, or the bounds without it."""
    record = DelayRecord(
        frames=frames,
        smallest=smallest if frames is None else frames,
        largest=largest if frames is None else frames,
        trials=12,
        measured_at="2026-01-01T00:00:00",
    )
    info = CameraInfo(f"v4l2:{PATH}", "uvcvideo", "A webcam", "", "v4l2")
    save_profile(
        Profile(
            driver=info.driver,
            make=info.make,
            model=info.model,
            serial=info.serial,
            delays={"yuyv-8x6-10": record},
        )
    )


def settings(ticks: Iterable[int]) -> list[ExposureSetting]:
    return [ExposureSetting(each / 10_000) for each in ticks]


def exposures(frames: Iterable[Frame]) -> list[int]:
    """Return the exposures that the pixels show, x 100 us."""
    return [ticks_of(frame.pixels) for frame in frames]
