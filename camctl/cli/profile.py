"""`camctl profile`: the kept measurements of each camera."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import LazyGroup, command
from camctl.cli.options import option
from camctl.cli.output import (
    format_delay,
    format_fields,
    format_table,
    print_json,
    print_text,
)
from camctl.cli.parameter_types import PATH, Text
from camctl.errors import visible

if TYPE_CHECKING:
    from camctl.profiles.noise import GainNoise
    from camctl.profiles.profile import Profile
    from camctl.profiles.response import ResponseRecord

profile = LazyGroup(
    "profile",
    help="Show, copy or remove the kept measurements of each camera.",
    examples=(
        ("camctl profile list", "all cameras that have a profile"),
        ("camctl profile show NAME --plot response.png", "all measurements of one, and a plot"),
        ("camctl profile export NAME -o camera.json", "for another computer, or as a copy"),
    ),
)


def _profile_names() -> Iterable[str]:
    from camctl.profiles.profile import profile_directory

    directory = profile_directory()
    return sorted(file.stem for file in directory.glob("*.json"))


name_argument = click.argument("name", metavar="NAME", type=Text(_profile_names))


@command(
    parent=profile,
    name="list",
    examples=(
        ("camctl profile list", "all profiles by name"),
        ("camctl profile list --json", "for a script"),
    ),
)
@options.as_json
def list_(as_json: bool) -> None:
    """List the cameras that have a profile.

    The first column is the name for show and remove.
    """
    from camctl.profiles.folder import list_profiles
    from camctl.profiles.profile import profile_directory

    found = list_profiles()
    if as_json:
        print_json({"profiles": [{"name": each.name, **dict(each)} for each in found]})
        return
    if not found:
        print_text(f"no profiles in {visible(profile_directory())}; camctl calibrate creates them")
        return
    headings = ("name", "make", "model", "serial", "measured", "formats")
    rows = [
        (
            each.name,
            each.make,
            each.model,
            each.serial,
            _measured(each),
            ", ".join(each.stills) or "none",
        )
        for each in found
    ]
    print_text(format_table(headings, rows))


def _measured(found: Profile) -> str:
    """Return what was measured of a camera, in any mode."""
    records = {
        "control delay": found.delays,
        "response": found.responses,
        "exposures": found.exposures,
        "noise": found.noises,
        "colours": found.colours,
    }
    return ", ".join(name for name, modes in records.items() if modes) or "nothing"


@command(
    parent=profile,
    examples=(
        ("camctl profile show sim-camctl-simulated-standard-standard-34a1fb02", "one camera"),
        ("camctl profile show NAME --plot response.png", "also draw what was measured"),
        ("camctl profile show NAME --json", "for a script; camctl profile list shows the names"),
    ),
)
@name_argument
@option(
    "--plot FILE",
    "Draw the responses and the photon transfer curves, as PNG or SVG; needs matplotlib.",
    PATH,
)
@options.force
@options.as_json
def show(name: str, plot: Path | None, force: bool, as_json: bool) -> None:
    """Show all kept measurements of one camera."""
    from camctl.profiles.folder import find_profile
    from camctl.profiles.profile import profile_directory

    found = find_profile(name)
    if plot is not None:
        from camctl.calibration.plots import draw_profile
        from camctl.system.plots import check_plots

        check_plots((plot,), overwrite=force)
        draw_profile(found, plot)
    if as_json:
        print_json({"name": name, **dict(found)})
        return
    rows = [
        ("camera", f"{found.make} {found.model}"),
        ("serial number", found.serial or "none"),
        ("driver", found.driver),
        *_measurements(found),
        ("file", str(profile_directory() / f"{name}.json")),
    ]
    if plot is not None:
        rows.append(("plot", str(plot)))
    print_text(format_fields(rows))


def _measurements(found: Profile) -> list[tuple[str, str]]:
    """Return name and value of each record."""
    rows = []
    known = {*found.responses, *found.exposures, *found.noises, *found.colours}
    for mode, delay in found.delays.items():
        name = _mode_of_delay(mode, known)
        rows.append((f"delay in {name}", f"{format_delay(delay)}; {delay.trials} trials"))
        rows.append(("", f"measured {delay.measured_at}"))
    for kind, still in found.stills.items():
        size = f"{still.columns} x {still.rows}, {still.layout}, {still.bits} bits"
        rows.append((f"{kind} files", f"{size}, black {still.black}, white {still.white}"))
    for mode, exposures in found.exposures.items():
        wrong = sum(each.contradicts_label for each in (*exposures.times, *exposures.gains))
        times, gains = len(exposures.times), len(exposures.gains)
        measured = f"{times} time{'s' * (times != 1)}, {gains} gain{'s' * (gains != 1)}"
        rows.append((f"exposures in {mode}", f"{measured}; {wrong} contradict the stated ones"))
        rows.append(("", f"measured {exposures.measured_at}"))
    for mode, response in found.responses.items():
        levels = {f"black {each.black}, white {each.white}" for each in response.channels}
        channels = ", ".join(each.name for each in response.channels)
        rows.append((f"response in {mode}", f"channels {channels}; {'; '.join(sorted(levels))}"))
        rows.append(("", f"measured {response.measured_at}, {response.frames} frames"))
        rows += [("", line) for line in _curves(response)]
    for mode, colour in found.colours.items():
        mean, largest = colour.mean_difference, colour.largest_difference
        error = f"CIEDE2000 {mean:.2f} in the mean, {largest:.2f} at most"
        rows.append((f"colours in {mode}", error))
        rows.append(("", f"measured {colour.measured_at}"))
    for mode, noise in found.noises.items():
        for each in noise.gains:
            conversion, read_noise = each.conversion_e_per_dn, each.read_noise_e
            rows.append(
                (
                    f"noise in {mode}, gain {each.gain:g}",
                    f"{conversion.value:.4g} electrons a level, read noise {read_noise.value:.3g} "
                    "electrons",
                )
            )
            rows += [("", line) for line in _transfer(each)]
        hot = f", {len(noise.dark.hot_pixels)} hot pixels" if noise.dark is not None else ""
        rows.append(("", f"full well {noise.full_well_e.value:.4g} electrons{hot}"))
        rows.append(("", f"measured {noise.measured_at}"))
    return rows


def _mode_of_delay(mode: str, known: Iterable[str]) -> str:
    """Return the mode of a control delay as other measurements name it, with its frame rate.

    A stream's mode ends in the frame rate, theirs in the white level: it is itself where none or
    several of theirs have its format and size.
    """
    picture, _, rate = mode.rpartition("-")
    kind, _, size = picture.rpartition("-")
    kinds = {kind, kind.rstrip("0123456789")}
    fits = [
        each
        for each in known
        if (parts := each.split("-")) and kinds & set(parts[:-2]) and parts[-2] == size
    ]
    return f"{fits[0]}, {rate} frames/s" if len(fits) == 1 else mode


def _transfer(noise: GainNoise) -> list[str]:
    """Return some points of a photon transfer curve, on one line."""
    points = noise.curve[:: max(1, len(noise.curve) // 4)]
    if not points:
        return []
    text = ", ".join(f"{each.variance:.3g} at {each.mean:.3g}" for each in points)
    return [f"variance in DN squared {text} DN"]


def _curves(response: ResponseRecord) -> list[str]:
    """Return the brightness of each channel at some irradiances, one line each."""
    import numpy as np

    shares = (0.01, 0.05, 0.2, 0.5)
    return [
        f"{channel.name}: "
        + ", ".join(
            f"{np.interp(share, channel.irradiance, channel.brightness):.1%} at {share:.0%}"
            for share in shares
        )
        + " of full light"
        for channel in response.channels
    ]


@command(
    parent=profile,
    examples=(
        ("camctl profile export NAME -o camera.json", "one camera, for camctl profile import"),
        ("camctl profile export NAME", "on standard output"),
    ),
)
@name_argument
@option("-o --output FILE", "File.  [default: standard output]", PATH)
@options.force
def export(name: str, output: Path | None, force: bool) -> None:
    """Write the profile of one camera as one JSON file."""
    from camctl.errors import visible
    from camctl.profiles.folder import find_profile
    from camctl.system.files import check_new, write_bytes

    text = find_profile(name).model_dump_json(indent=2)
    if output is None:
        print_text(text)
        return
    check_new(output, overwrite=force)
    write_bytes(output, f"{text}\n".encode())
    print_text(f"wrote {visible(output)}")


@command(
    parent=profile,
    name="import",
    examples=(
        ("camctl profile import camera.json", "what camctl profile export has written"),
        ("camctl profile import camera.json --force", "in place of what is known of that camera"),
    ),
)
@click.argument("file", type=PATH, metavar="FILE")
@option("--force", "Replace the camera's profile without asking.")
@options.as_json
def import_(file: Path, force: bool, as_json: bool) -> None:
    """Keep a profile that was exported, for the camera that it names.

    If the camera has a profile, it is replaced: on a terminal you are asked first.
    """
    from camctl.profiles.folder import import_profile

    def replace(earlier: Profile) -> bool:
        if force or not (sys.stdin.isatty() and sys.stderr.isatty()):
            return force
        question = f"replace the profile of {visible(earlier.make)} {visible(earlier.model)}?"
        return click.confirm(question, err=True)

    kept = import_profile(file, replace=replace)
    if as_json:
        print_json({"name": kept.stem, "file": kept})
    else:
        print_text(f"kept as {visible(kept.stem)} in {visible(kept)}")


@command(
    parent=profile,
    examples=(
        ("camctl profile remove NAME", "delete the measurements of one camera"),
        ("camctl profile remove NAME --json", "for a script"),
    ),
)
@name_argument
@options.as_json
def remove(name: str, as_json: bool) -> None:
    """Delete the profile of one camera."""
    from camctl.profiles.folder import remove_profile

    file = remove_profile(name)
    if as_json:
        print_json({"removed": file})
    else:
        print_text(f"removed {visible(file)}")
