"""One result of the live effective camera; its arrays are computed when they are asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from camctl.findings import Finding
from camctl.interface.camera import Frame
from camctl.interface.controls import Layout
from camctl.livestream.disagreement import Disagreement
from camctl.livestream.tables import SumTable
from camctl.livestream.window import SlotState
from camctl.pictures.render import CONTRADICTING
from camctl.records.capture_plan import CapturePlan
from camctl.system.threads import in_threads

ScalarT = TypeVar("ScalarT", bound=np.generic)

#: Samples whose places in a table are computed at a time: they stay in the cache.
_TILE = 1 << 16
#: Samples from which two threads share the work: one is faster below.
_SHARED = 1 << 19


class Arrays:
    """The memory of results: new for each, or the same again.

    Args:
        are_reused: the same for all results
    """

    def __init__(self, *, are_reused: bool) -> None:
        self._are_reused = are_reused
        self._kept: dict[str, NDArray[Any]] = {}

    def get(self, name: str, shape: tuple[int, ...], dtype: type[ScalarT]) -> NDArray[ScalarT]:
        """Return an array whose content does not count."""
        kept = self._kept.get(name)
        if kept is None or (kept.shape, kept.dtype) != (shape, np.dtype(dtype)):
            kept = np.empty(shape, dtype)
            if self._are_reused:
                self._kept[name] = kept
        return kept


@dataclass(eq=False)
class LiveResult:
    """What the last frame of each exposure of a cycle shows together.

    The arrays are in the shape of a frame: (rows, columns), also of a Bayer mosaic, or (rows,
    columns, 3).  With `reuse` of `camctl.live` they are overwritten by the next result.

    Attributes:
        number: of the result, from 0; results that a slow consumer skipped are counted
        time_s: when the newest exposure ended, on the camera's clock, s
        age_s: how much earlier the oldest one ended, s: a moving thing lags by up to this
        latency_s: from the end of the newest exposure until its result was there, s
        exposures: of the frames, see `SlotState`
        sum: uint16 or uint32, the sum of min(frame, white), black included
        plan: by which the exposures were chosen; while it is exchanged, the new one
        findings: what there is to know of plan, light and exposures
    """

    number: int
    time_s: float
    age_s: float
    latency_s: float
    exposures: tuple[SlotState, ...]
    sum: NDArray[np.unsignedinteger]
    plan: CapturePlan
    findings: tuple[Finding, ...]
    layout: Layout
    black: int
    white: int
    _tables: tuple[SumTable, ...]
    _frames: tuple[Frame, ...]
    _disagreement: Disagreement
    _arrays: Arrays
    _done: dict[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def is_exact(self) -> bool:
        """False for some results after a change of the exposures: their light has no prior."""
        return all(table.is_exact for table in self._tables)

    @cached_property
    def irradiance(self) -> NDArray[np.float32]:
        """The light, in the scene's unit where the camera's sensitivity is known.

        Else a light of 1 saturates an exposure of 1 s at gain 1.
        """
        return self._looked_up("irradiance", np.float32)

    @cached_property
    def sd(self) -> NDArray[np.float32]:
        """Its standard deviation: infinite where saturated, NaN where noise is not known."""
        return self._looked_up("sd", np.float32)

    @cached_property
    def image(self) -> NDArray[np.uint16]:
        """The desired response, 0 to 65,535."""
        return self._looked_up("code", np.uint16)

    @cached_property
    def mask(self) -> NDArray[np.uint8]:
        """1 no light, 2 saturated in every frame, 4 two frames contradict: something moved."""
        mask = self._looked_up("mask", np.uint8)
        moved = self._disagreement.mask(self._frames)
        if moved is not None:
            mask |= moved.view(np.uint8) * np.uint8(CONTRADICTING)
        return mask

    @property
    def tables(self) -> tuple[SumTable, ...]:
        """What each value of the sum says; one, or those of R, G and B."""
        return self._tables

    def through(self, table: Callable[[SumTable], NDArray[ScalarT]], name: str) -> NDArray[ScalarT]:
        """Return what a table says of each sample; `name` is that of the array.

        Args:
            table: of a `SumTable`, (top + 1,)
            name: of the memory that is used
        """
        columns = [table(each) for each in self._tables]
        found = self._arrays.get(name, self.sum.shape, columns[0].dtype.type)
        if len(columns) == 1:
            _take(columns[0], self.sum, found)
            return found
        letters = "RGB" if self.layout is Layout.RGB else self.layout.value.upper()
        order = ["RGB".index(letter) for letter in letters]
        views = zip(order, self.layout.planes(self.sum), self.layout.planes(found), strict=True)
        for colour, total, out in views:
            out[...] = columns[colour].take(total)
        return found

    def _looked_up(self, name: str, dtype: type[ScalarT]) -> NDArray[ScalarT]:
        found: NDArray[ScalarT] = self.through(lambda table: getattr(table, name), name)
        return found


def _take(table: NDArray[Any], total: NDArray[np.unsignedinteger], out: NDArray[Any]) -> None:
    """Look the values of a contiguous array up."""
    places, found = total.reshape(-1), out.reshape(-1)

    def fill(part: slice) -> None:
        index = np.empty(min(_TILE, part.stop - part.start), np.intp)
        for start in range(part.start, part.stop, _TILE):
            stop = min(start + _TILE, part.stop)
            here = index[: stop - start]
            np.copyto(here, places[start:stop])
            np.take(table, here, out=found[start:stop], mode="clip")

    size = places.size
    if size < _SHARED:
        fill(slice(0, size))
        return
    half = size // 2
    for _ in in_threads(fill, (slice(0, half), slice(half, size))):
        pass
