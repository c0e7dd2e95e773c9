"""`camctl shoot` for a series: options, keys of a terminal, hooks, resuming, signals."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from datetime import datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from command_line import Run
from pseudo_terminal import Terminal
from sampling import some
from series_bench import journal

import camctl
from camctl.captures.series_sets import CameraSets
from camctl.errors import CaptureError
from camctl.sim.camera import SimulatedCamera

TINY = ("series", "-O", "size=16x12", "--scene", "uniform", "--ratios", "1,4", "--base", "0.01")


def sets(folder: str = "day") -> Any:
    return json.loads(Path(folder, "series.json").read_text())["sets"]


def test_a_series_is_a_folder_of_captures_with_a_page(run: Run) -> None:
    ran = run(*TINY, "--repeat", "3", "--interval", "60", "-o", "day")
    assert (ran.status, ran.err) == (0, "")
    assert "3 of 3 complete" in ran.out
    names = {path.name for path in Path("day").iterdir()} - {".camctl.lock"}
    assert names == {"series.json", "index.html", "thumbnails"} | {f"set-000{k}" for k in (1, 2, 3)}
    assert [each["started_s"] for each in sets()] == pytest.approx([0, 60, 120])
    taken = [datetime.fromisoformat(each["started_at"]) for each in sets()]
    assert [(b - a).total_seconds() for a, b in pairwise(taken)] == [60, 60]  # the camera's clock
    for each, begun in zip(sets(), taken, strict=True):
        folder = Path("day", each["folder"])
        assert (folder / "radiance.exr").exists()
        report = json.loads((folder / "report.json").read_text())
        assert datetime.fromisoformat(report["taken_at"]).replace(tzinfo=None) == begun
    page = Path("day/index.html").read_text()
    assert page.count("<article>") == 3
    assert run("resume", "day").error == (
        "the series in day is complete: 3 of 3 sets were taken; take another one with camctl "
        "series --repeat N"
    )


@pytest.mark.parametrize(
    "sensor",
    ["phone", *(pytest.param(each, marks=pytest.mark.slow) for each in ("standard", "consumer"))],
)
def test_the_space_of_a_set_is_known_before_the_first_one(sensor: str, tmp_path: Path) -> None:
    with camctl.open_camera("sim", sensor=sensor, size="320x240") as camera:
        series = journal(request=camctl.CaptureRequest(count=2, dynamic_range=256.0), repeat=2)
        taker = CameraSets(camera, series)
        taker.prepare(series)
        least = taker.least_bytes()
        taker.take(tmp_path / "set")
    taken = sum(path.stat().st_size for path in tmp_path.rglob("*") if path.is_file())
    assert 0.3 * taken < least <= taken


def test_a_set_that_is_not_trustworthy_is_named(run: Run) -> None:
    faults = ("-O", "size=160x120", "--repeat", "2", "-O", "faults=wrong@5=2,wrong@7=2", "-n", "3")
    ran = run("series", *faults, "-o", "day")
    wrong = [each["folder"] for each in sets() if each["trustworthy"] is False]
    assert len(wrong) == 1
    assert (ran.status, f"{wrong[0]} is not trustworthy: " in ran.err) == (3, True)


def test_json_of_a_series_is_its_journal(run: Run) -> None:
    found = run(*TINY, "--repeat", "2", "--name", "a {number}", "--json", "-o", "day").json
    assert (found["completed"], found["failed"]) == (2, 0)
    assert [each["folder"] for each in found["sets"]] == ["a 0001", "a 0002"]
    assert {"effective_levels", "response", "dynamic_range"} <= set(found["sets"][0])


def test_a_series_has_a_folder_of_its_own(run: Run) -> None:
    assert run(*TINY, "--repeat", "1").status == 0
    (folder,) = Path().iterdir()
    assert folder.name.startswith("series-20")
    error = run(*TINY, "--repeat", "1", "-o", folder.name).error
    assert error.startswith(f"{folder.name} is not empty")


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--interval 5", "a series needs its number of sets; give it with --repeat N"),
        ("--repeat 2 --hook ''", "--hook is empty"),
        ("--repeat 0", "invalid value for --repeat"),
        ("--repeat 2 --interval 0", "invalid value for --interval"),
        ("--repeat 2 --name ../x", "invalid folder name '../x'"),
        ("--repeat 2 --name {n}", "unknown field of a name '{n}'"),
        ("--repeat 2 --name day-%03n", "unknown field of a name '%03n', which is one of gphoto2"),
        ("--repeat 2 --force", "unknown option '--force'"),
        ("--on-key", "--on-key needs a terminal on standard input"),
        ("--on-key --interval 3", "--on-key cannot be combined with --interval"),
        ("--repeat 2 --meter twice", "unknown time to meter 'twice'"),
    ],
)
def test_contradictions_are_refused_before_anything_is_shot(
    run: Run, line: str, message: str
) -> None:
    import shlex

    ran = run(*TINY, *shlex.split(line), "-o", "day")
    assert ran.status == 2
    assert ran.error.startswith(message)
    assert not Path("day").exists()


def test_a_hook_gets_the_folder_of_each_set(run: Run) -> None:
    hook = 'echo "$CAMCTL_NUMBER $CAMCTL_FOLDER" >> hooks.txt; ls "$CAMCTL_FOLDER/report.json"'
    ran = run(*TINY, "--repeat", "2", "--hook", hook, "-o", "day", "--json")
    assert ran.json["completed"] == 2
    expected = [f"{k} {Path('day').resolve()}/set-000{k}" for k in (1, 2)]
    assert Path("hooks.txt").read_text().splitlines() == expected


def test_a_hook_that_fails_is_reported_and_the_series_goes_on(run: Run) -> None:
    hook = "echo first; echo the disk of the server is full >&2; exit $((CAMCTL_NUMBER - 1))"
    ran = run(*TINY, "--repeat", "3", "--hook", hook, "-o", "day")
    assert ran.status == 1
    assert ran.err.splitlines() == [
        "camctl: warning: set-0002: the hook failed with status 1: first the disk of the server is "
        "full",
        "camctl: warning: set-0003: the hook failed with status 2: first the disk of the server is "
        "full",
        "camctl: the hook failed after 2 of 3 sets; see day/index.html",
    ]
    assert [each["hook"] for each in sets()] == ["done", "failed", "failed"]


def test_a_hook_that_takes_too_long_is_ended_with_its_children(run: Run) -> None:
    hook = "sleep 1000 & echo $! > pid; wait"
    ran = run(*TINY, "--repeat", "1", "--hook", hook, "--hook-limit", "0.5", "-o", "day")
    assert "set-0001: the hook was ended after 500 ms" in ran.err
    process = Path("/proc", Path("pid").read_text().strip())
    while process.exists() and "\nState:\tZ" not in (process / "status").read_text():
        time.sleep(0.01)  # the kernel ends it


def test_sets_that_fail_are_counted_and_the_status_says_it(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = CameraSets.take

    def sometimes(taker: CameraSets, directory: Path) -> Any:
        if directory.name == "set-0002":
            raise CaptureError("the light went out")
        return take(taker, directory)

    monkeypatch.setattr(CameraSets, "take", sometimes)
    ran = run(*TINY, "--repeat", "3", "-o", "day")
    assert ran.status == 1
    assert ran.err.splitlines()[-1] == ("camctl: 1 of 3 sets failed (set-0002); see day/index.html")
    assert [each["state"] for each in sets()] == ["complete", "failed", "complete"]


@pytest.mark.parametrize(
    ("number", "status"),
    some([(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)], every=3, first=1),
)
def test_a_signal_keeps_what_was_shot_and_resume_goes_on(
    run: Run, monkeypatch: pytest.MonkeyPatch, number: signal.Signals, status: int
) -> None:
    frames, left = SimulatedCamera._frames, [4]

    def sending(camera: SimulatedCamera, settings: Any) -> Iterator[Any]:
        for frame in frames(camera, settings):
            left[0] -= 1
            if left[0] == 0:  # the second frame of the second set
                signal.raise_signal(number)
            yield frame

    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "_frames", sending)
        ran = run(*TINY, "--repeat", "3", "--hook", "true", "-o", "day")
    assert ran.status == status
    assert "1 of 3 sets are complete; continue the series (camctl resume day)" in ran.error
    assert sets()[1]["state"] == "begun"
    assert list(Path("day/set-0002/frames").glob("frame-01.npy"))
    again = run("resume", "day")
    assert (again.status, "3 of 3 complete" in again.out) == (0, True)
    assert again.err == (
        "camctl: warning: the series was begun with --hook, which is not kept: give it again\n"
    )
    assert [each["run"] for each in sets()] == [1, 2, 2]


def test_options_of_a_series_are_not_changed_when_it_is_resumed(run: Run) -> None:
    assert run(*TINY, "--repeat", "1", "-o", "day").status == 0
    for line in (["--repeat", "3"], ["-n", "2"], ["--name", "x", "--repeat", "2"]):
        assert "; the capture goes on with the options that" in run("resume", "day", *line).error


def test_a_journal_of_another_camera_is_not_opened_unasked(run: Run) -> None:
    assert run(*TINY, "--repeat", "1", "-o", "day").status == 0
    content = json.loads(Path("day/series.json").read_text())
    content["options"]["repeat"] = 2
    for source, message in (
        (
            {"camera": "coolpix:socket://192.0.2.1:1", "options": {}},
            "is not opened unless you name",
        ),
        ({}, "does not name the camera"),
    ):
        Path("day/series.json").write_text(json.dumps(content | {"source": source}))
        assert message in run("resume", "day").error
    by_hand = ("resume", "day", "--camera", "sim", "-O", "size=16x12")
    other = content | {"camera": content["camera"] | {"serial": "another"}}
    Path("day/series.json").write_text(json.dumps(other))
    assert "connect the same camera" in run(*by_hand).error
    Path("day/series.json").write_text(json.dumps(content))
    assert run(*by_hand).status == 0


PROGRAM = "import sys; from camctl.cli import main; sys.exit(main(sys.argv[1:]))"


def on_terminal(folder: Path, *arguments: str) -> Terminal:
    return Terminal(["-c", PROGRAM, *TINY, *arguments, "-o", str(folder)], columns=100)


def wait_for_sets(terminal: Terminal, folder: Path, count: int) -> None:
    """Wait until so many sets are complete."""
    while True:
        terminal._read(0.05)
        assert terminal.process.poll() is None, terminal.raw
        if (folder / "series.json").exists():
            found = json.loads((folder / "series.json").read_text())["sets"]
            if sum(each["state"] == "complete" for each in found) >= count:
                return


def test_keys_of_a_terminal_take_sets_and_end_the_series(tmp_path: Path) -> None:
    folder = tmp_path / "day"
    terminal = on_terminal(folder, "--on-key")
    try:
        while "set 1, waiting" not in terminal.raw:
            terminal._read(0.05)
        terminal.type("\r")
        wait_for_sets(terminal, folder, 1)
        terminal.type(" ")
        wait_for_sets(terminal, folder, 2)
        terminal.type("q")
        assert terminal.wait_for_end() == 0
        import termios

        assert termios.tcgetattr(terminal.slave) == terminal.before
        assert "2 complete" in terminal.raw
    finally:
        terminal.close()


@pytest.mark.slow
def test_a_series_on_a_terminal_pauses_and_says_when_it_will_end(tmp_path: Path) -> None:
    folder = tmp_path / "day"
    terminal = on_terminal(folder, "--repeat", "3", "--interval", "0.7", "-O", "time=real")
    try:
        wait_for_sets(terminal, folder, 1)
        terminal.type("p")
        while "paused: p goes on, q ends" not in terminal.raw:
            terminal._read(0.05)
        terminal.type("p")
        assert terminal.wait_for_end() == 0
        assert "ends about" in terminal.raw
        assert "3 of 3 complete" in terminal.raw
    finally:
        terminal.close()


@pytest.mark.slow
def test_a_killed_series_is_resumed(tmp_path: Path) -> None:
    folder = tmp_path / "day"
    line = [*TINY, "--repeat", "100", "--interval", "0.05", "-O", "time=real", "-o", str(folder)]
    process = subprocess.Popen([sys.executable, "-c", PROGRAM, *line])
    try:
        while not (folder / "set-0002").exists():
            assert process.poll() is None
            time.sleep(0.01)
    finally:
        process.kill()
        process.wait()
    content = json.loads((folder / "series.json").read_text())
    content["options"]["repeat"] = len(content["sets"]) + 1
    (folder / "series.json").write_text(json.dumps(content))
    hook = f"echo $CAMCTL_NUMBER >> {tmp_path}/numbers"
    resumed = subprocess.run(
        [sys.executable, "-c", PROGRAM, "resume", str(folder), "--hook", hook],
        capture_output=True,
        text=True,
        check=False,
    )
    assert resumed.returncode == 0, resumed.stderr
    states = [each["state"] for each in sets(str(folder))]
    assert states == ["complete"] * content["options"]["repeat"]
    # The hook is run for the sets that were taken now.
    last = str(content["options"]["repeat"])
    assert (tmp_path / "numbers").read_text().split()[-1] == last
