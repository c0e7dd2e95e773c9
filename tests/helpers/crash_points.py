"""Kill a process at each of its file operations, and drop what was not synchronised to disk.

`run` forks, traces the child (ptrace, with a seccomp filter so that only file operations stop it),
counts every system call that changes something below one folder, and kills the child right before
operation number `die_at`.  It sees what any library does: libtiff and OpenEXR included.

A power failure loses more than a kill does.  `PowerLoss` follows the operations and rebuilds the
folder as a file system may leave it: of a file what its last fsync found, of a directory the
entries that its own last fsync found; and of everything later nothing, or any part in any order.

Linux on x86-64 only.
"""

from __future__ import annotations

import ctypes
import os
import random
import re
import shutil
import signal
import stat
import struct
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

_PTRACE_TRACEME, _PTRACE_CONT, _PTRACE_SETOPTIONS = 0, 7, 0x4200
_PTRACE_GETEVENTMSG, _PTRACE_GET_SYSCALL_INFO = 0x4201, 0x420E
_OPTIONS = 0x2 | 0x4 | 0x8 | 0x80 | 0x100000  # fork, vfork, clone, seccomp, kill on exit
_EVENT_SECCOMP = 7
_PR_SET_NO_NEW_PRIVS, _PR_SET_SECCOMP, _SECCOMP_MODE_FILTER = 38, 22, 2
_AUDIT_ARCH_X86_64 = 0xC000003E
_ALLOW, _TRACE = 0x7FFF0000, 0x7FF00000
_AT_FDCWD = -100
_O_ACCMODE, _O_CREAT, _O_TRUNC = 0o3, 0o100, 0o1000

#: System calls by number: what they do, and which arguments hold (descriptor, path) pairs.
_CALLS: dict[int, tuple[str, tuple[tuple[int | None, int | None], ...]]] = {
    1: ("write", ((0, None),)),
    18: ("write", ((0, None),)),
    20: ("write", ((0, None),)),
    296: ("write", ((0, None),)),
    328: ("write", ((0, None),)),
    40: ("write", ((0, None),)),
    326: ("write", ((2, None),)),
    285: ("write", ((0, None),)),
    77: ("truncate", ((0, None),)),
    76: ("truncate", ((None, 0),)),
    74: ("fsync", ((0, None),)),
    75: ("fsync", ((0, None),)),
    2: ("open", ((None, 0),)),
    257: ("open", ((0, 1),)),
    85: ("open", ((None, 0),)),
    82: ("rename", ((None, 0), (None, 1))),
    264: ("rename", ((0, 1), (2, 3))),
    316: ("rename", ((0, 1), (2, 3))),
    86: ("link", ((None, 0), (None, 1))),
    265: ("link", ((0, 1), (2, 3))),
    87: ("unlink", ((None, 0),)),
    263: ("unlink", ((0, 1),)),
    84: ("rmdir", ((None, 0),)),
    83: ("mkdir", ((None, 0),)),
    258: ("mkdir", ((0, 1),)),
}
_OPEN_FLAGS = {2: 1, 257: 2}
_BLOCK = 64
"""Bytes of a file that are on disk together; less than a sector: the files of tests are small."""


class _Filter(ctypes.Structure):
    _fields_ = (
        ("code", ctypes.c_ushort),
        ("jt", ctypes.c_ubyte),
        ("jf", ctypes.c_ubyte),
        ("k", ctypes.c_uint),
    )


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("filter", ctypes.POINTER(_Filter)))


_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]
_libc.ptrace.restype = ctypes.c_long


@dataclass(frozen=True)
class Operation:
    """One system call about to change something below the folder; paths are absolute."""

    name: str
    path: str
    target: str | None = None


@dataclass
class Outcome:
    """How the child ended: `status` is its exit status, None if it was killed at `die_at`."""

    status: int | None
    operations: list[Operation] = field(default_factory=list)


def is_possible() -> bool:
    """Return whether this machine can trace file operations."""
    return os.name == "posix" and os.uname().sysname == "Linux" and os.uname().machine == "x86_64"


