"""Series: when sets begin, and what happens when they fail."""

from __future__ import annotations

import gc
import json
import threading
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from series_bench import Bench, FakeSets, ScriptedKeys, journal
from small_cameras import gradient, small_camera

from camctl.captures.series import Series
from camctl.captures.series_sets import CameraSets, SeriesProgress, SeriesTools
from camctl.errors import (
    CameraDisconnectedError,
    CameraError,
    CaptureError,
    InterruptedCaptureError,
    StorageError,
    UsageError,
)
from camctl.exposure.goal import CaptureRequest
from camctl.records.journal import (
    SeriesJournal,
    SetRecord,
    read_series,
)
from camctl.sim.camera import Faults
from camctl.system.picture_operations import opencv


@settings(max_examples=12)  # each writes a journal a dozen times
@given(seconds=st.lists(st.floats(0, 9.99), min_size=12, max_size=12))
def test_set_k_begins_k_intervals_after_the_first(
    tmp_path_factory: pytest.TempPathFactory, seconds: list[float]
) -> None:
    bench = Bench(tmp_path_factory.mktemp("series") / "series")
    sets = FakeSets(bench.clock, seconds)
    found = bench.run(sets, journal(repeat=12, interval_s=10.0))
    first = sets.starts[0]
    assert sets.starts == [first + k * 10.0 for k in range(12)]
    assert [each.slot for each in found.sets] == list(range(12))
    assert (found.skipped, bench.warnings) == (0, [])


@settings(max_examples=12)  # each writes a journal a dozen times
@given(seconds=st.lists(st.floats(0, 50), min_size=8, max_size=8))
def test_starts_that_have_passed_are_left_out_and_the_number_of_sets_stays(
    tmp_path_factory: pytest.TempPathFactory, seconds: list[float]
) -> None:
    bench = Bench(tmp_path_factory.mktemp("series") / "series")
    sets = FakeSets(bench.clock, seconds)
    found = bench.run(sets, journal(repeat=8, interval_s=10.0))
    assert found.completed == 8
    late = [
        start - sets.starts[0] - each.slot * 10
        for start, each in zip(sets.starts, found.sets, strict=True)
    ]
    assert all(-1e-9 <= each <= 1 + 1e-9 for each in late)  # a tenth of the interval
    assert found.skipped == found.sets[-1].slot - 7
    assert bool(bench.warnings) == bool(found.skipped)


def test_a_slightly_late_set_begins_at_once_and_does_not_move_the_next(bench: Bench) -> None:
    sets = FakeSets(bench.clock, [10.5, 1])
    found = bench.run(sets, journal(repeat=3, interval_s=10.0))
    assert [start - sets.starts[0] for start in sets.starts] == pytest.approx([0, 10.5, 20])
    assert found.skipped == 0


def test_sets_planned_longer_than_the_interval_are_said_once_before_the_first(
    bench: Bench,
) -> None:
    sets = FakeSets(bench.clock, [12.5] * 9, planned_s=12.0)
    found = bench.run(sets, journal(repeat=9, interval_s=10.0))
    assert found.skipped == 8
    assert bench.warnings == [
        "a set takes 12 s by its plan, longer than the interval of 10 s: sets begin every 20 s at "
        "best, and the starts between are left out"
    ]


def test_sets_that_are_late_against_their_plan_are_said_once(bench: Bench) -> None:
    sets = FakeSets(bench.clock, [12.5] * 9, planned_s=10.5)
    found = bench.run(sets, journal(repeat=9, interval_s=10.0))
    assert found.skipped == 8
    assert len(bench.warnings) == 1
    assert "a set took longer than the interval of 10 s: 1 start is left out" in bench.warnings[0]


def test_without_an_interval_one_set_follows_another(bench: Bench) -> None:
    sets = FakeSets(bench.clock, [3, 4, 5])
    bench.run(sets, journal(repeat=3))
    assert [start - sets.starts[0] for start in sets.starts] == pytest.approx([0, 3, 7])


