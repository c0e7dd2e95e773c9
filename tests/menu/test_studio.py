"""The server of the studio: page, state, commands, pictures of the camera, captures."""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bracketed_photographs import film, photograph, save
from panel_fakes import FakeJob
from ptp_bench import bench
from site_client import ask_site
from studio_menu import MakeJob, job_with, start_menu

import camctl
from camctl import CaptureRequest, read_report
from camctl.errors import StorageError
from camctl.exposure.light import Metering
from camctl.interface.camera import Camera
from camctl.interface.controls import Layout
from camctl.menu.studio.sections import SECTIONS
from camctl.menu.studio.server import PAGE
from camctl.menu.studio.sight import Look, Sight, View, rendered
from camctl.menu.tables import STATES
from camctl.profiles.noise import Figure, GainNoise, NoiseRecord
from camctl.profiles.profile import Profile, save_profile
from camctl.sim.backend import SimulatedBackend
from camctl.sim.devices.ptp.properties import CHARGE
from camctl.system.picture_operations import png_pixels


class Client:
    """What a browser sends."""

    def __init__(self, url: str) -> None:
        self.url = url

    def ask(self, path: str, body: object = None, *, header: bool = True) -> tuple[int, bytes]:
        """Return (status, content); with a body it is sent by POST."""
        return ask_site(
            self.url + path,
            body=None if body is None else json.dumps(body).encode(),
            headers={"X-Camctl": "1"} if header else {},
        )

    def json(self, path: str) -> Any:
        """Return the answer that is JSON."""
        status, content = self.ask(path)
        assert status == 200, content
        return json.loads(content)

    def until(self, state: str) -> dict[str, Any]:
        """Return the state of the menu once it is this one."""
        shown: dict[str, Any] = {"version": 0, "state": ""}
        while shown.get("state") != state:
            shown = self.json(f"state?after={shown['version']}")
        return shown

    def command(self, **fields: object) -> int:
        """Send a command."""
        return self.ask("command", fields)[0]


Start = Callable[[MakeJob], Client]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """Return a function that starts a studio with a job."""
    threads: list[tuple[Client, threading.Thread]] = []

    def begin(make_job: MakeJob) -> Client:
        panel, menu = start_menu(tmp_path, make_job)
        client = Client(panel.url)
        threads.append((client, menu))
        return client

    yield begin
    for client, menu in threads:
        while client.json("state")["state"] != "menu":  # a menu that starts ignores it
            client.command(state="menu")
            time.sleep(0.02)
        client.command(seen="menu", action="quit")
        client.until("confirm")
        client.command(seen="confirm", action="quit")
        menu.join(20)
        assert not menu.is_alive()


def simulated() -> Camera:
    """Return a small simulated camera."""
    return SimulatedBackend().open("", {"size": "48x32"})


def test_each_state_of_the_menu_belongs_to_one_section() -> None:
    states = [state for section in SECTIONS for state in section.states]
    assert sorted(states) == sorted(STATES)


def test_each_section_has_a_script_that_is_served(start: Start) -> None:
    client = start(lambda _: FakeJob())
    assert client.ask("") == (200, PAGE)
    for name in ("studio.js", "studio.css", *(f"{each.name}.js" for each in SECTIONS)):
        assert client.ask(f"static/{name}")[0] == 200, name
    for path in ("static/../panel.py", "static/%2e%2e/panel.py", "static/x.js", "x", "live/x"):
        assert client.ask(path)[0] == 404, path


