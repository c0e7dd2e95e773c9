"""`camctl figures`, through the command line, and what the figures claim."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from command_line import Run

pytestmark = pytest.mark.skipif(
    find_spec("matplotlib") is None, reason="matplotlib is not installed"
)

QUICK = ("figures", "--workers", "1", "--dpi", "40")


@pytest.mark.slow
def test_figures_are_written_with_captions(run: Run) -> None:
    found = run(*QUICK, "--only", "3,6", "-o", "drawn/here", "--svg", "--json").json["figures"]
    assert [row["figure"] for row in found] == ["3", "6"]
    for row in found:
        png, svg = (Path(name) for name in row["files"])
        assert png.read_bytes().startswith(b"\x89PNG")
        assert "font" in svg.read_text("utf-8")
        assert row["title"]
        assert len(row["caption"]) > 100
        assert row["caption"].split()[0] in svg.read_text("utf-8")
    assert {path.name for path in Path("drawn/here").iterdir()} == {
        "figure-3.png",
        "figure-3.svg",
        "figure-6.png",
        "figure-6.svg",
    }


@pytest.mark.slow
def test_all_figures_are_drawn_and_none_is_flat(run: Run) -> None:
    import cv2

    from camctl.cli.figures import NUMBERS
    from camctl.studies.figures import FIGURES

    assert tuple(FIGURES) == NUMBERS
    numbers = [number for number in NUMBERS if number != "4"]  # it takes half a minute
    found = run(*QUICK, "--only", ",".join(numbers), "--json").json["figures"]
    for row in found:
        picture = cv2.imread(row["files"][0], cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        assert np.std(picture) > 20, row["figure"]


@pytest.mark.slow
def test_existing_files_are_kept(run: Run) -> None:
    line = (*QUICK, "--only", "3")
    first = run(*line)
    assert first.status == 0
    assert "figures/figure-3.png" in first.out
    message = "figures/figure-3.png exists; choose another file, or have it replaced (--force)"
    assert run(*line).error == message
    assert run(*line, "--force").status == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--only", "12"), "unknown figure '12'"),
        (("--only", "5"), "without matplotlib"),
        (("--dpi", "5"), "expected a whole number from 30 to 600"),
        (("-o", "a-file/below"), "could not make the folder a-file/below: Not a directory"),
    ],
)
def test_bad_input(
    arguments: tuple[str, ...], message: str, run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("a-file").touch()
    if message == "without matplotlib":
        monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
        message = "plots need matplotlib, which is not installed"
    assert message in run("figures", *arguments).error


def test_pictures_show_what_their_captions_claim() -> None:
    """The computed exposures have narrower bands in the light (figures 6, 7), more values (9)."""
    from camctl.studies.figure_parts import BASELINE, computed, shoot
    from camctl.studies.figure_pictures import LINEAR_4_BIT, LOG_6_BIT

    found = computed(4, "linear", 64.0, 3).exposures
    values = [
        np.unique(shoot("ramp", "ideal-4", ratios, LINEAR_4_BIT, "600x4").sum()[:, 300:]).size
        for ratios in (BASELINE, found)
    ]
    assert values[1] >= 1.8 * values[0]
    found = computed(6, "log", 1000.0, 3).exposures
    dark = (slice(None), slice(100, 160))
    values = [
        np.unique(shoot("tile-floor", "ideal-6", ratios, LOG_6_BIT, "160x100").sum()[dark]).size
        for ratios in (BASELINE, found)
    ]
    assert values[1] >= 3 * values[0]
