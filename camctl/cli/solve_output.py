"""How much better any other exposures could be: a proof, or the best bound there is."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from camctl.cli.output import (
    Tick,
    duration,
    fields,
    number,
    progress_bar,
    range_name,
    say,
    say_json,
)

if TYPE_CHECKING:
    from camctl.exposure.lower_bound import Certificate
    from camctl.response.camera import CameraResponse
    from camctl.response.desired import DesiredResponse

SETTLED = 1.01e-4
"""A relative gap of this or less is a proof: the search for it stops at 1e-4."""

USUAL_SETS = 400_000
"""What settles two exposures of up to 10 bits."""

_PACE_SETS = 256


def prove(
    real: CameraResponse,
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
    from camctl.exposure.lower_bound import certify

    most = USUAL_SETS
    pace = _sets_a_second(real, desired, n)
    if limit_s is not None:
        most = max(1, int(limit_s * pace))
    with progress_bar("proving" if n <= 2 else "bounding") as tick, _passing(tick, most / pace):
        return certify(
            real, desired, n, levels_wanted=levels_wanted, max_evaluations=most, seed=seed
        )


def _sets_a_second(real: CameraResponse, desired: DesiredResponse, n: int) -> float:
    """Return how many sets of n exposures this machine scores in a second."""
    import numpy as np

    from camctl.exposure.candidates import BatchScore
    from camctl.exposure.objective import ExposureProblem

    score = BatchScore(ExposureProblem(real, desired, n), exact=True)
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


if TYPE_CHECKING:
    from camctl.exposure.grid_search import SettingsSolution
    from camctl.exposure.lower_bound import Certificate
    from camctl.exposure.solver import Solution

SAME_EXPOSURE = 1e-8
"""Products of time and gain that agree to this are one exposure."""

Made = list[tuple[float, float]]
"""Shutter time in s and gain of each exposure."""


def made_of(
    found: SettingsSolution, times: tuple[float, ...] | None, gains: tuple[float, ...] | None
) -> Made:
    """Return the time and the gain that make each exposure, the least gain that does."""
    pairs = [(gain, time_s) for gain in sorted(gains or (1.0,)) for time_s in times or ()]
    made = []
    for product in found.settings:
        gain, time_s = next(
            pair for pair in pairs if abs(pair[0] * pair[1] / product - 1) <= SAME_EXPOSURE
        )
        made.append((time_s, gain))
    return made


def tell(
    found: Solution,
    camera: str,
    response: str,
    dynamic_range: float,
    seed: int,
    *,
    as_json: bool,
    plain: bool = True,
    proof: Certificate | None = None,
    possible: tuple[SettingsSolution, Made] | None = None,
) -> None:
    """Say what was found; with `possible`, what a camera can set, `found` is the ideal."""
    told: Solution = found if possible is None else possible[0]
    if as_json:
        facts: dict[str, Any] = {
            "exposures": told.exposures,
            "xi": told.xi,
            "levels_wanted": told.levels_wanted,
            "effective_levels": told.effective_levels,
            "total_exposure": told.total_exposure,
            "seconds": told.seconds,
            "evaluations": told.evaluations,
            "response": response,
            "dynamic_range": dynamic_range,
            "camera": camera,
            "seed": seed,
        }
        if proof is not None:
            facts["certificate"] = certificate_facts(proof)
        if possible is not None:
            facts["settings_s"] = [time_s for time_s, _ in possible[1]]
            facts["gains"] = [gain for _, gain in possible[1]]
            facts["shutter_s"] = sum(facts["settings_s"])
            facts["every_set_tried"] = possible[0].enumerated
            facts["without_settings"] = {
                "exposures": found.exposures,
                "xi": found.xi,
                "effective_levels": found.effective_levels,
            }
        say_json(facts)
        return
    rows = [
        ("wanted", desired_name(response, dynamic_range, len(told.exposures))),
        ("camera", camera),
        ("exposures", "  ".join(number(value) for value in told.exposures)),
        objective_line(told.xi, told.levels_wanted, plain=plain),
        ("effective levels", number(told.effective_levels, 4)),
        ("shutter open", f"{number(told.total_exposure)} x the shortest exposure"),
    ]
    if proof is None:
        work = f"{number(told.seconds, 3)} s, {told.evaluations:,} sets, seed {seed}"
        rows += [("search", work)]
    if possible is not None:
        with_gain = any(gain != 1 for _, gain in possible[1])
        settings = [
            duration(time_s) + (f" x {number(gain)}" if with_gain else "")
            for time_s, gain in possible[1]
        ]
        open_s = duration(sum(time_s for time_s, _ in possible[1]))
        rows[2:2] = [("settings", "  ".join(settings))]
        rows[-2] = ("shutter open", open_s)
        if possible[0].enumerated:
            rows[-1] = (rows[-1][0], f"{rows[-1][1]}: every set there is")
        share = told.effective_levels / found.effective_levels
        kept = f"the camera's own settings keep {number(100 * share, 3)} % of these levels"
        if share > 1:
            kept = "the camera's own settings give no fewer effective levels"
        rows += [
            ("any times at all", "  ".join(number(value) for value in found.exposures)),
            (
                "",
                f"{number(found.xi, 5)} (xi), {number(found.effective_levels, 4)} effective levels",
            ),
            ("", kept),
        ]
    text = fields(rows)
    say(text if proof is None else f"{text}\n\n{certificate_text(proof)}")


def desired_name(response: str, dynamic_range: float, count: int) -> str:
    """Return what is wanted, in words."""
    return (
        f"{response}, {range_name(dynamic_range)}, in {count} exposure{'s' if count != 1 else ''}"
    )


def objective_line(xi: float, levels_wanted: float, *, plain: bool) -> tuple[str, str]:
    """Return the objective in words; only the plain one counts levels."""
    if plain:
        return "wanted levels missing", f"{number(xi, 5)} of {number(levels_wanted)} (xi)"
    return "objective", f"{number(xi)}, {number(levels_wanted)} levels wanted"
