"""How many frames pass from setting an exposure to the first frame that has it.

The camera looks at a steady scene.  Its exposure is stepped between a dark and a bright setting, up
and down, in shutter time and, where the camera has one, in gain.  The brightness of each frame
after a step shows whether it has the old or the new exposure, compared with the brightness of both
settings once they have settled.  A setting may even act on the frame that is being exposed: its
delay is -1.

What was measured is proved: settings in random order are shot with it, and each frame has to have
the brightness of its own.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.light import metered, too_bright
from camctl.calibration.timing import measure_stream_timing
from camctl.errors import CameraProtocolError, CaptureError, DataError, UsageError
from camctl.findings import Finding
from camctl.interface.camera import Camera, Frame, StreamingCamera, use_delay
from camctl.interface.controls import Control, ExposureSetting
from camctl.profiles.profile import DelayRecord
from camctl.system.number_text import time_text

TRIALS = 12
#: Exposure of the bright setting over the dark one: far apart, and both within the range
#: that a camera can show of one scene.
_STEP_RATIO = 4.0
#: Two settings with a smaller ratio of exposures are not used: their step might drown in noise.
_LEAST_STEP_RATIO = 1.5
#: A frame has an exposure if its brightness differs from the settled one by at most this share of
#: the step; what lies between the two bands is a mixture of both exposures.
_TOLERANCE = 0.15
#: Least step of brightness, as a share of the range between black and white: well above noise.
_LEAST_STEP = 0.02
#: The bright setting is the longest with at most this mean brightness, as a share of that range:
#: few samples are saturated then.
_BRIGHT = 0.6
#: Frames after a step that are looked at first, and at most, for cameras with a longer delay.
FIRST_FRAMES, MOST_FRAMES = 8, 64
#: Consecutive frames with the new exposure after which it counts as settled.
_SETTLED_AFTER = 2
#: Frames of which the settled brightness of a setting is the mean.
_SETTLED_FRAMES = 4
#: Frames before the first whose exposure had not begun that may have a setting, too.
_EARLY = 1
#: Settings of each series that proves a delay: by chance 2^-16 of those with another delay fit.
_PROOF = 16
#: Longest exposure, s, where the camera does not report its frame interval: 15 frames a second
#: are a usual lowest rate.
_LONGEST_S = 1 / 15


@dataclass(frozen=True)
class StepResponse:
    """The frames at which a step took effect.

    Attributes:
        first: the first frame whose brightness changed
        full: the first frame with the whole change
    """

    first: int
    full: int


@dataclass(frozen=True)
class InvalidStep:
    """A step from which no delay can be read, and why."""

    why: str


_Pair = tuple[ExposureSetting, ExposureSetting]


def find_step(
    light: Sequence[float], old: float, new: float, number: int = 0
) -> StepResponse | InvalidStep | None:
    """Return where a step took effect; None: not within these frames.

    A frame with a brightness between the two belongs to the change.  All frames after the first
    one with the new exposure must have it, too, and there must be two of these at least.

    Args:
        light: brightness of the frames after the step
        old: settled brightness before the step, in the same unit
        new: settled brightness after it
        number: of the first of these frames; -1: it was being exposed at the step
    """
    shares = [(each - old) / (new - old) for each in light]
    for index, share in enumerate(shares):
        if not -_TOLERANCE <= share <= 1 + _TOLERANCE:
            return InvalidStep(f"frame {index + number} has the brightness of neither exposure")
    first = next((i for i, share in enumerate(shares) if share > _TOLERANCE), len(shares))
    full = next((i for i, share in enumerate(shares) if share >= 1 - _TOLERANCE), len(shares))
    for index in range(first, len(shares)):
        is_partial = index > full and shares[index] < 1 - _TOLERANCE
        if shares[index] <= _TOLERANCE or is_partial:
            return InvalidStep(f"frame {index + number} returns to the earlier exposure")
    if full + _SETTLED_AFTER > len(shares):
        return None
    return StepResponse(first + number, full + number)


def measure_delay(
    camera: Camera,
    *,
    trials: int = TRIALS,
    progress: Callable[[float], None] | None = None,
    warn: Callable[[Finding], None] | None = None,
    seed: int = 0,
) -> DelayRecord:
    """Measure the delay of a camera's exposure controls in front of a steady scene.

    Args:
        camera: an open `camctl.StreamingCamera`
        trials: number of steps; a delay that rarely varies needs many
        progress: called with the share that is done, 0 to 1
        warn: called with each irregularity
        seed: of the order of the steps and the pauses between them

    Returns:
        The record for the camera's `mode`, with the timing of its stream.  A step with a frame
        that mixes both exposures takes effect at no single frame, so the delay is not constant.
        The camera uses this delay from then on, where it can (`camctl.interface.camera.use_delay`).

    Raises:
        UsageError: the camera does not stream, or has no two settings far enough apart; fewer than
            2 trials
        CaptureError: the scene is too dark, too bright, or not steady
        CameraProtocolError: an exposure does not take effect, the one before it returns, or the
            frames of a random series have not the exposures that follow from the delay
        CameraError: as `StreamingCamera.step` raises
    """
    if not isinstance(camera, StreamingCamera):
        raise UsageError("this camera does not stream", hint="a still camera has no control delay")
    if trials < 2:
        raise UsageError(f"invalid number of trials {trials}", hint="take at least 2")
    random = np.random.Generator(np.random.PCG64(seed))
    pairs = _pairs(camera)
    stepper = _Stepper(camera, pairs, max(2, trials // 4), warn or (lambda _: None))
    steps = [(pair, is_up) for pair in pairs for is_up in (True, False)]
    order = [steps[index % len(steps)] for index in range(trials)]
    random.shuffle(order)
    interval_s = camera.controls.frame_interval_s
    responses, names = [], []
    for number, (pair, is_up) in enumerate(order):
        if progress is not None:
            progress(number / trials)
        # Pauses of a random length, so that the trials are not in step with the frames.
        camera.clock.sleep_until(camera.clock.now() + interval_s * float(random.uniform(0, 3)))
        before, after = pair if is_up else pair[::-1]
        responses.append(stepper.response(before, after))
        names.append("gain" if before.time_s == after.time_s else "time")
    record = _record(responses, stepper.warn, names)
    if use_delay(camera, record.bounds):
        _prove(camera, record, stepper, pairs, random)
    return record.model_copy(update={"timing": measure_stream_timing(camera)})


def _prove(
    camera: StreamingCamera,
    record: DelayRecord,
    stepper: _Stepper,
    pairs: Sequence[_Pair],
    random: np.random.Generator,
) -> None:
    """Shoot settings in random order with a delay, and compare each frame with its own setting.

    Each pair has a series of its own, as the delays of time and gain may differ, and then all have
    one together.

    Raises:
        CameraProtocolError: a frame has not the brightness of its setting; the camera settles at
            each exposure from then on
    """
    together = [setting for pair in pairs for setting in pair]
    series = [list(pair) for pair in pairs] + ([together] if len(pairs) > 1 else [])
    for settings in series:
        places = np.resize(np.arange(len(settings)), _PROOF)
        random.shuffle(places)
        shot = [settings[place] for place in places]
        with closing(camera.shoot(shot)) as frames:
            light = [_brightness(frame) for frame in frames]
        for place, (setting, shown) in enumerate(zip(shot, light, strict=True)):
            if stepper.is_of(setting, shown):
                continue
            use_delay(camera, None)
            raise CameraProtocolError(
                f"a delay of {record.smallest} to {record.largest} frames was measured, but frame "
                f"{place} of a random series has not the exposure that follows from it",
                hint="keep scene and light steady, and measure again",
            )


def delay_of_frames(
    frames: Sequence[NDArray[Any]], exposures: Sequence[float], warn: Callable[[Finding], None]
) -> DelayRecord:
    """Return the delay that the frames of a stream show, without its timing.

    Each exposure must last until it has been effective for two frames at least: the brightness of
    the last frame before a change and of the last one before the next change are compared.

    Args:
        frames: consecutive frames of a steady scene
        exposures: for each frame the exposure that was last set when its exposure began
        warn: called with each irregularity

    Raises:
        UsageError: there are fewer than two changes of the exposure
        CaptureError: a change is hardly visible
        DataError: a change takes effect at no certain frame
    """
    starts = [k for k in range(1, len(exposures)) if exposures[k] != exposures[k - 1]]
    if len(starts) < 2:
        raise UsageError(
            f"{len(starts)} changes of the exposure show no delay",
            hint="give the frames of at least 2 changes, with several frames after each",
        )
    # Samples of 10 or 12 bits in 16 have another full scale: the brightest one is near to it.
    full = max(1, *(int(np.max(each)) for each in frames))
    light = [float(np.mean(each)) / full for each in frames]
    responses = []
    for start, end in zip(starts, [*starts[1:], len(frames)], strict=True):
        # The last frames before a change may have the new exposure already.
        begin = start - _EARLY if start - _EARLY > 0 else start
        until = end if end == len(frames) else end - _EARLY
        old, new = light[begin - 1], light[until - 1]
        if abs(new - old) < _LEAST_STEP:
            raise CaptureError(
                f"the brightness hardly changes from frame {start - 1} to frame {end - 1}",
                hint=f"set exposures a factor {_STEP_RATIO:g} apart that do not saturate",
            )
        found = find_step(light[begin:until], old, new)
        if not isinstance(found, StepResponse):
            why = "it is too late for" if found is None else f"{found.why} after"
            raise DataError(
                f"{why} the change at frame {start}",
                hint="keep scene and light steady, and let each exposure last more frames",
            )
        early = start - begin
        responses.append(StepResponse(found.first - early, found.full - early))
    return _record(responses, warn)


def _record(
    responses: Sequence[StepResponse],
    warn: Callable[[Finding], None],
    names: Sequence[str] = (),
) -> DelayRecord:
    """Return the record of steps; `names` says of each whether it was one of "time" or "gain"."""
    trials = len(responses)
    if mixed := sum(response.first < response.full for response in responses):
        warn(Finding(code="delay_irregular", value=mixed, details={"trials": trials}))
    smallest = min(response.first for response in responses)
    largest = max(response.full for response in responses)
    return DelayRecord(
        frames=smallest if smallest == largest else None,
        smallest=smallest,
        largest=largest,
        trials=trials,
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
        timing=None,
        **{
            name: (min(each.first for each in steps), max(each.full for each in steps))
            for name in ("time", "gain")
            if (steps := [r for r, of in zip(responses, names, strict=False) if of == name])
        },
    )


class _Stepper:
    """Steps the exposure of a camera and compares frames with the settled brightness.

    Args:
        camera: under test
        pairs: settings between which it steps
        repeats: invalid steps that are repeated, in all
        warn: called for each invalid step
    """

    def __init__(
        self,
        camera: StreamingCamera,
        pairs: Sequence[_Pair],
        repeats: int,
        warn: Callable[[Finding], None],
    ) -> None:
        self._camera, self._pairs, self._repeats = camera, pairs, repeats
        self.warn = warn
        self._invalid_steps = 0
        self._light = self._settled_light()

    def response(self, before: ExposureSetting, after: ExposureSetting) -> StepResponse:
        """Return where one step took effect."""
        frames = FIRST_FRAMES
        while True:
            shown = self._camera.step(before, after, frames, early=_EARLY)
            light = [_brightness(frame) for frame in shown]
            found = find_step(light, self._light[before], self._light[after], shown[0].index)
            if isinstance(found, StepResponse):
                return found
            if isinstance(found, InvalidStep):
                self._prepare_repeat(found)
            elif frames < MOST_FRAMES:
                frames = min(2 * frames, MOST_FRAMES)
            else:
                raise CameraProtocolError(
                    f"a new exposure did not take effect within {frames} frames",
                    hint="turn the camera's automatic exposure off, or try another format",
                    remedies={"option:format": None},
                )

    def is_of(self, setting: ExposureSetting, light: float) -> bool:
        """Return whether a brightness is the settled one of `setting`."""
        step = min(
            abs(self._light[bright] - self._light[dark])
            for dark, bright in self._pairs
            if setting in (dark, bright)
        )
        return abs(light - self._light[setting]) <= _TOLERANCE * step

    def _prepare_repeat(self, step: InvalidStep) -> None:
        self._invalid_steps += 1
        if self._invalid_steps > self._repeats:
            raise CameraProtocolError(
                f"{self._invalid_steps} steps were invalid, the last because {step.why}",
                hint="keep scene and light steady; turn the camera's automatic exposure off",
            )
        self.warn(Finding(code="delay_irregular", details={"why": step.why}))
        self._light = self._settled_light()

    def _settled_light(self) -> dict[ExposureSetting, float]:
        """Return the brightness of all settings; raise unless a step between them is visible."""
        light: dict[ExposureSetting, list[float]] = {}
        for setting in {setting: None for pair in self._pairs for setting in pair}:
            frames = self._camera.step(setting, setting, _SETTLED_FRAMES)
            light[setting] = [_brightness(frame) for frame in frames]
        for dark, bright in self._pairs:
            step = float(np.mean(light[bright]) - np.mean(light[dark]))
            if step < _LEAST_STEP:
                raise _invisible_step(float(np.mean(light[bright])), step, dark, bright)
            variation = max(np.ptp(light[dark]), np.ptp(light[bright]))
            if variation > _TOLERANCE * step:
                raise CaptureError(
                    f"the light is not steady: frames with one exposure differ by {variation:.1%} "
                    f"of full scale, and the step is {step:.1%}",
                    hint="point the camera at a steady scene under light that does not flicker",
                )
        return {setting: float(np.mean(values)) for setting, values in light.items()}


def _brightness(frame: Frame) -> float:
    """Return the mean brightness of a frame, from 0 at black to 1 at white."""
    return float(metered(frame).mean())


def _invisible_step(
    light: float, step: float, dark: ExposureSetting, bright: ExposureSetting
) -> CaptureError:
    """Return the error for two settings, the brighter one with brightness `light`."""
    if light > _BRIGHT:
        return too_bright(dark.time_s)
    return CaptureError(
        f"the scene is too dark: its brightness changes by {step:.1%} of full scale, up to "
        f"{light:.1%} at {time_text(bright.time_s)} with gain {bright.gain:.4g}, and "
        f"{_LEAST_STEP:.0%} are needed",
        hint="take the lens cap off, point the camera at something brighter, or state the "
        "brightness without light if it is not 0",
    )


def _pairs(camera: StreamingCamera) -> list[_Pair]:
    """Return (dark, bright) settings: a pair that differs in time, and one that differs in gain.

    Exposures are not longer than the frame interval: that would change the frame rate.
    """
    controls = camera.controls
    longest_s = max(
        controls.time_s.minimum,
        min(controls.time_s.maximum, controls.frame_interval_s or _LONGEST_S),
    )
    candidates = _candidates(camera, longest_s)
    # Bisect for the last one that is not too bright; brightness rises along the list.
    low, high = 0, len(candidates) - 1
    while low < high:
        middle = (low + high + 1) // 2
        (frame,) = camera.step(candidates[middle], candidates[middle], 1)
        if _brightness(frame) <= _BRIGHT:
            low = middle
        else:
            high = middle - 1
    bright = candidates[low]
    pairs = []
    darker_s = _at_most(controls.time_s, bright.time_s / _STEP_RATIO)
    if bright.time_s / darker_s >= _LEAST_STEP_RATIO:
        pairs.append((replace(bright, time_s=darker_s), bright))
    pairs += _gain_pair(camera, bright, longest_s)
    if not pairs:
        raise UsageError(
            "this camera has no two exposures far enough apart within a frame",
            hint="choose a lower frame rate",
        )
    return pairs


def _gain_pair(camera: StreamingCamera, bright: ExposureSetting, longest_s: float) -> list[_Pair]:
    """Return the pair that steps the gain up to about the exposure of `bright`, if possible."""
    gains, times = camera.controls.gain, camera.controls.time_s
    high = gains.nearest(min(gains.maximum, max(bright.gain, gains.minimum * _STEP_RATIO)))
    low = gains.nearest(high / _STEP_RATIO)
    time_s = _at_most(times, min(bright.time_s * bright.gain / high, longest_s))
    if high / low < _LEAST_STEP_RATIO:
        return []
    return [(ExposureSetting(time_s, low), ExposureSetting(time_s, high))]


def _at_most(control: Control, value: float) -> float:
    """Return the setting nearest to `value` and not above it; the smallest where there is none."""
    nearest = control.nearest(value)
    if nearest <= value:
        return nearest
    return next(iter(control.between(control.minimum, value, 1)), control.minimum)


def _candidates(camera: StreamingCamera, longest_s: float) -> list[ExposureSetting]:
    """Return settings a factor 2 apart or less, ascending: first in time, then in gain."""
    times, gains = camera.controls.time_s, camera.controls.gain
    gain = gains.nearest(1.0)
    start_s = min(times.minimum * _STEP_RATIO, longest_s)
    count = 1 + math.ceil(math.log2(longest_s / start_s))
    found = {_at_most(times, float(each)) for each in np.geomspace(start_s, longest_s, count)}
    by_time = [ExposureSetting(time_s, gain) for time_s in sorted(found)]
    count = 1 + math.ceil(math.log2(gains.maximum / gain))
    higher = {gains.nearest(float(each)) for each in np.geomspace(gain, gains.maximum, count)}
    return by_time + [ExposureSetting(by_time[-1].time_s, each) for each in sorted(higher - {gain})]
