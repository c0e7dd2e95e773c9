"""Movement where noise is unknown: lamps before a dark wall, where it is measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.evidence.light_ratio import NeighbourCheck
from camctl.evidence.marks import FALSE_ALARMS
from camctl.evidence.movement import find_movement
from camctl.evidence.residual import Pair, Side
from camctl.interface.camera import Pixels
from camctl.model.response.camera import linear_response


def lamps(seed: int, first: int = 0, *, is_sharp: bool = True) -> NDArray[np.float64]:
    """Return a dark wall with lamps, `first` to 11; the lamp 0 has half of full scale."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:160, :240]
    light = np.full(rows.shape, 0.0005)
    for number in range(12):
        row, column = rng.uniform(10, 150), rng.uniform(10, 230)
        radius, bright = rng.uniform(2, 6), rng.uniform(0.05, 0.9)
        away = np.hypot(rows - row, columns - column)
        shape = (
            np.clip(radius + 0.5 - away, 0, 1) if is_sharp else np.exp(-2 * (away / radius) ** 2)
        )
        if number >= first:
            light += (bright if number else 0.5) * shape
    return light


@pytest.mark.parametrize("sensor", ["standard", "machine-vision"])
def test_lamps_before_a_wall_of_unknown_noise_do_not_move(sensor: str, tmp_path: Path) -> None:
    """All measured patches are dark: their error is not one of the same share of the lamps."""
    request = camctl.CaptureRequest("log", 1000.0, ratios=(1.0, 8.0, 64.0))
    path = tmp_path / "lamps.npy"
    for seed in range(3):
        np.save(path, lamps(seed).astype(np.float32))
        with camctl.open_camera(
            "sim", scene=str(path), sensor=sensor, seed=seed, unknown=True
        ) as camera:
            movement = camctl.capture(camera, request).movement
        assert movement is not None
        assert movement.places == ()
        assert movement.share <= movement.false_alarms


def test_noise_without_photons_says_nothing_of_bright_blobs(tmp_path: Path) -> None:
    """The wall alone shows noise, too little light to tell photon noise from read noise."""
    np.save(tmp_path / "blobs.npy", lamps(2, is_sharp=False).astype(np.float32))
    with camctl.open_camera("sim", scene=str(tmp_path / "blobs.npy"), sensor="phone", seed=2) as it:
        request = camctl.CaptureRequest("log", 1000.0, ratios=(1.0, 4.0, 16.0))
        frames = list(it.shoot(camctl.plan_capture(it, request).settings))
    times = [frame.applied.time_s for frame in frames]  # all have one gain
    found = camctl.combine([each.pixels for each in frames], times, black=64, white=1023)
    assert not np.isfinite(found.noise[0][0].electrons_per_level)
    assert ((found.mask & 4) != 0).mean() < FALSE_ALARMS


def test_a_lamp_that_goes_out_before_a_dark_wall_is_found_where_noise_is_unknown() -> None:
    rng, light, others = np.random.default_rng(1), lamps(0), lamps(0, first=1)
    check = NeighbourCheck(linear_response(8), 0)
    frames: list[Pixels] = []
    for exposure, seen in ((1.0, others), (1.5, light)):
        electrons = rng.poisson(np.minimum(seen * exposure, 2) * 10_000)
        frames.append(np.clip(electrons / 10_000 * 256, 0, 255).astype(np.uint8))
    samples = check.sample(frames[0]).patches, check.sample(frames[1]).patches
    pair = Pair(check.scale, Side(0, 1.0, None), Side(1, 1.5, None), 1.5, samples)
    movement = find_movement(lambda k, part: frames[k][part], frames[0].shape, [pair])
    assert movement is not None
    (place,) = movement.found.places
    assert (light - others)[place.top : place.bottom, place.left : place.right].max() > 0.4
