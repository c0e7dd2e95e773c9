"""`camctl cameras`, with the built-in backends and with ones made for the test."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from command_line import Run

import camctl
from camctl.errors import CameraNotFoundError
from camctl.interface import backends
from camctl.interface.camera import CameraInfo
from camctl.sim.backend import SimulatedBackend


def test_simulated_camera_and_its_backend_are_listed(run: Run) -> None:
    (camera,) = [each for each in run("cameras", "--json").json["cameras"] if each["id"] == "sim"]
    assert set(camera) == {"id", "make", "model", "serial", "driver", "remark"}
    cameras, searches = run("cameras").out.split("\n\n")
    assert any(line.startswith("sim ") for line in cameras.splitlines()[1:])
    assert searches.splitlines()[0].split() == ["backend", "found", "cameras"]
    (search,) = [line for line in searches.splitlines() if line.startswith("sim ")]
    assert search.split() == ["sim", "1", *SimulatedBackend.about.split()]


class FailingBackend:
    about = "cameras on a closed bus"

    def discover(self, *, probe: bool = False) -> None:
        raise CameraNotFoundError("the bus is closed", hint="open it")


class SerialBackend:
    def discover(self, *, probe: bool = False) -> list[CameraInfo]:
        return [CameraInfo("serial:1", "Make", "Old", "", "serial")] * probe


def replace_backends(monkeypatch: pytest.MonkeyPatch, **kinds: type) -> None:
    """Let these be all backends there are."""
    monkeypatch.setattr(backends, "_entry_points", lambda _: kinds)
    monkeypatch.setattr(backends, "load", lambda _group, _kind, name: kinds[name])


def test_failed_search_is_a_warning(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    replace_backends(monkeypatch, closed=FailingBackend)
    ran = run("cameras", "--json")
    assert ran.json == {"format_version": 1, "cameras": []}
    assert ran.err == "camctl: warning: closed: the bus is closed; open it\n"
    cameras, searches = run("cameras").out.split("\n\n")
    assert cameras == "no camera found"
    assert " ".join(searches.splitlines()[1].split()) == (
        "closed search failed cameras on a closed bus"
    )


class RecordedBackend:
    def discover(self, *, probe: bool = False) -> list[CameraInfo]:
        return [CameraInfo("usb:/by-id/12345678", "Make", "New", "12345678", "usb")]

    def record(self, address: str) -> dict[str, Any]:
        assert address == "/by-id/12345678"
        return {"found": {}}


def test_what_cameras_say_is_recorded_without_their_ids(
    run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    replace_backends(monkeypatch, closed=FailingBackend, serial=SerialBackend, usb=RecordedBackend)
    file = tmp_path / "cameras.json"
    assert run("cameras", "--record", file, "--probe").status == 0
    record = json.loads(file.read_text())
    assert record == {
        "format_version": 1,
        "camctl": camctl.__version__,
        "cameras": [{"backend": "usb", "found": {}}],
    }
    assert run("cameras", "--record", file).status == 1  # it exists
    assert run("cameras", "--record", file, "--force").status == 0
    for others in (("--force",), ("--record", file, "--json"), ("--record", file, "--udev-rules")):
        assert run("cameras", *others).status == 2


def test_serial_cameras_are_found_only_with_probe(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_backends(monkeypatch, serial=SerialBackend)
    assert run("cameras", "--json").json["cameras"] == []
    assert [each["id"] for each in run("cameras", "--probe", "--json").json["cameras"]] == [
        "serial:1"
    ]
