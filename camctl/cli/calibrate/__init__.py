"""`camctl calibrate`: measure a real camera."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.calibrate.result import Findings, Result, camera_row
from camctl.cli.commands import LazyGroup, command
from camctl.cli.options import CameraOptions
from camctl.cli.output import (
    format_delay,
    format_duration,
    format_fields,
    format_table,
    print_json,
    print_text,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import PATH, WholeNumber
from camctl.errors import DataError

if TYPE_CHECKING:
    from camctl.interface.camera import CameraInfo
    from camctl.profiles.exposures import ExposureRecord
    from camctl.profiles.profile import DelayRecord, FrameTiming, Profile

calibrate = LazyGroup(
    "calibrate",
    ("all", "noise", "response"),
    package="camctl.cli.calibrate",
    help="Measure a camera and keep the result in its profile.",
    examples=(
        ("camctl calibrate all --camera v4l2:/dev/video0", "everything, before one still scene"),
        ("camctl calibrate delay --camera v4l2:/dev/video0", "the delay of its exposure controls"),
        ("camctl calibrate exposure --camera ptp:123", "the true exposure of its settings"),
        ("camctl calibrate response --camera v4l2:/dev/video0", "its response, from any scene"),
        ("camctl calibrate noise --camera v4l2:/dev/video0", "its noise, from any scene"),
        ("camctl profile list", "the profiles of all cameras"),
    ),
)


@command(
    parent=calibrate,
    examples=(
        ("camctl calibrate delay --camera v4l2:/dev/video0", "a webcam, in its default format"),
        (
            "camctl calibrate delay --camera v4l2:/dev/video0 -O format=yuyv -O size=640x480",
            "in another format: a delay belongs to format, size and frame rate",
        ),
        ("camctl calibrate delay --sensor consumer --trials 40", "a simulated one, thoroughly"),
    ),
)
@options.camera_options
@click.option(
    "--trials",
    type=WholeNumber(least=2, most=10_000),
    metavar="N",
    default=12,
    help="Number of exposure changes to measure.",
)
@options.as_json
def delay(camera: CameraOptions, trials: int, as_json: bool) -> None:
    """Measure how many frames pass until a new exposure takes effect, and when frames come.

    First point the camera at a scene that neither moves nor changes brightness. A trial takes about
    20 frames. With a constant delay of d frames, n exposures take n + d frames; with a varying or
    unknown delay, the camera waits at each exposure until it has taken effect. Of a still camera,
    which has no such delay, the time from picture to picture is measured.
    """
    from camctl.calibration.delay import measure_delay
    from camctl.calibration.timing import measure_still_timing
    from camctl.interface.camera import StreamingCamera
    from camctl.profiles.profile import change_profile

    with camera.open(profile="none") as opened, progress_bar("changing the exposure") as bar:
        info = opened.info
        if not isinstance(opened, StreamingCamera):
            timing = measure_still_timing(opened)
            if as_json:
                content = {"frames": None, "timing": timing.model_dump()}
                print_json({"camera": dataclasses.asdict(info), **content})
            else:
                print_text(format_fields(_still_rows(info, timing)))
            return
        findings = Findings()
        record = measure_delay(
            opened, trials=trials, progress=without_stage(bar), warn=findings.add
        )
        mode = opened.mode

    def keep(profile: Profile) -> None:
        profile.delays[mode] = record

    result = Result(info, mode, change_profile(info, keep))
    if as_json:
        result.print_json({**record.model_dump(), "findings": findings.to_json()})
        return
    rows = [
        ("control delay", f"{format_delay(record)}, in {record.trials} trials"),
        ("consequence", _consequence(record)),
        *_timing_rows(record),
    ]
    result.print_text("", rows)


def _timing_rows(record: DelayRecord) -> list[tuple[str, str]]:
    """Return what is known of when the frames of a stream come."""
    timing = record.timing
    if timing is None:
        return []
    lost = f", {timing.lost} frames lost" if timing.lost else ""
    return [
        (
            "frame interval",
            f"{_milliseconds(timing.frame_interval_s)}, jitter {_milliseconds(timing.jitter_s)}"
            f"{lost}",
        ),
        ("read-out", f"{_milliseconds(timing.readout_s)} after the end of an exposure"),
    ]


def _still_rows(info: CameraInfo, timing: FrameTiming) -> list[tuple[str, str]]:
    interval = _milliseconds(timing.frame_interval_s)
    return [
        camera_row(info),
        ("control delay", "none: a still camera"),
        (
            "picture to picture",
            f"{interval} beside the exposure, jitter {_milliseconds(timing.jitter_s)}",
        ),
        ("read-out", _milliseconds(timing.readout_s)),
        ("download", _milliseconds(timing.download_s)),
    ]


def _milliseconds(time_s: float) -> str:
    return f"{1e3 * time_s:.3g} ms"


def _consequence(record: DelayRecord) -> str:
    """Return what the delay means for the number of frames of a capture."""
    if record.frames is None:
        return f"the camera waits {record.largest} frames at each exposure"
    if record.frames == 0:
        return "n exposures take n frames"
    return f"n exposures take n + {record.frames} frames"


@command(
    parent=calibrate,
    examples=(
        ("camctl calibrate exposure --camera v4l2:/dev/video0", "all times that suit the light"),
        ("camctl calibrate exposure --camera ptp --longest 30", "a still camera on a tripod"),
        ("camctl calibrate exposure --from hall", "the settings of a capture that is done"),
    ),
)
@options.camera_options
@click.option(
    "--repeats",
    type=WholeNumber(least=2, most=100),
    metavar="N",
    default=3,
    help="Frames of each setting.",
)
@options.longest("Longest shutter time to measure.")
@click.option(
    "--from",
    "folder",
    type=PATH,
    metavar="FOLDER",
    help="Measure the settings of a complete capture in FOLDER instead, and keep the result for "
    "its camera.",
)
@click.option(
    "--response",
    metavar="NAME",
    help="Response of the camera: linear, srgb, rec709, or power:GAMMA.  [default: the measured "
    "one, else that which the camera states; with --from else linear]",
)
@options.as_json
def exposure(
    camera: CameraOptions,
    repeats: int,
    longest_s: float,
    folder: Path | None,
    response: str | None,
    as_json: bool,
) -> None:
    """Measure the true exposure of each setting against the stated one.

    First point the camera at a scene with light and dark parts that neither moves nor changes
    brightness; a tripod and daylight are best. Its response must be known: measure it first with
    camctl calibrate response. The settings that suit the light are shot several
    times each; for others, change the light and measure again: settings measured earlier are kept
    where they are not measured now. Later captures use the result in place of the stated exposures.
    """
    from camctl.profiles.profile import change_profile

    context = click.get_current_context()
    findings = Findings()
    if folder is None:
        info, mode, record = _measure(camera, repeats, longest_s, response, findings)
    else:
        others = options.given(context) - {"folder", "response", "as_json"}
        options.refuse_together(context, "--from", others)
        info, mode, record = _from_capture(folder, response)

    def keep(profile: Profile) -> None:
        earlier = profile.exposures.get(mode)
        profile.exposures[mode] = record if earlier is None else record.joined(earlier)

    result = Result(info, mode, change_profile(info, keep))
    if as_json:
        result.print_json({**record.model_dump(), "findings": findings.to_json()})
    else:
        result.print_text(_exposure_table(record), [])


def _measure(
    camera: CameraOptions,
    repeats: int,
    longest_s: float,
    response: str | None,
    findings: Findings,
) -> tuple[CameraInfo, str, ExposureRecord]:
    from camctl.calibration.exposures import measure_exposures
    from camctl.cli.calibrate.exposure_series import response_of
    from camctl.profiles.exposures import exposure_mode

    with (
        camera.open(profile="response,noise") as opened,
        progress_bar("shooting each setting") as bar,
    ):
        record = measure_exposures(
            opened,
            repeats=repeats,
            longest_s=longest_s,
            response=response_of(opened.controls, response),
            progress=without_stage(bar),
            warn=findings.add,
        )
        return opened.info, exposure_mode(opened.controls), record


def _from_capture(folder: Path, response: str | None) -> tuple[CameraInfo, str, ExposureRecord]:
    from camctl.calibration.exposures import record_of_frames
    from camctl.cli.calibrate.exposure_series import SeriesOptions, stored_capture
    from camctl.evidence.patches import sample_patches
    from camctl.model.sensor import SensorModel

    stored = stored_capture(SeriesOptions((folder,)))
    if stored is None:
        raise DataError(f"{folder} holds no capture", hint="name the folder of a capture")
    report = stored.report
    channels = list(stored.responses(response).values())
    frames = [report.frame(position) for position in stored.positions]
    record = record_of_frames(
        [sample_patches(report.layout.planes(frame), report.white) for frame in frames],
        [report.frames[position].applied for position in stored.positions],
        SensorModel(channels[len(channels) // 2], stored.black),
    )
    return report.camera, stored.mode, record


def _exposure_table(record: ExposureRecord) -> str:
    """Return one row for each setting: true over stated exposure, and its interval."""
    settings = [(format_duration(each.value), each) for each in record.times]
    settings += [(f"gain {each.value:.4g}", each) for each in record.gains[1:]]
    rows = [
        (
            name,
            f"{each.factor:.5f}",
            "reference" if each.low == each.high else f"{each.low:.5f} to {each.high:.5f}",
            "contradicts the stated one" if each.contradicts_label else "",
        )
        for name, each in settings
    ]
    headings = ("setting", "true / stated", "95 %", "")
    return format_table(headings, rows, right_aligned=(0, 1))
