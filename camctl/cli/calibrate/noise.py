"""`camctl calibrate noise`: the noise of a camera, from pairs of frames of any scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.calibrate.result import Rows, SeriesOptions, measured, series_options, show
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions, option
from camctl.cli.output import format_table
from camctl.cli.parameter_types import PATH, Text, WholeNumber

if TYPE_CHECKING:
    from camctl.calibration.results import NoiseResult
    from camctl.profiles.noise import Figure, NoiseRecord


@command(
    examples=(
        ("camctl calibrate noise --camera v4l2:/dev/video0", "a webcam before any still scene"),
        ("camctl calibrate noise --sensor ccd --scene uniform --flat", "an evenly lit surface"),
        ("camctl calibrate noise --camera ptp --dark", "afterwards, with the lens cap on"),
        (
            "camctl calibrate noise a.tif b.tif c.tif d.tif --times 1/60,1/60,1/8,1/8",
            "photographs, two of each exposure",
        ),
    ),
)
@series_options
@options.camera_options
@option(
    "--flat",
    "An evenly lit surface fills the picture, out of focus: measure the PRNU, too.",
    field="is_flat",
)
@option(
    "--dark",
    "The lens cap is on: measure dark current, DSNU and hot pixels, in addition to an earlier "
    "calibration with light.",
    field="is_dark",
)
@option(
    "-n --exposures N",
    "Exposures at each gain, of two frames each.",
    WholeNumber(least=3, most=64),
    field="count",
    default=12,
)
@options.longest("Longest shutter time to use.  [default: 2; with --dark 4]", default=None)
@option(
    "--response NAME",
    "Response of the camera or of FILES: linear, srgb, rec709, or power:GAMMA.  [default: as "
    "measured, else as the camera states; for JPEG files srgb, for others linear]",
    Text(),
)
@option("--report FILE.md", "Write the figures of EMVA 1288 to a Markdown file.", PATH)
@options.force
@options.as_json
def noise(
    source: SeriesOptions,
    camera: CameraOptions,
    is_flat: bool,
    is_dark: bool,
    count: int,
    longest_s: float | None,
    response: str | None,
    report: Path | None,
    force: bool,
    as_json: bool,
) -> None:
    """Measure the noise of a camera: electrons per level, read noise, saturation.

    Point the camera at a scene that does not move, with dark and bright parts and smooth shades, in
    steady light; no chart is needed. Two frames of each of many exposures are compared: what
    differs is noise. The result is kept in the camera's profile. For more, measure again with
    --flat before an evenly lit surface, and with --dark with the lens cap on.
    """
    from camctl import calibrate
    from camctl.system.files import check_new, write_bytes

    if report is not None:
        check_new(report, overwrite=force)
    source.check({"count", "longest_s", "is_dark"})
    longest: dict[str, Any] = {} if longest_s is None else {"longest_s": longest_s}
    if is_dark:
        context = click.get_current_context()
        options.refuse_together(context, "--dark", {"is_flat", "count", "response"})
        result = measured(calibrate.dark, camera, "shooting dark frames", **longest)
    else:
        result = measured(
            calibrate.noise,
            camera,
            "shooting pairs",
            profile="response",
            source=source,
            how={"response": response, "is_flat": is_flat},
            count=count,
            **longest,
        )
    if result.camera is not None:
        result = result.save()
    if report is not None:
        write_bytes(report, result.emva_report().encode())
    written = [] if report is None else [("report", str(report))]
    show(result, lambda: (_table(result), [*_rows(result), *written]), as_json=as_json)


def _table(record: NoiseRecord) -> str:
    """Return one row for each gain."""
    rows = [
        (
            f"{each.gain:.4g}",
            *_cells(each.conversion_e_per_dn),
            *_cells(each.read_noise_e),
            f"{each.read_noise_e.value / each.conversion_e_per_dn.value:.3g}",
        )
        for each in record.gains
    ]
    headings = ("gain", "electrons per level", "95 %", "read noise, e-", "95 %", "in levels")
    return format_table(headings, rows, right_aligned=(0, 1, 3, 5))


def _cells(figure: Figure) -> tuple[str, str]:
    return f"{figure.value:.4g}", f"{figure.low:.4g} to {figure.high:.4g}"


def _text(figure: Figure, unit: str = "") -> str:
    value, interval = _cells(figure)
    return f"{value}{unit} (95 %: {interval})"


def _rows(result: NoiseResult) -> Rows:
    seen = "" if result.saturates else "; no saturated samples seen: of the stated white level"
    emva, dark = result.emva1288, result.dark
    yield "saturation", _text(result.full_well_e, " e-") + seen
    yield "least signal", _text(emva["sensitivity_threshold_e"], " e-")
    yield "dynamic range", _text(emva["dynamic_range"])
    yield "largest signal to noise", _text(emva["snr_max"])
    if result.prnu is None:
        yield "PRNU", "not measured: use --flat before an evenly lit surface"
    else:
        yield "PRNU", _text(result.prnu.scaled(100), " %")
    if dark is None:
        yield "dark current, DSNU", "not measured: put the lens cap on, and use --dark"
        return
    yield "dark current", _text(dark.dark_current_e_s, " e-/s")
    yield "DSNU", _text(dark.dsnu_e, " e-")
    if dark.dcnu_e_s:
        yield "DCNU", _text(dark.dcnu_e_s, " e-/s")
    yield "hot pixels", str(len(dark.hot_pixels))
