"""A virtual machine with Debian's stock kernel on this machine's own file system, for one command.

The kernel package is unpacked, not installed.  QEMU emulates the processor, so that nothing but its
binary is needed of the host: no KVM, no root.  The guest's root is the host's, read-only over 9p
under a layer of RAM: every package and virtual environment of the host is there at its own path,
and what the guest writes is lost when it ends, except in /guest_out.

The guest's clock counts instructions (1 ns each), not the time of the host: while the host does
something else the clock stands still, and while the guest is idle it jumps to the next timer.  What
runs in the guest therefore takes the same time on a busy host as on a quiet one.  One exception:
while the guest waits for a file of the host, it is idle, and the clock runs ahead.  Tests that
measure time read what they need before.
"""

from __future__ import annotations

import fcntl
import gzip
import hashlib
import lzma
import os
import platform
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import platformdirs

HERE = Path(__file__).parent
CACHE_VARIABLE = "CAMCTL_VIRTUAL_HARDWARE_CACHE"
APT_LINE = (
    "apt-get install --no-install-recommends qemu-system-x86 busybox-static kmod cpio udev"
    " libusb-1.0-0 gphoto2"
)
# Program to the Debian package that has it.
PROGRAMS = {
    "qemu-system-x86_64": "qemu-system-x86",
    "busybox": "busybox-static",
    "modprobe": "kmod",
    "depmod": "kmod",
    "cpio": "cpio",
    "apt-get": "apt",
    "dpkg": "dpkg",
}
UDEV = Path("/lib/systemd/systemd-udevd")
BOOT_MODULES = ("virtio_pci", "9pnet_virtio", "9p", "overlay")
# Calibrating the local APIC's timer and checking the clock against others takes seconds where each
# access to a device ends a block of translated code.
KERNEL_ARGUMENTS = (
    "console=ttyS0 loglevel=4 panic=-1 mitigations=off random.trust_cpu=on"
    " tsc=reliable no_timer_check nolapic_timer"
)
# The oldest processor that numpy runs on: with all that QEMU can emulate, imports take 15 % longer,
# and its AVX2 is wrong (numpy.argsort gives a wrong order, or a segmentation fault).
PROCESSOR = "Nehalem"
CLOCK_OF_INSTRUCTIONS = ("-accel", "tcg,thread=single", "-icount", "shift=0,sleep=off")
# Limits that only catch what hangs.  A boot takes 5 s of processor time, a guest with all
# tests seven minutes; a busy host makes either longer, but costs no more processor time.
BOOT_CPU_S = 60.0
BOOT_S = 600.0
BOOTS = 3
GUEST_CPU_S = 1800
DOWNLOAD_S = 240.0
PATH = os.pathsep.join((os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"))


class CannotRunError(Exception):
    """No guest can run on this machine: the reason, and what to install."""

    def __init__(self, reason: str, remedy: str) -> None:
        super().__init__(f"{reason}; {remedy}")


class GuestError(Exception):
    """The guest did not come up, exceeded a limit, or ended without an exit status."""


@dataclass(frozen=True)
class Kernel:
    """Debian's kernel package, unpacked, with the RAM disk that starts it."""

    image: Path
    modules: Path
    initrd: Path


def cache_directory() -> Path:
    """Return the folder that $CAMCTL_VIRTUAL_HARDWARE_CACHE names, else one in the user's cache."""
    named = os.environ.get(CACHE_VARIABLE)
    return (
        Path(named) if named else Path(platformdirs.user_cache_dir("camctl")) / "virtual-hardware"
    )


def prepare() -> Kernel:
    """Return a kernel to boot, from the cache or from the package archive.

    Raises:
        CannotRunError: something is missing on this machine
    """
    if sys.platform != "linux" or platform.machine() != "x86_64":
        raise CannotRunError(
            f"it needs Linux on x86-64, this is {sys.platform} on {platform.machine()}",
            "run it on such a machine",
        )
    missing = [program for program in PROGRAMS if shutil.which(program, path=PATH) is None]
    if missing:
        raise CannotRunError(f"no {', '.join(missing)}", APT_LINE)
    if not UDEV.exists():
        raise CannotRunError(f"no {UDEV}", APT_LINE)
    cache = cache_directory()
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise CannotRunError(f"{cache}: {error.strerror}", f"set {CACHE_VARIABLE}") from error
    with _locked(cache):
        try:
            root = _unpacked(cache / "kernel")
            version = next((root / "lib/modules").iterdir()).name
            image = _image(root / "boot", version)
            initrd = _initrd(root, version)
        except (subprocess.SubprocessError, OSError) as error:
            output = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
            raise CannotRunError(
                f"no kernel could be downloaded ({output[-1] if output else error})",
                "run apt-get update, with a network",
            ) from error
    return Kernel(image, root / "lib/modules", initrd)


@contextmanager
def _locked(cache: Path) -> Iterator[None]:
    with (cache / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def _run(*words: str | Path, cwd: Path | None = None) -> str:
    return subprocess.run(
        words,
        cwd=cwd,
        check=True,
        text=True,
        capture_output=True,
        timeout=DOWNLOAD_S,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "PATH": PATH, "LC_ALL": "C"},
    ).stdout


def _unpacked(root: Path) -> Path:
    """Return the folder of the unpacked kernel package; it appears there whole or not at all."""
    if root.exists():
        return root
    with tempfile.TemporaryDirectory(dir=root.parent) as scratch:
        new = Path(scratch, "kernel")
        # The package that always stands for the newest kernel depends on the one that holds it.
        depends = _run("apt-cache", "depends", "linux-image-amd64")
        found = re.search(r"Depends: (linux-image-\S+)", depends)
        if found is None:
            raise CannotRunError(
                "the package archive has no linux-image-amd64", "run it on Debian, after an update"
            )
        _run("apt-get", "download", found[1], cwd=Path(scratch))
        (package,) = Path(scratch).glob("*.deb")
        _run("dpkg", "-x", package, new)
        _run("depmod", "-b", new, next((new / "lib/modules").iterdir()).name)
        new.rename(root)
    return root


def _image(folder: Path, version: str) -> Path:
    """Return the kernel to boot: uncompressed where QEMU can start it so.

    Uncompressing it in the guest takes longer than all the rest of a boot.  The layout of a bzImage
    is in the kernel's Documentation/arch/x86/boot.rst.
    """
    packed, plain = folder / f"vmlinuz-{version}", folder / f"vmlinux-{version}"
    if plain.exists():
        return plain
    image = packed.read_bytes()
    setup_sectors, (offset, length) = image[0x1F1], struct.unpack_from("<II", image, 0x248)
    payload = image[(setup_sectors + 1) * 512 + offset :][:length]
    can_start = "CONFIG_PVH=y" in (folder / f"config-{version}").read_text()
    if not (can_start and payload.startswith(b"\xfd7zXZ")):
        return packed
    part = plain.with_suffix(".part")
    part.write_bytes(lzma.LZMADecompressor().decompress(payload))
    return part.rename(plain)


def _initrd(root: Path, version: str) -> Path:
    """Return a RAM disk with busybox, init.sh, and the modules that reach the host's files."""
    init = (HERE / "init.sh").read_bytes()
    target = root.parent / f"initrd-{version}-{hashlib.sha256(init).hexdigest()[:12]}.gz"
    if target.exists():
        return target
    with tempfile.TemporaryDirectory(dir=root.parent) as scratch:
        disk = Path(scratch, "disk")
        for folder in ("bin", "modules"):
            (disk / folder).mkdir(parents=True)
        shutil.copy(str(shutil.which("busybox", path=PATH)), disk / "bin/busybox")
        (disk / "init").write_bytes(init)
        (disk / "init").chmod(0o755)
        order: list[str] = []
        for module in BOOT_MODULES:
            shown = _run("modprobe", "-d", root, "-S", version, "--show-depends", module)
            for words in map(str.split, shown.splitlines()):
                if words[0] == "insmod" and Path(words[1]).name not in order:
                    order.append(Path(words[1]).name)
                    shutil.copy(words[1], disk / "modules")
        (disk / "modules.order").write_text("\n".join(order) + "\n")
        names = "\n".join(str(path.relative_to(disk)) for path in sorted(disk.rglob("*")))
        archive = subprocess.run(
            [str(shutil.which("cpio", path=PATH)), "-o", "-H", "newc", "--quiet"],
            input=names.encode(),
            cwd=disk,
            check=True,
            capture_output=True,
        ).stdout
        packed = Path(scratch, "initrd.gz")
        packed.write_bytes(gzip.compress(archive, 1))
        packed.rename(target)
    return target


@dataclass(frozen=True)
class Result:
    """How a command in the guest ended.

    Attributes:
        status: its exit status
        boots: how often the guest was started until it came up
        boot_s: how long the last start took, in the host's time
    """

    status: int
    boots: int
    boot_s: float


def run_in_guest(
    kernel: Kernel,
    command: Sequence[str],
    out: Path,
    *,
    environment: Mapping[str, str],
    directory: Path,
    limit_s: float,
    on_line: Callable[[str], None],
    devices: Sequence[str] = (),
) -> Result:
    """Run `command` as root in a new guest.

    Args:
        kernel: see `prepare`
        command: program and arguments
        out: folder that the guest sees as /guest_out and may write to
        environment: added to the command's
        directory: to start it in
        limit_s: the guest is ended after so many seconds of the host's time
        on_line: called with every line that the command prints, as it comes
        devices: words for QEMU that add devices

    Raises:
        GuestError: the guest did not come up, exceeded a limit, or ended without an exit status
    """
    settings = {"GUEST_MODULES": str(kernel.modules), "GUEST_DIRECTORY": str(directory)}
    exports = "".join(f"export {k}={shlex.quote(v)}\n" for k, v in environment.items())
    (out / "command.sh").write_text(f"{exports}exec {shlex.join(command)}\n")
    (out / "start.sh").write_text(
        "".join(f"{k}={shlex.quote(v)}\n" for k, v in settings.items())
        + (HERE / "start.sh").read_text()
    )
    end = time.monotonic() + limit_s
    for boots in range(1, BOOTS + 1):
        with _started([*_qemu(kernel, out), *devices]) as guest:
            began = time.monotonic()
            if not _came_up(guest, out, min(end, began + BOOT_S)):
                continue
            boot_s = time.monotonic() - began
            alarm = threading.Timer(max(0.0, end - time.monotonic()), guest.kill)
            alarm.start()
            assert guest.stdout is not None
            for text in guest.stdout:
                on_line(text.rstrip("\r\n"))
            guest.wait()
            alarm.cancel()
        try:
            return Result(int((out / "status").read_text()), boots, boot_s)
        except (OSError, ValueError):
            raise GuestError(f"the guest {_reason(guest.returncode, end)}") from None
    raise GuestError(f"the guest did not come up in {BOOTS} starts")


def _reason(status: int, end: float) -> str:
    if time.monotonic() >= end:
        return "exceeded its time limit"
    if status < 0:
        return f"was killed by signal {-status} (processor time limit {GUEST_CPU_S} s)"
    return "ended without an exit status"


def _came_up(guest: subprocess.Popen[str], out: Path, end: float) -> bool:
    while time.monotonic() < end and _cpu_s(guest.pid) < BOOT_CPU_S:
        if (out / "started").exists():
            return True
        if guest.poll() is not None:
            output = guest.stdout.read().strip() if guest.stdout else ""
            raise GuestError(
                f"QEMU ended with status {guest.returncode} before the guest was up: {output}"
            )
        time.sleep(0.05)
    return False


def _cpu_s(pid: int) -> float:
    """Return the processor time that a child has used, s (proc(5), /proc/pid/stat)."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def _started(words: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    guest = subprocess.Popen(
        ["sh", "-c", 'ulimit -t "$0" && exec "$@"', str(GUEST_CPU_S), *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
    )
    try:
        yield guest
    finally:
        guest.kill()
        guest.wait()


def _qemu(kernel: Kernel, out: Path) -> list[str]:
    # security_model=none: files keep their owners and modes; remap: the host's mounts do not clash.
    host = "local,path=/,mount_tag=host,security_model=none,readonly=on,multidevs=remap"
    back = f"local,path={out},mount_tag=out,security_model=none"
    return [
        *("qemu-system-x86_64", *CLOCK_OF_INSTRUCTIONS, "-cpu", PROCESSOR),
        *("-smp", "1", "-m", "2048", "-machine", "pc", "-nodefaults", "-no-user-config"),
        *("-display", "none", "-no-reboot", "-seed", "1"),
        *("-kernel", str(kernel.image), "-initrd", str(kernel.initrd)),
        *("-append", KERNEL_ARGUMENTS, "-virtfs", host, "-virtfs", back),
        *("-chardev", f"file,id=console,path={out}/console.log", "-serial", "chardev:console"),
        *("-serial", "stdio"),
    ]
