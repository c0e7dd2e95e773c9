"""The shares of a picture's samples within and outside of its range."""

import math

import numpy as np
import pytest

from camctl.interface.controls import Layout
from camctl.model.effective import EffectiveCamera
from camctl.model.inverse import Posterior
from camctl.model.noise import FrameNoise
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.pictures.light_shares import BINS, light_shares
from camctl.pictures.render import Tables

BLACK = 5
EFFECTIVE = EffectiveCamera.of(linear_response(6), [1.0, 4.0])


def posterior(desired: DesiredResponse) -> Posterior:
    noise = [FrameNoise(math.inf, 0.0, black=2), FrameNoise(math.inf, 0.0, black=3)]
    return Posterior(EFFECTIVE, desired, noise)


@pytest.mark.parametrize("dynamic_range", [10.0, 100.0, math.inf])
def test_light_below_the_range_is_dark_though_frames_have_it(dynamic_range: float) -> None:
    desired = desired_response("linear", dynamic_range)
    tables = Tables.of(posterior(desired))
    total = np.arange(tables.mask.size, dtype=np.uint16).reshape(1, -1)
    E = posterior(desired).inverse.E[BLACK + 1 : -1]
    found = light_shares(Layout.MONO, total, [tables], desired)
    dark = BLACK + 1 + np.count_nonzero(desired.e_min > E)
    assert found.dark == pytest.approx(dark / total.size)
    assert found.saturated == pytest.approx(1 / total.size)
    assert math.fsum(found.histogram) == pytest.approx(1 - found.dark - found.saturated)


def test_histogram_has_equal_steps_of_stops() -> None:
    desired = desired_response("log", 100.0)
    tables = Tables.of(posterior(desired))
    for place in (3, 20, BINS - 1):
        E = 100.0 ** ((place + 0.5) / BINS - 1)
        value = int(np.argmin(np.abs(np.log(tables.shown / E))))
        total = np.full((4, 5), value, np.uint16)
        found = light_shares(Layout.MONO, total, [tables], desired).histogram
        expected = int((math.log(tables.shown[value]) / math.log(100.0) + 1) * BINS)
        assert found[expected] == pytest.approx(1.0)
        assert len(found) == BINS
