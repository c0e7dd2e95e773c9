"""The image panel: each screen as a picture that other programs can read."""

from __future__ import annotations

from dataclasses import replace
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from panel_fakes import FakeJob

from camctl.errors import UsageError
from camctl.interface.clock import VirtualClock
from camctl.menu.app import run
from camctl.menu.drawing import draw
from camctl.menu.model import State
from camctl.menu.panels.image import ImagePanel
from camctl.menu.ports import Key
from camctl.menu.screens import screen
from tests.menu.test_machine import FULL


def test_each_screen_is_a_picture(tmp_path: Path, cv2: Any) -> None:
    panel = ImagePanel(f"{tmp_path}/shots,320x240")
    shown = screen(FULL)
    with panel:
        panel.show(shown)
    read = cv2.imread(str(tmp_path / "shots" / "screen-0001.png"))
    assert read is not None
    np.testing.assert_array_equal(read[..., ::-1], draw(shown, 320, 240).pixels)


def test_menu_runs_on_a_list_of_keys(tmp_path: Path) -> None:
    pauses: list[Key | None] = [None] * 400
    # Time is virtual, and that of the job is not: the keys come again until it has ended.
    keys = cycle([*pauses, Key.EXIT, *pauses, Key.RIGHT, Key.ENTER])
    panel = ImagePanel(str(tmp_path), keys, clock=VirtualClock())
    assert run(panel, FakeJob) is None
    assert panel.count >= 3


@pytest.mark.parametrize(
    ("address", "message"),
    [("", "invalid address"), ("x,10x10", "10 x 10 pixels is too small for the menu; use 96x16")],
)
def test_address_that_cannot_be_used_is_refused(address: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        ImagePanel(address)


@pytest.mark.parametrize(
    "size",
    [
        *((240, 240), (320, 240), (480, 320), (800, 480)),
        pytest.param((1920, 1080), marks=pytest.mark.slow),
    ],
)
def test_every_screen_is_drawn_in_every_size(size: tuple[int, int]) -> None:
    for state in State:
        pixels = draw(screen(replace(FULL, state=state)), *size).pixels
        assert pixels.shape == (size[1], size[0], 3)
        shades = np.count_nonzero(np.bincount(pixels.ravel(), minlength=256))
        assert shades == 1 if state is State.SAVER else shades > 3, (state, "a flat picture")
        assert pixels.any() == (state is not State.SAVER), state
