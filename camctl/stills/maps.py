"""Reads OpenEXR and TIFF files of light in this process; `camctl.stills.separate` reads them apart.

Errors are those of the libraries, of any type, unless a function says otherwise.
"""

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
    """Return (rows, columns, 3) from the header."""
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
        DataError: it has neither colours nor luminance
    """
    channels = _channels(path)
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


def read_radiance(path: Path, prefix: str = "") -> Map:
    """Return the channels of a capture's radiance.exr whose names begin so, float16 or float32."""
    channels = _channels(path)
    names = "Y" if "Y" in channels else "RGB"
    found = [channels[prefix + name] for name in names]
    return found[0] if len(names) == 1 else np.stack(found, axis=-1), ()


def tiff_shape(path: Path) -> Shape:
    """Return the shape of the first picture of a TIFF file."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        return tuple(_first(file).shape)


def read_tiff(path: Path) -> Map:
    """Return the first picture of a TIFF file, colours in the last place."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        page = _first(file)
        values, axes = np.asarray(page.asarray(maxworkers=1)), page.axes
        notes = ("only the first of several pictures was read",) if _has_more(file) else ()
    if values.ndim == 3 and axes[0] in "SC" and values.shape[0] in (1, 3):
        values = np.moveaxis(values, 0, -1)  # stored as separate planes
    if values.ndim == 3 and values.shape[2] == 4:
        opaque = "the fourth channel was taken as opacity and ignored"
        return values[..., :3], (*notes, opaque)
    return values, notes


def _first(file: Any) -> Any:
    """Return the first picture of a `tifffile.TiffFile`; raise `ValueError` where strips lack.

    tifffile would go through all that are missing, and a short file may state millions.  So it may
    with pictures: nothing here may ask how many there are, as `TiffFile.series` does.
    """
    page = file.pages.first
    if len(page.dataoffsets) < math.prod(page.chunked):
        raise ValueError("most of its samples are missing")
    return page


def _has_more(file: Any) -> bool:
    try:
        return file.pages[1] is not None
    except Exception:  # damage after the first picture does not matter
        return False


def _channels(path: Path) -> dict[str, NDArray[Any]]:
    import OpenEXR

    with exr_source(path) as source, OpenEXR.File(source, separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}


def _header(path: Path) -> dict[str, Any]:
    import OpenEXR

    with exr_source(path) as source, OpenEXR.File(source, header_only=True) as file:
        return dict(file.header())  # the library clears its own


READERS = {
    read.__name__: read
    for read in (exr_shape, exr_exposure, read_exr, read_radiance, tiff_shape, read_tiff)
}
"""What a process of its own may be asked to read."""
