"""All calibrations of a camera before one scene, in the order in which they need each other.

Control delay, response, true exposures, noise; where its lens can be covered, the dark signal; and
where the camera can be turned, the pattern of its pixels.  A response is estimated from stated
exposures; if these turn out to be wrong, both are measured again from the results so far, until
they agree.  If the frames agree less with the measured exposures than with the stated ones, these
are kept: a camera of few levels without noise does not show its exposures, and rounds would lead
further away.
The result of each step is kept in the camera's profile before the next one, which uses it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from camctl.calibration.delay import measure_delay
from camctl.calibration.exposures import measure_exposures
from camctl.calibration.light import LONGEST_S
from camctl.calibration.noise.dark import measure_dark
from camctl.calibration.noise.pattern import (
    View,
    sensitivity_pattern,
    shoot_view,
    view_settings,
)
from camctl.calibration.noise.shooting import measure_noise
from camctl.calibration.response.estimate import ResponseEstimate, estimate_response
from camctl.calibration.response.shooting import measure_response
from camctl.errors import CamctlError
from camctl.findings import Finding
from camctl.interface.camera import Camera, StreamingCamera
from camctl.interface.controls import ExposureSetting
from camctl.profiles.calibrated import EXPOSURES, RESPONSE
from camctl.profiles.exposures import ExposureRecord, exposure_mode
from camctl.profiles.noise import DarkRecord
from camctl.profiles.profile import Profile, change_profile, load_profile
from camctl.profiles.response import ResponseRecord


def _ignore(_finding: Finding) -> None:
    pass


@dataclass(frozen=True)
class StepOptions:
    """How the steps are done.

    Attributes:
        longest_s: longest shutter time, s
        begin: called with the name of each step; returns what is called with the share of it that
            is done, 0 to 1
        warn: called with each irregularity
        cover: asks for the lens to be covered, and returns whether it was; None: it cannot be
        turn: asks for another view of the scene through the uncovered lens, and returns whether the
            camera was turned; None: it cannot be
    """

    longest_s: float = LONGEST_S
    begin: Callable[[str], Callable[[float], None] | None] = lambda _name: None
    warn: Callable[[Finding], None] = _ignore
    cover: Callable[[], bool] | None = None
    turn: Callable[[], bool] | None = None


@dataclass(frozen=True)
class StepResult:
    """What one step has measured.

    Attributes:
        name: of the step
        result: what was measured, one line; None where it could not be
        problem: why it could not be measured; None where it was
        hint, remedies: what to do then, as in `camctl.CamctlError`
    """

    name: str
    result: str | None
    problem: str | None = None
    hint: str = ""
    remedies: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Found:
    """What a step has measured: the change of the profile, and one line for people."""

    keep: Callable[[Profile], None]
    text: str


Progress: TypeAlias = Callable[[float], None] | None
Measure: TypeAlias = Callable[[Camera, StepOptions, Progress], Found | None]


def delay_step(camera: Camera, options: StepOptions, progress: Progress) -> Found | None:
    """Measure the control delay of a camera that streams."""
    if not isinstance(camera, StreamingCamera):
        return None
    record = measure_delay(camera, progress=progress, warn=options.warn)
    mode = camera.mode
    if record.frames is None:
        text = f"{record.smallest} to {record.largest} frames, not constant"
    else:
        text = f"{record.frames} frame{'' if record.frames == 1 else 's'}"
    return Found(lambda profile: profile.delays.update({mode: record}), text)


def noise_step(camera: Camera, options: StepOptions, progress: Progress) -> Found:
    """Measure photon and read noise."""
    record = measure_noise(camera, longest_s=options.longest_s, progress=progress)
    for finding in record.findings:
        options.warn(finding)
    mode, measured = exposure_mode(camera.controls), record.reference
    conversion, read_noise = measured.conversion_e_per_dn, measured.read_noise_e
    text = (
        f"{conversion.value:.3g} electrons a level ({conversion.low:.3g} to "
        f"{conversion.high:.3g}), read noise {read_noise.value:.3g} electrons "
        f"({read_noise.low:.3g} to {read_noise.high:.3g}), gains measured: {len(record.gains)}"
    )
    return Found(lambda profile: profile.add_noise(mode, record), text)


class PatternSteps:
    """Measure how the sensitivity of the pixels differs, from two views of the scene.

    Between the two, the dark signal can be measured: it is then no part of the result.
    """

    def __init__(self) -> None:
        self._settings: list[ExposureSetting] = []
        self._first: View | None = None

    def first_view(self, camera: Camera, options: StepOptions, _progress: Progress) -> None:
        """Shoot the view before the camera is turned."""
        mode = exposure_mode(camera.controls)
        if options.turn is not None and mode in load_profile(camera.info).noises:
            self._settings = view_settings(camera, options.longest_s)
            self._first = shoot_view(camera, self._settings)

    def second_view(
        self, camera: Camera, options: StepOptions, _progress: Progress
    ) -> Found | None:
        """Ask for the camera to be turned, and compare both views; nothing without the first."""
        if self._first is None or options.turn is None or not options.turn():
            return None
        mode = exposure_mode(camera.controls)
        noise = load_profile(camera.info).noises[mode]
        prnu = sensitivity_pattern(self._first, shoot_view(camera, self._settings), noise)

        def keep(profile: Profile) -> None:
            profile.noises[mode] = profile.noises[mode].model_copy(update={"prnu": prnu})

        text = f"their sensitivity differs by {prnu.value:.2%} ({prnu.low:.2%} to {prnu.high:.2%})"
        return Found(keep, text)


def dark_step(camera: Camera, options: StepOptions, progress: Progress) -> Found | None:
    """Measure dark current, the pixels' offsets and hot pixels with the lens covered."""
    mode = exposure_mode(camera.controls)
    known = load_profile(camera.info).noises.get(mode)
    if options.cover is None or known is None or not options.cover():
        return None
    dark = measure_dark(camera, known, longest_s=options.longest_s, progress=progress)

    def keep(profile: Profile) -> None:
        profile.noises[mode] = profile.noises[mode].model_copy(update={"dark": dark})

    return Found(keep, dark_text(dark))


