"""`camctl table show`: the rows of an exposure table."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import option
from camctl.cli.output import (
    NOISE_UNKNOWN,
    format_number,
    format_table,
    print_json,
    print_text,
    progress_bar,
)
from camctl.cli.parameter_types import PATH
from camctl.cli.real_camera import (
    KnownCamera,
    NoiseOptions,
    RealCameraOptions,
    noise_options,
    real_camera_options,
)
from camctl.cli.request_options import RESPONSE, SEARCHED, named
from camctl.cli.sensitivity import sensitivity_json, sensitivity_table
from camctl.errors import DataError, UsageError
from camctl.system.number_text import range_text

if TYPE_CHECKING:
    from camctl.exposure.robustness import Robustness
    from camctl.exposure.table import TableEntry
    from camctl.model.response.camera import CameraResponse


@command(
    examples=(
        ("camctl table show", "all rows of the built-in table"),
        ("camctl table show --response log --range high", "some of them"),
        ("camctl table show --table ten-bit.json --json", "a table of your own, for a script"),
        ("camctl table show --electrons 40", "with the noise of a camera of 40 electrons a level"),
        ("camctl table show -n 3 --sensitivity", "with exposure errors and noise"),
    ),
)
@option(
    "--table FILE",
    "Table made by camctl table build.  [default: the built-in one]",
    PATH,
    field="path",
)
@option("--response linear|gamma|log", "Only this response.  [default: all]", RESPONSE)
@named("dynamic_range", "Only this dynamic range.  [default: all]")
@named("count", "Only this number of exposures.  [default: all]", SEARCHED)
@option(
    "--sensitivity",
    "Show the effective levels with exposure errors of 0.01, 0.1 and 1 %, with noise of 0.1, "
    "0.5 and 2 brightness levels, and over all phases of the quantiser.  Takes about 0.1 s per row "
    "of 8 bits.",
)
@real_camera_options
@noise_options
@options.as_json
def show(
    path: Path | None,
    response: str | None,
    dynamic_range: float | None,
    count: int | None,
    sensitivity: bool,
    real_camera: RealCameraOptions,
    noise: NoiseOptions,
    as_json: bool,
) -> None:
    """Show the exposures in the table, how long they take and how good they are.

    Each row is for one camera, response, dynamic range and number of exposures. With --bits,
    --phase or --curve, or with --sensor or --camera, only rows of that camera are shown. Where the
    noise is known (--sensor, --camera, --electrons, --read-noise), effective levels count it in.
    The built-in table has exposures chosen by xi; where the noise is known, others chosen by
    accuracy are solved and shown beside them: 0.1 s for each row of 8 bits and up to 6 exposures,
    up to a minute for a row of 16 bits and 16 exposures.
    """
    from camctl.exposure.table import ExposureTable, default_table

    found = default_table() if path is None else ExposureTable.load(path)
    camera = noise.camera(real_camera)
    real = camera.response if noise.names_camera else None
    entries = [
        entry
        for entry in found.entries
        if response in (None, entry.response)
        and dynamic_range in (None, entry.dynamic_range)
        and count in (None, entry.n)
        and (real is None or entry.camera == real.fingerprint)
    ]
    accurate = []
    if path is None and not sensitivity:
        accurate = _chosen_by_accuracy(camera, response, dynamic_range, count)
    has_rows = real is None or any(entry.camera == real.fingerprint for entry in found.entries)
    if real is not None and not (has_rows or accurate):
        name = "the built-in table" if path is None else f"table {path}"
        raise DataError(f"{name} has no row for {real.name}", hint=_other_ways(noise))
    chosen_by = ["xi"] * len(entries) + ["accuracy"] * len(accurate)
    entries += accurate
    if not (entries or as_json):
        raise UsageError(
            "the table has no such row",
            hint="camctl solve finds exposures for any response, range and number",
        )
    robustness = _robustness(entries, real) if sensitivity else []
    levels = _effective_levels(entries, camera, real)
    if as_json:
        rows = [
            entry.model_dump()
            | {
                "chosen_by": how,
                "effective_levels": with_noise,
                "effective_levels_noise_free": entry.effective_levels,
            }
            for entry, how, with_noise in zip(entries, chosen_by, levels, strict=True)
        ]
        for row, each in zip(rows, robustness, strict=False):
            row["sensitivity"] = sensitivity_json(each)
        print_json({"entries": rows, "noise": camera.noise})
    else:
        noise_known = camera.noise is not None
        text = (
            sensitivity_table(entries, robustness)
            if robustness
            else _rows_text(list(zip(entries, chosen_by, levels, strict=True)), noise_known)
        )
        print_text(text if path is not None or sensitivity else f"{text}\n{_hint(noise_known)}")


def _hint(noise_known: bool) -> str:
    """Return what the exposures chosen by accuracy are, or how to see them."""
    if noise_known:
        return "chosen by accuracy: least error with the noise of this camera, at gain 1"
    return "exposures chosen by accuracy belong to a camera's noise: name one with --sensor"


def _other_ways(noise: NoiseOptions) -> str:
    """Return what to do where a table has no row for a camera."""
    if noise.camera_id is None:
        return "build one with camctl table build"
    return (
        f"find exposures with camctl solve --camera {noise.camera_id}, or give camctl table build "
        "and show the --curve that camctl calibrate response -o has written"
    )


def _chosen_by_accuracy(
    camera: KnownCamera, response: str | None, dynamic_range: float | None, count: int | None
) -> list[TableEntry]:
    """Return rows chosen by accuracy with the noise of a camera, at gain 1; none if unknown."""
    if camera.noise is None:
        return []
    from camctl.exposure.accuracy import solve_accuracy
    from camctl.exposure.build import COUNTS
    from camctl.exposure.exposure_choices import AccuracyProblem
    from camctl.exposure.table import TableEntry
    from camctl.model.response.desired import desired_response
    from camctl.model.response.names import RANGES, RESPONSES

    rows = [
        (desired_response(name, span), n)
        for name in ([response] if response in RESPONSES else RESPONSES if not response else [])
        for span in ([dynamic_range] if dynamic_range else RANGES.values())
        for n in ([count] if count else COUNTS)
    ]
    found = []
    with progress_bar(f"solving {len(rows)} rows") as bar:
        for desired, n in rows:
            problem = AccuracyProblem(camera.response, desired, camera.noise, black=camera.black)
            solution = solve_accuracy(problem, [n])
            found.append(TableEntry.of(camera.response, desired, solution))
            if bar is not None:
                bar(len(found) / len(rows), "")
    return found


def _effective_levels(
    entries: list[TableEntry], camera: KnownCamera, real: CameraResponse | None
) -> list[float]:
    """Return the effective levels of each row, with the camera's noise where it is known."""
    from camctl.model.response.desired import desired_response

    if camera.noise is None:
        return [entry.effective_levels for entry in entries]
    cameras = _cameras(entries, real)
    return [
        replace(camera, response=cameras[entry.camera])
        .rate(desired_response(entry.response, entry.dynamic_range), entry.exposures)
        .effective_levels
        for entry in entries
    ]


