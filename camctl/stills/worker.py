"""Decodes pictures in a process of its own, for `camctl.stills.separate`.

The libraries of JPEG, PNG, TIFF, raw formats and OpenEXR are written in C and C++, without limits
of their own.  What a file makes of them stays here: memory and processor time are limited, and a
crash ends this process alone.

Requests and answers are lines of JSON.  The bytes that they speak of, the picture file and its
samples, are in a file that both processes have open, since pipes take three times as long.
"""

from __future__ import annotations

import json
import os
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from camctl.errors import CamctlError, DataError
from camctl.stills.decoding import read_still
from camctl.stills.maps import READERS
from camctl.system.memory import share_free_memory

MOST_SECONDS = 60
"""Processor time for one file: the slowest of 100 megapixels takes 4 s on one core (2026-11)."""

_MOST_BYTES = 4 << 30
"""Memory beyond the libraries: 400 megapixels of 2 bytes (`MAX_PIXELS`), held five times."""


def serve(requests: BinaryIO, answers: BinaryIO, shared: int) -> None:
    """Answer requests until there are no more."""
    share_free_memory()  # the next file takes what the last one took
    _limit_memory()
    for line in requests:
        request = json.loads(line)
        _limit_time()
        answers.write(json.dumps(_answer(shared, request)).encode() + b"\n")
        answers.flush()


def _answer(shared: int, request: dict[str, Any]) -> dict[str, Any]:
    """Replace the picture file in `shared` by its samples; return what they are."""
    if "read" in request:
        return _map_answer(shared, request)
    name = request["name"]
    try:
        still = read_still(os.pread(shared, request["bytes"], 0), name)
        pixels = np.ascontiguousarray(still.pixels)
        put(shared, pixels.reshape(-1).view(np.uint8).data)
        if still.invalid is not None:
            put(shared, np.ascontiguousarray(still.invalid).view(np.uint8).data, pixels.nbytes)
    except CamctlError as error:
        return {"error": type(error).__name__, "what": error.what, "hint": error.hint}
    except MemoryError:
        what = f"{name} needs more than {_MOST_BYTES >> 30} GiB to be decoded"
        return {"error": "CameraProtocolError", "what": what, "hint": "leave it out"}
    return {
        "shape": pixels.shape,
        "dtype": pixels.dtype.name,
        "layout": still.layout.value,
        "bits": still.bits,
        "black": still.black,
        "white": still.white,
        "notes": still.notes,
        "has_invalid": still.invalid is not None,
        "few_chroma_samples": still.few_chroma_samples,
        "brightness_steps": still.brightness_steps,
        "colour": None if still.colour is None else asdict(still.colour),
    }


def _map_answer(shared: int, request: dict[str, Any]) -> dict[str, Any]:
    """Answer what a reader of `camctl.stills.maps` finds; samples are put into `shared`."""
    error = "UnreadableError"
    try:
        found: Any = READERS[request["read"]](Path(request["name"]), *request["arguments"])
        if not (isinstance(found, tuple) and isinstance(found[0], np.ndarray)):
            return {"found": found}
        samples, notes = found
        if samples.dtype.kind not in "biuf" or not samples.size:
            raise ValueError("its samples are no real numbers")
        samples = np.ascontiguousarray(samples, samples.dtype.newbyteorder("="))
        put(shared, samples.reshape(-1).view(np.uint8).data)
        return {"shape": samples.shape, "dtype": samples.dtype.name, "notes": notes}
    except DataError as found:
        return {"error": "DataError", "what": found.what, "hint": found.hint}
    except MemoryError:
        what = f"it needs more than {_MOST_BYTES >> 30} GiB to be decoded"
        return {"error": error, "what": what, "hint": ""}
    except Exception as found:  # the library raises errors of any type for a damaged file
        lines = str(found).strip().splitlines() or [type(found).__name__]
        return {"error": error, "what": lines[0], "hint": ""}


def put(file: int, content: bytes | memoryview, at: int = 0) -> None:
    """Write to a place of a file that another process has open with the same position."""
    view, done = memoryview(content).cast("B"), 0
    while done < len(view):
        done += os.pwrite(file, view[done:], at + done)


def _limit_memory() -> None:
    if os.name != "posix":
        return
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    sizes = Path("/proc/self/statm")  # Linux
    if not sizes.exists():
        return
    used = int(sizes.read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [each for each in (soft, used + _MOST_BYTES) if each != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))


def _limit_time() -> None:
    if os.name != "posix":
        return
    import resource

    _, hard = resource.getrlimit(resource.RLIMIT_CPU)
    resource.setrlimit(resource.RLIMIT_CPU, (int(time.process_time()) + MOST_SECONDS, hard))


if __name__ == "__main__":
    own = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not disturb the answers
    serve(sys.stdin.buffer, own, int(sys.argv[1]))
