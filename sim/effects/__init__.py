"""The effects of a simulated sensor; each is one record, see `camctl.sim.effects.record.Effect`."""

from __future__ import annotations

from collections.abc import Iterable

from camctl.errors import unknown_name
from camctl.sim.effects.charge import CHARGE, PIXELS
from camctl.sim.effects.dark import DARK
from camctl.sim.effects.optics import OPTICS
from camctl.sim.effects.readout import READ_OUT
from camctl.sim.effects.record import Effect

__all__ = ["EFFECTS", "check_names", "effect_names"]

EFFECTS: tuple[Effect, ...] = (*OPTICS, *PIXELS, *DARK, *CHARGE, *READ_OUT)
"""All effects, in the order in which light goes through them."""


def effect_names() -> tuple[str, ...]:
    """Return the names of all effects, in the order of `EFFECTS`."""
    return tuple(effect.name for effect in EFFECTS)


def check_names(names: Iterable[str]) -> frozenset[str]:
    """Return names of effects as a set.

    Raises:
        UsageError: one of them is not the name of an effect
    """
    requested = frozenset(names)
    for name in sorted(requested.difference(effect_names())):
        raise unknown_name("effect", name, effect_names())
    return requested
