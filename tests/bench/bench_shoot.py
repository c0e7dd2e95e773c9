"""Memory and processor time of `camctl shoot` before the drawn default scene, by its parts.

    python tests/bench/bench_shoot.py [--megapixels 24] [-n 6] [--rounds 3]

Each capture runs in a process of its own.  A part is a function; its time is the processor time of
the thread that called it, without the parts that it called itself; work in other threads counts by
the name of its function.  What the simulator does (drawing, planning and rendering) is summed
apart; the time of the rest of `shoot` is the processor time of the process less the simulator's.
"""

from __future__ import annotations

import argparse
import importlib
import json
import resource
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camctl.__main__ import settle

SIMULATOR = "simulator"
#: Modules, functions and the part that each belongs to.
PARTS = (
    ("camctl.sim.scenes.scene", "load_scene", SIMULATOR),
    ("camctl.sim.backend", "load_scene", SIMULATOR),
    ("camctl.sim.camera", "View.of", SIMULATOR),
    ("camctl.sim.render", "Renderer.plan", SIMULATOR),
    ("camctl.sim.render", "Renderer.expose", SIMULATOR),
    ("camctl.sim.compiled", "KernelChoice._load_now", SIMULATOR),
    ("camctl.captures.sequencer", "plan_capture", "meter and plan"),
    ("camctl.records.folder_store", "FolderStore.keep", "store and checksum frames"),
    ("camctl.captures.sequence", "FrameChecks.add", "compare frames with neighbours"),
    ("camctl.captures.sequence", "Accumulator.accumulate", "sum"),
    ("camctl.captures.sequence", "FrameChecks.suspects", "look for wrong frames"),
    ("camctl.captures.outputs", "_effective_camera", "effective camera"),
    ("camctl.captures.outputs", "light_shares", "light outside the range"),
    ("camctl.captures.outputs", "_achieved", "achieved quality"),
    ("camctl.captures.outputs", "find_movement", "look for movement"),
    ("camctl.captures.outputs", "measure_noise", "measure noise"),
    ("camctl.captures.outputs", "_light", "weights of the light"),
    ("camctl.captures.outputs", "find_ghosts", "ghosts"),
    ("camctl.records.folder_store", "FolderStore.keep_pictures", "pictures and files"),
)


class Clocks:
    """Processor time of parts, by the threads that called them."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = defaultdict(float)
        self.peak_mb: dict[str, float] = {}
        self._open = threading.local()
        self._lock = threading.Lock()

    def wrapped(self, work: Callable[..., Any], part: str) -> Callable[..., Any]:
        """Return `work` whose time is counted for `part`."""

        def call(*args: Any, **others: Any) -> Any:
            stack: list[float] = self._open.__dict__.setdefault("stack", [])
            began = time.thread_time()
            stack.append(0.0)
            try:
                return work(*args, **others)
            finally:
                took = time.thread_time() - began
                inner = stack.pop()
                if stack:
                    stack[-1] += took
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                with self._lock:
                    self.spent[part] += took - inner
                    self.peak_mb[part] = max(self.peak_mb.get(part, 0.0), peak)

        return call

    def watch(self, module: str, name: str, part: str) -> None:
        """Count the calls of a function, or of a method, for `part`."""
        owner: Any = importlib.import_module(module)
        *above, last = name.split(".")
        for each in above:
            owner = getattr(owner, each)
        setattr(owner, last, self.wrapped(getattr(owner, last), part))


def shoot(megapixels: float, exposures: int, folder: str) -> None:
    """Run one capture and print its measurements as JSON."""
    began = time.process_time()
    settle()
    clocks = Clocks()
    for module, name, part in PARTS:
        clocks.watch(module, name, part)
    render = importlib.import_module("camctl.sim.render")
    submit = render._pool().submit
    render._pool().submit = lambda work, *args: submit(clocks.wrapped(work, SIMULATOR), *args)
    columns = round((megapixels * 1e6 * 1.5) ** 0.5) // 2 * 2
    rows = round(megapixels * 1e6 / columns) // 2 * 2
    from camctl.cli import main
    from camctl.system.threads import Threads

    begin = Threads.submit

    def submitted(pool: Any, work: Callable[..., Any], *args: Any) -> Any:
        name = getattr(work, "func", work).__qualname__
        return begin(pool, clocks.wrapped(work, f"thread: {name}"), *args)

    Threads.submit = submitted  # type: ignore[assignment]
    imported = time.process_time() - began
    arguments = ["shoot", "-n", str(exposures), "-O", f"size={columns}x{rows}", "-o", folder]
    if failed := main(arguments):
        sys.exit(failed)
    usage = resource.getrusage(resource.RUSAGE_SELF)
    parts = {"import": imported, **clocks.spent}
    total = usage.ru_utime + usage.ru_stime
    parts["other"] = total - sum(parts.values())
    measured = {"total": total, "peak_mb": usage.ru_maxrss / 1024, "parts": parts}
    print("\n" + json.dumps(measured | {"peaks": clocks.peak_mb}))


def main() -> None:
    """Run captures in fresh processes and print the fastest of each part."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--megapixels", type=float, default=24)
    parser.add_argument("-n", type=int, default=6)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--folder", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.folder:
        shoot(chosen.megapixels, chosen.n, chosen.folder)
        return
    runs = []
    for _ in range(chosen.rounds):
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, __file__, "--megapixels", str(chosen.megapixels)]
            command += ["-n", str(chosen.n), "--folder", str(Path(folder) / "out")]
            done = subprocess.run(command, check=True, capture_output=True, text=True)
        runs.append(json.loads(done.stdout.splitlines()[-1]))
    best = min(runs, key=lambda run: run["total"] - run["parts"][SIMULATOR])
    rest = best["total"] - best["parts"][SIMULATOR]
    peak = max(run["peak_mb"] for run in runs)
    for part, seconds in sorted(best["parts"].items(), key=lambda each: -each[1]):
        peaks = best["peaks"].get(part)
        print(f"{part:32} {seconds:6.2f} s" + (f"   up to {peaks:.0f} MB" if peaks else ""))
    print(f"{chosen.megapixels:g} MP, n = {chosen.n}: peak {peak:.0f} MB;", end=" ")
    print(f"{best['total']:.2f} s of processor time, {rest:.2f} s without the simulator's")


if __name__ == "__main__":
    main()
