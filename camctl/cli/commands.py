"""What all commands share: help with examples, errors of one line, late imports."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any, TypeAlias

import click

from camctl.cli.output import say
from camctl.errors import UsageError, unknown_name

UNDER_DEBUG = "camctl.debug"
"""Key in a context's `meta` that says whether the user asked for tracebacks."""

Examples: TypeAlias = Sequence[tuple[str, str]]

_CONTEXT = {"help_option_names": ["-h", "--help"], "show_default": True, "max_content_width": 100}


def one_line(text: str) -> str:
    """Return `text` as one line without trailing stop."""
    return " ".join(text.split()).removesuffix(".")


def _note_debug(context: click.Context, _option: click.Parameter, value: bool) -> None:
    if value:
        context.meta[UNDER_DEBUG] = True


def _debug_option() -> click.Option:
    return click.Option(
        ["--debug"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_note_debug,
        help="Show the traceback of an error.",
    )


def _show_help(context: click.Context, _option: click.Parameter, value: bool) -> None:
    if value:
        say(context.get_help())
        context.exit()


@click.pass_context
def _help_where_no_command(context: click.Context) -> None:
    if context.invoked_subcommand is None:
        say(context.get_help())


class Command(click.Command):
    """A command whose help shows examples and whose usage errors fit on one line."""

    def __init__(self, *arguments: Any, examples: Examples = (), **settings: Any) -> None:
        settings["context_settings"] = _CONTEXT | settings.get("context_settings", {})
        super().__init__(*arguments, **settings)
        self.examples = examples
        self.params.append(_debug_option())

    def get_help_option(self, ctx: click.Context) -> click.Option | None:
        """Return the help option; it writes as every other output is written."""
        option = super().get_help_option(ctx)
        if option is not None:
            option.callback = _show_help
            option.help = "Show this page."
        return option

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what the command does, then the examples, before the options."""
        super().format_help_text(ctx, formatter)
        if self.examples:
            with formatter.section("Examples"):
                for line, what in self.examples:
                    formatter.write(f"{'':{formatter.current_indent}}{line}\n")
                    formatter.write_text(f"    {what}" if len(what) < 70 else what)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse; what is wrong becomes a `UsageError` that names the near words."""
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            known = [word for option in self.get_params(ctx) for word in option.opts]
            long = [word for word in known if word.startswith("--")]
            raise unknown_name("option", error.option_name, long) from error
        except click.UsageError as error:
            said = one_line(error.format_message())
            raise UsageError(
                said[:1].lower() + said[1:], hint=f"see {ctx.command_path} --help"
            ) from error


class LazyGroup(Command, click.Group):
    """A group whose commands are modules of `package`, imported when they are named."""

    def __init__(
        self,
        name: str,
        modules: Sequence[str] = (),
        *,
        package: str = "camctl.cli",
        **settings: Any,
    ) -> None:
        super().__init__(
            name, invoke_without_command=True, callback=_help_where_no_command, **settings
        )
        self._modules = tuple(modules)
        self._package = package

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order in which they were given."""
        return [*self._modules, *self.commands]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command's module and return the command, None if there is none."""
        if cmd_name in self._modules:
            found = getattr(import_module(f"{self._package}.{cmd_name}"), cmd_name)
            assert isinstance(found, click.Command)
            return found
        return self.commands.get(cmd_name)

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands, then the options."""
        self.format_commands(ctx, formatter)
        click.Command.format_options(self, ctx, formatter)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that the first word names; raise `UsageError` with the near ones."""
        name = args[0]
        command = self.get_command(ctx, name)
        if command is None:
            raise unknown_name("command", name, self.list_commands(ctx))
        return name, command, args[1:]


def command(
    *, examples: Examples, parent: click.Group | None = None, **settings: Any
) -> Callable[[Callable[..., Any]], Command]:
    """Decorate a function as a command of its own name, with examples in its help."""

    def decorate(function: Callable[..., Any]) -> Command:
        made = click.command(cls=Command, examples=examples, **settings)(function)
        if parent is not None:
            parent.add_command(made)
        return made

    return decorate
