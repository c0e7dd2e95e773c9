"""How much better any other exposures could be: a proof, or the best bound there is."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from camctl.cli.output import fields, number
from camctl.cli.progress import Tick, progress_bar

if TYPE_CHECKING:
    from camctl.exposure.certificate import Certificate
    from camctl.exposure.response import DesiredResponse, RealResponse

SETTLED = 1.01e-4
"""A relative gap of this or less is a proof: the search for it stops at 1e-4."""

USUAL_SETS = 400_000
"""What settles two exposures of up to 10 bits."""

_PACE_SETS = 256


def prove(
    real: RealResponse,
    desired: DesiredResponse,
    n: int,
    *,
    levels_wanted: float | None,
    seed: int,
    limit_s: float | None,
) -> Certificate:
    """Return the best n exposures with a lower bound for all others.

    Bounds `USUAL_SETS` sets, or as many as this machine bounds in about `limit_s` seconds.
    """
    from camctl.exposure.certificate import certify

    most = USUAL_SETS
    pace = _sets_a_second(real, desired, n)
    if limit_s is not None:
        most = max(1, int(limit_s * pace))
    with progress_bar("proving" if n <= 2 else "bounding") as tick, _passing(tick, most / pace):
        return certify(
            real, desired, n, levels_wanted=levels_wanted, most_evaluations=most, seed=seed
        )


def _sets_a_second(real: RealResponse, desired: DesiredResponse, n: int) -> float:
    """Return how many sets of n exposures this machine scores in a second."""
    import numpy as np

    from camctl.exposure.goal import Goal
    from camctl.exposure.kernels import BatchScore

    score = BatchScore(real, desired, Goal(n * real.M), n, exact=True)
    spread = np.linspace(0.0, math.log(desired.dynamic_range), _PACE_SETS)
    sets = np.exp(spread[:, np.newaxis] * np.linspace(0.0, 1.0, n))
    score(sets[:1])
    started = time.perf_counter()
    score(sets)
    return _PACE_SETS / (time.perf_counter() - started)


@contextmanager
def _passing(tick: Tick | None, at_most_s: float) -> Iterator[None]:
    """Move the bar with the time that passes, up to the most that the work may take."""
    if tick is None:
        yield
        return
    show = tick
    ended = threading.Event()
    started = time.monotonic()

    def watch() -> None:
        while not ended.wait(0.2):
            show(min((time.monotonic() - started) / at_most_s, 0.99), "")

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


def certificate_facts(proof: Certificate) -> dict[str, Any]:
    """Return what a script wants to know."""
    return {
        "proven": proof.gap <= SETTLED,
        "best_known": proof.xi,
        "lower_bound": proof.lower_bound,
        "gap": proof.gap,
        "sets_bounded": proof.evaluations,
        "seconds": proof.seconds,
    }


def certificate_text(proof: Certificate) -> str:
    """Return the certificate as a person reads it."""
    n = len(proof.exposures)
    which = "any exposure" if n == 1 else f"any {n} exposures"
    if proof.gap <= SETTLED:
        title = "certificate: proven, nothing better exists"
    elif proof.lower_bound > 0:
        title = "certificate: a bound, no proof; nothing says that better exposures exist"
    else:
        title = "certificate: nothing is proven yet; every xi is at least 0 anyway"
    return "\n".join(
        [
            title,
            fields(
                [
                    ("  best known xi", number(proof.xi, 8)),
                    ("  lower bound", f"{number(proof.lower_bound, 8)} for {which} at all"),
                    (
                        "  gap",
                        f"{number(proof.xi - proof.lower_bound, 3)}, "
                        f"{number(100 * proof.gap, 2)} % of the best known",
                    ),
                    (
                        "  boxes examined",
                        f"{proof.evaluations:,} in ln e, {number(proof.seconds, 3)} s",
                    ),
                ]
            ),
        ]
    )
