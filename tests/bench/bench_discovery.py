"""How long it takes to find out that no camera is connected.

    python tests/bench/bench_discovery.py          on this machine
    python tests/virtual_hardware/run.py --bench                in the laboratory's guest, with the other two

Each look is one call of `camctl.backends.list_backends` with the roads' modules imported, as in
the menu; the command line with its imports is measured beside it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from camctl.backends import list_backends

LOOKS = 5
MOST_S = 1.0


def main() -> int:
    """Print the times; return 1 if the slowest look on this machine took longer than `MOST_S`."""
    began = time.perf_counter()
    found = list_backends()
    first_s = time.perf_counter() - began
    real = [camera.id for look in found for camera in look.cameras if camera.driver != "sim"]
    looks = []
    for _ in range(LOOKS):
        began = time.perf_counter()
        list_backends()
        looks.append(time.perf_counter() - began)
    began = time.perf_counter()
    command = Path(sys.executable).with_name("camctl")
    subprocess.run([command, "cameras"], check=True, stdout=subprocess.DEVNULL)
    whole_s = time.perf_counter() - began
    print(f"cameras connected: {', '.join(real) or 'none'}")
    for problem in (f"{look.name}: {look.problem}" for look in found if look.problem):
        print(f"could not look: {problem}")
    print(f"first look, with imports  {first_s:6.3f} s")
    print(f"slowest of {LOOKS} more        {max(looks):6.3f} s   (at most {MOST_S:g} s)")
    print(f"camctl cameras, a process {whole_s:6.3f} s")
    # An emulated processor says nothing of how long it takes on a real one.
    return int(max(looks) > MOST_S and not os.environ.get("CAMCTL_IN_GUEST"))


if __name__ == "__main__":
    sys.exit(main())
