"""Run every command at the corners of its numeric options, with limits on memory and time.

    python resource_contract.py [--seconds S] [--only TEXT] [--every N]
    python resource_contract.py --combine {pairs,heavy} [--seed K] [--most N] ...

The lines come from the table of options of the command line: each numeric option of each command,
added to a line of `command_bases.BASES`, at the least and the largest value that its type accepts,
just beyond them, and at tiny, huge and endless ones where the type has no bound.  Each runs in a
process of its own, with 500 MB of memory beyond what the process has before, and S seconds of
processor time (60).  It must end with a result, or be refused in one line that is not about memory.
Lines of `COSTLY` may take longer: they show progress, and their pages state the cost.

With --combine, lines have several options at once, numeric ones at the corners that their types
accept, names and flags as well: rows that hold each pair of values, on the quick line of the
command (pairs) or with its whole numbers at their largest (heavy).  A row that is refused says
nothing about its pairs: each of them, or the first N (--pairs), is run by itself.

Prints one JSON object for each line, with what is wrong, its processor time and its memory.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import resource
import signal
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import chdir, redirect_stderr, redirect_stdout, suppress
from itertools import combinations
from pathlib import Path
from random import Random
from typing import Any

import click
from command_bases import BASES, COMMANDS, ENDLESS, write_photographs
from option_combinations import Row, covering, pairs_of

from camctl.cli import main as camctl
from camctl.cli.parameter_types import (
    DynamicRange,
    FrameSize,
    ListOf,
    Name,
    Number,
    Seconds,
    SettingOf,
    Settings,
    WholeNumber,
)
from camctl.errors import CamctlError
from camctl.model.effective import MOST_SEARCHED

MOST_BYTES = 500 << 20

COSTLY = {
    "series --repeat": "Number of sets.",
    "calibrate delay --trials": "A trial takes about 20 frames.",
    "table build --exposures": "Takes seconds per row, most for rows of five exposures and more.",
    "table build --ranges": "Takes seconds per row, most for rows of five exposures and more.",
    "table show": "up to a minute for a row of 16 bits and 16 exposures.",
    "tradeoff capture --repeats": "the time grows with their number.",
    "tradeoff simulation --frames": "the time grows with their number.",
    "tradeoff simulation --tolerances": "each takes as many frames.",
    "tradeoff solver --seeds": "the time grows with their number.",
    "tradeoff solver --evaluations": "End a run also after N sets of exposures",
    "tradeoff solver --limit": "CPU time of a run.",
    "simulate --times": "the time grows with their number.",
}
"""Options (of `table show`: combinations of them) whose largest values take longer than the limit,
each with what its page says of the time; these commands show their progress, and go on."""

SIZES = ("--size", "--camera-option size=")
"""Options of the number of pixels, whose own memory counts beside the limit: a picture that does
not fit is refused because of its memory."""

LEFT_OUT = {"--workers"}
"""They start processes, each with memory of its own."""

UNCOMBINED = LEFT_OUT | {"--debug", "--size", "--camera-option", "--help"}
"""Options that are not combined: a traceback is more than one line, and pixels have their own
limit."""


def _beside(value: float, towards: float) -> str:
    return repr(math.nextafter(value, towards))


def corners(kind: Any) -> Iterator[str]:
    """Yield texts of values at and just beyond the bounds of an option's type."""
    if isinstance(kind, WholeNumber):
        yield from (str(kind._least), str(kind._least - 1))
        if kind._most is None:
            yield from ("1000", str(10**18))
        else:
            yield from (str(kind._most), str(kind._most + 1))
    elif isinstance(kind, Number):
        low, high = max(kind._above, kind._least), min(kind._below, kind._most)
        if math.isfinite(low):
            yield from (repr(low), _beside(low, math.inf), _beside(low, -math.inf))
        else:
            yield from ("-1e308", "-1e6")
        if math.isfinite(high):
            yield from (repr(high), _beside(high, -math.inf), _beside(high, math.inf))
        else:
            yield from ("1e6", "1e308")
    elif isinstance(kind, Seconds):
        yield from ("1e-300", "1e-9", repr(kind._least or 1e-6), "1e9", "1e308")
    elif isinstance(kind, DynamicRange):
        yield from ("1", _beside(1, 2), "1.0000001", "1.00001", "1.01", "1e6", "1e12", "1e308")
    elif isinstance(kind, FrameSize):
        yield from ("1x1", "999999999x1", "1x999999999", "999999999x999999999", "65536x65536")
    elif isinstance(kind, Settings):
        yield from ("1e-9", "1e-9:1:1e-9", "1:1e308:1e-3", ",".join(map(str, range(1, 2000))))
    elif isinstance(kind, ListOf):
        single = list(corners(kind._item))
        yield from (",".join(single[:2]), *single[2:], ",".join(["1", *single[-2:]]))
        yield ",".join(str(1 + k / 1000) for k in range(17))
        yield ",".join(str(k) for k in range(1, 17))
        yield ",".join(str(k) for k in range(1, 3001))


