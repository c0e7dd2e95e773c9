"""Commands without what they need of the system: streams, folders, HOME, files, memory, names."""

from __future__ import annotations

import errno
import io
import os
import re
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from camctl_process import SHOOT, Ended, camctl
from command_line import Run
from crash_sweep import damaged

from camctl.cli.output import print_text
from camctl.errors import StorageError

UNKNOWN = ("--scene", "uniform", "-n", "2", "--range", "5")
"""Exposures that are not in the built-in table."""


SEVERAL = (
    "import sys; from camctl.cli import main; print(*(main(line.split()) for line in sys.argv[1:]))"
)
"""A program that runs each argument as a command line, and prints the statuses."""

SLOW = pytest.mark.slow  # each is a process, half a second of processor time or more


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """An empty folder."""
    folder = tmp_path / "empty"
    folder.mkdir()
    return folder


STREAMS = [
    ("solve -n 1", ">&-", 1, "cannot write to standard output: it is closed; redirect"),
    ("solve -n 1 --json", ">&-", 1, "cannot write to standard output: it is closed; redirect"),
    ("solve -n 1", ">/dev/full", 1, "cannot write to standard output: no space left on device"),
    ("--help", ">/dev/full", 1, "cannot write to standard output: no space left on device"),
    ("-V", ">&-", 1, "cannot write to standard output: it is closed"),
    (
        " ".join(SHOOT),
        ">&-",
        1,
        "cannot write to standard output: it is closed; the capture in out",
    ),
    (" ".join(SHOOT), ">/dev/full", 1, "cannot write to standard output: no space left on device"),
    ("solve -n 99", ">&-", 2, "invalid value for --exposures: 99"),
    ("solve -n 99 --json", ">/dev/full", 2, "invalid value for --exposures: 99"),
    ("solve -n 1 --curve no", "2>&-", 2, ""),
    ("solve -n 99", "2>&-", 2, ""),
    ("solve -n 99", "2>/dev/full", 2, ""),
    ("solve -n 99", ">&- 2>&-", 2, ""),
    ("solve -n 99", "<&- >&- 2>&-", 2, ""),
    ("solve -n 1", "2>&-", 0, ""),
    (" ".join(SHOOT), "<&- 2>&-", 0, ""),
    (" ".join(SHOOT), ">&- 2>/dev/full", 1, ""),
]


IN_SLOW_TESTS = {0, 1, 2, 4, 6, 8, 9, 10, 11, 13, 14, 15, 16}
"""Places in `STREAMS` of lines that differ from another one in a stream or the command alone."""


@pytest.mark.parametrize(
    ("line", "shell", "status", "message"),
    [
        pytest.param(*each, marks=SLOW if place in IN_SLOW_TESTS else ())
        for place, each in enumerate(STREAMS)
    ],
)
def test_closed_and_full_streams(
    folder: Path, line: str, shell: str, status: int, message: str
) -> None:
    ended = camctl(folder, *line.split(), shell=shell)
    if message:
        assert ended.check_one_line(status).startswith(message)
    else:
        assert (ended.status, ended.err) == (status, "")
    if line.startswith("shoot"):
        assert damaged(folder / "out") == []
        assert (folder / "out/sum.tiff").exists()


@SLOW
def test_reader_that_leaves_early_is_no_error(folder: Path) -> None:
    """As with `| head -1`."""
    ended = camctl(folder, *SHOOT, shell="2>err | head -1")
    assert ended.out.startswith("camera ")
    assert ended.out.count("\n") == 1
    assert (folder / "err").read_text() == ""
    assert damaged(folder / "out") == []


def long_name(suffix: str = "") -> str:
    """Return a path of 5,000 characters."""
    return "a" * (5000 - len(suffix)) + suffix


@pytest.mark.parametrize(
    "line",
    [
        "shoot --scene {}.hdr",
        "shoot --sensor {}.json",
        "shoot --set table={}",
        "shoot -o {} -O size=24x16",
        "resume {}",
        "simulate --size 24x16 -o {}.tiff",
        "solve --curve {}",
        "solve --settings {}",
        "solve --response ./{}",
        "table show --table {}",
        "table build -n 1 --bits 3 -o {}",
        "evaluate --ratios 1,2 --curve {}",
        "profile show {}",
    ],
)
def test_name_of_5000_characters_is_refused_in_one_line(run: Run, line: str) -> None:
    words = [word.replace("{}", long_name()) for word in line.split()]
    ran = run(*words)
    assert ran.status in (1, 2)
    assert "internal error" not in ran.error
    assert len(ran.err) < 400
    assert "aaa...aaa" in ran.err


