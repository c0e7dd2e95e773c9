"""`camctl shoot`: meter, look up the exposures, shoot, sum, and write the result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.capture_output import (
    UNTRUSTWORTHY,
    capture_progress,
    capture_text,
    draws_bars,
    new_directory,
    noting_completion,
    simulation_text,
)
from camctl.cli.commands import command
from camctl.cli.light_options import LightOptions, light_options
from camctl.cli.options import CameraOptions
from camctl.cli.output import print_finding, print_json, print_text, print_warning
from camctl.cli.parameter_types import PATH, Number, Ratios, Seconds
from camctl.cli.response_options import DesiredOptions, desired_options, levels_wanted
from camctl.cli.resumed_camera import refuse_other_options, resumed_camera
from camctl.cli.series_options import SeriesRequest, series_options
from camctl.errors import DataError, UsageError

if TYPE_CHECKING:
    from camctl.records.report import CaptureReport
    from camctl.records.request import CaptureRequest

    _Complete = Callable[[CaptureReport], CaptureReport]

MOST_FOR_TOLERANCE = 6
"""Exposures that --tolerance may take where -n is not given."""

#: Options that are no fields of a `CaptureRequest`, or have another name there.
_OTHER_NAMES = {"objective_kind", "table_file"}


@dataclass(frozen=True)
class ExposureOptions:
    """How many exposures are taken, and where they come from."""

    count: int | None
    objective_kind: str | None
    accuracy: float | None
    tolerance: float | None
    time_budget_s: float | None
    ratios: tuple[float, ...] | None
    base_s: float | None
    compensation_stops: float
    clip_percent: float | None
    table_file: Path | None
    levels_wanted: float | None

    def check_ratios(self, response: str) -> ExposureOptions:
        """Return the options with the number of exposures that --ratios and --tolerance imply.

        Raises:
            UsageError: --ratios contradicts another option
        """
        context = click.get_current_context()
        count_given = "count" in options.given(context)
        if self.ratios is None:
            if count_given:
                return self
            return replace(self, count=None if self.tolerance is None else MOST_FOR_TOLERANCE)
        if count_given and len(self.ratios) != self.count:
            raise UsageError(
                f"--ratios has {len(self.ratios)} exposures but -n is {self.count}",
                hint="leave -n out",
            )
        others = {"table_file", "tolerance", "time_budget_s", "objective_kind", "accuracy"}
        options.refuse_together(context, "--ratios", others)
        if response == "auto":
            raise UsageError(
                "--ratios cannot be combined with --response auto", hint="name a response"
            )
        return replace(self, count=len(self.ratios))

    def request_fields(self) -> dict[str, Any]:
        """Return the fields of a `CaptureRequest`."""
        fields = {name: value for name, value in vars(self).items() if name not in _OTHER_NAMES}
        return {**fields, "objective": self.objective_kind}


exposure_options = options.option_group(
    ExposureOptions,
    "exposure",
    options.count,
    options.objective_kind,
    options.accuracy,
    click.option(
        "--tolerance",
        type=Number("a number of levels of at least 0", least=0),
        metavar="X",
        help="Take the fewest exposures, at most 6 or -n, with at most X desired levels missing; "
        "needs --levels.",
    ),
    click.option(
        "--time-budget",
        "time_budget_s",
        type=Seconds(),
        metavar="SECONDS",
        help="Longest time from the first frame's request until the last frame has arrived; chosen "
        "by accuracy, with as many exposures as are best in it, up to 6, unless -n is given.",
    ),
    click.option(
        "--ratios",
        type=Ratios(),
        metavar="A,B,...",
        help="Exposures, relative to each other, instead of those looked up.",
    ),
    click.option(
        "--base",
        "base_s",
        type=Seconds(auto=True),
        default="auto",
        metavar="auto|SECONDS",
        help="Shutter time of the shortest exposure, for example 0.004 or 1/250; auto meters it "
        "so that highlights are just below saturation.",
    ),
    click.option(
        "--compensation",
        "compensation_stops",
        type=Number("a number of stops from -64 to 64, such as -1 or 0.5", least=-64, most=64),
        default="0",
        metavar="STOPS",
        help="Make the shortest exposure longer (or shorter: -1 halves it).",
    ),
    click.option(
        "--clip",
        "clip_percent",
        type=Number("a percentage from 0 to 50", least=0, most=50),
        metavar="PERCENT",
        help="Share of the picture, the brightest, that may be saturated in every frame.  "
        "[default: lamps and reflections: at most 0.5 %, if the rest is two stops darker]",
    ),
    click.option(
        "--table",
        "table_file",
        type=PATH,
        metavar="FILE",
        help="Look the exposures up in this table (see camctl table build).  [default: the "
        "built-in one; exposures that it lacks are computed once and kept]",
    ),
    levels_wanted,
)


@command(
    examples=(
        ("camctl shoot", "the simulated camera: tile floor, equal contrast, 3 exposures"),
        ("camctl shoot --range high -n 4 --sensor phone -o hall", "10 bits, Bayer mosaic"),
        ("camctl shoot --camera v4l2:/dev/video0 -O format=y16", "a webcam, in 16 bits"),
        ("camctl shoot --repeat 50 --interval 60 -o day", "a series, one picture a minute"),
        ("camctl shoot --resume hall", "complete a capture or a series that was interrupted"),
    )
)
@options.camera_options
@desired_options(auto=True, has_light=True)
@exposure_options
@light_options(series=True)
@click.option(
    "--simulation-tolerance",
    type=Number("a number of DN of at least 0", least=0),
    metavar="DN",
    help="Let the simulator leave out effects that change the sum of the frames by at most this.  "
    "[default: 0, all effects]",
)
@click.option(
    "--explain",
    is_flag=True,
    help="Show which effects of the simulated sensor each frame lacks, and what that can change.",
)
@options.result_folder("capture")
@click.option(
    "--preview-only",
    is_flag=True,
    help="Shoot nothing: write one picture that shows the scene, as the camera sees it now, in the "
    "three responses side by side, to -o FILE.png.  [default: preview-DATE-TIME.png]",
)
@series_options
@click.option(
    "--resume",
    "resume_directory",
    type=PATH,
    metavar="DIR",
    help="Shoot the missing frames of the interrupted capture or series in DIR, with its options, "
    "and with the camera that it was begun with, unless --camera and its options name the camera "
    "again.",
)
@options.as_json
def shoot(
    camera: CameraOptions,
    desired: DesiredOptions,
    exposure: ExposureOptions,
    light: LightOptions,
    series: SeriesRequest,
    directory: Path | None,
    force: bool,
    preview_only: bool,
    explain: bool,
    resume_directory: Path | None,
    as_json: bool,
) -> None:
    """Take a picture of high dynamic range.

    Meters the scene, looks up the exposures that give the most accurate picture, chooses the best
    among the settings of the camera, shoots them, and sums the frames as they arrive. Where the
    camera's noise is known, accuracy counts it in, otherwise quantisation alone. The result is a
    folder: the frames, their sum, a 16-bit image, a radiance map (.exr), a preview and a report
    (report.json). The exit status is 3 where the pixels of the frames contradict their exposures:
    the files are there, and not trustworthy.
    """
    series.check(light.metering, is_resumed=resume_directory is not None)
    if resume_directory is not None and (resume_directory / "series.json").exists():
        from camctl.cli.series import continued_series

        continued_series(resume_directory, series, camera, as_json=as_json)
        return
    if resume_directory is not None:
        directory = resume_directory
        take = partial(_resume, resume_directory, camera)
    else:
        from camctl.records.request import CaptureRequest

        exposure = exposure.check_ratios(desired.response)
        request = CaptureRequest(
            **desired.request_fields(),
            **exposure.request_fields(),
            **light.request_fields(),
        )
        if preview_only:
            from camctl.cli.preview_only import show_responses

            options.refuse_together(click.get_current_context(), "--preview-only", {"table_file"})
            if series.is_series:
                raise UsageError("--preview-only cannot be combined with a series")
            show_responses(camera, request, directory, force=force, as_json=as_json)
            return
        if series.is_series:
            from camctl.cli.series import new_series

            options.refuse_together(click.get_current_context(), "a series", {"force"})
            directory = new_directory(kind="series") if directory is None else directory
            chosen = series.options(light.metering)
            new_series(
                camera, request, series, chosen, exposure.table_file, directory, as_json=as_json
            )
            return
        directory = new_directory() if directory is None else directory
        take = partial(_shoot, camera, request, exposure.table_file, directory, force=force)
    with noting_completion(directory) as complete:
        report = take(complete)
        for finding in report.findings:
            print_finding(finding)
        if report.untrustworthy_because is not None:
            print_warning(f"not trustworthy: {report.untrustworthy_because}")
        if as_json:
            print_json(report.model_dump(mode="json"))
        else:
            print_text(capture_text(report, directory, with_bars=draws_bars()))
            if explain:
                print_text("\n" + simulation_text(report))
    if not report.trustworthy:
        click.get_current_context().exit(UNTRUSTWORTHY)


def _shoot(
    camera_options: CameraOptions,
    request: CaptureRequest,
    table_file: Path | None,
    directory: Path,
    complete: _Complete,
    *,
    force: bool,
) -> CaptureReport:
    from camctl.captures.plan import plan_capture
    from camctl.captures.sequencer import capture
    from camctl.exposure.table import ExposureTable
    from camctl.records.folder_store import FolderStore

    with camera_options.open() as camera, capture_progress() as progress:
        plan = None
        if table_file is not None:
            FolderStore.check_free(directory, overwrite=force)
            table = ExposureTable.load(table_file, camera.controls.levels)
            plan = plan_capture(camera, request, table=table)
        report = complete(
            capture(
                camera,
                request,
                directory,
                plan=plan,
                source=camera_options.source(),
                progress=progress,
                overwrite=force,
            )
        )
        if (unused := camera_options.unused_faults(camera)) is not None:
            print_warning(unused)
        return report


def _resume(directory: Path, camera_options: CameraOptions, complete: _Complete) -> CaptureReport:
    from camctl.captures.sequencer import already_complete, resume
    from camctl.records.folder_store import read_capture

    refuse_other_options()
    report = read_capture(directory)
    if report.status == "complete":
        raise already_complete(directory, report)
    if not report.repeatable:
        raise DataError(
            f"{directory} is no capture of a camera, but was begun by camctl merge",
            hint="merge the photographs again, with --force",
        )
    opened = resumed_camera(camera_options, report.source, directory, "report.json")
    with opened as camera, capture_progress() as progress:
        return complete(resume(camera, directory, progress=progress))
