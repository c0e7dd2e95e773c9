"""How long it takes to find out that no camera is connected.

    python tests/bench/bench_discovery.py           on this machine
    python tests/virtual_hardware/run.py --bench    in a virtual machine, with two other benchmarks

Measured are calls of `camctl.list_backends` with the backends' modules imported, as in
the menu, and beside them the command line with its imports.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from camctl.interface.backends import list_backends

CALLS = 5
MOST_S = 1.0  # the menu looks while a person waits


def main() -> int:
    """Print the times; return 1 if a later call on this machine took longer than `MOST_S`."""
    began = time.perf_counter()
    found = list_backends()
    first_s = time.perf_counter() - began
    real = [camera.id for backend in found for camera in backend.cameras if camera.driver != "sim"]
    later_s = []
    for _ in range(CALLS):
        began = time.perf_counter()
        list_backends()
        later_s.append(time.perf_counter() - began)
    began = time.perf_counter()
    command = Path(sys.executable).with_name("camctl")
    subprocess.run([command, "cameras"], check=True, stdout=subprocess.DEVNULL)
    whole_s = time.perf_counter() - began
    print(f"cameras connected: {', '.join(real) or 'none'}")
    for backend in found:
        if backend.problem:
            print(f"{backend.name} could not look for cameras: {backend.problem}")
    print(f"first call, with imports  {first_s:6.3f} s")
    print(f"slowest of {CALLS} more        {max(later_s):6.3f} s   (at most {MOST_S:g} s)")
    print(f"camctl cameras, a process {whole_s:6.3f} s")
    # The speed of an emulated processor says nothing about a real one.
    return int(max(later_s) > MOST_S and not os.environ.get("CAMCTL_IN_GUEST"))


if __name__ == "__main__":
    sys.exit(main())