UNREADABLE = [
    *((f"shoot --scene bad{suffix}", f"bad{suffix}") for suffix in (".hdr", ".exr")),
    *((f"shoot --scene bad{suffix}", f"bad{suffix}") for suffix in (".tiff", ".npy")),
    ("shoot --sensor bad.json", "bad.json"),
    ("shoot -O size=24x16 --set table=bad.json", "bad.json"),
    ("shoot --response bad.txt", "bad.txt"),
    ("simulate --scene bad.exr", "bad.exr"),
    ("solve --curve bad.txt", "bad.txt"),
    ("solve --settings bad.txt", "bad.txt"),
    ("solve --response bad.txt", "bad.txt"),
    ("evaluate --ratios 1,2 --curve bad.txt", "bad.txt"),
    ("table show --table bad.json", "bad.json"),
]
"""Command lines, and the file that each reads."""


@pytest.mark.slow
def test_file_without_permission_is_one_line(folder: Path) -> None:
    for _, name in UNREADABLE:
        (folder / name).touch(mode=0)
    lines = [line for line, _ in UNREADABLE]
    ended = camctl(folder, "-c", SEVERAL, *lines, module=(), obeys_permissions=True)
    assert ended.out.split() == ["1"] * len(lines)
    for (_, name), error in zip(UNREADABLE, ended.err.splitlines(), strict=True):
        assert re.fullmatch(rf"camctl: .*{name}.*permission.*", error, re.IGNORECASE), error


NO_RIGHTS = {"CAMCTL_CACHE": None, "CAMCTL_PROFILES": None, "XDG_CACHE_HOME": None}
"""Environment in which cache and profiles are in HOME."""


@pytest.mark.parametrize(
    "home",
    [
        "/proc",
        *(pytest.param(each, marks=SLOW) for each in ("", None, "/dev/null", "/nonexistent")),
    ],
)
def test_home_that_cannot_be_used(folder: Path, home: str | None) -> None:
    variables = {**NO_RIGHTS, "XDG_DATA_HOME": None, "HOME": home}
    (folder / "here").mkdir()
    line = ("shoot", *UNKNOWN, *SHOOT[1:3], "--base", "0.01", "-o", "out")
    ended = camctl(folder / "here", *line, obeys_permissions=True, environment=variables)
    assert (ended.status, ended.err) == (0, "")
    assert [path.name for path in (folder / "here").iterdir()] == ["out"]


@pytest.mark.slow
def test_home_without_permission(folder: Path) -> None:
    """It may hold the camera's profile, which must not be left out silently."""
    (folder / "home").mkdir(mode=0)
    variables = {**NO_RIGHTS, "XDG_DATA_HOME": None, "HOME": str(folder / "home")}
    ended = camctl(folder, *SHOOT, obeys_permissions=True, environment=variables)
    message = ended.check_one_line(1)
    assert message.startswith(f"cannot read {folder / 'home'}")
    assert "or set $CAMCTL_PROFILES to another folder" in message


def test_folder_that_cannot_be_written(folder: Path) -> None:
    folder.chmod(0o555)
    lines = (" ".join(SHOOT), "simulate --size 24x16 -o frame.png")
    ended = camctl(folder, "-c", SEVERAL, *lines, module=(), obeys_permissions=True)
    assert ended.out.split() == ["1", "1"]
    shoot, simulate = ended.err.splitlines()
    assert shoot.startswith("camctl: cannot write out: no permission to write; choose")
    assert simulate.startswith("camctl: ")
    assert "no permission" in simulate


@pytest.mark.parametrize(
    "line",
    [
        "solve --settings x",
        *(
            pytest.param(each, marks=SLOW)
            for each in ("shoot -O size=24x16", "shoot --scene x.hdr", "solve --response x.txt")
        ),
    ],
)
def test_working_directory_that_was_deleted(folder: Path, line: str) -> None:
    gone = folder / "gone"
    gone.mkdir()
    command = f"rmdir ../gone && exec {sys.executable} -m camctl {line}"
    done = subprocess.run(
        ["/bin/sh", "-c", command], cwd=gone, capture_output=True, text=True, check=False
    )
    Ended(done.returncode, done.stdout, done.stderr).check_one_line(1)


def test_few_open_files_suffice(folder: Path) -> None:
    ended = camctl(folder, *SHOOT, limits={resource.RLIMIT_NOFILE: 12})
    assert (ended.status, ended.err) == (0, "")


@SLOW
@pytest.mark.parametrize("files", [5, 6, 7, 9])
def test_too_few_open_files(folder: Path, files: int) -> None:
    """Below about 5 not even Python starts."""
    ended = camctl(folder, *SHOOT, limits={resource.RLIMIT_NOFILE: files})
    if ended.status == 0:
        assert damaged(folder / "out") == []
    elif ended.err.startswith("camctl: "):
        assert "move it away" not in ended.err  # no frame is damaged
        assert re.search("(?i)too many (open files|files are open)", ended.check_one_line(1))
    else:
        assert files <= 5


SIZES = ("-O", "size=240x160", *SHOOT[3:])


