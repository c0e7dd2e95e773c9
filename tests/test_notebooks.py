"""The notebooks of the documentation run, and print what they hold."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

FOLDER = Path(__file__).parents[1] / "docs/tutorials/notebooks"
NAMES = ("accuracy-and-time", "light-from-frames", "photometric-stereo")


def cells(name: str) -> list[dict[str, Any]]:
    found = json.loads((FOLDER / f"{name}.ipynb").read_text("utf-8"))["cells"]
    return [each for each in found if each["cell_type"] == "code"]


def test_every_notebook_is_run() -> None:
    assert sorted(path.stem for path in FOLDER.glob("*.ipynb")) == sorted(NAMES)


@pytest.mark.slow
@pytest.mark.timeout(1200)  # planning and pictures, which take long on a busy machine
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_prints_what_it_holds(name: str, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    program = "\nplt.close('all')\n".join("".join(each["source"]) for each in cells(name))
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "agg"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    outputs = [output for each in cells(name) for output in each["outputs"]]
    shown = "".join("".join(each["text"]) for each in outputs if each["output_type"] == "stream")
    assert shown
    assert done.stdout == shown
    assert any("image/png" in each.get("data", {}) for each in outputs)
