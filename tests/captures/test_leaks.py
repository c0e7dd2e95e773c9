"""A long series in one process: memory, open files and threads do not grow."""

from __future__ import annotations

import ctypes
import gc
import resource
import shutil
import threading
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest
from small_cameras import gradient, small_camera

import camctl

MOST_RESIDENT_BYTES = 2 << 20
"""Growth of the whole process: 14 kB in each of 150 captures."""

MOST_PYTHON_BYTES = 250
"""Growth of the memory of Python and numpy with each call."""

EXR_BYTES = 1000
"""What the library OpenEXR keeps of each file that it writes, whatever its caller does: the names
of the attributes and of the channels, 0.6 kB for 3 channels and 0.84 kB for 9, by tracemalloc."""

WARM_UP, MEASURED = 50, 100
"""Calls before the first measurement; and the last ones, of which Python's memory is measured."""


@dataclass(frozen=True)
class Usage:
    """What a process uses."""

    resident_bytes: int
    files: tuple[str, ...]
    threads: int

    @classmethod
    def now(cls) -> Usage:
        """Return what this process uses, without what its allocator holds in reserve."""
        gc.collect()
        # The reserve of glibc changes by 40 MB between two captures with a contact sheet.
        trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
        if trim is not None:
            trim(0)
        pages = int(Path("/proc/self/statm").read_text().split()[1])
        # The listing itself opens the folder, which is gone afterwards.
        links = [link for link in Path("/proc/self/fd").iterdir() if link.exists()]
        files = tuple(sorted(str(link.readlink()) for link in links))
        return cls(pages * resource.getpagesize(), files, threading.active_count())


def python_memory() -> tracemalloc.Snapshot:
    """Return the memory that Python and numpy hold, of that allocated since tracing began."""
    gc.collect()
    return tracemalloc.take_snapshot()


@contextmanager
def threads_without_tracing() -> Iterator[None]:
    """Switch the tracing of coverage off in new threads: it keeps 1.1 kB of each.

    It must be done in the test itself: a process of pytest-xdist has two collectors of coverage,
    and where the mark `no_cover` ends the one, the other goes on.
    """
    tracing = threading.gettrace()
    threading.settrace(cast("Any", None))
    try:
        yield
    finally:
        threading.settrace(cast("Any", tracing))


@threads_without_tracing()
def check_series(
    work: Callable[[int], object], count: int, *, traced: int = 140, exr_share: float = 0.0
) -> None:
    """Call `work` with 0 to `count` - 1, and check that nothing grows.

    Python's memory is traced in the last `traced` calls, which makes them slow; `exr_share` is the
    share of the calls that write an OpenEXR file.
    """
    for number in range(WARM_UP):
        work(number)
    before = Usage.now()
    for number in range(WARM_UP, count - traced):
        work(number)
    after = Usage.now()
    tracemalloc.start(1)
    try:
        for number in range(count - traced, count - MEASURED):
            work(number)
        snapshot_before = python_memory()
        for number in range(count - MEASURED, count):
            work(number)
        snapshot = python_memory()
    finally:
        tracemalloc.stop()
    end = Usage.now()
    assert end.files == before.files
    assert end.threads == before.threads
    # A table is allocated anew when it is full, as one block: that of all interned strings has
    # megabytes.  What leaks has more blocks with each call.
    lines = [
        line for line in snapshot.compare_to(snapshot_before, "lineno") if line.count_diff != 1
    ]
    grown = sum(line.size_diff for line in lines)
    most = MEASURED * (MOST_PYTHON_BYTES + exr_share * EXR_BYTES)
    assert grown < most, "\n".join(map(str, lines[:12]))
    assert after.resident_bytes - before.resident_bytes < MOST_RESIDENT_BYTES


@pytest.mark.slow
@pytest.mark.no_cover  # the tracing of coverage keeps something of each thread
@pytest.mark.timeout(900)
def test_hundreds_of_captures_leave_nothing_behind(tmp_path: Path) -> None:
    """Two in memory, two into folders, and so on; every second one of a mosaic."""
    request = camctl.CaptureRequest(ratios=(1.0, 8.0))
    light = gradient(12, 16)

    def shoot(number: int) -> None:
        folder = tmp_path / f"{number}" if number & 2 else None
        layout = "rggb" if number & 1 else "mono"
        with small_camera("ideal-6", light, seed=number, layout=layout) as camera:
            report = camctl.capture(camera, request, folder)
        assert report.radiance().size > 0
        assert report.sum().max() > 0
        if folder is not None:
            assert camctl.read_report(folder).status == "complete"
            shutil.rmtree(folder)

    check_series(shoot, 300, exr_share=0.5)


@pytest.mark.slow
@pytest.mark.no_cover  # the tracing of coverage keeps something of each thread
@pytest.mark.timeout(900)
def test_hundreds_of_plans_leave_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every second plan looks up a row that is solved and cached for it, of nearly one size."""
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path))
    light = gradient(12, 16)

    def plan(number: int) -> None:
        new = number % 2 == 0
        request = camctl.CaptureRequest(
            dynamic_range=100.0 + (number / 1000 if new else 0),
            count=1 if new else 2,
            base_s=0.001,
        )
        with small_camera("ideal-6", light) as camera:
            assert camctl.plan_capture(camera, request).exposures

    # Before the last 100 each of the 32 kept searches was traced.
    check_series(plan, 360, traced=200)
    assert len(list((tmp_path / "exposure").iterdir())) == 2 * 181  # settings, and their levels


@pytest.mark.parametrize(
    "leak",
    [
        *("file", "thread"),
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("memory", "small memory")),
    ],
)
def test_a_leak_is_found(tmp_path: Path, leak: str) -> None:
    kept: list[Any] = []
    ended = threading.Event()

    def work(number: int) -> None:
        if leak == "memory":
            kept.append(b"x" * 20_000)
        elif leak == "small memory":
            kept.append(gradient(12, 16))
        elif leak == "file":
            kept.append((tmp_path / f"{number}").open("w"))
        else:
            kept.append(threading.Thread(target=ended.wait, daemon=True))
            kept[-1].start()

    try:
        with pytest.raises(AssertionError):
            check_series(work, 400 if leak == "memory" else 260)
    finally:
        ended.set()
        for each in kept:
            if leak == "file":
                each.close()
            elif leak == "thread":
                each.join()
