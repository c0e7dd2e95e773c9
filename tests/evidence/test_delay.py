"""A control delay that is not the known one: recognised by the light of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import pytest
from sampling import some

import camctl
from camctl.captures.sequencer import capture
from camctl.evidence.delay import DelayError, ShotLog
from camctl.evidence.ratio_check import RatioCheck
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Frame, MeasuredDelay
from camctl.interface.controls import ExposureSetting
from camctl.records.report import CaptureReport
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.sim.streaming_device import Buffer
from camctl.streaming import Shot

#: Of a stream with 30 frames a second and a delay of two frames.
STREAM = replace(
    load_sensor("standard").controls((48, 64), is_coloured=False, photons_per_unit=1e4),
    delay_frames=2,
)
ADVICE = {"calibrate_delay": "sim"}


def check_of(expected: float, measured: float, compared: float = 0.5) -> RatioCheck:
    return RatioCheck(
        expected=expected,
        measured=measured,
        tolerance=0.03,
        agrees=abs(measured / expected - 1) < 0.03,
        moved=0.0,
        compared=compared,
    )


def found(
    times_s: Sequence[float], had: Sequence[float], compared: float = 0.5
) -> DelayError | None:
    """Return what the log of a capture in one sequence says of frames that had these exposures."""

    def compare(one: int, other: int, expected: float) -> RatioCheck:
        return check_of(expected, had[other] / had[one], compared)

    settings = [ExposureSetting(time_s) for time_s in times_s]
    log = ShotLog(settings, STREAM, compare, lambda shot: had[shot])
    log.begin(range(len(times_s)))
    return log.find()


def shot(sensor: str, count: int, late: int) -> CaptureReport:
    """Return a capture of a camera whose control delay is `late` frames more than the known one."""
    faults = Faults(late_frames=late)
    with camctl.open_camera("sim", sensor=sensor, size="160x120", faults=faults) as camera:
        request = CaptureRequest(ratios=tuple(2.0**k for k in range(count)), base_s=0.01)
        return capture(camera, request)


@pytest.mark.parametrize("light", [(1.4, 0.7, 1.1), (0.6, 1.35, 0.9), (1.0, 0.65, 1.3)])
def test_lamps_that_flicker_are_not_blamed_on_the_delay(light: tuple[float, ...]) -> None:
    times_s = (0.00069, 0.00276, 0.01104)
    assert (
        found(times_s, [time_s * each for time_s, each in zip(times_s, light, strict=True)]) is None
    )


def test_frames_without_noise_are_compared_exactly() -> None:
    """Such as those of a camera without a usual interval, which rests at its last setting."""
    controls = replace(STREAM, delay_frames=0, frame_interval_s=0.0)
    settings = [ExposureSetting(time_s) for time_s in (0.01, 0.04)]

    def compare(one: int, other: int, expected: float) -> RatioCheck:
        return check_of(expected, 4.0 ** (other - one)).model_copy(update={"tolerance": 0.0})

    log = ShotLog(settings, controls, compare, float)
    log.begin(range(2))
    assert log.find() is None


@pytest.mark.parametrize("late", [-2, -1, 1, 2, 3])
def test_error_of_the_delay_is_found(late: int) -> None:
    times_s = (0.01, 0.02, 0.05, 0.15, 0.6, 3.0, 7.0)
    rest_s = 1 / 60
    # The setting at rest is written after the last one; what was set before is not known.
    had = [
        0.037 if k < late else times_s[k - late] if k - late < len(times_s) else rest_s
        for k in range(len(times_s))
    ]
    error = found(times_s, had)
    assert error is not None
    assert error.is_certain
    assert error.shift == late
    assert found(times_s, times_s) is None


def test_few_frames_may_show_an_error_or_a_wrong_frame() -> None:
    error = found((0.01, 0.02, 0.05), (0.01, 0.02, 0.04))
    assert error is None or not error.is_certain
    assert found((0.01, 0.02, 0.05), (0.01, 0.01, 0.01), compared=0.01) is None


@pytest.mark.parametrize(
    ("fault", "count", "place"),
    [
        ("corrupt_frames", 2, 1),
        ("corrupt_frames", 3, 0),
        ("repeated_frames", 3, 1),
        ("repeated_frames", 4, 3),
    ],
)
def test_a_frame_that_was_sent_wrong_is_shot_again_first(
    fault: str, count: int, place: int
) -> None:
    faults = Faults(**{fault: [place]})  # type: ignore[arg-type]
    with camctl.open_camera("sim", sensor="standard", size="160x120", faults=faults) as camera:
        ratios = tuple(3.0**k for k in range(count))
        report = capture(camera, CaptureRequest(ratios=ratios, base_s=0.004))
    assert report.trustworthy
    assert not [each for each in report.findings if each.code.startswith("delay")]
    assert count == 2 or min(frame.attempts for frame in report.frames) == 1


def test_one_wrong_frame_is_not_an_error_of_the_delay() -> None:
    error = found((0.01, 0.02, 0.05, 0.15), (0.01, 0.01, 0.05, 0.15))
    assert error is None or not error.is_probable


@pytest.mark.parametrize("longest_s", [0.05, 0.2])
def test_a_camera_that_clamps_what_is_set_has_its_known_delay(longest_s: float) -> None:
    times_s = (0.01, 0.02, 0.05, 0.15, 0.6, 3.0)
    error = found(times_s, [min(time_s, longest_s) for time_s in times_s])
    assert error is None or not error.is_probable


@pytest.fixture
def keeps_its_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera cannot settle at each exposure."""
    monkeypatch.setattr("camctl.captures.sequence.use_delay", lambda *_: False)


