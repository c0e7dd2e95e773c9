"""When the exposures of a cycle no longer fit the light, by the pixels of the stream itself.

The light is the histogram of the sum.  Exposures are chosen anew where the highlights left the
range in which they were when the last ones were chosen, and stay away for two looks in a row: a
hand before the lens or a lamp that is switched on for a moment changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.captures.metering import OUTLIER_SHARE, TARGET_SHARE
from camctl.exposure.light import LAMP_SHARE, Light, Metering
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout
from camctl.livestream.tables import SumTable
from camctl.model.response.camera import FloatArray
from camctl.pictures.render import DARK
from camctl.records.capture_plan import MUCH

#: Samples of which the histogram is made, about: 1e-4 of them are 26.
_SAMPLES = 1 << 18
#: Change of the highlights, stops, from which other exposures are worth their exchange: the range
#: of a picture is chosen in whole stops.
_STOPS = 0.5
#: Change of the share of samples that are darker than the range.
_DARK_SHARE = MUCH
#: Factor by which the shortest exposure is shortened where the highlights are not known.
_SHORTENING = 4.0
#: Looks in a row that have to show another light.
_LOOKS = 2


@dataclass(frozen=True, eq=False)
class Look:
    """The light of a window.

    Attributes:
        irradiance: ascending, E = 1 saturates the base exposure
        shares: of the samples that have it
        highlight: E that no more than `OUTLIER_SHARE` of the samples exceed
        clipped: share of the samples that are saturated in every frame
        dark: share of the samples that are darker than the desired range
        unseen: share of the samples in which no light can be told from black
    """

    irradiance: FloatArray
    shares: FloatArray
    highlight: float
    clipped: float
    dark: float
    unseen: float = 0.0

    @property
    def is_cut(self) -> bool:
        """Whether highlights are saturated in every frame."""
        return self.clipped > OUTLIER_SHARE

    @property
    def is_well_placed(self) -> bool:
        """Whether the highlights are just below saturation; lamps may be above it."""
        is_low = self.highlight < TARGET_SHARE / 2**_STOPS
        return not is_low and self.clipped <= 2 * LAMP_SHARE

    @classmethod
    def at(
        cls, total: NDArray[np.unsignedinteger], layout: Layout, tables: Sequence[SumTable]
    ) -> Look:
        """Return the light of the sum of a window."""
        planes = layout.planes(total)
        step = max(1, math.isqrt(total.size // _SAMPLES))
        colours = {Layout.MONO: "G", Layout.RGB: "RGB"}.get(layout, layout.value.upper())
        lights, counts, highlights, clipped, dark, unseen = [], [], [], 0, 0, 0
        for plane, colour in zip(planes, colours, strict=True):
            table = tables["RGB".index(colour) if len(tables) > 1 else 0]
            found = np.bincount(plane[::step, ::step].ravel(), minlength=table.E.size)
            found = found[: table.E.size].astype(np.float64)
            above = np.cumsum(found[::-1])[::-1]
            brightest = int(np.flatnonzero(above > OUTLIER_SHARE * above[0])[-1])
            highlights.append(float(table.E[brightest]))
            clipped += found[-1]
            dark += found[table.below].sum()
            unseen += found[table.mask == DARK].sum()
            kept = found > 0
            lights.append(table.E[kept])
            counts.append(found[kept])
        light, number = np.concatenate(lights), np.concatenate(counts)
        order, samples = np.argsort(light, kind="stable"), number.sum()
        return cls(
            light[order],
            number[order] / samples,
            max(highlights),
            float(clipped / samples),
            float(dark / samples),
            float(unseen / samples),
        )

    def light(self, controls: ExposureControls, settings: Sequence[ExposureSetting]) -> Light:
        """Return the light for a plan, as `camctl.captures.metering.meter_light` does."""
        ordered = sorted(settings, key=controls.exposure)
        shortest, longest = ordered[0], ordered[-1]
        # How bright saturated light is, is not known.
        factor = _SHORTENING if self.is_cut else 1.0
        irradiance = np.where(
            self.irradiance >= self.highlight, factor * self.irradiance, self.irradiance
        )
        whole = self.highlight / TARGET_SHARE * factor
        times = controls.time_s
        limit_s = min(max(shortest.time_s / whole, times.minimum), times.maximum)
        unit = shortest.time_s / limit_s
        span = controls.exposure(longest) / controls.exposure(shortest)
        darkest = float(controls.levels.levels[0]) / span / unit
        return Light(
            Metering(limit_s, shortest, min(self.highlight, 1.0), self.clipped, len(settings)),
            np.maximum(irradiance / unit, darkest / 2),
            self.shares,
            darkest,
            brightest=min(1.0, factor * self.highlight / unit),
            last=longest,
        )


class Following:
    """Says when exposures have to be chosen anew."""

    def __init__(self) -> None:
        self._accepted: Look | None = None
        self._others = 0
        self._is_final = False

    def accept(self, look: Look | None, *, is_final: bool = False) -> None:
        """The exposures were chosen for this light.

        Args:
            look: as the exposures show it; None: the next one that is looked at
            is_final: whether there are none that suit it better
        """
        self._accepted, self._others, self._is_final = look, 0, is_final

    def is_other(self, look: Look) -> bool:
        """Return whether another light was seen often enough."""
        if self._accepted is None:
            self.accept(look)
            return False
        accepted = self._accepted
        change = math.log2(max(look.highlight, 1e-12) / max(accepted.highlight, 1e-12))
        is_other = (
            abs(change) > _STOPS
            or look.is_cut != accepted.is_cut
            or abs(look.dark - accepted.dark) > _DARK_SHARE
            or (not self._is_final and not look.is_well_placed)
        )
        self._others = self._others + 1 if is_other else 0
        return self._others >= _LOOKS