def dark_text(dark: DarkRecord) -> str:
    """Return the dark signal in words."""
    return (
        f"dark current {dark.dark_current_e_s.value:.3g} electrons/s, offsets of the pixels differ "
        f"by {dark.dsnu_e.value:.3g} electrons, hot pixels: {len(dark.hot_pixels)}"
    )


#: Response and exposures are measured in turn if the exposures differ by this from their labels,
#: until they change by less than the second number: each round about halves the errors that wrong
#: labels leave in both, and the irradiance of dark levels has ten times the errors of exposures.
_NOTABLE_CHANGE, _SETTLED, _MOST_ROUNDS = 0.005, 0.001, 5
#: Factor of the disagreement of the frames from which measured exposures are worse than stated.
_WORSE = 1.25

OpenCamera: TypeAlias = Callable[[str], AbstractContextManager[Camera]]
"""Opens the camera with these parts of its profile, as the option "profile" names them."""


def calibrate(open_camera: OpenCamera, options: StepOptions | None = None) -> Iterator[StepResult]:
    """Measure everything that can be measured before one scene; yield the result of each step.

    The scene and its light must be steady.  The camera is opened for each step, so that the step
    has what the earlier ones have measured.  A step that fails does not keep the others from
    running: what an earlier calibration has measured then stays.

    Raises:
        CameraError: the camera cannot be opened
        StorageError: a result cannot be kept
    """
    return _Calibration(open_camera, options or StepOptions()).results()


