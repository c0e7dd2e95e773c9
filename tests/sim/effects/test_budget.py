"""The plan of a frame: what the greedy choice loses, what planning reads, and its contents."""

from __future__ import annotations

import itertools
import json
import statistics
from typing import Any, NoReturn

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.errors import UsageError
from camctl.interface.controls import ExposureSetting
from camctl.sim.camera import SimulatedCamera
from camctl.sim.effects import EFFECTS, effect_names
from camctl.sim.effects.bounds import Bounds, absolute_shift, relative_shift
from camctl.sim.effects.budget import FramePlan, candidates, greedy, plan_frame, saved
from camctl.sim.effects.charge import cosmic_hits
from camctl.sim.effects.record import Lacking, Shot
from camctl.sim.noise import TileNoise, largest_noise, normal_quantiles
from camctl.sim.render import Renderer
from camctl.sim.scenes.scene import load_scene
from camctl.sim.scenes.view import View
from camctl.sim.sensors.sensor import load_sensor

EFFECT = {effect.name: effect for effect in EFFECTS}


def a_shot(scene: str, sensor: str, time_s: float, shape: tuple[int, int] = (48, 64)) -> Shot:
    chosen = load_sensor(sensor)
    view = View.of(load_scene(scene, shape), chosen)
    return Renderer(view, chosen, seed=1).shot(time_s, 1.0, 0)


def saving(names: tuple[str, ...], shot: Shot) -> float:
    return saved([EFFECT[name] for name in names], shot)


def exhaustive(bounds: Bounds, tolerance_dn: float) -> tuple[str, ...]:
    """Return the most costly set within the tolerance, by trying every set."""
    fits = [effect.name for effect in candidates(bounds, tolerance_dn)]
    sets = itertools.chain.from_iterable(
        itertools.combinations(fits, count) for count in range(len(fits) + 1)
    )
    return max(
        (s for s in sets if not s or bounds.joint(s) <= tolerance_dn),
        key=lambda names: saving(names, bounds.shot),
    )


@pytest.mark.slow
def test_the_greedy_choice_loses_little_against_trying_every_set() -> None:
    """Over scenes, exposures and tolerances with 2 to 11 effects to choose from."""
    losses = []
    for scene in ("ramp", "room", "colour-chart", "tile-floor"):
        for sensor in ("complete", "mobile", "ccd"):
            for time_s in (0.001, 0.02):
                bounds = Bounds(a_shot(scene, sensor, time_s))
                for tolerance in (0.1, 0.5, 2.0):
                    # Effects that certainly change nothing are in both sets.
                    choices = [
                        e for e in candidates(bounds, tolerance) if bounds.single[e.name] > 0
                    ]
                    if not 2 <= len(choices) <= 11:
                        continue
                    best = saving(exhaustive(bounds, tolerance), bounds.shot)
                    chosen = saving(greedy(bounds, tolerance), bounds.shot)
                    assert chosen <= best + 1e-9
                    losses.append(1 - chosen / best if best else 0.0)
    print(
        f"{len(losses)} plans: greedy loses {statistics.mean(losses):.2%} of the time saved on"
        f" average, {max(losses):.1%} at most"
    )
    assert len(losses) > 15
    assert statistics.mean(losses) < 0.03
    assert max(losses) < 0.25


def test_a_joint_bound_does_not_depend_on_the_order_of_the_effects() -> None:
    """Effects left out are a set, whose order differs from process to process."""
    bounds = Bounds(a_shot("room", "complete", 0.01, (32, 48)))
    left_out = greedy(bounds, 0.5)
    assert len(left_out) > 4
    orders = itertools.islice(itertools.permutations(left_out), 0, 5000, 50)
    assert len({bounds.joint(order) for order in orders}) == 1


