"""The kernel module v4l2loopback, built once for the guest's kernel from Debian's packages.

The packages are unpacked, not installed; the compiler is the host's.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from pathlib import Path

from machine import PATH, CannotRunError, Kernel, _locked, _run, cache_directory

APT_LINE = "apt-get install gcc make"
_SOURCE = "v4l2loopback-dkms"


def loopback_module(kernel: Kernel) -> Path:
    """Return the module, from the cache, or built now.

    Raises:
        CannotRunError: it cannot be built on this machine
    """
    version = next(kernel.modules.iterdir()).name
    module = cache_directory() / f"v4l2loopback-{version}.ko"
    with _locked(cache_directory()):
        if not module.exists():
            missing = [each for each in ("gcc", "make") if shutil.which(each, path=PATH) is None]
            if missing:
                raise CannotRunError(f"no {', '.join(missing)}", APT_LINE)
            try:
                _build(version, module)
            except (subprocess.SubprocessError, OSError, ValueError) as error:
                output = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
                raise CannotRunError(
                    f"no v4l2loopback could be built ({output[-1] if output else error})", APT_LINE
                ) from error
    return module


def _build(version: str, module: Path) -> None:
    with tempfile.TemporaryDirectory(dir=module.parent) as scratch:
        root = Path(scratch, "root")
        headers = [f"linux-headers-{version}", f"linux-headers-{version.rsplit('-', 1)[0]}-common"]
        kbuild = f"linux-kbuild-{'.'.join(version.split('.')[:2])}"
        _run("apt-get", "download", *headers, kbuild, _SOURCE, cwd=Path(scratch))
        for package in Path(scratch).glob("*.deb"):
            _run("dpkg", "-x", package, root)
        makefile = root / "usr/src" / headers[0] / "Makefile"
        # It names the other package's folder as installed.
        makefile.write_text(makefile.read_text().replace("/usr/src", str(root / "usr/src")))
        (source,) = (root / "usr/src").glob("v4l2loopback-*")
        _run("make", "-C", makefile.parent, f"M={source}", "CC=gcc", "modules")
        (source / "v4l2loopback.ko").rename(module)
