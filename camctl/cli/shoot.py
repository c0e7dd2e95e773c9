"""`camctl shoot`: meter, look up the exposures, shoot, sum, and write the result."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from camctl.cli import options
from camctl.cli.capture_output import (
    Complete,
    capture_progress,
    new_directory,
    show_capture,
)
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions
from camctl.cli.output import print_warning
from camctl.cli.request_options import RequestOptions, request_options

if TYPE_CHECKING:
    from camctl.records.report import CaptureReport

PICTURE_OPTIONS = (
    "response",
    "gamma",
    "dynamic_range",
    "clip_percent",
    "count",
    "time_budget_s",
    "accuracy",
    "ratios",
    "base_s",
    "compensation_stops",
    "spend_shutter",
    "estimate_ratios",
)
"""The fields of a request that have options of their own where a picture is taken."""


@command(
    examples=(
        ("camctl shoot", "the simulated camera: a tile floor with equal contrast"),
        ("camctl shoot --range high -n 4 --sensor phone -o hall", "10 bits, Bayer mosaic"),
        ("camctl shoot --camera v4l2:/dev/video0 -O format=y16", "a webcam, in 16 bits"),
        ("camctl preview", "what the camera sees, in three responses; nothing is shot"),
        ("camctl resume hall", "complete a capture that was interrupted"),
    )
)
@options.camera_options
@request_options(*PICTURE_OPTIONS, "settings", has_light=True)
@options.result_folder("capture")
@options.as_json
def shoot(
    camera: CameraOptions,
    request: RequestOptions,
    directory: Path | None,
    force: bool,
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
    wanted = request.request()
    folder = new_directory() if directory is None else directory

    def take(complete: Complete) -> CaptureReport:
        from camctl.captures.plan import plan_capture
        from camctl.captures.sequencer import capture
        from camctl.exposure.table import ExposureTable
        from camctl.records.folder_store import FolderStore

        with camera.open() as opened, capture_progress() as progress:
            plan = None
            if request.table is not None:
                FolderStore.check_free(folder, overwrite=force)
                table = ExposureTable.load(request.table, opened.controls.levels)
                plan = plan_capture(opened, wanted, table=table)
            report = capture(
                opened,
                wanted,
                folder,
                plan=plan,
                source=camera.source(),
                progress=progress,
                overwrite=force,
            )
            complete(report)
            if (unused := camera.unused_faults(opened)) is not None:
                print_warning(unused)
            return report

    explain = "tolerance" in camera.camera_options()
    show_capture(take, folder, as_json=as_json, explain=explain)
