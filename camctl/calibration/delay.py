"""How many frames pass from setting an exposure to the frame that has it.

The camera looks at a steady scene; its exposure is stepped between a dark and a bright setting, up
and down, in shutter time and, where it has one, in gain.  Each frame after a step is told to be old
or new by its light, relative to what the two settings give when they are settled.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime

import numpy as np

from camctl.camera import Camera, Frame, StreamingCamera
from camctl.controls import Control, ExposureSetting
from camctl.errors import CameraProtocolError, CaptureError, UsageError
from camctl.profile import DelayRecord

TRIALS = 12
#: Bright over dark setting: far apart, and both within what a camera can show of one scene.
RATIO = 4.0
#: A pair that lies nearer together than this is no step.
LEAST_RATIO = 1.5
#: Distance from a settled level, as a share of the step, up to which a frame has that level.
NEAR = 0.15
#: Least step that can be seen, as a share of the levels between black and white.
LEAST_STEP = 0.02
#: The bright setting is the longest whose mean brightness lies below this share of the levels.
AIM = 0.6
#: Frames looked at after a step, and the most where the new exposure takes longer to show up.
FRAMES, MOST_FRAMES = 8, 64
#: A new exposure counts as settled when so many frames in a row have it.
TAIL = 2
_SETTLED = 4
_SAMPLES = 1 << 16
_LONGEST_S = 1 / 15


@dataclass(frozen=True)
class Landing:
    """Where a step showed up: the first frame that changed, and the first that has it in full."""

    first: int
    full: int


@dataclass(frozen=True)
class Spoiled:
    """Why a step tells nothing."""

    why: str


def read_step(light: Sequence[float], old: float, new: float) -> Landing | Spoiled | None:
    """Return where a step landed by the light of its frames; None: not within these frames.

    `old` and `new` are the settled levels, in the unit of `light`.  A frame between the two is part
    of the change; all frames after the first that has the new exposure must have it, `TAIL` at
    least.
    """
    shares = [(each - old) / (new - old) for each in light]
    for index, share in enumerate(shares):
        if not -NEAR <= share <= 1 + NEAR:
            return Spoiled(f"frame {index} has the light of neither exposure")
    first = next((i for i, share in enumerate(shares) if share > NEAR), len(shares))
    full = next((i for i, share in enumerate(shares) if share >= 1 - NEAR), len(shares))
    for index in range(first, len(shares)):
        if shares[index] <= NEAR or (index > full and shares[index] < 1 - NEAR):
            return Spoiled(f"frame {index} goes back to the earlier exposure")
    return Landing(first, full) if full + TAIL <= len(shares) else None


def measure_delay(
    camera: Camera,
    *,
    trials: int = TRIALS,
    progress: Callable[[float], None] | None = None,
    tell: Callable[[str], None] | None = None,
    seed: int = 0,
) -> DelayRecord:
    """Measure the delay of a camera's exposure controls before a steady scene.

    Args:
        camera: an open `camctl.camera.StreamingCamera`
        trials: how many steps to look at; a delay that varies now and then wants many
        progress: told the share that is done, 0 to 1
        tell: told in one line each what was odd
        seed: of the order of the steps and the pauses between them

    Returns:
        The record for the camera's `mode`.  A step that some frame shows in part (exposures of two
        settings mixed) lands nowhere exactly, and makes the delay not constant.

    Raises:
        UsageError: the camera has no stream, or no two settings far enough apart; `trials` < 2
        CaptureError: the scene is too dark, too bright, or not steady
        CameraProtocolError: an exposure does not show up, or goes back to the one before
        CameraError: as `step` does

    """
    if not isinstance(camera, StreamingCamera):
        raise UsageError("this camera has no stream", hint="a still camera needs no delay")
    if trials < 2:
        raise UsageError(f"{trials} trials", hint="take at least 2")
    random = np.random.Generator(np.random.PCG64(seed))
    pairs = _pairs(camera)
    stepper = _Stepper(camera, pairs, max(2, trials // 4), tell or (lambda _: None))
    steps = [(pair, is_up) for pair in pairs for is_up in (True, False)]
    order = [steps[index % len(steps)] for index in range(trials)]
    random.shuffle(order)
    interval_s = camera.controls.frame_interval_s
    landings = []
    for number, (pair, is_up) in enumerate(order):
        if progress is not None:
            progress(number / trials)
        # A pause of no whole number of frames: no trial keeps time with the one before.
        camera.clock.sleep_until(camera.clock.now() + interval_s * float(random.uniform(0, 3)))
        before, after = pair if is_up else pair[::-1]
        landings.append(stepper.land(before, after))
    mixed = sum(landing.first < landing.full for landing in landings)
    if mixed:
        stepper.tell(
            f"{mixed} of {trials} steps show a frame between the two exposures: the camera mixes "
            "exposures while it changes them"
        )
    smallest = min(landing.first for landing in landings)
    largest = max(landing.full for landing in landings)
    return DelayRecord(
        frames=smallest if smallest == largest else None,
        smallest=smallest,
        largest=largest,
        trials=trials,
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


_Pair = tuple[ExposureSetting, ExposureSetting]


class _Stepper:
    """Steps the exposure of one camera, and knows what its settings look like when settled.

    Steps that tell nothing are taken again, `allowed` times in all.
    """

    def __init__(
        self,
        camera: StreamingCamera,
        pairs: Sequence[_Pair],
        allowed: int,
        tell: Callable[[str], None],
    ) -> None:
        self._camera, self._pairs, self._allowed = camera, pairs, allowed
        self.tell = tell
        self._spoiled = 0
        self._level = self._settled()

    def land(self, before: ExposureSetting, after: ExposureSetting) -> Landing:
        """Return where one step landed."""
        frames = FRAMES
        while True:
            shown = self._camera.step(before, after, frames)
            light = [brightness(self._camera, frame) for frame in shown]
            found = read_step(light, self._level[before], self._level[after])
            if isinstance(found, Landing):
                return found
            if isinstance(found, Spoiled):
                self._spoil(found)
            elif frames < MOST_FRAMES:
                frames = min(2 * frames, MOST_FRAMES)
            else:
                raise CameraProtocolError(
                    f"a new exposure did not show up within {frames} frames",
                    hint="turn the camera's automatic exposure off, or try another format "
                    "(-O format=...)",
                )

    def _spoil(self, found: Spoiled) -> None:
        self._spoiled += 1
        if self._spoiled > self._allowed:
            raise CameraProtocolError(
                f"{self._spoiled} steps tell nothing, the last because {found.why}",
                hint="keep scene and light still; turn the camera's automatic exposure off",
            )
        self.tell(f"a step is taken again: {found.why}")
        self._level = self._settled()

    def _settled(self) -> dict[ExposureSetting, float]:
        """Return the light of all settings, once steps between them can be seen."""
        levels: dict[ExposureSetting, list[float]] = {}
        for setting in {setting: None for pair in self._pairs for setting in pair}:
            frames = self._camera.step(setting, setting, _SETTLED)
            levels[setting] = [brightness(self._camera, frame) for frame in frames]
        for dark, bright in self._pairs:
            step = float(np.mean(levels[bright]) - np.mean(levels[dark]))
            if step < LEAST_STEP:
                raise _unseen(float(np.mean(levels[bright])), dark, bright)
            unrest = max(np.ptp(levels[dark]), np.ptp(levels[bright]))
            if unrest > NEAR * step:
                raise CaptureError(
                    f"the light is not steady: frames of one exposure differ by {unrest:.1%} of "
                    f"full scale, where the step is {step:.1%}",
                    hint="point the camera at a steady scene under light that does not flicker",
                )
        return {setting: float(np.mean(seen)) for setting, seen in levels.items()}


def brightness(camera: Camera, frame: Frame) -> float:
    """Return the mean brightness of a frame as a share of its levels, 0 black to 1 white."""
    rows, columns = frame.pixels.shape[:2]
    step = max(1, math.isqrt(rows * columns // _SAMPLES))
    samples = np.clip(frame.pixels[::step, ::step].astype(np.float64), frame.black, frame.white)
    return float((samples.mean() - frame.black) / (frame.white - frame.black))


def _unseen(bright_level: float, dark: ExposureSetting, bright: ExposureSetting) -> CaptureError:
    """Return the error for a pair of settings that look alike."""
    if bright_level > 0.5:
        return CaptureError(
            f"the scene is too bright: all is white even at {dark.time_s:.4g} s",
            hint="close the aperture, or put a filter before the lens",
        )
    return CaptureError(
        f"the scene is too dark: nothing to see at {bright.time_s:.4g} s, gain {bright.gain:.4g}",
        hint="take the lens cap off, or point the camera at something brighter",
    )


def _pairs(camera: StreamingCamera) -> list[_Pair]:
    """Return (dark, bright) settings, one pair that differs in time and one in gain.

    Exposures stay within the frame interval: longer ones would stretch the very frames that are
    counted.
    """
    controls = camera.controls
    longest_s = max(
        controls.time_s.minimum,
        min(controls.time_s.maximum, controls.frame_interval_s or _LONGEST_S),
    )
    ladder = _ladder(camera, longest_s)
    low, high = 0, len(ladder) - 1
    while low < high:  # the last that is not too bright; brightness rises along the ladder
        middle = (low + high + 1) // 2
        (frame,) = camera.step(ladder[middle], ladder[middle], 1)
        if brightness(camera, frame) <= AIM:
            low = middle
        else:
            high = middle - 1
    bright = ladder[low]
    pairs = []
    darker_s = _at_most(controls.time_s, bright.time_s / RATIO)
    if bright.time_s / darker_s >= LEAST_RATIO:
        pairs.append((replace(bright, time_s=darker_s), bright))
    pairs += _gain_pair(camera, bright, longest_s)
    if not pairs:
        raise UsageError(
            "this camera has no two exposures apart within a frame",
            hint="choose a lower frame rate",
        )
    return pairs


def _gain_pair(camera: StreamingCamera, bright: ExposureSetting, longest_s: float) -> list[_Pair]:
    """Return the pair that steps the gain to about the light of `bright`, if there is one."""
    gains, times = camera.controls.gain, camera.controls.time_s
    high = gains.nearest(min(gains.maximum, max(bright.gain, gains.minimum * RATIO)))
    low = gains.nearest(high / RATIO)
    time_s = _at_most(times, min(bright.time_s * bright.gain / high, longest_s))
    if high / low < LEAST_RATIO:
        return []
    return [(ExposureSetting(time_s, low), ExposureSetting(time_s, high))]


def _at_most(control: Control, value: float) -> float:
    """Return the setting nearest to `value` and not above it, where there is one."""
    nearest = control.nearest(value)
    if nearest <= value:
        return nearest
    return next(iter(control.between(control.minimum, value, 1)), control.minimum)


def _ladder(camera: StreamingCamera, longest_s: float) -> list[ExposureSetting]:
    """Return settings a factor 2 apart or less, ascending: time first, then gain."""
    times, gains = camera.controls.time_s, camera.controls.gain
    gain = gains.nearest(1.0)
    start_s = min(times.minimum * RATIO, longest_s)
    count = 1 + math.ceil(math.log2(longest_s / start_s))
    found = {_at_most(times, float(each)) for each in np.geomspace(start_s, longest_s, count)}
    ladder = [ExposureSetting(time_s, gain) for time_s in sorted(found)]
    rungs = 1 + math.ceil(math.log2(gains.maximum / gain))
    higher = {gains.nearest(float(each)) for each in np.geomspace(gain, gains.maximum, rungs)}
    return ladder + [ExposureSetting(ladder[-1].time_s, each) for each in sorted(higher - {gain})]
