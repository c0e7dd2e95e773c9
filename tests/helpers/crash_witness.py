"""Kill camctl before each of its file operations; demand all that it had acknowledged until then.

    python crash_witness.py FOLDER SCENARIO [--every] [--torn N]
    python crash_witness.py FOLDER mutations

A scenario does something that writes files: it takes a capture ("fresh", "resume", "force" over an
older one, "retry" of a frame), a series, keeps a profile, the settings of the menu, a table or rows
of the cache.  What is acknowledged to the user goes to this process through a pipe, and so is kept
outside of the folder: a frame that is saved (the pixels as the camera sent them), a value that is
kept, and at the end, which is exit status 0, every file with its content.

Crash points are the first operation of each kind on each kind of file, or all of them; of the kinds
that a fresh capture has, too, every third where that is not the scenario.  At each the folder is
looked at as a kill leaves it, as a power failure leaves it at least, and N times as a power failure
leaves it that kept a part of the later writes, in any order and torn (see
`crash_points.PowerLoss`).  Then what the folder advises is done.  All that was acknowledged must be
there.  Prints one JSON object for each check.  Folders with the same content, of which the same was
acknowledged, are checked once.

With "mutations" the order of the writes is broken in each way of `crash_mutations` in turn.  The
points come in a random order until a check finds something wrong; prints what the last one found.

A program of its own: it forks, which a process with threads must not.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
from collections.abc import Callable, Collection, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import filelock  # noqa: F401  imported before the fork, once for all crash points
import numpy as np
from crash_mutations import MUTATIONS
from crash_points import Kind, PowerLoss, kinds, points, run
from crash_sweep import REQUEST, LyingCamera, checked, damaged, open_camera
from small_cameras import WrappedCamera

import camctl
from camctl.captures.series import Series
from camctl.captures.series_sets import CameraSets, SeriesTools
from camctl.errors import CamctlError
from camctl.exposure.build import build_table, discard_rows, look_up, table_jobs
from camctl.exposure.table import ExposureTable
from camctl.interface.camera import CameraInfo, Frame, FrameStream
from camctl.interface.controls import ExposureSetting
from camctl.menu.data import Settings
from camctl.menu.settings_file import load_settings, save_settings
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response
from camctl.profiles.profile import change_profile, load_profile
from camctl.records.folder_store import FolderStore
from camctl.records.journal import SeriesJournal, SeriesOptions, read_series
from camctl.records.report_file import LOCK

NAME = "out"


@dataclass
class Acknowledged:
    """What the user was told.

    Attributes:
        frames: checksums of the pixels of frames that are saved, as the camera sent them
        values: the last value of each name that is kept
        files: checksums of all files by name, once the command has ended with status 0
    """

    frames: set[str] = field(default_factory=set)
    values: dict[str, str] = field(default_factory=dict)
    files: dict[str, str] | None = None

    def add(self, item: dict[str, Any]) -> None:
        self.frames |= set(item.get("frames", ()))
        self.values |= item.get("values", {})
        self.files = item.get("files", self.files)


Acknowledge = Callable[..., None]


def digest(data: bytes) -> str:
    return sha256(data).hexdigest()


def content(folder: Path) -> dict[str, str]:
    """Return the checksums of all files that are no locks, by their names in the folder."""
    paths = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): digest(path.read_bytes())
        for path in paths
        if path.name not in (LOCK, ".lock")
    }


# ---- captures


class WitnessCamera(WrappedCamera):
    """Remembers the pixels of each frame, by the setting that was requested."""

    def __init__(self, camera: Any) -> None:
        super().__init__(camera)
        self.sent: dict[ExposureSetting, str] = {}

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        return self._frames(super().shoot(settings))

    def _frames(self, frames: FrameStream) -> Generator[Frame, None, None]:
        for frame in frames:
            self.sent[frame.requested] = digest(frame.pixels.tobytes())
            yield frame


@contextmanager
def witnessed(acknowledge: Acknowledge, camera: Any = None) -> Iterator[WitnessCamera]:
    """Yield a camera whose frames are acknowledged when a report that names them was saved."""
    save = FolderStore.save_report
    with WitnessCamera((camera or open_camera()).__enter__()) as witness:

        def saved(store: FolderStore, report: Any) -> None:
            save(store, report)
            kept = [each for each in report.frames if each is not None]
            acknowledge(
                frames=[witness.sent[e.requested] for e in kept if e.requested in witness.sent]
            )

        with patch.object(FolderStore, "save_report", saved):
            yield witness


def shoot(folder: Path, acknowledge: Acknowledge, *, seed: int = 0, **options: Any) -> None:
    with witnessed(acknowledge, open_camera(seed)) as camera:
        camctl.capture(camera, REQUEST, folder / NAME, **options)


def shoot_again(folder: Path, acknowledge: Acknowledge) -> None:
    with witnessed(acknowledge) as camera:
        camctl.resume(camera, folder / NAME)


def shoot_with_retry(folder: Path, acknowledge: Acknowledge) -> None:
    with witnessed(acknowledge, LyingCamera(open_camera())) as camera:
        camctl.capture(camera, REQUEST, folder / NAME)


def shoot_half(folder: Path, acknowledge: Acknowledge) -> None:
    """Leave a capture with one frame of two."""

    def keep_one(done: Any) -> None:
        if done.stage == "shooting" and done.done == 1:
            raise KeyboardInterrupt

    with suppress(camctl.InterruptedCaptureError), witnessed(acknowledge) as camera:
        camctl.capture(camera, REQUEST, folder / NAME, progress=keep_one)


def pixels_in(folder: Path) -> set[str]:
    """Return the checksums of the pixels of all frames that are there under their names."""
    found = set()
    for path in folder.rglob("frames/*.npy"):
        if not path.name.startswith("."):
            with suppress(ValueError, OSError):
                found.add(digest(np.load(path).tobytes()))
    return found


def check_capture(folder: Path, told: Acknowledged) -> list[str]:
    """Complete the capture as its folder advises; return what is wrong before and after that."""
    out = folder / NAME
    if told.values.get("before") and (wrong := _check_replaced(folder, told)) is not None:
        return wrong
    found = checked(out)
    wrong = list(found["wrong"])
    if found["done"] == "shot anew" and told.frames:
        wrong.append("acknowledged frames are gone with the capture")
    if lost := told.frames - pixels_in(out):
        wrong.append(f"{len(lost)} acknowledged frames are lost")
    return wrong


def _check_replaced(folder: Path, told: Acknowledged) -> list[str] | None:
    """Return what is wrong with a capture that is to be replaced, None once it was replaced."""
    before: dict[str, str] = json.loads(told.values["before"])
    report = folder / NAME / "report.json"
    if not report.exists():
        return ["neither the old capture nor the new one has a report"]
    if digest(report.read_bytes()) != before[f"{NAME}/report.json"]:
        return None
    if told.frames:
        return ["the new capture was acknowledged, and the old one is back"]
    now = content(folder)
    return [
        f"{name} of the old capture is lost" for name in before if now.get(name) != before[name]
    ]


# ---- series


def take_series(folder: Path, acknowledge: Acknowledge) -> None:
    """Begin or continue a series of two sets."""
    directory = folder / NAME
    save = SeriesJournal.save

    def saved(journal: SeriesJournal, into: Path) -> None:
        save(journal, into)
        acknowledge(values={"sets": str(journal.completed)})

    with witnessed(acknowledge) as camera, patch.object(SeriesJournal, "save", saved):
        if (directory / "series.json").exists():
            journal = read_series(directory)
        else:
            options = SeriesOptions(repeat=2)
            journal = SeriesJournal(camera=camera.info, source={}, request=REQUEST, options=options)
        if not journal.is_done():
            tools = SeriesTools(camera.clock)
            Series(directory, journal, CameraSets(camera, journal), tools).run()


def check_series(folder: Path, told: Acknowledged) -> list[str]:
    directory = folder / NAME
    if not (directory / "series.json").exists():
        if told.values or told.frames:
            return ["the journal is lost"]
        shutil.rmtree(directory, ignore_errors=True)  # what a user does who begins anew
    elif read_series(directory).completed < int(told.values.get("sets", "0")):
        return ["a complete set is not known any more"]
    take_series(folder, lambda **_: None)
    sets = [path for path in directory.iterdir() if (path / "report.json").exists()]
    wrong = [each for path in sets for each in damaged(path)]
    if read_series(directory).completed != 2:
        wrong.append("the series was not completed")
    if lost := told.frames - pixels_in(folder):
        wrong.append(f"{len(lost)} acknowledged frames are lost")
    return wrong + _hidden(folder)


# ---- what is kept under a name: profiles, settings, tables, rows

INFO = CameraInfo("x", "Maker", "Model", "1", "v4l2")
SETTINGS = {"old": Settings(response=1, count=4), "new": Settings(range=2, camera="sim")}


def keep_profile(folder: Path, acknowledge: Acknowledge) -> None:
    with patch.dict(os.environ, CAMCTL_PROFILES=str(folder / "share" / "profiles")):
        for bits in (8, 10):

            def change(profile: Any, bits: int = bits) -> None:
                profile.stills["raw"] = _still(bits)

            change_profile(INFO, change)
            acknowledge(values={"profile": str(bits)})


def _still(bits: int) -> Any:
    from camctl.interface.controls import Layout
    from camctl.profiles.profile import StillRecord

    return StillRecord(
        rows=24, columns=32, layout=Layout.RGGB, bits=bits, black=0, white=2**bits - 1
    )


def check_profile(folder: Path, told: Acknowledged) -> list[str]:
    with patch.dict(os.environ, CAMCTL_PROFILES=str(folder / "share" / "profiles")):
        record = load_profile(INFO).stills.get("raw")
        found = 0 if record is None else record.bits
        wrong = [] if found >= int(told.values.get("profile", "0")) else [f"bits {found} are kept"]
        keep_profile(folder, lambda **_: None)
        return wrong + _hidden(folder)


def keep_settings(folder: Path, acknowledge: Acknowledge) -> None:
    for name, settings in SETTINGS.items():
        save_settings(folder / "state" / "menu.json", settings)
        acknowledge(values={"settings": name})


def check_settings(folder: Path, told: Acknowledged) -> list[str]:
    path = folder / "state" / "menu.json"
    found, remark = load_settings(path)
    allowed = [*SETTINGS.values()]
    if (last := told.values.get("settings")) is None:
        allowed.append(Settings())
    elif last == "new":
        allowed.remove(SETTINGS["old"])
    wrong = [remark] * bool(remark) + [f"{found} are kept"] * (found not in allowed)
    keep_settings(folder, lambda **_: None)
    return wrong + _hidden(folder)


JOBS = table_jobs(linear_response(3), ("linear", "log"), (256.0,), (1,))


def make_table(folder: Path, acknowledge: Acknowledge) -> None:
    """Build a table as `camctl table build` does."""
    output, rows = folder / "table.json", folder / "table.json.parts"
    table = build_table(
        JOBS, state=rows, progress=lambda done, _: acknowledge(values={"rows": str(done)})
    )
    table.save(output)
    discard_rows(JOBS, rows)


def check_table(folder: Path, told: Acknowledged) -> list[str]:
    output, rows = folder / "table.json", folder / "table.json.parts"
    if output.exists():
        kept = len(ExposureTable.load(output).entries)
    else:
        kept = len([each for each in JOBS if (rows / f"{each.name}.json").exists()])
    wrong = []
    if kept < int(told.values.get("rows", "0")):
        wrong.append(f"{kept} rows of {told.values['rows']} are kept")
    make_table(folder, lambda **_: None)
    if len(ExposureTable.load(output).entries) != len(JOBS):
        wrong.append("the table is not complete")
    return wrong + ["the rows are left"] * rows.exists() + _hidden(folder)


def keep_row(folder: Path, acknowledge: Acknowledge) -> None:
    with patch.dict(os.environ, CAMCTL_CACHE=str(folder / "cache")):
        look_up(linear_response(3), desired_response("log", 300.0), 1)
        acknowledge(values={"row": "1"})


def check_row(folder: Path, told: Acknowledged) -> list[str]:
    rows = [path for path in folder.rglob("*.json") if not path.name.startswith(".")]
    wrong = ["the row is lost"] * bool(told.values and not rows)
    keep_row(folder, lambda **_: None)
    if list(folder.rglob("*.damaged")):
        wrong.append("the row was damaged")
    return wrong + _hidden(folder)


def _hidden(folder: Path) -> list[str]:
    hidden = [path.name for path in folder.rglob(".*.part")]
    return [f"left over: {hidden}"] if hidden else []


# ---- the sweep


def _nothing(_folder: Path, _acknowledge: Acknowledge) -> None:
    """Leave the folder empty."""


def _older_capture(folder: Path, acknowledge: Acknowledge) -> None:
    shoot(folder, lambda **_: None, seed=1)
    acknowledge(values={"before": json.dumps(content(folder))})


Act = Callable[[Path, Acknowledge], None]
SCENARIOS: dict[str, tuple[Act, Act, Callable[[Path, Acknowledged], list[str]]]] = {
    "fresh": (_nothing, shoot, check_capture),
    "resume": (shoot_half, shoot_again, check_capture),
    "force": (_older_capture, lambda f, a: shoot(f, a, overwrite=True), check_capture),
    "retry": (_nothing, shoot_with_retry, check_capture),
    "series": (_nothing, take_series, check_series),
    "profile": (_nothing, keep_profile, check_profile),
    "settings": (_nothing, keep_settings, check_settings),
    "table": (_nothing, make_table, check_table),
    "row": (_nothing, keep_row, check_row),
}
"""The folder before, the program that is killed, and what is wrong with the files afterwards."""

CAPTURES = {"resume", "force", "retry", "series"}
"""Scenarios that take a capture as "fresh" does."""


class Sweep:
    """The crash points of one scenario, in a folder of its own."""

    def __init__(self, base: Path, scenario: str, mutation: str | None) -> None:
        prepare, self._act, self._check = SCENARIOS[scenario]
        self._mutate = MUTATIONS[mutation].apply if mutation is not None else lambda: None
        self._base, self._work = base, base / "work"
        self._template, self._backups = base / "template", base / "kept"
        self._before = Acknowledged()
        self._template.mkdir(parents=True)
        prepare(self._template, lambda **item: self._before.add(item))
        shutil.copytree(self._template, self._work)
        self.operations = run(lambda: self._child(-1), self._work).operations
        self._found: dict[str, list[str]] = {}

    def _child(self, descriptor: int) -> int:
        """Act, broken by the mutation, and acknowledge through a pipe."""

        def acknowledge(**item: Any) -> None:
            if descriptor >= 0:
                os.write(descriptor, json.dumps(item).encode() + b"\n")

        self._mutate()
        self._act(self._work, acknowledge)
        acknowledge(files=content(self._work))
        return 0

    def at(self, point: int, torn: int, seed: int = 0) -> Iterator[dict[str, Any]]:
        """Yield a check for each way in which the crash at a point may leave the folder."""
        for folder in (self._work, self._backups):
            shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self._template, self._work)
        self._backups.mkdir()
        loss = PowerLoss(self._work, self._backups)
        reader, writer = os.pipe()
        outcome = run(lambda: self._child(writer), self._work, die_at=point, before=loss.before)
        os.close(writer)
        told = Acknowledged(set(self._before.frames), dict(self._before.values))
        with os.fdopen(reader, "rb") as lines:
            for line in lines:
                told.add(json.loads(line))
        is_end = point >= len(self.operations)
        assert outcome.status == (0 if is_end else None), outcome
        states = {"kill": self._base / "kill", "power": self._base / "power"}
        shutil.copytree(self._work, states["kill"])
        loss.strike(states["power"])
        for number in range(torn):
            states[f"torn {number}"] = self._base / f"torn{number}"
            loss.strike(states[f"torn {number}"], random.Random(f"{seed} {point} {number}"))
        before = "end" if is_end else self.operations[point].name
        for cause, folder in states.items():
            key = json.dumps([_all_in(folder), sorted(told.frames), told.values, told.files])
            if key not in self._found:
                self._found[key] = self._wrong(folder, told)
            wrong = self._found[key]
            shutil.rmtree(folder, ignore_errors=True)
            yield {"point": point, "before": before, "cause": cause, "wrong": wrong}

    def _wrong(self, folder: Path, told: Acknowledged) -> list[str]:
        wrong = []
        if told.files is not None and (found := content(folder)) != told.files:
            names = sorted(
                name for name in {*found, *told.files} if found.get(name) != told.files.get(name)
            )
            wrong.append(f"after exit status 0: {', '.join(names)}")
        try:
            wrong += self._check(folder, told)
        except (CamctlError, OSError, ValueError, AssertionError) as error:
            wrong.append(f"{type(error).__name__}: {error}")
        return wrong


def _all_in(folder: Path) -> list[tuple[str, str]]:
    """Return every entry of a folder with the checksum of its content."""
    return sorted(
        (str(path.relative_to(folder)), digest(path.read_bytes()) if path.is_file() else "")
        for path in folder.rglob("*")
    )


def noticed(base: Path, name: str) -> dict[str, Any]:
    """Return what a sweep finds where the order of the writes is broken."""
    sweep = Sweep(base, MUTATIONS[name].scenario, name)
    count = len(sweep.operations)
    for point in (count, *random.Random(1).sample(range(count), count)):
        for found in sweep.at(point, 1):
            if found["wrong"]:
                return {"mutation": name, **found}
    return {"mutation": name, "wrong": []}


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("scenario", choices=(*SCENARIOS, "mutations"))
    parser.add_argument("--every", action="store_true")
    parser.add_argument("--torn", type=int, default=0)
    given = parser.parse_args()
    cv2.setNumThreads(1)
    if given.scenario == "mutations":
        for place, name in enumerate(MUTATIONS):
            print(json.dumps(noticed(given.folder / str(place), name)), flush=True)
        return
    known: Collection[Kind] = ()
    if given.scenario in CAPTURES and not given.every:
        known = kinds(Sweep(given.folder / "fresh", "fresh", None).operations).keys()
    sweep = Sweep(given.folder / "here", given.scenario, None)
    for point in points(sweep.operations, every=given.every, known=known):
        for found in sweep.at(point, given.torn):
            print(json.dumps(found), flush=True)


if __name__ == "__main__":
    main()
