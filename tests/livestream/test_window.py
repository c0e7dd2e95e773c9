"""The running sum of a cycle is as narrow as its list of exposures allows."""

from __future__ import annotations

import numpy as np

from camctl.interface.camera import CyclePlace, Frame
from camctl.interface.controls import (
    Choices,
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
)
from camctl.livestream.window import Window

CONTROLS = ExposureControls(
    time_s=Choices((0.01,)),
    shape=(2, 3),
    layout=Layout.MONO,
    bits=12,
    white=4095,
    response_origin=ResponseOrigin.STATED,
)


def test_the_sum_is_as_wide_as_the_list_needs() -> None:
    """12-bit frames, 16 of which fit in 16 bits: lists of 3, 20 and 2 are exchanged."""
    window, number, wrong = Window(CONTROLS), 0, []
    setting = ExposureSetting(0.01)
    for plan, count in enumerate((3, 20, 2)):
        for index in range(2 * count):
            place = CyclePlace(number, plan)
            pixels = np.full((2, 3), 4095 - number, np.uint16)
            window.add(
                Frame(pixels, setting, setting, 0.01, index % count, 0, 4095, place=place), count
            )
            number += 1
            truth = sum(frame.pixels.astype(np.int64) for frame in window.frames)
            if not np.array_equal(window.total, truth):
                wrong.append(number)
        assert len(window.frames) == count
        assert window.total.dtype == (np.uint16 if count * 4095 < 2**16 else np.uint32)
    assert wrong == []
    assert number == 50
