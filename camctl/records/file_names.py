"""Names that other packages look for: files of a capture, and the command that completes it."""

from __future__ import annotations

import os
import shlex

REPORT = "report.json"


def resume_command(directory: str | os.PathLike[str]) -> str:
    r"""Return the command that goes on with a capture or a series, to be pasted into a shell.

    >>> resume_command("hall"), resume_command("red hall")
    ('camctl shoot --resume hall', "camctl shoot --resume 'red hall'")
    >>> print(resume_command("caf\udce9"))  # a name that is not UTF-8, in bash
    camctl shoot --resume $'caf\xe9'
    """
    name = os.fspath(directory)
    if name.isprintable():
        word = shlex.quote(name)
    else:
        codes = "".join(
            chr(byte) if 32 <= byte < 127 and byte not in b"\\'" else f"\\x{byte:02x}"
            for byte in os.fsencode(name)
        )
        word = f"$'{codes}'"
    return f"camctl shoot --resume {word}"
