"""Measure a camera: response, noise, true exposures, colours, dark signal and control delay.

Each function takes an open camera, which it lets shoot what it needs, or frames that were taken
before: arrays with their exposures, paths of photographs, or a capture (its report, or the path of
its folder).  It returns a typed result; `save` of a result keeps it in the profile of its camera,
which later captures use.

>>> import camctl
>>> with camctl.open_camera("sim", sensor="phone", size="320x240") as camera:
...     noise = camctl.calibrate.noise(camera, count=6)
>>> round(noise.conversion_e_per_dn.value)
6
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import ArrayLike, NDArray

from camctl.calibration.colour import measure_colour
from camctl.calibration.delay import TRIALS, delay_of_frames, measure_delay
from camctl.calibration.exposures import REPEATS, measure_exposures, record_of_frames
from camctl.calibration.frames import Response, Source, response_named, scene_frames
from camctl.calibration.light import LONGEST_S
from camctl.calibration.noise.dark import LONGEST_S as LONGEST_DARK_S
from camctl.calibration.noise.dark import measure_dark
from camctl.calibration.noise.estimate import estimate_noise
from camctl.calibration.noise.shooting import EXPOSURES, measure_noise
from camctl.calibration.response.chart import find_macbeth, read_patches
from camctl.calibration.response.checks import inexactness
from camctl.calibration.response.estimate import Chart, estimate_response
from camctl.calibration.response.shooting import FRAMES, measure_response
from camctl.calibration.results import (
    ChannelResult,
    ColourResult,
    DelayResult,
    ExposureResult,
    NoiseResult,
    ResponseResult,
    StillTiming,
)
from camctl.calibration.timing import measure_still_timing
from camctl.errors import DataError, UsageError
from camctl.evidence.patches import sample_patches
from camctl.findings import Finding
from camctl.interface.camera import Camera, CameraInfo, StreamingCamera
from camctl.interface.controls import ExposureControls, Layout
from camctl.model.response.camera import CameraResponse
from camctl.model.sensor import SensorModel
from camctl.pictures.combine_arguments import checked_frames
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.profile import load_profile

if TYPE_CHECKING:
    from camctl.calibration.response.series import Series

__all__ = ["colour", "dark", "delay", "exposure", "noise", "response"]

Progress = Callable[[float], None] | None
"""Called with the share that is done, 0 to 1."""

COLOUR_FRAMES = 4
"""Frames of a chart: the darkest patch has 1/30 of the light of white, three of them a stop apart
expose each well (`chart_samples`), and one is to spare."""

MACBETH = "macbeth"
"""Name of the chart of 24 patches that is looked for."""


def response(
    source: Camera | Source,
    exposures: Sequence[float] | None = None,
    *,
    black: int | None = None,
    white: int | None = None,
    layout: Layout | str | None = None,
    count: int = FRAMES,
    longest_s: float = LONGEST_S,
    estimate_ratios: bool = False,
    chart: str | os.PathLike[str] | None = None,
    keep: bool = False,
    progress: Progress = None,
) -> ResponseResult:
    """Measure the response: which brightness the camera gives to which irradiance.

    The scene must not move, its light must be steady, and it should have many shades from dark to
    bright.  Where the curve is too uncertain for a profile, `response_inexact` says what helps.

    Args:
        source: an open camera, which shoots a series that suits the light; or frames
        exposures: of the frames, s; None: as files state them, or unknown: the curve's exponent is
            then an expectation
        black: brightness without light, DN; None: as files state it, or found in the pixels
        white: brightness from which samples are saturated, DN; None: likewise
        layout: of arrays: the Bayer pattern, such as "rggb"
        count: frames to shoot, at least 2
        longest_s: longest shutter time, s
        estimate_ratios: the exposures are only roughly known (30 %)
        chart: "macbeth" for a chart of 24 patches that is looked for, or a file of patches, one a
            line: x, y, width, height, reflectance; one frame is enough
        keep: refuse no frames that seem to move or have wrong exposures; no finding of inexactness
        progress: called with the share that is done

    Raises:
        CaptureError: the scene is too dark or too bright
        DataError: the frames do not show the response; says why and what to do
        UsageError: levels or exposures do not fit the frames
        CameraError: as `camctl.Camera.shoot` raises
    """
    frames: list[NDArray[Any]] = []
    kept = frames if chart else None
    if isinstance(source, Camera):
        series = measure_response(
            source, count=count, longest_s=longest_s, frames=kept, progress=progress
        )
        camera: CameraInfo | None = source.info
        mode = exposure_mode(source.controls)
    else:
        found = scene_frames(
            source,
            exposures,
            black=black,
            white=white,
            layout=layout,
            needs_times=lambda count: not estimate_ratios and (chart is None or count > 1),
            finds_levels=True,
        )
        series, camera, mode = found.series(kept), found.camera, found.mode
    seen = _chart(chart, frames, series) if chart else None
    with _naming_measured_exposures(series):
        estimate = estimate_response(
            series, estimate_ratios=estimate_ratios, chart=seen, is_kept=keep
        )
    record = estimate.record
    is_judged = not keep and (camera or estimate.exponent_error is None)  # else it is said already
    inexact = inexactness(record, series.exposures, has_profile=bool(camera)) if is_judged else None
    return ResponseResult(
        channels=tuple(ChannelResult.of(each, record.phase) for each in record.channels),
        phase=record.phase,
        frames=record.frames,
        measured_at=record.measured_at,
        exposures=estimate.exposures,
        exponent_error=estimate.exponent_error,
        residual=estimate.residual,
        findings=(*estimate.findings, *([inexact] if inexact else [])),
        camera=camera,
        mode=mode,
    )


@contextmanager
def _naming_measured_exposures(series: Series) -> Iterator[None]:
    """Add to an error that the exposures of the camera's profile may be wrong, if they are used."""
    try:
        yield
    except DataError as error:
        if not series.has_measured_exposures:
            raise
        raise DataError(
            error.what,
            hint=f"{error.hint}; if the measured exposures in the camera's profile are wrong, "
            "leave them out",
            remedies={**error.remedies, "option:profile": "none"},
        ) from error


