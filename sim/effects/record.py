"""What an effect is: one record with a name, a bound, the work itself, and its cost.

A frame is made in stages.  An effect of the stages `SCENE`, `LENS` and `SAMPLES` changes the whole
picture of light; one of `MEAN`, `CHARGE` and `READING` changes tiles of electrons in place.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from sim.noise import TileNoise, largest_noise
from sim.scenes.view import Statistics, View
from sim.sensors.sensor import Sensor

Light: TypeAlias = NDArray[np.float32]
Lines: TypeAlias = tuple[Light | None, Light | None]
"""What an effect is to each row of a picture and to each sample of a row; None: nothing."""


class Stage(IntEnum):
    """When in the making of a frame an effect is at work, in the order of the light's way."""

    SCENE = 0
    LENS = 1
    SAMPLES = 2
    MEAN = 3
    CHARGE = 4
    WELL = 5
    READING = 6
    ADC = 7


@dataclass(frozen=True)
class Change:
    """Most that leaving an effect out changes in any sample.

    Attributes:
        light: of the light before anything multiplies it, photons a second
        less, more: the effect multiplies the light by 1 - less to 1 + more
        within: the effect whose factor that one only varies: it counts while the other stays
        mean_e: of the mean before photon noise, electrons
        read_e: of the charge after the well, electrons
        dn: after the gain, DN
        never: why the effect is never left out, whatever the scene
        only_below_well: nothing at all while no sample reaches the well, else without bound
        is_noise: it is the photon noise itself
        is_nothing: in this frame it changes no bit
    """

    light: float = 0.0
    less: float = 0.0
    more: float = 0.0
    within: str = ""
    mean_e: float = 0.0
    read_e: float = 0.0
    dn: float = 0.0
    never: str = ""
    only_below_well: bool = False
    is_noise: bool = False
    is_nothing: bool = False


@dataclass(frozen=True, eq=False)
class Shot:
    """One exposure of one sensor before one scene: all that effects may depend on.

    Attributes:
        view: the scene as the sensor sees it
        sensor, seed: the sensor, and the noise
        time_s, gain, number: exposure time, linear gain and number of the frame
        start_s: when its exposure begins; matters for what moves or flickers
        previous_s: exposure time of the frame before, for lag; None: the same
    """

    view: View
    sensor: Sensor
    seed: int
    time_s: float
    gain: float
    number: int
    start_s: float = 0.0
    previous_s: float | None = None
    lines: dict[str, Lines] = field(default_factory=dict)

    @property
    def width(self) -> int:
        """Samples in a row of the picture."""
        shape = self.view.light.shape
        return math.prod(shape[1:]) if len(shape) > 1 else shape[0]

    @property
    def rows(self) -> int:
        """Rows of the picture."""
        return self.view.light.shape[0] if self.view.light.ndim > 1 else 1

    @property
    def channels(self) -> int:
        """Samples of a pixel."""
        return self.view.light.shape[2] if self.view.light.ndim == 3 else 1

    @property
    def electrons_per_photon_s(self) -> float:
        """Electrons for one photon a second."""
        return self.sensor.quantum_efficiency * self.time_s

    @property
    def lag_ratio(self) -> float:
        """The last frame's exposure time over this one's."""
        return 1.0 if self.previous_s is None else self.previous_s / self.time_s

    @property
    def row_starts_s(self) -> NDArray[np.float64]:
        """When the exposure of each row begins, with its rolling shutter."""
        return np.arange(self.rows, dtype=np.float64) * self.sensor.read_out.row_s + self.start_s

    @property
    def statistics(self) -> Statistics:
        """Of the view's light."""
        return self.view.statistics

    @cached_property
    def cosmic(self) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Samples that cosmic rays hit in this frame, ascending, and their charge."""
        from sim.effects.charge import draw_hits

        return draw_hits(self)


@dataclass(slots=True, eq=False)
class Tile:
    """A tile of a frame in the making; `electrons` is changed in place.

    `start` is its first sample in the frame, `index` its number from 0, `noise` the
    memory of the thread.
    """

    shot: Shot
    electrons: Light
    start: int
    index: int
    noise: TileNoise

    def spread(self, lines: Lines) -> Light:
        """Return, for each sample of the tile, its row's value plus its column's."""
        rows, columns = lines
        width = self.shot.width
        stop = self.start + self.electrons.size
        first, last = self.start // width, -(-stop // width)
        if columns is None:
            assert rows is not None
            values = np.repeat(rows[first:last], width)
        elif rows is None:
            values = np.broadcast_to(columns, (last - first, width)).reshape(-1)
        else:
            values = np.add(rows[first:last, np.newaxis], columns).reshape(-1)
        return values[self.start - first * width : stop - first * width]


def nothing(_: Tile) -> None:
    """Change nothing: the work of an effect that another part of the renderer does."""


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes:
        name: what a person calls it
        stage: when it is at work
        source: where the model comes from, with its units
        present: whether sensor and scene have it at all
        change: the bound: most that leaving it out changes
        cost: nanoseconds a sample, measured on one core; what is dear is left out first
        apply: the work on a tile, for the stages `MEAN`, `CHARGE` and `READING`
        lines: what `apply` needs for each row and column, made once a frame
        picture: the work on the whole picture, for `LENS` and `SAMPLES`
    """

    name: str
    stage: Stage
    source: str
    present: Callable[[Shot], bool]
    change: Callable[[Shot], Change]
    cost: float
    apply: Callable[[Tile], None] = nothing
    lines: Callable[[Shot], Lines] | None = None
    picture: Callable[[Light, Shot], Light] | None = None


LARGEST = largest_noise()