class _Calibration:
    """The steps of `calibrate`, and the true exposures so far."""

    def __init__(self, open_camera: OpenCamera, options: StepOptions) -> None:
        self._open_camera, self._options = open_camera, options
        self._exposures: ExposureRecord | None = None
        self._change = 0.0
        self._residual = math.inf
        self._first: ResponseRecord | None = None

    def results(self) -> Iterator[StepResult]:
        """Do all steps; yield the result of each."""
        yield from self._step("control delay", "none", delay_step)
        yield from self._step("response", "none", self._measure_response)
        yield from self._step("exposures", RESPONSE, self._measure_exposures)
        for number in range(2, _MOST_ROUNDS + 1):
            if self._change < (_NOTABLE_CHANGE if number == 2 else _SETTLED):
                break
            before, change = self._residual, self._change
            self._change = 0.0
            yield from self._step(f"response, round {number}", EXPOSURES, self._measure_response)
            if self._residual > _WORSE * before:
                yield from self._step("exposures", "none", self._withdraw_exposures)
                break
            yield from self._step(f"exposures, round {number}", RESPONSE, self._measure_exposures)
            if self._change > max(_NOTABLE_CHANGE, change):
                yield from self._step("exposures", "none", self._withdraw_exposures)
                break
        yield from self._step("noise", f"{EXPOSURES},{RESPONSE}", noise_step)
        pattern, parts = PatternSteps(), f"{EXPOSURES},{RESPONSE}"
        yield from self._step("first view of the pixels", parts, pattern.first_view)
        yield from self._step("dark signal", "none", dark_step)
        yield from self._step("pixels", parts, pattern.second_view)

    def _step(self, name: str, parts: str, measure: Measure) -> Iterator[StepResult]:
        """Do one step with these parts of the profile; yield its result if it has one."""
        with self._open_camera(parts) as camera:
            info = camera.info
            try:
                found = measure(camera, self._options, self._options.begin(name))
            except CamctlError as error:
                yield StepResult(name, None, error.what, error.hint, error.remedies)
                return
        if found is not None:
            change_profile(info, found.keep)
            yield StepResult(name, found.text)

    def _measure_response(self, camera: Camera, options: StepOptions, progress: Progress) -> Found:
        series = measure_response(camera, longest_s=options.longest_s, progress=progress)
        estimate = estimate_response(series)
        for finding in estimate.findings:
            options.warn(finding)
        self._residual = estimate.residual
        self._first = self._first or estimate.record
        return _response_found(camera, estimate)

    def _withdraw_exposures(
        self, camera: Camera, _options: StepOptions, _progress: Progress
    ) -> Found:
        """Return to the stated exposures and to the response that they gave."""
        mode, response = exposure_mode(camera.controls), self._first
        self._exposures = None

        def keep(profile: Profile) -> None:
            profile.exposures.pop(mode, None)
            if response is not None:
                profile.responses[mode] = response

        return Found(
            keep,
            "as stated, with the response of the first round: measured ones do not settle, since "
            "the camera has too few levels or too little noise, or light and charge spill over",
        )

    def _measure_exposures(self, camera: Camera, options: StepOptions, progress: Progress) -> Found:
        record = measure_exposures(
            camera, longest_s=options.longest_s, progress=progress, warn=options.warn
        )
        mode = exposure_mode(camera.controls)
        wrong = max(abs(each.factor - 1) for each in (*record.times, *record.gains))
        self._change, self._exposures = _change(self._exposures, record), record
        text = (
            f"{_count(len(record.times), 'time')} and {_count(len(record.gains), 'gain')}, up to "
            f"{wrong:.2%} from the stated exposures"
        )
        return Found(lambda profile: profile.exposures.update({mode: record}), text)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _change(before: ExposureRecord | None, now: ExposureRecord) -> float:
    """Return by how much the ratios of two exposures differ at most; from 1 where none are known.

    The error of a wrong response is in them: a camera whose shutter is exact has some, too.
    """
    known = {each.value: each.factor for each in before.times} if before else {}
    logs = [
        math.log(each.factor / known.get(each.value, 1.0))
        for each in now.times
        if before is None or each.value in known
    ]
    return max(logs, default=0.0) - min(logs, default=0.0)


def _response_found(camera: Camera, estimate: ResponseEstimate) -> Found:
    record, mode = estimate.record, exposure_mode(camera.controls)
    low = max(channel.measured[0] for channel in record.channels)
    high = min(channel.measured[1] for channel in record.channels)
    channels = ", ".join(channel.name for channel in record.channels)
    text = (
        f"channels {channels} from {low:.1%} to {high:.1%} of full scale, {record.frames} frames "
        f"agree within {estimate.residual:.2%}"
    )
    return Found(lambda profile: profile.responses.update({mode: record}), text)
