"""What frames of a stream say of their exposures: wrong ones, late ones, and light that varies."""

from __future__ import annotations

from itertools import islice

import pytest
from small_cameras import GIVEN, gradient

import camctl
from camctl.evidence.ratio_check import RatioCheck
from camctl.livestream.disagreement import OtherExposures
from camctl.messages.plain import sentence
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import Scene
from camctl.sim.sensors.sensor import load_sensor


@pytest.mark.parametrize(
    ("faults", "factor", "frames"),
    [
        (Faults(longest_exposure_s=0.01), 4.0, ("1/16 s", "1/62 s")),
        (Faults(shutter_offset_s=0.002), 4 / 3, ("1/62 s", "1/250 s")),
    ],
)
@pytest.mark.parametrize("brightness", [1.0, 0.1])
def test_exposures_that_a_camera_does_not_make_are_named(
    faults: Faults, factor: float, frames: tuple[str, str], brightness: float
) -> None:
    scene = Scene("test", brightness * gradient(60, 80), photons_per_unit=2e7)
    with (
        SimulatedCamera(scene, load_sensor("machine-vision"), faults=faults) as opened,
        camctl.live(opened, GIVEN) as live,
    ):
        last = list(islice(live, 40))[-1]
        assert opened.controls.delay_frames is not None  # it did not settle
    found = {each.code: each for each in last.findings}
    assert "stream_settles" not in found
    differs = found["exposure_differs"]
    assert differs.value is not None
    assert max(differs.value, 1 / differs.value) == pytest.approx(factor, rel=0.03)
    name, before = frames
    assert sentence(differs).startswith(f"the frame of {name} is ")
    assert f"as bright as the frame of {before}, and its exposure is 4 times" in sentence(differs)


def ratios(*measured: float) -> OtherExposures:
    """Return what frames of exposures 1, 4 and 16 show."""
    checks = {
        (k, k + 1): RatioCheck(
            expected=4.0, measured=each, tolerance=0.01, agrees=False, moved=0.0, compared=0.5
        )
        for k, each in enumerate(measured)
    }
    return OtherExposures((1.0, 4.0, 16.0), checks)


def test_late_frames_have_exposures_of_others() -> None:
    assert ratios(1 / 16, 4.0).come_late  # 16, 1, 4
    assert ratios(4.0, 1 / 16).come_late  # 4, 16, 1
    assert not ratios(4.0, 1.0).come_late
    assert not ratios(1.0, 1.0).come_late


def test_wrong_exposures_stay_and_light_varies() -> None:
    assert ratios(4.0, 1.0).are_those_of(ratios(4.01, 0.99))
    assert not ratios(4.0, 1.0).are_those_of(ratios(4.0, 2.0))
    assert ratios(4.0, 1.0).reason(ratios(4.0, 1.0)) == "exposures"
    assert ratios(4.0, 1.0).reason(ratios(1.0, 4.0)) == "delay"
    assert ratios(5.0, 3.0).reason(ratios(3.3, 4.5)) == "light"
    nothing = OtherExposures((1.0, 4.0), {})  # all is saturated
    assert nothing.reason(nothing) == "delay"
