"""Plots of what was measured of a camera: responses, photon transfer curves, true exposures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from camctl.errors import DataError
from camctl.profiles.profile import Profile
from camctl.system.plots import COLOURS, plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from camctl.profiles.exposures import ExposureRecord
    from camctl.profiles.noise import NoiseRecord
    from camctl.profiles.response import ResponseRecord

_CHANNELS = {"R": ("#b3242b", "-"), "G": ("#3c7d2f", "--"), "B": ("#0b4aa2", ":")}
#: Inches of a plot for each mode; the narrowest one still has room for its caption.
_PANEL, _NARROWEST, _HEIGHT = 4.4, 8.6, 4.4


def draw_profile(profile: Profile, path: Path) -> None:
    """Draw responses and photon transfer curves of a camera, by mode, to a PNG or SVG file.

    Raises:
        DataError: neither was measured
        StorageError: the file cannot be written
        MissingPlotLibraryError: matplotlib is not installed
    """
    modes = sorted({*profile.responses, *profile.noises})
    if not modes:
        raise DataError(
            f"the profile {profile.name} has no response or noise to draw",
            hint="measure them",
            remedies={"calibrate_all": None},
        )
    caption = (
        f"{profile.make} {profile.model}. Response: brightness of irradiance, both from black to "
        "saturation; thick where the frames determine it, grey: linear, and the sRGB curve. Photon "
        "transfer: variance of the noise of a sample, with its quantisation, at its brightness; "
        "line: the fit."
    )
    size = (max(_NARROWEST, _PANEL * len(modes)), _HEIGHT * 2 if len(modes) > 1 else _HEIGHT)
    with plot((path,), size, caption) as figure:
        shape = (2, len(modes)) if len(modes) > 1 else (1, 2)
        panels = figure.subplots(*shape, squeeze=False).reshape(2, len(modes))
        for column, mode in enumerate(modes):
            upper, lower = panels[:, column]
            if mode in profile.responses:
                draw_response(upper, mode, profile.responses[mode])
            else:
                _leave_out(upper, f"response in {mode}: not measured")
            if mode in profile.noises:
                draw_transfer(lower, mode, profile.noises[mode])
            else:
                _leave_out(lower, f"noise in {mode}: not measured")


@contextmanager
def panel(path: Path, caption: str) -> Iterator[Axes]:
    """Yield axes; then write them to a file; raises as `plot` does."""
    with plot((path,), (_NARROWEST, _HEIGHT), caption) as figure:
        yield figure.subplots()


def _leave_out(axes: Axes, title: str) -> None:
    axes.set_title(title)
    axes.set_axis_off()


def draw_response(axes: Axes, mode: str, record: ResponseRecord) -> None:
    """Draw the curves of all channels."""
    import numpy as np

    from camctl.model.response.camera import srgb_to_linear

    axes.set_title(f"response in {mode}, {record.measured_at[:10]}")
    brightness = np.linspace(0, 1, 256)
    for irradiance, name in ((brightness, "linear"), (srgb_to_linear(brightness), "sRGB")):
        axes.plot(irradiance, brightness, color="#bbbbbb", linewidth=1)
        axes.annotate(
            name,
            (irradiance[120], brightness[120]),
            (4, -10),
            textcoords="offset points",
            color="#777777",
            fontsize=8,
        )
    for channel in record.channels:
        E, B = np.array(channel.irradiance), np.array(channel.brightness)
        colour, style = _CHANNELS.get(channel.name, ("#222222", "-"))
        axes.plot(E, B, color=colour, linewidth=0.7)
        inside = (channel.measured[0] <= B) & (channel.measured[1] >= B)
        axes.plot(E[inside], B[inside], style, color=colour, linewidth=2, label=channel.name)
    axes.set(xlabel="irradiance", ylabel="brightness", xlim=(0, 1), ylim=(0, 1))
    axes.legend(loc="lower right", frameon=False)


def draw_transfer(axes: Axes, mode: str, record: NoiseRecord) -> None:
    """Draw the photon transfer curves of all gains."""
    axes.set_title(f"photon transfer in {mode}, {record.measured_at[:10]}")
    for noise, colour in zip(record.gains, COLOURS * len(record.gains), strict=False):
        points = sorted(noise.curve, key=lambda point: point.mean)
        means = [point.mean for point in points]
        axes.plot(means, [point.variance for point in points], ".", color=colour)
        axes.plot(
            means,
            [point.fitted for point in points],
            color=colour,
            linewidth=1,
            label=f"gain {noise.gain:g}: {noise.conversion_e_per_dn.value:.3g} electrons a level",
        )
    axes.set(xlabel="brightness above black, DN", ylabel="variance, DN squared")
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.legend(loc="best", frameon=False, fontsize=8)


def draw_exposures(axes: Axes, mode: str, record: ExposureRecord) -> None:
    """Draw true over stated exposure of each shutter time."""
    axes.set_title(f"exposures in {mode}, {record.measured_at[:10]}")
    times, factors = zip(*((each.value, each.factor) for each in record.times), strict=True)
    below = [each.factor - each.low for each in record.times]
    above = [each.high - each.factor for each in record.times]
    axes.axhline(1.0, color="#bbbbbb", linewidth=1)
    axes.errorbar(times, factors, (below, above), fmt="o", color=COLOURS[0], linewidth=1)
    axes.set(xscale="log", xlabel="stated shutter time, s", ylabel="true over stated exposure")
