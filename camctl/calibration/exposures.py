"""The true exposures of a camera's settings, from the pixels of a scene that does not move.

Each setting is shot several times, in rising and falling order, so that a slow change of the light
cancels.  `camctl.evidence.ratios` estimates all exposures together.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from camctl.calibration.light import LONGEST_S, spread_times, too_bright, too_dark
from camctl.calibration.limits import DIM
from camctl.errors import CaptureError
from camctl.evidence.patches import Patches, sample_patches
from camctl.evidence.ratios import RatioEstimates, comparable_frames, estimate_ratios
from camctl.findings import Finding
from camctl.interface.camera import Camera
from camctl.interface.controls import Choices, Control, ExposureControls, ExposureSetting, Steps
from camctl.model.quantiles import Z_95, student
from camctl.model.response.camera import CameraResponse, FloatArray
from camctl.model.sensor import SensorModel
from camctl.profiles.exposures import Correction, ExposureRecord
from camctl.system.number_text import time_text

REPEATS = 3
#: Shutter times in a stop, on a camera that has any.
_TIMES_PER_STOP = 2
#: A frame is worth comparing if this share of its samples is well exposed.
_LEAST_SHARE = 0.05
#: Standard deviation of frames with one setting, relative: above the first the light or the shutter
#: is not steady and nothing is measured, above the second there is a warning.
_UNSTEADY, _UNEVEN = 0.02, 0.003


def measure_exposures(
    camera: Camera,
    *,
    repeats: int = REPEATS,
    longest_s: float = LONGEST_S,
    response: CameraResponse | None = None,
    progress: Callable[[float], None] | None = None,
    warn: Callable[[Finding], None] | None = None,
) -> ExposureRecord:
    """Measure the exposures of the camera's settings before a scene that does not move.

    Shutter times are measured at the gain nearest to 1, gains at the shortest of these times; which
    of them depends on the light: those at which a part of the scene is well exposed.

    Args:
        camera: an open camera
        repeats: frames of each setting, at least 2
        longest_s: longest shutter time to measure, s
        response: of the camera; None: as its controls state it
        progress: called with the share that is done, 0 to 1
        warn: called with each irregularity

    Raises:
        CaptureError: the scene is too dark or too bright, or its light is not steady
        DataError: the response is only assumed, or the frames cannot be compared: see
            `estimate_ratios`
        CameraError: as `Camera.shoot` raises
    """
    controls = camera.controls
    if response is None:
        controls.check_response("exposure")
    scale = SensorModel(controls.levels if response is None else response, controls.black)
    times = _useful_times(camera, _candidates(controls.time_s, longest_s), scale)
    base = controls.gain.nearest(1.0)
    span = times[-1] / times[0]
    gains = [gain for gain in _gains(controls.gain, base) if gain / base <= span]
    settings = [ExposureSetting(time_s, base) for time_s in times]
    settings += [ExposureSetting(times[0], gain) for gain in gains if gain != base]
    order = [k for turn in range(repeats) for k in range(len(settings))[:: -1 if turn % 2 else 1]]
    shown: list[Patches] = []
    for frame in camera.shoot([settings[k] for k in order]):
        shown.append(sample_patches(controls.layout.planes(frame.pixels), scale.white))
        if progress is not None:
            progress(len(shown) / len(order))
    settings, order, shown = _comparable(
        controls, scale, settings, order, shown, warn or (lambda _: None)
    )
    times = [setting.time_s for setting in settings if setting.gain == base]
    used = [settings[k] for k in order]
    noise = None if controls.noise is None else controls.frame_noise(used)
    labels = [setting.exposure for setting in used]
    found = estimate_ratios(shown, labels, scale, noise)
    means, half = _pooled(found, labels, order, warn or (lambda _: None))
    reference = order[found.reference]
    if reference >= len(times):  # a gain: relative to its time, which is the first
        reference = 0
    exponent = found.exponent_error
    corrections = [
        _correction(
            value,
            means[k] - means[reference],
            math.hypot(half[k], exponent * math.log(value / times[reference])) * (k != reference),
        )
        for k, value in enumerate(times)
    ]
    by_gain = {base: Correction(value=base, factor=1.0, low=1.0, high=1.0)}
    for k, setting in enumerate(settings[len(times) :], start=len(times)):
        width = math.hypot(half[k], exponent * math.log(setting.gain / base))
        by_gain[setting.gain] = _correction(setting.gain, means[k] - means[0], width)
    return ExposureRecord(
        times=tuple(corrections),
        gains=tuple(by_gain[gain] for gain in sorted(by_gain)),
        interpolates=isinstance(controls.time_s, Steps),
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def record_of_frames(
    frames: Sequence[Patches],
    settings: Sequence[ExposureSetting],
    scale: SensorModel,
) -> ExposureRecord:
    """Return the exposures of the settings of one capture, from one frame of each.

    Only settings of the first one's gain are compared.

    Raises:
        DataError: the frames cannot be compared: see `estimate_ratios`
    """
    used = [k for k, setting in enumerate(settings) if setting.gain == settings[0].gain]
    labels = [settings[k].exposure for k in used]
    found = estimate_ratios([frames[k] for k in used], labels, scale)
    corrections = {}
    for k, label in enumerate(labels):
        value, low, high = found.exposures[k], found.low[k], found.high[k]
        corrections[settings[used[k]].time_s] = Correction(
            value=settings[used[k]].time_s, factor=value / label, low=low / label, high=high / label
        )
    gain = settings[0].gain
    return ExposureRecord(
        times=tuple(corrections[time_s] for time_s in sorted(corrections)),
        gains=(Correction(value=gain, factor=1.0, low=1.0, high=1.0),),
        interpolates=False,
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _comparable(
    controls: ExposureControls,
    scale: SensorModel,
    settings: list[ExposureSetting],
    order: list[int],
    shown: list[Patches],
    warn: Callable[[Finding], None],
) -> tuple[list[ExposureSetting], list[int], list[Patches]]:
    """Leave out settings at which too little of the scene is well exposed to be compared.

    Gains are compared at the shortest time: they are left out with it.
    """
    noise = controls.frame_noise([settings[k] for k in order]) if controls.noise else None
    good = comparable_frames(shown, scale, noise)
    lost = {setting for place, setting in enumerate(order) if place not in good}
    if 0 in lost:
        base = settings[0].gain
        lost |= {k for k, setting in enumerate(settings) if setting.gain != base}
    kept = [k for k in range(len(settings)) if k not in lost]
    if not lost or len(kept) < 2:
        return settings, order, shown  # the second case is refused where they are compared
    warn(
        Finding(
            code="not_measured", value=len(lost), details={"what": "settings", "of": len(settings)}
        )
    )
    places = [place for place, k in enumerate(order) if k not in lost]
    return (
        [settings[k] for k in kept],
        [kept.index(order[place]) for place in places],
        [shown[place] for place in places],
    )


def _candidates(control: Control, longest_s: float) -> list[float]:
    """Return shutter times, ascending: all of a dial, or some in each stop."""
    if isinstance(control, Choices):
        return [value for value in control.values if value <= longest_s] or [control.minimum]
    longest_s = max(control.minimum, min(control.maximum, longest_s))
    count = 1 + math.ceil(_TIMES_PER_STOP * math.log2(longest_s / control.minimum))
    return spread_times(control, control.minimum, longest_s, count)


def _gains(control: Control, base: float) -> list[float]:
    if isinstance(control, Choices):
        return [value for value in control.values if value >= base]
    count = 1 + math.floor(math.log2(control.maximum / base))
    return sorted({control.nearest(base * 2.0**stop) for stop in range(count)})


def _useful_times(camera: Camera, times: Sequence[float], scale: SensorModel) -> list[float]:
    """Return the times between the first and the last at which the scene is well exposed.

    Every second stop is tried.

    Raises:
        CaptureError: there are fewer than two
    """
    controls = camera.controls
    tried = [times[0]]
    for time_s in times[1:]:
        if time_s >= 4 * tried[-1] * (1 - 1e-6) or time_s == times[-1]:
            tried.append(time_s)
    gain = controls.gain.nearest(1.0)
    light = {}
    for frame in camera.shoot([ExposureSetting(time_s, gain) for time_s in tried]):
        values = scale.light[sample_patches(controls.layout.planes(frame.pixels), scale.white)]
        light[tried[frame.index]] = values / scale.full
    brightest = scale.light[scale.highest(None)] / scale.full
    good = [
        time_s
        for time_s, values in light.items()
        if np.mean((values >= DIM) & (values <= brightest)) >= _LEAST_SHARE
    ]
    if not good:
        raise _unsuitable_light(light, brightest)
    first = max((t for t in tried if t < good[0]), default=times[0])
    last = min((t for t in tried if t > good[-1]), default=times[-1])
    # Times next to a good one are good where the light changes by the same factor as the time.
    useful = [t for t in times if max(first, good[0] / 2) <= t <= min(last, good[-1] * 2)]
    if len(useful) < 2:
        raise CaptureError(
            f"only {useful[0]:.4g} s of the camera's shutter times suits this light",
            hint="change the light or the aperture, or allow longer times",
            remedies={"longest_s": None},
        )
    return useful


def _unsuitable_light(light: Mapping[float, FloatArray], brightest: float) -> CaptureError:
    shortest, longest = min(light), max(light)
    if np.mean(light[shortest]) > brightest:
        return too_bright(shortest)
    if np.mean(light[longest]) < DIM:
        return too_dark(f"it is nearly black even at {time_text(longest)}")
    return CaptureError(
        "no shutter time exposes a twentieth of the picture well",
        hint="point the camera at an evenly lit surface",
    )


def _pooled(
    found: RatioEstimates,
    labels: Sequence[float],
    order: Sequence[int],
    warn: Callable[[Finding], None],
) -> tuple[FloatArray, FloatArray]:
    """Return for each setting the logarithm of true over stated exposure, and half its interval.

    The error of the exponent of the response is not in the interval.
    """
    count = max(order) + 1
    place = np.array(order)
    logs = np.log(np.array(found.exposures) / np.array(labels))
    widths = np.array(found.half_widths)
    repeats = np.bincount(place, minlength=count)
    means = np.bincount(place, logs, count) / repeats
    freedom = len(logs) - count
    scatter = math.sqrt(float(np.square(logs - means[place]).sum() / freedom))
    if scatter > _UNSTEADY:
        raise CaptureError(
            f"frames with one setting differ by {scatter:.1%}: the light or the shutter is not "
            "steady",
            hint="use daylight or a lamp that does not flicker; a shutter that varies this much "
            "cannot be calibrated: have the exposures of each capture estimated",
            remedies={"estimate_ratios": True},
        )
    if scatter > _UNEVEN:
        warn(Finding(code="light_varies", value=scatter, details={"within": "setting"}))
    half = np.bincount(place, widths, count) / repeats
    return means, np.hypot(half, student(Z_95, freedom) * scatter * np.sqrt(2 / repeats))


def _correction(value: float, log: float, half: float) -> Correction:
    factor = math.exp(log)
    return Correction(
        value=value, factor=factor, low=factor * math.exp(-half), high=factor * math.exp(half)
    )
