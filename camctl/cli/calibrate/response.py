"""`camctl calibrate response`: the response of a camera from an exposure series."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.calibrate.result import SeriesOptions, measured, series_options, show
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, option
from camctl.cli.output import format_percent, format_table
from camctl.cli.parameter_types import PATH, Name, WholeNumber

if TYPE_CHECKING:
    from camctl.calibration.results import ResponseResult
    from camctl.profiles.response import ResponseRecord

_CHARTS = ("macbeth",)
_SHARES = (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0)
"""Brightness in the rows of the table, as shares of full scale."""


@command(
    examples=(
        ("camctl calibrate response --camera v4l2:/dev/video0", "a webcam before any still scene"),
        (
            "camctl calibrate response a.tif b.tif c.tif --times 1/60,1/15,1/4 -o curve.txt",
            "photographs; the curve is for --curve",
        ),
        ("camctl calibrate response hall", "the frames of a capture in the folder hall"),
        ("camctl calibrate response chart.jpg --chart macbeth", "one photograph of a chart"),
    ),
)
@series_options
@options.camera_options
@option(
    "-n --frames N", "Frames to shoot.", WholeNumber(least=2, most=64), field="count", default=8
)
@options.longest()
@option(
    "--estimate-ratios",
    "The exposures are only roughly known (30 %), or unknown: estimate them, too.",
)
@option(
    f"--chart {'|'.join(_CHARTS)}",
    "A chart in the picture, which is looked for: macbeth has 24 patches.",
    Name("chart", _CHARTS),
)
@option(
    "--patches FILE",
    "Patches in the picture: in each line x, y, width, height in pixels, from the upper left "
    "corner, and one reflectance, or three for R, G and B.",
    PATH,
)
@option(
    "--keep",
    "Keep the result though it is not exact enough, or though frames seem to show movement or "
    "wrong exposures.",
)
@option("-o --output FILE", "Write the curve for --curve.", PATH)
@options.as_json
def response(
    source: SeriesOptions,
    camera: CameraOptions,
    count: int,
    longest_s: float,
    estimate_ratios: bool,
    chart: str | None,
    patches: Path | None,
    keep: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Measure the response of a camera, from different exposures of any scene.

    The scene must not move and its light must be steady; it should have dark and bright parts and
    many shades between. No chart is needed. With --camera (or without FILES) a series is shot that
    suits the light, and the result is kept in the camera's profile if it is exact enough (7 %);
    FILES are photographs, or the folder of a complete capture. With --chart or --patches one
    photograph is enough; several are used together.
    """
    from camctl.calibrate import response as measure

    if patches is not None:
        options.refuse_together(click.get_current_context(), "--patches", {"chart"})
    source.check({"count", "longest_s"})
    result = measured(
        measure,
        camera,
        "shooting an exposure series",
        profile="exposures",
        source=source,
        how={"estimate_ratios": estimate_ratios, "chart": patches or chart, "keep": keep},
        count=count,
        longest_s=longest_s,
    )
    if result.camera is not None and result.is_exact:
        result = result.save()
    if output is not None:
        _write_curve(output, result)
    rows = [
        ("frames", str(result.frames)),
        ("agreement of the frames", format_percent(result.residual)),
    ]
    if estimate_ratios:
        ratios = ", ".join(f"{each:.4g}" for each in result.exposures)
        rows.append(("estimated exposures", ratios))
        if patches is None and chart is None:
            rows.append(("", "a power of them, with that power of the curve, would fit as well"))
    rows += [] if output is None else [("curve", str(output))]
    show(result, lambda: (_table(result), rows), as_json=as_json)


def _write_curve(path: Path, record: ResponseRecord) -> None:
    """Write the curve of a channel, green where there are three, in two columns."""
    import numpy as np

    from camctl.system.files import write_bytes

    levels = record.camera_response().levels
    brightness = (np.arange(1, levels.size + 1) - record.phase) / (levels.size + 1)
    lines = [f"# irradiance and brightness, channel {record.main_channel.name}", "0 0"]
    lines += [f"{each:.9g} {at:.9g}" for each, at in zip(levels, brightness, strict=True)]
    lines.append("1 1")
    write_bytes(path, ("\n".join(lines) + "\n").encode())


def _table(record: ResponseResult) -> str:
    """Return one row for some brightness levels: irradiance of each channel, and its confidence."""
    import numpy as np

    headings = ["brightness"]
    for channel in record.channels:
        headings += [f"irradiance {channel.name}", "95 %"]
    rows = []
    for share in _SHARES:
        row = [f"{share:.2f}"]
        for channel in record.channels:
            row.append(f"{np.interp(share, channel.brightness, channel.irradiance):.5f}")
            if channel.confidence is None:
                row.append("unknown")
            else:
                width = np.interp(share, channel.brightness, channel.confidence)
                row.append(f"+-{width:.2%}")
        rows.append(row)
    notes = [
        f"{each.name}: black {each.black}, white {each.white}, "
        + ("clips there" if each.saturates else "no saturated samples seen")
        + f"; measured from {each.measured[0]:.1%} to {each.measured[1]:.1%} of full scale"
        for each in record.channels
    ]
    right = tuple(range(len(headings)))
    return "\n".join([format_table(headings, rows, right_aligned=right), "", *notes])
