"""A control delay that is not the known one: recognised by the light of the frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest
from sampling import some

import camctl
from camctl.captures.sequencer import capture
from camctl.evidence.delay import DelayError, ShotLog
from camctl.evidence.ratio_check import RatioCheck
from camctl.exposure.goal import CaptureRequest
from camctl.interface.controls import ExposureSetting
from camctl.records.report import CaptureReport
from camctl.sim.camera import Faults
from camctl.sim.sensors.sensor import load_sensor

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


def log_of(times_s: Sequence[float]) -> ShotLog:
    """Return the log of a capture whose frames were shot in one sequence."""
    log = ShotLog([ExposureSetting(time_s) for time_s in times_s], STREAM)
    log.begin(range(len(times_s)))
    return log


def shot(sensor: str, count: int, late: int) -> CaptureReport:
    """Return a capture of a camera whose control delay is `late` frames more than the known one."""
    faults = Faults(late_frames=late)
    with camctl.open_camera("sim", sensor=sensor, size="160x120", faults=faults) as camera:
        request = CaptureRequest(ratios=tuple(2.0**k for k in range(count)), base_s=0.01)
        return capture(camera, request)


@pytest.mark.parametrize("late", [-2, -1, 1, 2, 3])
def test_error_of_the_delay_is_found(late: int) -> None:
    times_s = (0.01, 0.02, 0.05, 0.15, 0.6, 3.0, 7.0)
    rest_s = 1 / 60
    # The setting at rest is written after the last one; what was set before is not known.
    had = [
        0.037 if k < late else times_s[k - late] if k - late < len(times_s) else rest_s
        for k in range(len(times_s))
    ]
    checks = [
        check_of(times_s[k] / times_s[k - 1], had[k] / had[k - 1]) for k in range(1, len(times_s))
    ]
    assert log_of(times_s).find([None, *checks]) == DelayError(late)
    true = [check_of(check.expected, check.expected) for check in checks]
    assert log_of(times_s).find([None, *true]) is None


def test_few_frames_show_an_error_but_not_how_many_frames() -> None:
    times_s = (0.01, 0.02, 0.05)
    for compared, error in ((0.5, DelayError()), (0.01, None)):
        checks = [None, None, check_of(2.5, 2, compared)]
        assert log_of(times_s).find(checks) == error


def test_one_wrong_frame_is_not_an_error_of_the_delay() -> None:
    checks = [None, check_of(2, 1), check_of(2.5, 5), check_of(3, 3)]
    assert log_of((0.01, 0.02, 0.05, 0.15)).find(checks) is None


@pytest.fixture
def keeps_its_delay(monkeypatch: pytest.MonkeyPatch) -> None:
    """The camera cannot settle at each exposure."""
    monkeypatch.setattr("camctl.captures.sequence.use_delay", lambda *_: False)


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
    (found,) = [finding for finding in report.findings if finding.code == "delay_settled"]
    assert found.value in (late, None)
    assert found.remedies == ADVICE
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
            ("standard", 3, 2, True),
            ("standard", 3, 3, False),
            ("standard", 3, 4, False),
            ("standard", 4, -1, False),
            ("standard", 4, 3, True),
            ("webcam", 4, 4, True),
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
    found = [finding.value for finding in report.findings if finding.code == "delay_contradicts"]
    assert set(found) <= {late, None}
    if is_numbered:
        assert found == [late]


@pytest.mark.usefixtures("keeps_its_delay")
@pytest.mark.parametrize(("count", "late"), some([(3, 3), (4, 4)], every=2))
def test_delay_that_varies_is_named_without_a_number(count: int, late: int) -> None:
    report = shot("consumer", count, late)
    assert not report.trustworthy
    (found,) = [each for each in report.findings if each.code == "delay_contradicts"]
    assert found.value is None
    assert found.remedies == ADVICE


def test_camera_that_shoots_single_frames_has_no_control_delay() -> None:
    settings = [ExposureSetting(time_s) for time_s in (0.01, 0.02, 0.05)]
    log = ShotLog(settings, replace(STREAM, delay_frames=None, timing=None))
    log.begin(range(3))
    assert not log.has_delay
    assert log.find([None, check_of(2, 1), check_of(2.5, 2)]) is None
