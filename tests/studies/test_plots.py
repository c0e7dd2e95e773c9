"""Plot files: their formats, what is checked before, and the message without matplotlib."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from camctl.errors import StorageError, UsageError
from camctl.system import plots

pytestmark = pytest.mark.skipif(
    find_spec("matplotlib") is None, reason="matplotlib is not installed"
)


def test_a_plot_is_written_in_both_formats_and_is_the_same_again(tmp_path: Path) -> None:
    paths = (tmp_path / "plot.svg", tmp_path / "plot.png")
    contents = []
    for _ in range(2):
        with plots.plot(paths, (4, 3), "What to see.") as figure:
            figure.subplots().plot([1, 2], [3, 4])
        contents.append([path.read_bytes() for path in paths])
    assert contents[0] == contents[1]
    assert b"What to see." in contents[0][0]
    assert contents[0][1].startswith(b"\x89PNG")


def test_nothing_is_written_where_drawing_fails(tmp_path: Path) -> None:
    path = tmp_path / "plot.svg"
    with pytest.raises(ZeroDivisionError), plots.plot((path,), (4, 3)):
        raise ZeroDivisionError
    assert not path.exists()


def test_unusable_paths_are_refused_before_the_work(tmp_path: Path) -> None:
    existing = tmp_path / "there.svg"
    existing.touch()
    with pytest.raises(UsageError, match=r"unknown format of the plot .*; end its name in \.svg"):
        plots.check_plots((tmp_path / "plot.gif",), overwrite=False)
    with pytest.raises(StorageError, match="exists; choose another file") as caught:
        plots.check_plots((existing,), overwrite=False)
    assert "overwrite" in caught.value.remedies
    with pytest.raises(StorageError, match="there is no folder"):
        plots.check_plots((tmp_path / "none" / "plot.svg",), overwrite=False)
    plots.check_plots((existing,), overwrite=True)


def test_without_matplotlib_the_error_states_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    with pytest.raises(plots.MissingPlotLibraryError, match=r"pip install 'camctl\[plots\]'"):
        plots.check_plots((tmp_path / "plot.svg",), overwrite=False)
    plots.check_plots((), overwrite=False)
