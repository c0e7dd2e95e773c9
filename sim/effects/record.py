"""The record that describes an effect, and the exposure that it acts on.

A frame is made in the stages of `Stage`.  Nothing outside the table `camctl.sim.effects.EFFECTS`
knows an effect by its name: what `camctl.sim.render` must do for it is a field of its `Effect`, and
what `camctl.sim.effects.bounds` must know of it is a field of its `Change`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.sim.compiled import Kernels
from camctl.sim.frame_cache import FrameCache
from camctl.sim.noise import PATTERN, TILE, Stream, TileNoise, largest_noise
from camctl.sim.photon_counts import READ_NOISE_THAT_HIDES_COUNTS_E
from camctl.sim.scenes.view import Statistics, View
from camctl.sim.sensors.sensor import Sensor

Light: TypeAlias = NDArray[np.float32]

Places: TypeAlias = tuple[NDArray[np.intp], NDArray[np.float64]]

LARGEST_NOISE = largest_noise()


class Stage(IntEnum):
    """Steps in the making of a frame, in the order in which light goes through them.

    `SCENE` sets when the rows are exposed; `LENS` changes the picture in front of the colour
    mosaic and `SAMPLES` behind it, in photons a second; `MEAN` changes the mean charge before
    photon noise, `CHARGE` the charge, `WELL` limits it, and `READING` adds to it, in electrons;
    `ADC` changes brightness above black, in DN.
    """

    SCENE = 0
    LENS = 1
    SAMPLES = 2
    MEAN = 3
    CHARGE = 4
    WELL = 5
    READING = 6
    ADC = 7


class Lacking(StrEnum):
    """Why a frame lacks an effect that nobody has left out, in words for users."""

    MODEL = "this sensor does not model it"
    SCENE = "nothing in the scene causes it"
    KIND = "this kind of sensor has none"


@dataclass(frozen=True)
class Change:
    """What `camctl.sim.effects.bounds` must know of an effect in one exposure.

    The first group limits what leaving the effect out changes in any sample:

    Attributes:
        light: change of the light before anything multiplies it, photons a second
        less, more: the effect multiplies the light by a factor from 1 - less to 1 + more
        within: name of the effect whose factor this one only varies: `less` and `more` count while
            that effect runs
        mean_e: change of the mean charge before photon noise, electrons
        read_e: change of the charge after the well, electrons
        dn: change after the gain, DN
        never: why the effect is never left out; empty if it may be
        only_below_well: no change while no sample reaches the well, else an unlimited one
        is_noise: the effect is the photon noise
        nothing: why leaving the effect out of this frame changes no bit; empty if it may

    The second group is what the effect does to a difference that others make:

    Attributes:
        repeats: share of the mean charge that the effect adds again
        least_e: least charge that it adds to the mean of every sample, electrons; may be negative
        hit_e: largest charge that it adds to a sample after photon noise, electrons
        spreads: share by which a difference grows if samples reach the well
        slope: share by which a difference in DN grows
        resets: share of the mean charge that the effect takes away again after the well
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
    nothing: str = ""
    repeats: float = 0.0
    least_e: float = 0.0
    hit_e: float = 0.0
    spreads: float = 0.0
    slope: float = 0.0
    resets: float = 0.0


@dataclass(frozen=True, eq=False)
class RowTiming:
    """When the rows of a frame are exposed.

    Attributes:
        starts_s: (rows,) float64, when the exposure of each row starts, seconds
        is_motion_blurred: a moving target is averaged over the exposure; otherwise it is drawn
            where it is in the middle of the exposure
    """

    starts_s: NDArray[np.float64]
    is_motion_blurred: bool = False


