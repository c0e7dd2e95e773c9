"""Metering: the shortest exposure, with the highlights just below saturation, and the light."""

from __future__ import annotations

import math
from contextlib import closing
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CaptureError, UsageError
from camctl.evidence.light_ratio import NeighbourCheck
from camctl.evidence.ratio_check import MOST
from camctl.evidence.shown_levels import other_levels
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.light import DARK_SHARE, Light, Metering
from camctl.exposure.search.settings import BASE_SLACK_ON_LIST_STOPS
from camctl.interface.camera import (
    Camera,
    Frame,
    PreviewingCamera,
    shoot_when_ready,
    when_ready,
)
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.messages.plain import sentence
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import FEWEST_LEVELS
from camctl.system.number_text import time_text
from camctl.system.picture_operations import level_counts

#: Share of a channel's samples above the highlights: reflections of lamps, and hot pixels.
OUTLIER_SHARE = 1e-4
#: Target for the highlights, as a share of the levels: below white by a few times photon noise.
TARGET_SHARE = 0.97
#: A scene with no more than this share of the levels at the longest exposure is black.
BLACK_SHARE = 0.01
#: Metering frames at most; each step changes the time by a factor of up to `LARGEST_STEP`.
_MOST_FRAMES = 16
LARGEST_STEP = 16.0
#: Shutter time of the first metering frame, s.
_FIRST_S = 1 / 60
#: Samples of a plane that are counted, at most.
_MOST_SAMPLES = 1 << 20
#: Longest exposure for a histogram or a preview, s: the user waits for it, where so much is dark
#: that the capture takes longer still.
WAITED_S = 4.0
#: Frames are compared whose exposures differ by this factor or more.  The pixels do not follow
#: where their light changes by less than this power of it: an unknown gamma curve has 0.4.
_COMPARED_FACTOR, _LEAST_POWER = 4.0, 0.25
#: Irradiances that stand for one brightness in a histogram.
_SPREAD = 16


def highlight(frame: Frame, camera: Camera) -> tuple[int, float]:
    """Return (brightness of the highlights above black in the fullest channel, share clipped).

    The highlights are the brightest samples without the brightest `OUTLIER_SHARE`.
    """
    brightest, clipped, total = 0, 0, 0
    for plane in camera.controls.layout.planes(frame.pixels):
        counts = np.bincount(_sample(plane).ravel(), minlength=frame.white + 1)
        above = np.cumsum(counts[::-1])[::-1]  # above[B]: samples of brightness >= B
        allowed = OUTLIER_SHARE * above[0]
        brightest = max(brightest, int(np.flatnonzero(above > allowed)[-1]))
        clipped += int(above[frame.white])
        total += int(above[0])
    return max(0, min(brightest, frame.white) - frame.black), clipped / total


