"""The effects of a simulated sensor, each one record; see `sim.effects.record.Effect`."""

from __future__ import annotations

from collections.abc import Iterable

from camctl.errors import unknown_name
from sim.effects.charge import CHARGE
from sim.effects.optics import OPTICS
from sim.effects.readout import READ_OUT
from sim.effects.record import Change, Effect, Shot, Stage, Tile

__all__ = ["EFFECTS", "Change", "Effect", "Shot", "Stage", "Tile", "check_names", "effect_names"]

EFFECTS: tuple[Effect, ...] = (*OPTICS, *CHARGE, *READ_OUT)
"""All effects, in the order of the light's way."""


def effect_names() -> tuple[str, ...]:
    """Return the names of all effects."""
    return tuple(effect.name for effect in EFFECTS)


def check_names(names: Iterable[str]) -> frozenset[str]:
    """Return names of effects as a set; raises `UsageError` for an unknown one."""
    wanted = frozenset(names)
    for name in sorted(wanted.difference(effect_names())):
        raise unknown_name("effect", name, effect_names())
    return wanted
