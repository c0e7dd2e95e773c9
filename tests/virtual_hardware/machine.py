"""A guest with Debian's stock kernel on this machine's own file system, for one command.

The kernel package is unpacked, not installed.  QEMU emulates the processor, so that nothing but its
binary is needed of the host: no KVM, no root.  The guest's root is the host's, read-only over 9p
under a layer of RAM: every package and virtual environment of the host is there at its own path,
and what the guest writes is gone when it ends, but for /lab_out.
"""

from __future__ import annotations

import fcntl
import gzip
import hashlib
import os
import platform
import re
import shlex
import shutil
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
KERNEL_ARGUMENTS = "console=ttyS0 panic=-1 mitigations=off random.trust_cpu=on"
# An emulated processor now and then hangs before the first program runs; a boot takes 6 to 15 s.
BOOT_S = 60.0
BOOTS = 4
DOWNLOAD_S = 240.0
PATH = os.pathsep.join((os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"))


class CannotRunError(Exception):
    """There can be no guest on this machine: why, and what to install."""

    def __init__(self, why: str, remedy: str) -> None:
        super().__init__(f"{why}; {remedy}")


class GuestError(Exception):
    """The guest did not come up, ran out of time or ended without a word."""


@dataclass(frozen=True)
class Kernel:
    """Debian's kernel package, unpacked, with the RAM disk that starts it."""

    image: Path
    modules: Path
    initrd: Path


def cache_directory() -> Path:
    """Return $CAMCTL_LAB_CACHE, else a folder of the user's cache."""
    named = os.environ.get("CAMCTL_LAB_CACHE")
    return Path(named) if named else Path(platformdirs.user_cache_dir("camctl")) / "laboratory"


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
        raise CannotRunError(f"{cache}: {error.strerror}", "set CAMCTL_LAB_CACHE") from error
    with _alone(cache):
        try:
            root = _unpacked(cache / "kernel")
            version = next((root / "lib/modules").iterdir()).name
            initrd = _initrd(root, version)
        except (subprocess.SubprocessError, OSError) as error:
            said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
            raise CannotRunError(
                f"no kernel to be had ({said[-1] if said else error})",
                "apt-get update, with a network",
            ) from error
    return Kernel(root / "boot" / f"vmlinuz-{version}", root / "lib/modules", initrd)


@contextmanager
def _alone(cache: Path) -> Iterator[None]:
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
        # The package that is always the newest one names the one that holds the kernel.
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
        boot_s: how long the last start took
    """

    status: int
    boots: int
    boot_s: float


def boot(
    kernel: Kernel,
    command: Sequence[str],
    out: Path,
    *,
    environment: Mapping[str, str],
    directory: Path,
    limit_s: float,
    line: Callable[[str], None],
) -> Result:
    """Run `command` as root in a new guest.

    Args:
        kernel: see `prepare`
        command: program and arguments
        out: folder that the guest sees as /lab_out and may write to
        environment: added to the command's
        directory: to start it in
        limit_s: the guest is ended after so many seconds, all in all
        line: called with every line that the command prints, as it comes

    Raises:
        GuestError: the guest did not come up, ran out of time, or ended without an exit status
    """
    settings = {"LAB_MODULES": str(kernel.modules), "LAB_DIRECTORY": str(directory)}
    words = shlex.join(command)
    exports = "".join(f"export {k}={shlex.quote(v)}\n" for k, v in environment.items())
    (out / "command.sh").write_text(f"{exports}exec {words}\n")
    (out / "start.sh").write_text(
        "".join(f"{k}={shlex.quote(v)}\n" for k, v in settings.items())
        + (HERE / "start.sh").read_text()
    )
    end = time.monotonic() + limit_s
    for boots in range(1, BOOTS + 1):
        with _started(_qemu(kernel, out)) as guest:
            began = time.monotonic()
            if not _came_up(guest, out, min(end, began + BOOT_S)):
                continue
            boot_s = time.monotonic() - began
            alarm = threading.Timer(max(0.0, end - time.monotonic()), guest.kill)
            alarm.start()
            assert guest.stdout is not None
            for text in guest.stdout:
                line(text.rstrip("\r\n"))
            guest.wait()
            alarm.cancel()
        try:
            return Result(int((out / "status").read_text()), boots, boot_s)
        except (OSError, ValueError):
            why = "ran out of time" if time.monotonic() >= end else "ended without a word"
            raise GuestError(f"the guest {why}; its console: {out}/console.log") from None
    raise GuestError(f"the guest did not come up in {BOOTS} starts; {out}/console.log")


def _came_up(guest: subprocess.Popen[str], out: Path, end: float) -> bool:
    while time.monotonic() < end:
        if (out / "started").exists():
            return True
        if guest.poll() is not None:
            said = guest.stdout.read().strip() if guest.stdout else ""
            raise GuestError(
                f"QEMU ended with status {guest.returncode} before the guest was up {said}"
            )
        time.sleep(0.05)
    return False


@contextmanager
def _started(words: Sequence[str]) -> Iterator[subprocess.Popen[str]]:
    guest = subprocess.Popen(
        words,
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
        *("qemu-system-x86_64", "-accel", "tcg,thread=multi", "-cpu", "max"),
        *("-smp", "2", "-m", "2048", "-machine", "pc", "-nodefaults", "-no-user-config"),
        *("-display", "none", "-no-reboot", "-device", "virtio-rng-pci"),
        *("-kernel", str(kernel.image), "-initrd", str(kernel.initrd)),
        *("-append", KERNEL_ARGUMENTS, "-virtfs", host, "-virtfs", back),
        *("-chardev", f"file,id=console,path={out}/console.log", "-serial", "chardev:console"),
        *("-serial", "stdio"),
    ]
