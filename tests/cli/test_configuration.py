"""Defaults of the user's own: the configuration file and $CAMCTL_CAMERA."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeAlias

import pytest
from command_line import Run
from sampling import some

SMALL = ("-O", "size=64x48")
Configure: TypeAlias = Callable[[str], Path]


@pytest.fixture
def configure(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Configure:
    """Write the user's configuration file."""
    path = tmp_path / "config.toml"
    monkeypatch.setenv("CAMCTL_CONFIG", str(path))

    def write(text: str) -> Path:
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_response_range_and_folder_are_defaults(run: Run, configure: Configure) -> None:
    configure('response = "gamma"\nrange = 300\nfolder = "pictures/today"\n')
    ran = run("shoot", *SMALL, "-n", "2", "--json")
    assert ran.status == 0, ran.err
    assert (ran.json["request"]["response"], ran.json["request"]["dynamic_range"]) == ("gamma", 300)
    (folder,) = Path("pictures/today").iterdir()
    assert (folder / "report.json").exists()
    given = run(
        *("shoot", *SMALL, "--response", "log", "--range", "256", "-n", "2", "-o", "here", "--json")
    )
    assert given.json["plan"]["dynamic_range"] == 256
    assert given.json["request"].get("response", "log") == "log"
    assert Path("here/report.json").exists()


def test_what_is_given_replaces_defaults_that_contradict_it(run: Run, configure: Configure) -> None:
    configure('response = "auto"\nrange = "high"\n')
    gamma = run("shoot", *SMALL, "--gamma", "0.45", "-n", "2", "-o", "a", "--json")
    assert gamma.json["request"]["gamma"] == 0.45, gamma.err
    ratios = run("shoot", *SMALL, "--ratios", "1,4", "-o", "b", "--json")
    assert ratios.status == 0, ratios.err
    Path("curve.txt").write_text("0.01 0\n0.1 0.5\n1 1\n")
    curve = run("shoot", *SMALL, "--response", "curve.txt", "-n", "2", "-o", "c", "--json")
    assert curve.json["plan"]["dynamic_range"] == 100, curve.err


def test_studies_have_no_such_defaults(run: Run, configure: Configure) -> None:
    configure('camera = "v4l2:/dev/nowhere"\nresponse = "gamma"\nrange = "auto"\n')
    found = run("solve", "-n", "2", "--json")
    assert (found.json["response"], found.json["dynamic_range"]) == ("log", 1000), found.err


def test_camera_of_the_environment_of_the_file_and_given(
    run: Run, configure: Configure, monkeypatch: pytest.MonkeyPatch
) -> None:
    line = ("shoot", "--ratios", "1,2", "-O", "size=64x48", "-o", "here")
    configure('camera = "filed"\n')
    assert "unknown camera 'filed'" in run(*line).error
    monkeypatch.setenv("CAMCTL_CAMERA", "named")
    assert "unknown camera 'named'" in run(*line).error
    assert "unknown camera 'typed'" in run(*line, "--camera", "typed").error
    assert run(*line, "--sensor", "phone").status == 0  # asks for the simulated one
    assert "here is complete" in run("resume", "here").error  # the camera of the capture


@pytest.mark.parametrize(
    ("text", "message"),
    some(
        [
            ("response = gamma", "is no TOML"),
            ('rnage = "high"', "unknown setting 'rnage' in "),
            ('range = "wide"', "unknown dynamic range 'wide' in "),
            ("range = 0.5", "invalid value for range: 0.5 in "),
            ('response = "sepia"', "unknown response 'sepia' in "),
            ("camera = true", "invalid value for camera in "),
            ("[camera]\nid = 1", "invalid value for camera in "),
            ("camera = '\xff'", "cannot be used"),
        ],
        every=3,
        first=1,
    ),
)
def test_a_wrong_file_is_one_line(run: Run, configure: Configure, text: str, message: str) -> None:
    path = configure(text)
    if "\xff" in text:
        path.write_bytes(text.encode("latin-1"))
        message = "it is not a text file"
    ran = run("shoot")
    assert message in ran.error
    assert ran.status in (1, 2)
    assert run("shoot", "--help").status == 0
    assert run("solve", "-n", "1").status == 0
    found = {each["name"]: each for each in run("doctor", "--json").json["checks"]}
    assert found["configuration"]["state"] == "problem"