def test_commands_lead_through_a_capture_and_its_cancelling(start: Start) -> None:
    job = FakeJob()
    client = start(lambda _: job)
    assert client.until("idle")["camera"]["id"] == "sim"
    client.command(state="front")
    while len(client.until("front")["front"]) < 3:
        time.sleep(0.005)
    client.command(seen="front", index=2, take=True)
    assert client.until("review")["plan"]["effective_levels"] == 98.4
    job.frame_may_end.clear()
    client.command(seen="review", action="shoot")
    assert client.until("shooting")["state"] == "shooting"
    job.frame_started.wait(10)
    assert client.command(state="browsing") == 200  # leads nowhere while a capture runs
    client.command(seen="shooting", key="exit")
    assert "stopped after 0 frames" in client.until("cancelled")["error"]
    assert len(job.shot) == 1


def test_other_sites_and_wrong_choices_are_refused(start: Start) -> None:
    client = start(lambda _: FakeJob())
    assert client.ask("command", {"key": "enter"}, header=False)[0] == 403
    assert client.ask("captures/delete/x", {}, header=False)[0] == 403
    for wrong in ({"key": "fire"}, {"state": "x"}, {"more": 1}, [1], {"index": "x"}, "x" * 70000):
        assert client.ask("command", wrong)[0] in (400, 413), wrong


def test_capture_is_taken_looked_at_and_deleted(start: Start, tmp_path: Path) -> None:
    client = start(job_with(simulated))
    client.until("idle")
    assert (
        client.ask("live/picture?width=64&height=64&clip=1&peak=1&at=0.5,0.5")[1][:2] == b"\xff\xd8"
    )
    assert client.ask("live/picture?at=nan,2")[0] == 404
    client.command(seen="idle", action="shoot")
    client.until("review")
    client.command(seen="review", action="shoot")
    name = Path(client.until("result")["summary"]["folder"]).name
    names = {each["name"] for each in client.json(f"captures/files/{name}")}
    assert {"radiance.exr", "report.json", "preview.png", "frames/frame-01.npy"} <= names
    status, content = client.ask(f"captures/file/{name}/report.json")
    assert (status, content) == (200, (tmp_path / name / "report.json").read_bytes())
    found = client.json(f"captures/light/{name}?x=0.1&y=0.99")
    assert (found["row"], found["column"]) == (31, 4)
    assert 0 < found["deviation"][0] < found["light"][0]
    assert client.ask(f"captures/light/{name}?x=2&y=0")[0] == 400
    layers = [each["name"] for each in client.json("captures/layers")]
    assert "saturated" in layers
    for layer in layers:
        assert client.ask(f"captures/layer/{name}/{layer}")[1][:4] == b"\x89PNG"
    assert client.ask(f"captures/small/{name}")[1][:4] == b"\x89PNG"
    for other in ("..", "x", f"{name}/..", "%2e%2e%2f"):
        assert client.ask(f"captures/files/{other}")[0] == 404, other
    assert client.ask(f"captures/file/{name}/../menu.json")[0] == 404
    assert client.ask(f"captures/delete/{name}", {}) == (200, b"{}")
    assert not (tmp_path / name).exists()


def test_battery_and_card_are_shown_where_the_camera_states_them(start: Start) -> None:
    pair = bench(vendor="sony")
    client = start(job_with(pair.camera))
    shown = client.until("idle")
    while shown["reading"] is None:
        shown = client.json(f"state?after={shown['version']}")
    assert (shown["reading"]["battery_percent"], shown["reading"]["free_images"]) == (CHARGE, 999)


def test_choices_have_pictures_that_differ(start: Start) -> None:
    client = start(job_with(simulated))
    client.until("idle")
    client.command(state="response")
    costs: list[Any] = []
    while not costs or None in costs:
        shown = client.until("response")
        costs = shown["costs"]
        time.sleep(0.02)
    assert all(cost["has_picture"] for cost in costs)
    pictures = [png_pixels(client.ask(f"look/picture/{place}")[1]) for place in range(2)]
    assert pictures[0].shape == pictures[1].shape
    assert pictures[0].mean() > 1.2 * pictures[1].mean()  # log shows the shadows brighter
    assert client.ask("look/picture/99")[0] == 404