def _sample(plane: NDArray[Any]) -> NDArray[Any]:
    """Return about `_MOST_SAMPLES` samples of a plane at most, evenly spread."""
    step = max(1, math.isqrt(plane.size // _MOST_SAMPLES))
    return np.ascontiguousarray(plane[::step, ::step])


def _level_counts(
    samples: NDArray[Any], black: int, most: int, where: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Return how many samples are 0, 1, ... `most` levels above black, or beyond these."""
    counts = level_counts(samples, np.iinfo(samples.dtype).max + 1, where)
    inner = counts[black : black + most + 1].copy()
    inner[0] += counts[:black].sum()
    inner[-1] += counts[black + most + 1 :].sum()
    return inner


class MeteringFrames:
    """Takes metering frames: previews, or exposures of the shutter where that is allowed.

    Args:
        camera: an open camera
        spend_shutter: allows exposures of a shutter
        controls: what metering may set; None: all that the camera can

    Attributes:
        controls: what metering may set
        count: number of frames taken
        last: the setting of the last one

    Raises:
        UsageError: the camera has no preview and `spend_shutter` does not allow actuations
    """

    def __init__(
        self,
        camera: Camera,
        *,
        spend_shutter: bool = False,
        controls: ExposureControls | None = None,
    ) -> None:
        if not (isinstance(camera, PreviewingCamera) or spend_shutter):
            raise UsageError(
                f"{camera.info.id} has no preview, and metering would cost shutter actuations",
                hint="allow them, or give the shortest exposure",
                remedies={"spend_shutter": True, "base_s": None},
            )
        self.camera = camera
        self.count = 0
        self.last: ExposureSetting | None = None
        self._frame: Frame | None = None
        self.controls = controls = controls or camera.controls
        self._reference: Frame | None = None
        self._check = NeighbourCheck(controls.levels, controls.black, controls.layout)

    def take(self, setting: ExposureSetting) -> Frame:
        """Return a frame; the last one again if it had this setting.

        Raises:
            CaptureError: the pixels do not follow the exposure, also when taken again
        """
        if self._frame is None or self.last != setting:
            frame = self._shoot(setting)
            before = self._reference
            # Frames that cannot be taken again, as photographs, are not those of a faulty camera.
            is_checked = self.controls.repeatable
            if before is not None and is_checked and self._stays_at(before, frame):
                reference, frame = self._shoot(before.requested), self._shoot(setting)
                if stays_s := self._stays_at(reference, frame):
                    raise self._not_following(reference, frame, stays_s)
            if self._reference is None or self._factor(self._reference, frame) >= _COMPARED_FACTOR:
                self._reference = frame
            self.last, self._frame = setting, frame
        return self._frame

    def _factor(self, before: Frame, after: Frame) -> float:
        """Return the ratio of the exposures, the larger one over the smaller one."""
        one, other = (self.camera.controls.exposure(each.applied) for each in (before, after))
        return max(one, other) / min(one, other)

    def _stays_at(self, before: Frame, after: Frame) -> float | None:
        """Return the shutter time that the pixels of `after` show, s; None: they follow."""
        factor = self._factor(before, after)
        if factor < _COMPARED_FACTOR:
            return None
        expected = factor if after.applied.exposure > before.applied.exposure else 1 / factor
        one, other = (self._check.sample(each.pixels) for each in (before, after))
        check = self._check.compare(one, other, expected)
        measured = check.measured
        if (
            measured is None
            or not check.is_certain
            or abs(math.log(measured)) > _LEAST_POWER * math.log(factor)
        ):
            return None
        return before.applied.time_s * measured

    def _shoot(self, setting: ExposureSetting) -> Frame:
        self.count += 1
        if isinstance(self.camera, PreviewingCamera):
            preview = self.camera.preview
            return when_ready(self.camera.clock, lambda: preview(setting))
        with closing(shoot_when_ready(self.camera, [setting])) as frames:
            return next(frames)

    def _not_following(self, before: Frame, after: Frame, stays_s: float) -> CaptureError:
        controls, frames = self.camera.controls, (before, after)
        patches = [self._check.sample(each.pixels).patches for each in frames]
        exposures = [controls.exposure(each.applied) for each in frames]
        if levels := other_levels(patches, exposures, controls):
            level = levels[0]
            hint = "give it" if level.remedies else "the camera's driver states it wrongly"
            return CaptureError(sentence(level), hint=hint, remedies=level.remedies)
        times = (before.applied.time_s, after.applied.time_s, stays_s)
        shown = [time_text(time_s) for time_s in times]
        end = "no longer" if after.applied.exposure > before.applied.exposure else "no shorter"
        brightest = int(after.pixels.max())
        full = (
            f"if its samples saturate at {brightest} already, that is its white level; "
            if brightest < after.white
            else ""
        )
        has_delay, name = self.camera.controls.delay_frames is not None, self.camera.info.id
        again = "measure its control delay again, or " if has_delay else ""
        return CaptureError(
            f"the camera does not follow its exposure: {shown[0]} and {shown[1]} give nearly the "
            f"same brightness, as if it were {end} than {shown[2]}",
            hint=f"{again}turn its automatic exposure off; {full}if it has none, give exposures "
            "that it can make",
            remedies={
                **({"calibrate_delay": name} if has_delay else {}),
                "base_s": None,
                "ratios": None,
            },
        )


def meter_light(
    camera: Camera, request: CaptureRequest, controls: ExposureControls | None = None
) -> Light | None:
    """Return the light, in units of what the request allows; None: it has the base exposure.

    Args:
        camera: an open camera
        request: what the user asks for
        controls: what metering may set; None: all that the camera can

    Raises:
        UsageError: the camera has no preview, and the request allows no actuations of its shutter
        CaptureError: the light cannot be metered
    """
    if request.base_s is not None:
        return None
    source = MeteringFrames(camera, spend_shutter=request.spend_shutter, controls=controls)
    metering = meter(source, small_aperture=request.use_aperture)
    # Actuations of a shutter are spent only where the light decides more than the base exposure.
    is_free = isinstance(camera, PreviewingCamera) or request.desired is None
    light = light_histogram(source, metering, lower_end=0.0 if is_free else 1.0)
    return replace(light, has_shadows=is_free).limited(request, camera.controls)


def meter(source: MeteringFrames, *, small_aperture: bool = False) -> Metering:
    """Take metering frames until the highlights are just below saturation.

    `small_aperture` uses the largest f-number, so that opening the aperture can lengthen an
    exposure.

    Raises:
        CaptureError: all is black at the longest exposure, or white at the shortest
    """
    camera, controls = source.camera, source.controls
    levels = controls.levels.levels
    aperture = controls.f_number
    f_number = aperture.maximum if aperture is not None and small_aperture else None
    gain = controls.gain.nearest(1.0)
    shortest, longest = controls.time_s.minimum, controls.time_s.maximum
    below = above = None  # the longest time that was not saturated, the shortest that was
    time_s = controls.time_s.nearest(min(max(_FIRST_S, shortest), longest))
    best: tuple[ExposureSetting, int, float] | None = None
    frames = 0
    while frames < _MOST_FRAMES:
        setting = ExposureSetting(time_s, gain, f_number)
        bright, clipped = highlight(source.take(setting), camera)
        frames += 1
        if bright >= levels.size:
            above = time_s
            if time_s <= shortest:
                best = (setting, bright, clipped)
                break
            target_s = math.sqrt(below * above) if below else time_s / LARGEST_STEP
        else:
            below, best = time_s, (setting, bright, clipped)
            # The shortest exposure need not be nearer to its limit: the light is in the gap.
            most = _headroom(levels, max(bright - 1, 0))
            if most <= 2.0**BASE_SLACK_ON_LIST_STOPS or time_s >= longest:
                break
            target_s = time_s * _headroom(levels, bright)
            if above and target_s >= above:
                target_s = math.sqrt(below * above)
        next_s = controls.time_s.nearest(min(max(target_s, shortest), longest))
        if below is None and next_s == above:  # the next one of a list may be farther away
            (next_s,) = controls.time_s.between(shortest, math.nextafter(above, 0.0), 1)
        if next_s in (below, above):
            break
        time_s = next_s
    if best is None:
        raise CaptureError(
            f"the light changes too fast: it was not metered in {_MOST_FRAMES} frames",
            hint="give the shortest exposure",
            remedies={"base_s": None},
        )
    setting, bright, clipped = best
    most = bright * controls.gain.maximum / gain  # what the gain would make of it
    if most <= BLACK_SHARE * levels.size and setting.time_s >= longest:
        raise CaptureError(
            f"the picture is black even at {time_text(longest)}",
            hint="take the lens cap off, or light the scene",
        )
    if clipped > MOST:
        raise CaptureError(
            f"the picture is white even at {time_text(shortest)}",
            hint="close the aperture, or put a filter before the lens",
        )
    limit_s = setting.time_s * (_headroom(levels, bright) if bright < levels.size else 1.0)
    return Metering(
        limit_s=min(max(limit_s, shortest), camera.controls.time_s.maximum),
        setting=setting,
        highlight=bright / levels.size,
        clipped=clipped,
        frames=frames,
    )


def light_histogram(source: MeteringFrames, metering: Metering, *, lower_end: float = 0.0) -> Light:
    """Return the histogram of the light, E = 1 at `limit_s`.

    A frame at the metered setting gives the highlights; each longer one gives the samples that had
    fewer than `FEWEST_LEVELS` levels in the frame before, until `DARK_SHARE` of them is darker at
    most, or all that is darker is below `lower_end`.  Times end at `WAITED_S`, where the frames are
    not taken yet; from there on the gain rises.
    """
    controls = source.controls
    main, M = controls.levels.levels, controls.levels.M
    readable = min(FEWEST_LEVELS, M)
    setting = metering.setting
    full = metering.limit_s * setting.exposure / setting.time_s
    colours = controls.plane_levels
    unread: list[NDArray[np.bool_]] = []
    light, counts = [], []
    while True:
        frame = source.take(setting)
        scale = full / setting.exposure
        planes = controls.layout.planes(frame.pixels)
        samples = [_sample(plane) for plane in planes]
        unread = unread or [np.ones(each.shape, np.bool_) for each in samples]
        most = frame.black + readable
        darker = [rest & (each < most) for rest, each in zip(unread, samples, strict=True)]
        longer = _longer(controls, setting, M / (2 * FEWEST_LEVELS))
        last = (
            sum(map(np.count_nonzero, darker)) <= DARK_SHARE * sum(each.size for each in samples)
            or main[readable - 1] * scale <= lower_end
            or longer.exposure <= setting.exposure
        )
        # The dark current looks like light, and is not.
        dark = controls.frame_noise([setting])[0].dark_levels if controls.noise else 0.0
        for real in dict.fromkeys(colours):
            found = np.zeros(M + 1)
            for colour, sample, rest, below in zip(colours, samples, unread, darker, strict=True):
                if colour is real:
                    used = rest if last else rest & ~below
                    found += _level_counts(sample, frame.black, M, used)
            kept = found > 0
            # All irradiances between two levels have one brightness: its count is spread over
            # them, evenly in ln E.
            low, high = (each[kept] * scale for each in real.gaps)
            lowest = real.levels[0] / 2 * scale
            E = np.geomspace(np.maximum(low, lowest), high, 2 * _SPREAD + 1)[1::2]
            light.append(np.maximum(E - dark / (M + 1) * scale, lowest).ravel())
            counts.append(np.tile(found[kept] / _SPREAD, _SPREAD))
        if last:
            break
        unread, setting = darker, longer
    E, number = np.concatenate(light), np.concatenate(counts)
    order = np.argsort(E, kind="stable")
    return Light(
        replace(metering, frames=source.count),
        E[order],
        number[order] / number.sum(),
        float(main[0] * scale),
        last=source.last,
    )


def _longer(controls: ExposureControls, setting: ExposureSetting, factor: float) -> ExposureSetting:
    """Return a setting with `factor` times the exposure, or the largest that metering uses."""
    waited_s = WAITED_S if controls.repeatable else math.inf  # else nobody waits
    longest_s = max(min(waited_s, controls.time_s.maximum), setting.time_s)
    time_s = controls.time_s.nearest(min(setting.time_s * factor, longest_s))
    gain = min(setting.gain * factor * setting.time_s / time_s, controls.gain.maximum)
    return replace(setting, time_s=time_s, gain=controls.gain.nearest(max(gain, setting.gain)))


def _headroom(levels: FloatArray, bright: int) -> float:
    """Return the factor by which an exposure may grow until `bright` reaches the target."""
    target = float(levels[max(0, math.ceil(TARGET_SHARE * levels.size) - 1)])
    if bright == 0:
        return LARGEST_STEP
    # The upper end of the brightness' gap: the light may be anywhere in it, and must not clip.
    return min(LARGEST_STEP, target / float(levels[min(bright, levels.size - 1)]))
