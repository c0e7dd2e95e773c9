"""Options of earlier versions: each still works in this one, and says once what it is now."""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

import click

from camctl.errors import UsageError

OLD_CAMERA_OPTIONS: Final = {
    "--size": "-O size={}",
    "--seed": "-O seed={}",
    "--fault": "-O faults={}",
    "--real-time": "-O time=real",
    "--simulation-tolerance": "-O tolerance={}",
    "--no-profile": "-O profile=none",
}
"""Options of commands that have -O, and what takes their place; {} stands for the value."""

OLD_OPTIONS: Final = {
    "--desired": "--response {}",
}
"""Options of commands that have --response."""

OLD_SETTINGS: Final = {
    "--mains": "--set mains={}",
    "--aperture": "--set aperture=yes",
    "--table": "--set table={}",
    "--levels": "--set levels={}",
    "--tolerance": "--set tolerance={}",
    "--objective": "--set objective={}",
}
"""Options of commands that have --set."""

OLD_COMMANDS: Final = {
    "--resume": "resume {}",
    "--preview-only": "preview",
    "--repeat": "series --repeat {}",
    "--on-key": "series --on-key",
    "--interval": "series --interval {}",
    "--name": "series --name {}",
    "--hook": "series --hook {}",
    "--hook-limit": "series --hook-limit {}",
    "--explain": "shoot",
}
"""Options of `camctl shoot` that are commands now, in the order in which they decide it."""

SILENT: Final = {"--levels", "--tolerance", "--objective", "--seed"}
"""Names that several commands share and that stay: they work without a remark."""


def new_command(args: Iterable[str]) -> tuple[str, list[str], list[str]]:
    """Return the command that takes the place of `camctl shoot`, its arguments, and remarks."""
    words = list(args)
    rest, old = _split(words, OLD_COMMANDS)
    if not old:
        return "shoot", words, []
    first = next(name for name in OLD_COMMANDS if name in old)
    command = OLD_COMMANDS[first].split()[0]
    if command == "shoot":
        return "shoot", rest, ["--explain is now: -O tolerance=DN, which shows it"]
    own = [word for name, value in old.items() for word in _words(command, name, value)]
    last = ["--", old["--resume"]] if command == "resume" else []
    return command, [*rest, *own, *last], [f"{first} is now: camctl {command}"]


def _words(command: str, name: str, value: str) -> list[str]:
    """Return the words of an old option that are options of the new command."""
    is_option = OLD_COMMANDS[name].startswith("series") and command in ("series", "resume")
    if not is_option:
        return []
    return [name, value] if "{}" in OLD_COMMANDS[name] else [name]


def new_options(command: click.Command, args: Iterable[str]) -> tuple[list[str], list[str]]:
    """Return the arguments of a command with its old options as they are now, and remarks."""
    own = {name for each in command.params for name in each.opts}
    table = {
        **(OLD_CAMERA_OPTIONS if "-O" in own else {}),
        **(OLD_OPTIONS if "--response" in own else {}),
        **(OLD_SETTINGS if "--set" in own else {}),
    }
    rest, old = _split(list(args), {name: now for name, now in table.items() if name not in own})
    remarks = []
    for name, value in old.items():
        option, word = table[name].split(" ")
        if option == "--response" and any(each.startswith(option) for each in rest):
            raise UsageError(f"{name} cannot be combined with {option}", hint="leave one out")
        rest = [option, word.format(value), *rest]
        if name not in SILENT:
            remarks.append(f"{name} is now: {option} {word.format(shlex.quote(value))}")
    return rest, remarks


def _split(words: list[str], old: Mapping[str, str]) -> tuple[list[str], dict[str, str]]:
    """Return the words without old options, and these with their values."""
    rest: list[str] = []
    found: dict[str, str] = {}
    remaining: Iterator[str] = iter(words)
    for word in remaining:
        name, equals, value = word.partition("=")
        if word == "--":
            return [*rest, word, *remaining], found
        if name not in old:
            rest.append(word)
        elif "{}" not in old[name]:
            found[name] = ""
        elif equals:
            found[name] = value
        else:
            following = next(remaining, None)
            if following is None:
                rest.append(word)  # its value is missing
            else:
                found[name] = following
    return rest, found
