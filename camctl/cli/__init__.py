"""The command line: one module per command, imported when the command runs."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Iterable, Sequence
from contextlib import suppress

import click
from click.shell_completion import CompletionItem

import camctl
from camctl.cli.commands import DEBUG_KEY, LazyGroup, command, one_line
from camctl.cli.output import (
    ClosedOutputError,
    print_error,
    print_json,
    print_text,
    standard_streams,
)
from camctl.errors import CamctlError, StorageError, UsageError, unknown_name, visible
from camctl.system.interrupts import Handler, last_interrupt, run_interruptible, signal_handlers
from camctl.system.system_errors import resource_error

_LONG_NAME = re.compile(r"\S{300,}")
"""A name that would fill the screen."""

COMMANDS = (
    "shoot",
    "series",
    "preview",
    "live",
    "alpaca",
    "resume",
    "merge",
    "menu",
    "studio",
    "cameras",
    "calibrate",
    "profile",
    "simulate",
    "solve",
    "evaluate",
    "table",
    "tradeoff",
    "figures",
    "doctor",
    "schema",
)
"""Each is a module of this package that holds a command of the same name."""

cli = LazyGroup(
    "camctl",
    COMMANDS,
    help=(
        "Take several exposures and sum them into one picture of high dynamic range.\n\n"
        "Choose how brightness depends on light (linear, gamma, or log for equal contrast in "
        "shadows and highlights), the dynamic range, and the number of exposures. camctl looks up "
        "which exposures give the most accurate picture, shoots them, and sums them."
    ),
    examples=(
        ("camctl shoot", "the simulated camera and a scene of floor tiles: no hardware needed"),
        ("camctl shoot --response log --range high -n 4", "a larger range, one more exposure"),
        ("camctl solve --response gamma -n 3", "the exposures alone, without a camera"),
        ("camctl help COMMAND", "what a command does, with examples"),
    ),
    epilog=(
        "\b\nCompletion of commands and values with the Tab key, in bash (zsh_source and "
        'fish_source\nfor zsh and fish):\n  eval "$(_CAMCTL_COMPLETE=bash_source camctl)"'
    ),
)


def _show_version(context: click.Context, _option: click.Parameter, value: bool) -> None:
    if value and not context.resilient_parsing:
        print_text(f"camctl {camctl.__version__}")
        context.exit()


cli.params.append(
    click.Option(
        ["-V", "--version"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_show_version,
        help="Show the version.",
    )
)


def _complete_command(
    context: click.Context, _argument: click.Parameter, incomplete: str
) -> list[CompletionItem]:
    """Return the commands below those already named that start with `incomplete`."""
    named = _context_of(context.params.get("names") or (), context.find_root())
    group = named.command
    names = group.list_commands(named) if isinstance(group, click.Group) else []
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


def _context_of(names: Iterable[str], root: click.Context) -> click.Context:
    """Return a context of the command that `names` leads to from the top."""
    context = root
    for name in names:
        group = context.command
        if not isinstance(group, click.Group):
            raise UsageError(f"{context.command_path} has no commands of its own")
        found = group.get_command(context, name)
        if found is None:
            raise unknown_name("command", name, group.list_commands(context))
        context = found.make_context(name, [], parent=context, resilient_parsing=True)
    return context


@command(
    parent=cli,
    name="help",
    examples=(
        ("camctl help", "the commands"),
        ("camctl help shoot", "the same page as camctl shoot --help"),
        ("camctl help table build", "a command of a command"),
    ),
)
@click.argument("names", nargs=-1, metavar="[COMMAND]...", shell_complete=_complete_command)
@click.pass_context
def help_(context: click.Context, names: tuple[str, ...]) -> None:
    """Show the help page of a command."""
    print_text(_context_of(names, context.find_root()).get_help())


def main(
    arguments: Sequence[str] | None = None, *, handler_afterwards: Handler | None = None
) -> int:
    """Run one command line (without the program's name) and return its exit status.

    After the command, signals are handled by `handler_afterwards`; None: as they were before.

    0: done.  1: it could not be done.  2: invalid usage.  3: a picture contradicts its own frames.
    130, 143, 129: ended by Control-C, SIGTERM, SIGHUP.  An error is one line on standard error,
    with ``--json`` also a JSON object on standard output; the traceback is printed only with
    ``--debug``.
    """
    completion = os.environ.get("_CAMCTL_COMPLETE")
    if completion:
        from click.shell_completion import shell_complete

        return shell_complete(cli, {}, "camctl", "_CAMCTL_COMPLETE", completion)
    given = list(sys.argv[1:] if arguments is None else arguments)
    with standard_streams(), signal_handlers(handler_afterwards):
        context: click.Context | None = None

        def run() -> None:
            nonlocal context
            with cli.make_context("camctl", given) as context:
                cli.invoke(context)

        try:
            run_interruptible(run)
        except click.exceptions.Exit as exit_request:
            return exit_request.exit_code
        except ClosedOutputError:
            return 1
        except SystemExit:
            raise
        except BaseException as error:
            if context is not None and context.meta.get(DEBUG_KEY):
                for line in "".join(traceback.format_exception(error)).splitlines():
                    sys.stderr.write(visible(line) + "\n")
            return _report(error, as_json="--json" in given)
    return 0


def _report(error: BaseException, *, as_json: bool) -> int:
    """Print the error and return the exit status."""
    interrupt = last_interrupt()
    if interrupt is not None and not isinstance(error, CamctlError):
        # A library may have dropped the interrupt, and failed in another way because of it.
        status, kind, message, hint = _describe(interrupt)
    else:
        status, kind, message, hint = _describe(error)
    # What became of a capture.
    notes = [one_line(note) for note in getattr(error, "__notes__", ())]
    if notes and not isinstance(error, CamctlError) and hasattr(error, "remedies"):
        from camctl.messages.command_line import with_remedies  # loads pydantic

        notes[-1] = with_remedies(notes[-1], error.remedies)
    if interrupt is not None:
        status = 128 + interrupt.number
    # Notes and hints hold commands to be pasted: they stay whole.
    print_error("; ".join(filter(None, [_shortened(message), *notes, hint])))
    message = "; ".join([message, *notes])
    if as_json:
        with suppress(ClosedOutputError, StorageError):
            print_json({"error": {"type": kind, "message": message, "hint": hint or None}})
    return status


def _shortened(line: str) -> str:
    """Return a line without the middle of names that are too long to be read."""
    return _LONG_NAME.sub(lambda found: f"{found[0][:40]}...{found[0][-40:]}", line)


def _describe(error: BaseException) -> tuple[int, str, str, str]:
    """Return the exit status, type name, message and hint of an error; each text is one line."""
    error = resource_error(error) or error
    kind = type(error).__name__
    if isinstance(error, CamctlError):
        from camctl.messages.command_line import error_hint  # loads pydantic

        return error.exit_status, kind, one_line(error.what), one_line(error_hint(error))
    if isinstance(error, click.ClickException):
        return UsageError.exit_status, "UsageError", one_line(error.format_message()), ""
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return 130, "KeyboardInterrupt", one_line(str(error) or "interrupted"), ""
    text = " ".join(f"internal error: {kind}: {error}".split()).rstrip(": ")
    return 1, kind, one_line(text), "run again with --debug for the traceback"