def test_picture_at_full_size_is_that_part_and_says_how_sharp_it_is() -> None:
    codes = np.full((60, 80), 100, np.uint8)
    codes[:, 40:] = 200
    codes[10, 10], codes[50, 70] = 255, 0
    view = View(1, codes, Layout.MONO, {})
    left = rendered(view, Look(20, 20, (0.1, 0.1)))
    edge = rendered(view, Look(20, 20, (0.5, 0.5)))
    assert left[2] > 0
    assert edge[2] > 10 * rendered(view, Look(20, 20, (0.9, 0.1)))[2]


def test_metering_frame_is_kept_with_its_saturated_samples() -> None:
    with SimulatedBackend().open("", {"size": "48x32"}) as camera:
        from camctl.interface.camera import PreviewingCamera
        from camctl.interface.controls import ExposureSetting

        assert isinstance(camera, PreviewingCamera)
        setting = ExposureSetting(camera.controls.time_s.nearest(0.5))
        frame = camera.preview(setting)
        sight = Sight()
        sight.show_frame(frame, camera.controls, Metering(0.02, setting, 1.0, 0.1, 1))
        view = sight.wait(0)
    assert view is not None
    saturated = frame.pixels >= frame.white
    assert saturated.any()
    np.testing.assert_array_equal(view.codes == 255, saturated)
    assert sum(view.facts["histogram"]) == pytest.approx(1.0)
    assert view.facts["clipped"] == pytest.approx(saturated.mean(), abs=0.02)


def test_photographs_that_are_sent_become_a_capture(start: Start, tmp_path: Path) -> None:
    client = start(lambda _: FakeJob())
    client.until("idle")
    names = []
    taken = json.loads(client.ask("merge/begin", {})[1])["set"]
    for place, time_s in enumerate((1 / 60, 1 / 15, 1 / 4)):
        path = save(tmp_path / f"photograph{place}.png", film(photograph(time_s)))
        names.append(path.name)
        address = f"{client.url}merge/file/{taken}/{path.name}"
        headers = {"X-Camctl": "1"}
        assert ask_site(address, body=path.read_bytes(), headers=headers)[0] == 200
        assert ask_site(address, body=path.read_bytes(), headers=headers)[0] == 409
    wrong: list[dict[str, object]] = [
        {"times": "1/60, 0"},
        {"times": "1/0"},
        {"response": "x"},
        {"files": []},
    ]
    for each in wrong:
        asked = {"files": names, "times": "", "response": "log", **each}
        assert client.ask(f"merge/merge/{taken}", asked)[0] == 400
    asked = {"files": names, "times": "1/60 1/15 1/4", "response": "linear"}
    status, content = client.ask(f"merge/merge/{taken}", asked)
    assert status == 200, content
    report = read_report(tmp_path / json.loads(content)["capture"])
    assert report.request.response == "linear"
    assert len(report.frames) == 3
    assert client.ask(f"merge/merge/{taken}", asked)[0] == 404  # it is done
    assert not list(tmp_path.glob(".photographs-*"))


@pytest.mark.parametrize("name", ["../x.png", ".x", "a%2fb.png", "%00.png", ""])
def test_photographs_have_plain_names(start: Start, name: str) -> None:
    client = start(lambda _: FakeJob())
    client.until("idle")
    taken = json.loads(client.ask("merge/begin", {})[1])["set"]
    assert client.ask(f"merge/file/{taken}/{name}", 0)[0] == 400


def test_what_is_no_photograph_is_said_by_its_name(start: Start, tmp_path: Path) -> None:
    client = start(lambda _: FakeJob())
    client.until("idle")
    taken = json.loads(client.ask("merge/begin", {})[1])["set"]
    names = ["hosts.txt", "more.txt"]
    for name in names:
        assert client.ask(f"merge/file/{taken}/{name}", "127.0.0.1")[0] == 200
    asked = {"files": names, "times": "1, 2", "response": "log"}
    status, content = client.ask(f"merge/merge/{taken}", asked)
    assert status == 422
    assert b"hosts.txt" in content
    assert str(tmp_path).encode() not in content


