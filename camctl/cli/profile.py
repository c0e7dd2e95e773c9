"""`camctl profile`: the kept measurements of each camera."""

from __future__ import annotations

from collections.abc import Iterable

import click

from camctl.cli import options
from camctl.cli.commands import LazyGroup, command
from camctl.cli.output import format_delay, format_fields, format_table, print_json, print_text
from camctl.cli.parameter_types import Text
from camctl.errors import UsageError, unknown_name

profile = LazyGroup(
    "profile",
    help="Show or remove the kept measurements of each camera.",
    examples=(
        ("camctl profile list", "all cameras that have a profile"),
        ("camctl profile show NAME", "all measurements of one"),
    ),
)


def _profile_names() -> Iterable[str]:
    from camctl.profile import profile_directory

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
    from camctl.profile import list_profiles, profile_directory

    found = list_profiles()
    if as_json:
        print_json([{"name": each.name, **each.model_dump(mode="json")} for each in found])
        return
    if not found:
        print_text(f"no profiles in {profile_directory()}; camctl calibrate creates them")
        return
    headings = ("name", "make", "model", "serial", "delays", "formats")
    rows = [
        (
            each.name,
            each.make,
            each.model,
            each.serial,
            str(len(each.delays) or "none"),
            ", ".join(each.stills) or "none",
        )
        for each in found
    ]
    print_text(format_table(headings, rows))


@command(
    parent=profile,
    examples=(
        ("camctl profile show sim-camctl-simulated-standard-standard-34a1fb02", "one camera"),
        ("camctl profile show NAME --json", "for a script; camctl profile list shows the names"),
    ),
)
@name_argument
@options.as_json
def show(name: str, as_json: bool) -> None:
    """Show all kept measurements of one camera."""
    from camctl.profile import list_profiles, profile_directory

    profiles = {each.name: each for each in list_profiles()}
    if name not in profiles:
        if not profiles:
            raise UsageError(
                f"unknown profile '{name}': there are no profiles",
                hint="make one with camctl calibrate",
            )
        raise unknown_name("profile", name, profiles)
    found = profiles[name]
    if as_json:
        print_json({"name": name, **found.model_dump(mode="json")})
        return
    rows = [
        ("camera", f"{found.make} {found.model}"),
        ("serial number", found.serial or "none"),
        ("driver", found.driver),
    ]
    for mode, delay in found.delays.items():
        rows.append((f"delay in {mode}", f"{format_delay(delay)}; {delay.trials} trials"))
        rows.append(("", f"measured {delay.measured_at}"))
    for kind, still in found.stills.items():
        size = f"{still.columns} x {still.rows}, {still.layout}, {still.bits} bits"
        rows.append((f"{kind} files", f"{size}, black {still.black}, white {still.white}"))
    rows.append(("file", str(profile_directory() / f"{name}.json")))
    print_text(format_fields(rows))


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
    from camctl.profile import remove_profile

    file = remove_profile(name)
    if as_json:
        print_json({"removed": file})
    else:
        print_text(f"removed {file}")
