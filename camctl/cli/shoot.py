"""`camctl shoot`: meter, look up, shoot, sum, write the result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli import parameters as kinds
from camctl.cli.capture_output import capture_lines, fresh_directory, source_of
from camctl.cli.commands import command
from camctl.cli.output import capture_progress, say, say_json, warn
from camctl.errors import DataError, UsageError

if TYPE_CHECKING:
    from camctl.captures.report import CaptureReport
    from camctl.captures.request import CaptureRequest

MOST_WITHIN_TOLERANCE = 6
WITH_RESUME = frozenset({"resume_directory", "as_json"})


@command(
    examples=(
        ("camctl shoot", "the simulated camera: tile floor, equal contrast, 3 exposures"),
        ("camctl shoot --range high -n 4 --sensor phone -o hall", "10 bits, Bayer mosaic"),
        ("camctl shoot --scene memorial.hdr --response gamma", "any radiance map as the scene"),
        ("camctl shoot --camera v4l2:/dev/video0 -O format=y16", "a webcam, in 16 bits"),
        ("camctl shoot --resume hall", "go on where a capture was interrupted"),
    )
)
@options.camera
@options.camera_words
@click.option(
    "--response",
    type=kinds.Name("response", (*options.RESPONSES, "auto")),
    default="log",
    metavar="linear|gamma|log|auto",
    help="How brightness shall follow light; log gives equal contrast in shadows and highlights, "
    "auto gives most levels to the light that the scene holds most of.",
)
@options.dynamic_range
@options.count
@click.option(
    "--tolerance",
    type=kinds.Number("a number of levels from 0", least=0),
    metavar="X",
    help="Take the fewest exposures, 6 or -n at most, that leave no more than X of the wanted "
    "levels missing; needs --levels.",
)
@click.option(
    "--time-budget",
    "time_budget_s",
    type=kinds.Seconds(),
    metavar="SECONDS",
    help="Keep the shutter open no longer than this in all.",
)
@click.option(
    "--ratios",
    type=kinds.Ratios(),
    metavar="A,B,...",
    help="Exposures of your own, relative to one another, instead of looked-up ones.",
)
@click.option(
    "--base",
    "base_s",
    type=kinds.Seconds(auto=True),
    default="auto",
    metavar="auto|SECONDS",
    help="Shutter time of the shortest exposure, for example 0.004 or 1/250; auto meters it so "
    "that highlights stay just below saturation.",
)
@click.option(
    "--compensation",
    "compensation_stops",
    type=kinds.Number("a finite number of stops"),
    default=0.0,
    metavar="STOPS",
    help="Make the shortest exposure longer (or shorter: -1 halves it).",
)
@click.option(
    "--table",
    "table_file",
    type=kinds.PATH,
    metavar="FILE",
    help="Look the exposures up in this table (see camctl table build).  [default: the shipped "
    "one; what it does not hold is solved once and kept]",
)
@options.levels_wanted
@options.shooting
@options.simulation
@click.option(
    "--simulation-tolerance",
    "tolerance_dn",
    type=kinds.Number("a number of DN from 0", least=0),
    metavar="DN",
    help="Let the simulator leave out effects that change the sum of the frames by no more than "
    "this.  [default: 0, all effects]",
)
@click.option(
    "-o",
    "--output",
    "directory",
    type=kinds.PATH,
    metavar="PATH",
    help="Folder for the result.  [default: capture-DATE-TIME here]",
)
@click.option("--force", is_flag=True, help="Replace an earlier capture in that folder.")
@click.option(
    "--resume",
    "resume_directory",
    type=kinds.PATH,
    metavar="DIR",
    help="Shoot only what is missing in DIR, as it was planned.",
)
@options.as_json
@click.pass_context
def shoot(
    context: click.Context,
    camera_id: str,
    words: tuple[tuple[str, str], ...],
    response: str,
    dynamic_range: float,
    count: int,
    tolerance: float | None,
    time_budget_s: float | None,
    ratios: tuple[float, ...] | None,
    base_s: float | None,
    compensation_stops: float,
    table_file: Path | None,
    levels_wanted: float | None,
    mains: str | None,
    use_aperture: bool,
    spend_shutter: bool,
    scene: str | None,
    sensor: str | None,
    size: str | None,
    seed: int | None,
    real_time: bool,
    tolerance_dn: float | None,
    directory: Path | None,
    force: bool,
    resume_directory: Path | None,
    as_json: bool,
) -> None:
    """Take a high-dynamic-range picture.

    Meters the scene, looks up which exposures serve the wanted picture best, chooses the best
    that the camera can really do, shoots them, and sums them while they arrive.  The result is a
    folder: frames as they came, their sum, a 16-bit image, a radiance map (.exr), a preview and a
    report (report.json).
    """
    named = options.given(context)
    if resume_directory is not None:
        if named - WITH_RESUME:
            extra = ", ".join(sorted(options.spelling(context, n) for n in named - WITH_RESUME))
            raise UsageError(f"--resume goes on as it was planned, without {extra}")
        report = _resume(resume_directory)
        directory = resume_directory
    else:
        if ratios is not None:
            if "count" in named and len(ratios) != count:
                raise UsageError(f"--ratios names {len(ratios)} exposures, -n says {count}")
            instead = named & {"table_file", "tolerance", "time_budget_s"}
            if instead:
                extra = ", ".join(sorted(options.spelling(context, name) for name in instead))
                raise UsageError(f"--ratios gives the exposures, without {extra}")
            if response == "auto":
                raise UsageError("--ratios goes with a response of your own, not with auto")
            count = len(ratios)
        elif tolerance is not None and "count" not in named:
            count = MOST_WITHIN_TOLERANCE
        from camctl.captures.request import CaptureRequest

        request = CaptureRequest(
            response=response,
            dynamic_range=dynamic_range,
            count=count,
            ratios=ratios,
            base_s=base_s,
            compensation_stops=compensation_stops,
            levels_wanted=levels_wanted,
            tolerance=tolerance,
            time_budget_s=time_budget_s,
            use_aperture=use_aperture,
            mains_hz=None if mains is None else float(mains),
            spend_shutter=spend_shutter,
        )
        beside = options.camera_options(
            words,
            scene=scene,
            sensor=sensor,
            size=size,
            seed=seed,
            real_time=real_time,
            tolerance_dn=tolerance_dn,
        )
        directory = fresh_directory() if directory is None else directory
        report = _shoot(camera_id, beside, request, table_file, directory, force)
    for warning in report.warnings:
        warn(warning)
    if as_json:
        say_json(report.model_dump(mode="json"))
    else:
        say(capture_lines(report, directory))


def _shoot(
    camera_id: str,
    beside: dict[str, str],
    request: CaptureRequest,
    table_file: Path | None,
    directory: Path,
    force: bool,
) -> CaptureReport:
    from camctl.backends import open_camera
    from camctl.captures.frame_store import FolderStore
    from camctl.captures.plan import plan_capture
    from camctl.captures.sequencer import capture
    from camctl.exposure.table import ExposureTable

    with open_camera(camera_id, beside) as camera, capture_progress() as progress:
        plan = None
        if table_file is not None:
            FolderStore.check_free(directory, overwrite=force)
            table = ExposureTable.load(table_file, camera.controls.levels)
            plan = plan_capture(camera, request, table=table)
        return capture(
            camera,
            request,
            directory,
            plan=plan,
            source=source_of(camera_id, beside),
            progress=progress,
            overwrite=force,
        )


def _resume(directory: Path) -> CaptureReport:
    from camctl.backends import open_camera
    from camctl.captures.frame_store import read_capture
    from camctl.captures.sequencer import resume

    source = read_capture(directory).source
    camera_id, beside = source.get("camera"), source.get("options")
    if not isinstance(camera_id, str) or not isinstance(beside, dict):
        raise DataError(
            f"{directory}/report.json does not say which camera took it",
            hint="it was not shot by `camctl shoot`; resume it with the program that took it",
        )
    with open_camera(camera_id, beside) as camera, capture_progress() as progress:
        return resume(camera, directory, progress=progress)
