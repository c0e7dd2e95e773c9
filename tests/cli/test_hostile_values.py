"""Every option of every command with values that no one should give.

A command line may be refused, but always in one line: no internal error, no traceback, no warning
of Python or of a library, no NaN in JSON, and no wait for a file that never ends.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Iterable, Iterator
from contextlib import chdir
from pathlib import Path

import click
import pytest
from command_bases import BASES, COMMANDS, ENDLESS, write_photographs
from command_line import Run
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from camctl.cli.parameter_types import (
    DynamicRange,
    FrameSize,
    ListOf,
    Number,
    Seconds,
    Settings,
    WholeNumber,
)

NUMBERS = (
    *("0", "-0", "-1", "1", "2", "0.5", "nan", "-nan", "inf", "-inf", "1e308", "-1e308", "1e400"),
    *("5e-324", "1e-300", "9007199254740993", "1,000", "1,000,000.5", "1.000,5", "0_2", "0x10"),
    *("1/0", "0/1", "1/1e308", "1e308/1e-308", "0x0", "1x1", "2x1", "-1x5", "1:0:1", "0:1:0"),
    *("1:2:1e-300", "1:1e308:1", "1:1e308:5e-324", "nan:nan:nan", "1:5", "1,nan", "0,0"),
    *("1,1e308", "5e-324,1", "1e-12,1e12", "1e-50,1,1e50"),
    *("1" + "0" * 30, "1" + "0" * 400, "9" * 5000, "9" * 5000 + "x1", "", " ", "٣", "½", "x"),
)
TEXTS = ("", " ", "-", "=", ":", "a=b", "x" * 5000, "NUL", "%s%n{0}", "é", "power:1e400", "sim:")

OUTPUTS = {"-o", "--output", "--plot"}
"""Options that name what is written.  They get names in the test's own folder only: the tests may
run as root, and a command that replaced a device or a system file would damage the machine."""

REFUSED = {
    "alpaca",
    "menu",
    "studio",
    "resume",
    "profile export",
    "profile import",
    "profile show",
    "profile remove",
    "figures",
}
"""Commands whose line in `BASES` is refused: without a terminal, an address, a profile, or a quick
figure."""

NUMERIC = (Number, WholeNumber, Seconds, DynamicRange, FrameSize, ListOf)
"""Types of options that open no files."""

LEFT_OUT = {"--debug", "--help", "--probe", "--workers"}
"""The first two print what they promise; a probe writes to serial ports; and
workers are processes."""

CASES = [
    (name, option)
    for name, command in COMMANDS.items()
    for option in command.params
    if not LEFT_OUT & set(option.opts)
]


def kind(option: click.Parameter) -> tuple[object, ...]:
    """Return what options have in common that several commands share."""
    return option.opts[-1], option.nargs, type(option.type), str(vars(option.type))


RUN_BY_DEFAULT = {
    "calibrate response files",
    "evaluate --noise",
    "merge --times",
    "merge files",
    "profile import file",
    "shoot --ratios",
    "simulate --times",
    "solve --range",
    "solve --settings",
    "table show --table",
}
"""Options whose values are tried with the whole command; the others are only parsed by default, and
run in slow tests."""

DIFFERENT = {kind(option): (name, option) for name, option in CASES}
"""A command and its option, for each option that is not like another one."""

PARSED = {(*key[1:], each[1].callback): each for key, each in DIFFERENT.items()}
"""Those of `DIFFERENT` whose values are parsed in different ways, whatever their names are."""

PARSED_SHARE = 5
"""One in so many values is only parsed by default; slow tests run commands with all of them."""


def case(name: str, option: click.Parameter) -> str:
    return f"{name} {option.opts[-1]}"


def takes_long(name: str) -> bool:
    """Return whether a line of a command takes a tenth of a second and more."""
    return name.startswith(("tradeoff", "table show", "calibrate noise"))


RUN = [each for each in CASES if case(*each) not in ENDLESS]
IN_FULL = [each for each in RUN if each in DIFFERENT.values() or case(*each) in RUN_BY_DEFAULT]
SHARED = [each for each in RUN if each not in IN_FULL]
SOME = 8
"""Every eighth of the values of an option in `SHARED`; of commands that take long every 16th of the
values of an option in `IN_FULL`, and every 32nd of one in `SHARED`."""


@pytest.fixture
def places(tmp_path: Path) -> Iterator[tuple[str, ...]]:
    """Paths that are no regular file, or an unexpected one."""
    folder = tmp_path / "places"
    folder.mkdir()
    (folder / "folder.json").mkdir()
    (folder / "folder.hdr").mkdir()
    (folder / "empty.json").touch()
    (folder / "empty.npy").touch()
    (folder / "text.json").write_text("[1, 2")
    (folder / "zeros.exr").write_bytes(bytes(1000))
    for suffix in (".json", ".hdr", ".exr", ".npy", ".tiff", ""):
        os.mkfifo(folder / f"pipe{suffix}")
        (folder / f"endless{suffix}").symlink_to("/dev/zero")
    (folder / "loop.json").symlink_to(folder / "loop.json")
    with socket.socket(socket.AF_UNIX) as server:
        with chdir(folder):  # the name of a socket has at most 107 characters
            server.bind("socket.json")
        yield (
            *(str(path) for path in sorted(folder.iterdir())),
            *("/", ".", "missing", "missing.json", "x" * 300 + ".json", "a/" * 3000 + "b.hdr"),
            *("/dev/zero", "/dev/full", "/dev/null", "/proc/self/mem", "/dev/tty"),
        )


@pytest.fixture(autouse=True)
def photographs(run: Run) -> None:
    """Write the photographs of `BASES` into the empty folder of `run`."""
    assert run is not None
    write_photographs(Path())


def problem(run: Run, *arguments: str) -> str:
    """Run a command line; return what is wrong with how it ends, empty if nothing is."""
    ran = run(*arguments)
    warning = "camctl: warning: "
    errors = [line for line in ran.err.splitlines() if not line.startswith(warning)]
    if ran.status == 3 and "camctl: warning: not trustworthy: " in ran.err:
        return ""  # as a black level that the pixels contradict
    if ran.status not in (0, 1, 2):
        return f"status {ran.status}"
    if "internal error" in ran.err or len(errors) != (ran.status != 0):
        return ran.err
    if errors and not errors[0].startswith("camctl: "):
        return ran.err
    if "--json" in arguments:
        try:
            _ = ran.json
        except (ValueError, AssertionError) as error:
            return f"invalid JSON: {error}"
    return ""


def test_every_command_is_tried() -> None:
    assert set(BASES) == set(COMMANDS)
    assert {case(*each) for each in CASES} >= RUN_BY_DEFAULT


@pytest.mark.parametrize(
    "name",
    [
        name
        if any(each.rpartition(" ")[0] == name for each in RUN_BY_DEFAULT)
        else pytest.param(name, marks=pytest.mark.slow)
        for name in sorted(set(BASES) - REFUSED)
    ],
)
def test_the_command_lines_without_hostile_values_work(run: Run, name: str) -> None:
    for base in BASES[name]:
        ran = run(*name.split(), *base.split())
        assert ran.status == 0, ran.err


def lines_with(
    name: str, option: click.Parameter, places: tuple[str, ...], folder: Path
) -> Iterator[list[str]]:
    """Yield command lines of a command that give this option each hostile value."""
    is_numeric = isinstance(option.type, NUMERIC)
    values: tuple[str | None, ...] = NUMBERS if is_numeric else (*TEXTS, *places)
    if isinstance(option.type, Settings):
        values = (*NUMBERS, *TEXTS, *places)
    if isinstance(option, click.Option) and option.is_flag:
        values = (None,)
    elif OUTPUTS & set(option.opts):
        own = (path for path in places if path.startswith(str(folder)) and "endless" not in path)
        values = ("", ".", "x" * 300, "a/" * 3000 + "b", *own)
    flag = ["--json"] if any("--json" in each.opts for each in COMMANDS[name].params) else []
    bases = BASES[name]
    # Each value with one of the command lines in turn; a flag with all of them.
    for k in range(max(len(bases), len(values))):
        value = values[k % len(values)]
        added = [] if value is None else [value]
        added = [option.opts[-1], *added] if isinstance(option, click.Option) else added
        yield [*name.split(), *bases[k % len(bases)].split(), *flag, *added]


def problems(run: Run, lines: Iterable[list[str]]) -> list[str]:
    """Run command lines; return what is wrong, with the beginning of the line."""
    found = ((line, problem(run, *line)) for line in lines)
    return [f"{' '.join(line)[:300]}: {wrong[:300]}" for line, wrong in found if wrong]


def test_hostile_values_are_parsed_or_refused_in_one_line(
    run: Run, tmp_path: Path, places: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    for command in COMMANDS.values():
        monkeypatch.setattr(command, "callback", lambda **_: print("null"))
    assert len(PARSED) > 30
    for place, (name, option) in enumerate(PARSED.values()):
        lines = list(lines_with(name, option, places, tmp_path))
        assert problems(run, lines[place % PARSED_SHARE :: PARSED_SHARE]) == []


@pytest.mark.parametrize(
    ("name", "option"),
    [
        pytest.param(
            *each, id=case(*each), marks=() if case(*each) in RUN_BY_DEFAULT else pytest.mark.slow
        )
        for each in IN_FULL
    ],
)
def test_hostile_values_are_refused_in_one_line(
    run: Run, tmp_path: Path, places: tuple[str, ...], name: str, option: click.Parameter
) -> None:
    lines = list(lines_with(name, option, places, tmp_path))
    if takes_long(name) and case(name, option) not in RUN_BY_DEFAULT:  # the proof has all
        some = 2 * SOME
        lines = lines[IN_FULL.index((name, option)) % some :: some] or lines[:1]
    assert problems(run, lines) == []


@pytest.mark.slow
@pytest.mark.proof
@pytest.mark.parametrize(
    ("name", "option"),
    [pytest.param(*each, id=case(*each)) for each in IN_FULL if takes_long(each[0])],
)
def test_all_hostile_values_of_what_takes_long_are_refused_in_one_line(
    run: Run, tmp_path: Path, places: tuple[str, ...], name: str, option: click.Parameter
) -> None:
    assert problems(run, lines_with(name, option, places, tmp_path)) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted({name for name, _ in SHARED}))
def test_hostile_values_of_shared_options_are_refused_in_one_line(
    run: Run, tmp_path: Path, places: tuple[str, ...], name: str
) -> None:
    """Another command has all values of each; this one has some of them, others for each option."""
    some = 4 * SOME if takes_long(name) else SOME
    for place, option in enumerate(option for command, option in SHARED if command == name):
        lines = list(lines_with(name, option, places, tmp_path))
        assert problems(run, lines[place % some :: some] or lines[:1]) == []


EDGES = ("0", "1", "1e-12", "1e12", "1e7", "1e15", "0.01", "100", "1.0000000000000002", "16", "2.5")
"""Numbers at the limits of options: each is allowed somewhere."""


def numeric(command: str) -> list[click.Parameter]:
    return [
        option
        for option in COMMANDS[command].params
        if isinstance(option.type, (*NUMERIC, Settings))
    ]


@st.composite
def command_lines(draw: st.DrawFn) -> list[str]:
    """Return a command line with several numeric options, each at a limit or beyond it."""
    name = draw(st.sampled_from(("solve", "evaluate", "evaluate", "simulate", "shoot")))
    line = [*name.split(), *draw(st.sampled_from(BASES[name])).split(), "--json"]
    for option in draw(st.lists(st.sampled_from(numeric(name)), min_size=2, max_size=4)):
        # Sixteen exposures take long, and so do many sets, and nothing else.
        if option.name not in ("count", "repeat"):
            line += [option.opts[-1], draw(st.sampled_from(EDGES) | st.sampled_from(NUMBERS))]
    return line


@pytest.mark.slow
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(line=command_lines())
def test_hostile_values_together_are_refused_in_one_line(run: Run, line: list[str]) -> None:
    assert problem(run, *line) == ""