def options_of(command: str) -> Iterator[tuple[str, str, list[str]]]:
    """Yield name, prefix of the value, and values of each numeric option."""
    for option in COMMANDS[command].params:
        if not isinstance(option, click.Option) or LEFT_OUT & set(option.opts):
            continue
        name = option.opts[-1]
        if isinstance(option.type, SettingOf):
            for field, (_, kind) in option.type._table.items():
                yield name, f"{field}=", list(corners(kind))
        else:
            yield name, "", list(corners(option.type))


def lines() -> Iterator[tuple[str, list[str]]]:
    """Yield "command --option" and the arguments of each command line."""
    for command, bases in BASES.items():
        for place, (name, prefix, values) in enumerate(options_of(command)):
            if f"{command} {name}" in ENDLESS:
                continue
            base = bases[place % len(bases)].split()
            for value in values:
                yield (
                    f"{command} {name} {prefix}".strip(),
                    [
                        *command.split(),
                        *base,
                        f"{name}={prefix}{value}" if name.startswith("--") else name,
                        *([] if name.startswith("--") else [f"{prefix}{value}"]),
                    ],
                )


def accepted(option: click.Option, command: str) -> dict[str, list[str]]:
    """Return the different values of an option, or of each of its fields, that its type accepts."""
    kind, name = option.type, option.opts[-1]
    if isinstance(kind, SettingOf):
        kinds = {f"{name} {field}=": each for field, (_, each) in kind._table.items()}
    else:
        kinds = {name: kind}
    return {
        label: texts[:1] if f"{command} {label}".strip() in COSTLY else texts
        for label, each in kinds.items()
        if (texts := list(_accepted(each, option.is_flag)))
    }


def _accepted(kind: Any, is_flag: bool) -> Iterator[str]:
    if is_flag:
        yield ""
    elif isinstance(kind, Name):
        yield from kind.names
    last = math.nan
    for text in corners(kind):
        with suppress(CamctlError):
            value = kind.parse(text, "--option")
            if isinstance(value, float) and math.isclose(value, last, rel_tol=1e-9):
                continue
            last = value if isinstance(value, float) else math.nan
            yield text


#: Values that cost the most, where a larger one is refused: of more exposures none are searched.
LARGEST = {"--exposures": str(MOST_SEARCHED)}


def combined_values(command: str) -> dict[str, list[str]]:
    """Return the values of each option of a command that are combined."""
    values: dict[str, list[str]] = {}
    for option in COMMANDS[command].params:
        if isinstance(option, click.Option) and not UNCOMBINED & set(option.opts):
            values.update(accepted(option, command))
    for name in LARGEST.keys() & values.keys():
        values[name] = [*dict.fromkeys([*values[name], LARGEST[name]])]
    return {name: texts for name, texts in values.items() if f"{command} {name}" not in ENDLESS}


def largest(command: str) -> Row:
    """Return the whole numbers of a command at the largest values that their types accept."""
    return tuple(
        (option.opts[-1], LARGEST.get(option.opts[-1], str(option.type._most)))
        for option in COMMANDS[command].params
        if isinstance(option.type, WholeNumber)
        and option.type._most is not None
        and not UNCOMBINED & set(option.opts)
        and f"{command} {option.opts[-1]}" not in COSTLY
    )


def line_of(command: str, base: str, row: Row) -> list[str]:
    """Return the arguments of a command with values of several options."""
    given = [*command.split(), *base.split()]
    for name, text in row:
        option, _, field = name.partition(" ")
        if not text:
            given.append(option)
        elif option.startswith("--"):
            given.append(f"{option}={field}{text}")
        else:
            given += [option, f"{field}{text}"]
    return given


def rows_of(command: str, how: str, seed: int, most: int) -> Iterator[Row]:
    """Yield the rows of a command."""
    random = Random(f"{seed} {command} {how}")
    values = combined_values(command)
    rows = list(covering(values, random))
    yield from random.sample(rows, min(most, len(rows)))


def import_all(commands: Iterable[str], folder: Path) -> None:
    """Run a line of each command in this process: its children need not import anything."""
    for command in commands:
        with (
            chdir(folder / "work"),
            (folder / "out").open("w") as output,
            redirect_stdout(output),
            redirect_stderr(output),
        ):
            camctl([*command.split(), *BASES[command][0].split()])


def run_line(arguments: list[str], seconds: int, folder: Path) -> dict[str, Any]:
    """Run a command line in a child process; return how it ended."""
    child = os.fork()
    if child == 0:
        _child(arguments, seconds, folder)
    _, status, used = os.wait4(child, 0)
    error = (folder / "err").read_text(errors="replace")
    # A child begins without the pages of libraries, which count when it uses them.
    before = int((folder / "resident").read_text())
    found = {
        "seconds": round(used.ru_utime + used.ru_stime, 1),
        "mb": max(0, round(used.ru_maxrss / 1024 - before / 2**20)),
        "status": os.waitstatus_to_exitcode(status),
    }
    if found["mb"] > MOST_BYTES >> 20:
        return {"wrong": f"{found['mb']} MB", **found}
    return {"wrong": _wrong(status, error), **found}


