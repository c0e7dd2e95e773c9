"""Defaults of one's own for common options: a configuration file in TOML."""

from __future__ import annotations

import os
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import click
from platformdirs import user_config_path

from camctl.cli.parameter_types import DynamicRange, NameOrFile
from camctl.errors import DataError, UsageError, unknown_name
from camctl.exposure.goal import AUTO
from camctl.model.response.names import RESPONSES
from camctl.system.input_files import exists, read_input_text

#: Commands that make a picture; response and range of others are those of a study.
PICTURES: Final = ("shoot", "series", "preview", "merge")

_SETTINGS: Final[dict[str, Callable[[str, str], object]]] = {
    "camera": lambda text, _: text,
    "folder": lambda text, _: Path(text).expanduser(),
    "response": NameOrFile("response", (*RESPONSES, AUTO)).parse,
    "range": DynamicRange(auto=True).parse,
}
"""What a file may set, and what checks it: the text, and what an error calls it."""


def configuration_file() -> Path:
    """Return the path of the file: $CAMCTL_CONFIG, else in the user's configuration folder."""
    named = os.environ.get("CAMCTL_CONFIG")
    return Path(named) if named else user_config_path("camctl") / "config.toml"


@dataclass(frozen=True)
class Configuration:
    """What the user's file sets, by the names in it."""

    given: Mapping[str, Any]

    @classmethod
    def load(cls) -> Configuration:
        """Read the file; nothing is set where there is none.

        Raises:
            DataError: it is no TOML
            UsageError: it sets something unknown, or to an invalid value
        """
        path = configuration_file()
        if not exists(str(path)):
            return cls({})
        try:
            content = tomllib.loads(read_input_text(path, "configuration"))
        except tomllib.TOMLDecodeError as error:
            raise DataError(
                f"configuration {path} is no TOML: {error}",
                hint='write lines such as range = "high"',
            ) from error
        given = {}
        for name, value in content.items():
            try:
                given[name] = _checked(name, value)
            except UsageError as error:
                raise UsageError(f"{error.what} in {path}", hint=error.hint) from error
        return cls(given)

    @property
    def folder(self) -> Path:
        """Where results are put that no option names a folder for."""
        return Path(self.given.get("folder", ""))


def _checked(name: str, value: object) -> object:
    """Return what a setting is set to; raise `UsageError` where it is none or not valid."""
    if name not in _SETTINGS:
        raise unknown_name("setting", name, _SETTINGS)
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise UsageError(f"invalid value for {name}", hint="expected one text or number")
    return _SETTINGS[name](str(value), name)


class Defaults(Mapping[str, Any]):
    """Defaults of a command's parameters, by their names; the file is read when one is needed."""

    def __init__(self, command: click.Command) -> None:
        self._settings: dict[str, str] = {}
        # Studies name a camera only where one is asked for: it has no default.
        if any((each.name, each.default) == ("camera_id", "sim") for each in command.params):
            self._settings["camera_id"] = "camera"
        if command.name == "menu":
            self._settings["parent"] = "folder"
        if command.name in PICTURES:
            self._settings |= {"response": "response", "dynamic_range": "range"}
        self._given: Mapping[str, Any] | None = None

    def __getitem__(self, name: str) -> Any:
        setting = self._settings[name]
        if self._given is None:
            self._given = Configuration.load().given
        return self._given[setting]

    def __iter__(self) -> Iterator[str]:
        return (name for name in self._settings if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)


def yield_to_given(values: dict[str, Any], context: click.Context) -> None:
    """Remove defaults of the file that contradict options given on the command line.

    Args:
        values: of the parameters by name; None where there is none
        context: of the command
    """
    source = context.get_parameter_source
    is_given = {
        name: source(name) is click.core.ParameterSource.COMMANDLINE and value is not None
        for name, value in values.items()
    }

    def is_file(response: Any) -> bool:
        return response is not None and response not in (*RESPONSES, AUTO)

    response = values.get("response")
    contradicts = {
        "response": is_given.get("gamma")
        or (response == AUTO and is_given.get("ratios"))
        or (is_file(response) and is_given.get("dynamic_range")),
        "dynamic_range": is_given.get("response") and is_file(response),
    }
    for name, others in contradicts.items():
        if others and source(name) is click.core.ParameterSource.DEFAULT_MAP:
            values[name] = None