def _chart(chart: str | os.PathLike[str], frames: list[NDArray[Any]], series: Series) -> Chart:
    if chart == MACBETH:
        return Chart(find_macbeth(frames, series.layout), frames)
    return Chart(read_patches(Path(chart)), frames)


def noise(
    source: Camera | Source,
    exposures: Sequence[float] | None = None,
    *,
    response: Response = None,
    black: int | None = None,
    white: int | None = None,
    layout: Layout | str | None = None,
    is_flat: bool = False,
    count: int = EXPOSURES,
    longest_s: float = LONGEST_S,
    progress: Progress = None,
) -> NoiseResult:
    """Measure the noise: electrons per level, read noise, saturation, as in EMVA 1288.

    Two frames of each exposure are compared: what differs is noise.  The scene must not move; it
    should have dark and bright parts and smooth shades.

    Args:
        source: an open camera, or frames, two of each exposure or more
        exposures: of the frames, s; None: as their files state them
        response: of the camera, or its name; None: as measured or stated; of JPEG files sRGB, of
            other frames linear
        black: brightness without light, DN; None: as files state it, else 0
        white: brightness from which samples are saturated, DN; None: as files state it
        layout: of arrays: the Bayer pattern, such as "rggb"
        is_flat: an evenly lit surface fills the picture: measure the PRNU, too
        count: exposures at each gain, of two frames each, at least 3
        longest_s: longest shutter time, s
        progress: called with the share that is done

    Raises:
        CaptureError: the scene is too dark or too bright
        DataError: the response is only assumed, or the frames are not suitable; says why
        UsageError: levels, exposures or response do not fit the frames
        CameraError: as `camctl.Camera.shoot` raises
    """
    if isinstance(source, Camera):
        record = measure_noise(
            source,
            is_flat=is_flat,
            exposures=count,
            longest_s=longest_s,
            response=_given(source.controls, response),
            progress=progress,
        )
        return NoiseResult(**dict(record), camera=source.info, mode=exposure_mode(source.controls))
    frames = scene_frames(source, exposures, black=black, white=white, layout=layout)
    record = estimate_noise(frames.pairs(response, is_flat=is_flat))
    if frames.grid is not None:
        record = record.in_levels(1 / frames.grid.step)
    return NoiseResult(**dict(record), camera=frames.camera, mode=frames.mode)


