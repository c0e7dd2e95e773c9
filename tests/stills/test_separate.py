"""Pictures of others: decoded in another process, whatever becomes of that."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from device_readers import still_files

from camctl.errors import CameraProtocolError, DataError
from camctl.stills import separate
from camctl.stills.decoding import read_still
from camctl.stills.files import read_photograph
from camctl.stills.separate import read_apart

pytest.importorskip("rawpy", reason="rawpy is not installed")


def test_a_raw_file_is_the_same_from_another_process(tmp_path: Path) -> None:
    data = still_files()["a.dng"]
    here, apart = read_still(data, "a.dng"), read_apart(data, "a.dng")
    assert np.array_equal(here.pixels, apart.pixels)
    assert apart.pixels.dtype == here.pixels.dtype
    assert {**vars(here), "pixels": 0} == {**vars(apart), "pixels": 0}
    with pytest.raises(CameraProtocolError):
        read_apart(b"no raw file at all", "a.dng")
    for name in ("a.jpg", "a.tif"):  # after an error, and of few bytes
        here, apart = read_still(still_files()[name], name), read_apart(still_files()[name], name)
        assert np.array_equal(here.pixels, apart.pixels)
    assert len(separate._free) == 1  # the same process has answered
    (tmp_path / "b.cr2").write_bytes(b"no raw file at all")
    with pytest.raises(DataError):
        read_photograph(tmp_path / "b.cr2")


@pytest.mark.parametrize(
    ("program", "why"),
    [
        ("import os; input(); os.kill(os.getpid(), 11)", "crashed .SIGSEGV"),
        ("import os; os.kill(os.getpid(), 24)", "takes more than a minute"),
        ("print(input()[:0])", "without an answer"),
        ('input(); print(\'{"shape": [1000000, 1000000], "dtype": "uint16"}\')', "cannot be read"),
    ],
)
def test_a_decoder_that_fails_is_the_error_of_its_file(
    monkeypatch: pytest.MonkeyPatch, program: str, why: str
) -> None:
    monkeypatch.setattr(separate, "_COMMAND", (sys.executable, "-c", program))
    monkeypatch.setattr(separate, "_free", [])
    with pytest.raises(CameraProtocolError, match=why):
        read_apart(bytes(100), "a.cr2")
    assert separate._free == []