def test_a_set_that_fails_once_is_tried_again(bench: Bench) -> None:
    sets = FakeSets(bench.clock, errors=[None, CameraDisconnectedError("the cable is out"), None])
    found = bench.run(sets, journal(repeat=3, interval_s=10.0))
    assert [each.state for each in found.sets] == ["complete"] * 3
    assert [each.attempts for each in found.sets] == [1, 2, 1]
    assert sets.reconnected == 1
    assert sets.folders == ["set-0001", "set-0002", "set-0002", "set-0003"]
    assert bench.warnings == ["set-0002 is tried again: the cable is out"]


def test_a_set_that_fails_twice_does_not_end_the_series(bench: Bench) -> None:
    wrong = [CaptureError("too dark")] * 2
    sets = FakeSets(bench.clock, errors=[None, *wrong, None])
    found = bench.run(sets, journal(repeat=3, interval_s=10.0))
    assert [each.state for each in found.sets] == ["complete", "failed", "complete"]
    assert found.failed[0].error == "too dark"
    assert sets.reconnected == 0
    assert "set-0002 failed twice" in bench.warnings[1]
    assert "too dark" in (bench.folder / "index.html").read_text()
    assert read_series(bench.folder) == found


def test_an_invalid_request_ends_the_series(bench: Bench) -> None:
    sets = FakeSets(bench.clock, errors=[UsageError("no preview")])
    with pytest.raises(UsageError, match="no preview"):
        bench.run(sets, journal(repeat=3))
    assert len(sets.starts) == 1


def test_a_series_that_cannot_be_metered_leaves_no_folder(bench: Bench) -> None:
    class Unmetered(FakeSets):
        def prepare(self, journal: SeriesJournal) -> None:
            raise CaptureError("the picture is black")

    with pytest.raises(CaptureError, match="black"):
        bench.run(Unmetered(bench.clock), journal(repeat=3))
    assert not bench.folder.exists()
    assert bench.warnings == ["the metering is tried again: the picture is black"]


def test_only_an_interval_gives_failing_sets_more_than_three_chances(tmp_path: Path) -> None:
    for interval_s, ends in ((None, True), (10.0, False)):
        bench = Bench(tmp_path / str(interval_s))
        sets = FakeSets(bench.clock, errors=[CameraError("no power")] * 40)
        found = journal(repeat=20, interval_s=interval_s)
        if ends:
            with pytest.raises(CameraError, match="3 sets in a row have failed: no power; 0 of 20"):
                bench.run(sets, found)
        else:
            bench.run(sets, found)
        assert len(found.sets) == (3 if ends else 20)


def test_the_disk_must_have_room_for_the_next_set(bench: Bench) -> None:
    sets = FakeSets(bench.clock, bytes=8_000_000)
    with pytest.raises(StorageError) as caught:
        bench.run(sets, journal(repeat=3), free=9_900_000)
    assert caught.value.what == (
        "the disk has 10 MB free and the next set needs about 10 MB; 1 of 3 sets are complete"
    )
    assert caught.value.remedies == {"resume": bench.folder}
    assert bench.run(sets, read_series(bench.folder), free=10_000_001).completed == 3


def test_the_disk_must_have_room_for_the_first_set(bench: Bench) -> None:
    sets = FakeSets(bench.clock, least=8_000_000)
    with pytest.raises(StorageError) as caught:
        bench.run(sets, journal(repeat=3), free=9_900_000)
    assert caught.value.what == (
        "the disk has 10 MB free and the next set needs about 10 MB; 0 of 3 sets are complete"
    )
    assert sets.starts == []


