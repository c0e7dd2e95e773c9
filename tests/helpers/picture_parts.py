"""What the picture files of a capture say of it, for tests that make no capture."""

from __future__ import annotations

from datetime import datetime, timedelta, timezone

import numpy as np
from numpy.typing import NDArray

from camctl.interface.camera import CameraInfo
from camctl.interface.colour import BT709
from camctl.interface.controls import ExposureSetting, Layout
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import posterior_of
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.pictures.details import PictureDetails, ShownFrame
from camctl.pictures.frame_light import frame_light, parts_of
from camctl.pictures.preview_light import ALL, Light
from camctl.pictures.render import Rendering, Tables

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
        camera,
        TAKEN_AT,
        "camctl 1.2.3",
        "log",
        1e-3,
        1.0,
        "as the scene",
        frames,
        0.02,
        0.4,
        colour=BT709,
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


#: Frames of `rendered`: 6 bits above a black level.
BLACK, EXPOSURES, NOISE = 2, (1.0, 4.0), FrameNoise(50.0, 0.2, black=2)


def rendered(
    layout: Layout,
    response: str = "log",
    unit: float = 2.0,
    shape: tuple[int, int] = (37, 22),
    light: NDArray[np.floating] | None = None,
    noise: FrameNoise | None = NOISE,
) -> tuple[NDArray[np.uint16], Rendering]:
    """Return the sum of two frames of random light, and what makes their pictures."""
    size = (*shape, 3) if layout is Layout.RGB else shape
    rng, real = np.random.default_rng(0), linear_response(6)
    E = rng.uniform(0, 1.1, size) ** 3 if light is None else light
    frames = [
        (BLACK + np.searchsorted(real.levels, exposure * E, "right")).astype(np.uint8)
        for exposure in EXPOSURES
    ]
    desired = desired_response(response, 100.0)
    known = (noise or FrameNoise(np.inf, 0.0, black=BLACK),) * 2
    estimator = frame_light(
        parts_of(layout, [real]),
        EXPOSURES,
        known if noise else None,
        [np.zeros((0, 64), np.uint16)] * 2,
        black=BLACK,
        unit=unit,
    )
    how = Rendering(
        layout,
        (Tables.of(posterior_of(EffectiveCamera.of(real, EXPOSURES), desired, known)),),
        desired,
        estimator,
        lambda place, rows: frames[place][rows],
        len(frames),
    )
    return np.asarray(np.sum(frames, axis=0, dtype=np.uint16)), how
