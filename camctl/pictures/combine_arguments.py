"""The arguments of `combine`: frames as arrays, levels, responses and noise, checked."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from numbers import Integral, Real
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from camctl.errors import DataError, UsageError, unknown_name
from camctl.evidence.patches import SIDE
from camctl.interface.controls import Layout
from camctl.model.effective import check_ratio
from camctl.model.noise import FrameNoise, NoiseModel
from camctl.model.response.camera import (
    CameraResponse,
    linear_response,
    phase_of_black,
    standard_response,
)

Noise: TypeAlias = NoiseModel | FrameNoise | Sequence[FrameNoise]
Response: TypeAlias = CameraResponse | str | Sequence[CameraResponse]


def _known_exposures(exposures: Sequence[float]) -> list[float]:
    """Return the exposures of frames; fractions, too, are numbers."""
    given = list(exposures) if isinstance(exposures, Iterable) else None
    if given is None or not all(isinstance(each, Real) for each in given):
        shown = exposures if given is None else given
        raise UsageError(f"invalid exposures {shown!r}: expected a list of numbers above 0")
    if not all(math.isfinite(each) and each > 0 for each in given):
        raise UsageError(f"invalid exposures {given}: expected finite numbers above 0")
    return [float(each) for each in given]


def checked_frames(
    frames: Iterable[ArrayLike], exposures: Sequence[float]
) -> tuple[list[NDArray[Any]], list[float]]:
    """Return the frames as arrays, and their exposures."""
    if not isinstance(frames, Iterable):
        raise UsageError(f"invalid frames {frames!r}: expected a list of arrays")
    given = list(frames)
    if any(np.ma.is_masked(each) for each in given):
        raise DataError(
            "frames with masked samples: a mask of a frame is not used",
            hint="give the samples alone (numpy.ma.getdata), and mask the result",
        )
    pictures = [np.asarray(each) for each in given]
    exposures = _known_exposures(exposures)
    if not pictures or len(pictures) != len(exposures):
        raise UsageError(
            f"invalid number of exposures: {len(exposures)} for {len(pictures)} frames",
            hint="give at least one frame, and the exposure of each",
        )
    check_ratio(exposures)
    first = pictures[0]
    for each in pictures:
        if each.dtype.kind != "u" or each.dtype.itemsize > 2:
            raise DataError(
                f"invalid frame of {each.dtype}: expected unsigned integers of 8 or 16 bits"
            )
        if each.shape != first.shape or each.dtype != first.dtype:
            raise DataError(
                f"invalid frame of {each.shape} {each.dtype} beside one of {first.shape} "
                f"{first.dtype}: expected frames of one shape and type"
            )
    if first.size == 0 or not (first.ndim == 2 or (first.ndim == 3 and first.shape[2] == 3)):
        raise DataError(
            f"invalid frames of the shape {first.shape}: expected (rows, columns) or "
            "(rows, columns, 3)"
        )
    return pictures, exposures


def known_level(name: str, level: int | None) -> int | None:
    """Return a level as a number of Python: one of an array has the width of its samples."""
    if level is not None and not isinstance(level, Integral):
        raise UsageError(f"invalid {name} level {level!r}: expected an integer")
    return None if level is None else int(level)


def known_levels(
    dtype: np.dtype[Any], response: Response, black: int, white: int | None
) -> tuple[int, int]:
    """Return the brightness without light, and the one from which samples are saturated."""
    black, white = known_level("black", black) or 0, known_level("white", white)
    if white is None and not isinstance(response, str):
        white = black + _curves(response)[0].M
    if white is None and dtype.itemsize > 1:
        raise UsageError(
            "the white level of 16-bit frames is not known",
            hint="give white, such as 4095, or the response as levels",
        )
    found = 255 if white is None else white
    if not 0 <= black < found - 1 < np.iinfo(dtype).max:
        raise UsageError(
            f"invalid black level {black} and white level {found}: expected "
            f"0 <= black, black + 2 <= white <= {np.iinfo(dtype).max}"
        )
    return black, found


def channel_responses(response: Response, black: int, white: int) -> tuple[CameraResponse, ...]:
    """Return the response, or those of R, G and B, as levels."""
    levels, phase = white - black, phase_of_black(black)
    if response == "linear":
        return (linear_response(16, phase=phase, levels=levels),)
    if isinstance(response, str):
        return (standard_response(response, 16, phase=phase, levels=levels),)
    found = _curves(response)
    for each in found:
        if levels != each.M:
            raise UsageError(
                f"the response has {each.M} levels, and white - black is {levels}",
                hint="give the black and white level of the frames",
            )
    return found


def _curves(response: CameraResponse | Sequence[CameraResponse]) -> tuple[CameraResponse, ...]:
    """Return the curve of a response, or those of R, G and B."""
    found = tuple(response) if isinstance(response, Iterable) else (response,)
    if not all(isinstance(each, CameraResponse) for each in found):
        raise UsageError(
            f"invalid response of type {type(response).__name__}: expected a name such as "
            '"linear", a CameraResponse, or three of R, G and B'
        )
    if len(found) not in (1, 3):
        raise UsageError(f"invalid response of {len(found)} curves: expected 1, or 3 of R, G, B")
    return found


def known_gains(gains: Sequence[float] | None, count: int) -> list[float]:
    """Return the linear gain of each of `count` frames."""
    if gains is None:
        return [1.0] * count
    given = list(gains) if isinstance(gains, Iterable) else [gains]
    if len(given) != count or not all(isinstance(x, Real) and 0 < x < math.inf for x in given):
        raise UsageError(f"invalid gains {given!r}: expected {count} finite numbers above 0")
    return [float(each) for each in given]


def known_noise(
    noise: Noise, exposures: Sequence[float], gains: Sequence[float], black: int, step: int
) -> tuple[FrameNoise, ...]:
    """Return the noise of each frame, in levels of `step` DN; black is one of them."""
    if isinstance(noise, NoiseModel):
        noise = [
            noise.frame(gain=gain, time_s=exposure / gain)
            for exposure, gain in zip(exposures, gains, strict=True)
        ]
    given = (noise,) * len(exposures) if isinstance(noise, FrameNoise) else noise
    if not isinstance(given, Sequence) or not all(isinstance(x, FrameNoise) for x in given):
        raise UsageError(
            f"invalid noise of type {type(noise).__name__}: expected a NoiseModel, a FrameNoise, "
            "or a FrameNoise for each frame"
        )
    return tuple(replace(each.in_levels(step), black=black) for each in given)


def known_steps(steps: Sequence[float]) -> NDArray[np.float64]:
    """Return the steps of the frequencies of brightness in JPEG files."""
    found = np.asarray(steps, np.float64)
    if found.shape != (SIDE * SIDE,) or not found.min() > 0:
        raise UsageError(f"invalid brightness_steps: expected {SIDE * SIDE} numbers above 0")
    return found


def frame_layout(shape: Sequence[int], count: int, layout: Layout | str | None) -> Layout:
    """Return the layout of frames of that shape with `count` responses."""
    if len(shape) == 3:
        return Layout.RGB
    if layout is not None and layout not in tuple(Layout):
        raise unknown_name("layout", str(layout), Layout)
    found = Layout.MONO if layout is None else Layout(layout)
    if found is Layout.RGB:
        raise UsageError("frames of one channel have no layout rgb", hint="give rggb or the like")
    if count > 1 and not found.is_mosaic:
        raise UsageError(
            "three responses for frames of one channel", hint="give the layout, such as rggb"
        )
    return found