def dark(
    camera: Camera, *, longest_s: float = LONGEST_DARK_S, progress: Progress = None
) -> NoiseResult:
    """Measure dark current, offsets of the pixels and hot pixels, with the lens covered.

    Args:
        camera: an open camera, in whose profile there is the noise
        longest_s: longest shutter time, s
        progress: called with the share that is done

    Returns:
        The noise in the camera's profile, with the dark signal in `dark`.

    Raises:
        UsageError: the electrons per level are not known in this mode
        DataError: the frames are not dark
        CameraError: as `camctl.Camera.shoot` raises
    """
    mode = exposure_mode(camera.controls)
    earlier = load_profile(camera.info).noises.get(mode)
    if earlier is None:
        raise UsageError(
            f"the electrons per level of this camera are not known in the mode {mode}",
            hint="take the lens cap off, and measure the noise with light first",
            remedies={"calibrate_noise": None},
        )
    found = measure_dark(camera, earlier, longest_s=longest_s, progress=progress)
    return NoiseResult(**{**dict(earlier), "dark": found}, camera=camera.info, mode=mode)


def exposure(
    source: Camera | Source,
    exposures: Sequence[float] | None = None,
    *,
    response: Response = None,
    black: int | None = None,
    white: int | None = None,
    layout: Layout | str | None = None,
    repeats: int = REPEATS,
    longest_s: float = LONGEST_S,
    progress: Progress = None,
) -> ExposureResult:
    """Measure the true exposure of each setting against the stated one.

    The scene must have light and dark parts, and neither move nor change its brightness.

    Args:
        source: an open camera, which shoots each setting that suits the light several times; or
            frames, of whose first gain the settings are compared
        exposures: of the frames, s; None: as their files state them
        response: of the camera, or its name; None: as measured or stated; of frames else linear
        black: brightness without light, DN; None: as files state it, else 0
        white: brightness from which samples are saturated, DN; None: as files state it
        layout: of arrays: the Bayer pattern, such as "rggb"
        repeats: frames of each setting, at least 2
        longest_s: longest shutter time to measure, s
        progress: called with the share that is done

    Raises:
        CaptureError: the scene is too dark or too bright, or its light is not steady
        DataError: the response is only assumed, or the frames cannot be compared
        UsageError: levels, exposures or response do not fit the frames
        CameraError: as `camctl.Camera.shoot` raises
    """
    findings: list[Finding] = []
    if isinstance(source, Camera):
        record = measure_exposures(
            source,
            repeats=repeats,
            longest_s=longest_s,
            response=_given(source.controls, response),
            progress=progress,
            warn=findings.append,
        )
        camera: CameraInfo | None = source.info
        mode = exposure_mode(source.controls)
    else:
        frames = scene_frames(source, exposures, black=black, white=white, layout=layout)
        channels = list(frames.responses(response).values())
        patches, settings = [], []
        black, white = frames.code_levels
        for codes, setting in frames.codes():
            patches.append(sample_patches(frames.layout.planes(codes), white))
            settings.append(setting)
        scale = SensorModel(channels[len(channels) // 2], black)
        record = record_of_frames(patches, settings, scale)
        camera, mode, findings = frames.camera, frames.mode, frames.findings
    return ExposureResult(**dict(record), findings=tuple(findings), camera=camera, mode=mode)


def _given(controls: ExposureControls, response: Response) -> CameraResponse | None:
    """Return the response of a camera that is given, by its name or as levels."""
    if response is None:
        return None
    return response_named(response, controls.bits, controls.black, controls.white)


def colour(
    source: Camera | Source,
    exposures: Sequence[float] | None = None,
    *,
    response: Response = None,
    black: int | None = None,
    white: int | None = None,
    layout: Layout | str | None = None,
    count: int = COLOUR_FRAMES,
    longest_s: float = LONGEST_S,
    progress: Progress = None,
) -> ColourResult:
    """Measure the colours with a Macbeth chart of 24 patches in view, which is looked for.

    The chart should fill half of the picture or more, lit evenly, without reflections.

    Args:
        source: an open camera, or frames; one is enough if no patch is saturated in it
        exposures: of the frames, s; None: as their files state them
        response: of the camera, or its name; None: as measured or stated; of JPEG files sRGB, of
            other frames linear
        black: brightness without light, DN; None: as files state it, else 0
        white: brightness from which samples are saturated, DN; None: as files state it
        layout: of arrays: the Bayer pattern, such as "rggb"
        count: frames to shoot, at least 2
        longest_s: longest shutter time, s
        progress: called with the share that is done

    Raises:
        CaptureError: the scene is too dark or too bright
        DataError: the response is only assumed, there is no chart, or it is not well exposed
        UsageError: levels, exposures or response do not fit the frames
        CameraError: as `camctl.Camera.shoot` raises
    """
    frames: list[NDArray[Any]] = []
    findings: list[Finding] = []
    if isinstance(source, Camera):
        controls, given = source.controls, _given(source.controls, response)
        if given is None:
            controls.check_response("colour")
        series = measure_response(
            source, count=count, longest_s=longest_s, frames=frames, progress=progress
        )
        of_channels = controls.responses or (given or controls.levels,) * 3
        if given is not None:
            of_channels = (given,) * 3
        camera: CameraInfo | None = source.info
        mode = exposure_mode(controls)
    else:
        found = scene_frames(
            source,
            exposures,
            black=black,
            white=white,
            layout=layout,
            needs_times=lambda count: count > 1,
        )
        of_channels = tuple(found.responses(response).values())
        series, camera, mode = found.series(frames), found.camera, found.mode
        findings = found.findings
    if series.layout is Layout.MONO:
        raise DataError(
            "the frames are monochrome and have no colours", hint="measure a colour camera"
        )
    record = measure_colour(frames, series, of_channels)
    return ColourResult(**dict(record), findings=tuple(findings), camera=camera, mode=mode)


def delay(
    source: Camera | Iterable[ArrayLike],
    exposures: Sequence[float] | None = None,
    *,
    trials: int = TRIALS,
    progress: Progress = None,
) -> DelayResult | StillTiming:
    """Measure how many frames pass until a new exposure takes effect, and when frames come.

    Args:
        source: an open camera before a scene that neither moves nor changes brightness; or
            consecutive frames of a stream as arrays
        exposures: of arrays: for each the exposure that was last set when its exposure began
        trials: number of changes of the exposure that the camera makes, at least 2
        progress: called with the share that is done

    Returns:
        The delay; of a still camera, which has none, its timing.

    Raises:
        UsageError: the camera has no two exposures far enough apart, or the frames show too few
            changes
        CaptureError: the scene is too dark, too bright, or not steady
        DataError: a change of the frames takes effect at no certain frame
        CameraError: as `camctl.StreamingCamera.step` raises, and where an exposure does not take
            effect
    """
    findings: list[Finding] = []
    if not isinstance(source, Camera):
        frames, given = checked_frames(source, [] if exposures is None else exposures)
        record = delay_of_frames(frames, given, findings.append)
        return DelayResult(**dict(record), findings=tuple(findings))
    if not isinstance(source, StreamingCamera):
        return StillTiming(camera=source.info, timing=measure_still_timing(source))
    record = measure_delay(source, trials=trials, progress=progress, warn=findings.append)
    return DelayResult(
        **dict(record), findings=tuple(findings), camera=source.info, mode=source.mode
    )
