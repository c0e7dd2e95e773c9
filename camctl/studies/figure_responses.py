"""The paper's figures 3, 5 and 8, which show responses, and the table of figure 4(a)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from camctl.exposure.accuracy import solve_accuracy
from camctl.exposure.evaluation import evaluate
from camctl.exposure.exposure_choices import AccuracyProblem
from camctl.exposure.noise import noisy_effective_levels
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import CameraResponse, linear_response
from camctl.model.response.desired import desired_response
from camctl.profiles.calibrated import open_camera
from camctl.studies.bracket_methods import PRINTED_TABLE
from camctl.studies.figure_parts import (
    BASELINE,
    COMPUTED,
    DOUBLING,
    PRINTED,
    PaperFigure,
    computed,
    draw_desired,
    draw_staircase,
    ratios_text,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

#: The levels of the camera in figure 3, read from the paper's drawing, and its second exposure.
_FIGURE_3_LEVELS = (0.20, 0.42, 0.78)


def _figure_3(figure: Figure) -> None:
    camera = CameraResponse(np.array(_FIGURE_3_LEVELS), "4 brightness levels")
    second = 1.6
    left, right = figure.subfigures(1, 2, width_ratios=(1, 1.25), squeeze=False)[0]
    panels = left.subplots(2, 1)
    _levels_panel(panels[0], camera, (1.0,), "(a) exposure $e_1 = 1$", DOUBLING)
    _levels_panel(panels[1], camera, (second,), f"(b) exposure $e_2 = {second:g}$", COMPUTED)
    union = right.subplots()
    _levels_panel(union, camera, (1.0, second), "(c) effective camera: the sum of both", "#222222")
    for exposure, colour in ((1.0, DOUBLING), (second, COMPUTED)):
        for level in np.array(_FIGURE_3_LEVELS) / exposure:
            union.axvline(level, ymax=0.16, color=colour, linewidth=3)


def _levels_panel(
    axes: Axes, camera: CameraResponse, exposures: tuple[float, ...], title: str, colour: str
) -> None:
    """Draw the staircase of some exposures over a bar that marks where it rises."""
    levels = EffectiveCamera.of(camera, exposures).levels
    edges = np.concatenate([[0.0], levels, [1.0]])
    axes.stairs(np.arange(levels.size + 1), edges, baseline=None, color=colour, linewidth=2)
    axes.vlines(levels, -0.22 * (levels.size + 1), 0, color=colour, linewidth=1.5)
    axes.axhline(0, color="#888888", linewidth=0.8)
    axes.set(title=title, xlim=(0, 1), ylim=(-0.22 * (levels.size + 1), levels.size + 0.5))
    names = [f"$E_{k + 1}$" for k in range(levels.size)]
    axes.set_xticks(levels.tolist(), names)
    axes.set_yticks(range(levels.size + 1))
    axes.set(ylabel="brightness B", xlabel="irradiance E")
    axes.grid(visible=False)


def _figure_5(figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    _response_panel(left, 4, "linear", math.inf, (1.0, 1.05, 1.11), "(a) 4 bits")
    _response_panel(right, 8, "linear", 2.0**10, PRINTED_TABLE["linear", 3], "(b) 8 bits")
    zoom = right.inset_axes((0.6, 0.06, 0.38, 0.28), xticks=[], yticks=[])
    _responses(zoom, 8, "linear", 2.0**10, PRINTED_TABLE["linear", 3])
    zoom.set(xlim=(0.965, 1.0), ylim=(0.975, 1.001))
    zoom.grid(visible=False)
    right.indicate_inset_zoom(zoom, edgecolor="#444444")


def _figure_8(figure: Figure) -> None:
    left, right = figure.subplots(1, 2)
    for axes, n, title in ((left, 3, "(a) 3 exposures"), (right, 5, "(b) 5 exposures")):
        _response_panel(axes, 8, "log", 2.0 ** (7 + n), PRINTED_TABLE["log", n], title)


def _response_panel(
    axes: Axes,
    bits: int,
    response: str,
    dynamic_range: float,
    printed: tuple[float, ...],
    title: str,
) -> None:
    _responses(axes, bits, response, dynamic_range, printed)
    # Responses above a linear one leave no corner free: the legend stands above them.
    is_log = response == "log"
    axes.set(title=title, xlim=(0, 1), ylim=(0, 1.01 if is_log else 1.38))
    axes.set(xlabel="irradiance", ylabel="brightness", yticks=np.linspace(0, 1, 6))
    axes.legend(loc="lower right" if is_log else "upper left", fontsize=7.5)


def _responses(
    axes: Axes, bits: int, response: str, dynamic_range: float, printed: tuple[float, ...]
) -> None:
    """Draw the desired response, and the responses of doubled, printed and computed exposures."""
    camera, desired = linear_response(bits), desired_response(response, dynamic_range)
    doubled = tuple(2.0**k for k in range(len(printed)))
    found = computed(bits, response, dynamic_range, len(printed)).exposures
    is_printed = np.allclose(printed, found, rtol=1e-3)
    draw_desired(axes, desired)
    for exposures, colour, name in (
        (doubled, DOUBLING, "baseline"),
        (printed, PRINTED, "printed"),
        (found, COMPUTED, "computed"),
    ):
        if name == "printed" and is_printed:
            continue
        label = f"{name}: {ratios_text(exposures)}"
        if name == "computed" and is_printed:
            label += ", as printed"
        draw_staircase(axes, camera, exposures, color=colour, linewidth=1.3, label=label)


def _table_4(figure: Figure) -> None:
    """Draw the table, one line for each response and number of exposures."""
    camera = linear_response(8)
    with open_camera("sim", {"sensor": "standard", "size": "8x8", "profile": "none"}) as standard:
        noise = standard.controls.noise
    assert noise is not None
    one_frame = noise.frame(gain=1.0, time_s=0.0)
    cells = []
    for (response, n), printed in PRINTED_TABLE.items():
        desired = desired_response(response, 2.0 ** (7 + n))
        by_xi = computed(8, response, desired.dynamic_range, n).exposures
        by_noise = solve_accuracy(AccuracyProblem(camera, desired, noise), (n,)).exposures
        texts = [{"log": "constant contrast"}.get(response, response), str(n)]
        for exposures in (printed, by_xi, by_noise):
            quality = evaluate(camera, desired, exposures)
            effective = EffectiveCamera.of(camera, exposures)
            noisy = noisy_effective_levels(effective, desired, [one_frame] * n)
            texts += [
                ratios_text(exposures),
                f"{quality.xi:.1f}",
                f"{noisy:.0f}",
                f"{quality.total_exposure:.1f}",
            ]
        cells.append(texts)
    axes = figure.subplots()
    axes.set_axis_off()
    quality_names = ["xi", "levels", "time"]
    names = ["response", "n"]
    for name in ("printed in the paper", "chosen by xi", "chosen by accuracy with noise"):
        names += [name, *quality_names]
    widths = [0.1, 0.02, *([0.2, 0.04, 0.04, 0.047] * 3)]
    table = axes.table(cells, colLabels=names, colWidths=widths, loc="center", cellLoc="right")
    table.auto_set_font_size(False)
    table.set_fontsize(7.5)
    table.scale(1, 1.25)
    for (row, column), cell in table.get_celld().items():
        cell.set_linewidth(0.4)
        cell.set_edgecolor("#bbbbbb")
        if row == 0:
            cell.set_text_props(weight="bold")
        elif ((row - 1) // 5) % 2:
            cell.set_facecolor("#f2f4f7")
        if column in (0, 2, 6, 10):
            cell.set_text_props(ha="left")
            cell.PAD = 0.03


FIGURES = (
    PaperFigure(
        "3",
        "The levels of two exposures together are the levels of their sum",
        """A camera of four brightness levels. The bars below the curves mark the irradiances at
        which brightness rises. (a) Exposure 1. (b) A longer exposure moves all of them to the left,
        to E / e. (c) The sum of both pictures rises at each of them (long bars, in the colour of
        the exposure that they come from): it keeps everything that the single pictures tell.""",
        (8.0, 4.6),
        _figure_3,
    ),
    PaperFigure(
        "4",
        "The table of exposures, with xi and with noise",
        """Exposures of a linear 8-bit camera for a dynamic range of 1:2^(7 + n) and 255 n desired
        levels: as printed in the paper, found here by the paper's objective xi, and found here by
        accuracy with the noise of the simulated sensor 'standard'. xi counts the desired levels
        that are missing (less is better); levels is the accuracy as a number of equal steps, noise
        counted in (more is better); time is the sum of the exposures. The sets chosen by xi have
        the least xi everywhere. Those chosen with noise are the shortest within 0.5 % of the most
        levels: for linear and gamma never longer than those chosen by xi, with 0.5 % fewer to 18 %
        more levels.""",
        (14.0, 4.9),
        _table_4,
    ),
    PaperFigure(
        "5",
        "A linear camera with more levels",
        f"""The effective camera should be linear (dashed), at least as steep everywhere. With the
        doubled exposures {ratios_text(BASELINE)} (orange) only the shortest frame is not saturated
        above half of the irradiance: the steps there are as coarse as in one frame. The
        computed exposures (blue) have two frames there, whose levels interleave, and steps of half
        the width, (a) with 4 bits, (b) with 8 bits; the inset shows the steps near the highlights.
        In (a) they miss 9.4 of the 45 desired levels, the set printed in the paper (green) 10.2,
        the baseline 17.8. In the paper, (a) shows the printed set.""",
        (9.0, 4.6),
        _figure_5,
    ),
    PaperFigure(
        "8",
        "A camera of constant contrast",
        """For equal contrast everywhere the effective response of a linear camera of 8 bits should
        be a logarithm (dashed), which is steep in the dark. The doubled exposures (orange) have far
        too few levels there. The computed exposures follow the logarithm, (a) with three and (b)
        still closer with five exposures, where those found here (blue) and those printed in the
        paper (green) differ little.""",
        (9.0, 4.4),
        _figure_8,
    ),
)
