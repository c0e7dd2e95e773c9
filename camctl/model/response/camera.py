"""The response of a real camera as a list of irradiance levels, and standard responses.

A camera's brightness (a digital number with black subtracted) is a monotone staircase of the
irradiance E.  The staircase is stored as the irradiances of its M steps, E_1 <= ... <= E_M.
"""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camctl.errors import DataError, UsageError, unknown_name

FloatArray: TypeAlias = NDArray[np.float64]

MAX_BITS = 16


@dataclass(frozen=True, eq=False)
class CameraResponse:
    """The response of a real camera: brightness is the number of levels <= the irradiance.

    Attributes:
        levels: (M,) float64, not decreasing, irradiance E_1..E_M; E = 1 is where level M + 1 would
            lie
        name: name shown to people
        notes: repairs made to a measured curve, one line each
        exponent_error: standard deviation of the exponent of a measured curve: where it is e, all
            ratios r of irradiances may be wrong by the same power, r^(1 + e)
        deviation: (M,) standard deviation of ln(E_k) of a measured curve, relative to ln(E) at half
            the brightness; infinite where the curve only continues what was measured; None: exact
        scale_error: standard deviation of ln(E) at E = 1, likewise

    Raises:
        DataError: the levels are not a non-empty, finite, ascending list of numbers >= 0
    """

    levels: FloatArray
    name: str
    notes: tuple[str, ...] = ()
    exponent_error: float = 0.0
    deviation: FloatArray | None = None
    scale_error: float = 0.0

    def __post_init__(self) -> None:
        levels = np.array(self.levels, dtype=np.float64)
        if levels.ndim != 1 or levels.size == 0:
            raise DataError(
                f"invalid response '{self.name}': expected a list of one or more levels"
            )
        if not np.all(np.isfinite(levels)):
            raise DataError(f"invalid response '{self.name}': a level is not a finite number")
        if np.any(np.diff(levels) < 0) or levels[0] < 0 or levels[-1] <= 0:
            raise DataError(
                f"invalid response '{self.name}': levels must be >= 0 and must not decrease"
            )
        levels.setflags(write=False)
        object.__setattr__(self, "levels", levels)

    @property
    def M(self) -> int:  # noqa: N802 - the letter used in the literature
        """Number of levels, which is white level minus black level."""
        return int(self.levels.size)

    def up_to(self, levels: int) -> CameraResponse:
        """Return the response of the camera where it saturates earlier; light keeps its unit."""
        kept = None if self.deviation is None else self.deviation[:levels]
        return replace(self, levels=self.levels[:levels], deviation=kept)

    @property
    def gaps(self) -> tuple[FloatArray, FloatArray]:
        """Both ends (low, high) of the irradiance of brightness 0..M, each (M + 1,) float64.

        Brightness M is saturated and has no upper end: both are E_M.
        """
        return (
            np.concatenate(([0.0], self.levels)),
            np.concatenate((self.levels, self.levels[-1:])),
        )

    @cached_property
    def fingerprint(self) -> str:
        """First 16 hex digits of the SHA-256 of the levels, in 9 significant digits each.

        Processors differ in the last bit of a power, which would give one camera two fingerprints.
        """
        text = " ".join(["%.9g"] * self.M) % tuple(self.levels.tolist())
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @cached_property
    def steps(self) -> tuple[FloatArray, NDArray[np.intp]]:
        """The irradiances at which brightness changes, (K,) ascending, and by how many levels."""
        return np.unique(self.levels, return_counts=True)

    def slope(self, E: ArrayLike) -> FloatArray:
        """Return the slope of brightness in levels per unit of irradiance, in the shape of E.

        The slope is one level per gap (m levels where m coincide).  Below the first level it is the
        slope of the first gap, above the last level of the last gap: the caller must handle
        saturation.
        """
        distinct, counts = self.steps
        if distinct.size == 1:
            return np.full(np.shape(E), counts[0] / distinct[0])
        steepness = counts[1:] / np.diff(distinct)
        gap = np.searchsorted(distinct, np.asarray(E, dtype=np.float64), side="right") - 1
        return np.asarray(steepness[np.clip(gap, 0, steepness.size - 1)])


def check_quantiser(bits: int, phase: float, levels: int | None) -> int:
    """Return the number of levels M of a quantiser.

    Raises:
        UsageError: the bit depth, phase or number of levels is out of range
    """
    if not 1 <= bits <= MAX_BITS:
        raise UsageError(f"invalid bit depth {bits}: expected 1 to {MAX_BITS}")
    if not (math.isfinite(phase) and 0 <= phase < 1):
        raise UsageError(
            f"invalid quantiser phase {phase}: expected at least 0 and less than 1",
            hint="0 truncates, 0.5 rounds",
        )
    count = 2**bits - 1 if levels is None else levels
    if not 1 <= count <= 2**MAX_BITS - 1:
        raise UsageError(
            f"invalid number of levels {count}: expected 1 to {2**MAX_BITS - 1}",
            hint="it is the white level minus the black level",
        )
    return count


def phase_of_black(black: int) -> float:
    """Return the phase of a quantiser of which the black level alone is known.

    A black level above 0 is the mean of dark frames: a sample less black is then right in the mean,
    as if the quantiser rounded.  One without is taken to truncate.
    """
    return 0.5 if black else 0.0


