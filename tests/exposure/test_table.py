from __future__ import annotations

import errno
import json
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from sampling import some

from camctl.errors import DataError, StorageError, UsageError
from camctl.exposure import build
from camctl.exposure.build import Job, build_table, discard_rows, look_up, table_jobs
from camctl.exposure.cache import cache_folder
from camctl.exposure.objective import xi
from camctl.exposure.solver import Progress
from camctl.exposure.table import ExposureTable, TableEntry, default_table
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.response.camera import CameraResponse, linear_response
from camctl.model.response.desired import desired_response
from camctl.model.response.names import RANGES, RESPONSES
from camctl.model.response.tabulated import tabulated_desired

EIGHT_BIT = linear_response(8)
THREE_BIT = linear_response(3)
LOG = desired_response("log", "medium")


@pytest.fixture(autouse=True)
def _empty_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path / "cache"))


def small_table(*, seed: int = 0, **options: Any) -> ExposureTable:
    jobs = table_jobs(THREE_BIT, ("linear", "log"), (20.0,), (1, 2), seed=seed)
    return build_table(jobs, **options)


def test_default_table_is_complete_and_its_numbers_are_right() -> None:
    assert len(default_table().entries) == 54
    for name in RESPONSES:
        for span in RANGES:
            desired = desired_response(name, span)
            for n in range(1, 7):
                entry = default_table().find(EIGHT_BIT, desired, n)
                assert entry is not None
                camera = EffectiveCamera.of(EIGHT_BIT, entry.exposures)
                assert entry.levels_wanted == n * 255
                assert entry.xi == pytest.approx(xi(camera, desired, n * 255), rel=1e-9)
                assert entry.effective_levels == pytest.approx(
                    effective_levels(camera, desired), rel=1e-9
                )


def test_exposures_of_the_default_table_are_better_than_doubling() -> None:
    for entry in default_table().entries:
        if entry.n == 1:
            continue
        desired = desired_response(entry.response, entry.dynamic_range)
        doubling = EffectiveCamera.of(EIGHT_BIT, [2.0**k for k in range(entry.n)])
        assert entry.xi < xi(doubling, desired, entry.levels_wanted)


@pytest.mark.parametrize(
    "other",
    [
        linear_response(10),
        linear_response(8, phase=0.5),
        linear_response(8, levels=239),
    ],
    ids=lambda camera: camera.name,
)
def test_default_table_has_no_row_for_other_cameras(other: CameraResponse) -> None:
    assert default_table().find(other, LOG, 3) is None


def test_default_table_has_no_row_for_other_desired_responses() -> None:
    assert default_table().find(EIGHT_BIT, desired_response("log", 1001.0), 3) is None
    assert (
        default_table().find(EIGHT_BIT, desired_response("gamma", "medium", gamma=0.45), 3) is None
    )
    assert default_table().find(EIGHT_BIT, LOG, 7) is None
    assert default_table().find(EIGHT_BIT, LOG, 3, levels_wanted=700) is None


def test_look_up_solves_a_row_once_and_caches_it(monkeypatch: pytest.MonkeyPatch) -> None:
    solved: list[Job] = []
    solve_job = build.solve_job

    def counted(job: Job, progress: Progress | None = None) -> TableEntry:
        solved.append(job)
        return solve_job(job, progress)

    monkeypatch.setattr(build, "solve_job", counted)
    desired = desired_response("log", 20.0)
    first = look_up(THREE_BIT, desired, 2)
    assert look_up(THREE_BIT, desired, 2) == first
    assert len(solved) == 1
    look_up(linear_response(3, phase=0.5), desired, 2)
    assert len(solved) == 2
    assert look_up(EIGHT_BIT, LOG, 3) == default_table().find(EIGHT_BIT, LOG, 3)
    assert len(solved) == 2


def test_look_up_distinguishes_tabulated_responses_of_the_same_name() -> None:
    one = tabulated_desired([0.05, 0.3, 1.0], [0, 0.5, 1], name="mine")
    two = tabulated_desired([0.05, 0.3, 1.0], [0, 0.8, 1], name="mine")
    assert look_up(THREE_BIT, one, 2).exposures != look_up(THREE_BIT, two, 2).exposures


@pytest.mark.parametrize(
    ("damage", "reason"),
    some(
        [
            (lambda path, entry: path.write_text(entry.model_dump_json()[:60]), "are damaged: "),
            (lambda path, entry: path.write_bytes(b"\xff\0"), "are damaged: "),
            (
                lambda path, entry: path.write_text(
                    entry.model_copy(update={"camera": "0" * 16}).model_dump_json()
                ),
                "are for another camera or desired response",
            ),
            (lambda path, entry: (path.unlink(), path.mkdir()), "cannot read cached exposures "),
        ],
        every=3,
    ),
)
def test_damaged_cached_row_is_set_aside_and_solved_again(
    caplog: pytest.LogCaptureFixture, damage: Callable[[Path, TableEntry], object], reason: str
) -> None:
    desired = desired_response("log", 20.0)
    entry = look_up(THREE_BIT, desired, 2)
    (path,) = cache_folder().iterdir()
    damage(path, entry)
    assert look_up(THREE_BIT, desired, 2) == entry
    (record,) = caplog.records
    assert reason in record.getMessage()
    assert f"set aside as {path.name}.damaged" in record.getMessage()
    assert {file.name for file in cache_folder().iterdir()} == {path.name, f"{path.name}.damaged"}
    assert look_up(THREE_BIT, desired, 2) == entry
    assert len(caplog.records) == 1


