"""Runs camctl in a process of its own, with limits, redirections and permissions."""

from __future__ import annotations

import ctypes
import os
import resource
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

SHOOT = ("shoot", "-O", "size=24x16", "--ratios", "1,8", "--base", "0.03", "-o", "out")
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
