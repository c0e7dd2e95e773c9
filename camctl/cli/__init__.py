"""The command line: one module per command, imported when the command runs."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Iterable, Sequence

import click
from click.shell_completion import CompletionItem

import camctl
from camctl.cli.commands import DEBUG_KEY, LazyGroup, command, one_line
from camctl.cli.output import ClosedOutputError, print_json, print_text
from camctl.errors import CamctlError, UsageError, unknown_name

COMMANDS = (
    "shoot",
    "menu",
    "cameras",
    "calibrate",
    "profile",
    "simulate",
    "solve",
    "evaluate",
    "table",
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (without the program's name) and return its exit status.

    0: done.  1: it could not be done.  2: invalid usage.  130: interrupted.  An error is one line
    on standard error, with ``--json`` also a JSON object on standard output; the traceback is
    printed only with ``--debug``.
    """
    completion = os.environ.get("_CAMCTL_COMPLETE")
    if completion:
        from click.shell_completion import shell_complete

        return shell_complete(cli, {}, "camctl", "_CAMCTL_COMPLETE", completion)
    given = list(sys.argv[1:] if arguments is None else arguments)
    context: click.Context | None = None
    try:
        with cli.make_context("camctl", given) as context:
            cli.invoke(context)
        return 0
    except click.exceptions.Exit as exit_request:
        return exit_request.exit_code
    except ClosedOutputError:
        return _close_output()
    except BaseException as error:
        if isinstance(error, SystemExit):
            raise
        if context is not None and context.meta.get(DEBUG_KEY):
            traceback.print_exc()
        status, kind, message, hint = _describe(error)
        sys.stderr.write(f"camctl: {f'{message}; {hint}' if hint else message}\n")
        if "--json" in given:
            try:
                print_json({"error": {"type": kind, "message": message, "hint": hint or None}})
            except ClosedOutputError:
                _close_output()
        return status


def _close_output() -> int:
    """Point standard output at nothing, so that the interpreter does not complain at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 1


def _describe(error: BaseException) -> tuple[int, str, str, str]:
    """Return the exit status, type name, message and hint of an error; each text is one line."""
    if isinstance(error, ImportError):
        from camctl.backends import shadowing_error

        error = shadowing_error(error) or error
    kind = type(error).__name__
    if isinstance(error, CamctlError):
        return error.exit_status, kind, one_line(error.what), one_line(error.hint)
    if isinstance(error, click.ClickException):
        return UsageError.exit_status, "UsageError", one_line(error.format_message()), ""
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return 130, "KeyboardInterrupt", "interrupted", ""
    message = one_line(f"internal error: {kind}: {error}".rstrip(": "))
    return 1, kind, message, "run again with --debug for the traceback"
