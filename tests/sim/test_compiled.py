"""Compiled functions give the frames that numpy gives, bit for bit."""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.sim.compiled import SAMPLES_WORTH_LOADING, KernelChoice, load
from camctl.sim.noise import TILE, Stream, TileNoise
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import load_sensor, sensor_names


@pytest.mark.parametrize(
    ("sensor", "scene"),
    [
        # By default each sensor before one of the scenes.
        pytest.param(name, scene, marks=() if place == k % 2 else pytest.mark.slow)
        for k, name in enumerate(sensor_names())
        for place, scene in enumerate(("ball", "night-street"))
    ],
)
@pytest.mark.slow
def test_frames_are_the_same_with_and_without_numba(sensor: str, scene: str) -> None:
    pytest.importorskip("numba")
    chosen = load_sensor(sensor)
    view = View.of(load_scene(scene, (261, 347)), chosen)
    light = float(view.light.max()) * chosen.quantum_efficiency
    for number, filled in enumerate((0.01, 0.6, 300.0)):
        time_s = filled * chosen.full_well_e / light
        pictures = []
        for is_compiled in (False, True):
            renderer = Renderer(view, chosen, seed=7, compiled=is_compiled)
            shot = renderer.shot(time_s, 2.0, number)
            plan = renderer.plan(shot)
            pictures.append((renderer.expose(shot, plan), renderer.brightness(shot, plan)))
        for plain, fast in zip(*pictures, strict=True):
            assert np.array_equal(plain, fast)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 4099, TILE - 1, TILE])
@pytest.mark.slow
def test_draws_are_the_same_for_every_size_of_tile(count: int) -> None:
    pytest.importorskip("numba")
    plain, fast = TileNoise(), TileNoise(load())
    args = (count, 2**64 - 1, 2**40, Stream.PRNU, 3)
    assert np.array_equal(plain.normal(*args), fast.normal(*args))


@pytest.mark.slow
def test_photon_noise_is_the_same_for_every_mean() -> None:
    pytest.importorskip("numba")
    means = np.concatenate([[0.0], np.geomspace(1e-45, 1e30, TILE - 1)]).astype(np.float32)
    drawn: list[NDArray[np.uint32]] = []
    for noise in (TileNoise(), TileNoise(load())):
        electrons = means.copy()
        noise.add_photon_noise(electrons, 5, 6, 7)
        drawn.append(electrons.view(np.uint32))
    assert np.array_equal(drawn[0], drawn[1])


@pytest.mark.parametrize("size", [1, 4099, TILE])
@pytest.mark.slow
def test_photon_counts_are_the_same_for_every_mean(size: int) -> None:
    pytest.importorskip("numba")
    means = np.concatenate([[0.0], np.geomspace(1e-45, 1e7, 4098), np.geomspace(1e-3, 40, TILE)])
    drawn: list[NDArray[np.uint32]] = []
    for noise in (TileNoise(), TileNoise(load())):
        electrons = means[:: -(-means.size // size)].astype(np.float32)
        noise.count_photons(electrons, 5, 6, 7)
        drawn.append(electrons.view(np.uint32))
    assert np.array_equal(drawn[0], drawn[1])


@pytest.mark.parametrize("most", [4, 20, 40, 200])
@pytest.mark.slow
def test_photon_counts_are_the_same_for_light_of_any_range(most: float) -> None:
    """Where most means are low all are looked up first, else they are expanded first."""
    pytest.importorskip("numba")
    drawn: list[NDArray[np.float32]] = []
    for noise in (TileNoise(), TileNoise(load())):
        electrons = np.linspace(0, most, 1 << 15, dtype=np.float32)
        noise.count_photons(electrons, 5, 6, 7)
        drawn.append(electrons)
    assert np.array_equal(drawn[0], drawn[1])


def test_the_functions_are_loaded_after_many_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded: list[str] = []
    monkeypatch.setattr("camctl.sim.compiled.load", lambda: loaded.append("yes"))

    class AtOnce:
        def __init__(self, target: Any, name: str) -> None:
            self.start = target

    monkeypatch.setattr("camctl.system.compiled_functions.threading.Thread", AtOnce)
    choice = KernelChoice(None)
    choice.after(SAMPLES_WORTH_LOADING - 1)
    assert not loaded
    for _ in range(3):
        choice.after(1)
    assert loaded == ["yes"]
    KernelChoice(False).after(2 * SAMPLES_WORTH_LOADING)
    assert loaded == ["yes"]
    KernelChoice(True)
    assert loaded == ["yes", "yes"]


def test_without_numba_there_are_no_compiled_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    assert load.__wrapped__() is None


def test_without_a_folder_for_machine_code_it_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    numba = pytest.importorskip("numba")
    asked = []

    def njit(cache: bool = False, **options: Any) -> Any:
        asked.append(cache)
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(numba, "njit", njit)
    with np.errstate(over="ignore"):
        assert load.__wrapped__() is not None
    assert asked == [True, False] * 9
