"""Photographs of 10 bits in files of 16 bits, shifted by 6 bits or from 8 bits scaled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import camctl
from camctl import CaptureRequest, PhotographOptions
from camctl.photographs.photograph_set import open_photographs

TIMES = (1 / 64, 1 / 16, 1 / 4)
ELECTRONS = 400


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path / "profiles"))


def shot(bits: int, black: int = 0) -> list[NDArray[np.uint16]]:
    """Return frames whose noise in the dark is less than a level."""
    rng, white = np.random.default_rng(0), 2**bits - 1
    light = np.tile(np.geomspace(0.3, white - black, 256), (128, 1))
    frames = []
    for time in TIMES:
        levels = rng.poisson(light * time / TIMES[0] * ELECTRONS) / ELECTRONS
        levels += rng.normal(0.5 if black else 0, 0.1, light.shape) + black
        frames.append(np.clip(np.floor(levels), 0, white).astype(np.uint16))
    return frames


def written(frames: list[NDArray[Any]], name: str) -> list[str]:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is blocked")
    names = [f"{name}{k}.png" for k in range(len(frames))]
    for each, frame in zip(names, frames, strict=True):
        cv2.imwrite(each, frame)
    return names


def merged(files: list[str], curve: str, **options: Any) -> list[NDArray[np.float32]]:
    """Return radiance and its standard deviation."""
    known = PhotographOptions(times=TIMES, curve=curve, **options)
    report = camctl.merge(files, CaptureRequest(response="linear"), options=known)
    return [report.radiance(), report.standard_deviation()]


@pytest.mark.parametrize("curve", ["linear", "srgb"])
def test_shifted_photographs_give_what_10_bits_give(curve: str) -> None:
    frames = shot(10)
    plain = merged(written(frames, "plain"), curve, white=1023)
    found = merged(written([each << 6 for each in frames], "shifted"), curve)
    for one, other in zip(found, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


def test_8_bits_scaled_to_16_give_what_8_bits_give() -> None:
    frames = shot(8)
    plain = merged(written([each.astype(np.uint8) for each in frames], "plain"), "srgb")
    found = merged(written([each * np.uint16(257) for each in frames], "scaled"), "srgb")
    for one, other in zip(found, plain, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-5)


def test_levels_are_stated_and_found_as_in_the_files() -> None:
    files = written([each << 6 for each in shot(10, black=64)], "shifted")
    stated = PhotographOptions(times=TIMES, curve="linear", black=64 << 6, white=65535)
    paths = list(map(Path, files))
    controls = open_photographs(paths, stated).camera.controls
    assert (controls.bits, controls.black, controls.white) == (10, 64, 1023)
    found = open_photographs(paths, PhotographOptions(times=TIMES, curve="linear"))
    (level,) = [each for each in found.facts if each.code == "levels_found"]
    assert level.value == pytest.approx(64 << 6, abs=64)
    assert (level.details["level"], level.details["stated"]) == ("black", 0)
