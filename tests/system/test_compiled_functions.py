"""Compiled functions: machine code that is kept does what the function does, without numba."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent
from types import FunctionType

import numpy as np
import pytest

from camctl.system.machine_code import KeptCode, kind_of

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
    def sign(number, found):
        found[0] = 1 if number > 0 else -1

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
    from made import FACTOR, Both, sign, total, work
    grid = np.arange(12, dtype=np.float32).reshape(4, 3)
    for values in (grid, grid[::2], grid.T):
        found = np.full(3, -1, np.float32)
        work(Both(values, np.float32(7)), len(values) - 1, True, found)
        print(found.tolist())
    unaligned = np.zeros(49, np.uint8)[1:].view(np.float32).reshape(4, 3)
    unaligned[:] = grid
    wide = np.zeros((4, 6), np.float32)
    wide[:, ::-2] = grid[:, ::-1]
    fixed = grid.copy()
    fixed.flags.writeable = False
    for values in (grid[::-1], wide[:, 1::2], unaligned, fixed, np.empty((0, 3), np.float32)):
        found = np.full(4, -1, np.float32)
        work(Both(values, np.float32(7)), len(values), True, found)
        expected = np.maximum(values[:, 1] * FACTOR + 1, 7)
        assert found[: len(values)].tolist() == expected.tolist(), values
    before = "numba" in sys.modules
    print(total(np.arange(3.0)), before)
    for number in (5, -(2**63), 2**63 - 1, 2**63 + 7, True, np.float32(-1), np.int8(-1)):
        found = np.zeros(1)
        sign(number, found)
        assert found[0] == (1 if number > 0 else -1), number
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
def test_functions_run_where_no_machine_code_can_be_kept(tmp_path: Path) -> None:
    for name in ("__pycache__", ".cache"):
        (tmp_path / name).touch()
    assert run(tmp_path, 2.0)[-1] == "3.0 True"


@pytest.mark.slow
def test_machine_code_of_another_constant_is_not_used(tmp_path: Path) -> None:
    run(tmp_path, 2.0)
    assert run(tmp_path, 3.0)[0] == "[7.0, 13.0, 22.0]"


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> KeptCode:
    """A function of a file in `tmp_path`, where its machine code is kept."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    names: dict[str, FunctionType] = {}
    exec(compile("def work(found): found[0] = 1", tmp_path / "made.py", "exec"), names)
    names["work"].__module__ = "made"
    found = KeptCode(names["work"], {}, (kind_of(np.zeros(1, np.float32)),))
    found.keep(b"machine code", "work")
    return found


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[bytes]:
    """The machine code that would be run."""
    found: list[bytes] = []
    monkeypatch.setattr(
        "camctl.system.machine_code.native", lambda code, _symbol, _kinds: found.append(code)
    )
    return found


def test_machine_code_is_read_as_it_was_kept(kept: KeptCode, loaded: list[bytes]) -> None:
    kept.read()
    assert loaded == [b"machine code"]


@pytest.mark.parametrize(
    "changed",
    [
        lambda _content: b"",
        lambda _content: b"[1]\nmachine code",
        lambda _content: b"{}\nmachine code",
        lambda _content: b"\xff\n",
        lambda content: content[:-1],
        lambda content: content.replace(b'"key": "', b'"key": "0'),
    ],
)
def test_damaged_machine_code_is_not_run(
    changed: Callable[[bytes], bytes], kept: KeptCode, loaded: list[bytes], tmp_path: Path
) -> None:
    (path,) = (tmp_path / "__pycache__").glob("*.o")
    path.write_bytes(changed(path.read_bytes()))
    assert kept.read() is None
    assert not loaded


def test_what_is_no_file_is_not_waited_for(kept: KeptCode, tmp_path: Path) -> None:
    (path,) = (tmp_path / "__pycache__").glob("*.o")
    path.unlink()
    os.mkfifo(path)
    assert kept.read() is None
    path.unlink()
    path.symlink_to("/dev/zero")
    assert kept.read() is None
    path.unlink()
    path.mkdir()
    assert kept.read() is None


def test_machine_code_of_another_user_is_not_run(
    kept: KeptCode, loaded: list[bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path,) = (tmp_path / "__pycache__").glob("*.o")
    if os.geteuid() == 0:
        os.chown(path, 12345, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: 12345)
    assert kept.read() is None
    assert not loaded


def test_machine_code_is_read_where_the_system_states_no_owner(
    kept: KeptCode, loaded: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr("camctl.system.machine_code.os.geteuid")
    kept.read()
    assert loaded == [b"machine code"]


def test_machine_code_of_another_processor_has_another_name(
    kept: KeptCode, loaded: list[bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("camctl.system.machine_code._machine", lambda: ("other",))
    names: dict[str, FunctionType] = {}
    exec(compile("def work(found): found[0] = 1", tmp_path / "made.py", "exec"), names)
    names["work"].__module__ = "made"
    other = KeptCode(names["work"], {}, (kind_of(np.zeros(1, np.float32)),))
    assert other.read() is None
    other.keep(b"other", "work")
    kept.read()
    other.read()
    assert loaded == [b"machine code", b"other"]


def test_integers_that_lose_bits_have_a_kind_of_their_own() -> None:
    assert kind_of(2**63 - 1) == kind_of(-(2**63)) == (int,)
    assert kind_of(2**63) == kind_of(-(2**63) - 1) != (int,)
