"""Run the notebooks of docs/tutorials/notebooks, and write them with what they show.

    pip install -e '.[docs,plots]' && python docs/run_notebooks.py [NAME...]

The tests run their code, too (tests/test_notebooks.py), without writing it.
"""

from __future__ import annotations

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

FOLDER = Path(__file__).parent / "tutorials" / "notebooks"


def main(names: list[str]) -> None:
    """Run those of these names, or all."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        if names and path.stem not in names:
            continue
        notebook = nbformat.read(path, as_version=4)
        NotebookClient(notebook, timeout=600, startup_timeout=300, record_timing=False).execute()
        notebook.metadata.pop("language_info", None)  # the version of this Python
        nbformat.write(notebook, path)


if __name__ == "__main__":
    main(sys.argv[1:])
