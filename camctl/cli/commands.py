"""Base classes of the commands: help pages with examples, one-line usage errors, late imports."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from typing import Any, TypeAlias

import click

from camctl.cli.configuration import Defaults
from camctl.cli.output import logged_warnings, print_text
from camctl.errors import CamctlError, UsageError, unknown_name, visible

DEBUG_KEY = "camctl.debug"
"""Key in a context's `meta` that is present where the user asked for tracebacks."""

Examples: TypeAlias = Sequence[tuple[str, str]]
"""Command lines with what each does."""

_LONG_EXPLANATION = 70
"""From this many characters on, an example's explanation is wrapped as a paragraph."""

_AS_SETTINGS = {
    "--levels": ("--set", "levels"),
    "--objective": ("--set", "objective"),
    "--tolerance": ("--set", "tolerance"),
    "--seed": ("-O", "seed"),
}
"""Options that several commands share, and the setting that each is where one lacks the option."""

_CONTEXT = {
    "help_option_names": ["-h", "--help"],
    "show_default": True,
    "max_content_width": 100,
    "allow_extra_args": True,  # they are refused in `Command.parse_args`
}


def one_line(text: str) -> str:
    """Return `text` as one visible line without a full stop at its end."""
    return visible(text.strip()).removesuffix(".")


def _remember_debug(context: click.Context, _option: click.Parameter, value: bool) -> None:
    if value:
        context.meta[DEBUG_KEY] = True


def _debug_option() -> click.Option:
    return click.Option(
        ["--debug"],
        is_flag=True,
        is_eager=True,
        expose_value=False,
        callback=_remember_debug,
        help="Show the traceback of an error.",
    )


def _show_help(context: click.Context, _option: click.Parameter, value: bool) -> None:
    if value and not context.resilient_parsing:
        print_text(context.get_help())
        context.exit()


@click.pass_context
def _show_help_without_command(context: click.Context) -> None:
    if context.invoked_subcommand is None:
        print_text(context.get_help())


class Command(click.Command):
    """A command whose help shows examples and whose usage errors fit on one line.

    `others_refused` says why options of other commands cannot be given.
    """

    def __init__(
        self, *arguments: Any, examples: Examples = (), others_refused: str = "", **settings: Any
    ) -> None:
        settings["context_settings"] = _CONTEXT | settings.get("context_settings", {})
        super().__init__(*arguments, **settings)
        self.examples, self._others_refused = examples, others_refused
        self.params.append(_debug_option())

    def make_context(
        self,
        info_name: str | None,
        args: list[str],
        parent: click.Context | None = None,
        **extra: Any,
    ) -> click.Context:
        """Return a context with the defaults of the user's configuration file."""
        if not isinstance(self, click.Group):
            extra["default_map"] = Defaults(self)
        return super().make_context(info_name, args, parent, **extra)

    def get_help(self, ctx: click.Context) -> str:
        """Return the help page, with the defaults that hold without a configuration file."""
        ctx.default_map = None
        return super().get_help(ctx)

    def get_help_option(self, ctx: click.Context) -> click.Option | None:
        """Return the help option, which prints through `print_text`."""
        option = super().get_help_option(ctx)
        if option is not None:
            option.callback = _show_help
            option.help = "Show this help page."
        return option

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what the command does, then the examples, before the options."""
        super().format_help_text(ctx, formatter)
        if self.examples:
            with formatter.section("Examples"):
                for line, explanation in self.examples:
                    formatter.write(f"{'':{formatter.current_indent}}{line}\n")
                    is_short = len(explanation) < _LONG_EXPLANATION
                    formatter.write_text(f"    {explanation}" if is_short else explanation)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; what it logs is printed as warnings.

        An error of a file names -o only where the command has it.
        """
        if isinstance(self, click.Group):
            return super().invoke(ctx)
        with logged_warnings():
            try:
                return super().invoke(ctx)
            except CamctlError as error:
                if not any("-o" in each.opts for each in self.params):
                    error.remedies.pop("directory", None)
                raise

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse; raise `UsageError` with similar names or with the help page to read."""
        try:
            rest = super().parse_args(ctx, list(self._with_settings(args)))
        except click.NoSuchOption as error:
            if self._others_refused:
                raise UsageError(
                    f"unknown option '{error.option_name}'", hint=self._others_refused
                ) from error
            names = [name for option in self.get_params(ctx) for name in option.opts]
            long = [name for name in names if name.startswith("--")]
            raise unknown_name("option", error.option_name, long) from error
        except click.MissingParameter as error:
            param = error.param or ctx.command.params[0]
            name = param.opts[-1] if isinstance(param, click.Option) else param.human_readable_name
            raise _usage_error(f"{param.param_type_name} {name} is missing", ctx) from error
        except click.UsageError as error:
            message = one_line(error.format_message())
            raise _usage_error(message[:1].lower() + message[1:], ctx) from error
        if rest and not isinstance(self, click.Group) and not ctx.resilient_parsing:
            raise _usage_error(f"unexpected argument '{rest[0]}'", ctx)
        return rest

    def _with_settings(self, args: Iterable[str]) -> Iterator[str]:
        """Yield the arguments with the options of `_AS_SETTINGS` as settings."""
        own = {name for each in self.params for name in each.opts}
        words = iter(args)
        for word in words:
            if word == "--":
                yield from (word, *words)
                return
            name, equals, value = word.partition("=")
            option, setting = _AS_SETTINGS.get(name, ("", ""))
            if name in own or option not in own:
                yield word
            else:
                yield from (option, f"{setting}={value if equals else next(words, '')}")


def _usage_error(message: str, context: click.Context) -> UsageError:
    return UsageError(message, hint=f"see {context.command_path} --help")


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
            name, invoke_without_command=True, callback=_show_help_without_command, **settings
        )
        self._modules = tuple(modules)
        self._package = package

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order in which they were given."""
        return [*self._modules, *self.commands]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Import a command's module and return the command, None for an unknown name."""
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
        """Return the command that the first argument names; `UsageError` for an unknown one."""
        name, rest = args[0], args[1:]
        if name == "shoot" and "--resume" in rest:
            name, rest = "resume", [word for word in rest if word != "--resume"]
        command = self.get_command(ctx, name)
        if command is None and not ctx.resilient_parsing:
            raise unknown_name("command", name, self.list_commands(ctx))
        return name if command else None, command, rest


def command(
    *, examples: Examples, parent: click.Group | None = None, **settings: Any
) -> Callable[[Callable[..., Any]], Command]:
    """Return a decorator that makes a function a command of its own name with examples."""

    def decorate(function: Callable[..., Any]) -> Command:
        created = click.command(cls=Command, examples=examples, **settings)(function)
        if parent is not None:
            parent.add_command(created)
        return created

    return decorate