def test_a_shift_of_the_mean_changes_photon_noise_by_no_more_than_its_bound() -> None:
    """Compared with the formula of the noise, at both ends and in the middle of its table."""
    random = np.random.default_rng(2)
    z = normal_quantiles().astype(np.float64)[np.r_[0:40, 32768 - 40 : 32768 + 40, 65496:65536]]

    def drawn(mean: float) -> NDArray[np.float64]:
        skew = mean / (6 * mean + 0.2)
        return np.asarray(mean + np.sqrt(mean - 2 * skew**2) * z + skew * (z**2 - 1))

    tightest = 0.0
    for _ in range(4000):
        least = float(10 ** random.uniform(-4, 5)) * (random.random() > 0.1)
        low = least * float(10 ** (random.exponential(0.3)))
        shift = float(10 ** random.uniform(-6, 4))
        moved = float(np.abs(drawn(low + shift) - drawn(low)).max())
        bound = shift + absolute_shift(shift, least)
        assert moved <= bound * (1 + 1e-9)
        tightest = max(tightest, moved / bound)
        share = float(10 ** random.uniform(-6, 0.3))
        for factor in (1 + share, max(0.0, 1 - share)):
            moved = float(np.abs(drawn(low * factor) - drawn(low)).max())
            assert moved <= (share * low + relative_shift(share, low)) * (1 + 1e-9)
    assert tightest > 0.99


def test_photon_noise_stays_within_the_formula_of_the_bounds() -> None:
    for mean in (0.0, 0.3, 5.0, 1e4):
        electrons = np.full(5000, mean, dtype=np.float32)
        TileNoise().add_photon_noise(electrons, 1, 2, 3)
        skew = mean / (6 * mean + 0.2)
        reach = np.sqrt(mean - 2 * skew**2) * largest_noise() + skew * (largest_noise() ** 2 - 1)
        assert np.abs(electrons - mean).max() <= reach * (1 + 1e-5) + 1e-6


def test_the_records_of_all_effects_are_complete() -> None:
    assert len(set(effect_names())) == len(EFFECTS)
    for effect in EFFECTS:
        assert effect.model
        assert effect.cost >= 0
        work = (effect.timing, effect.picture, effect.lines, effect.apply, effect.flow)
        assert sum(each is not None for each in work) <= 1
    assert [effect.stage for effect in EFFECTS] == sorted(effect.stage for effect in EFFECTS)


def test_tolerance_0_leaves_out_what_changes_no_bit() -> None:
    for time_s, gone in (
        (1e-5, {"blooming", "full well", "cosmic rays"}),
        (1.0, {"cosmic rays", "mains flicker", "rolling shutter"}),
    ):
        shot = a_shot("night-street", "complete", time_s)
        plan = plan_frame(shot, 0.0)
        assert plan.left_out == gone
        assert plan.joint_bound_dn == 0
        renderer = Renderer(shot.view, shot.sensor, seed=1)
        everything = renderer.brightness(shot, plan_frame(shot, 0.0, left_out=()))
        assert np.array_equal(renderer.brightness(shot, plan), everything)


def test_a_plan_can_be_written_as_json() -> None:
    plan = plan_frame(a_shot("ramp", "complete", 0.001), 0.5)
    data = json.loads(json.dumps(plan.as_data(), allow_nan=False))
    assert data["tolerance_dn"] == 0.5
    assert 0 < data["joint_bound_dn"] <= 0.5
    assert [effect["name"] for effect in data["effects"]] == list(effect_names())
    for effect in data["effects"]:
        assert set(effect) == {
            "name",
            "bound_dn",
            "own_dn",
            "ran",
            "why",
            "lacking",
            "milliseconds",
        }
        assert effect["why"]
    never = next(effect for effect in data["effects"] if effect["name"] == "quantisation")
    assert never["bound_dn"] is None
    assert never["why"] == "never left out: pixel values are whole numbers"


def test_what_a_sensor_does_not_model_is_told_from_what_the_scene_lacks() -> None:
    plain = plan_frame(a_shot("ramp", "standard", 0.001), 0.5).effects
    unmodelled = {one.name for one in plain if one.lacking is Lacking.MODEL}
    assert unmodelled.issuperset(("PRNU", "dark current", "blooming", "vignetting"))
    assert not unmodelled & {"mains flicker", "motion blur", "colour mosaic", "read noise"}
    whole = plan_frame(a_shot("ramp", "complete", 0.001), 0.5).effects
    left = {one.name for one in whole if one.lacking is Lacking.MODEL}
    assert left < unmodelled
    assert not left & {"PRNU", "dark current", "blooming", "vignetting"}