def test_keys_pause_and_end_a_series(bench: Bench) -> None:
    # No key before the second set; then p, which lasts for 300 looks, p, and no more until q.
    pause = ["p", *[None] * 300, "p"]
    keys = ScriptedKeys(bench.clock, None, *[None] * 50, *pause)
    sets = FakeSets(bench.clock)
    found = bench.run(sets, journal(repeat=6, interval_s=10.0), keys)
    assert found.completed == 6
    assert found.skipped == 0  # a pause is no delay
    gaps = {each.slot - before.slot for before, each in pairwise(found.sets)}
    assert gaps == {1, 4}
    assert [(start - sets.starts[0]) % 10 for start in sets.starts] == pytest.approx([0] * 6)
    assert "paused" in [each.state for each in bench.shown]
    more = Bench(bench.folder.with_name("more"))
    ended = more.run(
        FakeSets(more.clock), journal(repeat=6, interval_s=10.0), ScriptedKeys(more.clock, "q")
    )
    assert (ended.completed, ended.is_done()) == (1, False)


def test_a_pause_can_be_ended_with_the_series(bench: Bench) -> None:
    keys = ScriptedKeys(bench.clock, "p", None, "q")
    assert bench.run(FakeSets(bench.clock), journal(repeat=9), keys).completed == 1


def test_each_key_takes_a_set(bench: Bench) -> None:
    keys = ScriptedKeys(bench.clock, None, " ", "x", "\n", "p", None, "\r", "q")
    sets = FakeSets(bench.clock)
    found = bench.run(sets, journal(on_key=True), keys)
    assert found.completed == 3
    limited = Bench(bench.folder.with_name("limited"))
    keys = ScriptedKeys(limited.clock, " ", " ", " ")
    assert limited.run(FakeSets(limited.clock), journal(on_key=True, repeat=2), keys).is_done()


def test_progress_says_when_the_series_will_end(bench: Bench) -> None:
    bench.run(FakeSets(bench.clock, [2] * 5), journal(repeat=5, interval_s=10.0))
    ends = [each.ends_in_s for each in bench.shown if each.state == "waiting"]
    # Right after the first set: 38 s until the start of the last one, and 2 s for it.
    assert ends == pytest.approx([40, 30, 20, 10])
    bench.shown.clear()
    other = Bench(bench.folder.with_name("other"))
    other.run(FakeSets(other.clock, [2] * 5), journal(repeat=5))
    ends = [each.ends_in_s for each in other.shown if each.state == "waiting"]
    assert ends == pytest.approx([8, 6, 4, 2])


@pytest.mark.parametrize(
    ("error", "is_kept"), [(KeyboardInterrupt(), True), (CaptureError("no light"), False)]
)
def test_a_series_that_ends_before_its_first_set_is_continued_or_was_none(
    bench: Bench, error: BaseException, is_kept: bool
) -> None:
    sets, found = FakeSets(bench.clock), journal(repeat=2)

    def fail(_: SeriesJournal) -> float:
        raise error

    with patch.object(sets, "prepare", fail), pytest.raises(CaptureError):
        bench.run(sets, found)
    assert bench.folder.exists() == is_kept
    if is_kept:
        again = bench.run(FakeSets(bench.clock), read_series(bench.folder))
        assert again.completed == 2


def test_an_interrupted_series_goes_on_with_the_set_that_was_begun(bench: Bench) -> None:
    stop = InterruptedCaptureError("interrupted; 1 of 3 frames are kept")
    sets = FakeSets(bench.clock, errors=[None, stop])
    with pytest.raises(InterruptedCaptureError) as caught:
        bench.run(sets, journal(repeat=4, interval_s=10.0))
    assert str(caught.value) == (
        "interrupted; 1 of 3 frames are kept; 1 of 4 sets are complete; continue the series"
    )
    assert caught.value.remedies == {"resume": bench.folder}
    kept = read_series(bench.folder)
    assert [each.state for each in kept.sets] == ["complete", "begun"]
    again = FakeSets(bench.clock)
    found = bench.run(again, kept)
    assert again.folders == ["set-0002", "set-0003", "set-0004"]
    assert [each.run for each in found.sets] == [1, 2, 2, 2]
    assert [start - again.starts[0] for start in again.starts] == pytest.approx([0, 10, 20])
    assert found.is_done()


