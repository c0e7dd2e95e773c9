"""The whole job on a simulated camera: what lands on disk, what happens when things go wrong."""

import json
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import tifffile

from camctl.captures.plan import plan_capture
from camctl.captures.report import read_report
from camctl.captures.request import CaptureRequest
from camctl.captures.sequencer import capture, resume
from camctl.controls import ExposureSetting, Layout
from camctl.errors import (
    CameraDisconnectedError,
    CameraTimeoutError,
    CaptureError,
    DataError,
    InterruptedCaptureError,
    StorageError,
)
from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.exposure.objective import xi
from camctl.response.desired import desired_response
from sim.camera import Faults

GIVEN = CaptureRequest("log", 1000.0, ratios=(1.0, 4.0, 16.0))
RESULTS = {"report.json", "frames", "sum.tiff", "image.tiff", "radiance.exr", "preview.png"}


def radiance(directory):
    with OpenEXR.File(str(directory / "radiance.exr"), separate_channels=True) as file:
        return {name: channel.pixels.copy() for name, channel in file.channels().items()}


@pytest.mark.parametrize(
    ("sensor", "layout"),
    [("standard", "mono"), ("standard", "rgb"), ("phone", "rggb"), ("machine-vision", "mono")],
)
def test_the_sum_is_that_of_the_frames_on_disk(make_camera, tmp_path, sensor, layout):
    with make_camera(sensor, layout=layout) as camera:
        report = capture(camera, GIVEN, tmp_path / "out")
    assert report.status == "complete"
    assert {path.name for path in (tmp_path / "out").iterdir()} == RESULTS
    saved = json.loads((tmp_path / "out" / "report.json").read_text())
    total = sum(
        np.minimum(np.load(tmp_path / "out" / frame["file"]), frame["white"]).astype(np.int64)
        for frame in saved["frames"]
    )
    assert np.array_equal(tifffile.imread(tmp_path / "out" / "sum.tiff"), total)
    assert saved["black_total"] == sum(frame["black"] for frame in saved["frames"])


def test_what_was_achieved_is_that_of_the_applied_exposures(make_camera, tmp_path):
    with make_camera(line_s=1e-3, time_minimum_s=1e-3) as camera:
        report = capture(camera, CaptureRequest("gamma", 1000.0, 3), tmp_path / "out")
        real = camera.controls.levels
    applied = [frame.applied_s for frame in report.frames]
    assert [frame.exposure for frame in report.frames] == [t / applied[0] for t in applied]
    effective = EffectiveCamera.of(real, [t / applied[0] for t in applied])
    desired = desired_response("gamma", 1000.0)
    assert report.achieved.xi == xi(effective, desired, 3 * real.M)
    assert report.achieved.effective_levels == effective_levels(effective, desired)
    assert report.achieved.levels_distinct == effective.levels_distinct


@pytest.mark.parametrize(("layout", "names"), [("mono", "Y"), ("rgb", "RGB"), ("rggb", "RGB")])
def test_radiance_is_the_scene_in_its_own_unit(make_camera, tmp_path, layout, names):
    # An even colour survives demosaicing, and an ideal sensor leaves rounding alone.
    light = np.full((40, 50, 3), 0.4, np.float32) * np.float32([1.0, 0.5, 0.8])
    light[0, 0] = 0
    mono = float(np.float32([0.2126, 0.7152, 0.0722]) @ light[5, 5])
    truth = [mono] if names == "Y" else light[5, 5]
    with make_camera("ideal-8", light=light, layout=layout) as camera:
        capture(camera, GIVEN, tmp_path / "out")
    channels = radiance(tmp_path / "out")
    for name, value in zip(names, truth, strict=True):
        assert channels[name].dtype == np.float32
        inside = channels[name][4:-4, 4:-4]
        assert np.allclose(inside, value, rtol=0.01)
        assert not channels["mask." + name][4:-4, 4:-4].any()


