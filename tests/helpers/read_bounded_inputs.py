"""Read damaged inputs in processes of their own, with limits on memory and processor time.

    python tests/helpers/read_bounded_inputs.py COUNT SEED [READER...]

Each reader gets COUNT inputs.  The limits are those of the kernel: 500 MB of address space beyond
what the process has before, and 5 s of processor time for an input (not of real time, so that a
busy machine changes nothing).  Prints one line for each input that is neither read nor refused, and
the number of inputs at the end.  Exit status 1 where there were such lines.
"""

from __future__ import annotations

import os
import random
import resource
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from pathlib import Path

from capture_readers import CAPTURES
from device_readers import DEVICES
from input_readers import FILES, Reader
from mutations import mutated

from camctl.errors import CamctlError

MOST_BYTES = 500 << 20
MOST_SECONDS = 5

READERS = {**FILES, **CAPTURES, **DEVICES}


def used_bytes() -> int:
    """Return the address space of this process."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def read_within_limits(reader: Reader, data: bytes, folder: Path) -> str:
    """Read one input in a child process; return "read", "refused", or what went wrong."""
    output, child_output = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(output)
        os._exit(_read(reader, data, folder, child_output))
    os.close(child_output)
    with os.fdopen(output, "rb") as file:
        text = file.read().decode(errors="replace")
    _, status = os.waitpid(child, 0)
    if os.WIFSIGNALED(status):
        return f"ended by signal {os.WTERMSIG(status)} {text}".strip()
    return text


def _read(reader: Reader, data: bytes, folder: Path, output: int) -> int:
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_SECONDS, MOST_SECONDS))
    most = used_bytes() + MOST_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    try:
        reader.read(data, folder)
        text = "read"
    except CamctlError as error:
        text = "refused" if "\n" not in str(error) else f"several lines: {error!r}"
    except BaseException:
        text = traceback.format_exc()
    os.write(output, text.encode(errors="replace")[:60_000])
    return 0


def main(count: int, seed: int, names: list[str]) -> int:
    """Run; see the module."""
    warnings.simplefilter("error")
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})  # libraries then start no threads
    results: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as scratch:
        for name in names or READERS:
            rng = random.Random(f"{seed} {name}")
            samples = READERS[name].samples()
            for number in range(count):
                data = mutated(rng.choice(samples), rng, samples)
                result = read_within_limits(READERS[name], data, Path(scratch))
                if result not in ("read", "refused"):
                    kept = Path(tempfile.gettempdir()) / f"camctl-input-{seed}-{number}"
                    kept.write_bytes(data)
                    print(f"{name}: {kept}: {result}", flush=True)
                    result = "failed"
                results[result] += 1
    print(f"{results.total()} inputs: {dict(results)}")
    return 1 if results["failed"] else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))