def run(
    body: Callable[[], int],
    folder: Path,
    *,
    die_at: int | None = None,
    before: Callable[[Operation], None] = lambda _: None,
) -> Outcome:
    """Run `body` in a forked child and kill it before its file operation number `die_at`.

    Args:
        body: returns the child's exit status; standard output and error go nowhere
        folder: operations below it count, from 0
        die_at: None: let the child finish
        before: called with each operation while the child is stopped right before it
    """
    pid = os.fork()
    if pid == 0:
        _child(body)
    outcome = Outcome(None)
    os.waitpid(pid, 0)
    _ptrace(_PTRACE_SETOPTIONS, pid, _OPTIONS)
    _ptrace(_PTRACE_CONT, pid, 0)
    while True:
        tid, status = os.waitpid(-1, 0x40000000)  # __WALL: threads, too
        if os.WIFEXITED(status) or os.WIFSIGNALED(status):
            if tid == pid:
                if os.WIFEXITED(status):
                    outcome.status = os.WEXITSTATUS(status)
                return outcome
            continue
        event, delivered = status >> 16, os.WSTOPSIG(status)
        if event == _EVENT_SECCOMP:
            operation = _operation(tid, str(folder))
            if operation is not None:
                if len(outcome.operations) == die_at:
                    os.kill(pid, signal.SIGKILL)
                    continue
                before(operation)
                outcome.operations.append(operation)
            delivered = 0
        elif event or delivered in (signal.SIGTRAP, signal.SIGSTOP):
            delivered = 0
        _ptrace(_PTRACE_CONT, tid, delivered)


def _child(body: Callable[[], int]) -> None:
    status = 99
    try:
        sink = os.open(os.devnull, os.O_RDWR)
        for descriptor in (0, 1, 2):
            os.dup2(sink, descriptor)
        _libc.ptrace(_PTRACE_TRACEME, 0, None, None)
        _install_filter()
        os.kill(os.getpid(), signal.SIGSTOP)
        status = body()
    finally:
        os._exit(status)


def _install_filter() -> None:
    """Let the kernel stop the process at the calls of `_CALLS` and at no other."""
    load_number, equal, give = 0x20, 0x15, 0x06
    steps = [_Filter(load_number, 0, 0, 0)]
    left = len(_CALLS)
    for number in _CALLS:
        steps.append(_Filter(equal, left, 0, number))
        left -= 1
    steps += [_Filter(give, 0, 0, _ALLOW), _Filter(give, 0, 0, _TRACE)]
    program = _Program(len(steps), (_Filter * len(steps))(*steps))
    if _libc.prctl(_PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0) or _libc.prctl(
        _PR_SET_SECCOMP, _SECCOMP_MODE_FILTER, ctypes.byref(program), 0, 0
    ):
        raise OSError(ctypes.get_errno(), "cannot install the seccomp filter")


def _ptrace(request: int, tid: int, data: int) -> None:
    if _libc.ptrace(request, tid, None, data) < 0 and ctypes.get_errno() != 3:  # ESRCH: it died
        raise OSError(ctypes.get_errno(), f"ptrace request {request:#x}")


def _operation(tid: int, folder: str) -> Operation | None:
    """Return the call that a stopped thread is about to make; None if it changes nothing here."""
    info = ctypes.create_string_buffer(96)
    size = ctypes.c_void_p(len(info))
    if _libc.ptrace(_PTRACE_GET_SYSCALL_INFO, tid, size, ctypes.addressof(info)) < 0:
        return None
    number, *arguments = struct.unpack_from("<7Q", info.raw, 24)
    name, places = _CALLS[number]
    if name == "open" and number in _OPEN_FLAGS:
        flags = arguments[_OPEN_FLAGS[number]]
        if flags & _O_ACCMODE == 0 or not flags & (_O_CREAT | _O_TRUNC):
            return None
    paths = [_path(tid, arguments, place) for place in places]
    if not any(path == folder or path.startswith(folder + "/") for path in paths):
        return None
    truncates = number == 85 or (name == "open" and arguments[_OPEN_FLAGS[number]] & _O_TRUNC)
    if name == "open" and not truncates and Path(paths[0]).exists():
        return None
    return Operation(name, *paths)