@dataclass(frozen=True, eq=False)
class Shot:
    """One exposure of one sensor in front of one scene: all that effects depend on.

    Attributes:
        view: the scene as the sensor sees it
        sensor: the sensor
        seed: of all noise
        time_s: exposure time
        gain: linear gain
        number: number of the frame; frames of other numbers have other noise
        start_s: when the exposure of the first row starts; matters for targets and flicker
        previous_s: exposure time of the frame before, for lag; None if it is the same
    """

    view: View
    sensor: Sensor
    seed: int
    time_s: float
    gain: float
    number: int
    start_s: float = 0.0
    previous_s: float | None = None

    @property
    def rows(self) -> int:
        return self.view.light.shape[0] if self.view.light.ndim > 1 else 1

    @property
    def width(self) -> int:
        """Samples in a row of the picture."""
        shape = self.view.light.shape
        return math.prod(shape[1:]) if len(shape) > 1 else shape[0]

    @property
    def channels(self) -> int:
        """Samples of a pixel."""
        return self.view.light.shape[2] if self.view.light.ndim == 3 else 1

    @property
    def counts_photons(self) -> bool:
        """Whether photon noise must be whole electrons: the read noise does not hide them."""
        return self.sensor.read_noise_e < READ_NOISE_THAT_HIDES_COUNTS_E

    @property
    def electrons_per_photon_s(self) -> float:
        """Electrons in this exposure for one photon a second."""
        return self.sensor.quantum_efficiency * self.time_s

    @property
    def lag_ratio(self) -> float:
        """Exposure time of the frame before over the exposure time of this frame."""
        return 1.0 if self.previous_s is None else self.previous_s / self.time_s

    @property
    def row_starts_s(self) -> NDArray[np.float64]:
        """(rows,) when the exposure of each row starts with the sensor's rolling shutter."""
        return np.arange(self.rows, dtype=np.float64) * self.sensor.read_out.row_s + self.start_s

    @property
    def global_timing(self) -> RowTiming:
        """Timing without rolling shutter and motion blur: all rows start with the middle one."""
        starts = self.row_starts_s
        return RowTiming(np.full(starts.shape, starts[starts.size // 2]))

    @property
    def statistics(self) -> Statistics:
        return self.view.statistics


@dataclass(slots=True, eq=False)
class Tile:
    """Consecutive samples of a frame in the making.

    Attributes:
        shot: the exposure
        values: (samples,) float32, electrons up to `Stage.READING` and DN in `Stage.ADC`; effects
            change them in place
        light: (samples,) float32, photons a second on them; not to be written to
        start: number of the first sample in the frame
        index: number of the tile in the frame
        noise: generator and working memory of the thread
        cache: keeps what is the same in every frame
    """

    shot: Shot
    values: Light
    light: Light
    start: int
    index: int
    noise: TileNoise
    cache: FrameCache

    def pattern(self, stream: Stream, sigma: float, mean: float) -> Light:
        """Return the numbers of a fixed pattern, normal around `mean`; do not write.

        `sigma` and `mean` belong to the sensor, so that they are no part of the key.
        """

        def draw() -> tuple[Light]:
            shot = self.shot
            z = self.noise.normal(self.values.size, shot.seed, PATTERN, stream, self.index)
            numbers = z * np.float32(sigma)
            if mean:
                numbers += np.float32(mean)
            return (numbers,)

        return self.cache.get((stream, self.index), draw)[0]

    def some_pixels(self, stream: Stream, share: float) -> Places:
        """Return a fixed random share of the samples, ascending, each with a number from 0 to 1.

        `share` belongs to the sensor, so that it is no part of the key; do not write.
        """

        def draw() -> Places:
            key = (PATTERN, int(stream), self.index)
            seeds = np.random.SeedSequence(self.shot.seed, spawn_key=key)
            random = np.random.Generator(np.random.SFC64(seeds))
            # Always for a whole tile, so that it is the same in a frame that ends within it.
            count = int(TILE * share + random.random())
            places = (random.random(count) * TILE).astype(np.intp)
            numbers = random.random(count)
            places, first = np.unique(places, return_index=True)
            inside = places < self.values.size
            return places[inside], numbers[first][inside]

        return self.cache.get((stream, self.index), draw)


@dataclass(frozen=True, eq=False)
class Lines:
    """A number for each row plus one for each sample of a row, combined with every sample.

    Attributes:
        combine: `numpy.add` or `numpy.multiply`
        rows: (rows,), or None for nothing
        columns: (width,), or None for nothing; at least one of the two is given
    """

    combine: np.ufunc
    rows: Light | None = None
    columns: Light | None = None

    def apply(self, tile: Tile) -> None:
        """Combine the numbers of their row and column with the samples of a tile, in place."""
        values, width = tile.values, tile.shot.width
        row, column = divmod(tile.start, width)
        begun = min(-tile.start % width, values.size)  # samples of a row of the tile before
        if begun:
            self._combine(values[np.newaxis, :begun], row, column)
            row += 1
        whole = begun + (values.size - begun) // width * width
        self._combine(values[begun:whole].reshape(-1, width), row, 0)
        if whole < values.size:
            row += (whole - begun) // width
            self._combine(values[np.newaxis, whole:], row, 0)

    def _combine(self, part: Light, row: int, column: int) -> None:
        """Do so for (rows, columns) samples from a row and a column on."""
        height, width = part.shape
        if self.columns is None:
            assert self.rows is not None
            numbers = self.rows[row : row + height, np.newaxis]
        else:
            numbers = self.columns[column : column + width]
            if self.rows is not None:
                numbers = self.rows[row : row + height, np.newaxis] + numbers
        self.combine(part, numbers, out=part)


@dataclass(frozen=True)
class Effect:
    """One effect.

    `timing`, `picture`, `lines`, `apply` and `flow` are its work; an effect has one of them, or
    none if the renderer does its work for every sensor (such as quantisation).

    Attributes:
        name: as users see it
        stage: when it acts
        model: the model, where it comes from, and its units
        present: returns whether sensor and scene have it at all
        change: returns what leaving it out changes
        lacking: returns why sensor and scene do not have it, where `present` is false
        cost: nanoseconds for each of `samples` in frames after the first, measured on one core
            (bench_sensor_costs.py); see `cost_in`
        varies: what `change` depends on from frame to frame of the same exposure, if on anything
        timing: for `Stage.SCENE`, returns the timing as the effect changes it
        picture: for `Stage.LENS` and `Stage.SAMPLES`, returns the light of the whole picture as the
            effect changes it, (rows, columns[, 3])
        lines: returns numbers for rows and columns, computed once a frame and applied to each tile
        apply: changes a tile in place, from `Stage.MEAN` on
        flow: for `Stage.WELL`, changes the charge of the whole picture in place, (rows, width);
            with compiled functions where they are given
    """

    name: str
    stage: Stage
    model: str
    present: Callable[[Shot], bool]
    change: Callable[[Shot], Change]
    cost: float
    lacking: Callable[[Shot], Lacking] = lambda _: Lacking.MODEL
    varies: Callable[[Shot], Hashable] | None = None
    timing: Callable[[RowTiming, Shot], RowTiming] | None = None
    picture: Callable[[Light, Shot], Light] | None = None
    lines: Callable[[Shot, RowTiming], Lines] | None = None
    apply: Callable[[Tile], None] | None = None
    flow: Callable[[Light, Shot, Kernels | None], None] | None = None

    def cost_in(self, shot: Shot) -> float:
        """Return nanoseconds for each of `samples` in frames after the first.

        The light of a scene at rest is kept between frames, with all effects on it.
        """
        is_kept = self.picture is not None and shot.view.target is None
        return 0.0 if is_kept else self.cost

    def samples(self, shot: Shot) -> int:
        """Return on how many numbers it works: before a colour mosaic three for each pixel."""
        in_colour = shot.view.has_colours_before_mosaic and self.stage is Stage.LENS
        return shot.view.light.size * (3 if in_colour else 1)
