"""Each fault of the simulated hardware does what it says, and no capture hides it."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from camctl.captures.sequencer import capture
from camctl.errors import UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureSetting, resting_setting
from camctl.sim.backend import SimulatedOptions
from camctl.sim.camera import SimulatedCamera
from camctl.sim.faults import FAULT_FORMS, Faults
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor

TIMES = load_sensor("standard").times
SETTINGS = [ExposureSetting(TIMES.nearest(time_s)) for time_s in (0.005, 0.02, 0.04, 0.01)]


def taken(faults: Faults | None = None) -> list[Frame]:
    scene, sensor = load_scene("tile-floor", (48, 64)), load_sensor("standard")
    with SimulatedCamera(scene, sensor, faults=faults, seed=2) as camera:
        return list(camera.shoot(SETTINGS))


def same(one: Frame, other: Frame) -> bool:
    return bool(np.array_equal(one.pixels, other.pixels))


def test_a_dropped_frame_is_missing_from_the_stream_and_the_capture_still_right() -> None:
    scene, sensor = load_scene("tile-floor", (48, 64)), load_sensor("standard")
    with SimulatedCamera(scene, sensor, faults=Faults(dropped_frames=[1])) as camera:
        frames = list(camera.shoot(SETTINGS))
        assert camera.device.lost == 1
    assert [frame.applied for frame in frames] == SETTINGS
    means = [frame.pixels.mean() / frame.applied.time_s for frame in frames if frame.index != 2]
    assert max(means) < 1.15 * min(means)


@pytest.mark.parametrize("number", range(6))
def test_a_frame_is_dropped_while_the_stream_goes_to_rest(number: int) -> None:
    scene, sensor = load_scene("tile-floor", (48, 64)), load_sensor("standard")
    settings = [ExposureSetting(time_s) for time_s in (0.02, 0.2, 2.0)]
    assert resting_setting(SimulatedCamera(scene, sensor).controls, settings) is not None
    with SimulatedCamera(scene, sensor, faults=Faults(dropped_frames=[number])) as camera:
        frames = list(camera.shoot(settings))
    assert [frame.requested for frame in frames] == settings
    assert [frame.index for frame in frames] == [0, 1, 2]


def test_a_repeated_frame_has_the_pixels_of_the_frame_before() -> None:
    frames = taken(Faults(repeated_frames=[2]))
    assert same(frames[2], frames[1])
    assert frames[2].applied == SETTINGS[2]
    assert not same(frames[3], frames[2])


def test_a_corrupt_frame_is_right_in_its_upper_half_only() -> None:
    right, wrong = taken(), taken(Faults(corrupt_frames=[1]))
    assert np.array_equal(right[1].pixels[:24], wrong[1].pixels[:24])
    assert np.mean(right[1].pixels[24:] == wrong[1].pixels[24:]) < 0.1
    assert all(same(right[i], wrong[i]) for i in (0, 2, 3))


@pytest.mark.parametrize("kind", ["truncate", "shift", "double", "green", "jpeg"])
def test_a_damaged_frame_is_right_above_the_damage_only(kind: str) -> None:
    if kind == "jpeg":
        pytest.importorskip("cv2", reason="OpenCV is blocked")
    faults = SimulatedOptions.parse({"faults": f"{kind}@1"}).faults
    right, wrong = taken(), taken(faults)
    assert np.array_equal(right[1].pixels[:12], wrong[1].pixels[:12])
    assert not same(right[1], wrong[1])
    assert all(same(right[i], wrong[i]) for i in (0, 2, 3))


def test_a_late_frame_and_a_clock_that_jumps() -> None:
    right = taken()
    late = taken(Faults(delayed_frames={2: 5.0}))
    assert late[2].timestamp_s > right[2].timestamp_s + 4.5
    jumped = taken(Faults(clock_jumps={2: -100.0}))
    offsets = [a.timestamp_s - b.timestamp_s for a, b in zip(jumped, right, strict=True)]
    assert offsets == pytest.approx([0, 0, -100, -100])


def test_a_clamped_exposure_states_the_time_that_was_requested() -> None:
    right, clamped = taken(), taken(Faults(longest_exposure_s=0.01))
    assert [frame.applied for frame in clamped] == SETTINGS
    assert same(clamped[0], right[0])
    assert clamped[1].pixels.mean() == pytest.approx(right[1].pixels.mean() / 2, rel=0.1)


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("unplug@3", {"unplug_after": 3}),
        ("freeze@0,busy=2,delay=1", {"freeze_after": 0, "busy_calls": 2, "late_frames": 1}),
        ("drop@1,drop@4,repeat@2", {"dropped_frames": [1, 4], "repeated_frames": [2]}),
        ("wrong@1=0.5, wrong@2=2", {"wrong_exposure": {1: 0.5, 2: 2.0}}),
        ("late@1=0.25,jump@2=-3", {"delayed_frames": {1: 0.25}, "clock_jumps": {2: -3.0}}),
        ("clamp=0.1,longer=1e-4", {"longest_exposure_s": 0.1, "shutter_offset_s": 1e-4}),
        ("corrupt@0,jpeg@1", {"corrupt_frames": [0], "broken_jpegs": [1]}),
        (
            "shift@3,green@3,double@2",
            {"shifted_frames": [3], "green_frames": [3], "doubled_frames": [2]},
        ),
    ],
)
def test_text_and_json_give_the_same_faults(text: str, fields: dict[str, Any]) -> None:
    parsed = SimulatedOptions.parse({"faults": text}).faults
    assert parsed == SimulatedOptions.parse({"faults": json.loads(json.dumps(fields))}).faults


@pytest.mark.parametrize(
    "text", ["", "unplug", "unplug@", "unplug@x", "unplug@3=1", "wrong@1", "jump@1=nan", "bang@2"]
)
def test_an_invalid_fault_is_named_with_those_that_are_known(text: str) -> None:
    with pytest.raises(UsageError, match=f"invalid fault '{text}'; known are ") as caught:
        SimulatedOptions.parse({"faults": text})
    assert all(form in str(caught.value) for form in FAULT_FORMS)


@pytest.mark.parametrize("text", ["wrong@1=0", "wrong@1=-1", "clamp=0", "longer=-0.1"])
def test_exposures_of_faults_are_above_0(text: str) -> None:
    with pytest.raises(UsageError, match=r"expected (a number above 0|seconds)"):
        SimulatedOptions.parse({"faults": text})


@pytest.mark.parametrize("faults", [Faults(repeated_frames=[1]), Faults(longest_exposure_s=0.01)])
def test_a_capture_with_wrong_pixels_is_not_called_trustworthy(faults: Faults) -> None:
    scene, sensor = load_scene("tile-floor", (96, 128)), load_sensor("machine-vision")
    lasting = Faults(repeated_frames=list(range(1, 30))) if faults.repeated_frames else faults
    with SimulatedCamera(scene, sensor, faults=lasting) as camera:
        report = capture(camera, CaptureRequest(ratios=(1, 4, 16), count=3, base_s=0.005))
    assert not report.trustworthy
