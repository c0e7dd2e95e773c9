"""run.py on a machine where it cannot run."""

import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

HERE = Path(__file__).parent
UDEV = Path("/lib/systemd/systemd-udevd")
PROGRAMS = (
    *("qemu-system-x86_64", "busybox", "modprobe", "depmod", "cpio"),
    *("dpkg", "apt-get", "apt-cache"),
)


def run(*words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, HERE / "run.py", *words],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )


@pytest.fixture
def path_without(tmp_path: Path) -> Callable[[str | None], str]:
    """A PATH with all programs that are needed but one; those in it fail."""

    def build(missing: str | None) -> str:
        for name in PROGRAMS:
            if name != missing:
                (tmp_path / name).write_text("#!/bin/sh\nexit 1\n")
                (tmp_path / name).chmod(0o755)
        return str(tmp_path)

    return build


@pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"),
    reason="the virtual hardware needs Linux on x86-64",
)
class TestItCannotRun:
    @pytest.mark.parametrize(("words", "status"), [((), 0), (("--must-run",), 77)])
    def test_no_qemu(
        self, path_without: Callable[[str | None], str], words: tuple[str, ...], status: int
    ) -> None:
        done = run(*words, PATH=path_without("qemu-system-x86_64"))
        assert done.returncode == status
        assert done.stdout.startswith("virtual hardware skipped: no qemu-system-x86_64; apt-get ")
        assert len(done.stdout.splitlines()) == 1
        assert not done.stderr

    def test_no_kernel_package(
        self, path_without: Callable[[str | None], str], tmp_path: Path
    ) -> None:
        cache = str(tmp_path / "cache")
        done = run(PATH=path_without(None), CAMCTL_VIRTUAL_HARDWARE_CACHE=cache)
        assert done.returncode == 0
        reason = "no kernel could be downloaded (" if UDEV.exists() else f"no {UDEV}; "
        assert done.stdout.startswith(f"virtual hardware skipped: {reason}")
        assert len(done.stdout.splitlines()) == 1
