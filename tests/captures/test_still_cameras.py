"""Still cameras: a list of third stops, no preview, files of their own, slow downloads."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st
from still_fakes import THIRDS, StillCamera, ramp

from camctl.captures.plan import plan_capture
from camctl.captures.sequencer import capture
from camctl.errors import CaptureError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Frame
from camctl.interface.controls import Choices, ExposureSetting
from camctl.records.capture_plan import CapturePlan
from camctl.testing.conformance import CameraConformance

METERED = CaptureRequest(spend_shutter=True)


def plan_or_hint(camera: StillCamera, request: CaptureRequest) -> tuple[CapturePlan | None, str]:
    try:
        return plan_capture(camera, request), ""
    except (CaptureError, UsageError) as error:
        return None, error.hint


class TestStillCamera(CameraConformance):
    """The fake camera conforms, or the tests below would prove nothing."""

    def open_camera(self) -> StillCamera:
        return StillCamera(ramp(8.0), response="linear", bits=12, black=100, with_gain=True)


@pytest.mark.parametrize(
    ("brightest", "kind"),
    [
        pytest.param(1e-1, ("srgb", 8, 0), marks=pytest.mark.slow),
        pytest.param(1.0, ("linear", 10, 64), marks=pytest.mark.slow),
        (30.0, ("srgb", 8, 0)),
        pytest.param(1e3, ("linear", 10, 64), marks=pytest.mark.slow),
    ],
)
def test_metering_costs_few_actuations_and_finds_the_highlights(
    brightest: float, kind: tuple[str, int, int]
) -> None:
    response, bits, black = kind
    with StillCamera(ramp(brightest), response=response, bits=bits, black=black) as camera:
        plan = plan_capture(camera, replace(METERED, count=2))
        assert plan.metering is not None
        assert camera.actuations == plan.metering.frames <= 5
    # The longest time on the list that keeps the brightest light below white.
    longest = max(t for t in THIRDS.values if t * brightest < 1)
    assert longest / 2 <= plan.base_s <= longest


@pytest.mark.slow
@given(
    response=st.sampled_from(["log", "linear", "gamma"]),
    dynamic_range=st.sampled_from([256.0, 1000.0, 16000.0]),
    count=st.integers(1, 3),
    brightest=st.floats(1e-2, 1e3),
    mains=st.sampled_from([None, 50.0, 60.0]),
    budget=st.sampled_from([None, 30.0]),
)
@settings(max_examples=10)
def test_every_plan_consists_of_settings_that_the_camera_has(
    response: str,
    dynamic_range: float,
    count: int,
    brightest: float,
    mains: float | None,
    budget: float | None,
) -> None:
    request = replace(
        METERED,
        response=response,
        dynamic_range=dynamic_range,
        count=count,
        mains_hz=mains,
        time_budget_s=budget,
    )
    with StillCamera(ramp(brightest), with_gain=True, with_aperture=True) as camera:
        plan, hint = plan_or_hint(camera, request)
        if plan is None:
            assert hint
            return
        for setting in plan.settings:
            camera.controls.check(setting)
            assert setting.f_number is None
        assert list(plan.exposures) == sorted(plan.exposures)
        assert len(plan.settings) == count
        assert sum(s.time_s for s in plan.settings) <= (budget or np.inf) * (1 + 1e-9)


@pytest.mark.slow
def test_metered_base_is_shortened_until_enough_exposures_follow() -> None:
    with StillCamera(ramp(1e-2)) as camera:
        plan = plan_capture(camera, replace(METERED, count=3))
        assert plan.settings[-1].time_s == THIRDS.maximum
        (shortened,) = [each for each in plan.findings if each.code == "base_shortened"]
        assert shortened.value == plan.base_s
        with pytest.raises(CaptureError, match="leaves fewer than 3 exposures") as error:
            plan_capture(camera, replace(METERED, count=3, base_s=32.0))
        base_s = error.value.remedies["base_s"]
        assert plan_capture(camera, replace(METERED, count=3, base_s=base_s)).base_s >= plan.base_s


def test_more_exposures_than_the_camera_has_are_refused() -> None:
    with (
        StillCamera(ramp(), times=Choices((1 / 64, 1 / 8))) as camera,
        pytest.raises(UsageError, match="at most 2"),
    ):
        plan_capture(camera, replace(METERED, count=3))


def test_capture_keeps_the_cameras_own_files(tmp_path: Path, cv2: Any) -> None:
    bracket = replace(METERED, ratios=(1.0, 8.0, 64.0))
    with StillCamera(ramp(20.0), response="linear", bits=10, black=64) as camera:
        report = capture(camera, bracket, tmp_path / "here")
    assert report.status == "complete"
    total = np.zeros((), np.int64)
    for record in report.frames:
        assert record.file is not None
        assert record.original is not None
        original = tmp_path / "here" / record.original
        pixels = cv2.imread(str(original), cv2.IMREAD_UNCHANGED)
        assert pixels is not None
        assert np.array_equal(pixels, np.load(tmp_path / "here" / record.file))
        total = total + np.minimum(pixels, record.white).astype(np.int64)
    assert np.array_equal(tifffile.imread(tmp_path / "here" / "sum.tiff"), total)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [("srgb", 8, 0), ("linear", 10, 64)])
def test_radiance_is_the_light_of_the_scene(tmp_path: Path, kind: tuple[str, int, int]) -> None:
    response, bits, black = kind
    light = ramp(20.0, 300.0)
    with StillCamera(light, response=response, bits=bits, black=black) as camera:
        report = capture(camera, replace(METERED, count=3), tmp_path / "here")
        assert report.plan.metering is not None
        assert camera.actuations == 3 + report.plan.metering.frames
    radiance = report.radiance()
    error = np.abs(np.median(radiance / light) * light / radiance - 1)
    assert np.median(error) < 0.01
    assert np.quantile(error, 0.99) < 0.1
    assert all(frame.ratio is None or frame.ratio.agrees for frame in report.frames)


class _TurnedCamera(StillCamera):
    """A camera that was held upright: its files state a turn."""

    details: ClassVar[dict[str, int]] = {"quarter_turns": 3}

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        for frame in super()._frames(settings):
            yield replace(frame, details=self.details)


class _MirroredCamera(_TurnedCamera):
    """A camera that shows people to themselves."""

    details: ClassVar[dict[str, int]] = {"quarter_turns": 3, "mirrored": True}


def test_pictures_of_a_turned_camera_are_upright_and_its_frames_are_not(
    tmp_path: Path, cv2: Any
) -> None:
    request = CaptureRequest(base_s=1 / 60, ratios=(1, 4))
    shown = {}
    kinds = (StillCamera, None), (_TurnedCamera, 6), (_MirroredCamera, 7)
    for kind, tag in kinds:
        name = kind.__name__
        with kind(ramp()) as camera:
            report = capture(camera, request, tmp_path / name)
            shown[name] = cv2.imread(str(tmp_path / name / "preview.png"), cv2.IMREAD_UNCHANGED)
        assert report.radiance().shape[:2] == (48, 64)
        for file in ("sum.tiff", "image.tiff"):
            with tifffile.TiffFile(tmp_path / name / file) as tiff:
                assert tiff.pages.first.shape[:2] == (48, 64)
                stated = tiff.pages.first.tags.get("Orientation")
                assert (None if stated is None else stated.value) == tag
    level = shown["StillCamera"]
    assert np.array_equal(shown["_TurnedCamera"], np.rot90(level, 3))
    assert np.array_equal(shown["_MirroredCamera"], np.rot90(level[:, ::-1], 3))
    picture = cv2.imread(str(tmp_path / "_TurnedCamera" / "picture.jpg"))
    assert picture.shape[:2] == (64, 48)
