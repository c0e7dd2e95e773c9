"""`camctl profile`: what is known of each camera."""

from __future__ import annotations

import click

from camctl.cli import options
from camctl.cli.calibrate import delay_text
from camctl.cli.commands import LazyGroup, command
from camctl.cli.output import fields, say, say_json, table
from camctl.errors import UsageError, unknown_name

profile = LazyGroup(
    "profile",
    help="Show or remove what is known of each camera.",
    examples=(
        ("camctl profile list", "all cameras of which something is known"),
        ("camctl profile show NAME", "all that is known of one"),
    ),
)

NAME = click.argument("name", metavar="NAME")


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
    """List the cameras of which something is known.

    The first column is the name that show and remove take.
    """
    from camctl.profile import list_profiles, profile_directory

    found = list_profiles()
    if as_json:
        say_json([{"name": each.name, **each.model_dump(mode="json")} for each in found])
        return
    if not found:
        say(f"no profile in {profile_directory()}; camctl calibrate makes them")
        return
    heads = ("name", "make", "model", "serial", "delays", "formats")
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
    say(table(heads, rows))


@command(
    parent=profile,
    examples=(
        ("camctl profile show sim-camctl-simulated-standard-standard-34a1fb02", "one camera"),
        ("camctl profile show NAME --json", "for a script; camctl profile list has the names"),
    ),
)
@NAME
@options.as_json
def show(name: str, as_json: bool) -> None:
    """Show all that is known of one camera."""
    from camctl.profile import list_profiles, profile_directory

    known = {each.name: each for each in list_profiles()}
    if name not in known:
        if not known:
            raise UsageError(
                f"no profile '{name}', and no other", hint="camctl calibrate makes them"
            )
        raise unknown_name("profile", name, known)
    found = known[name]
    if as_json:
        say_json({"name": name, **found.model_dump(mode="json")})
        return
    rows = [
        ("camera", f"{found.make} {found.model}"),
        ("serial number", found.serial or "none"),
        ("driver", found.driver),
    ]
    for mode, delay in found.delays.items():
        rows.append((f"delay in {mode}", f"{delay_text(delay)}; {delay.trials} trials"))
        rows.append(("", f"measured {delay.measured_at}"))
    for kind, still in found.stills.items():
        what = f"{still.columns} x {still.rows}, {still.layout}, {still.bits} bits, "
        rows.append((f"files in {kind}", f"{what}black {still.black}, white {still.white}"))
    rows.append(("kept in", str(profile_directory() / f"{name}.json")))
    say(fields(rows))


@command(
    parent=profile,
    examples=(
        ("camctl profile remove NAME", "forget what is known of one camera"),
        ("camctl profile remove NAME --json", "for a script"),
    ),
)
@NAME
@options.as_json
def remove(name: str, as_json: bool) -> None:
    """Forget what is known of one camera."""
    from camctl.profile import remove_profile

    file = remove_profile(name)
    if as_json:
        say_json({"removed": file})
    else:
        say(f"removed {file}")
