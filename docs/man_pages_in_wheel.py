"""Puts the man pages, which are made from the help texts, into the wheel."""

from __future__ import annotations

import runpy
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class ManPages(BuildHookInterface[Any]):
    """Installs share/man/man1/camctl*.1, also with an editable installation."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the pages of the source tree, and name them as data of the wheel."""
        sys.path.insert(0, self.root)
        sys.dont_write_bytecode = True
        self._folder = tempfile.TemporaryDirectory(prefix="camctl-man-")
        pages = Path(self._folder.name)
        runpy.run_path(str(Path(self.root, "docs", "write_man_pages.py")))["main"](pages)
        for page in sorted(pages.iterdir()):
            build_data["shared_data"][str(page)] = f"share/man/man1/{page.name}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was written."""
        self._folder.cleanup()
