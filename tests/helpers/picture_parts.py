"""What the picture files of a capture say of it, for tests that make no capture."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import CameraInfo
from camctl.interface.controls import ExposureSetting
from camctl.pictures.details import PictureDetails, ShownFrame
from camctl.pictures.preview_light import ALL, Light

TAKEN_AT = datetime(2026, 5, 17, 21, 4, 9, tzinfo=timezone(timedelta(hours=2)))


def details(
    count: int = 2,
    thumbnail: NDArray[np.uint8] | None = None,
    f_number: float | None = 2.8,
    iso: float | None = 200,
) -> PictureDetails:
    """Return those of a capture of `count` frames, each four times as long as the one before."""
    picture = np.full((30, 40, 3), 120, np.uint8) if thumbnail is None else thumbnail
    frames = tuple(
        ShownFrame(
            picture,
            ExposureSetting(0.25 * 4.0**place, 2.0, f_number),
            0.01 * place,
            0.004 / 4.0**place,
            1 / 4.0**place,
            iso,
        )
        for place in range(count)
    )
    camera = CameraInfo("bench:0", "Bénch", "Camera 1", "S/N 7", "bench")
    return PictureDetails(
        camera, TAKEN_AT, "camctl 1.2.3", "log", 1e-3, 1.0, "as the scene", frames, 0.02, 0.4
    )


def light_of(
    irradiance: NDArray[np.floating],
    noise: float = 0.0,
    saturated: NDArray[np.floating] | None = None,
    dark: NDArray[np.floating] | None = None,
) -> Light:
    """Return light of one relative noise, (rows, columns) or (rows, columns, 3).

    What is dark is without any light.
    """
    light = irradiance.astype(np.float32).reshape(*irradiance.shape[:2], -1)
    none = np.zeros(light.shape[:2])
    shares = [none if share is None else share for share in (saturated, dark, dark, saturated)]
    return Light(
        light,
        np.full(light.shape, noise, np.float32),
        *((ALL * share).astype(np.uint8) for share in shares),
    )
