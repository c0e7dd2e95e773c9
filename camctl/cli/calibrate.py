"""`camctl calibrate`: measuring a real camera."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli import parameters as kinds
from camctl.cli.commands import LazyGroup, command
from camctl.cli.output import fields, progress_bar, say, say_json, share_only, warn

if TYPE_CHECKING:
    from camctl.profile import DelayRecord

calibrate = LazyGroup(
    "calibrate",
    help="Measure what a camera does not say of itself; its profile keeps it.",
    examples=(
        ("camctl calibrate delay --camera v4l2:/dev/video0", "how late its controls are"),
        ("camctl profile list", "what is known of each camera"),
    ),
)


@command(
    parent=calibrate,
    examples=(
        ("camctl calibrate delay --camera v4l2:/dev/video0", "a webcam, in its usual format"),
        (
            "camctl calibrate delay --camera v4l2:/dev/video0 -O format=yuyv --size 640x480",
            "in another format: a delay belongs to format, size and frame rate",
        ),
        ("camctl calibrate delay --sensor consumer --trials 40", "a simulated one, thoroughly"),
    ),
)
@options.camera
@options.camera_words
@options.simulation
@click.option(
    "--trials",
    type=kinds.Whole("a whole number of trials, 2 to 10000", least=2, most=10_000),
    metavar="N",
    default=12,
    help="Steps of exposure to look at.",
)
@options.as_json
def delay(
    camera_id: str,
    words: tuple[tuple[str, str], ...],
    scene: str | None,
    sensor: str | None,
    size: str | None,
    seed: int | None,
    real_time: bool,
    trials: int,
    as_json: bool,
) -> None:
    """Measure how many frames pass until a new exposure shows, and keep it.

    Point the camera at something steady under steady light first.  A trial takes some 20 frames.
    Where the delay is constant, n exposures then take n frames and the delay; where it is not, or
    is not known, the stream settles for each exposure.
    """
    from camctl.backends import open_camera
    from camctl.calibration.delay import measure_delay
    from camctl.camera import StreamingCamera
    from camctl.profile import Profile, change_profile

    beside = options.camera_options(
        words, scene=scene, sensor=sensor, size=size, seed=seed, real_time=real_time
    )
    with open_camera(camera_id, beside) as camera, progress_bar("stepping the exposure") as tick:
        record = measure_delay(camera, trials=trials, progress=share_only(tick), warn=warn)
        assert isinstance(camera, StreamingCamera)  # or there was nothing to measure
        info, mode = camera.info, camera.mode

    def keep(profile: Profile) -> None:
        profile.delays[mode] = record

    file = change_profile(info, keep)
    if as_json:
        who = {name: getattr(info, name) for name in ("id", "make", "model", "serial", "driver")}
        say_json({"camera": who, "mode": mode, **record.model_dump(), "file": file})
        return
    say(
        fields(
            [
                ("camera", f"{info.make} {info.model} ({info.id})"),
                ("mode", mode),
                ("control delay", f"{delay_text(record)}, in {record.trials} trials"),
                ("so that", _so_that(record)),
                ("kept in", str(file)),
            ]
        )
    )


def delay_text(record: DelayRecord) -> str:
    """Return a delay as a person says it: 2 frames; 1 to 3 frames, not constant."""
    if record.frames is None:
        return f"{record.smallest} to {record.largest} frames, not constant"
    return f"{record.frames} frame{'' if record.frames == 1 else 's'}"


def _so_that(record: DelayRecord) -> str:
    if record.frames is None:
        return f"the stream settles for {record.largest} frames at each exposure"
    return f"n exposures take n + {record.frames} frames" if record.frames else "no frame is lost"
