"""Lines of OpenEXR files in run lengths by compiled code, beside those of the OpenEXR library."""

from __future__ import annotations

from pathlib import Path

import Imath
import numpy as np
import OpenEXR
import pytest


@pytest.mark.parametrize("names", ["Y", "RGB"])
def test_files_have_the_bytes_that_the_library_writes(tmp_path: Path, names: str) -> None:
    pytest.importorskip("numba")
    from camctl.stills.compiled_runs import LinesFile

    random, rows, columns = np.random.default_rng(3), 40, 701
    channels = {}
    for place, name in enumerate(f"{prefix}{each}" for prefix in ("", "mask.") for each in names):
        # Lines of few and of many values, and runs of each length around the longest ones.
        values = random.integers(0, 1 + 2 ** random.integers(0, 16, (rows, 1)), (rows, columns))
        values[1, :130] = 7
        for length in range(120, 270):
            values[length % 30 + 2, length : 2 * length + place] = length
        values[33:35] = 0
        channels[name] = values.astype(np.uint16).view(np.float16)
    header = OpenEXR.Header(columns, rows) | {
        "compression": Imath.Compression(Imath.Compression.RLE_COMPRESSION),
        "channels": {
            name: Imath.Channel(Imath.PixelType(Imath.PixelType.HALF)) for name in channels
        },
    }
    library, own = tmp_path / "library.exr", tmp_path / "own.exr"
    file = OpenEXR.OutputFile(str(library), header)
    file.writePixels(channels, rows)
    file.close()
    OpenEXR.OutputFile(str(own), header).close()
    lines = LinesFile(own, rows)
    for start in range(0, rows, 16):
        lines.prepared([channels[name][start : start + 16] for name in sorted(channels)])()
    lines.close()
    assert own.read_bytes() == library.read_bytes()
