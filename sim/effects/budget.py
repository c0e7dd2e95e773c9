"""Which effects of a frame to run: those that the tolerance does not allow to leave out."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

from camctl.errors import UsageError
from sim.effects import EFFECTS, check_names
from sim.effects.bounds import Bounds
from sim.effects.record import Effect, Shot


@dataclass(frozen=True)
class Decision:
    """What was decided of one effect.

    Attributes:
        name: the effect
        bound_dn: most that leaving it out alone changes in a sample before the ADC, DN; infinite
            where it is never left out, 0 where there is nothing to leave out
        ran: whether the frame has it
        why: in words
    """

    name: str
    bound_dn: float
    ran: bool
    why: str


@dataclass(frozen=True)
class FramePlan:
    """Which effects a frame has.

    Attributes:
        tolerance_dn: that was allowed for this frame
        joint_bound_dn: most that all that was left out can change together, DN before the ADC;
            after it at most that many whole levels, rounded up
        effects: a decision for each effect there is, in the order of the light's way
    """

    tolerance_dn: float
    joint_bound_dn: float
    effects: tuple[Decision, ...]

    def runs(self, name: str) -> bool:
        """Return whether the frame has that effect."""
        return any(one.ran for one in self.effects if one.name == name)

    @property
    def left_out(self) -> frozenset[str]:
        """Effects that sensor and scene have, but not this frame."""
        return frozenset(e.name for e in self.effects if not e.ran and e.why != ABSENT)

    def as_data(self) -> dict[str, Any]:
        """Return the plan as JSON has it; a bound without limit is None."""
        effects = [
            {
                "name": one.name,
                "bound_dn": one.bound_dn if math.isfinite(one.bound_dn) else None,
                "ran": one.ran,
                "why": one.why,
            }
            for one in self.effects
        ]
        return {
            "tolerance_dn": self.tolerance_dn,
            "joint_bound_dn": self.joint_bound_dn,
            "effects": effects,
        }


ABSENT = "scene and sensor have none"


def check_tolerance(tolerance_dn: float) -> float:
    """Return a tolerance in DN; raises `UsageError` unless it is finite and not negative."""
    if not (math.isfinite(tolerance_dn) and tolerance_dn >= 0):
        raise UsageError(f"a tolerance of {tolerance_dn:g} DN", hint="give 0 DN or more")
    return tolerance_dn


def plan_frame(
    shot: Shot, tolerance_dn: float, *, left_out: Collection[str] | None = None
) -> FramePlan:
    """Choose what a frame leaves out.

    Args:
        shot: the exposure
        tolerance_dn: most that may change in any sample before the ADC; 0 runs everything
        left_out: leave out these effects and no others, whatever that changes

    Raises:
        UsageError: an unknown effect in `left_out`; a tolerance that is none
    """
    check_tolerance(tolerance_dn)
    bounds = Bounds(shot)
    if left_out is not None:
        chosen: tuple[str, ...] = tuple(n for n in check_names(left_out) if n in bounds.changes)
    elif tolerance_dn == 0:
        chosen = ()
    else:
        chosen = greedy(bounds, tolerance_dn)
    joint = bounds.joint(chosen) if chosen else 0.0
    decisions = tuple(_decision(e, bounds, chosen, tolerance_dn, joint) for e in EFFECTS)
    return FramePlan(tolerance_dn, joint, decisions)


def candidates(bounds: Bounds, tolerance_dn: float) -> tuple[Effect, ...]:
    """Return the effects that the tolerance allows to leave out alone."""
    return tuple(
        e for e in EFFECTS if e.name in bounds.changes and bounds.single[e.name] <= tolerance_dn
    )


def greedy(bounds: Bounds, tolerance_dn: float) -> tuple[str, ...]:
    """Return a dear set of effects whose joint bound stays under the tolerance.

    Two orders are tried, most time saved for each DN first and most time saved first; an effect
    that fits beside those already chosen is added.  The dearer of the two sets is taken.
    """
    fits = [(e, bounds.single[e.name]) for e in candidates(bounds, tolerance_dn)]
    orders = (
        sorted(fits, key=lambda one: (one[1] / one[0].cost, -one[0].cost)),
        sorted(fits, key=lambda one: -one[0].cost),
    )
    best: tuple[Effect, ...] = ()
    for order in orders:
        chosen: tuple[Effect, ...] = ()
        for effect, _ in order:
            wider = (*chosen, effect)
            if bounds.joint([e.name for e in wider]) <= tolerance_dn:
                chosen = wider
        best = max(best, chosen, key=saved)
    return tuple(effect.name for effect in best)


def exhaustive(bounds: Bounds, tolerance_dn: float) -> tuple[str, ...]:
    """Return the dearest set under the tolerance, by trying every set: what `greedy` may lose."""
    fits = candidates(bounds, tolerance_dn)
    sets = itertools.chain.from_iterable(
        itertools.combinations(fits, count) for count in range(len(fits) + 1)
    )
    allowed = (s for s in sets if not s or bounds.joint([e.name for e in s]) <= tolerance_dn)
    return tuple(effect.name for effect in max(allowed, key=saved))


def saved(effects: Sequence[Effect]) -> float:
    """Return the nanoseconds a sample that leaving out these effects saves."""
    return sum(effect.cost for effect in effects)


def _decision(
    effect: Effect, bounds: Bounds, chosen: Collection[str], tolerance_dn: float, joint: float
) -> Decision:
    name = effect.name
    if name not in bounds.changes:
        return Decision(name, 0.0, False, ABSENT)
    alone = bounds.single[name]
    if name in chosen:
        together = f", {joint:.2g} DN with all that was left out" if len(chosen) > 1 else ""
        return Decision(name, alone, False, f"changes at most {alone:.2g} DN{together}")
    change = bounds.changes[name]
    if change.never:
        why = change.never
    elif change.only_below_well and math.isinf(alone):
        well = bounds.shot.sensor.full_well_e
        why = f"up to {bounds.peak_e:.3g} e- would come to a well of {well:.3g} e-"
    elif tolerance_dn == 0:
        why = "a tolerance of 0 runs everything"
    elif alone > tolerance_dn:
        why = f"can change {alone:.3g} DN, more than {tolerance_dn:g} DN"
    else:
        why = f"can change {alone:.2g} DN, too much beside what was left out"
    return Decision(name, alone, True, why)
