"""`camctl shoot`: meter, look up the exposures, shoot, sum, and write the result."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.capture_output import capture_progress, capture_text, new_directory
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, LightOptions
from camctl.cli.output import print_json, print_text, print_warning
from camctl.cli.parameter_types import PATH, Number, Ratios, Seconds
from camctl.cli.response_options import DesiredOptions, desired_options, levels_wanted
from camctl.errors import DataError, UsageError

if TYPE_CHECKING:
    from camctl.captures.report import CaptureReport
    from camctl.captures.request import CaptureRequest

MOST_FOR_TOLERANCE = 6
"""Exposures that --tolerance may take where -n is not given."""


@dataclass(frozen=True)
class ExposureOptions:
    """How many exposures are taken, and where they come from."""

    count: int
    tolerance: float | None
    time_budget_s: float | None
    ratios: tuple[float, ...] | None
    base_s: float | None
    compensation_stops: float
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
            if self.tolerance is not None and not count_given:
                return replace(self, count=MOST_FOR_TOLERANCE)
            return self
        if count_given and len(self.ratios) != self.count:
            raise UsageError(
                f"--ratios has {len(self.ratios)} exposures but -n is {self.count}",
                hint="leave -n out",
            )
        options.refuse_together(context, "--ratios", {"table_file", "tolerance", "time_budget_s"})
        if response == "auto":
            raise UsageError(
                "--ratios cannot be combined with --response auto", hint="name a response"
            )
        return replace(self, count=len(self.ratios))

    def request_fields(self) -> dict[str, Any]:
        """Return the fields of a `CaptureRequest`."""
        names = ("count", "tolerance", "time_budget_s", "ratios", "base_s", "compensation_stops")
        return {name: getattr(self, name) for name in (*names, "levels_wanted")}


exposure_options = options.option_group(
    ExposureOptions,
    "exposure",
    options.count,
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
        help="Longest total exposure time.",
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
        type=Number("a number of stops such as -1 or 0.5"),
        default="0",
        metavar="STOPS",
        help="Make the shortest exposure longer (or shorter: -1 halves it).",
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
        ("camctl shoot --scene room.hdr --gamma 0.45", "a radiance map as scene, any gamma"),
        ("camctl shoot --camera v4l2:/dev/video0 -O format=y16", "a webcam, in 16 bits"),
        ("camctl shoot --resume hall", "complete a capture that was interrupted"),
    )
)
@options.camera_options
@desired_options(auto=True)
@exposure_options
@options.light_options
@click.option(
    "--simulation-tolerance",
    type=Number("a number of DN of at least 0", least=0),
    metavar="DN",
    help="Let the simulator leave out effects that change the sum of the frames by at most this.  "
    "[default: 0, all effects]",
)
@click.option(
    "-o",
    "--output",
    "directory",
    type=PATH,
    metavar="PATH",
    help="Folder for the result.  [default: capture-DATE-TIME in the working directory]",
)
@click.option("--force", is_flag=True, help="Replace an earlier capture in that folder.")
@click.option(
    "--resume",
    "resume_directory",
    type=PATH,
    metavar="DIR",
    help="Shoot the missing frames of the interrupted capture in DIR, with its options.",
)
@options.as_json
def shoot(
    camera: CameraOptions,
    desired: DesiredOptions,
    exposure: ExposureOptions,
    light: LightOptions,
    directory: Path | None,
    force: bool,
    resume_directory: Path | None,
    as_json: bool,
) -> None:
    """Take a picture of high dynamic range.

    Meters the scene, looks up the exposures that give the most accurate picture, chooses the best
    among the settings of the camera, shoots them, and sums the frames as they arrive. The result is
    a folder: the frames, their sum, a 16-bit image, a radiance map (.exr), a preview and a report
    (report.json).
    """
    if resume_directory is not None:
        directory = resume_directory
        report = _resume(resume_directory)
    else:
        from camctl.captures.request import CaptureRequest

        exposure = exposure.check_ratios(desired.response)
        request = CaptureRequest(
            **desired.request_fields(), **exposure.request_fields(), **light.request_fields()
        )
        directory = new_directory() if directory is None else directory
        report = _shoot(camera, request, exposure.table_file, directory, force=force)
    for warning in report.warnings:
        print_warning(warning)
    if as_json:
        print_json(report.model_dump(mode="json"))
    else:
        print_text(capture_text(report, directory))


def _shoot(
    camera_options: CameraOptions,
    request: CaptureRequest,
    table_file: Path | None,
    directory: Path,
    *,
    force: bool,
) -> CaptureReport:
    from camctl.captures.frame_store import FolderStore
    from camctl.captures.plan import plan_capture
    from camctl.captures.sequencer import capture
    from camctl.exposure.table import ExposureTable

    with camera_options.open() as camera, capture_progress() as progress:
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
            source=camera_options.source(),
            progress=progress,
            overwrite=force,
        )


def _resume(directory: Path) -> CaptureReport:
    from camctl.backends import open_camera
    from camctl.captures.frame_store import read_capture
    from camctl.captures.sequencer import resume

    context = click.get_current_context()
    others = options.given(context) - {"resume_directory", "as_json"}
    options.refuse_together(
        context, "--resume", others, "the capture continues with the options it was started with"
    )
    report = read_capture(directory)
    if report.status == "complete":
        raise DataError(
            f"the capture in {directory} is complete: all {len(report.frames)} frames were shot",
            hint="take another picture with camctl shoot",
        )
    camera_id, camera_options = report.source.get("camera"), report.source.get("options")
    if not isinstance(camera_id, str) or not isinstance(camera_options, dict):
        raise DataError(
            f"{directory}/report.json does not name the camera to open",
            hint="the capture was not made by camctl shoot; resume it with camctl.resume in Python",
        )
    with open_camera(camera_id, camera_options) as camera, capture_progress() as progress:
        return resume(camera, directory, progress=progress)