@pytest.mark.parametrize(
    ("sensor", "limit", "file", "kept"),
    [  # a frame of 8 bits has 38,528 bytes, the sum 77,056; the EXR file has more with 12 bits
        ("standard", 30_000, "frame-01.npy", 0),
        ("standard", 60_000, "sum.tiff", 2),
        ("machine-vision", 80_000, "radiance.exr", 2),
    ],
)
def test_limit_of_file_sizes(run: Run, sensor: str, limit: int, file: str, kept: int) -> None:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        ran = run("shoot", "--sensor", sensor, *SIZES)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert ran.status == 1
    assert re.search(rf"; {kept} of 2 frames are kept; .* \(camctl resume out\)$", ran.error)
    assert file in ran.error
    assert "raise the limit" in ran.error
    assert damaged(Path("out")) == []
    resumed = run("resume", "out")
    assert (resumed.status, resumed.err) == (0, "")


@pytest.mark.parametrize(
    ("size", "megabytes", "message"),
    [
        ("24x16", 200, "not enough memory to load a library; "),
        pytest.param(
            "6000x4000", 540, "not enough memory for an array of ", marks=pytest.mark.slow
        ),
    ],
)
def test_limit_of_memory(folder: Path, size: str, megabytes: int, message: str) -> None:
    limits = {resource.RLIMIT_AS: megabytes << 20}
    line = ("shoot", "-O", f"size={size}", *SHOOT[3:])
    ended = camctl(folder, *line, limits=limits, environment={"OPENBLAS_NUM_THREADS": "1"})
    assert ended.check_one_line(1).startswith(message)
    if (folder / "out").exists():
        assert damaged(folder / "out") == []
        assert ended.err.endswith(" (camctl resume out)\n")
        assert "frames are kept; " in ended.err


@pytest.mark.parametrize("name", ["out\udcff", "été\u202e", "two\nlines\x1b[31m"])
def test_any_characters_name_a_folder(run: Run, name: str) -> None:
    ran = run(*SHOOT[:-1], name)
    assert (ran.status, ran.err) == (0, "")
    assert damaged(Path(name)) == []
    assert all(character.isprintable() for line in ran.out.splitlines() for character in line)
    assert run(*SHOOT[:-1], name, "--force", "--json").status == 0


@pytest.mark.parametrize("suffix", [".hdr", ".exr", ".tiff", ".npy"])
def test_any_bytes_name_a_scene(run: Run, suffix: str) -> None:
    values = np.linspace(0.1, 10, 16 * 24, dtype=np.float32).reshape(16, 24)
    name = os.fsdecode(b"s\xff" + suffix.encode())
    write_map(Path(f"map{suffix}"), values)
    Path(f"map{suffix}").rename(name)
    ran = run("simulate", "--scene", name)
    assert (ran.status, ran.err) == (0, "")


def test_report_cannot_hold_every_name_of_a_scene(run: Run) -> None:
    """JSON is UTF-8."""
    scene = Path(os.fsdecode(b"s\xff.npy"))
    with scene.open("wb") as file:
        np.save(file, np.ones((16, 24), np.float32))
    ran = run("shoot", "--scene", scene, "-o", "out")
    assert ran.status == 2
    assert ran.error.endswith(
        r"s\xff.npy is not UTF-8, and a report cannot hold it; rename the file"
    )
    assert not Path("out").exists()


def test_damaged_cached_exposures_are_set_aside_with_a_warning(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CAMCTL_CACHE", str(tmp_path / "cache"))
    line = ("shoot", *UNKNOWN, "-O", "size=24x16", "--base", "0.01", "-o")
    assert run(*line, "first").err == ""
    paths = sorted((tmp_path / "cache").rglob("*.json"))
    assert paths
    for path in paths:
        path.write_text("{")
    ran = run(*line, "second")
    assert ran.status == 0
    warnings = ran.err.splitlines()
    assert len(warnings) == len(paths)
    for path in paths:
        (warning,) = (each for each in warnings if f" {path} are damaged; " in each)
        assert warning.startswith("camctl: warning: cached ")
        assert warning.endswith(f"; set aside as {path.name}.damaged, and computed again")
    assert run(*line, "third").err == ""


def write_map(path: Path, values: Any) -> None:
    if path.suffix == ".npy":
        np.save(path, values)
    elif path.suffix == ".tiff":
        tifffile.imwrite(path, values)
    elif path.suffix == ".exr":
        with OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": values}) as file:
            file.write(str(path))
    else:
        cv2.imwrite(str(path), np.repeat(values[..., None], 3, axis=2))


def test_a_stream_in_memory_that_cannot_be_written_is_one_error(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    class Full(io.StringIO):
        def write(self, text: str) -> int:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sys, "stdout", Full())
    with pytest.raises(StorageError, match="no space left on device"):
        print_text("anything")
