"""`camctl calibrate noise`: the noise of a camera, from pairs of frames of any scene."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from camctl.cli import options
from camctl.cli.calibrate.exposure_series import (
    SeriesOptions,
    StoredCapture,
    check_levels,
    levels_of,
    read_stills,
    response_named,
    response_of,
    series_options,
    stored_capture,
)
from camctl.cli.calibrate.result import Result
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions
from camctl.cli.output import (
    format_table,
    print_finding,
    progress_bar,
    without_stage,
)
from camctl.cli.parameter_types import WholeNumber
from camctl.errors import DataError, UsageError

if TYPE_CHECKING:
    from camctl.interface.camera import CameraInfo
    from camctl.profiles.noise import DarkRecord, Figure, NoiseRecord
    from camctl.profiles.profile import Profile


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
@click.option(
    "--flat",
    "is_flat",
    is_flag=True,
    help="An evenly lit surface fills the picture, out of focus: measure the PRNU, too.",
)
@click.option(
    "--dark",
    "is_dark",
    is_flag=True,
    help="The lens cap is on: measure dark current, DSNU and hot pixels, in addition to an earlier "
    "calibration with light.",
)
@click.option(
    "-n",
    "--exposures",
    "count",
    type=WholeNumber(least=3, most=64),
    metavar="N",
    default=12,
    help="Exposures at each gain, of two frames each.",
)
@options.longest("Longest shutter time to use.  [default: 2; with --dark 4]", default=None)
@click.option(
    "--response",
    metavar="NAME",
    help="Response of the camera or of FILES: linear, srgb, rec709, or power:GAMMA.  [default: the "
    "measured one of the camera, else that which it states; of FILES srgb for JPEG, else linear]",
)
@options.as_json
def noise(
    source: SeriesOptions,
    camera: CameraOptions,
    is_flat: bool,
    is_dark: bool,
    count: int,
    longest_s: float | None,
    response: str | None,
    as_json: bool,
) -> None:
    """Measure the noise of a camera: electrons per level, read noise, saturation.

    Point the camera at a scene that does not move, with dark and bright parts and smooth shades, in
    steady light; no chart is needed. Two frames of each of many exposures are compared: what
    differs is noise. The result is kept in the camera's profile. For more, measure again with
    --flat before an evenly lit surface, and with --dark with the lens cap on.
    """
    context = click.get_current_context()
    names = options.given(context)
    if source.files:
        others = names & (options.CAMERA_PARAMETERS | {"count", "longest_s", "is_dark"})
        options.refuse_together(context, "FILES", others)
        info, mode, record = _from_files(source, response, is_flat)
    else:
        hint = "name the files, or leave it out"
        others = names & {"times", "black", "white"}
        options.refuse_together(context, "--camera", others, hint)
        if is_dark:
            options.refuse_together(context, "--dark", names & {"is_flat", "count", "response"})
            info, mode, record = _dark(camera, longest_s)
        else:
            info, mode, record = _from_camera(camera, count, longest_s, is_flat, response)
    for finding in () if is_dark else record.findings:
        print_finding(finding)
    file = None if info is None else _keep(info, mode, record)
    result = Result(info, mode, file)
    if as_json:
        result.print_json(_json(record))
    else:
        result.print_text(_table(record), _rows(record))


def _from_camera(
    camera: CameraOptions,
    count: int,
    longest_s: float | None,
    is_flat: bool,
    response: str | None,
) -> tuple[CameraInfo, str, NoiseRecord]:
    from camctl.calibration.light import LONGEST_S
    from camctl.calibration.noise.shooting import measure_noise
    from camctl.profiles.exposures import exposure_mode

    with camera.open(profile="response") as opened, progress_bar("shooting pairs") as bar:
        record = measure_noise(
            opened,
            is_flat=is_flat,
            exposures=count,
            longest_s=longest_s or LONGEST_S,
            response=response_of(opened.controls, response),
            progress=without_stage(bar),
        )
        return opened.info, exposure_mode(opened.controls), record


def _dark(camera: CameraOptions, longest_s: float | None) -> tuple[CameraInfo, str, NoiseRecord]:
    from camctl.calibration.noise.dark import LONGEST_S, measure_dark
    from camctl.profiles.exposures import exposure_mode
    from camctl.profiles.profile import load_profile

    with camera.open(profile="none") as opened, progress_bar("shooting dark frames") as bar:
        info, mode = opened.info, exposure_mode(opened.controls)
        earlier = load_profile(info).noises.get(mode)
        if earlier is None:
            raise UsageError(
                f"the electrons per level of this camera are not known in the mode {mode}",
                hint="take the lens cap off, and run camctl calibrate noise without --dark first",
            )
        found = measure_dark(
            opened, earlier, longest_s=longest_s or LONGEST_S, progress=without_stage(bar)
        )
    return info, mode, earlier.model_copy(update={"dark": found})


def _from_files(
    source: SeriesOptions, response: str | None, is_flat: bool
) -> tuple[CameraInfo | None, str, NoiseRecord]:
    from camctl.calibration.noise.estimate import NoiseFrames, estimate_noise, same_response

    if (stored := stored_capture(source)) is not None:
        return _from_capture(stored, response, is_flat)
    from camctl.interface.controls import ExposureSetting

    frames: NoiseFrames | None = None
    for path, still, time_s in read_stills(source):
        if frames is None:
            is_jpeg = path.suffix.lower() in (".jpg", ".jpeg")
            name = response or ("srgb" if is_jpeg else "linear")
            black, white = levels_of(source, still)
            check_levels(still.bits, black, white)
            real = response_named(name, still.bits, black, white)
            responses = same_response(real, still.layout)
            frames = NoiseFrames(still.layout, black, white, responses, is_flat)
            frames.note_format(path.suffix)
        elif still.layout != frames.layout:
            raise DataError(
                f"{path} is {still.layout}, and {source.files[0]} is {frames.layout}",
                hint="give frames of one size and format",
            )
        frames.add(still.pixels, ExposureSetting(time_s))
    assert frames is not None
    return None, "", estimate_noise(frames)


def _from_capture(
    stored: StoredCapture, response: str | None, is_flat: bool
) -> tuple[CameraInfo, str, NoiseRecord]:
    from camctl.calibration.noise.estimate import NoiseFrames, estimate_noise

    report, responses = stored.report, stored.responses(response)
    frames = NoiseFrames(report.layout, stored.black, report.white, responses, is_flat)
    for position in stored.positions:
        frames.add(report.frame(position), report.frames[position].applied)
    return report.camera, stored.mode, estimate_noise(frames)


def _keep(info: CameraInfo, mode: str, record: NoiseRecord) -> Path:
    from camctl.profiles.profile import change_profile

    def keep(profile: Profile) -> None:
        earlier = profile.noises.get(mode)
        profile.noises[mode] = record if earlier is None else record.joined(earlier)

    return change_profile(info, keep)


def _json(record: NoiseRecord) -> dict[str, Any]:
    reference = record.reference
    return {
        "conversion_e_per_dn": reference.conversion_e_per_dn.model_dump(),
        "read_noise_e": reference.read_noise_e.model_dump(),
        "emva1288": {name: each.model_dump() for name, each in record.emva().items()},
        **record.model_dump(),
    }


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


def _rows(record: NoiseRecord) -> list[tuple[str, str]]:
    seen = "" if record.saturates else "; no saturated samples seen: of the stated white level"
    emva = record.emva()
    rows = [
        ("saturation", _text(record.full_well_e, " e-") + seen),
        ("least signal", _text(emva["sensitivity_threshold_e"], " e-")),
        ("dynamic range", _text(emva["dynamic_range"])),
        ("largest signal to noise", _text(emva["snr_max"])),
        (
            "PRNU",
            "not measured: use --flat before an evenly lit surface"
            if record.prnu is None
            else _text(record.prnu.scaled(100), " %"),
        ),
    ]
    return rows + _dark_rows(record.dark)


def _dark_rows(dark: DarkRecord | None) -> list[tuple[str, str]]:
    if dark is None:
        return [("dark current, DSNU", "not measured: put the lens cap on, and use --dark")]
    return [
        ("dark current", _text(dark.dark_current_e_s, " e-/s")),
        ("DSNU", _text(dark.dsnu_e, " e-")),
        *([("DCNU", _text(dark.dcnu_e_s, " e-/s"))] if dark.dcnu_e_s else []),
        ("hot pixels", str(len(dark.hot_pixels))),
    ]