def test_each_decision_gives_its_reason() -> None:
    dim, bright = a_shot("ramp", "complete", 0.001), a_shot("night-street", "complete", 4.0)
    whole = plan_frame(dim, 0.5)
    plan = {one.name: one for one in whole.effects}
    together = f"{whole.joint_bound_dn:.3g} DN with all others left out"
    assert plan["mains flicker"].lacking is Lacking.SCENE
    assert plan["response curve"].lacking is Lacking.KIND
    assert plan["DSNU"].why == f"changes at most {plan['DSNU'].own_dn:.3g} DN alone, {together}"
    assert plan["full well"].why == "changes nothing in this frame"
    assert plan["photon noise"].why.endswith("DN, more than the tolerance of 0.5 DN")
    plan = {one.name: one for one in plan_frame(bright, 0.5).effects}
    assert plan["full well"].why.endswith(" e-, above the full well of 1.05e+04 e-")
    plan = {one.name: one for one in plan_frame(dim, 0.0).effects}
    assert plan["DSNU"].why.startswith("can change 0.08")
    assert plan["DSNU"].why.endswith(" DN, and the tolerance is 0")


def test_a_bound_counts_only_light_that_does_not_fill_the_well() -> None:
    """A PRNU of 0.6 % changes a sample of a sensor without blooming by few levels, not by all."""
    sensor = load_sensor("complete")
    drained = {"pixels": sensor.pixels.model_copy(update={"blooming": 0.0})}
    sensor = sensor.model_copy(update=drained)
    view = View.of(load_scene("night-street", (48, 64)), sensor)
    shot = Renderer(view, sensor, seed=1).shot(4.0, 1.0, 0)
    bound = Bounds(shot).single["PRNU"]
    assert 5 < bound < 10
    everything, without = (plan_frame(shot, 0.0, left_out=names) for names in ((), ("PRNU",)))
    renderer = Renderer(view, sensor, seed=1)
    off = renderer.brightness(shot, everything) - renderer.brightness(shot, without)
    assert np.abs(off).max() <= bound


def test_more_tolerance_leaves_out_at_least_as_much() -> None:
    shot = a_shot("colour-chart", "complete", 0.01)
    savings = [saving(tuple(plan_frame(shot, t).left_out), shot) for t in (0.05, 0.5, 4.0, 50.0)]
    assert savings == sorted(savings)
    assert savings[-1] > savings[0]


def test_what_is_kept_between_frames_uses_up_no_tolerance() -> None:
    """Glare and optics of a scene at rest come last: at 0.5 DN a frame took longer than at 0.25."""
    shot = a_shot("tile-floor", "complete", 0.0004)
    bounds = Bounds(shot)
    left_out = [frozenset(greedy(bounds, tolerance)) for tolerance in (0.25, 0.5)]
    at_rest = {"veiling glare", "point spread", "vignetting", "crosstalk"}
    assert saved([EFFECT[name] for name in at_rest], shot) == 0
    with_target = a_shot("moving-target", "complete", 0.01)
    assert saved([EFFECT[name] for name in at_rest], with_target) > 0
    for chosen in left_out:
        others = chosen - at_rest
        more = [
            name
            for name in bounds.changes
            if name not in chosen | at_rest
            and bounds.joint([*others, name]) <= (0.25 if chosen is left_out[0] else 0.5)
            and EFFECT[name].cost_in(shot) > 0
        ]
        assert not more
    assert saving(tuple(left_out[1]), shot) >= saving(tuple(left_out[0]), shot)


@pytest.mark.parametrize("tolerance", [-1.0, float("nan"), float("inf")])
def test_an_invalid_tolerance_is_refused(tolerance: float) -> None:
    message = f"invalid tolerance {tolerance:g} DN; give 0 DN or more"
    with pytest.raises(UsageError, match=message):
        plan_frame(a_shot("ramp", "complete", 0.001), tolerance)
    with pytest.raises(UsageError, match=message):
        SimulatedCamera(load_scene("ramp", (4, 4)), load_sensor("complete"), tolerance_dn=tolerance)


def test_the_error_for_an_unknown_effect_suggests_a_similar_one() -> None:
    with pytest.raises(
        UsageError, match="unknown effect 'dark currant'; did you mean dark current"
    ):
        plan_frame(a_shot("ramp", "complete", 0.001), 0.5, left_out=["dark currant"])


