"""Kill the saving of the menu's settings before each of its file operations; see `crash_points`.

    python settings_crash_sweep.py FOLDER SCENARIO

SCENARIO is "first" (neither the file nor its folder is there) or "again" (over older settings).
Each crash point is checked as a kill leaves the folder, and as a power failure leaves it.  Prints
one JSON object for each check.

A program of its own: it forks, which a process with threads must not.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any

from crash_points import PowerLoss, run

from menu.data import Settings
from menu.settings_file import load_settings, save_settings

OLD, NEW, LATER = Settings(response=1, count=4), Settings(range=2, camera="sim"), Settings(timer=3)
NAME = Path("state") / "camctl" / "menu.json"


def save(path: Path, settings: Settings) -> int:
    save_settings(path, settings)
    return 0


def checked(path: Path) -> dict[str, Any]:
    """Return which settings are found, and what is wrong with them, the folder, or saving again."""
    found, remark = load_settings(path)
    left = [entry.name for entry in path.parent.glob("*") if entry != path]
    names = {repr(Settings()): "defaults", repr(OLD): "old", repr(NEW): "new"}
    save_settings(path, LATER)
    is_saved = load_settings(path) == (LATER, "")
    return {
        "found": names.get(repr(found), repr(found)),
        "wrong": [remark] * bool(remark) + left + ["not saved again"] * (not is_saved),
    }


def main(base: Path, scenario: str) -> None:
    template, work, other, backups = (base / name for name in ("template", "work", "other", "kept"))
    template.mkdir(parents=True)
    if scenario == "again":
        save(template / NAME, OLD)
    shutil.copytree(template, work)
    operations = run(lambda: save(work / NAME, NEW), work).operations
    for point in range(len(operations) + 1):
        for folder in (work, other, backups):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(template, work)
        backups.mkdir()
        loss = PowerLoss(work, backups)
        outcome = run(lambda: save(work / NAME, NEW), work, die_at=point, before=loss.before)
        assert outcome.status == (0 if point == len(operations) else None), outcome
        shutil.copytree(work, other)
        loss.strike()
        before = operations[point].name if point < len(operations) else "end"
        for cause, folder in (("kill", other), ("power", work)):
            print(json.dumps({"before": before, "cause": cause, **checked(folder / NAME)}))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
