"""Every maker's camera once more, in every order of its events, with random timing.

The table of event orders is `second_responder.ORDERS`; docs/reference/cameras.md shows it.
"""

from __future__ import annotations

from contextlib import closing
from itertools import product

import numpy as np
import pytest
from sampling import some
from second_responder import MAKERS, ORDERS, SecondCamera, SecondPtpCamera

from camctl.errors import CameraError
from camctl.interface.camera import Frame
from camctl.interface.controls import ExposureSetting

pytestmark = pytest.mark.usefixtures("own_profiles")
SEEDS = range(4)
CAPTURE_S = 20.0  # longest time of a picture, virtual: longer is "saved no picture"


def shoot(camera: SecondPtpCamera, second: SecondCamera, places: list[int]) -> list[Frame]:
    """Shoot the times with these places, and check that each frame is the one of its exposure."""
    times = sorted(second.kind.shutter[2])
    control = camera.controls.time_s  # known after a test picture
    settings = [ExposureSetting(control.nearest(times[place]), 1.0) for place in places]
    before = len(second.taken)
    with closing(camera.shoot(settings)) as frames:
        found = list(frames)
    taken = second.taken[before:]
    assert [name for _, name in taken] == [frame.details["object"] for frame in found]
    for frame, place, (number, _) in zip(found, places, taken, strict=True):
        assert number == second.kind.shutter[2][times[place]]
        assert abs(float(np.mean(frame.pixels)) - (60 + 40 * place)) < 2
    return found


@pytest.mark.parametrize(("order", "maker"), some(product(ORDERS, MAKERS), every=8))
def test_each_frame_is_the_one_of_its_exposure_in_every_order_of_events(
    maker: str, order: str
) -> None:
    for seed in SEEDS:
        second = SecondCamera(maker, order, seed)
        with SecondPtpCamera(second).open() as camera:
            began_s = second.clock.now()
            shoot(camera, second, [2, 0, 1])
            second._wait(second.random.uniform(0, 2))  # events may wait for the next sequence
            shoot(camera, second, [1, 2, 0])
            assert second.clock.now() - began_s < 6 * CAPTURE_S / 4
        assert not second.faults, (seed, second.faults)


@pytest.mark.parametrize("order", ["with the file", "never"])
def test_sony_with_autofocus_is_held_until_it_has_focused(order: str) -> None:
    for seed in SEEDS:
        second = SecondCamera("sony", order, seed)
        second.values[0x500A] = second.shown[0x500A] = 2  # automatic focus
        with SecondPtpCamera(second).open() as camera:
            shoot(camera, second, [0, 1, 2, 0])
        assert not second._pressed


@pytest.mark.parametrize("manner", ["refuses_presses", "refuses_full"])
def test_canon_that_refuses_a_press_is_released_otherwise_and_left_unpressed(manner: str) -> None:
    second = SecondCamera("canon", "with the file", 1, **{manner: True})
    with SecondPtpCamera(second).open() as camera:
        if manner == "refuses_full":
            with pytest.raises(CameraError):
                shoot(camera, second, [0])
            assert not second._pressed  # the half press was taken back
        shoot(camera, second, [0, 1, 2])
    assert not second.faults
    assert (0x910F in second.log) == (manner == "refuses_presses")


def test_canon_is_pressed_half_and_full_and_kept_on() -> None:
    second = SecondCamera("canon", "with the file", 1)
    with SecondPtpCamera(second).open() as camera:
        shoot(camera, second, [0] * 40)
        lasted_s = second.clock.now()
    assert 0x910F not in second.log
    assert second.log.count(0x9128) == second.log.count(0x9129) == 2 * len(second.taken)
    assert lasted_s / 10 - 2 <= second.log.count(0x911D) <= lasted_s / 10 + 1


def test_fuji_lets_the_half_press_go_after_it_could_not_focus() -> None:
    second = SecondCamera("fuji", "with the file", 1, fails_to_focus=True)
    camera = SecondPtpCamera(second).open()
    with camera:
        with pytest.raises(CameraError, match="cannot focus"):
            shoot(camera, second, [0])
        assert not second._pressed
        shoot(camera, second, [0, 1])
    assert not second.faults