def _cameras(entries: list[TableEntry], real: CameraResponse | None) -> dict[str, CameraResponse]:
    """Return the camera of each fingerprint in the rows; without `real`, found by its levels."""
    by_camera = {entry.camera: entry for entry in entries}
    return {key: real or _linear_camera(entry) for key, entry in by_camera.items()}


def _robustness(entries: list[TableEntry], real: CameraResponse | None) -> list[Robustness]:
    """Return the robustness of each row."""
    from camctl.exposure.robustness import sensitivity
    from camctl.model.response.desired import desired_response

    robustness = []
    exposures = sum(entry.n for entry in entries)
    cameras = _cameras(entries, real)
    with progress_bar(f"computing {len(entries)} rows") as bar:
        for entry in entries:
            robustness.append(
                sensitivity(
                    cameras[entry.camera],
                    desired_response(entry.response, entry.dynamic_range),
                    entry.exposures,
                    levels_wanted=entry.levels_wanted,
                )
            )
            if bar is not None:
                bar(sum(each.n for each in entries[: len(robustness)]) / exposures, "")
    return robustness


def _linear_camera(entry: TableEntry) -> CameraResponse:
    """Return the linear camera with the levels of a row; raise `UsageError` for any other."""
    for bits in range(1, 17):
        for phase in (0.0, 0.5):
            real = RealCameraOptions(bits, phase, None, None).response()
            if real.fingerprint == entry.camera:
                return real
    raise UsageError(
        f"the response of the camera {entry.camera_name} is unknown",
        hint="give --bits, --phase and --curve as when the table was built",
    )


def _rows_text(rated: list[tuple[TableEntry, str, float]], noise_known: bool) -> str:
    cameras = dict.fromkeys(entry.camera_name for entry, _, _ in rated)
    blocks = []
    for name in cameras:
        rows = [
            (
                entry.response,
                range_text(entry.dynamic_range),
                str(entry.n),
                how,
                format_number(with_noise, 4),
                f"with noise, {format_number(entry.effective_levels, 4)} without"
                if noise_known
                else NOISE_UNKNOWN,
                f"{format_number(entry.xi, 5)} of {format_number(entry.levels_wanted)}",
                format_number(entry.total_exposure, 4),
                "  ".join(map(format_number, entry.exposures)),
            )
            for entry, how, with_noise in sorted(rated, key=lambda row: _place(row[0]))
            if entry.camera_name == name
        ]
        headings = (
            *("response", "range", "n", "chosen by", "effective levels"),
            *("", "missing (xi)", "total time", "exposures"),
        )
        text = format_table(headings, rows, right_aligned=(1, 2, 4, 6, 7))
        blocks.append(f"camera: {name}\n\n{text}")
    legend = (
        "effective levels: equal steps of brightness that would be as accurate; "
        "missing (xi): desired levels not reached;\n"
        "exposures and their total time are relative to the shortest exposure"
    )
    return "\n\n".join([*blocks, legend])


def _place(entry: TableEntry) -> tuple[int, float, int]:
    """Return the order of rows: by response, range and number of exposures."""
    from camctl.model.response.names import RESPONSES

    names = list(RESPONSES)
    is_known = entry.response in names
    return (names.index(entry.response) if is_known else -1, entry.dynamic_range, entry.n)
