"""The address of a panel: its device, and options after commas, such as size=20x4."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from camctl.errors import UsageError, unknown_name


@dataclass(frozen=True)
class PanelAddress:
    """The words of an address: those without "=", the first of them the device, and the others."""

    words: tuple[str, ...]
    options: Mapping[str, str]

    def number(self, name: str, default: int) -> int:
        """Return an option that is a number, decimal or 0x hexadecimal.

        Raises:
            UsageError: it is none
        """
        text = self.options.get(name)
        if text is None:
            return default
        try:
            return int(text, 0)
        except ValueError as error:
            raise UsageError(
                f"invalid {name}={text} of the panel", hint=f"use a number, such as {default}"
            ) from error

    def size(self, least: tuple[int, int]) -> tuple[int, int]:
        """Return the option `size`, such as 20x4, or else the `least` one.

        Raises:
            UsageError: it is none, or smaller than `least`
        """
        text = self.options.get("size")
        if text is None:
            return least
        columns, _, rows = text.partition("x")
        is_size = columns.isascii() and columns.isdigit() and rows.isascii() and rows.isdigit()
        if not is_size or int(columns) < least[0] or int(rows) < least[1]:
            raise UsageError(
                f"invalid size={text} of the panel", hint=f"use {least[0]}x{least[1]} or more"
            )
        return int(columns), int(rows)


def parse_address(text: str, known: Collection[str]) -> PanelAddress:
    """Return the parts of an address.

    Args:
        text: the device and options, with commas between them
        known: names of the options

    Raises:
        UsageError: an option is not known
    """
    words, options = [], {}
    for word in text.split(","):
        name, equals, value = word.partition("=")
        if not equals:
            words.append(word)
        elif name not in known:
            raise unknown_name("option of the panel", name, known)
        else:
            options[name] = value
    return PanelAddress(tuple(words), options)
