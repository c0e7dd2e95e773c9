"""`camctl merge`: what the tags of photographs say beside their times, and files that are none."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import tifffile
from command_line import Run
from sampling import some

from camctl import read_report
from camctl.model.response.camera import standard_response

NAMES = ("a.tif", "b.tif", "c.tif")
_ORIENTATION, _EXPOSURE_TIME, _ISO = 274, 33434, 34855
_SHAPE = (96, 144)


@pytest.fixture
def tagged(run: Run) -> Run:
    """Return the command line in a folder with photographs that have tags of `write`."""
    pytest.importorskip("cv2", reason="OpenCV is blocked")
    return run


def write(orientations: Sequence[int] = (1, 1, 1), isos: Sequence[int] = (100, 100, 100)) -> None:
    """Write the photographs `NAMES`, whose exposures are 1, 8 and 64."""
    rng = np.random.default_rng(4)
    scene = np.exp(rng.normal(0, 1.2, (12, 18, 3))).repeat(8, 0).repeat(8, 1)
    scene[:, :72] *= 20  # the left half is bright
    levels = standard_response("srgb", 8).levels
    for name, exposure, orientation, iso in zip(NAMES, (1, 8, 64), orientations, isos, strict=True):
        light = scene * exposure / 400
        light += np.sqrt(light / 8000) * rng.normal(size=light.shape)
        pixels = np.searchsorted(levels, light, side="right").astype(np.uint8)
        tags = [
            (_EXPOSURE_TIME, 5, 1, (exposure * 100, 512 * iso), True),
            (_ISO, 3, 1, iso, True),
            (_ORIENTATION, 3, 1, orientation, True),
        ]
        tifffile.imwrite(name, pixels, photometric="rgb", extratags=tags)


@pytest.mark.parametrize(("orientation", "turns"), some([(6, -1), (1, 0), (3, 2), (8, 1)], every=4))
def test_photographs_are_turned_upright(tagged: Run, orientation: int, turns: int) -> None:
    write((orientation,) * 3)
    ran = tagged("merge", *NAMES, "--curve", "srgb", "-o", "hall")
    assert (ran.status, "orientation" in ran.err) == (0, False)
    lying = np.rot90(read_report("hall").radiance(), -turns)
    assert lying.shape[:2] == _SHAPE
    assert lying[:, :72].mean() > 5 * lying[:, 72:].mean()


def test_all_photographs_are_turned_as_the_first_one_states(tagged: Run) -> None:
    write((6, 6, 1))
    ran = tagged("merge", *NAMES, "--curve", "srgb", "-o", "hall")
    assert ran.status == 0
    report = read_report("hall")
    (note,) = [each for each in report.findings if each.code == "tags_differ"]
    assert (note.frames, note.details["what"]) == ((2,), "orientation")
    assert report.radiance().shape == (*_SHAPE[::-1], 3)


def test_what_differs_beside_the_times_is_in_the_table(tagged: Run) -> None:
    write(isos=(100, 100, 200))
    out = tagged("merge", *NAMES, "--curve", "srgb", "-o", "hall").out
    assert re.search(r"photograph +time +ISO\n", out)
    assert re.search(r"c.tif +\S+ \S+ +200 +used", out)
    write()
    assert "ISO" not in tagged("merge", *NAMES, "--curve", "srgb", "-o", "alike").out


def test_a_file_that_is_no_picture_is_named(tagged: Run) -> None:
    write()
    Path("notes.txt").write_text("a line of notes that is longer than a header")
    error = tagged("merge", *NAMES, "notes.txt", "-o", "hall").error
    assert error.startswith("notes.txt cannot be read: it is no picture of a known format")
