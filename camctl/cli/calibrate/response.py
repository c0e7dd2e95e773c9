"""`camctl calibrate response`: the response of a camera from an exposure series."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.calibrate.exposure_series import SeriesOptions, series_of_files, series_options
from camctl.cli.calibrate.result import Result
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, option_group
from camctl.cli.output import (
    format_percent,
    format_table,
    print_finding,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import PATH, Name, WholeNumber
from camctl.errors import DataError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from camctl.calibration.response.estimate import ResponseEstimate
    from camctl.calibration.response.series import Series
    from camctl.findings import Finding
    from camctl.interface.camera import CameraInfo
    from camctl.profiles.response import ResponseRecord

_CHARTS = ("macbeth",)


@dataclass(frozen=True)
class EstimateOptions:
    """How the response is estimated."""

    estimate_ratios: bool
    chart: str | None
    patches: Path | None

    @property
    def has_chart(self) -> bool:
        """Whether a chart is before the camera."""
        return self.chart is not None or self.patches is not None


_estimate_options = option_group(
    EstimateOptions,
    "how",
    click.option(
        "--estimate-ratios",
        is_flag=True,
        help="The exposures are only roughly known (30 %), or unknown: estimate them, too.",
    ),
    click.option(
        "--chart",
        type=Name("chart", _CHARTS),
        metavar="|".join(_CHARTS),
        help="A chart in the picture, which is looked for: macbeth has 24 patches.",
    ),
    click.option(
        "--patches",
        type=PATH,
        metavar="FILE",
        help="Patches in the picture: in each line x, y, width, height in pixels, from the upper "
        "left corner, and the reflectance, or those in R, G and B.",
    ),
)


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
@click.option(
    "-n",
    "--frames",
    "count",
    type=WholeNumber(least=2, most=64),
    metavar="N",
    default=8,
    help="Frames to shoot.",
)
@options.longest()
@_estimate_options
@click.option(
    "--keep",
    is_flag=True,
    help="Keep the result though it is not exact enough, or though frames seem to show movement or "
    "wrong exposures.",
)
@click.option("-o", "output", type=PATH, metavar="FILE", help="Write the curve for --curve.")
@options.as_json
def response(
    source: SeriesOptions,
    camera: CameraOptions,
    count: int,
    longest_s: float,
    how: EstimateOptions,
    keep: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Measure the response of a camera, from different exposures of any scene.

    The scene must not move and its light must be steady; it should have dark and bright parts and
    many shades between. No chart is needed. With --camera (or without FILES) a series is shot that
    suits the light, and the result is kept in the camera's profile if it is exact enough (7 %);
    FILES are photographs, or the folder of a complete capture. With --chart or --patches one
    photograph is enough; with several, what they say is added.
    """
    context = click.get_current_context()
    names = options.given(context)
    if how.patches is not None:
        options.refuse_together(context, "--patches", names & {"chart"})
    if source.files:
        others = names & (options.CAMERA_PARAMETERS | {"count", "longest_s"})
        options.refuse_together(context, "FILES", others)
        info, mode, series, frames = series_of_files(
            source, keep=how.has_chart, needs_times=_needs_times(source, how)
        )
    else:
        hint = "name the files, or leave it out"
        options.refuse_together(context, "--camera", names & {"times", "black", "white"}, hint)
        info, mode, series, frames = _from_camera(camera, count, longest_s, how)
    try:
        estimate = _estimate(series, frames, how, keep)
    except DataError as error:
        if series.measured_exposures != "used":
            raise
        raise DataError(
            error.what,
            hint=f"{error.hint}; if the measured exposures in the camera's profile are wrong, "
            "leave them out with -O profile=none",
        ) from error
    findings = [*estimate.findings]
    record = estimate.record
    file = None
    if info is not None:
        inexact = None if keep else _inexact(series, record)
        if inexact is None:
            file = _keep(info, mode, record, series)
        else:
            findings.append(inexact)
    for finding in findings:
        print_finding(finding)
    if output is not None:
        _write_curve(output, record)
    content = _json(record) | {
        "exposures": estimate.exposures,
        "exponent_error": estimate.exponent_error,
        "residual": estimate.residual,
        "findings": [each.model_dump() for each in findings],
    }
    result = Result(info, mode, file)
    if as_json:
        result.print_json(content)
    else:
        rows = [] if output is None else [("curve", str(output))]
        result.print_text(_table(record), _rows(estimate, how), rows)


