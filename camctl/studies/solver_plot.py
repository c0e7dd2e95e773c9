"""The plot of `camctl tradeoff solver`: regret against CPU time, one panel for each problem."""

from __future__ import annotations

from pathlib import Path

from camctl.studies.panels import Form, Panel, Place, draw_panels
from camctl.studies.solver_study import CAMCTL, ENOUGH, METHODS, Case, SolverStudy
from camctl.system.number_text import range_text

_FORM = Form(
    line=CAMCTL,
    x="CPU time, s",
    y="regret in xi",
    least=1e-5,
    caption="""Each panel is one problem; further down is better, further left is faster. The line
is camctl, the dots are the other methods, medians over the runs. A point of camctl or of the grid
is a complete search of that length; scipy's optimisers improve one answer as time goes on. All use
the same objective code. Regret is how far xi, the missing levels, lies above the least that any
run found: 0.01 is 1 %. The dotted line marks 0.5 %; a regret of zero is drawn at the bottom.""",
    mark=ENOUGH,
)


def draw_study(study: SolverStudy, paths: tuple[Path, ...]) -> None:
    """Draw regret against CPU time to `paths`; raises what `plots.plot` raises."""
    cases = sorted(study.cases, key=lambda case: case[2])
    draw_panels([_panel(study, case) for case in cases], _FORM, paths)


def _panel(study: SolverStudy, case: Case) -> Panel:
    def places(method: str) -> list[Place]:
        steps = sorted(spent for curve in study.curves(case, method) for spent, _ in curve)
        return [(time_s, study.regret_at(case, method, time_s)) for time_s in steps]

    response, dynamic_range, n, bits = case
    others = {method: places(method) for method in METHODS if method != CAMCTL}
    return Panel(
        f"{response}, {range_text(dynamic_range)}, {n} exposures, {bits} bits",
        places(CAMCTL),
        {method: found for method, found in others.items() if found},
    )
