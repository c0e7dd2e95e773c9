"""A capture of 64 exposures, the most that there are."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import pytest

import camctl
from camctl.pictures.files import write_picture_files


def test_64_exposures_are_planned() -> None:
    with camctl.open_camera("sim", scene="ramp", size=(48, 32)) as camera:
        request = camctl.CaptureRequest(response="log", dynamic_range=1000.0, count=64)
        assert len(camctl.plan_capture(camera, request).settings) == 64


def test_memory_for_the_pictures_does_not_follow_the_number_of_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The patches of a frame that checks compare are freed: 4761 of 8 x 8 samples of 16 bits."""
    before: list[int] = []

    def measured(*arguments: object) -> None:
        before.append(tracemalloc.get_traced_memory()[0])
        write_picture_files(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr("camctl.records.folder_store.write_picture_files", measured)
    for number, count in enumerate((2, 3, 9)):  # the first one imports modules, too
        request = camctl.CaptureRequest(ratios=tuple(1.1**k for k in range(count)))
        with camctl.open_camera("sim", scene="ramp", size="640x640") as camera:
            if number:  # tracing all that is imported would take longer than the rest
                tracemalloc.start()
            camctl.capture(camera, request, tmp_path / str(number))
            tracemalloc.stop()
    assert before[2] - before[1] < 6 * (4761 * 64 * 2)