def _path(tid: int, arguments: list[int], place: tuple[int | None, int | None]) -> str:
    descriptor, name = place
    base = Path(f"/proc/{tid}/cwd")
    if descriptor is not None:
        number = ctypes.c_int(arguments[descriptor]).value
        if number != _AT_FDCWD:
            base = Path(f"/proc/{tid}/fd/{number}")
    try:
        start = base.readlink()
    except OSError:
        return ""
    if name is None:
        return str(start)
    path = start / os.fsdecode(_string(tid, arguments[name]))
    return str(path.parent.resolve() / path.name)


def _string(tid: int, address: int) -> bytes:
    with Path(f"/proc/{tid}/mem").open("rb", buffering=0) as memory:
        memory.seek(address)
        found = b""
        while b"\0" not in found:
            found += memory.read(min(256, 4096 - (address + len(found)) % 4096))
    return found[: found.index(b"\0")]


@dataclass
class _File:
    """A file with content: where its bytes are kept, and those that are on disk for certain."""

    backup: Path
    synced: bytes = b""


@dataclass(frozen=True)
class _Change:
    """A change of the entries of one directory that no fsync has brought to disk."""

    operation: Operation
    inode: int | None  # of the file; None: of a directory


class PowerLoss:
    """Follows the operations of a process and knows what of its folder would outlive a power cut.

    Args:
        folder: as it is before the process starts; all that is there counts as synchronised
        backups: an empty folder on the same file system, for the bytes of files
    """

    def __init__(self, folder: Path, backups: Path) -> None:
        self._folder, self._backups = folder, backups
        self._files: dict[int, _File] = {}
        self._on_disk: dict[str, int | None] = {}  # entry -> inode of a file, None: a directory
        self._pending: list[_Change] = []
        self._made: Operation | None = None  # its file is there once the operation was made
        self._seen = 0
        for path in [folder, *folder.rglob("*")] if folder.exists() else []:
            self._on_disk[str(path)] = None if path.is_dir() else self._keep(path)
        for path_name, inode in self._on_disk.items():
            if inode is not None:
                self._files[inode].synced = Path(path_name).read_bytes()

    def before(self, operation: Operation) -> None:
        """Take note of an operation that is about to happen."""
        self._note_made()
        path = Path(operation.path)
        for each in (operation.path, operation.target):
            if each and Path(each).is_file() and not Path(each).is_symlink():
                self._keep(Path(each))
        if operation.name == "fsync":
            if path.is_dir():
                self._sync_folder(path)
            elif path.is_file():
                self._files[path.stat().st_ino].synced = path.read_bytes()
        elif operation.name in ("rename", "link", "unlink", "rmdir"):
            inode = path.stat().st_ino if path.is_file() else None
            self._pending.append(_Change(operation, inode))
        elif operation.name == "mkdir":
            self._pending.append(_Change(operation, None))
        elif operation.name == "open" and not path.exists():
            self._made = operation
        elif operation.name in ("open", "truncate") and path.is_file():
            self._files[path.stat().st_ino].synced = b""  # that it is empty may be on disk first

    def strike(
        self, into: Path | None = None, rng: random.Random | None = None, *, torn: bool = True
    ) -> None:
        """Leave the folder as a power cut at this moment may leave it.

        Args:
            into: where that is written; None: the folder itself
            rng: chooses which changes that were not synchronised are on disk nevertheless, each by
                itself, so in any order; None: none of them is
            torn: with `rng`, blocks of a file are on disk or not by themselves, too
        """
        self._note_made()
        entries = dict(self._on_disk)
        for change in self._pending:
            if rng is not None and rng.random() < 0.5:
                _apply(change, entries)
        contents = {
            name: None if inode is None else self._bytes(inode, rng, torn=torn)
            for name, inode in entries.items()
        }
        target = into or self._folder
        if target.exists():
            shutil.rmtree(target)
        for name in sorted(contents):
            data, path = contents[name], target / Path(name).relative_to(self._folder)
            if not path.parent.exists():
                continue  # its folder was not on disk
            if data is None:
                path.mkdir()
            else:
                path.write_bytes(data)

    def _note_made(self) -> None:
        """Keep the file that the operation before has made."""
        made, self._made = self._made, None
        if made is not None and Path(made.path).is_file():
            self._pending.append(_Change(made, self._keep(Path(made.path))))

    def _keep(self, path: Path) -> int:
        """Hold on to the bytes of a file, whatever happens to its name."""
        inode = path.stat().st_ino
        if inode not in self._files:
            self._seen += 1
            backup = self._backups / str(self._seen)
            os.link(path, backup)
            self._files[inode] = _File(backup)
        return inode

    def _bytes(self, inode: int, rng: random.Random | None, *, torn: bool) -> bytes:
        """Return what is on disk of a file: what was synchronised, and, with `rng`, some later."""
        file = self._files[inode]
        synced, latest = file.synced, file.backup.read_bytes()
        if rng is None or synced == latest:
            return synced
        if not torn:
            return rng.choice((synced, latest))
        length = rng.choice((len(synced), len(latest)))
        old, new = synced.ljust(length, b"\0"), latest.ljust(length, b"\0")
        blocks = range(0, length, _BLOCK)
        return b"".join(rng.choice((old, new))[at : at + _BLOCK] for at in blocks)[:length]

    def _sync_folder(self, folder: Path) -> None:
        """Make the entries of one directory those that it has now."""
        self._pending = [each for each in self._pending if not _is_in(each, folder)]
        for name in [name for name in self._on_disk if Path(name).parent == folder]:
            if not os.path.lexists(name):
                for lost in [n for n in self._on_disk if n == name or n.startswith(name + "/")]:
                    del self._on_disk[lost]
        for entry in os.scandir(folder):
            mode = entry.stat(follow_symlinks=False).st_mode
            if stat.S_ISDIR(mode):
                self._on_disk.setdefault(entry.path, None)
            elif stat.S_ISREG(mode):
                self._on_disk[entry.path] = self._keep(Path(entry.path))


