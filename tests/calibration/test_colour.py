"""Colours of a camera from a chart, and the colour difference that judges them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl.calibration.colour import REFERENCE, reference_xyz
from camctl.errors import DataError
from camctl.interface.colour import BT709_PRIMARIES, D65, rgb_to_xyz
from camctl.model.colour_difference import ciede2000, lab_of_xyz, xyz_of_lab
from camctl.profiles.profile import load_profile

# Sharma, Wu and Dalal (2005), table 1: L*, a*, b* of both colours, and their difference.
SHARMA = np.array(
    [
        (50.0000, 2.6772, -79.7751, 50.0000, 0.0000, -82.7485, 2.0425),
        (50.0000, 3.1571, -77.2803, 50.0000, 0.0000, -82.7485, 2.8615),
        (50.0000, 2.8361, -74.0200, 50.0000, 0.0000, -82.7485, 3.4412),
        (50.0000, -1.3802, -84.2814, 50.0000, 0.0000, -82.7485, 1.0000),
        (50.0000, -1.1848, -84.8006, 50.0000, 0.0000, -82.7485, 1.0000),
        (50.0000, -0.9009, -85.5211, 50.0000, 0.0000, -82.7485, 1.0000),
        (50.0000, 0.0000, 0.0000, 50.0000, -1.0000, 2.0000, 2.3669),
        (50.0000, -1.0000, 2.0000, 50.0000, 0.0000, 0.0000, 2.3669),
        (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0009, 7.1792),
        (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0010, 7.1792),
        (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0011, 7.2195),
        (50.0000, 2.4900, -0.0010, 50.0000, -2.4900, 0.0012, 7.2195),
        (50.0000, -0.0010, 2.4900, 50.0000, 0.0009, -2.4900, 4.8045),
        (50.0000, -0.0010, 2.4900, 50.0000, 0.0010, -2.4900, 4.8045),
        (50.0000, -0.0010, 2.4900, 50.0000, 0.0011, -2.4900, 4.7461),
        (50.0000, 2.5000, 0.0000, 50.0000, 0.0000, -2.5000, 4.3065),
        (50.0000, 2.5000, 0.0000, 73.0000, 25.0000, -18.0000, 27.1492),
        (50.0000, 2.5000, 0.0000, 61.0000, -5.0000, 29.0000, 22.8977),
        (50.0000, 2.5000, 0.0000, 56.0000, -27.0000, -3.0000, 31.9030),
        (50.0000, 2.5000, 0.0000, 58.0000, 24.0000, 15.0000, 19.4535),
        (50.0000, 2.5000, 0.0000, 50.0000, 3.1736, 0.5854, 1.0000),
        (50.0000, 2.5000, 0.0000, 50.0000, 3.2972, 0.0000, 1.0000),
        (50.0000, 2.5000, 0.0000, 50.0000, 1.8634, 0.5757, 1.0000),
        (50.0000, 2.5000, 0.0000, 50.0000, 3.2592, 0.3350, 1.0000),
        (60.2574, -34.0099, 36.2677, 60.4626, -34.1751, 39.4387, 1.2644),
        (63.0109, -31.0961, -5.8663, 62.8187, -29.7946, -4.0864, 1.2630),
        (61.2901, 3.7196, -5.3901, 61.4292, 2.2480, -4.9620, 1.8731),
        (35.0831, -44.1164, 3.7933, 35.0232, -40.0716, 1.5901, 1.8645),
        (22.7233, 20.0904, -46.6940, 23.0331, 14.9730, -42.5619, 2.0373),
        (36.4612, 47.8580, 18.3852, 36.2715, 50.5065, 21.2231, 1.4146),
        (90.8027, -2.0831, 1.4410, 91.1528, -1.6435, 0.0447, 1.4441),
        (90.9257, -0.5406, -0.9208, 88.6381, -0.8985, -0.7239, 1.5381),
        (6.7747, -0.2908, -2.4247, 5.8714, -0.0985, -2.2286, 0.6377),
        (2.0776, 0.0795, -1.1350, 0.9033, -0.0636, -0.5514, 0.9082),
    ]
)

#: Of a simulated camera: the matrix from its balanced R, G, B to BT.709, and its white balance.
TRUE_MATRIX = np.array([[1.62, -0.52, -0.10], [-0.21, 1.48, -0.27], [0.02, -0.46, 1.44]])
TRUE_BALANCE = np.array([2.1, 1.0, 1.5])
SIDE = 60
FULL_E = 10_000


def chart_light(rows: int, columns: int) -> NDArray[np.float64]:
    """Return what the camera sees of a chart in perspective, (rows, columns, 3), white is 1."""
    light = reference_xyz() @ np.linalg.inv(rgb_to_xyz(BT709_PRIMARIES, D65)).T
    camera = light @ np.linalg.inv(TRUE_MATRIX).T / TRUE_BALANCE
    flat = np.full((4 * SIDE, 6 * SIDE, 3), 0.02)
    for k, colour in enumerate(camera):
        row, column = divmod(k, 6)
        top, left = row * SIDE + 4, column * SIDE + 4
        flat[top : top + SIDE - 8, left : left + SIDE - 8] = colour
    corners = np.array([(0, 0), (6 * SIDE, 0), (6 * SIDE, 4 * SIDE), (0, 4 * SIDE)], np.float32)
    seen = np.array([(0.14, 0.12), (0.88, 0.17), (0.85, 0.84), (0.11, 0.90)], np.float32)
    matrix = cv2.getPerspectiveTransform(corners, seen * np.array((columns, rows), np.float32))
    return np.asarray(
        cv2.warpPerspective(
            flat, matrix, (columns, rows), flags=cv2.INTER_AREA, borderValue=(0.15, 0.15, 0.15)
        )
    )


def mosaic(light: NDArray[np.float64], exposure: float, seed: int = 0) -> NDArray[np.uint16]:
    """Return a frame of an RGGB camera of 12 bits with photon and read noise."""
    random = np.random.default_rng(seed)
    samples = np.empty(light.shape[:2])
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        samples[row::2, column::2] = light[row::2, column::2, channel]
    electrons = random.poisson(np.maximum(samples * exposure, 0) * FULL_E)
    level = (electrons + random.normal(0, 4, electrons.shape)) / FULL_E
    return np.rint(np.clip(level, 0, 1) * 4095).astype(np.uint16)


def test_difference_is_that_of_the_published_pairs() -> None:
    for one, other in ((SHARMA[:, :3], SHARMA[:, 3:6]), (SHARMA[:, 3:6], SHARMA[:, :3])):
        np.testing.assert_allclose(ciede2000(one, other), SHARMA[:, 6], atol=5.1e-5)


def test_lab_is_inverted() -> None:
    white = np.array([0.95, 1.0, 1.09])
    np.testing.assert_allclose(lab_of_xyz(xyz_of_lab(REFERENCE, white), white), REFERENCE)


@pytest.mark.slow
def test_matrix_of_a_chart_in_perspective() -> None:
    light = chart_light(480, 640)
    frames = [mosaic(light, exposure, seed) for seed, exposure in enumerate((0.7, 2.5))]
    found = camctl.calibrate.colour(frames, (0.7, 2.5), white=4095, layout="rggb")
    assert found.patches == 24
    assert found.mean_difference < 1.0
    assert found.largest_difference < 3.0
    np.testing.assert_allclose(found.matrix, TRUE_MATRIX, atol=0.06)
    np.testing.assert_allclose(found.white_balance, TRUE_BALANCE, rtol=0.01)
    # The matrix from XYZ gives what the camera sees.
    from_xyz = np.array(found.camera_colour().xyz_to_camera)
    seen = reference_xyz() @ from_xyz.T
    true = reference_xyz() @ np.linalg.inv(rgb_to_xyz(BT709_PRIMARIES, D65)).T
    true = true @ np.linalg.inv(TRUE_MATRIX).T / TRUE_BALANCE
    np.testing.assert_allclose(seen, true, atol=0.02)


@pytest.mark.parametrize(
    ("frame", "layout"),
    [
        (np.full((48, 64), 900, np.uint16), "rggb"),
        (mosaic(chart_light(240, 320), 40.0), "rggb"),
        (np.full((48, 64), 900, np.uint16), "mono"),
    ],
    ids=["no chart", "saturated", "monochrome"],
)
def test_frames_without_a_usable_chart(frame: NDArray[Any], layout: str) -> None:
    with pytest.raises(DataError) as error:
        camctl.calibrate.colour([frame], white=4095, layout=layout)
    assert error.value.hint


@pytest.mark.slow
def test_camera_has_the_colours_of_its_profile(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))
    options = {"scene": "colour-chart", "sensor": "webcam", "size": "320x240"}
    with camctl.open_camera("sim", options) as camera:
        assert camera.controls.colour is None
        measured = camctl.calibrate.colour(camera, response="linear").save()
        assert measured.mean_difference < 3
        info = camera.info
    stored = load_profile(info).colours[measured.mode]
    assert stored.model_dump() == measured.model_dump(include=set(type(stored).model_fields))
    with camctl.open_camera("sim", options) as camera:
        colour = camera.controls.colour
        assert colour is not None
        np.testing.assert_allclose(colour.matrix, measured.matrix)
    with camctl.open_camera("sim", {**options, "profile": "response"}) as camera:
        assert camera.controls.colour is None
