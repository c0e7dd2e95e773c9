"""The noise of frames of 10 bits that are shifted into 16 bits."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl

BLACK, STEP, WHITE, ELECTRONS = 16, 64, 1023, 400
TIMES = (1, 1, 4, 4, 16, 16)


@pytest.fixture(scope="module")
def frames() -> list[NDArray[Any]]:
    """Return pairs of frames whose read noise is a tenth of a level."""
    rng = np.random.default_rng(1)
    light = np.tile(np.geomspace(0.3, WHITE - BLACK, 512), (128, 1))
    found = []
    for time in TIMES:
        levels = rng.poisson(light * time * ELECTRONS) / ELECTRONS
        levels += rng.normal(0, 0.1, light.shape) + BLACK
        found.append(np.clip(np.rint(levels), 0, WHITE).astype(np.uint16))
    return found


@pytest.mark.parametrize("are_files", [False, True])
def test_it_is_that_of_10_bits(
    frames: list[NDArray[Any]],
    are_files: bool,
    tmp_path: Path,
) -> None:
    """The step is no read noise, which a picture would have twice."""
    plain = camctl.calibrate.noise(frames, TIMES, black=BLACK, white=WHITE)
    given: list[Any] = [each * np.uint16(STEP) for each in frames]
    if are_files:
        cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
        files = [tmp_path / f"{k}.png" for k in range(len(frames))]
        for file, frame in zip(files, given, strict=True):
            cv2.imwrite(str(file), frame)
        given = files
    found = camctl.calibrate.noise(given, TIMES, black=BLACK * STEP, white=WHITE * STEP)
    assert not found.findings
    assert found.read_noise_e.value == pytest.approx(0.1 * ELECTRONS, rel=0.05)
    assert found.read_noise_e.value == pytest.approx(plain.read_noise_e.value)
    electrons = plain.conversion_e_per_dn.value / STEP
    assert found.conversion_e_per_dn.value == pytest.approx(electrons)
    assert found.full_well_e.value == pytest.approx(plain.full_well_e.value)
    for one, other in zip(found.reference.curve, plain.reference.curve, strict=True):
        assert one.mean == pytest.approx(other.mean * STEP)
        assert one.variance == pytest.approx(other.variance * STEP**2)
        assert one.fitted == pytest.approx(other.fitted * STEP**2)
