"""What the laboratory says where it cannot run."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

RUN = Path(__file__).parent / "run.py"


def run(*words, **environment):
    return subprocess.run(
        [sys.executable, RUN, *words],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
    )


@pytest.fixture
def path_without(tmp_path):
    """A PATH that has everything but one program; what it has does nothing."""

    def build(missing):
        for name in ("qemu-system-x86_64", "busybox", "modprobe", "depmod", "cpio", "dpkg"):
            if name != missing:
                (tmp_path / name).write_text("#!/bin/sh\nexit 1\n")
                (tmp_path / name).chmod(0o755)
        return str(tmp_path)

    return build


@pytest.mark.skipif(
    (sys.platform, platform.machine()) != ("linux", "x86_64"),
    reason="the laboratory needs Linux on x86-64, which it says first",
)
class TestItCannotRun:
    @pytest.mark.parametrize(("words", "status"), [((), 0), (("--must-run",), 77)])
    def test_no_qemu(self, path_without, words, status):
        done = run(*words, PATH=path_without("qemu-system-x86_64"))
        assert done.returncode == status
        assert done.stdout.startswith("laboratory skipped: ")
        assert "qemu-system-x86_64" in done.stdout
        assert "apt-get install" in done.stdout
        assert len(done.stdout.splitlines()) == 1
        assert not done.stderr

    def test_no_kernel_package(self, path_without, tmp_path):
        done = run(PATH=path_without(None), CAMCTL_LAB_CACHE=str(tmp_path / "cache"))
        assert done.returncode == 0
        assert done.stdout.startswith("laboratory skipped: no ")
        assert len(done.stdout.splitlines()) == 1
