"""When the exposures of a stream are chosen anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_cameras import small_camera

from camctl.exposure.goal import CaptureRequest
from camctl.livestream.planning import Following, LivePlanner, Look

STEADY = Look(np.array([0.1, 0.9]), np.array([0.5, 0.5]), highlight=0.9, clipped=0.0, dark=0.01)
CHANGES = {
    "brighter": replace(STEADY, highlight=0.9 * 2**0.6),
    "darker": replace(STEADY, highlight=0.9 / 2**0.6),
    "saturated": replace(STEADY, clipped=0.001),
    "more of it dark": replace(STEADY, dark=0.3),
}


@pytest.mark.parametrize("name", CHANGES)
def test_another_light_counts_when_it_is_seen_twice_in_a_row(name: str) -> None:
    other = CHANGES[name]
    following = Following()
    following.accept(STEADY)
    seen = [following.is_other(each) for each in (other, STEADY, other, other)]
    assert seen == [False, False, False, True]


@pytest.mark.parametrize(("stops", "dark"), [(0.4, 0.01), (-0.3, 0.01), (0.0, 0.05)])
def test_a_small_change_does_not_count(stops: float, dark: float) -> None:
    following = Following()
    following.accept(STEADY)
    other = replace(STEADY, highlight=0.9 * 2**stops, dark=dark)
    assert not any(following.is_other(other) for _ in range(10))


def test_exposures_that_do_not_suit_the_light_stay_where_none_suit_it_better() -> None:
    badly_placed = replace(STEADY, highlight=0.01)
    following = Following()
    following.accept(badly_placed)
    assert [following.is_other(badly_placed) for _ in range(2)] == [False, True]
    following.accept(badly_placed, is_final=True)
    assert not any(following.is_other(badly_placed) for _ in range(10))


@pytest.mark.parametrize(
    ("wanted", "unseen", "remedies"),
    [
        (CaptureRequest(dynamic_range=16), 0.1, {"dynamic_range": "auto"}),
        (
            CaptureRequest(dynamic_range=16, base_s=0.01),
            0.1,
            {"base_s": False, "dynamic_range": "auto"},
        ),
        (CaptureRequest(), 0.0, {"dynamic_range": 64.0}),
        (CaptureRequest(), 0.3, {"fps": None}),
    ],
)
def test_what_is_too_dark_names_what_would_show_it(
    wanted: CaptureRequest, unseen: float, remedies: dict[str, object]
) -> None:
    dark = replace(STEADY, irradiance=np.array([0.02, 0.9]), dark=0.5, unseen=unseen)
    with small_camera() as camera:
        (found,) = LivePlanner(camera, wanted, 10.0).light_findings(dark, 16)
    assert found.code == "light_below_range"
    assert found.remedies == remedies
