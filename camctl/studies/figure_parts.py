"""What the paper's figures share: computed sets, summed pictures, and how they are drawn."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from camctl.captures.sequencer import capture
from camctl.exposure.goal import CaptureRequest
from camctl.exposure.solver import Solution, solve
from camctl.model.effective import EffectiveCamera
from camctl.model.response.camera import CameraResponse, linear_response, standard_response
from camctl.model.response.desired import DesiredResponse, desired_response
from camctl.profiles.calibrated import RESPONSE, CalibratedCamera, open_camera
from camctl.profiles.exposures import exposure_mode
from camctl.profiles.profile import Profile
from camctl.profiles.response import ResponseRecord

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from camctl.records.report import CaptureReport

BASELINE = (1.0, 2.0, 4.0)
"""The exposures that the paper compares with."""

DESIRED, COMPUTED, DOUBLING, PRINTED = "#222222", "#0b6aa2", "#c8501e", "#3c7d2f"
"""Colours of the desired response, the computed, the baseline and the printed exposures."""


@dataclass(frozen=True)
class PaperFigure:
    """One figure of the paper, recomputed.

    Attributes:
        number: in the paper, such as 5 or 4a
        title: what it shows
        caption: what to see in it, and what differs from the paper's
        size: width and height in inches
        draw: draws it into an empty figure
    """

    number: str
    title: str
    caption: str
    size: tuple[float, float]
    draw: Callable[[Figure], None]


@lru_cache(maxsize=64)
def computed(bits: int | str, response: str, dynamic_range: float, n: int) -> Solution:
    """Return the exposures that the solver finds; the search is made once in a process.

    Args:
        bits: of a linear camera, or the name of the curve of an 8-bit camera, such as srgb
        response: desired response
        dynamic_range: of the desired response
        n: number of exposures
    """
    return solve(camera_of(bits), desired_response(response, dynamic_range), n)


def camera_of(bits: int | str) -> CameraResponse:
    """Return a linear camera of so many bits, or an 8-bit camera with a standard curve."""
    return linear_response(bits) if isinstance(bits, int) else standard_response(bits)


def ratios_text(exposures: Sequence[float]) -> str:
    """Return exposures such as 1, 1.0028, 2.985."""
    return ", ".join(f"{e:.4f}".rstrip("0").rstrip(".") if e < 2 else f"{e:.4g}" for e in exposures)


def draw_staircase(
    axes: Axes, camera: CameraResponse, exposures: Sequence[float], **style: Any
) -> None:
    """Draw the effective response h over E, both from 0 to 1."""
    levels = EffectiveCamera.of(camera, exposures).levels
    inside = levels[levels <= 1]
    heights = np.arange(inside.size + 1) / levels.size
    edges = np.concatenate([[0.0], inside, [1.0]])
    axes.stairs(heights, edges, baseline=None, **style)


def draw_desired(axes: Axes, desired: DesiredResponse) -> None:
    """Draw a desired response u over E."""
    E = np.concatenate([np.geomspace(max(desired.e_min, 1e-5), 0.1, 400), np.linspace(0.1, 1, 200)])
    axes.plot(E, desired.u(E), color=DESIRED, linewidth=1.2, linestyle="--", label="desired")


def shoot(
    scene: str,
    sensor: str,
    ratios: Sequence[float],
    request: CaptureRequest,
    size: str,
    measured: ResponseRecord | None = None,
) -> CaptureReport:
    """Take a picture with the simulated camera, in memory; with `measured` as its response."""
    options = {"scene": scene, "sensor": sensor, "size": size, "profile": "none"}
    with open_camera("sim", options) as camera:
        if measured is not None:
            mode = exposure_mode(camera.controls)
            profile = Profile.of(camera.info).model_copy(update={"responses": {mode: measured}})
            camera = CalibratedCamera(camera, profile, (RESPONSE,))
        return capture(camera, replace(request, ratios=tuple(ratios)))


def brightness(report: CaptureReport) -> NDArray[np.float64]:
    """Return the picture in the desired response, 0 to 1, (rows, columns[, 3])."""
    return report.image() / 65535.0


def show(axes: Axes, picture: NDArray[Any], title: str, **options: Any) -> None:
    """Draw a picture without scales, grey from 0 to 1 or in colours."""
    axes.imshow(np.clip(picture, 0, 1), cmap="gray", vmin=0, vmax=1, **options)
    axes.set_title(title)
    axes.set_axis_off()
