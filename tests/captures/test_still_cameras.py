"""Still cameras: a dial of third stops, no preview, files of their own, slow downloads."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from still_fakes import THIRDS, StillCamera, ramp

from camctl.camera import FrameStream
from camctl.captures.plan import plan_capture
from camctl.captures.request import CapturePlan, CaptureRequest
from camctl.captures.sequencer import capture, resume
from camctl.controls import Choices, ExposureSetting
from camctl.errors import CameraDisconnectedError, CaptureError, UsageError
from camctl.testing.conformance import CameraConformance

METERED = CaptureRequest(spend_shutter=True)


def asked(**changes: object) -> CaptureRequest:
    return CaptureRequest(**{**vars(METERED), **changes})


def planned(camera: StillCamera, request: CaptureRequest) -> tuple[CapturePlan | None, str]:
    try:
        return plan_capture(camera, request), ""
    except (CaptureError, UsageError) as error:
        return None, error.hint


class TestStillCameraConforms(CameraConformance):
    """The helper keeps the contract, or the tests below would prove nothing."""

    def open_camera(self) -> StillCamera:
        return StillCamera(ramp(2.0), response="linear", bits=12, black=100, with_gain=True)


def test_metering_needs_leave_to_actuate() -> None:
    with StillCamera(ramp()) as camera:
        with pytest.raises(UsageError, match=r"no preview.*--meter.*--base SECONDS"):
            plan_capture(camera, CaptureRequest())
        assert camera.actuations == 0
        assert plan_capture(camera, CaptureRequest(base_s=1 / 60)).metering is None
        assert camera.actuations == 0


@pytest.mark.parametrize("brightest", [1e-1, 1.0, 30.0, 1e3])
@pytest.mark.parametrize("kind", [("srgb", 8, 0), ("linear", 10, 64)])
def test_metering_costs_few_actuations_and_finds_the_highlights(
    brightest: float, kind: tuple[str, int, int]
) -> None:
    response, bits, black = kind
    with StillCamera(ramp(brightest), response=response, bits=bits, black=black) as camera:
        plan = plan_capture(camera, asked(count=2))
        assert plan.metering is not None
        assert camera.actuations == plan.metering.frames <= 5
    # The longest time on the dial that keeps the brightest light below white.
    longest = max(t for t in THIRDS.values if t * brightest < 1)
    assert longest / 2 <= plan.base_s <= longest


@given(
    response=st.sampled_from(["log", "linear", "gamma"]),
    dynamic_range=st.sampled_from([256.0, 1000.0, 16000.0]),
    count=st.integers(1, 3),
    brightest=st.floats(1e-2, 1e3),
    mains=st.sampled_from([None, 50.0, 60.0]),
    budget=st.sampled_from([None, 30.0]),
)
@settings(max_examples=40)
def test_every_plan_is_on_the_dial(
    response: str,
    dynamic_range: float,
    count: int,
    brightest: float,
    mains: float | None,
    budget: float | None,
) -> None:
    request = asked(
        response=response,
        dynamic_range=dynamic_range,
        count=count,
        mains_hz=mains,
        time_budget_s=budget,
    )
    with StillCamera(ramp(brightest), with_gain=True, with_aperture=True) as camera:
        plan, refusal = planned(camera, request)
        if plan is None:
            assert refusal  # it says what to do instead
            return
        for setting in plan.settings:
            camera.controls.check(setting)
            assert setting.f_number is None
        assert list(plan.exposures) == sorted(plan.exposures)
        assert len(plan.settings) == count
        assert sum(s.time_s for s in plan.settings) <= (budget or np.inf) * (1 + 1e-9)


def test_gain_takes_over_where_the_dial_ends() -> None:
    with StillCamera(ramp(0.2), with_gain=True) as camera:
        plan = plan_capture(camera, asked(dynamic_range=16000.0))
        assert plan.settings[-1].gain > 1
        assert plan.settings[0].gain == 1


def test_a_base_that_leaves_too_little_of_the_dial_is_said_with_the_way_out() -> None:
    with StillCamera(ramp(1e-2)) as camera:
        with pytest.raises(CaptureError, match=r"leaves fewer than 4.*--compensation -") as error:
            plan_capture(camera, asked(count=4))
        stops = float(error.value.hint.split()[-1])
        plan = plan_capture(camera, asked(count=4, compensation_stops=stops))
        assert plan.settings[-1].time_s == THIRDS.maximum


def test_a_base_beyond_the_dial_is_refused_as_on_any_camera() -> None:
    with (
        StillCamera(ramp()) as camera,
        pytest.raises(CaptureError, match=r"beyond the camera's .* nearest possible is 32 s"),
    ):
        plan_capture(camera, asked(base_s=100.0))


def test_more_exposures_than_the_dial_has_are_refused() -> None:
    with (
        StillCamera(ramp(), times=Choices((1 / 64, 1 / 8))) as camera,
        pytest.raises(UsageError, match="at most 2"),
    ):
        plan_capture(camera, asked(count=3))


def test_whole_periods_of_the_mains_where_the_dial_has_them() -> None:
    with StillCamera(ramp(2.0)) as camera:
        plan = plan_capture(camera, asked(mains_hz=50.0, dynamic_range=256.0))
    warned = [warning for warning in plan.warnings if "flicker" in warning]
    periods = [setting.time_s * 100 for setting in plan.settings]
    # Part of a period more or less matters as a share of the exposure.
    off = [count for count in periods if abs(count - round(count)) > 0.01 * count]
    assert len(warned) == len(off)


def test_a_capture_keeps_the_cameras_own_files(tmp_path: Path) -> None:
    with StillCamera(ramp(20.0), response="linear", bits=10, black=64) as camera:
        report = capture(camera, METERED, tmp_path / "here")
    assert report.status == "complete"
    total = 0
    for record in report.frames:
        assert record is not None
        assert record.original is not None
        original = tmp_path / "here" / record.original
        pixels = cv2.imread(str(original), cv2.IMREAD_UNCHANGED)
        assert np.array_equal(pixels, np.load(tmp_path / "here" / record.file))
        total = total + np.minimum(pixels, record.white).astype(np.int64)
    assert np.array_equal(tifffile.imread(tmp_path / "here" / "sum.tiff"), total)


@pytest.mark.parametrize("kind", [("srgb", 8, 0), ("linear", 10, 64)])
def test_the_picture_is_the_light(tmp_path: Path, kind: tuple[str, int, int]) -> None:
    import OpenEXR

    response, bits, black = kind
    light = ramp(20.0, 300.0)
    with StillCamera(light, response=response, bits=bits, black=black) as camera:
        report = capture(camera, asked(count=4), tmp_path / "here")
        assert camera.actuations == 4 + report.plan.metering.frames  # type: ignore[union-attr]
    with OpenEXR.File(str(tmp_path / "here" / "radiance.exr")) as file:
        seen = next(c for n, c in file.channels().items() if not n.startswith("mask")).pixels
    error = np.abs(np.median(seen / light) * light / seen - 1)
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.99) < 0.1
    assert all(record.ratio is None or record.ratio.agrees for record in report.frames if record)


def test_the_missing_frame_is_shot_after_the_camera_came_back(tmp_path: Path) -> None:
    class Unplugged(StillCamera):
        """Goes away in the middle of its third frame."""

        def shoot(self, settings: list[ExposureSetting]) -> FrameStream:
            frames = super().shoot(settings)
            if len(settings) < 3:
                return frames

            def cut() -> FrameStream:
                yield next(frames)
                yield next(frames)
                raise CameraDisconnectedError("the still camera went away", hint="plug it in")

            return cut()

    with (
        Unplugged(ramp(20.0)) as camera,
        pytest.raises(CameraDisconnectedError, match="2 of 3 frames are kept"),
    ):
        capture(camera, METERED, tmp_path / "here")
    with StillCamera(ramp(20.0)) as camera:
        report = resume(camera, tmp_path / "here")
        assert camera.actuations == 1
    assert report.status == "complete"
