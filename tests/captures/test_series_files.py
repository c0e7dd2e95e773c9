"""What a series keeps: its folder, the names of its sets, its journal, and its gallery."""

from __future__ import annotations

import json
import os
from datetime import datetime
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from series_bench import Bench, FakeSets, journal, report

from camctl.captures.gallery import write_gallery
from camctl.errors import (
    DataError,
    InterruptedCaptureError,
    StorageError,
    UsageError,
)
from camctl.records.journal import (
    SetRecord,
    check_pattern,
    check_series_folder,
    read_series,
    set_name,
)
from camctl.records.report import CaptureReport


def test_two_processes_cannot_write_one_series(bench: Bench) -> None:
    class Nested(FakeSets):
        def take(self, directory: Path) -> CaptureReport:
            with pytest.raises(StorageError, match="another process is writing"):
                bench.run(FakeSets(bench.clock), journal(repeat=1))
            return super().take(directory)

    assert bench.run(Nested(bench.clock), journal(repeat=1)).completed == 1


def test_a_new_series_needs_an_empty_folder(tmp_path: Path) -> None:
    check_series_folder(tmp_path / "new")
    check_series_folder(tmp_path)
    (tmp_path / "photo.jpg").touch()
    with pytest.raises(StorageError, match="is not empty"):
        check_series_folder(tmp_path)


@given(pattern=st.text(st.characters() | st.sampled_from("{}/\\.:"), max_size=40))
def test_a_pattern_is_refused_or_names_a_folder_in_the_series(pattern: str) -> None:
    series = Path("/series")
    try:
        check_pattern(pattern)
    except UsageError:
        return
    name = set_name(pattern, 12, datetime(2026, 5, 4, 3, 2, 1))
    assert Path(os.path.normpath(series / name)).parent == series
    assert name == Path(name).name


@pytest.mark.parametrize(
    ("pattern", "problem"),
    [
        ("../{number}", "invalid folder name"),
        ("/tmp/{number}", "invalid folder name"),
        ("a\\b", "invalid folder name"),
        ("..", "invalid folder name"),
        ("", "invalid folder name"),
        (".hidden-{number}", "invalid folder name"),
        ("C:{number}", "invalid folder name"),
        ("index.html", "name of a file of the series"),
        ("Series.JSON", "name of a file of the series"),
        ("-rf", "begins with -"),
        ("a\nb", "invisible"),
        ("x" * 300, "longer than 200 bytes"),
        ("{number", "has no partner"),
        ("{numbr}", "did you mean {number}?"),
        ("{number.__class__}", "unknown field"),
        ("{0}", "unknown field"),
    ],
)
def test_hostile_name_patterns_are_refused(pattern: str, problem: str) -> None:
    with pytest.raises(UsageError) as caught:
        check_pattern(pattern)
    assert problem in str(caught.value)


def test_names_that_repeat_get_the_number_of_the_set(bench: Bench) -> None:
    sets = FakeSets(bench.clock)
    bench.run(sets, journal(repeat=3, name="hall"))
    assert sets.folders == ["hall", "hall-2", "hall-3"]


@pytest.mark.parametrize(
    "change",
    [
        {"sets": [{"number": 1, "folder": "../outside", "started_at": ""}]},
        {"sets": [{"number": 2, "folder": "a", "started_at": ""}]},
        {"options": {"repeat": 3, "name": "../{number}"}},
        {"options": {"repeat": None}},
        {"options": {"repeat": 3, "interval_s": 1e999}},
        {"request": {"dynamic_range": -1}},
        {"more": 1},
    ],
)
def test_a_damaged_journal_is_refused_in_one_line(bench: Bench, change: dict[str, Any]) -> None:
    bench.run(FakeSets(bench.clock), journal(repeat=1))
    content = json.loads((bench.folder / "series.json").read_text())
    (bench.folder / "series.json").write_text(json.dumps(content | change))
    with pytest.raises(DataError, match="is damaged") as caught:
        read_series(bench.folder)
    assert "\n" not in str(caught.value)


def test_a_set_is_not_resumed_through_a_link(bench: Bench, tmp_path: Path) -> None:
    stop = InterruptedCaptureError("interrupted")
    with pytest.raises(InterruptedCaptureError):
        bench.run(FakeSets(bench.clock, errors=[stop]), journal(repeat=1))
    (bench.folder / "set-0001").symlink_to(tmp_path)
    with pytest.raises(StorageError, match="is a link"):
        bench.run(FakeSets(bench.clock), read_series(bench.folder))


class _Page(HTMLParser):
    """The tags, the links and the text of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.links: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name in ("href", "src")]

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_gallery_escapes_names_and_messages(tmp_path: Path) -> None:
    found = journal(repeat=2, name="a & b's #1")
    found.sets = [
        SetRecord(
            number=1,
            folder="a & b's #1",
            started_at="2026-05-04T03:02:01",
            state="failed",
            error='<script>alert("x")</script>\u202e \x1b[31m',
        ),
        SetRecord(number=2, folder="é 'x' &lt;", started_at="", has_thumbnail=True),
    ]
    found.sets[1].complete(report(123.0))
    write_gallery(tmp_path, found)
    page = _Page()
    page.feed((tmp_path / "index.html").read_text())
    assert "script" not in page.tags
    assert '<script>alert("x")</script>\N{REPLACEMENT CHARACTER}' in page.text
    assert "\x1b" not in page.text
    assert "./a%20%26%20b%27s%20%231/" in page.links
    assert "thumbnails/0002.jpg" in page.links
    for text in ("é 'x' &lt;", "123 effective levels", "1:1,000", "log, 3 exposures", "3.00%"):
        assert text in page.text
    assert not [link for link in page.links if ":" in link]
