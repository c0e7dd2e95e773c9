"""Do one thing hundreds of times in a process of its own, and print what it leaves behind.

    python leaks.py {captures|plans} FOLDER [--planted]

Prints one JSON object: what grew, a text for each thing; and with --planted, below the name of each
of `LEAKS`, what grew when some more calls left that behind.

The memory in use is counted, not what the process has: of that, the kernel gives and takes 2 MB at
a time where it makes huge pages of a heap (8 MB in 20 captures in a process that has collected the
tests).  With `ENVIRONMENT` the C library knows of all of it: objects, arrays, and what OpenCV and
OpenEXR allocate.  What caches of Python, numpy and the C library hold counts as in use, too, and
they fill for thousands of calls: see `_settle_caches`.
"""

from __future__ import annotations

import ctypes
import gc
import json
import mmap
import os
import shutil
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from small_cameras import gradient, small_camera

import camctl

ENVIRONMENT = {"PYTHONMALLOC": "malloc", "PYTHONHASHSEED": "0"}
"""With another order of sets, other memory is used again."""

BLOCKS, CALLS, PLANTED_CALLS = 5, 20, 4
"""Blocks of calls, after each of which the memory is read; their calls, without and with leaks."""

MOST_BYTES = 100
"""Growth of the memory in use with each call; that of plans is 0 to 4 bytes."""

EXR_BYTES = 1000
"""What the library OpenEXR keeps of each file that it writes, whatever its caller does: the names
of the attributes and of the channels, 0.6 kB for 3 channels and 0.84 kB for 9, by tracemalloc."""

MOST_RESIDENT_BYTES = 14_000
"""Growth with each call of what is no file on a disk, for what is not allocated with malloc."""

_NO_HUGE_PAGES = 41  # PR_SET_THP_DISABLE, see prctl(2)


