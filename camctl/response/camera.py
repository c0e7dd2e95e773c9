"""Real cameras as their measured irradiance levels."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camctl.errors import DataError, UsageError, unknown_name

FloatArray: TypeAlias = NDArray[np.float64]

MAX_BITS = 16


@dataclass(frozen=True, eq=False)
class CameraResponse:
    """A real camera: brightness is how many of its levels are <= the irradiance.

    Attributes:
        levels: (M,) float64, not decreasing, irradiance E_1..E_M; E = 1 is where level M + 1 lies
        name: what a person calls it
        notes: what had to be repaired in a measured curve, one line each
    """

    levels: FloatArray
    name: str
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        levels = np.array(self.levels, dtype=np.float64)
        if levels.ndim != 1 or levels.size == 0:
            raise DataError(f"{self.name}: a camera needs a list of one or more levels")
        if not np.all(np.isfinite(levels)):
            raise DataError(f"{self.name}: a level is not a finite number")
        if np.any(np.diff(levels) < 0) or levels[0] < 0 or levels[-1] <= 0:
            raise DataError(f"{self.name}: levels must be >= 0 and must not decrease")
        levels.setflags(write=False)
        object.__setattr__(self, "levels", levels)

    @property
    def M(self) -> int:  # noqa: N802 - the field's letter
        """Number of levels: white minus black."""
        return int(self.levels.size)

    @property
    def gaps(self) -> tuple[FloatArray, FloatArray]:
        """(low, high), each (M + 1,): the irradiance that brightness 0..M stands for.

        Brightness M is saturated and has no upper end: it gets E_M for both.
        """
        return (
            np.concatenate(([0.0], self.levels)),
            np.concatenate((self.levels, self.levels[-1:])),
        )

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the sha256 of the levels as little-endian float64."""
        return hashlib.sha256(self.levels.astype("<f8").tobytes()).hexdigest()[:16]

    def slope(self, E: ArrayLike) -> FloatArray:
        """Return the local slope of brightness, levels per unit of irradiance, in E's shape.

        It is one level per gap (m levels where m coincide); below the first level that of the gap
        above it.  Saturation is the caller's to know.
        """
        distinct, counts = np.unique(self.levels, return_counts=True)
        if distinct.size == 1:
            return np.full(np.shape(E), counts[0] / distinct[0])
        steepness = counts[1:] / np.diff(distinct)
        gap = np.searchsorted(distinct, np.asarray(E, dtype=np.float64), side="right") - 1
        return np.asarray(steepness[np.clip(gap, 0, steepness.size - 1)])


def check_quantiser(bits: int, phase: float, levels: int | None) -> int:
    """Return the number of levels M of a quantiser; raise `UsageError` if it cannot be."""
    if not 1 <= bits <= MAX_BITS:
        raise UsageError(f"{bits} bits", hint=f"a camera has 1 to {MAX_BITS}")
    if not (math.isfinite(phase) and 0 <= phase < 1):
        raise UsageError(
            f"quantiser phase {phase}", hint="it lies in [0, 1): 0 is floor, 0.5 is rounding"
        )
    count = 2**bits - 1 if levels is None else levels
    if not 1 <= count <= 2**MAX_BITS - 1:
        raise UsageError(
            f"a camera of {count} levels", hint=f"levels (white - black) lie in 1..{2**16 - 1}"
        )
    return count


def quantiser_name(kind: str, bits: int, phase: float, count: int) -> str:
    """Return how a person calls a response behind a quantiser."""
    size = f"{bits} bit" if count == 2**bits - 1 else f"{bits} bit, {count} levels"
    return f"{kind} {size}" + (f", phase {phase:g}" if phase else "")


def linear_response(
    bits: int = 8, *, phase: float = 0.0, levels: int | None = None
) -> CameraResponse:
    """Return a linear camera: E_k = (k - phase) / (M + 1), k = 1..M.

    `levels` is M = white - black where there is a black level; without it M = 2^bits - 1.

    >>> linear_response(2).levels.tolist()
    [0.25, 0.5, 0.75]
    """
    count = check_quantiser(bits, phase, levels)
    ladder = (np.arange(1, count + 1, dtype=np.float64) - phase) / (count + 1)
    return CameraResponse(ladder, quantiser_name("linear", bits, phase, count))


STANDARDS: tuple[str, ...] = ("linear", "srgb", "rec709", "power")


def srgb_to_linear(B: FloatArray) -> FloatArray:
    """Return irradiance for sRGB brightness, both 0..1 (IEC 61966-2-1)."""
    return np.where(B <= 0.04045, B / 12.92, ((B + 0.055) / 1.055) ** 2.4)


def rec709_to_linear(B: FloatArray) -> FloatArray:
    """Return irradiance for Rec.709 brightness, both 0..1 (ITU-R BT.709, inverse camera curve)."""
    return np.where(B < 0.081, B / 4.5, ((B + 0.099) / 1.099) ** (1 / 0.45))


def standard_response(
    name: str,
    bits: int = 8,
    *,
    phase: float = 0.0,
    levels: int | None = None,
    gamma: float = 2.2,
) -> CameraResponse:
    """Return the camera with a standard's response: E_k = B^-1((k - phase) / (M + 1)).

    `name` is one of `STANDARDS`; "power" is B = E^(1/gamma).  Raises `UsageError`.

    >>> standard_response("power", 2, gamma=2.0).levels.tolist()
    [0.0625, 0.25, 0.5625]
    """
    if name == "linear":
        return linear_response(bits, phase=phase, levels=levels)
    count = check_quantiser(bits, phase, levels)
    B = (np.arange(1, count + 1, dtype=np.float64) - phase) / (count + 1)
    label = name
    if name == "srgb":
        ladder = srgb_to_linear(B)
    elif name == "rec709":
        ladder = rec709_to_linear(B)
    elif name == "power":
        if not (math.isfinite(gamma) and 0.05 <= gamma <= 20):
            raise UsageError(f"power 1/{gamma:g}", hint="gamma lies between 0.05 and 20")
        ladder = B**gamma
        label = f"power 1/{gamma:g}"
    else:
        raise unknown_name("camera response", name, STANDARDS)
    return CameraResponse(ladder, quantiser_name(label, bits, phase, count))


#: What stands after -O response=.
RESPONSES = (*STANDARDS[:-1], "power:GAMMA")


def named_response(word: str, bits: int, levels: int) -> CameraResponse | None:
    """Return the response that a word names; None: linear.

    Args:
        word: a name in `STANDARDS`, or power:GAMMA; power alone is power:2.2
        bits: a sample
        levels: white minus black

    Raises:
        UsageError: it is none of these, or an impossible gamma
    """
    name, _, gamma = word.partition(":")
    if name not in STANDARDS or (gamma and name != "power"):
        raise unknown_name("camera response", word, RESPONSES)
    if name == "linear":
        return None
    try:
        exponent = float(gamma) if gamma else 2.2
    except ValueError:
        raise UsageError(f"a response of '{word}'", hint="write it like power:2.2") from None
    return standard_response(name, bits, levels=levels, gamma=exponent)