def _resident() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def _child(arguments: list[str], seconds: int, folder: Path) -> None:
    status = 99
    try:
        (folder / "resident").write_text(str(_resident()))
        os.chdir(folder / "work")
        for descriptor, name in ((1, "out"), (2, "err")):
            file = os.open(folder / name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            os.dup2(file, descriptor)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        sys.stdout = os.fdopen(1, "w", closefd=False)
        sys.stderr = os.fdopen(2, "w", closefd=False)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        # A line that waits uses no processor time; a machine with other work gives it a tenth.
        signal.alarm(10 * seconds)
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        # Address space is reserved for threads and never used; what is used is looked at later.
        most = pages * resource.getpagesize() + 4 * MOST_BYTES
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        status = camctl(arguments)
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(status)


def _is_excused(name: str, wrong: str) -> bool:
    """Return whether a line may take as much as it did."""
    took_long = wrong == f"ended by signal {signal.SIGXCPU}" or wrong == "ended by signal 9"
    return (took_long and name in COSTLY) or (
        name.endswith(SIZES) and wrong.startswith("camctl: not enough memory")
    )


def _wrong(status: int, error: str) -> str:
    """Return what is wrong with how a line ended, "" where nothing is."""
    if os.WIFSIGNALED(status):
        return f"ended by signal {os.WTERMSIG(status)}"
    code = os.WEXITSTATUS(status)
    errors = [line for line in error.splitlines() if not line.startswith("camctl: warning: ")]
    if code not in (0, 1, 2, 3):
        return f"status {code}: {error[-300:]}"
    if "not enough memory" in error or "internal error" in error:
        return error[-300:]
    is_guided = len(errors) > 1 and errors[0].startswith("camctl: 1. ")  # instructions
    if len(errors) != (code in (1, 2)) and not is_guided:
        return f"{len(errors)} lines: {error[:300]}"
    return ""


def single(only: str, every: int) -> Iterator[tuple[str, list[str]]]:
    """Yield each k-th line of one option, of those whose name contains a text."""
    for place, (name, arguments) in enumerate(lines()):
        if only in name and place % every == 0:
            yield name, arguments


class Contract:
    """Runs lines in a folder of their own, and prints how each ended."""

    def __init__(self, seconds: int, folder: Path, pairs: int | None = None) -> None:
        self.seconds, self.folder, self.pairs = seconds, folder, pairs

    def run(self, name: str, arguments: list[str]) -> bool:
        """Run one line; return whether it was carried out, and not refused."""
        found = run_line(arguments, self.seconds, self.folder)
        if _is_excused(name, found["wrong"]):
            found = {**found, "wrong": "", "excused": found["wrong"]}
        line = " ".join(arguments)
        shown = line if len(line) < 400 else f"{line[:300]} ... {line[-80:]}"
        print(json.dumps({"option": name, "line": shown, **found}), flush=True)
        return found["status"] not in (1, 2)

    def combine(self, command: str, how: str, seed: int, most: int) -> None:
        """Run rows of a command; the pairs of those that are refused one by one."""
        done: set[frozenset[tuple[str, str]]] = set()
        for k, row in enumerate(rows_of(command, how, seed, most)):
            base = BASES[command][k % len(BASES[command])]
            names = {name for name, _ in row}
            counts = [each for each in largest(command) if how == "heavy" and each[0] not in names]
            if self.run(command, line_of(command, base, (*counts, *row))):
                done |= set(pairs_of(row))
                continue
            left = [pair for pair in combinations(row, 2) if frozenset(pair) not in done]
            for pair in left[: self.pairs]:
                done.add(frozenset(pair))
                self.run(command, line_of(command, base, (*counts, *pair)))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=int, default=60)
    parser.add_argument("--only", default="")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--combine", choices=("pairs", "heavy"))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--most", type=int, default=1 << 30)
    parser.add_argument("--pairs", type=int)
    given = parser.parse_args()
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # libraries then start no threads
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        (folder / "work").mkdir()
        write_photographs(folder / "work")
        names = {"CAMCTL_CACHE": "cache", "CAMCTL_PROFILES": "profiles", "XDG_STATE_HOME": "state"}
        os.environ.update({name: str(folder / each) for name, each in names.items()})
        contract = Contract(given.seconds, folder, given.pairs)
        if given.combine:
            commands = [each for each in BASES if f"{each} ".startswith(given.only)]
            import_all(commands, folder)
            for command in commands:
                contract.combine(command, given.combine, given.seed, given.most)
            return
        chosen = list(single(given.only, given.every))
        import_all(sorted({name.split(" -")[0] for name, _ in chosen}), folder)
        for name, arguments in chosen:
            contract.run(name, arguments)


if __name__ == "__main__":
    main()
