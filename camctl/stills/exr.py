"""Reads OpenEXR files in this process; those of others are read by `camctl.stills.separate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.system.library_output import exr_source

Shape: TypeAlias = tuple[int, ...]
Map: TypeAlias = tuple[NDArray[Any], tuple[str, ...]]
"""A map (RGB order), and notes about what of its file was left out."""

_EXPOSURE = ("expTime", "isoSpeed", "aperture")


def exr_shape(path: Path) -> Shape:
    """Return (rows, columns, 3) from the header; errors are those of the library."""
    low, high = _header(path)["dataWindow"]
    return int(high[1] - low[1] + 1), int(high[0] - low[0] + 1), 3


def exr_exposure(path: Path) -> dict[str, float]:
    """Return the standard attributes of the exposure (time in s, ISO, f-number) that are valid."""
    header = _header(path)
    stated = {name: header.get(name) for name in _EXPOSURE}
    return {
        name: float(value)
        for name, value in stated.items()
        if isinstance(value, int | float) and 0 < value < math.inf
    }


def read_exr(path: Path) -> Map:
    """Return the samples of an OpenEXR file, in float16, float32 or uint32.

    Raises:
        DataError: it has neither colours nor luminance; other errors are those of the library
    """
    import OpenEXR

    with exr_source(path) as source, OpenEXR.File(source, separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    if all(name in channels for name in "RGB"):
        return np.stack([channels[name] for name in "RGB"], axis=-1), ()
    if "Y" in channels:
        notes = ("only luminance was read, colour was ignored",) if "RY" in channels else ()
        return np.asarray(channels["Y"]), notes
    if len(channels) == 1:
        return np.asarray(next(iter(channels.values()))), ()
    raise DataError(
        f"{path}: no colour or luminance among channels {', '.join(sorted(channels))}",
        hint="R, G and B, or Y, or a single channel are needed",
    )


def _header(path: Path) -> dict[str, Any]:
    import OpenEXR

    with exr_source(path) as source, OpenEXR.File(source, header_only=True) as file:
        return dict(file.header())  # the library clears its own
