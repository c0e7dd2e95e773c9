"""Displaced photographs that are found, against OpenCV's methods.

    python tests/bench/bench_alignment.py [SIDE]

Brackets of the built-in scenes are taken as JPEG photographs of 8 bits with photon and read noise,
4 times apart, clean and noisy.  One photograph of each is shifted in turn.  A method has found the
shift where its amount is right within a pixel in both directions; it has a false alarm where it
gives more than 1.3 pixels for an unshifted one.  The rivals are given the nearest exposure.
"""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from camctl.evidence.alignment import displacement
from camctl.model.response.camera import standard_response
from camctl.photographs.alignment import Sight
from camctl.photographs.camera import Photograph
from camctl.sim.scenes import charts, drawings, night

SCENES = {
    each.__name__: each
    for each in (
        drawings.room,
        drawings.tile_floor,
        drawings.ball,
        drawings.cloth,
        drawings.colour_chart,
        drawings.wall,
        night.night_street,
        night.stars,
        charts.outdoor_sun,
    )
}
SHIFTS = ((2, 0), (0, -3), (-2, 2), (9, 0), (-5, 12), (0, 33), (64, -20), (-40, -64))
WELLS = (20000, 1500)
_MARGIN, _STEP, _MOST, _ALARM = 70, 4.0, 5, 1.3
_LEVELS = standard_response("srgb", 8).levels

Picture = NDArray[np.uint8]
Found = tuple[float, float] | None


def photograph(
    scene: NDArray[np.float32], time_s: float, shift: tuple[int, int], well: float, seed: int
) -> Picture:
    """Return a JPEG photograph, decoded, in grey."""
    columns, rows = shift
    height, width = scene.shape[0] - 2 * _MARGIN, scene.shape[1] - 2 * _MARGIN
    top, left = _MARGIN - rows, _MARGIN - columns
    light = scene[top : top + height, left : left + width] * time_s
    rng = np.random.default_rng(seed)
    electrons = np.minimum(light, 4) * well
    electrons = electrons + np.sqrt(electrons) * rng.standard_normal(light.shape)
    electrons = electrons + 6 * rng.standard_normal(light.shape)
    pixels = np.searchsorted(_LEVELS, electrons / well, side="right").astype(np.uint8)
    data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_GRAYSCALE), np.uint8)


def ours(one: Picture, other: Picture) -> Found:
    """Return what `camctl merge` finds, `one` being the shorter exposure."""
    grey = [Sight.of(Photograph("", 1.0), each, 255) for each in (one, other)]
    found = displacement(grey[0].grey, grey[1].grey)
    return None if found is None else (found[0] * grey[0].scale, found[1] * grey[0].scale)


def median_bitmaps(one: Picture, other: Picture) -> Found:
    """Return the shift of the median threshold bitmaps of Ward (2003), to 64 pixels."""
    columns, rows = cv2.createAlignMTB(max_bits=7).calculateShift(one, other)
    return -columns, -rows


def log_light(picture: Picture) -> NDArray[np.float32]:
    light = np.concatenate(([_LEVELS[0] / 2], _LEVELS))[:256]
    return np.log(np.maximum(light, 1e-4)).astype(np.float32)[picture]


def ecc(one: Picture, other: Picture) -> Found:
    """Return the maximum of the enhanced correlation coefficient of log light, coarse to fine."""
    warp: Any = np.eye(2, 3, dtype=np.float32)
    for power in (3, 2, 1, 0):
        size = one.shape[1] >> power, one.shape[0] >> power
        small: list[Any] = [
            cv2.resize(each, size, interpolation=cv2.INTER_AREA) for each in (one, other)
        ]
        mask = ((small[1] < 245) * 255).astype(np.uint8)
        start = warp.copy()
        start[:, 2] /= 1 << power
        end = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
        try:
            _, start = cv2.findTransformECC(
                log_light(small[0]),
                log_light(small[1]),
                start,
                cv2.MOTION_TRANSLATION,
                end,
                mask,
                5,
            )
        except cv2.error:
            return None
        warp = start.copy()
        warp[:, 2] *= 1 << power
    return float(warp[0, 2]), float(warp[1, 2])


METHODS: dict[str, Callable[[Picture, Picture], Found]] = {
    "camctl": ours,
    "median bitmaps": median_bitmaps,
    "ECC": ecc,
}


def main() -> None:
    """Print how many shifts each method has found, its false alarms, and its time."""
    side = int(sys.argv[1]) if len(sys.argv) > 1 else 480
    found: dict[str, int] = defaultdict(int)
    alarms: dict[str, int] = defaultdict(int)
    used: dict[str, float] = defaultdict(float)
    shifted = still = 0
    for well in WELLS:
        for draw in SCENES.values():
            drawn = np.asarray(draw(side * 3 // 4 + 2 * _MARGIN, side + 2 * _MARGIN), np.float32)
            scene = drawn[..., 1] if drawn.ndim == 3 else drawn
            times = [0.5 / float(np.quantile(scene, 0.995))]
            while len(times) < _MOST and np.mean(scene * times[-1] * _STEP > 1) < 0.6:
                times.append(times[-1] * _STEP)
            before = [photograph(scene, t, (0, 0), well, k) for k, t in enumerate(times)]
            for k in range(len(times) - 1):
                # Of each pair the shorter is shifted, or the longer, by turns.
                for number, shift in enumerate((*SHIFTS, (0, 0))):
                    which = k + number % 2
                    changed = photograph(scene, times[which], shift, well, 100 + number)
                    pair = (changed, before[k + 1]) if which == k else (before[k], changed)
                    sign = -1 if which == k else 1
                    is_still = shift == (0, 0)
                    still, shifted = still + is_still, shifted + (not is_still)
                    for method, find in METHODS.items():
                        start = time.process_time()
                        result = find(*pair)
                        used[method] += time.process_time() - start
                        if is_still:
                            alarms[method] += result is not None and np.hypot(*result) > _ALARM
                        elif result is not None:
                            error = np.subtract(result, np.multiply(sign, shift))
                            found[method] += bool(np.abs(error).max() <= 1)
    print(f"{'method':18} {'found':>12} {'false alarms':>13} {'CPU a pair':>11}")
    for method in METHODS:
        ms = 1000 * used[method] / (shifted + still)
        print(
            f"{method:18} {found[method]:>5} of {shifted} {alarms[method]:>6} of {still:>3} "
            f"{ms:>8.0f} ms"
        )


if __name__ == "__main__":
    main()
