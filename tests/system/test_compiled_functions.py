"""Compiled functions: machine code that is kept does what the function does, without numba."""

import subprocess
import sys
from pathlib import Path
from textwrap import dedent

import pytest

pytest.importorskip("numba")

MODULE = """
    from typing import NamedTuple
    import math
    import numpy as np
    from camctl.system.compiled_functions import compiler

    FACTOR = {factor}

    class Both(NamedTuple):
        values: np.ndarray
        least: np.float32

    compiled = compiler(are_joined=True)

    @compiled
    def scaled(x):
        return x * FACTOR + math.exp(0)

    @compiled
    def work(both, count, is_used, found):
        for k in range(count):
            if is_used:
                found[k] = max(scaled(both.values[k, 1]), both.least)

    @compiled
    def total(values):
        sum = 0.0
        for k in range(len(values)):
            sum += values[k]
        return sum
"""

SCRIPT = """
    import sys
    import numpy as np
    from made import Both, total, work
    grid = np.arange(12, dtype=np.float32).reshape(4, 3)
    for values in (grid, grid[::2], grid.T):
        found = np.full(3, -1, np.float32)
        work(Both(values, np.float32(7)), len(values) - 1, True, found)
        print(found.tolist())
    before = "numba" in sys.modules
    print(total(np.arange(3.0)), before)
"""


def run(folder: Path, factor: float) -> list[str]:
    """Return what the script prints."""
    (folder / "made.py").write_text(dedent(MODULE.format(factor=factor)))
    done = subprocess.run(
        [sys.executable, "-c", dedent(SCRIPT)],
        cwd=folder,
        env={"PYTHONPATH": f"{Path(__file__).parents[2]}:{folder}", "HOME": str(folder)},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()


@pytest.mark.slow
def test_machine_code_is_kept_and_runs_without_numba(tmp_path: Path) -> None:
    expected = ["[7.0, 9.0, 15.0]", "[7.0, -1.0, -1.0]", "[7.0, 9.0, -1.0]"]
    assert run(tmp_path, 2.0) == [*expected, "3.0 True"]
    assert run(tmp_path, 2.0) == [*expected, "3.0 False"]
    for path in (tmp_path / "__pycache__").glob("made.work-*.o"):  # one of the three is damaged
        path.write_bytes(path.read_bytes()[:-1] + b"?")
        break
    assert run(tmp_path, 2.0) == [*expected, "3.0 True"]


@pytest.mark.slow
def test_machine_code_of_another_constant_is_not_used(tmp_path: Path) -> None:
    run(tmp_path, 2.0)
    assert run(tmp_path, 3.0)[0] == "[7.0, 13.0, 22.0]"
