"""Kernel modules that Debian's kernel lacks, built once for the guest from Debian's packages.

The packages are unpacked, not installed; the compiler is the host's.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

from machine import PATH, CannotRunError, Kernel, _locked, _run, cache_directory

APT_LINE = "apt-get install gcc make"


def loopback_module(kernel: Kernel) -> Path:
    """Return the module v4l2loopback, from the cache, or built now.

    Raises:
        CannotRunError: it cannot be built on this machine
    """
    return _module(kernel, "v4l2loopback", _loopback_source)


def gpio_module(kernel: Kernel) -> Path:
    """Return the module gpio-sim, from the cache, or built now.

    Raises:
        CannotRunError: it cannot be built on this machine
    """
    return _module(kernel, "gpio-sim", _gpio_source)


def _module(kernel: Kernel, name: str, source: Callable[[Path, str], Path]) -> Path:
    version = next(kernel.modules.iterdir()).name
    module = cache_directory() / f"{name}-{version}.ko"
    with _locked(cache_directory()):
        if not module.exists():
            missing = [each for each in ("gcc", "make") if shutil.which(each, path=PATH) is None]
            if missing:
                raise CannotRunError(f"no {', '.join(missing)}", APT_LINE)
            try:
                _build(version, source, module)
            except (subprocess.SubprocessError, OSError, ValueError) as error:
                output = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
                raise CannotRunError(
                    f"no {name} could be built ({output[-1] if output else error})", APT_LINE
                ) from error
    return module


def _build(version: str, source: Callable[[Path, str], Path], module: Path) -> None:
    with tempfile.TemporaryDirectory(dir=module.parent) as scratch:
        headers = [f"linux-headers-{version}", f"linux-headers-{version.rsplit('-', 1)[0]}-common"]
        root = _unpacked(Path(scratch), *headers, _series(version, "linux-kbuild"))
        makefile = root / "usr/src" / headers[0] / "Makefile"
        # It names the other package's folder as installed.
        makefile.write_text(makefile.read_text().replace("/usr/src", str(root / "usr/src")))
        folder = source(Path(scratch), version)
        _run("make", "-C", makefile.parent, f"M={folder}", "CC=gcc", "modules")
        (made,) = folder.glob("*.ko")
        made.rename(module)


def _loopback_source(scratch: Path, _version: str) -> Path:
    (source,) = (_unpacked(scratch, "v4l2loopback-dkms") / "usr/src").glob("v4l2loopback-*")
    return source


def _gpio_source(scratch: Path, version: str) -> Path:
    """Return a folder with the kernel's gpio-sim and its simulated interrupts as one module."""
    package = _series(version, "linux-source")
    archive = _unpacked(scratch, package) / "usr/src" / f"{package}.tar.xz"
    files = ("drivers/gpio/gpio-sim.c", "drivers/gpio/gpiolib.h", "kernel/irq/irq_sim.c")
    _run("tar", "-xJf", archive, "-C", scratch, *(f"{package}/{each}" for each in files))
    source = scratch / "gpio-sim"
    source.mkdir()
    for each in files:
        (scratch / package / each).rename(source / Path(each).name)
    # A module has its own name, and irq_to_desc() is for the kernel alone.
    (source / "gpio-sim.c").rename(source / "lines.c")
    interrupts = source / "irq_sim.c"
    text = interrupts.read_text()
    call = "handle_simple_irq(irq_to_desc(irqnum))"
    if call not in text:
        raise ValueError(f"{package}: no {call} in {interrupts.name}")
    interrupts.write_text(text.replace(call, "generic_handle_irq(irqnum)"))
    (source / "Kbuild").write_text("obj-m := gpio-sim.o\ngpio-sim-y := lines.o irq_sim.o\n")
    return source


def _series(version: str, name: str) -> str:
    """Return the name of a package that is one for all kernels of a series, such as 6.1."""
    return f"{name}-{'.'.join(version.split('.')[:2])}"


def _unpacked(scratch: Path, *packages: str) -> Path:
    """Return the folder with what packages hold."""
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        _run("apt-get", "download", *packages, cwd=Path(folder))
        for package in Path(folder).glob("*.deb"):
            _run("dpkg", "-x", package, scratch / "root")
    return scratch / "root"
