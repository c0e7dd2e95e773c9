"""`camctl calibrate colour`: the colours of a camera from a chart."""

from __future__ import annotations

from typing import TYPE_CHECKING

from camctl.cli import options
from camctl.cli.calibrate.result import Rows, SeriesOptions, measured, series_options, show
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, option
from camctl.cli.output import format_table
from camctl.cli.parameter_types import Text, WholeNumber

if TYPE_CHECKING:
    from camctl.calibration.results import ColourResult


@command(
    examples=(
        ("camctl calibrate colour --camera v4l2:/dev/video0", "a chart fills half of the picture"),
        ("camctl calibrate colour chart.dng", "one photograph of a chart"),
        ("camctl calibrate colour --scene colour-chart --sensor consumer", "a simulated one"),
    ),
)
@series_options
@options.camera_options
@option(
    "-n --frames N", "Frames to shoot.", WholeNumber(least=2, most=64), field="count", default=4
)
@options.longest()
@option(
    "--response NAME",
    "Response of the camera: linear, srgb, rec709, or power:GAMMA.  [default: as measured, else "
    "as the camera states; for JPEG files srgb, for others linear]",
    Text(),
)
@options.as_json
def colour(
    source: SeriesOptions,
    camera: CameraOptions,
    count: int,
    longest_s: float,
    response: str | None,
    as_json: bool,
) -> None:
    """Measure the colours of a camera with a Macbeth chart of 24 patches.

    The chart is looked for; it should fill half of the picture or more, in even light without
    reflections. The result is the white balance of this light, and a matrix from R, G and B of the
    camera to linear BT.709 (sRGB); with --camera (or without FILES) it is kept in the profile of
    the camera, and pictures of later captures have true colours. FILES are photographs, or the
    folder of a complete capture. The response must be known: measure it first with
    camctl calibrate response.
    """
    from camctl.calibrate import colour as measure

    source.check({"count", "longest_s"})
    result = measured(
        measure,
        camera,
        "shooting the chart",
        profile="exposures,response",
        source=source,
        how={"response": response},
        count=count,
        longest_s=longest_s,
    )
    if result.camera is not None:
        result = result.save()
    show(result, lambda: (_table(result), _rows(result)), as_json=as_json)


def _table(result: ColourResult) -> str:
    """Return the matrix: R, G and B of BT.709 in rows."""
    rows = [
        (name, *(f"{value:.4f}" for value in row))
        for name, row in zip(("red", "green", "blue"), result.matrix, strict=True)
    ]
    return format_table(("BT.709", "R", "G", "B"), rows, right_aligned=(1, 2, 3))


def _rows(result: ColourResult) -> Rows:
    yield "white balance", ", ".join(f"{each:.4f}" for each in result.white_balance)
    mean, largest = result.mean_difference, result.largest_difference
    yield "error (CIEDE2000)", f"{mean:.2f} in the mean, {largest:.2f} at most"
    yield "patches", f"{result.patches} of 24"
