"""Progress of long work on standard error, only where that is a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TypeAlias

if TYPE_CHECKING:
    from camctl.capture import Progress as CaptureProgress

Tick: TypeAlias = Callable[[float, str], None]
"""Takes the share that is done, 0 to 1, and what is being done now."""


@contextmanager
def progress_bar(what: str) -> Iterator[Tick | None]:
    """Show a bar with the time left while the block runs; yield None where nobody looks."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
    from rich.progress import TimeRemainingColumn as TimeLeftColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
    with Progress(
        *columns,
        TimeLeftColumn(elapsed_when_finished=True),
        console=Console(stderr=True),
        transient=True,
    ) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share, now: bar.update(task, completed=share, description=now or what)


def share_only(tick: Tick | None) -> Callable[[float], None] | None:
    """Return `tick` for work that knows only the share that is done."""
    return None if tick is None else lambda share: tick(share, "")


@contextmanager
def capture_progress() -> Iterator[Callable[[CaptureProgress], None] | None]:
    """Show how far a capture is while the block runs; yield None where nobody looks."""
    with progress_bar("opening") as tick:
        if tick is None:
            yield None
            return
        show = tick
        yield lambda now: show(now.share, now.stage)
