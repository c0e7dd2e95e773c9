"""The layout of report.json: what it leaves out, and that it is put back."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from small_cameras import small_camera

import camctl
from camctl.captures.sequencer import capture
from camctl.records.folder_store import read_report
from camctl.records.report import CaptureReport
from camctl.records.report_json import FOLLOWS, from_json, to_json

MOST_PATHS = 110
"""Key paths of the report of a capture in memory; it had 189.  A folder adds names and checksums of
files, about 10."""


def paths(value: object, at: str = "") -> Iterator[str]:
    """Yield the path of each key; all entries of a list have one."""
    if isinstance(value, dict):
        for name, item in value.items():
            path = f"{at}.{name}" if at else name
            yield path
            yield from paths(item, path)
    elif isinstance(value, list):
        for item in value:
            yield from paths(item, f"{at}[]")


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, CaptureReport]:
    """A capture as `camctl shoot` takes it, of a small frame, with estimated exposures."""
    folder = tmp_path_factory.mktemp("taken") / "out"
    with camctl.open_camera("sim", size="160x120", seed=3) as camera:
        request = camctl.CaptureRequest(estimate_ratios=True)
        return folder, capture(camera, request, folder)


def written(folder: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return content


def test_what_is_written_is_read_again(taken: tuple[Path, CaptureReport]) -> None:
    folder, report = taken
    assert written(folder) == json.loads(json.dumps(to_json(report)))
    assert read_report(folder).model_dump() == report.model_dump()


def test_a_report_has_few_keys() -> None:
    with camctl.open_camera("sim", size="320x240") as camera:
        report = capture(camera, camctl.CaptureRequest())
    found = set(paths(to_json(report)))
    assert report.achieved.measured is not None
    assert report.movement is not None
    assert len(found) <= MOST_PATHS, sorted(found)


def test_what_scripts_rely_on_is_there(taken: tuple[Path, CaptureReport]) -> None:
    content = written(taken[0])
    assert {"camera", "plan", "frames", "achieved", "timing", "files"} <= content.keys()
    assert {"findings", "warnings", "status", "black_total", "trustworthy"} <= content.keys()
    plan = {"response", "dynamic_range", "ratios", "base_s", "xi", "effective_levels", "noise"}
    assert plan | {"effective_levels_noise_free"} <= content["plan"].keys()
    named = {"file", "requested_s", "applied_s", "exposure", "black", "white"}
    for frame in content["frames"]:
        assert named | {"saturated_fraction", "timestamp_s"} <= frame.keys()
    achieved = {"xi", "effective_levels", "levels", "levels_distinct", "noise"}
    assert achieved | {"effective_levels_noise_free"} <= content["achieved"].keys()


def test_noise_that_is_unknown_is_null() -> None:
    with camctl.open_camera("sim", size="160x120", unknown=True) as camera:
        request = camctl.CaptureRequest(count=3, response="linear")
        content = to_json(capture(camera, request))
    assert content["plan"]["noise"] is content["achieved"]["noise"] is None


def test_an_incomplete_report_has_what_goes_on_with_it(tmp_path: Path) -> None:
    from camctl.errors import InterruptedCaptureError
    from camctl.records.folder_store import read_capture

    shot: list[int] = []
    request = camctl.CaptureRequest(ratios=(1, 4, 16), base_s=0.01, dynamic_range=256)
    with small_camera() as camera, pytest.raises(InterruptedCaptureError):
        capture(
            camera,
            request,
            tmp_path / "out",
            progress=lambda each: shot.append(each.done),
            cancelled=lambda: bool(shot) and shot[-1] > 0,
        )
    kept = read_capture(tmp_path / "out")
    assert kept.status == "incomplete"
    assert kept.request == request
    assert written(tmp_path / "out")["request"].keys() == {"ratios", "base_s", "dynamic_range"}


@pytest.mark.parametrize("content", [None, [], {"plan": 3}, {"plan": {"settings": [{}]}}, "x"])
def test_what_is_no_report_stays_as_it_is(content: object) -> None:
    assert from_json(content) == content


def test_every_field_that_is_left_out_is_one_of_a_report() -> None:
    schema = json.dumps(CaptureReport.model_json_schema())
    for path in FOLLOWS:
        assert f'"{path.rpartition(".")[2]}"' in schema