def test_control_c_in_a_wait_keeps_the_series(bench: Bench) -> None:
    class Interrupted(ScriptedKeys):
        def read(self, timeout_s: float) -> str | None:
            raise KeyboardInterrupt

    with pytest.raises(InterruptedCaptureError, match="interrupted; 1 of 5 sets are complete"):
        bench.run(FakeSets(bench.clock), journal(repeat=5), Interrupted(bench.clock))
    assert read_series(bench.folder).completed == 1


def test_a_hook_runs_after_each_complete_set_and_its_failure_is_counted(bench: Bench) -> None:
    called = []

    def hook(folder: Path, record: SetRecord) -> None:
        called.append((folder.name, record.number))
        if record.number == 2:
            raise CaptureError("the hook failed")

    sets = FakeSets(bench.clock, errors=[None, None, CaptureError("dark"), CaptureError("dark")])
    found = bench.run(sets, journal(repeat=4, interval_s=10.0), hook=hook)
    assert called == [("set-0001", 1), ("set-0002", 2), ("set-0004", 4)]
    assert [each.hook for each in found.sets] == ["done", "failed", None, "done"]
    assert "set-0002: the hook failed" in bench.warnings


@pytest.fixture
def camera_sets(tmp_path: Path) -> Callable[..., Any]:
    """Return a function that runs a series of tiny frames of the simulated camera."""

    def run(count: int, faults: Faults | None = None, **options: Any) -> Any:
        with small_camera("ideal-6", gradient(12, 16), faults) as camera:
            request = CaptureRequest(ratios=(1.0, 8.0))
            found = journal(camera.info, request, repeat=count, **options)
            tools = SeriesTools(camera.clock)
            Series(tmp_path / "series", found, CameraSets(camera, found), tools).run()
        return found

    return run


def test_exposures_are_metered_once_or_for_each_set(
    camera_sets: Callable[..., Any], tmp_path: Path
) -> None:
    found = camera_sets(3, meter="once")
    assert found.plan is not None
    reports = [
        json.loads((tmp_path / "series" / each.folder / "report.json").read_text())
        for each in found.sets
    ]
    assert len({json.dumps(each["plan"]) for each in reports}) == 1
    # Its small pictures need OpenCV.
    has_picture = (tmp_path / "series" / "thumbnails" / "0003.jpg").exists()
    assert has_picture == (opencv() is not None)
    (tmp_path / "series").rename(tmp_path / "once")
    found = camera_sets(3, meter="each")
    assert found.plan is None
    assert found.completed == 3


def test_a_camera_that_is_unplugged_in_a_set_completes_it(camera_sets: Callable[..., Any]) -> None:
    found = camera_sets(3, Faults(unplug_after=3), interval_s=60.0)
    assert [each.state for each in found.sets] == ["complete"] * 3
    assert [each.attempts for each in found.sets] == [1, 2, 1]


@pytest.mark.slow
@pytest.mark.no_cover  # the tracing of coverage keeps something of each thread
def test_many_sets_neither_drift_nor_grow(tmp_path: Path) -> None:
    interval_s = 30.0
    objects: list[int] = []
    open_files: list[int] = []
    threads: list[int] = []

    def count(progress: SeriesProgress) -> None:
        if progress.state == "waiting" and progress.done in (60, 160):
            gc.collect()
            objects.append(len(gc.get_objects()))
            open_files.append(len(list(Path("/proc/self/fd").iterdir())))
            threads.append(threading.active_count())

    with small_camera("ideal-6", gradient(12, 16)) as camera:
        request = CaptureRequest(ratios=(1.0, 8.0))
        found = journal(camera.info, request, repeat=170, interval_s=interval_s)
        tools = SeriesTools(camera.clock, progress=count)
        Series(tmp_path / "series", found, CameraSets(camera, found), tools).run()
    assert found.completed == 170
    assert (
        max(abs(each.started_s - each.number * interval_s + interval_s) for each in found.sets)
        < 1e-6
    )
    # What is kept of a set: its record, which is six objects, and nothing else.
    assert objects[1] - objects[0] < 100 * 7
    assert open_files[0] == open_files[1]
    assert threads[0] == threads[1]
    assert len(list((tmp_path / "series" / "thumbnails").iterdir())) == 170
