"""`camctl calibrate delay` and `camctl profile`, on the simulated camera."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Run

from camctl.interface.camera import CameraInfo
from camctl.interface.controls import Layout
from camctl.profiles.calibrated import open_camera
from camctl.profiles.exposures import Correction, ExposureRecord, exposure_mode
from camctl.profiles.folder import list_profiles
from camctl.profiles.profile import StillRecord, change_profile
from camctl.sim.sensors.sensor import load_sensor

SMALL = ("-O", "size=64x48")
STILL_CAMERA = CameraInfo("ptp:1", "Make", "Still 5", "77", "ptp")


def test_delay_is_measured_kept_and_shown(run: Run) -> None:
    output = run("calibrate", "delay", *SMALL, "--sensor", "mobile", "--json").json
    assert output["mode"] == "rggb10-64x48-30"
    names = ("frames", "smallest", "largest", "trials")
    assert [output[name] for name in names] == [3, 3, 3, 12]
    assert output["camera"]["id"] == "sim"
    (kept,) = list_profiles()
    assert Path(output["file"]).stem == kept.name
    (listed,) = run("profile", "list", "--json").json["profiles"]
    shown = run("profile", "show", kept.name, "--json").json
    assert {**listed, "format_version": 1} == shown
    assert shown["delays"]["rggb10-64x48-30"]["frames"] == 3


def test_text_output_states_delay_consequence_and_file(run: Run) -> None:
    ran = run("calibrate", "delay", *SMALL)
    assert "2 frames, in 12 trials" in ran.out
    assert "n exposures take n + 2 frames" in ran.out
    assert "33.3 ms, jitter" in ran.out
    assert ran.out.rstrip().endswith(".json")
    varied = run("calibrate", "delay", *SMALL, "-O", "sensor=consumer", "--trials", "30").out
    assert "1 to 2 frames, not constant, in 30 trials" in varied
    assert "the camera waits 2 frames at each exposure" in varied
    text = run("profile", "list").out
    for each in list_profiles():
        assert each.name in text
        assert "control delay" in text
        shown = run("profile", "show", each.name).out
        assert each.model in shown
        assert "delay in " in shown


def test_a_delay_below_0_costs_no_frame(run: Run, tmp_path: Path) -> None:
    """The frame that is being exposed has the setting already."""
    sensor = {**load_sensor("standard").model_dump(mode="json"), "delay_frames": -1}
    (tmp_path / "early.json").write_text(json.dumps(sensor))
    ran = run("calibrate", "delay", *SMALL, "--sensor", str(tmp_path / "early.json"))
    assert "-1 frames, in 12 trials" in ran.out
    assert "n exposures take n frames" in ran.out


def test_profile_shows_file_formats(run: Run) -> None:
    record = StillRecord(rows=4, columns=6, layout=Layout.RGGB, bits=14, black=512, white=15000)
    change_profile(STILL_CAMERA, lambda profile: profile.stills.update(raw=record))
    (kept,) = list_profiles()
    shown = run("profile", "show", kept.name).out
    assert "6 x 4, rggb, 14 bits, black 512, white 15000" in shown
    assert "raw" in run("profile", "list").out


def test_remove_deletes_one_profile(run: Run) -> None:
    run("calibrate", "delay", *SMALL, "--trials", "4")
    change_profile(STILL_CAMERA, lambda profile: None)
    first, second = list_profiles()
    assert run("profile", "remove", first.name).out.startswith("removed ")
    assert list_profiles() == [second]
    output = run("profile", "remove", second.name, "--json").json
    assert not Path(output["removed"]).exists()
    assert run("profile", "list").out.startswith("no profiles in ")
    assert run("profile", "list", "--json").json == {"format_version": 1, "profiles": []}


def test_unknown_profile_suggests_similar_names(run: Run) -> None:
    change_profile(STILL_CAMERA, lambda profile: None)
    (kept,) = list_profiles()
    for command in ("show", "remove"):
        ran = run("profile", command, kept.name[:-2])
        assert ran.status == 2
        assert f"did you mean {kept.name}?" in ran.error


def test_damaged_profile_is_removed_with_the_suggested_command(run: Run) -> None:
    path = change_profile(STILL_CAMERA, lambda profile: None)
    path.write_text("{")
    ran = run("profile", "list")
    assert ran.status == 1
    suggestion = f"camctl profile remove {path.stem}"
    assert suggestion in ran.error
    assert run(*suggestion.split()[1:]).status == 0
    assert run("profile", "list").status == 0


SMALL_PHONE = ("--sensor", "phone", "-O", "size=240x180")


def test_true_exposures_are_measured_kept_and_not_used_where_they_are_estimated(run: Run) -> None:
    ran = run("calibrate", "exposure", *SMALL_PHONE, "--longest", "0.3", "--json")
    assert ran.status == 0
    found = ran.json
    assert found["mode"] == "rggb-240x180-1023"
    times = found["times"]
    assert len(times) > 5
    assert all(each["low"] <= each["factor"] <= each["high"] for each in times)
    assert [each["factor"] for each in times] == pytest.approx([1] * len(times), abs=2e-3)
    kept = json.loads(Path(found["file"]).read_text())
    assert kept["exposures"][found["mode"]]["times"] == times
    name = Path(found["file"]).stem
    shown = run("profile", "show", name)
    assert f"{len(times)} times" in shown.out
    ran = run("shoot", *SMALL_PHONE, "--ratios", "1,2,4", "--estimate-ratios", "--json")
    ratios = [frame["exposure_ratio"] for frame in ran.json["frames"]]
    assert [ratio["used"] for ratio in ratios] == ["estimate"] * 3
    assert ran.json["request"]["estimate_ratios"] is True


def test_exposures_are_measured_in_a_capture_that_is_done(run: Run) -> None:
    assert run("shoot", *SMALL_PHONE, "--ratios", "1,2,4", "-o", "here").status == 0
    ran = run("calibrate", "exposure", "--from", "here")
    assert ran.status == 0
    assert "true / stated" in ran.out
    assert "reference" in ran.out
    found = run("calibrate", "exposure", "--from", "here", "--json").json
    assert len(found["times"]) == 3
    assert found["camera"]["model"] == "simulated phone"


CURVED_OPTIONS = {"sensor": "consumer", "scene": "ramp", "size": "160x120", "unknown": True}
CURVED = ("--sensor", "consumer", "--scene", "ramp", "-O", "size=160x120", "-O", "unknown=yes")


@pytest.mark.slow
def test_exposures_and_noise_are_measured_through_a_response_that_is_given(run: Run) -> None:
    given = (*CURVED, "--response", "srgb", "--json")
    times = run("calibrate", "exposure", *given, "--repeats", "2").json["times"]
    assert [each["factor"] for each in times] == pytest.approx([1] * len(times), abs=0.02)
    found = run("calibrate", "noise", *given)
    true = load_sensor("consumer").noise_model.conversion_e_per_dn
    assert found.json["conversion_e_per_dn"]["value"] == pytest.approx(true, rel=0.1)
    assert found.err == ""


def wrong_exposures(value: float) -> None:
    """Keep exposures that are wrong by a smooth curve, as an unknown response makes them."""
    with open_camera("sim", {**CURVED_OPTIONS, "profile": "none"}) as camera:
        mode, info = exposure_mode(camera.controls), camera.info
    record = ExposureRecord(
        times=tuple(
            Correction(value=time_s, factor=factor, low=factor, high=factor)
            for time_s in np.geomspace(1e-4, 4, 40).tolist()
            for factor in [float(time_s**value)]
        ),
        gains=(Correction(value=1.0, factor=1.0, low=1.0, high=1.0),),
        interpolates=True,
        measured_at="2026-11-22",
    )
    change_profile(info, lambda profile: profile.exposures.update({mode: record}))


@pytest.mark.slow
def test_measured_exposures_are_named_where_they_contradict_the_pixels(run: Run) -> None:
    assert run("calibrate", "response", *CURVED).status == 0
    wrong_exposures(-0.9)
    ran = run("calibrate", "response", *CURVED)
    assert ran.status == 1
    assert "measured exposures in the camera's profile" in ran.error
    assert run("calibrate", "response", *CURVED, "-O", "profile=none").status == 0


@pytest.mark.parametrize(
    ("arguments", "problem"),
    [
        (("--from", "nowhere"), "cannot read nowhere"),
        (("--from", "here", "--repeats", "3"), "--from cannot be combined with --repeats"),
        (("--repeats", "1"), "invalid"),
    ],
)
def test_exposures_that_cannot_be_measured_are_one_line(
    run: Run, arguments: tuple[str, ...], problem: str
) -> None:
    ran = run("calibrate", "exposure", *arguments)
    assert ran.status in (1, 2)
    assert problem in ran.error
