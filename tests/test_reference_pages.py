"""The pages of findings, of the report's fields and of the options are what the code gives."""

import runpy
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
SCRIPT = runpy.run_path(str(DOCS / "write_reference.py"))


@pytest.mark.parametrize("page", ["findings", "options", "report"])
def test_a_generated_page_is_up_to_date(page: str) -> None:
    """Update it with: python docs/write_reference.py."""
    text = (DOCS / "reference" / f"{page}.md").read_text(encoding="utf-8")
    assert text == SCRIPT[f"{page}_page"]()


def test_man_pages_of_all_commands_are_valid(tmp_path: Path) -> None:
    runpy.run_path(str(DOCS / "write_man_pages.py"))["main"](tmp_path)
    pages = {path.stem: path.read_text(encoding="utf-8") for path in tmp_path.glob("*.1")}
    assert {"camctl", "camctl-shoot", "camctl-calibrate-noise", "camctl-schema"} <= set(pages)
    shoot = pages["camctl-shoot"].splitlines()
    assert shoot[:3] == [
        shoot[0],
        ".ad l",
        ".SH NAME",
    ]
    assert "camctl\\-shoot \\- Take a picture of high dynamic range" in shoot
    assert ".B \\-n, \\-\\-exposures N" in shoot
    if shutil.which("groff") is None:
        pytest.skip("groff is missing: apt-get install groff-base")
    command = ["groff", "-man", "-Tutf8", "-ww", "-z", *sorted(map(str, tmp_path.glob("*.1")))]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_man_pages_are_written_where_only_a_build_has_its_packages(tmp_path: Path) -> None:
    """`[build-system]` of pyproject.toml names them: pip makes the pages before all else."""
    code = (
        "import runpy, sys; from pathlib import Path; before = set(sys.modules)\n"
        f"runpy.run_path({str(DOCS / 'write_man_pages.py')!r})['main'](Path({str(tmp_path)!r}))\n"
        "print(*{each.partition('.')[0] for each in set(sys.modules) - before})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = set(done.stdout.split()) - sys.stdlib_module_names
    assert loaded <= {"camctl", "click", "platformdirs"}


@pytest.mark.slow
def test_the_wheel_installs_the_man_pages(tmp_path: Path) -> None:
    root, wheels, prefix = DOCS.parent, tmp_path / "wheels", tmp_path / "prefix"
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(wheels)]
    subprocess.run(build, cwd=root, check=True)
    (wheel,) = wheels.iterdir()
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index"]
    # What is installed here stays as it is.
    subprocess.run([*pip, "--ignore-installed", "--prefix", str(prefix), str(wheel)], check=True)
    runpy.run_path(str(DOCS / "write_man_pages.py"))["main"](tmp_path / "written")
    written = {path.name: path.read_bytes() for path in (tmp_path / "written").iterdir()}
    installed = prefix / "share" / "man" / "man1"
    assert {path.name: path.read_bytes() for path in installed.iterdir()} == written
    if shutil.which("man") is not None:  # it is part of few containers
        command = ["man", "-M", str(installed.parent), "camctl-shoot"]
        shown = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        assert "Take a picture of high dynamic range" in " ".join(shown.split())
