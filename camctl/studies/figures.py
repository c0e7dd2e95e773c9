"""The figures of the paper by Grossberg and Nayar, recomputed, as files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from camctl.profiles.response import ResponseRecord
from camctl.studies import figure_pictures, figure_responses
from camctl.studies.figure_parts import PaperFigure
from camctl.system.plots import plot

FIGURES: dict[str, PaperFigure] = {
    figure.number: figure
    for figure in sorted(
        (*figure_responses.FIGURES, *figure_pictures.FIGURES), key=lambda each: int(each.number)
    )
}
"""The figures by number."""


@dataclass(frozen=True)
class FigureFiles:
    """One figure and the files to draw it to; can be sent to another process.

    Attributes:
        number: a key of `FIGURES`
        paths: files, .png or .svg
        dpi: resolution of a PNG, dots per inch
        measured: the response with which the camera of figure 10 is used; None: its true one
    """

    number: str
    paths: tuple[Path, ...]
    dpi: int = 150
    measured: ResponseRecord | None = None

    @property
    def caption(self) -> str:
        """What to see in the figure, as one line."""
        caption = " ".join(FIGURES[self.number].caption.split())
        if self.measured is None:
            return caption
        return (
            f"{caption} Exposures and pictures come from a response that was measured on "
            f"{self.measured.measured_at[:10]}, and not from the true one."
        )

    @property
    def title(self) -> str:
        """What the figure shows."""
        return FIGURES[self.number].title


def figure_files(
    numbers: tuple[str, ...],
    folder: Path,
    *,
    svg: bool = False,
    dpi: int = 150,
    measured: ResponseRecord | None = None,
) -> tuple[FigureFiles, ...]:
    """Return the files of some figures: PNG, and SVG where it is requested."""
    suffixes = (".png", ".svg") if svg else (".png",)
    return tuple(
        FigureFiles(
            number,
            tuple(folder / f"figure-{number}{suffix}" for suffix in suffixes),
            dpi,
            measured if number == "10" else None,
        )
        for number in numbers
    )


def draw(files: FigureFiles) -> None:
    """Draw a figure; raises what `plots.plot` raises."""
    figure = FIGURES[files.number]
    caption = f"Figure {figure.number}: {figure.title}. {files.caption}"
    with plot(files.paths, figure.size, caption, dpi=files.dpi) as empty:
        if files.measured is None:
            figure.draw(empty)
        else:
            figure_pictures.draw_figure_10(empty, files.measured)
