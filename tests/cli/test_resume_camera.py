"""Which camera `camctl resume` opens: none that only a report asks for."""

from __future__ import annotations

import json
import os
import socket
import subprocess
from pathlib import Path
from typing import Any

import pytest
from command_line import Ran, Run

from camctl.interface.backends import is_local
from camctl.messages.command_line import with_remedies
from camctl.records.folder_store import resumption

SMALL = ("-O", "size=64x48", "--ratios", "1,4", "--base", "0.01")


@pytest.fixture
def begun(run: Run) -> Path:
    """A folder whose second frame is missing."""
    folder = Path("here")
    assert run("shoot", *SMALL, "-o", folder).status == 0
    (folder / "frames" / "frame-02.npy").unlink()
    edit(folder, status="incomplete")
    return folder


def edit(folder: Path, **changes: Any) -> None:
    report = json.loads((folder / "report.json").read_text())
    (folder / "report.json").write_text(json.dumps({**report, **changes}))


def resume(run: Run, *arguments: str | Path) -> Ran:
    return run("resume", "here", *arguments)


def test_report_with_a_spy_url_writes_no_file(run: Run, begun: Path) -> None:
    victim = Path("letter.txt").absolute()
    victim.write_text("dear")
    url = f"coolpix:spy:///dev/null?file={victim}"
    edit(begun, source={"camera": url, "options": {}})
    ran = resume(run)
    assert ran.status == 1
    assert ran.error == (
        f"here/report.json names the camera {url[:80]!r}, which is not opened unless you name it: "
        "it may lead to another machine; if you trust it: camctl resume here --camera ID"
    )
    assert victim.read_text() == "dear"


@pytest.mark.parametrize("scheme", ["socket", "rfc2217"])
def test_report_with_a_network_url_connects_to_nothing(run: Run, begun: Path, scheme: str) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.setblocking(False)
        port = server.getsockname()[1]
        edit(begun, source={"camera": f"coolpix:{scheme}://127.0.0.1:{port}", "options": {}})
        assert "is not opened unless you name it" in resume(run).error
        with pytest.raises(BlockingIOError):
            server.accept()


def test_the_user_can_name_the_camera(run: Run, begun: Path) -> None:
    edit(begun, source={"camera": "coolpix:socket://127.0.0.1:9", "options": {}})
    ran = resume(run, "--camera", "sim", *SMALL[:2], "--json")
    assert ran.json["status"] == "complete"


@pytest.mark.parametrize(
    ("camera_id", "named"),
    [("ptpip:10.0.0.2", " --camera ptpip:10.0.0.2"), ("sim", ""), ("v4l2:/dev/video0", "")],
)
def test_the_command_after_a_failure_names_a_camera_of_another_machine(
    camera_id: str, named: str
) -> None:
    remedies = {"resume": resumption(Path("red hall"), {"camera": camera_id, "options": {}})}
    assert with_remedies("", remedies) == f"(camctl resume 'red hall'{named})"


@pytest.mark.parametrize(
    ("camera_id", "options", "expected"),
    [
        ("sim", {}, True),
        ("sim", {"scene": "room", "seed": "3"}, True),
        ("sim", {"faults": {"unplug_after": 1}}, False),
        ("sim", {"seed": 3}, False),
        ("sim:7", {}, False),
        ("v4l2", {}, True),
        ("v4l2:/dev/video0", {"format": "y16"}, True),
        ("v4l2:/dev/v4l/by-id/usb-046d_C920_1-video-index0", {}, True),
        ("v4l2:/dev/../etc/passwd", {}, False),
        ("v4l2:/dev/video0/../../etc/passwd", {}, False),
        ("v4l2:/dev/v4l/by-id/../../../etc/passwd", {}, False),
        ("v4l2:/dev/video0\n", {}, False),
        ("ptp", {}, True),
        ("ptp:001:012", {}, True),
        ("ptp:2B05-11", {}, True),
        ("coolpix:/dev/ttyUSB0", {}, True),
        ("coolpix:COM3", {}, True),
        ("coolpix:/dev/serial/by-id/usb-FTDI_1-port0", {}, True),
        ("coolpix:/dev/sda", {}, False),
        ("coolpix:/dev/tty/../sda", {}, False),
        ("coolpix:spy:///dev/ttyUSB0?file=/etc/passwd", {}, False),
        ("coolpix:socket://127.0.0.1:9", {}, False),
        ("coolpix:loop://", {}, False),
        ("coolpix:hwgrep://0403", {}, False),
        ("nothing:/dev/video0", {}, False),
        ("", {}, False),
    ],
)
def test_only_devices_of_this_machine_are_local(
    camera_id: str, options: dict[str, Any], expected: bool
) -> None:
    assert is_local(camera_id, options) is expected


@pytest.mark.parametrize(
    "name",
    ["red hall", "$(touch pwn);x", "it's", "caf\udce9", "two\nlines", "a" * 200 + "/" + "b" * 200],
)
def test_the_command_that_goes_on_can_be_pasted(run: Run, name: str) -> None:
    Path(name).parent.mkdir(exist_ok=True)
    try:
        Path(name).mkdir()
        Path(name).rmdir()
    except OSError:
        pytest.skip("this file system has no such names")
    error = run("shoot", *SMALL, "-o", name, "-O", "faults=unplug@1").error
    command = error[error.index("camctl resume ") :].removesuffix(")")
    shell = ["bash", "-c", f"camctl() {{ printf '%s\\0' \"$@\"; }}; {command}"]
    printed = subprocess.run(shell, check=True, capture_output=True).stdout
    folder = os.fsdecode(printed.split(b"\0")[1])
    assert Path(folder).absolute() == Path(name).absolute()
    assert not Path("pwn").exists()