def quantiser_name(kind: str, bits: int, phase: float, count: int) -> str:
    """Return the name of a quantised response, such as "linear 8 bit, 239 levels, phase 0.5"."""
    size = f"{bits} bit" if count == 2**bits - 1 else f"{bits} bit, {count} levels"
    return f"{kind} {size}" + (f", phase {phase:g}" if phase else "")


def linear_response(
    bits: int = 8, *, phase: float = 0.0, levels: int | None = None
) -> CameraResponse:
    """Return the response of a linear camera: E_k = (k - phase) / (M + 1), k = 1..M.

    Args:
        bits: bit depth, 1 to 16
        phase: phase of the quantiser, in [0, 1): 0 truncates, 0.5 rounds
        levels: M, the white level minus the black level; None: 2^bits - 1

    Raises:
        UsageError: a value is out of range

    >>> linear_response(2).levels.tolist()
    [0.25, 0.5, 0.75]
    """
    count = check_quantiser(bits, phase, levels)
    irradiance = (np.arange(1, count + 1, dtype=np.float64) - phase) / (count + 1)
    return CameraResponse(irradiance, quantiser_name("linear", bits, phase, count))


def every_nth_level(response: CameraResponse, step: int) -> CameraResponse:
    """Return a camera with each `step`-th level of a finer one."""
    if step == 1:
        return response
    return CameraResponse(response.levels[step - 1 :: step], f"{response.name}, 1/{step}")


STANDARDS: tuple[str, ...] = ("linear", "srgb", "rec709", "power")


def srgb_to_linear(B: FloatArray) -> FloatArray:
    """Return the irradiance for sRGB brightness, both 0..1 (IEC 61966-2-1)."""
    return np.where(B <= 0.04045, B / 12.92, ((B + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(E: NDArray[Any]) -> NDArray[Any]:
    """Return the sRGB brightness for an irradiance, both 0..1 (IEC 61966-2-1)."""
    return np.where(E <= 0.0031308, 12.92 * E, 1.055 * E ** (1 / 2.4) - 0.055)


def rec709_to_linear(B: FloatArray) -> FloatArray:
    """Return the smallest irradiance that reaches a Rec.709 brightness, both 0..1.

    ITU-R BT.709 defines brightness 4.5 E below E = 0.018 and 1.099 E^0.45 - 0.099 from there.  Its
    rounded constants make brightness jump from 0.0810 to 0.0812 at 0.018: all brightness between
    is reached there, which is 16 levels of a 16-bit camera.
    """
    curved = ((B + 0.099) / 1.099) ** (1 / 0.45)
    return np.where(B <= 0.081, np.minimum(B / 4.5, 0.018), np.maximum(curved, 0.018))


def standard_response(
    name: str,
    bits: int = 8,
    *,
    phase: float = 0.0,
    levels: int | None = None,
    gamma: float = 2.2,
) -> CameraResponse:
    """Return the response of a camera that follows a standard: E_k = B^-1((k - phase) / (M + 1)).

    Args:
        name: one of `STANDARDS`; "power" is B = E^(1/gamma)
        bits: bit depth, 1 to 16
        phase: phase of the quantiser, in [0, 1): 0 truncates, 0.5 rounds
        levels: M, the white level minus the black level; None: 2^bits - 1
        gamma: exponent of "power", 0.05 to 20; the other responses ignore it

    Raises:
        UsageError: an unknown name, or a value out of range

    >>> standard_response("power", 2, gamma=2.0).levels.tolist()
    [0.0625, 0.25, 0.5625]
    """
    if name == "linear":
        return linear_response(bits, phase=phase, levels=levels)
    count = check_quantiser(bits, phase, levels)
    B = (np.arange(1, count + 1, dtype=np.float64) - phase) / (count + 1)
    label = name
    if name == "srgb":
        irradiance = srgb_to_linear(B)
    elif name == "rec709":
        irradiance = rec709_to_linear(B)
    elif name == "power":
        if not (math.isfinite(gamma) and 0.05 <= gamma <= 20):
            raise UsageError(f"invalid gamma {gamma:g} of a power response: expected 0.05 to 20")
        irradiance = B**gamma
        label = f"power 1/{gamma:g}"
    else:
        raise unknown_name("camera response", name, STANDARDS)
    return CameraResponse(irradiance, quantiser_name(label, bits, phase, count))


#: Values of the driver option "response".
RESPONSES = (*STANDARDS[:-1], "power:GAMMA")


def named_response(text: str, bits: int, levels: int) -> CameraResponse | None:
    """Return the response that the value of a driver option names, None for linear.

    Args:
        text: a name in `STANDARDS`, in capitals or not, or power:GAMMA; power alone is power:2.2
        bits: bit depth
        levels: white level minus black level

    Raises:
        UsageError: an unknown name, or a gamma that is not a number or is out of range
    """
    name, _, gamma = text.casefold().partition(":")
    if name not in STANDARDS or (gamma and name != "power"):
        raise unknown_name("camera response", text, RESPONSES)
    if name == "linear":
        return None
    try:
        exponent = float(gamma) if gamma else 2.2
    except ValueError:
        raise UsageError(
            f"invalid response '{text}': '{gamma}' is not a number", hint="for example power:2.2"
        ) from None
    return standard_response(name, bits, levels=levels, gamma=exponent)
