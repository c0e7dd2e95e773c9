"""Write the states of the menu from its tables: the page, and the drawing with graphviz's dot.

The drawing holds its source, so that a test can tell whether it is up to date.

    python docs/draw_menu_states.py
"""

from __future__ import annotations

import subprocess
from pathlib import Path

from camctl.menu.model import Action, Model, State
from camctl.menu.ports import Key
from camctl.menu.tables import KEYS, STATES, TRANSITIONS, Symbol

DOCS = Path(__file__).parent

#: The screen saver can follow most screens, and its arrows would hide the others.
_HIDDEN = {State.SAVER}


def diagram() -> str:
    """Return the tables as a state diagram in the language of graphviz."""
    lines = ["digraph menu {", "    node [shape=box, style=rounded, fontname=sans, fontsize=12]"]
    lines.append("    edge [fontname=sans, fontsize=10]")
    lines.append("    start [shape=point, width=0.15]")
    lines += [
        f'    {state} [label="{STATES[state].title[0]}"]' for state in State if state not in _HIDDEN
    ]
    lines.append(f"    start -> {Model().state}")
    for state, row in TRANSITIONS.items():
        labels: dict[State, list[str]] = {}
        for symbol, target in row.items():
            if target is not state and not {state, target} & _HIDDEN:
                labels.setdefault(target, []).append(_label(symbol))
        lines += [
            f'    {state} -> {target} [label="{", ".join(ls)}"]' for target, ls in labels.items()
        ]
    return "\n".join([*lines, "}", ""])


def _label(symbol: Symbol) -> str:
    """Return a key in capitals, a button in brackets, or an event in small letters."""
    if isinstance(symbol, Key):
        return symbol.name
    return f"[{symbol.value}]" if isinstance(symbol, Action) else symbol.value


def states_page() -> str:
    """Return the Markdown page with the diagram and the table of states."""
    rows = [
        f"| {spec.title[0]} | {spec.kind.value} | {', '.join(KEYS[spec.kind])} "
        f"| {', '.join(action.value for action in spec.actions)} |"
        for spec in STATES.values()
    ]
    return "\n".join(
        [
            "# States of the menu",
            "",
            "This page and its diagram are generated from the tables of the menu:",
            "`python docs/draw_menu_states.py`.",
            "",
            "An arrow names what causes the transition: a key in capitals, a button or the entry "
            "of a",
            "list in brackets, or an event in small letters. A key that is not shown selects or "
            "scrolls.",
            "The screen saver comes from every list and page that is not used for a while, and "
            "any key",
            "leads from it to the screen *Ready*; its arrows are left out.",
            "",
            "![state diagram of the menu](../pictures/menu-states.svg)",
            "",
            "| screen | kind | keys | buttons |",
            "|---|---|---|---|",
            *rows,
            "",
        ]
    )


def main() -> None:
    """Write the page, then the drawing."""
    (DOCS / "reference" / "menu-states.md").write_text(states_page(), encoding="utf-8")
    source = diagram()
    done = subprocess.run(
        ["dot", "-Tsvg"], input=source, capture_output=True, text=True, check=True
    )
    svg = done.stdout[done.stdout.index("<svg") :]
    picture = DOCS / "pictures" / "menu-states.svg"
    picture.write_text(f"<!--\n{source}-->\n{svg}", encoding="utf-8")


if __name__ == "__main__":
    main()
