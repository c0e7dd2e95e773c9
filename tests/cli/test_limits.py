"""Commands without what they need of the system: streams, folders, HOME, files, memory, names."""

from __future__ import annotations

import ctypes
import errno
import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce
from importlib import import_module
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
import tifffile
from command_line import Run
from crash_sweep import checked, damaged

from camctl.errors import CameraDisconnectedError, RefusedSettingError

SHOOT = ("shoot", "--size", "24x16", "--ratios", "1,8", "--base", "0.03", "-o", "out")
UNKNOWN = ("--scene", "uniform", "-n", "2", "--range", "5")
"""Exposures that are not in the built-in table."""

RESUME = "go on with: camctl shoot --resume out"
PR_CAPBSET_DROP, CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH = 24, 1, 2


@dataclass(frozen=True)
class Ended:
    """A process of camctl that has ended."""

    status: int
    out: str
    err: str

    def check_one_line(self, status: int) -> str:
        """Return the one line on standard error of a failure; it is no internal error."""
        assert self.status == status, self
        assert self.err.startswith("camctl: "), self
        assert self.err.count("\n") == 1, self
        assert "internal error" not in self.err
        return self.err.removeprefix("camctl: ").rstrip("\n")


def camctl(
    folder: Path,
    *arguments: str | bytes | Path,
    shell: str = "",
    limits: Mapping[int, int] | None = None,
    module: Sequence[str] = ("-m", "camctl"),
    obeys_permissions: bool = False,
    environment: Mapping[str, str | None] | None = None,
) -> Ended:
    """Run camctl in a process of its own.

    Args:
        folder: the working directory
        arguments: the command line
        shell: redirections, as in a shell
        limits: of resources, by RLIMIT_*
        module: how Python starts camctl
        obeys_permissions: root, too, gets only what the permissions of files allow
        environment: changes of the environment; None removes a variable
    """

    def prepare() -> None:
        for number, limit in (limits or {}).items():
            resource.setrlimit(number, (limit, limit))
        for capability in (CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH) if obeys_permissions else ():
            assert ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, capability, 0, 0, 0) == 0

    variables = {**os.environ, **(environment or {})}
    line = [sys.executable, *module, *arguments]
    done = subprocess.run(
        ["/bin/sh", "-c", f'exec "$@" {shell}', "sh", *line] if shell else line,
        cwd=folder,
        capture_output=True,
        preexec_fn=prepare,
        env={name: value for name, value in variables.items() if value is not None},
        check=False,
    )
    return Ended(done.returncode, done.stdout.decode(), done.stderr.decode())


@pytest.fixture
def room(tmp_path: Path) -> Path:
    """An empty folder."""
    folder = tmp_path / "room"
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
    ("solve -n 1 --curve no", "2>&-", 1, ""),
    ("solve -n 99", "2>&-", 2, ""),
    ("solve -n 99", "2>/dev/full", 2, ""),
    ("solve -n 99", ">&- 2>&-", 2, ""),
    ("solve -n 99", "<&- >&- 2>&-", 2, ""),
    ("solve -n 1", "2>&-", 0, ""),
    (" ".join(SHOOT), "<&- 2>&-", 0, ""),
    (" ".join(SHOOT), ">&- 2>/dev/full", 1, ""),
]


@pytest.mark.parametrize(("line", "shell", "status", "message"), STREAMS)
def test_closed_and_full_streams(
    room: Path, line: str, shell: str, status: int, message: str
) -> None:
    ended = camctl(room, *line.split(), shell=shell)
    if message:
        assert ended.check_one_line(status).startswith(message)
    else:
        assert (ended.status, ended.err) == (status, "")
    if line.startswith("shoot"):
        assert damaged(room / "out") == []
        assert (room / "out/sum.tiff").exists()


def test_reader_that_leaves_early_is_no_error(room: Path) -> None:
    """As with `| head -1`."""
    ended = camctl(room, *SHOOT, shell="2>err | head -1")
    assert ended.out.startswith("camera ")
    assert ended.out.count("\n") == 1
    assert (room / "err").read_text() == ""
    assert damaged(room / "out") == []


def long_name(suffix: str = "") -> str:
    """Return a path of 5,000 characters."""
    return "a" * (5000 - len(suffix)) + suffix