def test_what_lies_outside_the_levels_is_marked(make_camera, tmp_path):
    light = np.full((30, 30), 0.5, np.float32)
    light[:3], light[-3:] = 500.0, 1e-9
    with make_camera("ideal-8", light=light) as camera:
        request = CaptureRequest("log", 1000.0, ratios=(1.0, 2.0), base_s=0.002)
        report = capture(camera, request, tmp_path / "out")
    mask = radiance(tmp_path / "out")["mask.Y"]
    assert (mask[:3] == 2).all()
    assert (mask[-3:] == 1).all()
    assert (mask[3:-3] == 0).all()
    assert report.achieved.saturated_fraction == pytest.approx(0.1)
    assert report.achieved.dark_fraction == pytest.approx(0.1)


def test_image_is_the_desired_response(make_camera, tmp_path):
    with make_camera("ideal-12") as camera:
        capture(camera, CaptureRequest("log", 256.0, ratios=(1.0, 16.0)), tmp_path / "out")
    report = read_report(tmp_path / "out")
    image = tifffile.imread(tmp_path / "out" / "image.tiff")
    assert image.dtype == np.uint16
    E = radiance(tmp_path / "out")["Y"] * report.irradiance.full_scale_exposure
    expected = desired_response("log", 256.0).u(E) * 65535
    assert np.abs(image - expected).max() <= 1


@pytest.mark.parametrize("delay", range(6))
def test_no_frame_slot_is_wasted(make_camera, tmp_path, delay):
    with make_camera(delay_frames=delay) as camera:
        request = CaptureRequest("linear", 256.0, ratios=(1, 1.1, 1.2, 1.3, 1.4), base_s=0.01)
        report = capture(camera, request, tmp_path / "out")
    slots = 5 + delay
    assert report.timing["shooting_s"] / (slots * camera.sensor.frame_interval_s) <= 1.02


@pytest.mark.parametrize(
    ("faults", "kind"),
    [
        (Faults(unplug_after=2), CameraDisconnectedError),
        (Faults(freeze_after=2), CameraTimeoutError),
    ],
)
def test_a_camera_that_goes_leaves_its_frames_and_resume_completes(
    make_camera, tmp_path, faults, kind
):
    with make_camera(faults=faults) as camera, pytest.raises(kind) as failure:
        capture(camera, GIVEN, tmp_path / "out")
    assert f"2 of 3 frames are kept; go on with: camctl shoot --resume {tmp_path}" in str(
        failure.value
    )
    assert "\n" not in str(failure.value)
    kept = [np.load(tmp_path / "out" / "frames" / f"frame-0{k}.npy") for k in (1, 2)]
    assert read_report(tmp_path / "out").status == "incomplete"
    with make_camera(seed=1) as camera:
        report = resume(camera, tmp_path / "out")
    assert report.status == "complete"
    for k, before in enumerate(kept, start=1):
        assert np.array_equal(np.load(tmp_path / "out" / "frames" / f"frame-0{k}.npy"), before)
    total = sum(np.load(tmp_path / "out" / frame.file).astype(int) for frame in report.frames)
    assert np.array_equal(tifffile.imread(tmp_path / "out" / "sum.tiff"), total)


def test_a_cancelled_capture_keeps_what_was_shot(make_camera, tmp_path):
    asked = []

    def cancelled():
        asked.append(1)
        return len(asked) >= 2

    with make_camera() as camera, pytest.raises(InterruptedCaptureError) as failure:
        capture(camera, GIVEN, tmp_path / "out", cancelled=cancelled)
    assert failure.value.exit_status == 130
    assert len(list((tmp_path / "out" / "frames").iterdir())) == 2
    with make_camera() as camera:
        assert resume(camera, tmp_path / "out").status == "complete"


def test_control_c_keeps_what_was_shot(make_camera, tmp_path):
    def interrupt(progress):
        if progress.stage == "shooting" and progress.done >= 1:
            raise KeyboardInterrupt

    with make_camera() as camera, pytest.raises(InterruptedCaptureError, match="interrupted"):
        capture(camera, GIVEN, tmp_path / "out", progress=interrupt)
    assert (tmp_path / "out" / "frames" / "frame-01.npy").exists()


