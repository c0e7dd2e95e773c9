"""What libcamera does not say of a sensor, found by what the metadata of frames state.

A sensor exposes for whole lines and has a table of gains; libcamera rounds silently.  No frame is
assigned to a request here: which values occur is enough.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from camctl.drivers.libcamera.requests import Requests, Stated
from camctl.errors import CameraProtocolError

#: Times that are tried to find the first lines: from so many times the shortest on, in these steps,
#: us.  Lines take 9 us (IMX708) to 38 us (IMX219 at its full size).
_FIRST, _STEP_US, _STEPS = 4, 4, 24
#: Gains that are asked for, in factors of half a stop.
_GAIN_STEP = 2**0.5
#: Two stated gains are one if they differ by less: libcamera states single precision.
SAME_GAIN = 1e-4


@dataclass(frozen=True)
class Probed:
    """What was found.

    Attributes:
        line_us: time of a line, us
        lines: fewest and most lines of an exposure
        gains: analogue gains that the sensor holds exactly
        delay_frames: frames from sending a setting until the first one that has it, at most
    """

    line_us: float
    lines: tuple[int, int]
    gains: tuple[float, ...]
    delay_frames: int


def probe(requests: Requests, times_us: tuple[int, int], gains: tuple[float, float]) -> Probed:
    """Measure the sensor of a running camera; some 200 frames.

    Args:
        requests: of the camera
        times_us: shortest and longest exposure that libcamera states, us
        gains: lowest and highest analogue gain that it states

    Raises:
        CameraProtocolError: its exposures are not those of lines
    """
    shortest, gain = max(times_us[0], 1), gains[0]
    start = _FIRST * shortest
    requests.metadata([Stated(start, gain)])
    delay = 0
    for time_us in (2 * start, start):
        found = requests.metadata([Stated(min(time_us, times_us[1]), gain)])
        changed = [place for place, each in enumerate(found) if each.time_us != found[0].time_us]
        # It was sent when frame 0 was here and frame 1 was being exposed.
        delay = max(delay, changed[0] - 2 if changed else 0)
    ladder = [Stated(start + _STEP_US * place, gain) for place in range(1, _STEPS + 1)]
    seen = [each.time_us for each in requests.metadata(ladder)]
    line_us = _line_us(seen, requests, gain, times_us[1])
    lines = math.ceil(times_us[0] / line_us - 0.01), math.floor(times_us[1] / line_us + 0.01)
    return Probed(line_us, (max(lines[0], 1), lines[1]), _gains(requests, start, gains), delay)


def _line_us(seen: Sequence[int], requests: Requests, gain: float, longest_us: int) -> float:
    """Return the time of a line, by neighbouring exposures and then by longer and longer ones."""
    steps = [after - before for before, after in pairwise(sorted(set(seen)))]
    if not steps:
        raise CameraProtocolError(
            "the camera does not change its exposure", hint="close other programs that use it"
        )
    line_us = sorted(steps)[len(steps) // 2]
    # A stated time lacks less than 1 us: with twice as many lines the error is half as large.
    times, time = [], 2.0 * max(seen)
    while time < min(longest_us, 4000 * line_us):
        times.append(Stated(int(time), gain))
        time *= 1.5
    found = sorted({each.time_us for each in requests.metadata(times)} | set(seen))
    estimate = float(line_us)
    for time_us in found:
        count = round((time_us + 0.5) / estimate)
        # With too many lines for the error so far the number of lines would be a guess.
        if count and (time_us + 1) / count - time_us / count < estimate / 2:
            estimate = (time_us + 0.5) / count
    return estimate


def _gains(requests: Requests, time_us: int, limits: tuple[float, float]) -> tuple[float, ...]:
    """Return gains that the sensor states again when it is sent what it stated."""
    count = max(1, math.floor(math.log(limits[1] / limits[0]) / math.log(_GAIN_STEP) + 1e-6))
    wanted = [limits[0] * _GAIN_STEP**place for place in range(count + 1)]
    offered = {each.gain for each in requests.metadata([Stated(time_us, g) for g in wanted])}
    again = requests.metadata([Stated(time_us, gain) for gain in sorted(offered)])
    held = sorted(
        gain for gain in offered if any(abs(each.gain / gain - 1) < SAME_GAIN for each in again)
    )
    return tuple(held) or (limits[0],)