class _Mallinfo2(ctypes.Structure):
    """What the allocator of glibc has given away and holds, see mallinfo2(3)."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in (
            *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
            *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
        )
    )


_LIBC = ctypes.CDLL(None)


def can_count() -> bool:
    """Return whether the C library counts what is in use: glibc 2.33 does."""
    return hasattr(_LIBC, "mallinfo2")


@dataclass(frozen=True)
class Usage:
    """What a process uses."""

    bytes_in_use: int
    resident_bytes: int
    files: tuple[str, ...]
    threads: int

    @classmethod
    def now(cls) -> Usage:
        """Return what this process uses, without what its allocator holds in reserve."""
        _settle_caches()
        _LIBC.malloc_trim(0)
        _LIBC.mallinfo2.restype = _Mallinfo2
        heap = _LIBC.mallinfo2()
        status = (line.split() for line in Path("/proc/self/status").read_text().splitlines())
        resident = sum(int(words[1]) for words in status if words[0] in ("RssAnon:", "RssShmem:"))
        # The listing itself opens the folder, which is gone afterwards.
        links = [link for link in Path("/proc/self/fd").iterdir() if link.exists()]
        return cls(
            heap.uordblks + heap.hblkhd,
            resident << 10,
            tuple(sorted(str(link.readlink()) for link in links)),
            threading.active_count(),
        )


def _settle_caches() -> None:
    """Empty or fill what keeps memory of calls that are over.

    Python's cache of attributes that were looked up keeps 4,096 names by their addresses: a name
    that C code makes anew for each look-up (each text file asks its codec for "incrementaldecoder")
    stays in it each time, with 72 bytes.  numpy keeps 7 blocks of each size up to 1,023 bytes, and
    the C library 7 of each of its sizes up to 1,032 bytes.  Emptied and full, they do not grow.
    """
    gc.collect()
    forget_attributes = getattr(sys, "_clear_internal_caches", None) or sys._clear_type_cache
    forget_attributes()
    blocks = [np.empty(size, np.uint8) for size in range(1024) for _ in range(7)]
    del blocks
    _LIBC.malloc.restype = ctypes.c_void_p
    for size in range(24, 1033, 16):
        for pointer in [_LIBC.malloc(size) for _ in range(7)]:
            _LIBC.free(ctypes.c_void_p(pointer))


def growth(work: Callable[[int], object], numbers: range, exr_share: float) -> list[str]:
    """Call `work` with each of `numbers`, and return what grew.

    A share of the calls writes an OpenEXR file.
    """
    first = last = Usage.now()
    in_use = [first.bytes_in_use]
    for count, number in enumerate(numbers, 1):
        work(number)
        if count % (len(numbers) // BLOCKS) == 0:
            last = Usage.now()
            in_use.append(last.bytes_in_use)
    steps = [after - before for before, after in pairwise(in_use)]
    # A table is allocated anew when it is full: that of all interned strings has megabytes.  What
    # leaks has more with each call, not in one block of them.
    kept = (sum(steps) - max(steps)) / (len(numbers) * (1 - 1 / BLOCKS))
    resident = (last.resident_bytes - first.resident_bytes) / len(numbers)
    grew = {
        f"files: {set(last.files) ^ set(first.files)}": last.files != first.files,
        f"threads: {last.threads - first.threads}": last.threads != first.threads,
        f"bytes in use: {kept:.0f} a call": kept >= MOST_BYTES + exr_share * EXR_BYTES,
        f"resident bytes: {resident:.0f} a call": resident >= MOST_RESIDENT_BYTES,
    }
    return [text for text, found in grew.items() if found]


def captures(folder: Path) -> Callable[[int], object]:
    """Two in memory, two into folders, and so on; every second one of a mosaic."""
    request = camctl.CaptureRequest(ratios=(1.0, 8.0))
    light = gradient(12, 16)

    def shoot(number: int) -> None:
        directory = folder / f"{number}" if number & 2 else None
        layout = "rggb" if number & 1 else "mono"
        with small_camera("ideal-6", light, seed=number, layout=layout) as camera:
            report = camctl.capture(camera, request, directory)
        assert report.radiance().size > 0
        assert report.sum().max() > 0
        if directory is not None:
            assert camctl.read_report(directory).status == "complete"
            shutil.rmtree(directory)

    return shoot


def plans(folder: Path) -> Callable[[int], object]:
    """Every second plan looks up a row that is solved and cached for it, of nearly one size."""
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

    os.environ["CAMCTL_CACHE"] = str(folder)
    return plan


WORKS = {"captures": (captures, 40, 0.5), "plans": (plans, 80, 0.0)}
"""What is done, the calls before the first reading (32 searches of plans are kept), and the share
of calls that write an OpenEXR file."""


def _of_c(number: int, folder: Path) -> object:
    _LIBC.malloc.restype = ctypes.c_void_p
    return _LIBC.malloc(500)


def _mapping(number: int, folder: Path) -> object:
    mapping = mmap.mmap(-1, 40_000)
    mapping.write(b"x" * len(mapping))
    return mapping


def _thread(number: int, folder: Path) -> object:
    thread = threading.Thread(target=threading.Event().wait, daemon=True)
    thread.start()
    return thread


LEAKS: dict[str, Callable[[int, Path], object]] = {
    "objects": lambda number, folder: [number / each for each in range(1, 17)],
    "array": lambda number, folder: np.zeros(500, np.uint8),
    "memory of C": _of_c,
    "mapping": _mapping,
    "file": lambda number, folder: (folder / f"leak-{number}").open("w"),
    "thread": _thread,
}
"""What is left behind by a call."""


def main(name: str, folder: str, planted: str = "") -> None:
    """Print what grew."""
    _LIBC.prctl(_NO_HUGE_PAGES, 1, 0, 0, 0)
    vars(os)["fsync"] = os.fstat  # as in the tests, see their conftest.py
    made, warm_up, exr_share = WORKS[name]
    work = made(Path(folder))
    for number in range(warm_up):
        work(number)
    numbers = range(warm_up, warm_up + BLOCKS * CALLS)
    grew = {"": growth(work, numbers, exr_share)}
    kept: list[object] = []
    for leak, leave in LEAKS.items() if planted else ():
        numbers = range(numbers.stop, numbers.stop + BLOCKS * PLANTED_CALLS)

        def leaking(number: int, leave: Callable[[int, Path], object] = leave) -> None:
            work(number)
            kept.append(leave(number, Path(folder)))

        grew[leak] = growth(leaking, numbers, exr_share)
    print(json.dumps(grew))


if __name__ == "__main__":
    main(*sys.argv[1:])
