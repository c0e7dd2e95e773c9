"""What is installed by extras is imported only where a feature needs it."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]

#: Modules of packages that have other names, and of what packages depend on.
OTHER_NAMES = {
    *("usb", "serial", "cv2", "typing_extensions", "pydantic_core"),
    *("Imath", "camctl", "drivers", "menu", "sim"),
}

#: Where the modules of extras, and of pytest, may be imported: folders or files.
WHERE = {
    "PIL": "menu/panels/luma_display.py",
    "bluesky": "camctl/adapters/bluesky.py",
    "event_model": "camctl/adapters/bluesky.py",
    "gphoto2": "drivers/gphoto2/",
    "gpiod": "menu/panels/gpio_keys.py",
    "h5py": "camctl/adapters/bluesky.py",
    "imagecodecs": "camctl/pictures/hdr_avif.py",
    "llvmlite": "camctl/system/machine_code.py",
    "luma": "menu/panels/luma_display.py",
    "matplotlib": "camctl/(studies/|calibration/plots.py|system/plots.py)",
    "numba": "camctl/system/compiled_functions.py",
    "ophyd_async": "camctl/adapters/bluesky.py",
    "paho": "menu/mqtt/",
    "picamera2": "drivers/libcamera/",
    "pytest": "camctl/testing/",
    "rawpy": "camctl/stills/decoding.py",
    "scipy": "camctl/studies/",
    "smbus2": "menu/panels/hd44780.py",
}


def statements(parent: ast.AST) -> Iterator[ast.AST]:
    """Yield all statements in a file, but not their expressions, which are most of its tree."""
    for node in ast.iter_child_nodes(parent):
        if isinstance(node, ast.stmt | ast.excepthandler | ast.match_case):
            yield node
            yield from statements(node)


def imported(path: Path) -> Iterator[str]:
    """Yield the first names of the modules that a file imports, wherever it does."""
    for node in statements(ast.parse(path.read_text("utf-8"))):
        names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module]
        yield from (name.partition(".")[0] for name in names)


def test_modules_of_extras_are_imported_only_where_a_feature_needs_them() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    always = {re.split(r"[<>=]", each)[0] for each in project["dependencies"]}
    always |= OTHER_NAMES | sys.stdlib_module_names
    seen = set()
    for package in ("camctl", "drivers", "menu", "sim"):
        for path in sorted((ROOT / package).rglob("*.py")):
            place = path.relative_to(ROOT).as_posix()
            for name in imported(path):
                if name in always:
                    continue
                seen.add(name)
                assert name in WHERE, f"{place} imports {name}, which is no dependency"
                assert re.match(WHERE[name], place), f"{place} imports {name}"
    assert seen == WHERE.keys()
