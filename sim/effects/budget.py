"""Which effects a frame needs: those that the tolerance does not allow to be left out."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from camctl.errors import UsageError
from camctl.sim.effects import EFFECTS, check_names
from camctl.sim.effects.bounds import Bounds
from camctl.sim.effects.record import Effect, Lacking, Shot


@dataclass(frozen=True)
class Decision:
    """Whether a frame has one effect.

    Attributes:
        name: of the effect
        bound_dn: bound of the change of any sample before the ADC if this effect alone is left
            out, DN; infinite if it is never left out, 0 if it is absent
        own_dn: the same but for streaks of charge from full wells, which it can end earlier
        ran: whether the frame has it
        why: the reason, for users
        lacking: why scene and sensor do not have it; None if they have it
        milliseconds: time of the effect in a frame of this size after the first, by its cost on one
            core
    """

    name: str
    bound_dn: float
    own_dn: float
    ran: bool
    why: str
    lacking: Lacking | None = None
    milliseconds: float = 0.0

    def as_data(self) -> dict[str, Any]:
        """Return the decision for JSON; an infinite bound is None."""
        return {
            "name": self.name,
            "bound_dn": self.bound_dn if math.isfinite(self.bound_dn) else None,
            "own_dn": self.own_dn if math.isfinite(self.own_dn) else None,
            "ran": self.ran,
            "why": self.why,
            "lacking": None if self.lacking is None else self.lacking.name.lower(),
            "milliseconds": self.milliseconds,
        }


@dataclass(frozen=True, eq=False)
class FramePlan:
    """Which effects a frame has.

    Attributes:
        tolerance_dn: tolerance of this frame
        bounds: of the exposure
        left_out: names of the effects that sensor and scene have, but not this frame
    """

    tolerance_dn: float
    bounds: Bounds
    left_out: frozenset[str]

    @cached_property
    def joint_bound_dn(self) -> float:
        """Bound of the change of any sample before the ADC by all effects left out together, DN.

        After the ADC the change is at most that many levels, rounded up.
        """
        return self.bounds.joint(self.left_out) if self.left_out else 0.0

    @cached_property
    def effects(self) -> tuple[Decision, ...]:
        """A decision for each effect, with words for users, in the order of `EFFECTS`."""
        return tuple(_decision(effect, self) for effect in EFFECTS)

    def runs(self, name: str) -> bool:
        """Return whether the frame has the effect `name`."""
        return name in self.bounds.changes and name not in self.left_out

    @property
    def simulated(self) -> tuple[str, ...]:
        """Names of the effects that the frame has."""
        return tuple(effect.name for effect in EFFECTS if self.runs(effect.name))

    def as_data(self) -> dict[str, Any]:
        """Return the plan for JSON; an infinite bound is None."""
        effects = [one.as_data() for one in self.effects]
        return {
            "tolerance_dn": self.tolerance_dn,
            "joint_bound_dn": self.joint_bound_dn,
            "effects": effects,
        }

    def summary(self) -> dict[str, Any]:
        """Return tolerance, bound, and the bound of each effect left out, for a report."""
        bounds = {e.name: self.bounds.single[e.name] for e in EFFECTS if e.name in self.left_out}
        return {
            "tolerance_dn": self.tolerance_dn,
            "joint_bound_dn": self.joint_bound_dn,
            "left_out": bounds,
        }


def check_tolerance(tolerance_dn: float) -> float:
    """Return a tolerance in DN; raises `UsageError` unless it is finite and not negative."""
    if not (math.isfinite(tolerance_dn) and tolerance_dn >= 0):
        raise UsageError(f"invalid tolerance {tolerance_dn:g} DN", hint="give 0 DN or more")
    return tolerance_dn


def plan_frame(
    shot: Shot,
    tolerance_dn: float,
    *,
    left_out: Collection[str] | None = None,
    bounds: Bounds | None = None,
) -> FramePlan:
    """Decide which effects a frame leaves out.

    Args:
        shot: the exposure
        tolerance_dn: largest allowed change of any sample before the ADC; 0 leaves out only what
            changes no bit
        left_out: names of the effects to leave out instead, whatever that changes
        bounds: the bounds of `shot`, where the caller has them

    Raises:
        UsageError: an invalid tolerance; an unknown effect in `left_out`
    """
    check_tolerance(tolerance_dn)
    bounds = bounds or Bounds(shot)
    if left_out is not None:
        chosen = frozenset(check_names(left_out)) & set(bounds.changes)
    elif tolerance_dn == 0:
        chosen = bounds.changes_nothing
    else:
        chosen = frozenset(greedy(bounds, tolerance_dn))
    return FramePlan(tolerance_dn, bounds, chosen)


def candidates(bounds: Bounds, tolerance_dn: float) -> tuple[Effect, ...]:
    """Return the effects that the tolerance allows to leave out alone."""
    return tuple(
        e for e in EFFECTS if e.name in bounds.changes and bounds.single[e.name] <= tolerance_dn
    )


def greedy(bounds: Bounds, tolerance_dn: float) -> tuple[str, ...]:
    """Return a costly set of effects whose joint bound is within the tolerance.

    Two orders are tried: most time saved for each DN first, and most time saved first.  An effect
    is added if the joint bound stays within the tolerance; of the two sets the one that saves more
    time is returned.  What costs nothing in later frames comes last: it saves time in the first.
    """
    fits = [
        (e, e.cost_in(bounds.shot), bounds.single[e.name]) for e in candidates(bounds, tolerance_dn)
    ]
    orders = (
        sorted(fits, key=lambda one: (not one[1], one[2] / (one[0].cost or 1), -one[0].cost)),
        sorted(fits, key=lambda one: (-one[1], -one[0].cost)),
    )
    best: tuple[Effect, ...] = ()
    for order in orders:
        chosen: tuple[Effect, ...] = ()
        for effect, _, _ in order:
            wider = (*chosen, effect)
            if bounds.joint([e.name for e in wider]) <= tolerance_dn:
                chosen = wider
        best = max(best, chosen, key=lambda effects: saved(effects, bounds.shot))
    return tuple(effect.name for effect in best)


def saved(effects: Iterable[Effect], shot: Shot) -> float:
    """Return the nanoseconds that leaving out these effects saves for each sample."""
    return sum(effect.cost_in(shot) for effect in effects)


def _decision(effect: Effect, plan: FramePlan) -> Decision:
    name, bounds, tolerance_dn, chosen = effect.name, plan.bounds, plan.tolerance_dn, plan.left_out
    shot = bounds.shot
    if name not in bounds.changes:
        lacking = effect.lacking(shot)
        return Decision(name, 0.0, 0.0, False, str(lacking), lacking=lacking)
    alone = bounds.single[name]
    own = bounds.own[name]
    change = bounds.changes[name]
    milliseconds = effect.cost_in(shot) * effect.samples(shot) * 1e-6
    range_dn = 2.0**shot.sensor.bits
    size = f"{own:.3g} DN"
    if alone > 1.01 * own:
        size += (
            f" ({min(alone, range_dn):.3g} DN where full wells overflow and a streak of charge ends"
            " a row earlier)"
        )
    if name in chosen:
        together = (
            f" alone, {plan.joint_bound_dn:.3g} DN with all others left out"
            if len(chosen) > 1
            else ""
        )
        why = f"changes at most {size}{together}"
        if alone == 0:
            why = change.nothing or "changes nothing in this frame"
        return Decision(name, alone, own, False, why, milliseconds=milliseconds)
    if change.never:
        why = change.never
    elif change.only_below_well and math.isinf(alone):
        well = shot.sensor.full_well_e
        why = f"charge can reach {bounds.peak_e:.3g} e-, above the full well of {well:.3g} e-"
    elif own >= range_dn:
        why = "can change a sample by the whole range of the ADC"
    elif tolerance_dn == 0:
        why = f"can change {size}, and the tolerance is 0"
    elif alone > tolerance_dn:
        why = f"can change {size}, more than the tolerance of {tolerance_dn:g} DN"
    else:
        why = f"can change {size}, too much together with the effects left out"
    return Decision(name, alone, own, True, why, milliseconds=milliseconds)
