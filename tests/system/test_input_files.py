"""Files that a user names are opened without waiting, and read up to a limit."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Callable
from contextlib import chdir
from pathlib import Path

import pytest

from camctl.cli.parameter_types import Seconds, Settings
from camctl.errors import DataError
from camctl.exposure.table import ExposureTable
from camctl.model.response.measured import read_curve, read_desired, read_response_model
from camctl.profiles.folder import list_profiles
from camctl.sim.devices.hub import read_config
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.studies.rows import read_runs
from camctl.studies.solver_study import SolverRun
from camctl.system.input_files import exists, open_input, read_input, read_input_text

Make = Callable[[Path], object]


def make_socket(path: Path) -> None:
    # The name of a socket has at most 107 characters.
    with socket.socket(socket.AF_UNIX) as server, chdir(path.parent):
        server.bind(path.name)


NO_FILES: dict[str, tuple[Make, str]] = {
    "endless": (lambda path: path.symlink_to("/dev/zero"), "it is a device"),
    "pipe": (os.mkfifo, "it is a named pipe"),
    "socket": (make_socket, "it is a socket"),
    "folder": (Path.mkdir, "it is a folder"),
    "missing": (lambda path: None, "No such file"),
    "loop": (lambda path: path.symlink_to(path), "symbolic links"),
}


def read_profiles(path: Path) -> object:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(path.parent))
        return list_profiles()


READERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "text": ("a.txt", lambda path: read_input_text(path, "text")),
    "curve": ("a.txt", read_curve),
    "desired": ("a.txt", read_desired),
    "model": ("a.txt", read_response_model),
    "table": ("a.json", ExposureTable.load),
    "settings": (
        "a.txt",
        lambda path: Settings("", unit=Seconds(), file=True).parse(str(path), ""),
    ),
    "sensor": ("a.json", load_sensor),
    "scene": ("a.json", load_scene),
    "hdr": ("a.hdr", load_scene),
    "exr": ("a.exr", load_scene),
    "tiff": ("a.tiff", load_scene),
    "npy": ("a.npy", load_scene),
    "devices": ("a.json", read_config),
    "rows": ("a.json", lambda path: read_runs(path, SolverRun)),
    "profile": ("a.json", read_profiles),
}


@pytest.fixture
def path_named(tmp_path: Path) -> Callable[[str], Path]:
    folder = tmp_path / "f"
    folder.mkdir()
    return lambda name: folder / name


@pytest.mark.parametrize(
    ("reader", "kind"),
    [
        # All readers open files by one function: one sees each kind, each of the others one.
        (reader, kind)
        for place, reader in enumerate(READERS)
        for number, kind in enumerate(NO_FILES)
        if place == 0 or place % len(NO_FILES) == number
    ],
)
def test_what_is_no_regular_file_is_refused_at_once(
    path_named: Callable[[str], Path], reader: str, kind: str
) -> None:
    name, read = READERS[reader]
    make, message = NO_FILES[kind]
    path = path_named(name)
    make(path)
    if (reader, kind) == ("profile", "missing"):
        assert read(path) == []
        return
    with pytest.raises(DataError, match=message) as caught:
        read(path)
    assert "\n" not in str(caught.value)
    assert str(path.parent) in str(caught.value)


def test_a_pipe_that_has_a_writer_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "pipe"
    os.mkfifo(path)
    reader = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
    writer = os.open(path, os.O_WRONLY)
    try:
        os.write(writer, b"data")
        with pytest.raises(DataError, match="it is a named pipe"):
            open_input(path, "text")
        assert os.read(reader, 100) == b"data"
    finally:
        os.close(writer)
        os.close(reader)


def test_a_path_that_becomes_a_pipe_while_it_is_opened_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.txt"
    path.write_text("text")
    really = os.open

    def replaced_first(name: str, flags: int) -> int:
        path.unlink()
        os.mkfifo(path)
        return really(name, flags)

    monkeypatch.setattr(os, "open", replaced_first)
    with pytest.raises(DataError, match="it is a named pipe"):
        open_input(path, "text")


def test_files_are_read_up_to_a_limit(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(bytes(100))
    assert read_input(path, "", most_bytes=100) == bytes(100)
    with pytest.raises(DataError, match=r"a.bin: it is larger than .* MiB; check that it is the"):
        read_input(path, "", most_bytes=99)
    with path.open("r+b") as file:
        file.truncate(1 << 40)  # a hole: takes no space on the disk
    with pytest.raises(DataError, match=r"cannot read curve .*: it is larger than 64 MiB"):
        read_curve(path)


@pytest.mark.parametrize("name", ["x" * 300, "a/" * 3000 + "b", "zero\0byte", ""])
def test_impossible_names_are_refused(tmp_path: Path, name: str) -> None:
    assert not exists(tmp_path / name / "missing")
    with pytest.raises(DataError, match="cannot read text "):
        read_input(tmp_path / name, "text")


def test_text_must_be_utf_8(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_bytes("Größe".encode("latin-1"))
    with pytest.raises(DataError, match=r"cannot read curve .*a.txt: it is not a text file; hint"):
        read_input_text(path, "curve", hint="hint")


@pytest.mark.parametrize("read", [load_scene, load_sensor, ExposureTable.load])
def test_an_error_of_a_file_is_one_visible_line_whatever_its_keys_are(
    tmp_path: Path, read: Callable[[Path], object]
) -> None:
    """Keys of JSON may hold line breaks and commands for a terminal."""
    file = tmp_path / "a.json"
    file.write_text(json.dumps({"a\nb\x1b[31m\u202e": [{"a\nb": 1}]}))
    with pytest.raises(DataError) as caught:
        read(file)
    assert str(caught.value).isprintable()
    error = DataError("a\nb", hint="c\x07")
    assert (error.what, error.hint, str(error)) == (r"a\nb", r"c\x07", r"a\nb; c\x07")
