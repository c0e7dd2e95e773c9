"""calibrate delay and profile, on the simulated camera."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from camctl import backends as registry
from camctl.camera import Camera, CameraInfo
from camctl.controls import Layout
from camctl.profile import StillRecord, change_profile, list_profiles

if TYPE_CHECKING:
    from conftest import Run

SMALL = ("--size", "64x48")
PRINTER = CameraInfo("ptp:1", "Make", "Still 5", "77", "ptp")


def test_the_delay_is_measured_kept_and_shown(run: Run) -> None:
    told = run("calibrate", "delay", *SMALL, "--sensor", "mobile", "--json").json
    assert (told["mode"], told["frames"], told["smallest"], told["largest"], told["trials"]) == (
        "rggb10-64x48-30",
        3,
        3,
        3,
        12,
    )
    assert told["camera"]["id"] == "sim"
    (kept,) = list_profiles()
    assert Path(told["file"]).stem == kept.name
    (listed,) = run("profile", "list", "--json").json
    shown = run("profile", "show", kept.name, "--json").json
    assert listed == shown
    assert shown["delays"]["rggb10-64x48-30"]["frames"] == 3


def test_as_text_it_says_what_it_is_good_for_and_where_it_is(run: Run) -> None:
    ran = run("calibrate", "delay", *SMALL)
    assert "2 frames, in 12 trials" in ran.out
    assert "n exposures take n + 2 frames" in ran.out
    assert ran.out.rstrip().endswith(".json")
    varied = run("calibrate", "delay", *SMALL, "-O", "sensor=consumer", "--trials", "30").out
    assert "1 to 2 frames, not constant, in 30 trials" in varied
    assert "settles for 2 frames at each exposure" in varied
    text = run("profile", "list").out
    for each in list_profiles():
        assert each.name in text
        shown = run("profile", "show", each.name).out
        assert each.model in shown
        assert "delay in " in shown


def test_modes_of_one_camera_stand_side_by_side(run: Run) -> None:
    for size in ("64x48", "32x24"):
        assert run("calibrate", "delay", "--size", size, "--trials", "4").status == 0
    (kept,) = list_profiles()
    assert sorted(kept.delays) == ["mono8-32x24-30", "mono8-64x48-30"]


def test_what_files_are_made_of_is_shown(run: Run) -> None:
    record = StillRecord(rows=4, columns=6, layout=Layout.RGGB, bits=14, black=512, white=15000)
    change_profile(PRINTER, lambda profile: profile.stills.update(raw=record))
    (kept,) = list_profiles()
    shown = run("profile", "show", kept.name).out
    assert "6 x 4, rggb, 14 bits, black 512, white 15000" in shown
    assert "raw" in run("profile", "list").out


def test_remove_forgets_one(run: Run) -> None:
    run("calibrate", "delay", *SMALL, "--trials", "4")
    change_profile(PRINTER, lambda profile: None)
    first, second = list_profiles()
    assert run("profile", "remove", first.name).out.startswith("removed ")
    assert list_profiles() == [second]
    told = run("profile", "remove", second.name, "--json").json
    assert not Path(told["removed"]).exists()
    assert run("profile", "list").out.startswith("no profile in ")
    assert run("profile", "list", "--json").json == []


def test_a_name_that_is_off_names_the_near_ones(run: Run) -> None:
    change_profile(PRINTER, lambda profile: None)
    (kept,) = list_profiles()
    for command in ("show", "remove"):
        ran = run("profile", command, kept.name[:-2])
        assert ran.status == 2
        assert f"did you mean {kept.name}?" in ran.error


def test_a_damaged_profile_names_the_command_that_helps(run: Run) -> None:
    path = change_profile(PRINTER, lambda profile: None)
    path.write_text("{")
    ran = run("profile", "list")
    assert ran.status == 1
    help_line = f"camctl profile remove {path.stem}"
    assert help_line in ran.error
    assert run(*help_line.split()[1:]).status == 0
    assert run("profile", "list").status == 0


def test_a_measurement_that_cannot_be_kept_says_so(run: Run) -> None:
    Path(os.environ["CAMCTL_PROFILES"]).write_text("in the way")
    ran = run("calibrate", "delay", *SMALL, "--trials", "4")
    assert ran.status == 1
    assert "$CAMCTL_PROFILES" in ran.error


@pytest.mark.parametrize(
    ("words", "said", "status"),
    [
        (["--scene", "night-street", "--sensor", "ideal-8"], "too dark", 1),
        (["--camera", "smi"], "unknown camera 'smi'", 2),
    ],
)
def test_what_cannot_be_measured_gets_one_line(
    run: Run, words: list[str], said: str, status: int
) -> None:
    ran = run("calibrate", "delay", *words)
    assert said in ran.error
    assert ran.status == status
    assert list_profiles() == []


def test_a_still_camera_needs_no_delay(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: Camera = registry.open_camera("sim", {"size": "32x24"})

    class Still:
        def __init__(self) -> None:
            self.info, self.controls, self.clock = opened.info, opened.controls, opened.clock
            self.shoot, self.close = opened.shoot, opened.close

        def __enter__(self) -> Still:
            return self

        def __exit__(self, *_: object) -> None:
            self.close()

    monkeypatch.setattr(registry, "open_camera", lambda *_: Still())
    ran = run("calibrate", "delay")
    assert ran.error == "this camera does not stream; a still camera has no control delay"
    assert ran.status == 2
