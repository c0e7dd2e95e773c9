"""shoot, simulate, cameras and menu, on the simulated camera."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest
import tifffile

from camctl import backends as registry
from camctl.camera import CameraInfo
from camctl.errors import CameraNotFoundError
from sim.backend import SimulatedBackend
from sim.camera import Faults, SimulatedCamera
from sim.scenes.scene import load_scene
from sim.sensors.sensor import load_sensor

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from conftest import Run

SMALL = ("--size", "64x48")
RESULT = {"sum.tiff", "image.tiff", "radiance.exr", "preview.png", "report.json", "frames"}


def shot(run: Run, *words: str | Path) -> Any:
    return run("shoot", *SMALL, *words, "--json").json


def test_shoot_without_options_is_the_main_job(run: Run) -> None:
    ran = run("shoot")
    assert ran.status == 0
    (folder,) = Path().iterdir()
    assert folder.name.startswith("capture-20")
    assert {path.name for path in folder.iterdir()} == RESULT
    report = json.loads((folder / "report.json").read_text())
    assert report["plan"]["response"] == "log"
    assert report["plan"]["dynamic_range"] == 1000
    assert len(report["frames"]) == 3
    assert report["camera"]["id"] == "sim"
    for words in ("log, 1:1,000, in 3 exposures", "effective levels", str(folder), "sum.tiff"):
        assert words in ran.out
    assert ran.err == ""


def test_shoot_gives_all_that_scripts_rely_on(run: Run) -> None:
    told = shot(run, "-o", "here", "--range", "low", "-n", "2")
    assert told == json.loads(Path("here/report.json").read_text())
    assert {"make", "model", "serial", "driver"} <= set(told["camera"])
    plan = {"response", "dynamic_range", "ratios", "base_s", "xi", "effective_levels"}
    assert plan <= set(told["plan"])
    frame = {"file", "requested_s", "applied_s", "exposure", "black", "white"}
    frame |= {"saturated_fraction", "timestamp_s"}
    for each in told["frames"]:
        assert frame <= set(each)
    assert {"xi", "effective_levels", "levels", "levels_distinct"} <= set(told["achieved"])
    assert told["timing"]
    assert told["files"]


def test_sum_is_that_of_the_frames_named(run: Run) -> None:
    told = shot(run, "-o", "here", "--sensor", "phone")
    total = sum(
        np.minimum(np.load(Path("here", each["file"])), each["white"]).astype(np.int64)
        for each in told["frames"]
    )
    assert np.array_equal(tifffile.imread("here/sum.tiff"), total)


def test_options_reach_the_plan(run: Run) -> None:
    told = shot(run, "-o", "a", "--ratios", "4,1,2", "--base", "1/500", "--levels", "300")
    assert told["plan"]["ratios"] == [1, 2, 4]
    assert told["plan"]["base_s"] == pytest.approx(1 / 500)
    assert told["plan"]["levels_wanted"] == 300
    assert [each["applied_s"] for each in told["frames"]] == pytest.approx([0.002, 0.004, 0.008])
    longer = shot(run, "-o", "b", "--ratios", "1,2", "--base", "0.002", "--compensation", "2")
    assert longer["plan"]["base_s"] == pytest.approx(0.008)
    lamps = shot(run, "-o", "c", "--ratios", "1,2", "--mains", "50")
    assert lamps["request"]["mains_hz"] == 50
    assert shot(run, "-o", "d", "--aperture")["request"]["use_aperture"] is True
    assert shot(run, "-o", "e", "--meter")["request"]["spend_shutter"] is True


def test_seed_makes_the_noise(run: Run) -> None:
    words = ("--ratios", "1,2", "--base", "0.01")
    for name, seed in (("a", "1"), ("b", "1"), ("c", "2")):
        shot(run, *words, "--seed", seed, "-o", name)
    sums = [tifffile.imread(f"{name}/sum.tiff") for name in "abc"]
    assert np.array_equal(sums[0], sums[1])
    assert not np.array_equal(sums[0], sums[2])


def test_warnings_go_to_standard_error(run: Run) -> None:
    ran = run("shoot", *SMALL, "--base", "1/500", "--ratios", "1,2", "--mains", "50", "--json")
    assert ran.json["warnings"]
    for warning in ran.json["warnings"]:
        assert f"camctl: warning: {warning}\n" in ran.err


def test_fresh_folders_in_one_second_are_different(run: Run) -> None:
    for _ in range(2):
        assert run("shoot", *SMALL, "--ratios", "1", "--base", "0.01").status == 0
    assert len(list(Path().iterdir())) == 2


def test_an_earlier_capture_is_replaced_only_with_force(run: Run) -> None:
    shot(run, "-o", "here", "--seed", "1")
    before = Path("here/sum.tiff").read_bytes()
    ran = run("shoot", *SMALL, "-o", "here", "--seed", "2")
    assert ran.status == 1
    assert "here is not empty" in ran.error
    assert "--force" in ran.error
    assert Path("here/sum.tiff").read_bytes() == before
    shot(run, "-o", "here", "--seed", "2", "--force")
    assert Path("here/sum.tiff").read_bytes() != before


def test_a_folder_of_other_things_is_never_replaced(run: Run) -> None:
    Path("here").mkdir()
    Path("here/letter.txt").write_text("dear")
    ran = run("shoot", *SMALL, "-o", "here", "--force")
    assert ran.status == 1
    assert "here is not empty" in ran.error
    assert Path("here/letter.txt").read_text() == "dear"


class FaultyRoad:
    """The simulated camera, with faults the first time it is opened."""

    faults: Faults | None = None

    def open(self, address: str, options: Mapping[str, str]) -> SimulatedCamera:
        faults, FaultyRoad.faults = FaultyRoad.faults, None
        scene = load_scene("tile-floor", (48, 64))
        seed = int(options.get("seed", "0"))
        return SimulatedCamera(scene, load_sensor("standard"), seed=seed, faults=faults)


def test_resume_completes_a_broken_capture(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(registry, "load", lambda *_: FaultyRoad)
    FaultyRoad.faults = Faults(unplug_after=1)
    broken = run("shoot", "--seed", "4", "-o", "here")
    assert broken.status == 1
    assert "camctl shoot --resume here" in broken.error
    kept = json.loads(Path("here/report.json").read_text())
    assert kept["source"] == {"camera": "sim", "options": {"seed": "4"}}
    assert kept["status"] == "incomplete"
    ran = run("shoot", "--resume", "here", "--json")
    assert ran.json["status"] == "complete"
    assert all(ran.json["frames"])
    assert ran.json["plan"] == kept["plan"]


def test_interrupted_capture_says_how_to_go_on(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    shoot = SimulatedCamera.shoot

    def one_frame(self: SimulatedCamera, settings: Any) -> Any:
        frames = shoot(self, settings)
        yield next(frames)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(SimulatedCamera, "shoot", one_frame)
        ran = run("shoot", *SMALL, "-o", "here")
    assert ran.status == 130
    assert "camctl shoot --resume here" in ran.error
    assert run("shoot", "--resume", "here").status == 0
    again = run("shoot", "--resume", "here")
    assert again.status == 1
    assert "here is complete" in again.error


def test_options_of_the_camera_are_kept_for_resuming(run: Run) -> None:
    words = ("-O", "scene=room", "-O", "sensor=phone")
    told = shot(run, *words, "-o", "here")
    options = {"scene": "room", "sensor": "phone", "size": "64x48"}
    assert told["source"] == {"camera": "sim", "options": options}
    assert told["layout"] == "rggb"
    Path("here/frames/frame-02.npy").unlink()
    report = json.loads(Path("here/report.json").read_text())
    Path("here/report.json").write_text(json.dumps({**report, "status": "incomplete"}))
    again = run("shoot", "--resume", "here", "--json").json
    assert again["layout"] == "rggb"
    assert all(again["frames"])


def test_a_word_stays_a_word_where_a_file_is_called_so(run: Run) -> None:
    Path("room").write_text("no scene")
    assert shot(run, "--scene", "room", "-o", "here")["source"]["options"]["scene"] == "room"


def test_a_stream_that_settles_for_each_exposure_says_so_once(run: Run) -> None:
    ran = run("shoot", *SMALL, "--sensor", "consumer", "-o", "here", "--json")
    (note,) = [warning for warning in ran.json["warnings"] if "settles" in warning]
    assert "not constant" in note
    assert ran.err.count(note) == 1
    assert "settles" not in run("shoot", *SMALL, "-o", "steady").err


def test_report_finds_the_scene_from_any_folder(run: Run) -> None:
    np.save("map.npy", np.geomspace(1, 100, 48 * 64).reshape(48, 64))
    told = run("shoot", "--scene", "map.npy", "-o", "here", "--json").json
    assert told["source"]["options"]["scene"] == str(Path("map.npy").resolve())


HDR = np.ones((4, 4), dtype=np.float32)


@pytest.mark.parametrize(
    ("words", "message", "status"),
    [
        (["--camera", "smi"], "unknown camera 'smi'; did you mean sim?", 2),
        (["--camera", "sim:7"], "no camera sim:7", 1),
        (["--scene", "tile-flor"], "unknown scene 'tile-flor'; did you mean tile-floor", 2),
        (["--scene", "nix.hdr"], "nix.hdr", 1),
        (["--scene", "nan.npy"], "scene nan.npy: 1 of 16 pixels is NaN", 1),
        (["--scene", "negative.npy"], "1 of 16 pixels is negative", 1),
        (["--scene", "dark.npy"], "there is nothing in it", 1),
        (["--sensor", "fone"], "unknown sensor 'fone'; did you mean phone", 2),
        (["--sensor", "bad.json"], "bad.json: not JSON", 1),
        (["--base", "100"], "beyond the camera's", 1),
        (["--base", "10", "--ratios", "1,1000"], "is beyond the camera's controls", 1),
        (["--resume", "nix"], "nix holds no capture: report.json is missing", 1),
        (["--resume", "damaged"], "report.json is damaged", 1),
        (["-o", "dark.npy/x"], "cannot write", 1),
    ],
)
def test_what_cannot_be_shot_gets_one_line(
    run: Run, words: list[str], message: str, status: int
) -> None:
    for name, value in (("nan", np.nan), ("negative", -1.0)):
        light = HDR.copy()
        light[1, 2] = value
        np.save(f"{name}.npy", light)
    np.save("dark.npy", 0 * HDR)
    Path("bad.json").write_text("{")
    Path("damaged").mkdir()
    Path("damaged/report.json").write_text('{"status": "complete"}')
    before = {path.name for path in Path().iterdir()}
    ran = run("shoot", *words)
    assert message in ran.error
    assert ran.status == status
    assert {path.name for path in Path().iterdir()} == before


def test_cameras(run: Run) -> None:
    told = run("cameras", "--json").json
    (camera,) = [each for each in told if each["id"] == "sim"]
    assert set(camera) == {"id", "make", "model", "serial", "driver"}
    out = run("cameras").out
    cameras, roads = out.split("\n\n")
    assert any(line.startswith("sim ") for line in cameras.splitlines()[1:])
    (road,) = [line for line in roads.splitlines() if line.startswith("sim ")]
    assert road.split() == ["sim", "1", *SimulatedBackend.about.split()]


class Blind:
    about = "cameras in the dark"

    def discover(self, *, probe: bool = False) -> None:
        raise CameraNotFoundError("the bus is closed", hint="open it")


class Serial:
    def discover(self, *, probe: bool = False) -> list[CameraInfo]:
        return [CameraInfo("serial:1", "Make", "Old", "", "serial")] * probe


def roads(monkeypatch: pytest.MonkeyPatch, **kinds: type) -> None:
    monkeypatch.setattr(registry, "_entry_points", lambda _: kinds)
    monkeypatch.setattr(registry, "load", lambda _group, _kind, name: kinds[name])


def test_cameras_says_which_road_could_not_look(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    roads(monkeypatch, blind=Blind)
    ran = run("cameras", "--json")
    assert ran.json == []
    assert ran.err == "camctl: warning: blind: the bus is closed; open it\n"
    told, road = run("cameras").out.split("\n\n")
    assert told == "no camera found"
    assert road.splitlines()[1].split(maxsplit=3) == [
        "blind",
        "cannot",
        "look",
        "cameras in the dark",
    ]


def test_only_probing_speaks_to_what_may_be_no_camera(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    roads(monkeypatch, serial=Serial)
    assert run("cameras", "--json").json == []
    assert [each["id"] for each in run("cameras", "--probe", "--json").json] == ["serial:1"]


def test_simulate_gives_all_that_scripts_rely_on(run: Run) -> None:
    told = run("simulate", *SMALL, "--json").json
    assert {"tolerance_dn", "joint_bound_dn", "effects", "seconds"} <= set(told)
    for effect in told["effects"]:
        assert set(effect) == {"name", "bound_dn", "ran", "why"}
    ran = {effect["name"]: effect["ran"] for effect in told["effects"]}
    assert ran["photon noise"]
    assert not ran["colour mosaic"]
    assert (told["width"], told["height"]) == (64, 48)
    ideal = run("simulate", *SMALL, "--sensor", "ideal-6", "--json").json
    assert not {e["name"]: e["ran"] for e in ideal["effects"]}["photon noise"]


@pytest.mark.parametrize("suffix", ["tiff", "png", "npy"])
@pytest.mark.parametrize(("sensor", "scene"), [("machine-vision", "ramp"), ("consumer", "colour")])
def test_simulate_writes_the_frame(run: Run, suffix: str, sensor: str, scene: str) -> None:
    if scene == "colour":
        scene = "colour.npy"
        np.save(scene, np.random.default_rng(1).uniform(1, 9, (48, 64, 3)))
    size = () if scene == "colour.npy" else SMALL
    words = ("simulate", "--sensor", sensor, "--scene", scene, *size, "--seed", "3")
    told = run(*words, "-o", f"frame.{suffix}", "--json").json
    readers: dict[str, Callable[[str], Any]] = {
        "tiff": tifffile.imread,
        "png": partial(cv2.imread, flags=cv2.IMREAD_UNCHANGED),
        "npy": np.load,
    }
    pixels = readers[suffix](f"frame.{suffix}")
    assert told["file"] == f"frame.{suffix}"
    assert (int(pixels.min()), int(pixels.max())) == (told["minimum"], told["maximum"])
    assert pixels.mean() == pytest.approx(told["mean"])
    run(*words, "-o", "same.npy")
    order = pixels[..., ::-1] if suffix == "png" and pixels.ndim == 3 else pixels
    assert np.array_equal(order, np.load("same.npy"))


def test_simulate_as_text(run: Run) -> None:
    ran = run("simulate", *SMALL, "--time", "1/50")
    for words in ("64 x 48, mono", "20 ms, gain 1", "photon noise", "-o FILE writes"):
        assert words in ran.out
    assert ran.err == ""


def test_simulate_takes_the_nearest_setting_and_says_so(run: Run) -> None:
    ran = run("simulate", *SMALL, "--time", "0.0100049", "--json")
    assert ran.json["time_s"] == pytest.approx(0.01)
    assert "the sensor has no shutter time of 0.0100049: 0.01 is taken" in ran.err


def test_simulate_replaces_a_file_only_with_force(run: Run) -> None:
    Path("a.npy").write_text("mine")
    ran = run("simulate", *SMALL, "-o", "a.npy")
    assert ran.status == 1
    assert ran.error == "a.npy exists; choose another name, or say --force"
    assert Path("a.npy").read_text() == "mine"
    assert run("simulate", *SMALL, "-o", "a.npy", "--force").status == 0
    assert "unknown kind of file '.jpg'" in run("simulate", "-o", "a.jpg").error
    assert "cannot write nix/a.png" in run("simulate", *SMALL, "-o", "nix/a.png").error


def test_menu_needs_a_terminal(run: Run) -> None:
    ran = run("menu", *SMALL)
    assert ran.status == 2
    assert "the terminal panel needs a terminal" in ran.error


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--panel", "termnal"], "unknown panel 'termnal'; did you mean terminal?"),
        (["--panel", "terminal:7"], "panel 'terminal' takes no address; say --panel terminal"),
        (["--camera", "smi"], "unknown camera 'smi'"),
        (["--scene", "nix"], "unknown scene 'nix'"),
    ],
)
def test_menu_words_that_are_off(run: Run, words: list[str], message: str) -> None:
    ran = run("menu", *words)
    assert message in ran.error
    assert ran.status == 2


def test_menu_shoots_into_the_folder_that_was_named(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    import menu.app
    from menu.ports import Choice, Job, Summary

    def picked(panel: object, job: Job) -> Summary:
        return job.shoot(job.plan(Choice("log", 256.0, 2)), lambda _: None, lambda: False)

    monkeypatch.setattr(menu.app, "run", picked)
    ran = run("menu", *SMALL, "-o", "pictures", "--mains", "50")
    (folder,) = Path("pictures").iterdir()
    assert ran.out == f"the last picture is in {folder}\n"
    report = json.loads((folder / "report.json").read_text())
    assert report["source"] == {"camera": "sim", "options": {"size": "64x48"}}
    assert report["request"]["mains_hz"] == 50
    assert len(report["frames"]) == 2