def test_merge_that_fails_leaves_no_folder(
    start: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def merge_on_a_full_disk(_: object, __: object, result: Path, **___: object) -> None:
        (result / "frames").mkdir(parents=True)
        raise StorageError("cannot write frame-02.npy: the disk is full", hint="free some space")

    monkeypatch.setattr("camctl.photographs.merge.merge", merge_on_a_full_disk)
    client = start(lambda _: FakeJob())
    client.until("idle")
    taken = json.loads(client.ask("merge/begin", {})[1])["set"]
    asked = {"files": [], "times": "", "response": "log"}
    status, content = client.ask(f"merge/merge/{taken}", asked)
    assert status == 422
    assert b"the disk is full; free some space" in content
    assert not list(tmp_path.glob("capture-*"))


def test_profiles_are_listed_and_drawn(start: Start, own_profiles: Path) -> None:
    client = start(lambda _: FakeJob())
    client.until("idle")
    assert client.json("settings/profiles") == []
    assert client.ask("settings/plot/x")[0] == 404
    with simulated() as camera:
        profile = Profile.of(camera.info)
    save_profile(profile)
    assert client.ask(f"settings/plot/{profile.name}")[0] == 422  # nothing was measured
    figure = Figure(value=5.0, low=4.9, high=5.1)
    at_gain_1 = GainNoise(
        gain=1.0, conversion_e_per_dn=figure, read_noise_e=figure, patches=1000, misfit=1.0
    )
    well = Figure(value=6000.0, low=5900.0, high=6100.0)
    profile.add_noise(
        "mono",
        NoiseRecord(gains=(at_gain_1,), full_well_e=well, saturates=True, measured_at="2026-11-22"),
    )
    save_profile(profile)
    assert [each["noise"] for each in client.json("settings/profiles")] == [["mono"]]
    status, content = client.ask(f"settings/plot/{profile.name}")
    if find_spec("matplotlib") is None:
        assert status == 422
    else:
        assert content.startswith(b"\x89PNG")


def test_picture_of_a_series_is_looked_at(start: Start, tmp_path: Path) -> None:
    folder = tmp_path / "series-0001-20261125-120000" / "set-0001"
    with simulated() as camera:
        camctl.capture(camera, CaptureRequest(count=2), folder)
    client = start(lambda _: FakeJob())
    client.until("idle")
    name = f"{folder.parent.name}/{folder.name}"
    files = [each["name"] for each in client.json(f"captures/files/{name}")]
    assert {"report.json", "radiance.exr"} <= set(files)
    for path in (*files, "preview.png"):
        assert client.ask(f"captures/file/{name}/{path}")[0] == 200, path
    assert client.ask(f"captures/small/{name}")[0] == 200
    assert client.json(f"captures/light/{name}?x=0.5&y=0.5")["light"][0] > 0
    report = folder / "report.json"
    told = json.loads(report.read_text("utf-8"))
    told["frames"][0]["details"] = {"quarter_turns": 3}
    report.write_text(json.dumps(told), "utf-8")
    (folder / "radiance.exr").touch()
    found = client.json(f"captures/light/{name}?x=0.9&y=0.1")
    assert (found["row"], found["column"]) == (3, 4)  # of 32 rows and 48 columns
    _, layer = client.ask(f"captures/layer/{name}/dark")
    assert struct.unpack(">II", layer[16:24]) == (32, 48)  # columns and rows of a PNG file
    for wrong in (folder.parent.name, f"{name}/x", f"{folder.parent.name}/../{name}", f"./{name}"):
        assert client.ask(f"captures/files/{wrong}")[0] == 404, wrong
    assert client.ask(f"captures/delete/{name}", {})[0] == 200
    assert not folder.exists()
