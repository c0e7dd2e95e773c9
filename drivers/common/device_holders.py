"""Which processes have a device node open, as far as this user may see."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePath


@dataclass(frozen=True)
class Holder:
    """A process that has a node open."""

    process: int
    program: str

    @property
    def is_us(self) -> bool:
        return self.process == os.getpid()


def holding(node: str) -> Iterator[Holder]:
    """Yield each process that has `node`, a path without links, open.

    This process is included only if it has the node open twice, since the caller usually has it
    open once.  Processes of other users are visible to root alone.
    """
    for process in Path("/proc").glob("[0-9]*"):
        allowed = 1 if process.name == str(os.getpid()) else 0
        try:
            if _count(node, process / "fd") > allowed:
                yield Holder(int(process.name), _program(process))
        except OSError:  # the process has ended, or belongs to another user
            continue


def _program(process: Path) -> str:
    """Return the name of a process's program, of which the kernel keeps 15 characters."""
    kept = (process / "comm").read_text().strip()
    called = PurePath(os.fsdecode((process / "cmdline").read_bytes().split(b"\0")[0])).name
    return called if called.startswith(kept) else kept


def _count(node: str, descriptors: Path) -> int:
    """Return how many of a process's file descriptors refer to `node`."""
    count = 0
    for link in descriptors.iterdir():
        with suppress(FileNotFoundError):  # closed in the meantime
            count += str(link.readlink()) == node
    return count
