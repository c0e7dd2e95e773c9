"""Radiance maps from files: .hdr, .pic, .exr, .tif, .tiff, .npy; each library only when needed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from sim.rgbe import read_rgbe, rgbe_shape

Result = TypeVar("Result")
Shape: TypeAlias = tuple[int, ...]
Map: TypeAlias = tuple[NDArray[Any], tuple[str, ...]]


@dataclass(frozen=True)
class _Kind:
    """How one kind of file is read: its size alone, and its pixels with notes."""

    shape: Callable[[Path], Shape]
    pixels: Callable[[Path], Map]


def read_shape(path: Path) -> Shape:
    """Return the size of the map in `path` without reading its pixels; raises `DataError`."""
    return _reading(path, _KINDS[path.suffix.lower()].shape)


def read_map(path: Path) -> Map:
    """Return the map in `path` as it stands there (RGB order), and what had to be repaired.

    Raises:
        DataError: missing, unreadable, or not what its name says
    """
    return _reading(path, _KINDS[path.suffix.lower()].pixels)


def _reading(path: Path, read: Callable[[Path], Result]) -> Result:
    if not path.exists():
        raise DataError(f"{path}: no such file", hint="give a scene's name or a radiance map")
    try:
        return read(path)
    except DataError:
        raise
    except PermissionError as error:
        raise DataError(f"{path}: no permission to read it") from error
    # Readers of foreign files raise whatever a damaged one leads them to.
    except Exception as error:
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise DataError(
            f"{path}: cannot be read as {path.suffix} ({reason})", hint="is it damaged?"
        ) from error


def _npy_shape(path: Path) -> Shape:
    return tuple(np.load(path, mmap_mode="r", allow_pickle=False).shape)


def _npy(path: Path) -> Map:
    return np.load(path, allow_pickle=False), ()


def _tiff_shape(path: Path) -> Shape:
    import tifffile

    with tifffile.TiffFile(path) as file:
        return tuple(file.series[0].shape)


def _tiff(path: Path) -> Map:
    import tifffile

    with tifffile.TiffFile(path) as file:
        series = file.series[0]
        values = np.asarray(series.asarray())
        axes = series.axes
    if values.ndim == 3 and axes[0] in "SC" and values.shape[0] in (1, 3):
        values = np.moveaxis(values, 0, -1)  # planes one after another
    if values.ndim == 3 and values.shape[2] == 4:
        return values[..., :3], ("the fourth channel was taken for opacity and left out",)
    return values, ()


def _exr_shape(path: Path) -> Shape:
    import OpenEXR

    with OpenEXR.File(str(path), header_only=True) as file:
        low, high = file.header()["dataWindow"]
        return int(high[1] - low[1] + 1), int(high[0] - low[0] + 1), 3


def _exr(path: Path) -> Map:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    if all(name in channels for name in "RGB"):
        return np.stack([channels[name] for name in "RGB"], axis=-1), ()
    if "Y" in channels:
        notes = ("only its luminance was read",) if "RY" in channels else ()
        return np.asarray(channels["Y"]), notes
    if len(channels) == 1:
        return np.asarray(next(iter(channels.values()))), ()
    raise DataError(
        f"{path}: its channels are {', '.join(sorted(channels))}", hint="R, G and B or Y are needed"
    )


_KINDS = {
    ".hdr": _Kind(rgbe_shape, read_rgbe),
    ".pic": _Kind(rgbe_shape, read_rgbe),
    ".exr": _Kind(_exr_shape, _exr),
    ".tif": _Kind(_tiff_shape, _tiff),
    ".tiff": _Kind(_tiff_shape, _tiff),
    ".npy": _Kind(_npy_shape, _npy),
}
SUFFIXES = tuple(_KINDS)
