"""The command line: one module a command, nothing imported before a command needs it."""

from __future__ import annotations

import os
import sys
import traceback
from collections.abc import Sequence

import click

import camctl
from camctl.cli.commands import UNDER_DEBUG, LazyGroup, one_line
from camctl.cli.output import ClosedOutputError, say
from camctl.errors import CamctlError, UsageError

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
        "Take a high-dynamic-range picture from the exposures that serve your picture best.\n\n"
        "You say how brightness shall follow light (linear, gamma, or log for equal contrast "
        "everywhere), over which range, and in how many exposures; camctl looks up which "
        "exposures to combine, shoots them, and sums them into one picture."
    ),
    examples=(
        ("camctl shoot", "a simulated camera before a tile floor: nothing to connect"),
        ("camctl shoot --response log --range high -n 4", "more range, one more exposure"),
        ("camctl solve --response gamma -n 3", "only the exposures, without a camera"),
        ("camctl COMMAND --help", "what a command can do, with examples"),
    ),
    epilog=(
        "\b\nCompletion with the Tab key in bash (zsh and fish: zsh_source, fish_source):\n"
        '  eval "$(_CAMCTL_COMPLETE=bash_source camctl)"'
    ),
)


def _show_version(context: click.Context, _option: click.Parameter, value: bool) -> None:
    if value:
        say(f"camctl {camctl.__version__}")
        context.exit()


cli.params.append(
    click.Option(
        ["--version"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_show_version,
        help="Show the version.",
    )
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command line (without the program's name) and return its exit status.

    0: done.  1: it could not be done.  2: the words are off.  130: interrupted.  Whatever is wrong
    becomes one line on standard error; the traceback is printed only with ``--debug``.
    """
    completion = os.environ.get("_CAMCTL_COMPLETE")
    if completion:
        from click.shell_completion import shell_complete

        return shell_complete(cli, {}, "camctl", "_CAMCTL_COMPLETE", completion)
    words = list(sys.argv[1:] if arguments is None else arguments)
    context: click.Context | None = None
    try:
        with cli.make_context("camctl", words) as context:
            cli.invoke(context)
        return 0
    except click.exceptions.Exit as done:
        return done.exit_code
    except ClosedOutputError:
        # Whoever read our output has enough; the interpreter must not complain on its way out.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except BaseException as error:
        if isinstance(error, SystemExit):
            raise
        if context is not None and context.meta.get(UNDER_DEBUG):
            traceback.print_exc()
        status, message = _verdict(error)
        sys.stderr.write(f"camctl: {message}\n")
        return status


def _verdict(error: BaseException) -> tuple[int, str]:
    """Return the exit status for an error, and the line that tells of it."""
    if isinstance(error, CamctlError):
        return error.exit_status, one_line(str(error))
    if isinstance(error, click.ClickException):
        return UsageError.exit_status, one_line(error.format_message())
    if isinstance(error, KeyboardInterrupt | click.Abort):
        return 130, "interrupted"
    said = one_line(f"{type(error).__name__}: {error}".rstrip(": "))
    return 1, f"internal error: {said}; run again with --debug for the traceback"