@pytest.mark.parametrize(
    "line",
    [
        "shoot --scene {}.hdr",
        "shoot --sensor {}.json",
        "shoot --table {}",
        "shoot -o {} --size 24x16",
        "shoot --resume {}",
        "simulate --size 24x16 -o {}.tiff",
        "solve --curve {}",
        "solve --settings {}",
        "solve --desired {}",
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
    ("shoot --size 24x16 --table bad.json", "bad.json"),
    ("shoot --desired bad.txt", "bad.txt"),
    ("simulate --scene bad.exr", "bad.exr"),
    ("solve --curve bad.txt", "bad.txt"),
    ("solve --settings bad.txt", "bad.txt"),
    ("solve --desired bad.txt", "bad.txt"),
    ("evaluate --ratios 1,2 --curve bad.txt", "bad.txt"),
    ("table show --table bad.json", "bad.json"),
]
"""Command lines, and the file that each reads."""


@pytest.mark.parametrize(("line", "name"), UNREADABLE)
def test_folder_in_place_of_a_file_is_one_line(run: Run, line: str, name: str) -> None:
    Path(name).mkdir()
    ran = run(*line.split())
    assert ran.status == 1
    assert name in ran.error
    assert "internal error" not in ran.error


def test_file_without_permission_is_one_line(room: Path) -> None:
    for _, name in UNREADABLE:
        (room / name).touch(mode=0)
    code = (
        "import sys; from camctl.cli import main; "
        "print(*(main(line.split()) for line in sys.argv[1:]))"
    )
    lines = [line for line, _ in UNREADABLE]
    ended = camctl(room, "-c", code, *lines, module=(), obeys_permissions=True)
    assert ended.out.split() == ["1"] * len(lines)
    for (_, name), error in zip(UNREADABLE, ended.err.splitlines(), strict=True):
        assert re.fullmatch(rf"camctl: .*{name}.*permission.*", error, re.IGNORECASE), error


NO_RIGHTS = {"CAMCTL_CACHE": None, "CAMCTL_PROFILES": None, "XDG_CACHE_HOME": None}
"""Environment in which cache and profiles are in HOME."""


@pytest.mark.parametrize("home", [None, "", "/dev/null", "/nonexistent", "/proc"])
def test_home_that_cannot_be_used(room: Path, home: str | None) -> None:
    variables = {**NO_RIGHTS, "XDG_DATA_HOME": None, "HOME": home}
    (room / "here").mkdir()
    line = ("shoot", *UNKNOWN, *SHOOT[1:3], "--base", "0.01", "-o", "out")
    ended = camctl(room / "here", *line, obeys_permissions=True, environment=variables)
    assert (ended.status, ended.err) == (0, "")
    assert [path.name for path in (room / "here").iterdir()] == ["out"]


def test_home_without_permission(room: Path) -> None:
    """It may hold the camera's profile, which must not be left out silently."""
    (room / "home").mkdir(mode=0)
    variables = {**NO_RIGHTS, "XDG_DATA_HOME": None, "HOME": str(room / "home")}
    ended = camctl(room, *SHOOT, obeys_permissions=True, environment=variables)
    message = ended.check_one_line(1)
    assert message.startswith(f"cannot read {room / 'home'}")
    assert message.endswith("or set $CAMCTL_PROFILES to another folder")


def test_folder_that_cannot_be_written(room: Path) -> None:
    room.chmod(0o555)
    ended = camctl(room, *SHOOT, obeys_permissions=True)
    assert ended.check_one_line(1).startswith("cannot write out: no permission to write; choose")
    line = ("simulate", "--size", "24x16", "-o", "frame.png")
    assert "no permission" in camctl(room, *line, obeys_permissions=True).check_one_line(1)


@pytest.mark.parametrize(
    "line",
    ["shoot --size 24x16", "shoot --scene x.hdr", "solve --curve x", "solve --settings x.txt"],
)
def test_working_directory_that_was_deleted(room: Path, line: str) -> None:
    gone = room / "gone"
    gone.mkdir()
    command = f"rmdir ../gone && exec {sys.executable} -m camctl {line}"
    done = subprocess.run(
        ["/bin/sh", "-c", command], cwd=gone, capture_output=True, text=True, check=False
    )
    Ended(done.returncode, done.stdout, done.stderr).check_one_line(1)


@pytest.mark.parametrize("files", [12])
def test_few_open_files_suffice(room: Path, files: int) -> None:
    ended = camctl(room, *SHOOT, limits={resource.RLIMIT_NOFILE: files})
    assert (ended.status, ended.err) == (0, "")


@pytest.mark.parametrize("files", [5, 6, 7, 9])
def test_too_few_open_files(room: Path, files: int) -> None:
    """Below about 5 not even Python starts."""
    ended = camctl(room, *SHOOT, limits={resource.RLIMIT_NOFILE: files})
    if ended.status == 0:
        assert damaged(room / "out") == []
    elif ended.err.startswith("camctl: "):
        assert re.search("too many (open files|files are open)", ended.check_one_line(1))
    else:
        assert files <= 5


#: A frame has 38,528 bytes, the sum 77,056, and the EXR file about 83,000.
SIZES = ("--size", "240x160", *SHOOT[3:])


@pytest.mark.parametrize(
    ("limit", "file", "kept"),
    [(30_000, "frame-01.npy", 0), (60_000, "sum.tiff", 2), (80_000, "radiance.exr", 2)],
)
def test_limit_of_file_sizes(room: Path, limit: int, file: str, kept: int) -> None:
    ended = camctl(room, "shoot", *SIZES, limits={resource.RLIMIT_FSIZE: limit})
    message = ended.check_one_line(1)
    assert message.endswith(f"{kept} of 2 frames are kept; go on with: camctl shoot --resume out")
    assert file in message
    assert "raise the limit" in message
    assert damaged(room / "out") == []
    resumed = camctl(room, "shoot", "--resume", "out")
    assert (resumed.status, resumed.err) == (0, "")


@pytest.mark.parametrize(
    ("size", "megabytes", "message"),
    [
        ("24x16", 200, "not enough memory to load a library; "),
        pytest.param(
            "6000x4000", 1500, "not enough memory for an array of ", marks=pytest.mark.slow
        ),
    ],
)
def test_limit_of_memory(room: Path, size: str, megabytes: int, message: str) -> None:
    limits = {resource.RLIMIT_AS: megabytes << 20}
    line = ("shoot", "--size", size, *SHOOT[3:])
    ended = camctl(room, *line, limits=limits, environment={"OPENBLAS_NUM_THREADS": "1"})
    assert ended.check_one_line(1).startswith(message)
    if (room / "out").exists():
        assert damaged(room / "out") == []
        assert ended.err.endswith(f"frames are kept; {RESUME}\n")


def array_too_large() -> MemoryError:
    """Return the error of numpy for an array that cannot be allocated."""
    with pytest.raises(MemoryError) as caught:
        np.empty((1 << 20, 1 << 35))
    return caught.value


def no_memory_in_opencv() -> cv2.error:
    error = cv2.error("OpenCV: Failed to allocate 1 bytes")
    error.code = -4
    return error


def no_memory_in_the_c_library() -> cv2.error:
    """Return what OpenCV raises, as seen with ulimit -v 600000, while it measures text."""
    return cv2.error("std::bad_alloc")


FRAME = "sim.camera:SimulatedCamera._counted_frame"
SUM = "camctl.captures.sequence:Accumulator.accumulate"
PREVIEW = "camctl.captures.picture_files:png"
DISK_FULL = OSError(errno.ENOSPC, "No space left on device")
UNPLUGGED = CameraDisconnectedError("the camera was unplugged", hint="plug it in again")
REFUSED = RefusedSettingError("time_s", 1.0, 0.5)


def call_first(monkeypatch: pytest.MonkeyPatch, point: str, action: Callable[[], object]) -> None:
    """Call `action` before a call of "module:function": the second of those of each frame."""
    module, _, path = point.partition(":")
    *names, last = path.split(".")
    owner = reduce(getattr, names, import_module(module))
    function = getattr(owner, last)
    calls: list[object] = []

    def call(*arguments: Any, **named: Any) -> Any:
        calls.append(arguments)
        if len(calls) == (2 if point in (FRAME, SUM) else 1):
            action()
        return function(*arguments, **named)

    monkeypatch.setattr(owner, last, call)


@pytest.mark.parametrize(
    ("point", "error", "kept", "message"),
    [
        (FRAME, UNPLUGGED, 1, "the camera was unplugged; plug it in again"),
        (FRAME, REFUSED, 1, "the camera cannot set time_s to 1; the nearest it can do is 0.5"),
        (FRAME, ValueError("odd"), 1, "internal error: ValueError: odd"),
        (SUM, MemoryError(), 2, "not enough memory; choose a smaller picture"),
        (SUM, array_too_large(), 2, "not enough memory for an array of 2.68e+08 GiB"),
        (PREVIEW, no_memory_in_opencv(), 2, "not enough memory for a picture"),
        (PREVIEW, no_memory_in_the_c_library(), 2, "not enough memory for a picture"),
        (PREVIEW, RuntimeError("can't start new thread"), 2, "the system starts no more threads"),
        ("tifffile:imwrite", DISK_FULL, 2, "cannot write out/sum.tiff: the disk is full"),
        ("camctl.captures.sequence:complete", KeyboardInterrupt(), 2, "interrupted"),
    ],
)
def test_failure_after_the_first_frame_says_how_to_resume(
    run: Run,
    monkeypatch: pytest.MonkeyPatch,
    point: str,
    error: BaseException,
    kept: int,
    message: str,
) -> None:

    def fail() -> None:
        raise error

    call_first(monkeypatch, point, fail)
    ran = run(*SHOOT)
    assert ran.status == (130 if isinstance(error, KeyboardInterrupt) else 1)
    assert ran.error.startswith(message)
    assert f"; {kept} of 2 frames are kept; {RESUME}" in ran.error
    folder = Path("out").absolute()
    monkeypatch.undo()  # the working folder, too
    assert checked(folder)["wrong"] == []


@pytest.mark.parametrize("name", [b"out\xff", "été\u202e".encode(), b"two\nlines\x1b[31m"])
def test_any_bytes_name_a_folder(room: Path, name: bytes) -> None:
    ended = camctl(room, *SHOOT[:-1], name)
    assert (ended.status, ended.err) == (0, "")
    assert damaged(room / os.fsdecode(name)) == []
    assert all(character.isprintable() for line in ended.out.splitlines() for character in line)
    assert camctl(room, *SHOOT[:-1], name, "--force", "--json").status == 0


@pytest.mark.parametrize("suffix", [".hdr", ".exr", ".tiff", ".npy"])
def test_any_bytes_name_a_scene(room: Path, suffix: str) -> None:
    values = np.linspace(0.1, 10, 16 * 24, dtype=np.float32).reshape(16, 24)
    name = b"s\xff" + suffix.encode()
    write_map(room / f"map{suffix}", values)
    (room / f"map{suffix}").rename(room / os.fsdecode(name))
    ended = camctl(room, "simulate", "--scene", name)
    assert (ended.status, ended.err) == (0, "")


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


@pytest.mark.parametrize("point", [FRAME, "tifffile:imwrite", PREVIEW])
def test_folder_that_is_removed_meanwhile(
    run: Run, monkeypatch: pytest.MonkeyPatch, point: str
) -> None:
    call_first(monkeypatch, point, lambda: shutil.rmtree("out"))
    ran = run(*SHOOT)
    assert ran.status == 1
    assert ran.error.startswith("cannot write out")
    assert ran.error.endswith("out was removed meanwhile, and the frames with it; shoot again")
    assert run(*SHOOT).status == 0


def test_damaged_cached_exposures_are_set_aside_with_a_warning(run: Run, tmp_path: Path) -> None:
    line = ("shoot", *UNKNOWN, "--size", "24x16", "--base", "0.01", "-o")
    assert run(*line, "first").err == ""
    (path,) = (tmp_path / "cache").rglob("*.json")
    path.write_text("{")
    ran = run(*line, "second")
    assert ran.status == 0
    assert ran.err.startswith(f"camctl: warning: cached exposures {path} are damaged: ")
    assert ran.err.endswith(f"; set aside as {path.name}.damaged, and computed again\n")
    assert ran.err.count("\n") == 1
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
