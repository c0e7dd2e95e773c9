"""`camctl calibrate`: measure a real camera."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import LazyGroup, command
from camctl.cli.options import CameraOptions
from camctl.cli.output import (
    format_delay,
    format_fields,
    print_json,
    print_text,
    print_warning,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import WholeNumber

if TYPE_CHECKING:
    from camctl.profile import DelayRecord, Profile

calibrate = LazyGroup(
    "calibrate",
    help="Measure a camera and keep the result in its profile.",
    examples=(
        ("camctl calibrate delay --camera v4l2:/dev/video0", "the delay of its exposure controls"),
        ("camctl profile list", "the profiles of all cameras"),
    ),
)


@command(
    parent=calibrate,
    examples=(
        ("camctl calibrate delay --camera v4l2:/dev/video0", "a webcam, in its default format"),
        (
            "camctl calibrate delay --camera v4l2:/dev/video0 -O format=yuyv --size 640x480",
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
    """Measure how many frames pass until a new exposure takes effect.

    First point the camera at a scene that neither moves nor changes brightness. A trial takes about
    20 frames. With a constant delay of d frames, n exposures take n + d frames; with a varying or
    unknown delay, the camera waits at each exposure until it has taken effect.
    """
    from camctl.calibration.delay import measure_delay
    from camctl.camera import StreamingCamera
    from camctl.profile import change_profile

    with camera.open() as opened, progress_bar("changing the exposure") as bar:
        record = measure_delay(
            opened, trials=trials, progress=without_stage(bar), warn=print_warning
        )
        assert isinstance(opened, StreamingCamera)  # `measure_delay` refuses others
        info, mode = opened.info, opened.mode

    def keep(profile: Profile) -> None:
        profile.delays[mode] = record

    file = change_profile(info, keep)
    if as_json:
        identity = {
            name: getattr(info, name) for name in ("id", "make", "model", "serial", "driver")
        }
        print_json({"camera": identity, "mode": mode, **record.model_dump(), "file": file})
        return
    rows = [
        ("camera", f"{info.make} {info.model} ({info.id})"),
        ("mode", mode),
        ("control delay", f"{format_delay(record)}, in {record.trials} trials"),
        ("consequence", _consequence(record)),
        ("profile", str(file)),
    ]
    print_text(format_fields(rows))


def _consequence(record: DelayRecord) -> str:
    """Return what the delay means for the number of frames of a capture."""
    if record.frames is None:
        return f"the camera waits {record.largest} frames at each exposure"
    if record.frames == 0:
        return "n exposures take n frames"
    return f"n exposures take n + {record.frames} frames"
