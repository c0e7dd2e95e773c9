"""Checks of a camera that repeats a list of exposures without end."""

from __future__ import annotations

from itertools import islice, pairwise

import pytest

from camctl.errors import CameraBusyError, RefusedSettingError, UsageError
from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureSetting
from camctl.interface.cycle import CyclingCamera
from camctl.testing.suite import UNUSABLE, CameraSuite

# Lists that are repeated.
_ROUNDS = 3


class CycleChecks(CameraSuite):
    """Checks of `CyclingCamera.cycle`; a camera without it skips them."""

    def test_a_cycle_repeats_its_list(self, camera: Camera) -> None:
        """Each frame of an endless stream has the exposure that it states."""
        if not isinstance(camera, CyclingCamera):
            pytest.skip("the camera repeats no list of exposures")
        first, second = self.times(camera, [1, 0.25, 0.5]), self.times(camera, [0.5, 1])
        cycle = camera.cycle(first)
        try:
            frames = list(islice(cycle, _ROUNDS * len(first)))
            number = cycle.exchange(second)
            frames += islice(cycle, _ROUNDS * (len(first) + len(second)))
            with pytest.raises(CameraBusyError):
                camera.shoot(first)
            with pytest.raises(UsageError):
                cycle.exchange([])
            with pytest.raises(RefusedSettingError):
                cycle.exchange([ExposureSetting(camera.controls.time_s.maximum * 3)])
        finally:
            cycle.close()
        lists = {0: first, number: second}
        for frame in frames:
            assert frame.place is not None
            assert frame.requested == lists[frame.place.plan][frame.index]
        places = [frame.place for frame in frames if frame.place]
        assert all(before.number < after.number for before, after in pairwise(places))
        assert [place.plan for place in places] == sorted(place.plan for place in places)
        assert {place.plan for place in places} == {0, number}
        compared = [self.check_light(camera, frames[0], frame) for frame in frames[1:]]
        assert all(compared), UNUSABLE
        (after,) = self.shoot(camera, first[:1])
        assert self.check_light(camera, frames[0], after), UNUSABLE

    def test_an_empty_cycle_is_a_usage_error(self, camera: Camera) -> None:
        """There is nothing to repeat, and the camera is not busy afterwards."""
        if not isinstance(camera, CyclingCamera):
            pytest.skip("the camera repeats no list of exposures")
        with pytest.raises(UsageError):
            camera.cycle([])
        assert len(self.shoot(camera, self.times(camera, [1]))) == 1
