"""Results as pictures for people: 8 bits, as wanted or tone-mapped, without flicker.

The desired response is the picture of the effective camera.  With `look` its light is mapped by the
operator of `camctl.pictures.preview` without surrounds: one curve for the whole picture, whose
parameters follow the scene slowly, so that a thing that passes does not make the rest flicker.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from camctl.interface.controls import Layout
from camctl.livestream.planning import Look
from camctl.livestream.result import LiveResult
from camctl.livestream.tables import SumTable
from camctl.pictures.preview import LIFTED, exposure_of, srgb_codes
from camctl.system.picture_operations import reduced_by_area

CodeT = TypeVar("CodeT", np.uint8, np.uint16)

#: Time constant of the mapping, s: auto exposure of video cameras takes about as long.
_TIME_CONSTANT_S = 0.7
#: Quantiles of the light of which the mapping is made.
_QUANTILES = (np.arange(512) + 0.5) / 512
_LEAST_LIGHT = 1e-9


class Display:
    """Makes pictures of one result after the other.

    Args:
        look: map the light for looking, instead of showing the desired response
        most: longest side, pixels; None: as the results
    """

    def __init__(self, *, look: bool = False, most: int | None = None) -> None:
        self._look, self._most = look, most
        self._mapping: NDArray[np.float64] | None = None
        self._time_s = 0.0

    def picture(self, result: LiveResult) -> NDArray[np.uint8]:
        """Return (rows, columns) or (rows, columns, 3), sRGB; a mosaic has half the size."""
        if self._look:
            factor, white, power = self._parameters(result)
            codes = result.through(
                lambda table: _mapped(table, result, factor, white, power), "display"
            )
        else:
            codes = result.through(lambda table: (table.code >> 8).astype(np.uint8), "display")
        if result.layout.is_mosaic:
            codes = rgb_of_cells(codes, result.layout)
        rows, columns = codes.shape[:2]
        step = 1 if self._most is None else -(-max(rows, columns) // self._most)
        if step > 1:
            size = max(1, columns // step), max(1, rows // step)
            codes = reduced_by_area(codes[: size[1] * step, : size[0] * step], size)
        return codes

    def _parameters(self, result: LiveResult) -> tuple[float, float, float]:
        """Return the parameters of the mapping, filtered in time."""
        seen = Look.at(result.sum, result.layout, result.tables)
        places = np.searchsorted(np.cumsum(seen.shares), _QUANTILES)
        light = seen.irradiance[np.minimum(places, seen.shares.size - 1)] * _scale(result)
        logs = np.log2(np.maximum(light, _LEAST_LIGHT)).astype(np.float32)
        exposure, white, power = exposure_of(logs, logs)
        wanted = np.array([exposure, np.log2(white), power], np.float64)
        if self._mapping is None:
            self._mapping = wanted
        else:
            passed_s = max(0.0, result.time_s - self._time_s)
            self._mapping += (wanted - self._mapping) * (1 - np.exp(-passed_s / _TIME_CONSTANT_S))
        self._time_s = result.time_s
        first, second, third = self._mapping.tolist()
        return 2.0**first, 2.0**second, third


def _scale(result: LiveResult) -> float:
    """Return irradiance of the results over light E, which changes with the exposures."""
    table = result.tables[0]
    return float(table.irradiance[-1] / table.E[-1])


def _mapped(
    table: SumTable, result: LiveResult, factor: float, white: float, power: float
) -> NDArray[np.uint8]:
    """Return the sRGB code of each value of the sum."""
    shown = table.E * (_scale(result) * factor)
    shown = np.minimum(shown * (1 + shown / white**2) / (1 + shown), 1.0)
    if power < 1:
        shown = np.where(shown < LIFTED, LIFTED * (shown / LIFTED) ** power, shown)
    shown[-1] = 1.0
    return srgb_codes(shown)


def rgb_of_cells(codes: NDArray[CodeT], layout: Layout) -> NDArray[CodeT]:
    """Return (rows / 2, columns / 2, 3): one pixel of each 2 x 2 cell of a mosaic."""
    rows, columns = (length & ~1 for length in codes.shape)
    planes: dict[str, list[NDArray[CodeT]]] = {"r": [], "g": [], "b": []}
    for letter, plane in zip(layout.value, layout.planes(codes[:rows, :columns]), strict=True):
        planes[letter].append(plane)
    green = (planes["g"][0] >> 1) + (planes["g"][1] >> 1)
    return np.stack([planes["r"][0], green, planes["b"][0]], axis=-1)
