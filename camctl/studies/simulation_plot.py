"""The plot of `camctl tradeoff simulation`: differences against CPU time, a panel for a scene."""

from __future__ import annotations

from pathlib import Path

from camctl.studies.panels import Form, Panel, Place, draw_panels
from camctl.studies.simulation_study import (
    CAMCTL,
    SimulationPoint,
    SimulationRun,
    SimulationStudy,
)

_FORM = Form(
    line="camctl, by tolerance in DN",
    x="CPU time of a frame, ms",
    y="mean difference, levels",
    least=1e-4,
    caption="""Each panel is one scene and exposure; further left is faster, further down is more
faithful. The line has the smallest difference that camctl's tolerances reach in each time, with the
tolerance in DN; each dot is a method that leaves out the same effects in every frame. The mean
difference, after the ADC, is from the frame in which every effect was simulated; a difference of
zero is drawn at the bottom.""",
    columns=5,
)


def draw_study(study: SimulationStudy, paths: tuple[Path, ...]) -> None:
    """Draw differences against CPU time to `paths`; raises what `plots.plot` raises."""
    panels = [_panel(run, points) for run, points in zip(study.runs, study.points, strict=True)]
    draw_panels(panels, _FORM, paths)


def _panel(run: SimulationRun, points: tuple[SimulationPoint, ...]) -> Panel:
    exposure = "" if run.stops == 0 else f", {run.stops:+g} stops"
    line: list[Place] = []
    names: dict[Place, str] = {}
    dots: dict[str, list[Place]] = {}
    for point in sorted(points, key=lambda each: (each.milliseconds, each.mean_dn)):
        place = (point.milliseconds, point.mean_dn)
        if point.tolerance_dn is None:
            dots.setdefault(point.method, []).append(place)
        elif point.method == CAMCTL and (not line or place[1] < line[-1][1]):
            line.append(place)
            names[place] = f"{point.tolerance_dn:g}"
    return Panel(f"{Path(run.scene).name}{exposure}", line, dict(sorted(dots.items())), names)
