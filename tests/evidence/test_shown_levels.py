"""Black and white levels that frames show: where stated wrongly, and not where all is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from raw_photographs import WHITE, mosaic, raw_file
from small_cameras import small_camera

import camctl
from camctl.captures.sequencer import capture
from camctl.evidence.patches import sample_patches
from camctl.evidence.shown_levels import black_level, saturation_level
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Frame
from camctl.messages.plain import sentence
from camctl.model.response.camera import CameraResponse, linear_response
from camctl.photographs.merge import merge
from camctl.photographs.photograph_set import PhotographOptions
from camctl.sim.camera import SimulatedCamera

BLACK, TOP, GAIN = 60, 4095, 4.0
EXPOSURES = (1.0, 8.0, 64.0)
RESPONSE = linear_response(12, phase=0.5, levels=TOP - BLACK)


def scene(contrast: float = 1000, shape: tuple[int, int] = (160, 240)) -> NDArray[np.float64]:
    """Return light up to full scale at exposure 8, with texture, in electrons of a level of 4."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    light = contrast ** (column / shape[1] - 1) * (1 + 0.2 * np.sin(row / 9))
    return np.asarray(light * (TOP - BLACK) * GAIN / 8)


def shoot(
    exposures: tuple[float, ...],
    level: float = np.inf,
    uniformity: float = 0.0,
    seen: Callable[[int], NDArray[np.float64]] = lambda _: scene(),
) -> list[NDArray[np.uint16]]:
    """Return frames with noise that saturate at `level` + black, with pixels that differ in it."""
    rng = np.random.default_rng(5)
    pixels = 1 + uniformity * rng.normal(size=seen(0).shape)
    frames = []
    for k, exposure in enumerate(exposures):
        electrons = np.minimum(rng.poisson(seen(k) * exposure), level * GAIN * pixels)
        levels = electrons / GAIN + BLACK + rng.normal(0, 1.2, pixels.shape)
        frames.append(np.clip(np.rint(levels), 0, TOP).astype(np.uint16))
    return frames


def brighter(added: tuple[float, ...], position: int) -> NDArray[np.float64]:
    """Return the scene with a share of its brightest light added."""
    return np.asarray(scene() + added[position] * scene().max())


def black_of(
    frames: list[NDArray[np.uint16]],
    stated: int,
    exposures: tuple[float, ...] = EXPOSURES,
    response: CameraResponse | None = None,
) -> int | None:
    patches = [sample_patches([each], TOP) for each in frames]
    known = response or linear_response(12, phase=0.5, levels=TOP - stated)
    return black_level(patches, exposures, known, stated, TOP)


@pytest.mark.parametrize("stated", [0, 40, 62, 100])
def test_the_black_level_is_found_to_a_level(stated: int) -> None:
    assert black_of(shoot(EXPOSURES), stated) == BLACK


def test_what_else_may_be_wrong_is_no_black_level() -> None:
    assert black_of(shoot(EXPOSURES), BLACK) is None
    assert black_of(shoot((1.0, 8.0, 40.0)), BLACK) is None
    assert black_of(shoot((1.0, 4.0, 64.0)), BLACK) is None
    assert black_of(shoot((1.0, 1.0)), 0, (1.0, 1.0)) is None  # they have one ratio
    for share in (0.005, 0.02, 0.05):  # of the highlights: it came on after the first frame
        added = (0.0, share, share)
        lit = shoot(EXPOSURES, seen=partial(brighter, added))
        assert black_of(lit, BLACK) is None
    # Two frames cannot tell it from black, of which somebody has said what it is.
    assert black_of(shoot(EXPOSURES[:2]), BLACK + 20, EXPOSURES[:2]) is None
    assert black_of(shoot(EXPOSURES[:2]), 0, EXPOSURES[:2]) == BLACK
    curve = np.geomspace(1e-4, 1, TOP - BLACK)
    assert black_of(shoot(EXPOSURES), 0, response=CameraResponse(curve, "curve")) is None


def coloured(lifted: float, layout: str) -> list[NDArray[np.uint16]]:
    """Return frames of three colours; the black level of blue is `lifted` levels more."""
    frames = shoot(EXPOSURES)
    blue = [np.minimum(each + np.uint16(lifted), TOP).astype(np.uint16) for each in frames]
    if layout == "rgb":
        pairs = zip(frames, blue, strict=True)
        return [np.stack((one, one, other), axis=-1) for one, other in pairs]
    for one, other in zip(frames, blue, strict=True):
        one[1::2, 1::2] = other[1::2, 1::2]
    return frames


@pytest.mark.parametrize("layout", ["rgb", "rggb"])
def test_one_colour_may_have_another_black_level(layout: str) -> None:
    result = camctl.combine(coloured(10, layout), EXPOSURES, black=BLACK, white=TOP, layout=layout)
    found = [each for each in result.findings if each.code == "levels_found"]
    assert [(each.value, each.details["colour"]) for each in found] == [(BLACK + 10, "B")]
    assert sentence(found[0]).startswith("the black level of channel B is 70, not 60: ")
    both = camctl.combine(coloured(40, layout), EXPOSURES, black=50, white=TOP, layout=layout)
    *others, blue = both.findings
    assert (blue.value, blue.details["colour"]) == (100, "B")
    assert {(each.code, each.value) for each in others} == {("levels_found", 60)}  # nothing moved
    right = camctl.combine(coloured(0, layout), EXPOSURES, black=BLACK, white=TOP, layout=layout)
    assert not right.findings


