"""`camctl simulate`: brackets, tolerance, what it explains, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import tifffile

from sim.effects import effect_names

if TYPE_CHECKING:
    from conftest import Run

SMALL = ("--size", "64x48")


def decided(told: dict[str, Any]) -> dict[str, bool]:
    return {effect["name"]: effect["ran"] for effect in told["effects"]}


def test_a_street_at_night_calls_for_nearly_everything_and_a_dim_ramp_does_not(run: Run) -> None:
    night = run("simulate", "--scene", "night-street", "--time", "4", *SMALL, "--json").json
    ramp = run("simulate", "--scene", "ramp", "--time", "0.001", *SMALL, "--json").json
    assert list(decided(night)) == list(effect_names())
    for name in ("veiling glare", "blooming", "full well", "vignetting", "photon noise"):
        assert decided(night)[name], name
    for name in ("blooming", "full well", "crosstalk", "DSNU", "dark current"):
        assert not decided(ramp)[name], name
    assert sum(decided(night).values()) > sum(decided(ramp).values())
    for told in (night, ramp):
        assert 0 < told["joint_bound_dn"] <= told["tolerance_dn"] == 0.5


def test_the_default_differs_from_tolerance_0_by_no_more_than_was_promised(run: Run) -> None:
    words = ("simulate", "--scene", "ball", "--time", "0.002", *SMALL)
    told = run(*words, "-o", "some.tiff", "--json").json
    all_on = run(*words, "--tolerance", "0", "-o", "all.tiff", "--json").json
    assert all_on["joint_bound_dn"] == 0
    assert sum(decided(all_on).values()) > sum(decided(told).values())
    some, everything = (tifffile.imread(f"{name}.tiff").astype(int) for name in ("some", "all"))
    assert 0 < np.abs(some - everything).max() <= np.ceil(told["joint_bound_dn"])


def test_explain_shows_each_effect_with_its_bound_and_why(run: Run) -> None:
    told = run("simulate", *SMALL, "--scene", "ramp", "--time", "0.001", "--explain").out
    for name in effect_names():
        assert name in told
    for words in ("at most, DN", "left out", "pixel values are whole numbers", "DN of 0.5 allowed"):
        assert words in told


def test_a_bracket_shares_the_tolerance_and_is_planned_frame_by_frame(run: Run) -> None:
    words = ("simulate", "--scene", "room", *SMALL, "--time", "0.001", "--bracket", "1,8,512")
    told = run(*words, "-o", "room.npy", "--json").json
    assert [frame["time_s"] for frame in told["frames"]] == pytest.approx([0.001, 0.008, 0.512])
    assert [frame["file"] for frame in told["frames"]] == [f"room-{i}.npy" for i in (1, 2, 3)]
    assert all(frame["tolerance_dn"] == pytest.approx(0.5 / 3) for frame in told["frames"])
    assert told["joint_bound_dn"] <= told["tolerance_dn"] == 0.5
    first, *_, last = (decided(frame) for frame in told["frames"])
    assert not first["blooming"]
    assert last["blooming"]
    assert decided(told)["blooming"]
    means = [np.load(f"room-{i}.npy").mean() for i in (1, 2, 3)]
    assert means == sorted(means)
    listed = run("simulate", *SMALL, "--times", "1/100,1/50", "--json").json
    assert [frame["time_s"] for frame in listed["frames"]] == pytest.approx([0.01, 0.02])


def test_scenes_and_sensors_are_files_too(run: Run) -> None:
    scene = {"name": "mine", "picture": "wall", "luminance_cd_m2": 50, "target": {"size": 0.5}}
    Path("mine.json").write_text(json.dumps(scene))
    told = run("simulate", "--scene", "mine.json", *SMALL, "--time", "1/50", "--json").json
    assert decided(told)["motion blur"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--tolerance", "-1"), "--tolerance: -1 is not a tolerance of 0 DN or more"),
        (("--tolerance", "nan"), "--tolerance: nan is not finite"),
        (("--times", "1,x"), "--times: 'x' is not a time"),
        (("--times", "1", "--bracket", "1,2"), "--times and --bracket; give one of them"),
        (("--bracket", "1,-2"), "--bracket: exposure -2 is not positive"),
        (("--sensor", "complet"), "did you mean complete"),
        (("--scene", "nightstreet"), "did you mean night-street"),
        (("--scene", "ramp", "--size", "999999x999999"), "GiB"),
    ],
)
def test_what_is_off_is_one_line(run: Run, words: tuple[str, ...], said: str) -> None:
    ran = run("simulate", *words)
    assert said in ran.error
    assert ran.status in (1, 2)