def test_a_camera_plans_each_frame_with_its_share_of_the_tolerance() -> None:
    scene, sensor = load_scene("room", (48, 64)), load_sensor("complete")
    with SimulatedCamera(scene, sensor, tolerance_dn=0.6, seed=4) as camera:
        assert camera.last_plan is None
        plans: list[FramePlan] = []
        for _ in camera.shoot([ExposureSetting(t) for t in (0.001, 0.03, 2.0)]):
            assert camera.last_plan is not None
            plans.append(camera.last_plan)
    assert all(plan.tolerance_dn == pytest.approx(0.2) for plan in plans)
    assert all(0 < plan.joint_bound_dn <= 0.2 for plan in plans)
    assert not plans[0].runs("blooming")
    assert plans[2].runs("blooming")
    with SimulatedCamera(scene, sensor) as camera:
        next(iter(camera.shoot([ExposureSetting(0.001)])))
        assert camera.last_plan is not None
        assert camera.last_plan.tolerance_dn == 0


class Unreadable(np.ndarray[Any, np.dtype[np.float32]]):
    """An array with a shape, whose values no numpy function may read."""

    def __array_ufunc__(self, *_: Any, **__: Any) -> NoReturn:
        raise AssertionError("the pixels were read")

    def __array_function__(self, *_: Any, **__: Any) -> NoReturn:
        raise AssertionError("the pixels were read")


def test_planning_reads_no_pixels_once_the_statistics_are_known() -> None:
    shot = a_shot("night-street", "complete", 0.01)
    sensor, light = shot.sensor, shot.view.light.view(Unreadable)
    unreadable = View(light, shot.view.layout, shot.view.source)
    with pytest.raises(AssertionError, match="the pixels were read"):
        _ = unreadable.statistics
    vars(unreadable)["statistics"] = shot.view.statistics
    plan = plan_frame(Renderer(unreadable, sensor, seed=1).shot(0.01, 1.0, 0), 0.5)
    assert plan.as_data() == plan_frame(shot, 0.5).as_data()
    assert plan.left_out


def test_the_own_bound_is_without_streaks_of_overflowing_wells() -> None:
    sensor = load_sensor("complete")
    for time_s, overflows in ((4.0, True), (1e-8, False)):
        shot = a_shot("night-street", "complete", time_s)
        prnu = next(one for one in plan_frame(shot, 0.5).effects if one.name == "PRNU")
        assert Bounds(shot).overflows is overflows
        if overflows:
            assert prnu.bound_dn > 256
            # 4.325 standard deviations of a full well, and the photon noise of that charge.
            charge = 4.325 * 0.006 * sensor.full_well_e / sensor.electrons_per_dn
            assert charge < prnu.own_dn < 1.5 * charge
            assert "DN where full wells overflow" in prnu.why
        else:
            assert prnu.own_dn == prnu.bound_dn


def test_frames_with_hits_of_about_one_size_share_a_plan() -> None:
    sensor = load_sensor("complete")
    fields = sensor.model_dump()
    fields["read_out"]["cosmic_rate_s"] = 1e5
    sensor = type(sensor).model_validate(fields)
    renderer = Renderer(View.of(load_scene("ramp", (60, 80)), sensor), sensor, tolerance_dn=0.5)
    shots = [renderer.shot(1e-3, 1.0, number) for number in range(40)]
    hits = [cosmic_hits(shot)[0].size > 0 for shot in shots]
    assert [renderer.plan(shot).runs("cosmic rays") for shot in shots] == hits
    assert 0 < sum(hits) < len(hits)
    plans = {id(renderer.plan(shot)): renderer.plan(shot) for shot in shots}
    assert len(plans) < sum(hits) / 2
    for shot, is_hit in zip(shots, hits, strict=True):
        largest = float(cosmic_hits(shot)[1].max()) if is_hit else 0.0
        assert largest <= renderer.plan(shot).bounds.changes["cosmic rays"].hit_e <= 2 * largest


def test_a_frame_of_a_known_exposure_is_planned_without_asking_an_effect(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sensor = load_sensor("complete")
    renderer = Renderer(View.of(load_scene("ramp", (60, 80)), sensor), sensor)
    first = renderer.plan(renderer.shot(1e-3, 1.0, 0))
    assert "blooming" in first.left_out

    def must_not_run(*_: object) -> NoReturn:
        raise AssertionError("planned again")

    monkeypatch.setattr("camctl.sim.render.plan_frame", must_not_run)
    for effect in EFFECTS:
        monkeypatch.setitem(vars(effect), "change", must_not_run)
    again = renderer.plan(renderer.shot(1e-3, 1.0, 1))
    assert again is first
    renderer.expose(renderer.shot(1e-3, 1.0, 1), again)
