"""Which programs hold a device node, as far as this user may see."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Holder:
    """A process that has a node open."""

    process: int
    program: str

    @property
    def is_us(self) -> bool:
        """True where it is this very process."""
        return self.process == os.getpid()


def holding(node: str) -> Iterator[Holder]:
    """Yield each process that has `node`, a path without links, open.

    Our own counts where it has it open twice: once is the caller's doing.  Processes of other
    users are not seen without the rights of root.
    """
    for process in Path("/proc").glob("[0-9]*"):
        allowed = 1 if process.name == str(os.getpid()) else 0
        try:
            if _count(node, process / "fd") > allowed:
                yield Holder(int(process.name), (process / "comm").read_text().strip())
        except OSError:  # it has ended meanwhile, or belongs to somebody else
            continue


def _count(node: str, descriptors: Path) -> int:
    """Return how many of a process's descriptors are of `node`."""
    count = 0
    for link in descriptors.iterdir():
        with suppress(FileNotFoundError):  # closed meanwhile
            count += str(link.readlink()) == node
    return count
