"""Print what happens with each recorded body: the table of docs/reference/bodies.md.

    python docs/print_bodies.py

Each body is a virtual camera with the properties, the choices and the manners of the real one, on a
virtual bus.  Takes about 40 s.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from camctl.sim.devices.ptp.body_facts import bodies

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from ptp_bodies import row

HEAD = "| body | name | what its record says | as recorded | with its mode dial at M |"


def main() -> None:
    """Print the head and the rows."""
    print(f"{HEAD}\n|---|---|---|---|---|")
    for name in bodies():
        with tempfile.TemporaryDirectory() as folder:
            os.environ["CAMCTL_PROFILES"] = folder
            print(row(name), flush=True)


if __name__ == "__main__":
    main()
