"""Draw docs/pictures/menu-states.svg from the tables of the menu; needs graphviz (the program dot).

The file holds the source of the drawing, so that a test can tell whether it is up to date.

    python docs/draw_menu_states.py
"""

import subprocess
from pathlib import Path

from camctl.menu.diagram import diagram

PICTURE = Path(__file__).parent / "pictures" / "menu-states.svg"


def main() -> None:
    """Draw the diagram."""
    source = diagram()
    done = subprocess.run(
        ["dot", "-Tsvg"], input=source, capture_output=True, text=True, check=True
    )
    svg = done.stdout[done.stdout.index("<svg") :]
    PICTURE.write_text(f"<!--\n{source}-->\n{svg}", encoding="utf-8")


if __name__ == "__main__":
    main()