def _rows(estimate: ResponseEstimate, how: EstimateOptions) -> list[tuple[str, str]]:
    rows = [
        ("frames", str(estimate.record.frames)),
        ("agreement of the frames", format_percent(estimate.residual)),
    ]
    if how.estimate_ratios:
        ratios = ", ".join(f"{each:.4g}" for each in estimate.exposures)
        rows.append(("estimated exposures", ratios))
        if not how.has_chart:
            rows.append(("", "a power of them, with that power of the curve, would fit as well"))
    return rows


def _needs_times(source: SeriesOptions, how: EstimateOptions) -> bool:
    """Return whether the exposure times must be known."""
    return not how.estimate_ratios and not (how.has_chart and len(source.files) == 1)


def _from_camera(
    camera: CameraOptions, count: int, longest_s: float, how: EstimateOptions
) -> tuple[CameraInfo, str, Series, list[NDArray[Any]]]:
    from camctl.calibration.response.shooting import measure_response
    from camctl.profiles.exposures import exposure_mode

    with (
        camera.open(profile="exposures") as opened,
        progress_bar("shooting an exposure series") as bar,
    ):
        frames: list[NDArray[Any]] = []
        series = measure_response(
            opened,
            count=count,
            longest_s=longest_s,
            frames=frames if how.has_chart else None,
            progress=without_stage(bar),
        )
        return opened.info, exposure_mode(opened.controls), series, frames


def _estimate(
    series: Series, frames: list[NDArray[Any]], how: EstimateOptions, keep: bool
) -> ResponseEstimate:
    from camctl.calibration.response.chart import find_macbeth, read_patches
    from camctl.calibration.response.estimate import Chart, estimate_response

    chart = None
    if how.patches is not None:
        chart = Chart(read_patches(how.patches), frames)
    elif how.has_chart:
        chart = Chart(find_macbeth(frames, series.layout), frames)
    return estimate_response(series, estimate_ratios=how.estimate_ratios, chart=chart, is_kept=keep)


def _inexact(series: Series, record: ResponseRecord) -> Finding | None:
    """Return why a response is not exact enough for the profile; None where it is."""
    from camctl.calibration.response.checks import KEPT, helpful_exposures, intervals_of
    from camctl.findings import Finding

    intervals = intervals_of(record)
    if intervals is None or intervals.widest <= KEPT:
        return None
    return Finding(
        code="response_inexact",
        value=intervals.widest,
        details={
            "brightness": intervals.brightness,
            "needed": KEPT,
            "help": helpful_exposures(series.exposures, intervals.brightness),
        },
        remedies={"keep": True},
    )


def _keep(info: CameraInfo, mode: str, record: ResponseRecord, series: Series) -> Path:
    from camctl.profiles.profile import Profile, change_profile

    def keep(profile: Profile) -> None:
        profile.responses[mode] = record
        if series.measured_exposures == "ignored":
            profile.exposures.pop(mode, None)

    return change_profile(info, keep)


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


def _json(record: ResponseRecord) -> dict[str, Any]:
    from camctl.calibration.intervals import Z_95

    described = record.model_dump()
    for measured, channel in zip(record.channels, described["channels"], strict=True):
        channel["levels"] = measured.level_table(record.phase).tolist()
        deviation = channel["deviation"]
        channel["confidence"] = None if deviation is None else [Z_95 * each for each in deviation]
    return described


def _table(record: ResponseRecord) -> str:
    """Return one row for some brightness levels: irradiance of each channel, and its confidence."""
    import numpy as np

    from camctl.calibration.intervals import Z_95

    headings = ["brightness"]
    for channel in record.channels:
        headings += [f"irradiance {channel.name}", "95 %"]
    rows = []
    for share in (0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 1.0):
        row = [f"{share:.2f}"]
        for channel in record.channels:
            row.append(f"{np.interp(share, channel.brightness, channel.irradiance):.5f}")
            if channel.deviation is None:
                row.append("unknown")
            else:
                width = np.interp(share, channel.brightness, channel.deviation)
                row.append(f"+-{Z_95 * width:.2%}")
        rows.append(row)
    notes = [
        f"{each.name}: black {each.black}, white {each.white}, "
        + ("clips there" if each.saturates else "no saturated samples seen")
        + f"; measured from {each.measured[0]:.1%} to {each.measured[1]:.1%} of full scale"
        for each in record.channels
    ]
    right = tuple(range(len(headings)))
    return "\n".join([format_table(headings, rows, right_aligned=right), "", *notes])