def _is_in(change: _Change, folder: Path) -> bool:
    """Return whether a change is one of a directory's entries; a rename is within one directory."""
    return Path(change.operation.path).parent == folder


def _apply(change: _Change, entries: dict[str, int | None]) -> None:
    """Make a change among the entries on disk, where what it needs is there."""
    operation = change.operation
    if operation.name in ("unlink", "rmdir"):
        entries.pop(operation.path, None)
    elif operation.name == "rename":
        assert operation.target is not None
        if operation.path in entries:  # else the change that made the name is not on disk
            entries[operation.target] = entries.pop(operation.path)
    elif operation.name == "link":
        assert operation.target is not None
        entries[operation.target] = change.inode
    else:
        entries[operation.path] = change.inode


Kind: TypeAlias = tuple[str, str]
"""Name of an operation, and of its file with 0 for each number."""

SHARE = 3
"""Of the kinds that are swept in another scenario one in so many is a crash point."""


def kinds(operations: Sequence[Operation]) -> dict[Kind, int]:
    """Return the number of the first operation of each kind on each kind of file."""
    found: dict[Kind, int] = {}
    for number, operation in enumerate(operations):
        file = re.sub(r"[0-9]+", "0", Path(operation.path).name)
        found.setdefault((operation.name, file), number)
    return found


def points(
    operations: Sequence[Operation], *, every: bool, known: Collection[Kind] = ()
) -> list[int]:
    """Return the numbers of the operations before which the process is killed, and of the end.

    They are all operations, or one of each kind; of `known` kinds one in `SHARE`.
    """
    first = kinds(operations)
    shared = [kind for kind in first if kind in known]
    left_out = set(shared) - set(shared[::SHARE])
    chosen = [number for kind, number in first.items() if kind not in left_out]
    return [*(range(len(operations)) if every else chosen), len(operations)]
