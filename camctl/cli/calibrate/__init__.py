"""`camctl calibrate`: measure a real camera."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.calibrate.result import Rows, measured, show
from camctl.cli.commands import LazyGroup, command
from camctl.cli.options import CameraOptions, option
from camctl.cli.output import format_delay, format_duration, format_table
from camctl.cli.parameter_types import PATH, Text, WholeNumber

if TYPE_CHECKING:
    from camctl.calibration.results import DelayResult, StillTiming
    from camctl.profiles.exposures import ExposureRecord

calibrate = LazyGroup(
    "calibrate",
    ("all", "colour", "noise", "response"),
    package="camctl.cli.calibrate",
    help="Measure a camera and keep the result in its profile.",
    examples=(
        ("camctl calibrate all --camera v4l2:/dev/video0", "everything, before one still scene"),
        ("camctl calibrate delay --camera v4l2:/dev/video0", "the delay of its exposure controls"),
        ("camctl calibrate exposure --camera ptp:123", "the true exposure of its settings"),
        ("camctl calibrate response --camera v4l2:/dev/video0", "its response, from any scene"),
        ("camctl calibrate noise --camera v4l2:/dev/video0", "its noise, from any scene"),
        ("camctl calibrate colour --camera v4l2:/dev/video0", "its colours, from a Macbeth chart"),
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
@option(
    "--trials N",
    "Number of exposure changes to measure.",
    WholeNumber(least=2, most=10_000),
    default=12,
)
@options.as_json
def delay(camera: CameraOptions, trials: int, as_json: bool) -> None:
    """Measure how many frames pass until a new exposure takes effect, and when frames come.

    First point the camera at a scene that neither moves nor changes brightness. A trial takes about
    20 frames. With a constant delay of d frames, n exposures take n + d frames; with a varying or
    unknown delay, the camera waits at each exposure until it has taken effect. Of a still camera,
    which has no such delay, the time from picture to picture is measured.
    """
    from camctl.calibrate import delay as measure

    result = measured(measure, camera, "changing the exposure", trials=trials).save()
    show(result, lambda: ("", _delay_rows(result)), as_json=as_json)


def _delay_rows(result: DelayResult | StillTiming) -> Rows:
    from camctl.calibration.results import StillTiming

    if isinstance(result, StillTiming):
        still = result.timing
        interval = _milliseconds(still.frame_interval_s)
        yield "control delay", "none: a still camera"
        jitter = f"jitter {_milliseconds(still.jitter_s)}"
        yield "picture to picture", f"{interval} beside the exposure, {jitter}"
        yield "read-out", _milliseconds(still.readout_s)
        yield "download", _milliseconds(still.download_s)
        return
    yield "control delay", f"{format_delay(result)}, in {result.trials} trials"
    yield "consequence", _consequence(result)
    if (timing := result.timing) is not None:
        lost = f", {timing.lost} frames lost" if timing.lost else ""
        jitter = f"jitter {_milliseconds(timing.jitter_s)}"
        yield "frame interval", f"{_milliseconds(timing.frame_interval_s)}, {jitter}{lost}"
        yield "read-out", f"{_milliseconds(timing.readout_s)} after the end of an exposure"


def _milliseconds(time_s: float) -> str:
    return f"{1e3 * time_s:.3g} ms"


def _consequence(result: DelayResult) -> str:
    """Return what the delay means for the number of frames of a capture."""
    if result.frames is None:
        return f"the camera waits {result.largest} frames at each exposure"
    late = f" + {result.frames}" if result.frames > 0 else ""  # below 0: nothing is waited for
    return f"n exposures take n{late} frames"


@command(
    parent=calibrate,
    examples=(
        ("camctl calibrate exposure --camera v4l2:/dev/video0", "all times that suit the light"),
        ("camctl calibrate exposure --camera ptp --longest 30", "a still camera on a tripod"),
        ("camctl calibrate exposure --from hall", "the settings of a capture that is done"),
    ),
)
@options.camera_options
@option("--repeats N", "Frames of each setting.", WholeNumber(least=2, most=100), default=3)
@options.longest("Longest shutter time to measure.")
@option(
    "--from FOLDER",
    "Measure the settings of a complete capture in FOLDER instead, and keep the result for its "
    "camera.",
    PATH,
    field="folder",
)
@option(
    "--response NAME",
    "Response of the camera: linear, srgb, rec709, or power:GAMMA.  [default: as measured, else "
    "as the camera states; with --from else linear]",
    Text(),
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
    from camctl.calibrate import exposure as measure

    if folder is None:
        result = measured(
            measure,
            camera,
            "shooting each setting",
            profile="response,noise",
            how={"response": response},
            repeats=repeats,
            longest_s=longest_s,
        )
    else:
        context = click.get_current_context()
        others = options.given(context) - {"folder", "response", "as_json"}
        options.refuse_together(context, "--from", others)
        result = measure(folder, response=response)
    result = result.save()
    show(result, lambda: (_exposure_table(result), ()), as_json=as_json)


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
