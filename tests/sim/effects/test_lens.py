"""Diffraction and lateral colour: the size of the Airy disk, and how far colours part."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy import special

from camctl.sim.effects.bounds import Bounds
from camctl.sim.effects.budget import plan_frame
from camctl.sim.effects.lens import airy_kernel
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import LUMINANCE, Scene
from camctl.sim.scenes.view import Light, View
from camctl.sim.sensors.parts import Lens, Pixels
from camctl.sim.sensors.sensor import Sensor, load_sensor


def photographed(light: Any, lens: Lens, pitch_um: float = 2.0) -> Light:
    """Return the input of the ADC."""
    sensor = Sensor(
        name="s",
        bits=16,
        full_well_e=1e6,
        photon_noise=False,
        lens=lens,
        pixels=Pixels(pitch_um=pitch_um),
    )
    view = View.of(Scene("s", np.asarray(light, dtype=np.float32)), sensor)
    renderer = Renderer(view, sensor)
    shot = renderer.shot(0.01, 1.0, 0)
    return renderer.brightness(shot, plan_frame(shot, 0.0, left_out=()))


@pytest.mark.parametrize("radius_px", [1e-6, 0.3, 1.0, 4.0, 12.0])
def test_the_airy_kernel_is_the_diffraction_of_a_round_aperture(radius_px: float) -> None:
    kernel = airy_kernel(radius_px)
    assert kernel.sum() == pytest.approx(1)
    assert kernel.min() >= 0
    assert np.allclose(kernel, kernel.T)
    assert np.allclose(kernel, kernel[::-1])
    if radius_px < 4:
        return
    # Rayleigh: the energy within r is 1 - J0(v)^2 - J1(v)^2, here of that within the third ring.
    at = np.arange(kernel.shape[0]) - kernel.shape[0] // 2
    distance = np.hypot(at, at[:, None])
    within = 1 - special.j0(10.1735) ** 2 - special.j1(10.1735) ** 2
    for ring in (3.8317, 7.0156):
        v = ring * (math.floor(radius_px) + 0.5) / radius_px if ring < 4 else ring
        energy = 1 - special.j0(v) ** 2 - special.j1(v) ** 2
        inside = kernel[distance <= v / 3.8317 * radius_px].sum()
        assert inside == pytest.approx(energy / within, abs=0.015)


def test_diffraction_spreads_a_point_by_wavelength_and_f_number() -> None:
    """Half of the first dark ring is where most light is; red spreads further than blue."""
    light = np.full((61, 61, 3), 1e-3, dtype=np.float32)
    light[30, 30] = 1e6
    widths = {}
    for f_number in (4.0, 16.0):
        seen = photographed(light, Lens(f_number=f_number, diffraction=True)).astype(float)
        peaks = seen[30, 30]
        assert peaks[0] < peaks[1] < peaks[2]
        row = seen[30, :, 1] / peaks[1]
        widths[f_number] = (row > 0.5).sum()
        total = seen.sum(axis=(0, 1))
        assert total == pytest.approx(np.full(3, total[1]), rel=1e-3)
    # Full width at half maximum: 1.03 wavelength x f-number, 4.4 pixels at f/16.
    assert widths[16.0] == pytest.approx(1.03 * 0.54 * 16 / 2.0, abs=1)
    assert widths[4.0] <= 3


def test_diffraction_leaves_no_negative_light_beside_a_bright_point() -> None:
    light = np.full((80, 90), 1e-6, dtype=np.float32)
    light[40, 45] = 1e12
    seen = photographed(light, Lens(f_number=22.0, diffraction=True))
    assert np.isfinite(seen).all()
    assert seen.min() >= 0


def test_an_airy_disk_of_many_pixels_is_refused() -> None:
    with pytest.raises(ValidationError, match=r"an Airy disk with a radius of 36\.6 pixels"):
        photographed(np.ones((2, 2)), Lens(f_number=100.0, diffraction=True))


def test_lateral_colour_parts_the_colours_of_an_edge() -> None:
    """1 % at 40 pixels from the middle: red 0.4 pixels further out, blue 0.4 further in."""
    light = np.zeros((21, 101, 3), dtype=np.float32)
    ramp = np.clip(np.abs(np.arange(101) - 50.0) - 30, 0, 20) * 1e5
    light[:] = ramp[None, :, None]
    seen = photographed(light, Lens(lateral_colour=0.01)).astype(float)[10]
    plain = photographed(light, Lens()).astype(float)[10]
    a_pixel = plain[91, 1] - plain[90, 1]
    shift = (seen - plain)[90] / a_pixel
    assert shift == pytest.approx([-0.4, 0.0, 0.4], abs=0.01)
    assert np.allclose((seen - plain)[10], (seen - plain)[90], atol=a_pixel / 100)


def test_the_bound_of_lateral_colour_is_nearly_reached_in_the_corner_of_a_ramp() -> None:
    """A slope of the same size along rows and columns, steepest where colours part most."""
    y, x = np.mgrid[:61, :81]
    light = np.repeat(np.abs(np.stack([x - 40.0 + y - 30.0])).transpose(1, 2, 0), 3, axis=2)
    lens = Lens(lateral_colour=0.02)
    sensor = Sensor(name="s", bits=16, full_well_e=1e6, photon_noise=False, lens=lens)
    view = View.of(Scene("s", (light * 1e5 + 1).astype(np.float32)), sensor)
    renderer = Renderer(view, sensor)
    shot = renderer.shot(0.01, 1.0, 0)
    bound = Bounds(shot).joint(["lateral colour"])
    with_it, without = (
        renderer.brightness(shot, plan_frame(shot, 0.0, left_out=names)).astype(np.float64)
        for names in ((), ("lateral colour",))
    )
    assert 0.9 * bound < np.abs(with_it - without).max() <= bound


def test_lateral_colour_does_not_change_grey_pictures_of_one_channel() -> None:
    light = np.random.default_rng(1).random((20, 30)) * 1e6
    lens = Lens(lateral_colour=0.02)
    assert np.array_equal(photographed(light, lens), photographed(light, Lens()))


def test_lens_and_pixel_convert_candela_to_photons() -> None:
    """100 cd/m^2 at f/4, T 0.9: pi 100 0.9 / 64 = 4.42 lx; 683 lm/W at 555 nm."""
    sensor = load_sensor("complete")
    lux = np.pi * 100 * 0.9 / (4 * 16)
    photon_j = 6.62607015e-34 * 299_792_458 / 555e-9
    expected = lux / 683 / photon_j * (3.45e-6) ** 2
    scene = Scene("even", np.full((1, 1), 100.0, np.float32), LUMINANCE)
    light = View.of(scene, sensor).light
    assert light[0, 0] == pytest.approx(expected, rel=1e-3)
    wide = sensor.model_copy(update={"lens": sensor.lens.model_copy(update={"f_number": 2.0})})
    assert View.of(scene, wide).light[0, 0] == pytest.approx(4 * light[0, 0], rel=1e-6)