def test_a_frame_that_is_gone_is_shot_again(make_camera, tmp_path):
    with (
        make_camera(faults=Faults(unplug_after=2)) as camera,
        pytest.raises(CameraDisconnectedError),
    ):
        capture(camera, GIVEN, tmp_path / "out")
    (tmp_path / "out" / "frames" / "frame-01.npy").unlink()
    with make_camera() as camera:
        assert resume(camera, tmp_path / "out").status == "complete"


def test_a_damaged_frame_is_named(make_camera, tmp_path):
    with (
        make_camera(faults=Faults(unplug_after=2)) as camera,
        pytest.raises(CameraDisconnectedError),
    ):
        capture(camera, GIVEN, tmp_path / "out")
    (tmp_path / "out" / "frames" / "frame-01.npy").write_bytes(b"\x93NUMPY")
    with make_camera() as camera, pytest.raises(DataError, match=r"frame-01.npy cannot be read"):
        resume(camera, tmp_path / "out")


def test_resume_wants_the_same_camera_and_something_to_do(make_camera, tmp_path):
    with make_camera() as camera:
        capture(camera, GIVEN, tmp_path / "out")
        with pytest.raises(DataError, match="nothing is missing"):
            resume(camera, tmp_path / "out")
    with make_camera("phone") as camera, pytest.raises(DataError, match="connect the same camera"):
        resume(camera, tmp_path / "out")
    with make_camera() as camera, pytest.raises(DataError, match="holds no capture"):
        resume(camera, tmp_path / "nowhere")


def test_a_damaged_report_is_said_in_one_line(make_camera, tmp_path):
    with make_camera() as camera:
        capture(camera, GIVEN, tmp_path / "out")
    path = tmp_path / "out" / "report.json"
    path.write_text(path.read_text().replace('"white": 255', '"white": "snow"'))
    with pytest.raises(DataError, match="is damaged at frames") as failure:
        read_report(tmp_path / "out")
    assert "\n" not in str(failure.value)


@pytest.mark.parametrize("wrong", [0, 1, 2, 3])
def test_a_frame_of_the_wrong_exposure_is_shot_again(make_camera, tmp_path, wrong):
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 2.0, 4.0, 8.0))
    with make_camera() as camera:
        truth = capture(camera, request, tmp_path / "truth")
    with make_camera(faults=Faults(wrong_exposure={wrong: 0.5})) as camera:
        report = capture(camera, request, tmp_path / "out")
    assert report.warnings == truth.warnings
    assert report.frames[wrong].attempts == 2
    assert any(f"frame-0{wrong + 1}-rejected" in name for name in report.rejected)
    assert all((tmp_path / "out" / name).exists() for name in report.rejected)
    total = sum(np.load(tmp_path / "out" / frame.file).astype(int) for frame in report.frames)
    assert np.array_equal(tifffile.imread(tmp_path / "out" / "sum.tiff"), total)
    good, got = radiance(tmp_path / "truth")["Y"], radiance(tmp_path / "out")["Y"]
    assert np.median(np.abs(got / good - 1)) < 0.03


def test_a_frame_that_stays_wrong_is_marked(make_camera, tmp_path):
    request = CaptureRequest("log", 1000.0, ratios=(1.0, 2.0, 4.0))
    with make_camera(faults=Faults(wrong_exposure=dict.fromkeys((1, 3, 4, 5), 0.5))) as camera:
        report = capture(camera, request, tmp_path / "out")
    assert report.status == "complete"
    assert any("do not trust the picture" in warning for warning in report.warnings)


def test_an_existing_capture_is_never_replaced_unasked(make_camera, tmp_path):
    with make_camera() as camera:
        capture(camera, GIVEN, tmp_path / "out")
        before = (tmp_path / "out" / "sum.tiff").read_bytes()
        with pytest.raises(StorageError, match="replace this capture with --force"):
            capture(camera, CaptureRequest(ratios=(1.0,)), tmp_path / "out")
        assert (tmp_path / "out" / "sum.tiff").read_bytes() == before
        report = capture(camera, CaptureRequest(ratios=(1.0,)), tmp_path / "out", overwrite=True)
    assert len(report.frames) == len(list((tmp_path / "out" / "frames").iterdir())) == 1


