"""Whole captures on a simulated camera: their files, and what happens when something fails."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
import tifffile
from numpy.typing import NDArray
from sampling import some
from small_cameras import WrappedCamera, gradient, small_camera, sum_of_frames

from camctl.captures import sequence
from camctl.captures.plan import plan_capture
from camctl.captures.sequencer import capture, resume
from camctl.errors import (
    CaptureError,
    StorageError,
    UsageError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.noise import noisy_effective_levels
from camctl.exposure.objective import xi
from camctl.interface.camera import Frame, FrameStream
from camctl.interface.controls import ExposureSetting, Layout
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.inverse import Posterior
from camctl.model.response.desired import desired_response
from camctl.profiles.calibrated import open_camera
from camctl.records.capture_plan import CapturePlan
from camctl.records.folder_store import read_capture
from camctl.records.frame_store import KeptFiles, MemoryStore
from camctl.records.report_json import to_json
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.effects import effect_names

GIVEN = CaptureRequest("log", 1000.0, ratios=(1.0, 4.0, 16.0))
LOCK = ".camctl.lock"
RESULTS = {
    "report.json",
    "frames",
    "sum.tiff",
    "image.tiff",
    "radiance.exr",
    "preview.png",
    "picture.jpg",
    "contact.png",
}
if find_spec("imagecodecs"):
    RESULTS.add("picture.avif")


@pytest.mark.parametrize(
    ("sensor", "layout"),
    [("standard", "mono"), ("standard", "rgb"), ("phone", "rggb"), ("machine-vision", "mono")],
)
def test_sum_is_that_of_the_frames_on_disk(tmp_path: Path, sensor: str, layout: str) -> None:
    with small_camera(sensor, layout=layout) as camera:
        report = capture(camera, GIVEN, tmp_path / "out")
    assert report.status == "complete"
    assert {path.name for path in (tmp_path / "out").iterdir()} - {LOCK} == RESULTS
    saved = json.loads((tmp_path / "out" / "report.json").read_text())
    assert saved == json.loads(json.dumps(to_json(report)))
    total = sum_of_frames(tmp_path / "out", report)
    assert np.array_equal(tifffile.imread(tmp_path / "out" / "sum.tiff"), total)
    assert saved["black_total"] == sum(frame["black"] for frame in saved["frames"])


def test_achieved_quality_is_that_of_the_applied_exposures(tmp_path: Path) -> None:
    with small_camera(line_s=1e-3, time_minimum_s=1e-3) as camera:
        report = capture(camera, CaptureRequest("gamma", 1000.0, 3), tmp_path / "out")
        real = camera.controls.levels
    applied = [frame.applied_s for frame in report.frames]
    assert [frame.exposure for frame in report.frames] == [t / applied[0] for t in applied]
    effective = EffectiveCamera.of(real, [t / applied[0] for t in applied])
    desired = desired_response("gamma", 1000.0)
    assert report.achieved.xi == xi(effective, desired, 3 * real.M)
    achieved, settings = report.achieved, [frame.applied for frame in report.frames]
    assert achieved.effective_levels_noise_free == effective_levels(effective, desired)
    noise = camera.controls.frame_noise(settings)
    posterior = Posterior(effective, desired, noise)
    assert achieved.effective_levels == posterior.inverse.effective_levels
    # Both from other parts of the same distribution, which is known to 1e-7.
    predicted = noisy_effective_levels(effective, desired, noise)
    assert achieved.effective_levels == pytest.approx(predicted, rel=1e-7)
    assert achieved.effective_levels < 0.5 * achieved.effective_levels_noise_free
    assert achieved.noise == camera.sensor.noise_model
    assert report.achieved.levels_distinct == effective.levels_distinct


@pytest.mark.parametrize(("layout", "names"), [("mono", "Y"), ("rgb", "RGB"), ("rggb", "RGB")])
def test_radiance_is_the_scene_in_its_own_unit(tmp_path: Path, layout: str, names: str) -> None:
    # A uniform colour survives demosaicing, and an ideal sensor leaves rounding alone.
    colour = np.array([0.4, 0.2, 0.32], np.float32)
    light = np.full((40, 50, 3), colour)
    light[0, 0] = 0
    truth = [float(np.dot([0.2126, 0.7152, 0.0722], colour))] if names == "Y" else colour
    with small_camera("ideal-8", light, layout=layout) as camera:
        capture(camera, GIVEN, tmp_path / "out")
    with OpenEXR.File(str(tmp_path / "out" / "radiance.exr"), separate_channels=True) as file:
        channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
    for name, value in zip(names, truth, strict=True):
        assert channels[name].dtype == np.float32
        inside = channels[name][4:-4, 4:-4]
        assert np.allclose(inside, value, rtol=0.01)
        assert not channels["mask." + name][4:-4, 4:-4].any()


def test_samples_outside_the_levels_are_masked_and_counted(tmp_path: Path) -> None:
    light = np.full((30, 30), 0.5, np.float32)
    light[:3], light[-3:] = 500.0, 1e-9
    with small_camera("ideal-8", light) as camera:
        request = CaptureRequest("log", 1000.0, ratios=(1.0, 2.0), base_s=0.002)
        report = capture(camera, request, tmp_path / "out")
    mask = report.mask()
    assert (mask[:3] == 2).all()
    assert (mask[-3:] == 1).all()
    assert (mask[3:-3] == 0).all()
    assert report.achieved.saturated_fraction == pytest.approx(0.1)
    assert report.achieved.dark_fraction == pytest.approx(0.1)


def test_image_is_the_desired_response_to_the_scene(tmp_path: Path) -> None:
    """Each value is the response to some light that gives the same brightness in every frame.

    The scene's light is known and the sensor ideal, so that the brightness of each frame and the
    interval of irradiance that it stands for follow from the definition of the linear camera.
    """
    light, dynamic_range = gradient(), 256.0
    request = CaptureRequest("log", dynamic_range, ratios=(1.0, 16.0))
    with small_camera("ideal-12", light) as camera:
        report = capture(camera, request, tmp_path / "out")
        sensitivity = camera.controls.sensitivity
    assert sensitivity is not None
    times_s = [frame.applied_s for frame in report.frames]
    E = light.astype(np.float64) * sensitivity * times_s[0]  # 1 at full scale of the first frame
    low, high = np.zeros_like(E), np.full_like(E, np.inf)
    for time_s in times_s:
        exposure = time_s / times_s[0]
        levels = np.minimum(np.floor(E * exposure * 4096), 4095)
        low = np.maximum(low, levels / 4096 / exposure)
        high = np.minimum(high, np.where(levels < 4095, (levels + 1) / 4096 / exposure, np.inf))

    def constant_contrast(E: NDArray[np.float64]) -> NDArray[np.float64]:
        u: NDArray[np.float64] = 1 + np.log(np.clip(E, 1 / dynamic_range, 1)) / np.log(
            dynamic_range
        )
        return u

    image = tifffile.imread(tmp_path / "out" / "image.tiff")
    assert image.dtype == np.uint16
    # Half a code of rounding; and the simulator computes light in float32.
    slack = 0.5 + 65535 * 1e-6
    assert (image >= 65535 * constant_contrast(low) - slack).all()
    assert (image <= 65535 * constant_contrast(high) + slack).all()
    # The intervals are narrow, so that a wrong image would not pass.
    width = constant_contrast(high) - constant_contrast(low)
    assert np.median(width) < 1 / 1000
    assert width.max() < 1 / 8


@pytest.mark.parametrize("delay", some(range(6), every=5))
def test_no_frame_slot_is_wasted(tmp_path: Path, delay: int) -> None:
    with small_camera(delay_frames=delay) as camera:
        request = CaptureRequest("linear", 256.0, ratios=(1, 1.1, 1.2, 1.3, 1.4), base_s=0.01)
        report = capture(camera, request, tmp_path / "out")
    slots = 5 + delay
    assert report.timing["shooting_s"] / (slots * camera.sensor.frame_interval_s) <= 1.02


@pytest.mark.parametrize("wrong", some([0, 1, 2, 3], every=3))
def test_frame_of_the_wrong_exposure_is_shot_again(tmp_path: Path, wrong: int) -> None:
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 2.0, 4.0, 8.0))
    with small_camera() as camera:
        truth = capture(camera, request, tmp_path / "truth")
    with small_camera(faults=Faults(wrong_exposure={wrong: 0.5})) as camera:
        report = capture(camera, request, tmp_path / "out")
    assert report.warnings == truth.warnings
    assert report.frames[wrong].attempts == 2
    assert any(f"frame-0{wrong + 1}-rejected" in name for name in report.rejected)
    assert all((tmp_path / "out" / name).exists() for name in report.rejected)
    total = sum_of_frames(tmp_path / "out", report)
    assert np.array_equal(tifffile.imread(tmp_path / "out" / "sum.tiff"), total)
    assert np.median(np.abs(report.radiance() / truth.radiance() - 1)) < 0.03


def test_folder_with_other_files_is_never_touched(tmp_path: Path) -> None:
    (tmp_path / "diary.txt").write_text("mine")
    with small_camera() as camera, pytest.raises(StorageError, match="is not empty"):
        capture(camera, GIVEN, tmp_path, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["diary.txt"]


def test_given_plan_is_followed(tmp_path: Path) -> None:
    with small_camera() as camera:
        plan = plan_capture(camera, GIVEN)
        report = capture(camera, GIVEN, tmp_path / "out", plan=plan)
    assert [frame.requested for frame in report.frames] == list(plan.settings)
    assert report.plan == plan


def test_sum_that_does_not_fit_in_32_bits_is_refused_before_shooting(tmp_path: Path) -> None:
    with small_camera() as camera:
        plan = plan_capture(camera, GIVEN)
        setting = ExposureSetting(plan.base_s)
        many = CapturePlan(**{**vars(plan), "settings": (setting,) * 20_000_000})
        with pytest.raises(UsageError, match="does not fit in 32 bits"):
            capture(camera, GIVEN, tmp_path / "out", plan=many)
    assert not (tmp_path / "out").exists()


class OtherFrames(WrappedCamera):
    """A camera whose frames a test changes."""

    def __init__(
        self, camera: SimulatedCamera, change: Callable[[FrameStream], Iterator[Frame]]
    ) -> None:
        super().__init__(camera)
        self._change = change

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        frames = super().shoot(settings)
        return (frame for frame in self._change(frames))


def test_camera_that_ends_the_sequence_early_is_an_error(tmp_path: Path) -> None:
    request = replace(GIVEN, base_s=0.01)
    with small_camera() as simulated:
        camera = OtherFrames(simulated, lambda frames: iter([next(frames)]))
        with pytest.raises(CaptureError, match="ended the sequence 2 frames early; 1 of 3 frames"):
            capture(camera, request, tmp_path / "out")


def test_frame_with_another_white_level_is_an_error_and_is_kept(tmp_path: Path) -> None:
    request = replace(GIVEN, base_s=0.01)
    with small_camera() as simulated:
        camera = OtherFrames(
            simulated, lambda frames: (replace(frame, white=200) for frame in frames)
        )
        with pytest.raises(CaptureError, match="changed its black and white level to 0 and 200"):
            capture(camera, request, tmp_path / "out")
    unfinished = read_capture(tmp_path / "out")
    assert unfinished.frames == [None, None, None]
    assert unfinished.rejected == ["frames/frame-01-rejected-1.npy"]
    assert np.load(tmp_path / "out" / unfinished.rejected[0]).shape == (60, 80)
    with small_camera() as simulated:
        assert resume(simulated, tmp_path / "out").status == "complete"


def test_report_names_the_pixel_layout(tmp_path: Path) -> None:
    with small_camera("phone") as camera:
        report = capture(camera, GIVEN, tmp_path / "out")
    assert report.layout is Layout.RGGB
    assert json.loads((tmp_path / "out" / "report.json").read_text())["layout"] == "rggb"


def test_report_has_one_summary_of_what_the_frames_lack(tmp_path: Path) -> None:
    options = {"sensor": "complete", "size": "64x48", "tolerance": "0.5"}
    with open_camera("sim", **options) as camera:
        report = capture(camera, GIVEN, tmp_path / "out")
    saved = json.loads((tmp_path / "out" / "report.json").read_text())
    summary = report.simulation
    assert summary is not None
    assert saved["simulation"] == summary.model_dump(exclude_defaults=True)
    assert 0 < summary.joint_bound_dn <= summary.tolerance_dn
    assert summary.tolerance_dn == pytest.approx(0.5)
    assert set(summary.left_out) <= set(effect_names())
    numbers = set(range(1, len(report.frames) + 1))
    assert all(one.frames and set(one.frames) <= numbers for one in summary.left_out.values())
    assert all("simulation" not in frame.get("details", {}) for frame in saved["frames"])


@pytest.mark.parametrize("sensor", ["standard", "machine-vision"])
@pytest.mark.parametrize(
    ("base_s", "reason"), [(1e-5, "is black"), (60.0, "is white"), (0.02, None)]
)
def test_black_or_white_picture_causes_a_warning(
    tmp_path: Path, sensor: str, base_s: float, reason: str | None
) -> None:
    with small_camera(sensor, time_minimum_s=1e-5, line_s=1e-5, time_maximum_s=120.0) as camera:
        request = CaptureRequest("log", 1000.0, ratios=(1.0, 1.0), base_s=base_s)
        report = capture(camera, request, tmp_path / "out")
    found = [line for line in report.warnings if "in every exposure" in line]
    assert len(found) == (reason is not None)
    assert all(reason in line for line in found if reason is not None)


@pytest.mark.parametrize(("waiting_bytes", "goes_on"), [(None, True), (0, False)])
def test_a_stream_goes_on_while_small_frames_are_stored(
    monkeypatch: pytest.MonkeyPatch, waiting_bytes: int | None, *, goes_on: bool
) -> None:
    """A pause would cost frames of the stream; large frames do not wait, for the sake of memory."""
    if waiting_bytes is not None:
        monkeypatch.setattr(sequence, "WAITING_BYTES", waiting_bytes)
    third = threading.Event()
    went_on: list[bool] = []

    def observed(frames: FrameStream) -> Iterator[Frame]:
        for frame in frames:
            yield frame
            if frame.index == 1:  # the third frame is asked for
                third.set()

    def keep(store: MemoryStore, frame: Frame, position: int) -> KeptFiles:
        if position == 0:
            went_on.append(third.wait(30 if goes_on else 0.2))
        return kept(store, frame, position)

    kept = MemoryStore.keep
    monkeypatch.setattr(MemoryStore, "keep", keep)
    with small_camera() as camera:
        capture(OtherFrames(camera, observed), replace(GIVEN, base_s=0.01))
    assert went_on == [goes_on]