def test_cache_that_cannot_be_read_is_not_needed(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def deny(path: Path) -> bool:
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr(Path, "exists", deny)
    assert look_up(THREE_BIT, desired_response("log", 20.0), 2).n == 2
    assert not caplog.records


def test_look_up_works_without_a_writable_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocker = tmp_path / "file"
    blocker.write_text("not a folder")
    monkeypatch.setenv("CAMCTL_CACHE", str(blocker))
    assert look_up(THREE_BIT, desired_response("log", 20.0), 2).n == 2


def test_saved_table_can_be_loaded(tmp_path: Path) -> None:
    made = small_table()
    made.save(tmp_path / "table.json")
    assert ExposureTable.load(tmp_path / "table.json", THREE_BIT).entries == made.entries
    assert [path.name for path in tmp_path.iterdir()] == ["table.json"]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda text: text[:-40], "damaged"),
        (lambda text: "", "damaged"),
        (lambda text: text.replace('"exposures":[1.0', '"exposures":[-1.0', 1), "damaged"),
        (lambda text: text.replace('"exposures":[1.0', '"exposures":[NaN', 1), "damaged"),
        (lambda text: text.replace('"n":2', '"n":3', 1), "it has 2 exposures, but n is 3"),
        (lambda text: text.replace('"dynamic_range":20.0', '"dynamic_range":1.0', 1), "dynamic"),
        (lambda text: text.replace('"version": 1', '"version": 99'), "version"),
    ],
    ids=[
        "truncated",
        "empty",
        "negative exposure",
        "exposure not a number",
        "wrong number of exposures",
        "dynamic range 1",
        "unknown version",
    ],
)
def test_damaged_table_is_refused_in_one_line(
    tmp_path: Path, change: Callable[[str], str], problem: str
) -> None:
    path = tmp_path / "table.json"
    small_table().save(path)
    path.write_text(change(path.read_text()))
    with pytest.raises(DataError, match=problem) as caught:
        ExposureTable.load(path)
    assert str(path) in str(caught.value)
    assert "build the table again" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_binary_table_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "table.json"
    with pytest.raises(DataError, match=r"cannot read exposure table .*table.json: No such file"):
        ExposureTable.load(path)
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DataError, match=r"table.json: it is not a text file"):
        ExposureTable.load(path)


def test_table_of_another_camera_is_refused(tmp_path: Path) -> None:
    small_table().save(tmp_path / "table.json")
    with pytest.raises(
        DataError, match=r"for another camera \(linear 3 bit\), not for linear 8 bit"
    ):
        ExposureTable.load(tmp_path / "table.json", EIGHT_BIT)


def test_table_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match=r"table\.json: a part of the path is a file"):
        small_table().save(tmp_path / "file" / "table.json")


def test_every_executor_builds_the_same_table() -> None:
    expected = small_table().entries
    with ThreadPoolExecutor(3) as threads:
        assert small_table(executor=threads).entries == expected
    with ProcessPoolExecutor(2) as processes:
        assert small_table(executor=processes).entries == expected
    assert small_table(seed=1).entries != expected


class FailingExecutor(Executor):
    """Solves the first rows, then fails like a worker that was killed."""

    def __init__(self, good: int) -> None:
        self.remaining = good

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        if self.remaining > 0:
            self.remaining -= 1
            future.set_result(fn(*args, **kwargs))
        elif self.remaining == 0:
            self.remaining -= 1
            future.set_exception(KeyboardInterrupt())
        return future


def test_interrupted_build_continues_with_the_unsolved_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = tmp_path / "state"
    with pytest.raises(KeyboardInterrupt):
        small_table(state=state, executor=FailingExecutor(2))
    kept = len(list(state.iterdir()))
    assert kept == 2
    solved: list[Job] = []
    solve_job = build.solve_job

    def counted(job: Job) -> TableEntry:
        solved.append(job)
        return solve_job(job)

    monkeypatch.setattr(build, "solve_job", counted)
    reported: list[tuple[int, int]] = []
    resumed = small_table(state=state, progress=lambda done, total: reported.append((done, total)))
    assert len(solved) == 4 - kept
    assert reported == [(done, 4) for done in range(1, 5)]
    discard_rows(table_jobs(THREE_BIT, ("linear", "log"), (20.0,), (1, 2)), state)
    assert not state.exists()
    assert resumed.entries == small_table().entries


def test_table_of_several_cameras_and_custom_responses() -> None:
    custom = tabulated_desired([0.05, 0.3, 1.0], [0, 0.5, 1], name="custom")
    jobs = table_jobs([THREE_BIT, linear_response(2)], [custom, "linear"], (9.0,), (2,))
    made = build_table(jobs)
    assert [entry.camera_name for entry in made.entries] == ["linear 3 bit"] * 2 + [
        "linear 2 bit"
    ] * 2
    assert made.find(linear_response(2), custom, 2) is not None


def test_table_without_rows_is_refused() -> None:
    with pytest.raises(UsageError, match="the exposure table has no rows; name at least one"):
        build_table(table_jobs(THREE_BIT, (), (), ()))


def test_invalid_names_and_counts_are_refused_before_the_first_row() -> None:
    with pytest.raises(UsageError, match="unknown response 'lgo'"):
        table_jobs(THREE_BIT, ("lgo",), (9.0,), (2,))
    with pytest.raises(UsageError, match="invalid number of exposures 17: expected 1 to 16"):
        table_jobs(THREE_BIT, ("log",), (9.0,), (17,))


def test_saved_table_is_json(tmp_path: Path) -> None:
    small_table().save(tmp_path / "table.json")
    data = json.loads((tmp_path / "table.json").read_text())
    assert data["format"] == "camctl exposure table"
    assert len(data["entries"]) == 4