def test_a_folder_of_somebody_else_is_never_touched(make_camera, tmp_path):
    (tmp_path / "diary.txt").write_text("mine")
    with make_camera() as camera, pytest.raises(StorageError, match="is not empty"):
        capture(camera, GIVEN, tmp_path, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["diary.txt"]


def test_the_plan_that_was_shown_is_the_one_that_is_shot(make_camera, tmp_path):
    with make_camera() as camera:
        plan = plan_capture(camera, GIVEN)
        report = capture(camera, GIVEN, tmp_path / "out", plan=plan)
    assert [frame.requested for frame in report.frames] == list(plan.settings)
    assert report.plan == plan


def test_too_many_levels_for_the_sum_are_refused_before_shooting(make_camera, tmp_path):
    with make_camera() as camera:
        plan = plan_capture(camera, GIVEN)
        setting = ExposureSetting(plan.base_s)
        many = type(plan)(**{**vars(plan), "settings": (setting,) * 20_000_000})
        with pytest.raises(Exception, match="does not fit in 32 bits"):
            capture(camera, GIVEN, tmp_path / "out", plan=many)
    assert not (tmp_path / "out").exists()


def test_a_camera_that_ends_early_is_found_out(make_camera, tmp_path):
    class Short:
        def __init__(self, camera):
            self.__dict__["camera"] = camera

        def __getattr__(self, name):
            return getattr(self.camera, name)

        def shoot(self, settings):
            return (frame for frame in [next(self.camera.shoot(settings))])

    with make_camera() as camera, pytest.raises(CaptureError, match="2 frames early"):
        capture(Short(camera), GIVEN, tmp_path / "out")


def test_layouts_of_the_report_are_words(make_camera, tmp_path):
    with make_camera("phone") as camera:
        report = capture(camera, GIVEN, tmp_path / "out")
    assert report.layout is Layout.RGGB
    assert json.loads((tmp_path / "out" / "report.json").read_text())["layout"] == "rggb"


def test_the_report_says_what_was_simulated_in_each_frame(make_camera, tmp_path):
    with make_camera("complete") as camera:
        report = capture(camera, GIVEN, tmp_path / "out")
    saved = json.loads((tmp_path / "out" / "report.json").read_text())
    for frame, record in zip(saved["frames"], report.frames, strict=True):
        plan = frame["details"]["simulation"]
        assert plan == record.details["simulation"]
        assert plan["joint_bound_dn"] <= plan["tolerance_dn"]
        assert {"name", "bound_dn", "ran", "why"} <= plan["effects"][0].keys()


def test_a_frame_in_another_format_is_on_disk_all_the_same(make_camera, tmp_path):
    class Shifting:
        def __init__(self, camera):
            self.camera = camera

        def __getattr__(self, name):
            return getattr(self.camera, name)

        def shoot(self, settings):
            return (replace(frame, white=200) for frame in self.camera.shoot(settings))

    with make_camera() as camera, pytest.raises(CaptureError, match="changed its black and white"):
        capture(Shifting(camera), GIVEN, tmp_path / "out")
    assert (tmp_path / "out" / "frames" / "frame-01.npy").exists()


@pytest.mark.parametrize("sensor", ["standard", "machine-vision"])
@pytest.mark.parametrize(("base_s", "said"), [(1e-5, "lens cap"), (60.0, "is white"), (0.02, None)])
def test_a_picture_that_shows_nothing_says_so(make_camera, tmp_path, sensor, base_s, said):
    with make_camera(sensor, time_minimum_s=1e-5, line_s=1e-5, time_maximum_s=120.0) as camera:
        request = CaptureRequest("log", 1000.0, ratios=(1.0, 1.0), base_s=base_s)
        report = capture(camera, request, tmp_path / "out")
    told = [line for line in report.warnings if "in every exposure" in line]
    assert len(told) == (said is not None)
    assert all(said in line for line in told)