def test_light_is_right_whatever_black_is_stated() -> None:
    frames = shoot(EXPOSURES)
    result = camctl.combine(frames, EXPOSURES, white=TOP)
    assert [(each.code, each.value) for each in result.findings] == [("levels_found", BLACK)]
    light = scene() / GAIN / (TOP - BLACK + 1)
    z = ((result.irradiance - light) / result.sd)[result.mask == 0]
    assert 0.95 < np.sqrt(np.mean(z**2)) < 1.05


def found(frames: list[NDArray[np.uint16]], exposures: tuple[float, ...] = EXPOSURES) -> int | None:
    patches = [sample_patches([each], TOP) for each in frames]
    return saturation_level(patches, exposures, RESPONSE, BLACK, TOP)


@pytest.mark.parametrize("uniformity", [0.0, 0.003])
@pytest.mark.parametrize("level", [1200, 2500, 3700])
def test_a_full_pixel_is_found_below_white(level: int, uniformity: float) -> None:
    white = found(shoot(EXPOSURES, level, uniformity))
    assert white is not None
    # At most one of a thousand saturated samples is below it, and it is not far below them.
    spread = 3.1 * np.hypot(1.3, uniformity * level)
    assert 0 < level + BLACK - white < 1.3 * spread + 3


def test_what_else_may_be_wrong_is_no_saturation() -> None:
    assert found(shoot(EXPOSURES)) is None
    assert found(shoot((1.0, 8.0, 16.0))) is None  # the last frame has a quarter of its exposure

    def moved(position: int) -> NDArray[np.float64]:
        light = scene()
        if position == 2:
            light[20:140, 100:] = light[20:140, 40:180] / 6
        return light

    assert found(shoot(EXPOSURES, seen=moved)) is None
    assert found(shoot((1.0, 1.0, 1.0), 2500), (1.0, 1.0, 1.0)) is None  # nothing must be white


def test_light_of_full_pixels_is_right_whatever_white_is_stated() -> None:
    frames, light = shoot(EXPOSURES, 3540, 0.002), scene() / GAIN / (TOP - BLACK + 1)
    result = camctl.combine(frames, EXPOSURES, black=BLACK, white=TOP)
    assert [each.code for each in result.findings] == ["levels_found"]
    bright = light > np.quantile(light, 0.4)
    z = (result.irradiance - light)[bright] / result.sd[bright]
    assert 0.95 < np.sqrt(np.mean(z**2)) < 1.05


def test_raw_files_may_state_white_too_high(tmp_path: Path) -> None:
    pytest.importorskip("rawpy", reason="rawpy is missing: pip install 'camctl[raw]'")
    row, column = np.mgrid[:96, :144]
    light = np.stack([1e-2 * 300 ** (column / 144) * (1 + 0.2 * np.sin(row / 5))] * 3, axis=-1)
    files, real = [], 12500
    for time_s in (1.0, 0.25, 1 / 16):
        samples = mosaic(light, time_s)
        noise = np.random.default_rng(3).normal(0, 3, samples.shape)
        samples = np.minimum(samples, np.rint(real + noise)).astype(np.uint16)
        files.append(tmp_path / f"r{round(1 / time_s)}.dng")
        files[-1].write_bytes(raw_file(samples, time_s))
    known = PhotographOptions(labels="exact", colour="camera")
    report = merge(files, CaptureRequest("linear"), tmp_path / "out", options=known)
    assert report.source is not None
    assert [each["code"] for each in report.source["facts"]].count("levels_found") == 1
    assert "moved" not in [each.code for each in report.findings]
    assert real - 25 < report.white < real
    ratio = report.radiance()[..., 1] / light[..., 1]
    assert np.quantile(np.abs(ratio / np.median(ratio) - 1), 0.98) < 0.05
    stated = replace(known, white=WHITE)  # by a person
    told = merge(files, CaptureRequest("linear"), tmp_path / "told", options=stated)
    assert told.white == WHITE


def test_a_capture_says_where_the_camera_saturates(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = SimulatedCamera._frame

    def full(self: SimulatedCamera, *args: Any, **options: Any) -> Frame:
        frame = whole(self, *args, **options)
        return replace(frame, pixels=np.minimum(frame.pixels, np.uint16(2700)))

    monkeypatch.setattr(SimulatedCamera, "_frame", full)
    known = CaptureRequest("log", 1000.0, ratios=(1.0, 8.9, 88.0), base_s=2e-3)
    with small_camera("machine-vision") as camera:
        report = capture(camera, known)
    assert not report.trustworthy
    codes = [each.code for each in report.findings]
    assert "levels_found" in codes
    assert not {"exposure_differs", "moved", "light_spread"} & set(codes)  # one cause, one finding


def test_a_capture_says_which_black_level_the_frames_have(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = SimulatedCamera._frame

    def lifted(self: SimulatedCamera, *args: Any, **options: Any) -> Frame:
        frame = whole(self, *args, **options)
        return replace(
            frame, pixels=np.minimum(frame.pixels, np.uint16(frame.white - 50)) + np.uint16(50)
        )

    monkeypatch.setattr(SimulatedCamera, "_frame", lifted)
    known = CaptureRequest("log", 1000.0, ratios=(1.0, 8.9, 88.0), base_s=2e-4)
    with small_camera("machine-vision") as camera:
        report = capture(camera, known)
        black = camera.controls.black
    assert not report.trustworthy
    values = [each.value for each in report.findings if each.code == "levels_found"]
    assert values == [black + 50]
    assert "control delay" not in str(report.untrustworthy_because)