class _TruthfulCamera(SimulatedCamera):
    """Says of each frame which exposure it has had."""

    def _frame(self, shot: Shot[Buffer], requested: ExposureSetting, *, light: float) -> Frame:
        frame = super()._frame(shot, requested, light=light)
        return replace(frame, details={"had": shot.data.exposed.exposure})


def with_delays(assumed: int, true: int, *, unknown: bool) -> SimulatedCamera:
    """Return a camera that relies on one control delay and has another one."""
    delays = {"delay_frames": assumed, "gain_delay_frames": None, "delay_jitter_frames": 0}
    sensor = load_sensor("standard").model_copy(update=delays)
    camera = _TruthfulCamera(
        load_scene("room", (120, 160)),
        sensor,
        faults=Faults(late_frames=true - assumed),
        is_unknown=unknown,
    )
    if unknown:
        camera.use_delay(MeasuredDelay(assumed, assumed))
    return camera


def every_delay(*shares: int) -> list[tuple[int, int, bool, tuple[float, ...]]]:
    """Return quarters of the cases: in each one of the four of each pair of delays."""
    return [
        (assumed, true, unknown, ratios)
        for assumed, true in product(range(-1, 6), repeat=2)
        for unknown in (False, True)
        for place, ratios in enumerate([(1.0, 2.0, 4.0), (1.0, 8.9, 88.0)])
        if (assumed + 2 * true + unknown + 2 * place) % 4 in shares
    ]


PROOF = (pytest.mark.slow, pytest.mark.proof)


@pytest.mark.parametrize(
    ("assumed", "true", "unknown", "ratios"),
    [
        *some(every_delay(0), every=8),
        *(pytest.param(*each, marks=PROOF) for each in every_delay(1, 2, 3)),
    ],
)
def test_frames_are_right_whatever_the_delay_is(
    assumed: int, true: int, unknown: bool, ratios: tuple[float, ...]
) -> None:
    """Of a long list most frames are saturated or dark; a black level is only assumed.

    A setting is written as a slot begins, which a delay of 0 frames has as one of -1 has it.
    """
    base_s = 0.01 if ratios[-1] < 10 else 0.002
    with with_delays(assumed, true, unknown=unknown) as camera:
        report = capture(camera, CaptureRequest(ratios=ratios, base_s=base_s))
    assert report.trustworthy
    had = [frame.details["had"] for frame in report.frames]
    assert had == pytest.approx([frame.applied.exposure for frame in report.frames])
    settled = [each for each in report.findings if each.code == "delay_settled"]
    assert len(settled) == (assumed != true and (assumed, true) != (-1, 0))
    assert {frame.attempts for frame in report.frames} == {1 + len(settled)}


@pytest.mark.parametrize(
    ("sensor", "late"),
    some(
        (
            (sensor, late)
            for sensor in ("standard", "webcam", "machine-vision")
            for late in (-3, -2, -1, 1, 2, 3)
            if load_sensor(sensor).delay_frames + late >= -1  # the frame that is being exposed
        ),
        every=8,
    ),
)
def test_stale_delay_is_settled_and_the_picture_finished(sensor: str, late: int) -> None:
    report = shot(sensor, 4, late)
    assert report.trustworthy
    (finding,) = [finding for finding in report.findings if finding.code == "delay_settled"]
    assert finding.value in (late, None)
    assert finding.remedies == ADVICE
    assert [frame.attempts for frame in report.frames] == [2] * 4
    ratios = [frame.ratio for frame in report.frames[1:]]
    assert all(each is None or each.agrees for each in ratios)


@pytest.mark.usefixtures("keeps_its_delay")
@pytest.mark.parametrize(
    ("sensor", "count", "late", "is_numbered"),
    some(
        [
            ("standard", 3, -1, False),
            ("standard", 3, 1, True),
            ("standard", 4, 2, True),
            ("standard", 3, 3, False),
            ("standard", 3, 4, False),
            ("standard", 4, -1, False),
            ("standard", 4, 3, True),
            ("webcam", 4, 4, False),  # all four had the exposure before the capture
        ],
        every=2,
    ),
)
def test_report_names_the_frames_late_only_where_no_other_number_fits(
    sensor: str, count: int, late: int, is_numbered: bool
) -> None:
    report = shot(sensor, count, late)
    assert not report.trustworthy
    assert ADVICE in [finding.remedies for finding in report.findings]
    values = [each.value for each in report.findings if each.code == "delay_contradicts"]
    assert set(values) <= {late, None}
    if is_numbered:
        assert values == [late]


@pytest.mark.usefixtures("keeps_its_delay")
@pytest.mark.parametrize(("count", "late"), some([(3, 3), (4, 4)], every=2))
def test_delay_that_varies_is_named_without_a_number(count: int, late: int) -> None:
    report = shot("consumer", count, late)
    assert not report.trustworthy
    (finding,) = [each for each in report.findings if each.code == "delay_contradicts"]
    assert finding.value is None
    assert finding.remedies == ADVICE


def test_camera_that_shoots_single_frames_has_no_control_delay() -> None:
    controls = replace(STREAM, delay_frames=None, timing=None)
    log = ShotLog([ExposureSetting(0.01)] * 2, controls, lambda *_: check_of(1, 2), float)
    log.begin(range(2))
    assert not log.has_delay
    assert log.find() is None
