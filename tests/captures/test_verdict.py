"""Whether frames contradict their exposures: wrong ones do; lamps and moving things do not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from sampling import some
from small_cameras import gradient, small_camera, sum_of_frames

import camctl
from camctl.captures import frame_checks
from camctl.captures.sequencer import capture
from camctl.captures.verdict import suspects
from camctl.errors import CameraBusyError
from camctl.evidence.damage import damaged_share
from camctl.evidence.ratio_check import RatioCheck
from camctl.exposure.goal import CaptureRequest
from camctl.findings import Finding
from camctl.records.report import CaptureReport
from camctl.sim.camera import Faults

MAINS = CaptureRequest("log", 4000.0, ratios=(1.0, 2.0, 4.0), mains_hz=50)
#: A bracket as it is computed for constant contrast, without the time to compute it.
WIDE = CaptureRequest("log", 1000.0, ratios=(1.0, 8.9, 88.0))


def check_of(
    expected: float, measured: float, *, agrees: bool, compared: float = 0.5
) -> RatioCheck:
    return RatioCheck(
        expected=expected,
        measured=measured,
        tolerance=0.03,
        agrees=agrees,
        moved=0.0,
        compared=compared,
    )


def differing(report: CaptureReport) -> list[Finding]:
    """Return where whole frames do not fit their exposures."""
    return [each for each in report.findings if each.code == "exposure_differs"]


def wrong_frame(sensor: str, position: int, factor: float, seed: int = 0) -> CaptureReport:
    """Return a capture in which a frame has a wrong exposure in both tries."""
    faults = Faults(wrong_exposure=dict.fromkeys((position, 3, 4, 5), factor))
    with small_camera(sensor, faults=faults, seed=seed) as camera:
        return capture(camera, MAINS)


@pytest.mark.parametrize(
    ("disagreeing", "expected"),
    [
        ([], []),
        ([1], [0, 1]),  # frames 0 and 1 disagree: either may be wrong
        ([1, 2], [1]),  # frame 1 disagrees with both neighbours
        ([2, 3], [2]),
        ([3], [2, 3]),
        ([1, 3], [0, 1, 2, 3]),
        ([1, 2, 3], [1, 2]),
    ],
)
def test_suspects_are_the_frames_that_disagree_with_their_neighbours(
    disagreeing: list[int], expected: list[int]
) -> None:
    checks = [None, *(check_of(2, 2, agrees=later not in disagreeing) for later in (1, 2, 3))]
    assert suspects(checks) == expected


@pytest.mark.parametrize("factor", some([0.1, 0.95, 1.05, 2], every=2, first=1))
@pytest.mark.parametrize(
    ("sensor", "position"), [("standard", 0), ("machine-vision", 2), ("phone", 1)]
)
def test_wrong_exposure_makes_a_capture_untrustworthy(
    sensor: str, position: int, factor: float
) -> None:
    report = wrong_frame(sensor, position, factor)
    assert not report.trustworthy
    assert report.untrustworthy_because is not None
    assert "frame" in report.untrustworthy_because


@pytest.mark.parametrize(("factor", "position"), [(0.98, 0), (1.02, 1), (0.98, 2)])
def test_two_percent_are_seen_where_noise_and_levels_allow(position: int, factor: float) -> None:
    assert not wrong_frame("ideal-12", position, factor).trustworthy


@pytest.mark.parametrize("factor", [0.99, 1.01])
@pytest.mark.parametrize(
    "sensor", some(["standard", "machine-vision", "ideal-12"], every=2, first=1)
)
def test_one_percent_is_within_the_tolerance(sensor: str, factor: float) -> None:
    assert wrong_frame(sensor, 1, factor).trustworthy


def test_untrustworthy_capture_has_all_its_files(tmp_path: Path) -> None:
    faults = Faults(wrong_exposure=dict.fromkeys((1, 3, 4, 5), 0.25))
    with small_camera(faults=faults) as camera:
        report = capture(camera, MAINS, tmp_path / "out")
    assert report.status == "complete"
    assert [frame.attempts for frame in report.frames] == [1, 2, 1]
    assert {path.name for path in (tmp_path / "out").iterdir()} >= set(report.files.values())
    assert (report.sum() == sum_of_frames(tmp_path / "out", report)).all()
    written = json.loads((tmp_path / "out" / "report.json").read_text())
    assert written["trustworthy"] is False
    assert "exposure is 2 times as long" in written["untrustworthy_because"]
    codes = [each["code"] for each in written["findings"]]
    assert codes.count("exposure_differs") == 2
    assert set(codes) <= {"exposure_differs", "light_below_range"}
    assert [each["frames"] for each in written["findings"] if each["frames"]] == [[0, 1], [1, 2]]


@pytest.mark.parametrize(
    ("scene", "sensor"),
    [
        ("night-street", "complete"),
        # Its drain keeps the streaks of the lamps short.
        pytest.param("night-street", "ccd", marks=pytest.mark.slow),
        # Light flows out of the bright steps into a tenth of the picture.
        pytest.param("grey-steps", "ccd", marks=pytest.mark.slow),
        ("outdoor-sun", "complete"),
        ("pwm-lamp", "quanta-1"),
        ("cloth", "quanta-3"),  # noise of two electrons in seven levels
    ],
)
def test_light_that_spreads_and_noise_are_no_wrong_exposure(scene: str, sensor: str) -> None:
    with camctl.open_camera("sim", scene=scene, sensor=sensor, size="160x120") as camera:
        report = capture(camera, WIDE)
    assert report.trustworthy
    assert not differing(report)
    assert [frame.attempts for frame in report.frames] == [1, 1, 1]


@pytest.mark.parametrize(
    "sensor",
    [
        *("standard", "phone", "complete", "security"),
        pytest.param("ccd", marks=pytest.mark.slow),
    ],
)
@pytest.mark.parametrize("ratios", some([((1.0, 8.9, 88.0),), ((1.0, 2.0, 6.2),)], every=2))
def test_moving_things_are_in_parts_of_the_picture(sensor: str, ratios: tuple[float, ...]) -> None:
    """Only the wheel moves: no sentence says that a frame as a whole is wrong."""
    request = CaptureRequest("log", 1000.0, ratios=ratios)
    with camctl.open_camera("sim", scene="moving-target", sensor=sensor, size="160x120") as camera:
        report = capture(camera, request)
    assert report.trustworthy
    assert not differing(report)
    assert [frame.attempts for frame in report.frames] == [1, 1, 1]


@pytest.mark.parametrize(
    ("sensor", "trusted"),
    [("standard", True), ("phone", False)],  # 3 % and 18 % between frames 1 and 2
)
def test_flicker_of_the_whole_picture_is_said_and_mended(sensor: str, trusted: bool) -> None:
    """Exposures of 2 to 7 periods of the lamps, of which they are on for a quarter."""
    request = CaptureRequest("log", 16.0, ratios=(1.0, 1.48, 3.91), base_s=0.0141)
    if sensor == "standard":
        request = replace(request, base_s=0.0283)

    def shot(request: CaptureRequest) -> CaptureReport:
        with camctl.open_camera("sim", scene="pwm-lamp", sensor=sensor, size="160x120") as camera:
            return capture(camera, request)

    report = shot(request)
    assert report.trustworthy == trusted
    found = differing(report)
    assert all(0.6 < (each.value or 0) < 1.6 for each in found)
    assert any("estimate_ratios" in each.remedies for each in found)
    mended = shot(replace(request, estimate_ratios=True))
    assert mended.trustworthy
    assert not differing(mended)


@pytest.mark.parametrize(
    ("scene", "sensor"),
    [
        *(("tile-floor", "standard"), ("ball", "ccd"), ("cloth", "ideal-6")),
        *(("colour-chart", "phone"), ("ramp", "ccd"), ("room", "ideal-6")),
    ],
)
def test_true_exposures_are_trusted(scene: str, sensor: str) -> None:
    with camctl.open_camera("sim", scene=scene, sensor=sensor, size="160x120") as camera:
        assert capture(camera, WIDE).trustworthy


@pytest.mark.parametrize(
    ("late", "ratios"),
    some(
        [
            (1, (1.0, 8.9, 88.0)),
            (2, (1.0, 2.0, 4.0)),
            (1, (1.0, 1.003, 2.985)),
            (2, (1.0, 1.003, 2.985)),
            (1, (1.0, 8.0)),
        ],
        every=2,
    ),
)
def test_wrong_control_delay_makes_a_capture_untrustworthy(
    late: int, ratios: tuple[float, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camctl.captures.sequence.use_delay", lambda *_: False)  # it cannot settle
    faults = Faults(late_frames=late)
    with camctl.open_camera("sim", sensor="phone", size="160x120", faults=faults) as camera:
        # Metering may end with an exposure so long that two late frames are white altogether.
        report = capture(camera, CaptureRequest(ratios=ratios, base_s=0.01))
    assert not report.trustworthy
    assert any(each.remedies.get("calibrate_delay") == "sim" for each in report.findings)


@pytest.mark.parametrize("late", [2, 3])
def test_wrong_control_delay_is_noticed_where_all_frames_are_white(late: int) -> None:
    def shot(faults: Faults) -> CaptureReport:
        with camctl.open_camera(
            "sim", scene="outdoor-sun", sensor="phone", size="160x120", faults=faults
        ) as camera:
            return capture(camera, CaptureRequest(ratios=(1.0, 1.003)))

    report = shot(Faults(late_frames=late))
    assert min(frame.saturated_fraction for frame in report.frames) > 0.9
    assert not report.trustworthy
    (found,) = [each for each in report.findings if each.code == "frame_white"]
    assert found.frames == (0,)
    assert any(each.remedies.get("calibrate_delay") == "sim" for each in report.findings)
    assert shot(Faults()).trustworthy


@pytest.mark.parametrize(
    ("scene", "sensor"), [("moving-target", "ideal-4"), ("night-street", "machine-vision")]
)
def test_lamps_and_moving_things_are_not_a_wrong_control_delay(scene: str, sensor: str) -> None:
    with camctl.open_camera("sim", scene=scene, sensor=sensor, size="160x120") as camera:
        assert capture(camera, WIDE).trustworthy


@pytest.mark.parametrize("seed", range(2))
def test_noise_near_saturation_does_not_contradict(seed: int) -> None:
    # At gain 15 noise saturates a part of each patch of the evenly lit sky.
    with camctl.open_camera(
        "sim", scene="stars", sensor="mobile", size="160x120", seed=seed
    ) as camera:
        report = capture(camera, CaptureRequest(ratios=(1.0, 8.9, 80.0), base_s=5.5))
    assert report.trustworthy
    assert not differing(report)


def damaged(*numbers: int) -> CaptureReport:
    """Return a capture of three frames in which those of these numbers are damaged."""
    with small_camera(
        "standard", gradient(120, 160), faults=Faults(corrupt_frames=numbers)
    ) as camera:
        return capture(camera, MAINS)


def test_a_frame_is_judged_once_until_it_or_one_beside_it_is_shot_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[int] = []

    def counted(*arguments: Any) -> float:
        calls.append(1)
        return damaged_share(*arguments)

    monkeypatch.setattr(frame_checks, "damaged_share", counted)
    assert damaged().trustworthy
    assert len(calls) == 3
    again = damaged(0)
    assert (again.frames[0].attempts, again.rejected) == (2, [])
    assert len(calls) == 3 + 3 + 2  # frames 0 and 1 once more


def test_a_frame_damaged_twice_makes_a_capture_untrustworthy() -> None:
    report = damaged(1, 3)
    (found,) = [each for each in report.findings if each.code == "frame_damaged"]
    assert found.frames == (1,)
    assert 0.4 < (found.value or 0.0) < 0.6
    assert not report.trustworthy


def test_what_can_be_compared_in_little_of_the_picture_is_shot_again() -> None:
    """A stale frame before a wide bracket: 7 % of the samples are in range in two frames."""
    faults = Faults(repeated_frames=(1,))
    with small_camera("standard", gradient(120, 160), faults=faults) as camera:
        report = capture(camera, CaptureRequest("log", 1000.0, ratios=(1.0, 30.0, 900.0)))
    assert [frame.attempts for frame in report.frames][1] == 2
    assert report.trustworthy


@pytest.mark.parametrize(("calls", "is_taken"), [(3, True), (30, False)])
def test_a_busy_camera_is_asked_again_for_a_while(calls: int, *, is_taken: bool) -> None:
    with small_camera("standard", faults=Faults(busy_calls=calls)) as camera:
        if is_taken:
            assert capture(camera, WIDE).trustworthy
        else:
            with pytest.raises(CameraBusyError):
                capture(camera, WIDE)
        assert camera.clock.now() > 0.5
