"""Plots as SVG or PNG files: the one place that imports matplotlib, and the style of all plots."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.errors import CamctlError, StorageError, UsageError
from camctl.system.files import check_new

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

SUFFIXES = (".svg", ".png")
"""File formats of a plot."""

COLOURS = ("#0b6aa2", "#c8501e", "#3c7d2f", "#7b4ba0", "#8a6d1c", "#555555", "#b3246b")
"""Colours of lines, in the order of use; dark enough for text on white, different in lightness."""

CAPTION_WIDTH = 110
"""Characters in a line of a caption."""

_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.5,
    "lines.markersize": 5.0,
    "svg.fonttype": "none",  # text stays text: it can be searched, and needs no outlines
    "svg.hashsalt": "camctl",  # the same plot is the same file
}


class MissingPlotLibraryError(CamctlError):
    """Plots need matplotlib, which is not installed."""


def check_plots(paths: tuple[Path, ...], *, overwrite: bool) -> None:
    """Check, before long work, that the plots can be written to `paths`.

    Raises:
        UsageError: a suffix is not in `SUFFIXES`
        StorageError: a file exists and is not to be replaced, or its folder does not exist
        MissingPlotLibraryError: matplotlib is not installed
    """
    for path in paths:
        if path.suffix.lower() not in SUFFIXES:
            raise UsageError(
                f"unknown format of the plot {path}", hint=f"end its name in {', '.join(SUFFIXES)}"
            )
        check_new(path, overwrite=overwrite)
        if not path.parent.is_dir():
            raise StorageError(f"there is no folder {path.parent}", hint="make it first")
    if paths:
        require_matplotlib()


def plain_ticks(axis: Axis) -> None:
    """Write the numbers of a logarithmic axis in full, as 0.2, 1, 20, for what it shows now."""
    from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, NullLocator

    least, most = axis.get_view_interval()
    # The numbers of more than three decades have no space for 2 and 5.
    subs = (1.0, 2.0, 5.0) if most < 1000 * least else (1.0,)
    ticks = LogLocator(subs=subs).tick_values(least, most)
    axis.set_major_locator(FixedLocator([tick for tick in ticks if least <= tick <= most]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


def require_matplotlib() -> None:
    """Raise `MissingPlotLibraryError`, which states the command, where matplotlib is missing."""
    try:
        import matplotlib.figure  # noqa: F401 - imported to find out whether it can be
    except ImportError as error:
        raise MissingPlotLibraryError(
            "plots need matplotlib, which is not installed",
            hint="install it with: pip install 'camctl[plots]'",
        ) from error


@contextmanager
def plot(
    paths: tuple[Path, ...], size: tuple[float, float], caption: str = "", *, dpi: int = 150
) -> Iterator[Figure]:
    """Yield an empty figure of `size` inches in the common style; then write it to `paths`.

    The caption, what to see in the plot, stands below it.  Nothing is written where the block
    fails.  Raises `MissingPlotLibraryError`; `StorageError` where a file cannot be written.
    """
    require_matplotlib()
    import textwrap

    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(_STYLE):
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        if caption:
            lines = textwrap.fill(" ".join(caption.split()), CAPTION_WIDTH)
            figure.supxlabel(lines, x=0.01, ha="left", fontsize=9, color="#333333")
        for path in paths:
            metadata = {"Date": None} if path.suffix.lower() == ".svg" else {}
            try:
                figure.savefig(path, dpi=dpi, metadata=metadata)
            except OSError as error:
                raise StorageError(f"could not write {path}: {error.strerror}") from error
