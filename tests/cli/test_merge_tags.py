"""`camctl merge`: what the tags of photographs say beside their times, and files that are none."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from command_line import Run
from numpy.typing import NDArray

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


#: How the pixels of an upright picture lie, by orientation (EXIF 2.32, 4.6.4): the first row of
#: the file and its first column are which sides of the picture.
_LYING: dict[int, Callable[[Any], Any]] = {
    1: lambda upright: upright,  # top, left
    2: lambda upright: upright[:, ::-1],  # top, right
    3: lambda upright: upright[::-1, ::-1],  # bottom, right
    4: lambda upright: upright[::-1],  # bottom, left
    5: lambda upright: upright.swapaxes(0, 1),  # left, top
    6: lambda upright: upright[:, ::-1].swapaxes(0, 1),  # right, top
    7: lambda upright: upright[::-1, ::-1].swapaxes(0, 1),  # right, bottom
    8: lambda upright: upright[::-1].swapaxes(0, 1),  # left, bottom
}


def write(
    orientations: Sequence[int] = (1, 1, 1),
    isos: Sequence[int] = (100, 100, 100),
    lying: Sequence[int] | None = None,
) -> None:
    """Write the photographs `NAMES`, whose exposures are 1, 8 and 64; upright they are `_SHAPE`.

    Args:
        orientations: that they state
        isos: likewise
        lying: the orientations of their pixels; None: those that they state
    """
    rng = np.random.default_rng(4)
    scene = np.exp(rng.normal(0, 1.2, (12, 18, 3))).repeat(8, 0).repeat(8, 1)
    scene[:, :72] *= 20  # the left half is bright
    scene[:8] *= 20  # and so is the top
    levels = standard_response("srgb", 8).levels
    whole = zip(NAMES, (1, 8, 64), orientations, isos, lying or orientations, strict=True)
    for name, exposure, orientation, iso, lies in whole:
        light = scene * exposure / 400
        light += np.sqrt(light / 8000) * rng.normal(size=light.shape)
        pixels = np.searchsorted(levels, light, side="right").astype(np.uint8)
        tags = [
            (_EXPOSURE_TIME, 5, 1, (exposure * 100, 512 * iso), True),
            (_ISO, 3, 1, iso, True),
            (_ORIENTATION, 3, 1, orientation, True),
        ]
        tifffile.imwrite(name, _LYING[lies](pixels), photometric="rgb", extratags=tags)


def is_upright(radiance: NDArray[Any]) -> bool:
    """Whether the left half is bright, and of a grey row of the scene the order is right."""
    return radiance.shape[:2] == _SHAPE and bool(
        radiance[:, :72].mean() > 5 * radiance[:, 72:].mean()
        and radiance[:8].mean() > 5 * radiance[-8:].mean()
    )


@pytest.mark.parametrize(
    "orientations", [(6, 8, 1), (1, 2, 3), *((k,) * 3 for k in (2, 3, 4, 5, 7, 8))]
)
def test_photographs_are_all_turned_upright(tagged: Run, orientations: tuple[int, ...]) -> None:
    write(orientations)
    ran = tagged("merge", *NAMES, "--curve", "srgb", "-o", "hall")
    assert (ran.status, "orientation" in ran.err) == (0, False)
    assert is_upright(read_report("hall").radiance())


@pytest.mark.parametrize("stated", [1, 8])
def test_photographs_of_a_tripod_are_turned_as_the_first_one_states(
    tagged: Run, stated: int
) -> None:
    write((6, 6, stated), lying=(6, 6, 6))
    ran = tagged("merge", *NAMES, "--curve", "srgb", "-o", "hall")
    assert ran.status == 0
    report = read_report("hall")
    (note,) = [each for each in report.findings if each.code == "tags_differ"]
    assert (note.frames, note.details["what"]) == ((2,), "orientation")
    assert is_upright(report.radiance())


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
