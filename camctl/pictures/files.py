"""The picture files of a capture, such as radiance.exr and preview.png."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError, OutOfMemoryError, UsageError
from camctl.pictures.contact_sheet import contact_sheet
from camctl.pictures.details import PictureDetails
from camctl.pictures.dng import dng_tags, has_raw
from camctl.pictures.gain_map import picture_with_gain_map
from camctl.pictures.hdr_avif import avif_library, picture_in_pq
from camctl.pictures.icc import icc_profile
from camctl.pictures.metadata import (
    EXR_PLACEHOLDER,
    exr_attributes,
    fill_exr_header,
    png_with_metadata,
    tiff_tags,
)
from camctl.pictures.preview import renditions
from camctl.pictures.preview_light import PREVIEW_SIDE, LightReducer
from camctl.pictures.render import Rendering, Strip
from camctl.stills import maps
from camctl.stills.separate import map_apart
from camctl.system.files import atomic_file, storage_error, write_bytes
from camctl.system.input_files import check_regular, read_own_file
from camctl.system.interrupts import uninterrupted
from camctl.system.library_output import quiet_libraries
from camctl.system.picture_operations import as_halves, looked_up, opencv, png
from camctl.system.threads import THREADS, Threads, in_threads

#: Several threads compress the radiance of a picture of at least so many pixels.
_LARGE = 4_000_000

SUM, IMAGE, RADIANCE = "sum.tiff", "image.tiff", "radiance.exr"
DNG = "picture.dng"
PREVIEW, PICTURE, AVIF, CONTACT = "preview.png", "picture.jpg", "picture.avif", "contact.png"
PICTURE_FILES = {
    "sum": SUM,
    "image": IMAGE,
    "radiance": RADIANCE,
    "preview": PREVIEW,
    "picture": PICTURE,
    "avif": AVIF,
    "contact": CONTACT,
    "raw": DNG,
}
"""Names of all picture files by kind, see `picture_files`."""

#: Bytes of a preview at most: three for each pixel, and what a PNG file adds where noise makes it
#: impossible to compress.
_LARGEST_PREVIEW = 4 * PREVIEW_SIDE**2

_MASK_PREFIX, _DEVIATION_PREFIX = "mask.", "sd."
#: The values of a mask in float16, as their bits.
_MASKS = np.arange(256).astype(np.float16).view(np.uint16)
_LIBRARIES = ("OpenEXR", "tifffile")
"""Modules that write pictures; the packages that hold them have the same names."""
_SHOOT_AGAIN = "shoot the capture again"


def picture_files(rendering: Rendering) -> dict[str, str]:
    """Return the names of the files that `write_picture_files` writes, by kind."""
    without = set() if opencv() is not None else {"picture"}
    if avif_library() is None:
        without.add("avif")
    if not has_raw(rendering):
        without.add("raw")
    return {kind: name for kind, name in PICTURE_FILES.items() if kind not in without}


def write_picture_files(
    total: NDArray[np.unsignedinteger],
    rendering: Rendering,
    details: PictureDetails,
    directory: Path,
) -> None:
    """Write all files of `picture_files` from one pass over the sum.

    Raises:
        StorageError: one of them could not be written; a file is complete or missing
    """
    tags, radiance = tiff_tags(details), directory / RADIANCE
    height, width = total.shape[:2]
    reducer = LightReducer(height, width, rendering.full, development=rendering.development)
    raw = np.empty(total.shape, np.float16) if has_raw(rendering) else None
    with (
        Threads(2) as threads,
        atomic_file(radiance) as radiance_part,
        atomic_file(directory / IMAGE) as image_part,
    ):
        summed = threads.submit(_write_sum, directory / SUM, total, tags)
        try:
            with _radiance_file(
                radiance_part, radiance, (width, height), rendering, details
            ) as exr:
                codes = _written(total, rendering, exr, reducer, threads, raw)
                profile = _profile(rendering)
                _write_image(image_part, codes, total, rendering, tags | {"iccprofile": profile})
        finally:
            summed.result()  # raises its error before the errors of the others
        light = reducer.light()
        # While the disk takes the files.
        mapped = threads.submit(lambda: renditions(light).upright(details.orientation))
    if raw is not None:
        _write_raw(directory / DNG, raw, rendering, details)
    if (imagecodecs := avif_library()) is not None:
        write_bytes(directory / AVIF, picture_in_pq(mapped.result().light, imagecodecs))
    preview, cv2 = mapped.result().codes, opencv()
    if cv2 is not None:
        write_bytes(directory / PICTURE, picture_with_gain_map(mapped.result(), details, cv2))
    write_bytes(directory / PREVIEW, png_with_metadata(png(preview), details))
    sheet = contact_sheet(light, preview, details, rendering.movement)
    write_bytes(directory / CONTACT, png_with_metadata(png(sheet), details))


def _written(
    total: NDArray[np.unsignedinteger],
    rendering: Rendering,
    exr: _RadianceFile,
    reducer: LightReducer,
    threads: Threads,
    raw: NDArray[np.float16] | None,
) -> Iterator[NDArray[np.uint16]]:
    """Yield the strips of image.tiff; each of them is in `exr`, `reducer` and `raw` then."""
    row = 0

    def prepared(render: Callable[[], Strip]) -> tuple[Strip, dict[str, NDArray[Any]]]:
        strip = render()
        return strip, exr.channels(strip)

    for strip, channels in in_threads(prepared, rendering.strips(total)):
        reduced = threads.submit(reducer.add, strip)
        exr.write(channels)
        if raw is not None and strip.mosaic is not None:
            raw[row : row + len(strip.mosaic)] = strip.mosaic / np.float32(rendering.full)
            row += len(strip.mosaic)
        yield strip.code
        reduced.result()


def _write_image(
    path: Path,
    codes: Iterator[NDArray[np.uint16]],
    total: NDArray[np.unsignedinteger],
    rendering: Rendering,
    tags: dict[str, Any],
) -> None:
    import tifffile

    tifffile.imwrite(
        path,
        codes,
        shape=rendering.picture_shape(total),
        dtype=np.uint16,
        rowsperstrip=rendering.strip_rows(total),
        photometric="minisblack" if rendering.channels == "Y" else "rgb",
        **tags,
    )


def _write_raw(path: Path, samples: Any, rendering: Rendering, details: PictureDetails) -> None:
    import tifffile

    assert rendering.colour is not None  # there are samples
    tags = dng_tags(details, rendering.colour, rendering.full, rendering.layout)
    with atomic_file(path) as part:
        tifffile.imwrite(part, samples, **tags)


def _profile(rendering: Rendering) -> bytes | None:
    """Return the ICC profile of image.tiff; None where its colours are the camera's own."""
    if rendering.channels == "Y":
        return None
    return None if rendering.colour is None else icc_profile(rendering.desired)


def _write_sum(path: Path, total: NDArray[np.unsignedinteger], tags: dict[str, Any]) -> None:
    import tifffile

    photometric = "rgb" if total.ndim == 3 else "minisblack"
    with atomic_file(path) as part:
        tifffile.imwrite(part, total, photometric=photometric, **tags)


def read_tiff(path: Path) -> NDArray[Any]:
    """Return the samples of a TIFF file, (rows, columns) or (rows, columns, 3).

    Raises:
        DataError: the file is missing or damaged
    """
    with _readable(path):
        samples, _ = map_apart(maps.read_tiff, path)
        if samples.ndim not in (2, 3):
            raise ValueError("the file holds no picture")
        return samples


def read_radiance(path: Path) -> NDArray[np.float32]:
    """Return the irradiance in radiance.exr, float32, (rows, columns) or (rows, columns, 3).

    Raises:
        DataError: the file is missing or damaged
    """
    return _read_channels(path, "").astype(np.float32, copy=False)


def read_mask(path: Path) -> NDArray[np.uint8]:
    """Return the mask in radiance.exr, in the shape of the irradiance; raises as that does."""
    found = _read_channels(path, _MASK_PREFIX)
    if not ((found >= 0) & (found <= 255)).all():
        raise DataError(f"cannot read {path}: its masks hold no bits", hint=_SHOOT_AGAIN)
    return found.astype(np.uint8)


def read_deviation(path: Path) -> NDArray[np.float32]:
    """Return the standard deviation in radiance.exr, float32, likewise."""
    return _read_channels(path, _DEVIATION_PREFIX).astype(np.float32, copy=False)


def _read_channels(path: Path, prefix: str) -> NDArray[Any]:
    with _readable(path):
        return map_apart(maps.read_radiance, path, prefix)[0]


def load_libraries() -> None:
    """Import the libraries that make and write pictures, before anything is shot.

    Where memory is short, loading one may end the process.

    Raises:
        UsageError: one of them is not installed
    """
    opencv()
    avif_library()
    for module in _LIBRARIES:
        try:
            import_module(module)
        except ModuleNotFoundError as error:
            raise UsageError(
                f"a capture cannot write its pictures: {module} is not installed",
                hint=f"install it with: pip install {module}",
            ) from error


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn what a library raises for a missing or damaged file into `DataError`."""
    check_regular(path, "", hint=_SHOOT_AGAIN)
    try:
        with quiet_libraries():
            yield
    except MemoryError as error:
        raise OutOfMemoryError(f"cannot read {path}: not enough memory") from error
    except Exception as error:  # the libraries raise errors of any type for a damaged file
        reason = (str(error).strip() or type(error).__name__).splitlines()[0]
        raise DataError(f"cannot read {path}: {reason}", hint=_SHOOT_AGAIN) from error


@contextmanager
def _radiance_file(
    path: Path, final: Path, size: tuple[int, int], rendering: Rendering, details: PictureDetails
) -> Iterator[_RadianceFile]:
    """Open an OpenEXR file at `path`, complete at the end of the block; errors name `final`."""
    import OpenEXR

    if size[0] * size[1] >= _LARGE:
        OpenEXR.set_global_thread_count(THREADS)
    try:
        file = _RadianceFile(path, final, size, rendering)
        try:
            yield file
        finally:
            file.close()
    finally:
        OpenEXR.set_global_thread_count(0)
    fill_exr_header(path, exr_attributes(details, rendering.channels), details.summary)


@lru_cache(maxsize=8)
def _exr_header(
    size: tuple[int, int], names: str, lights_are_halves: bool, deviations_are_halves: bool
) -> dict[str, Any]:
    """Return the header of an OpenEXR file.

    The library never releases the values of a header: files of one size share theirs, so that a
    long series of captures does not grow by them.
    """
    import Imath
    import OpenEXR

    pixels = Imath.PixelType
    kinds = {
        "": pixels.HALF if lights_are_halves else pixels.FLOAT,
        _DEVIATION_PREFIX: pixels.HALF if deviations_are_halves else pixels.FLOAT,
        _MASK_PREFIX: pixels.HALF,
    }
    channels = {
        prefix + name: Imath.Channel(Imath.PixelType(kind))
        for prefix, kind in kinds.items()
        for name in names
    }
    # Without loss.  Of float16, RLE takes half the time of PIZ for 1.5 to 2 times the bytes, about
    # those of sum.tiff; of float32 it would take three times the bytes.  For noisy light PIZ takes
    # half the time of ZIP, and its files are smaller.
    run_lengths = lights_are_halves and deviations_are_halves
    codec = Imath.Compression.RLE_COMPRESSION if run_lengths else Imath.Compression.PIZ_COMPRESSION
    return {
        **OpenEXR.Header(*size),
        "compression": Imath.Compression(codec),
        "channels": channels,
        **EXR_PLACEHOLDER,
    }


class _RadianceFile:
    """An OpenEXR file written strip by strip.

    The time to compress a channel follows its bytes: masks are float16, and so are irradiance and
    standard deviations where that has all of them as they are rounded; else they are float32.  The
    file is written at `path` and will be called `final`, which errors name.
    """

    def __init__(
        self, path: Path, final: Path, size: tuple[int, int], rendering: Rendering
    ) -> None:
        import OpenEXR

        self._names, self._final = rendering.channels, final
        lights, deviations = rendering.lights_are_halves, rendering.deviations_are_halves
        header = _exr_header(size, self._names, lights, deviations)
        self._light = as_halves if lights else np.ascontiguousarray
        self._deviation = as_halves if deviations else np.ascontiguousarray
        # It takes bytes, too.  A str that is not UTF-8 ends the process, as does an exception in
        # the Python code that it calls.
        self._file = uninterrupted(OpenEXR.OutputFile)(os.fsencode(path), header)
        self.close = self._file.close

    def channels(self, strip: Strip) -> dict[str, NDArray[Any]]:
        """Return the channels of a strip, (rows, columns) each."""
        found: dict[str, NDArray[Any]] = {}
        for name, light, deviation, mask in zip(
            self._names, strip.irradiance, strip.deviation, strip.mask, strict=True
        ):
            found[name] = self._light(light)
            found[_DEVIATION_PREFIX + name] = self._deviation(deviation)
            found[_MASK_PREFIX + name] = looked_up(_MASKS, mask).view(np.float16)
        return found

    def write(self, channels: dict[str, NDArray[Any]]) -> None:
        """Append the channels of a strip."""
        rows = len(next(iter(channels.values())))
        try:
            uninterrupted(self._file.writePixels)(channels, rows)
        except OSError as error:
            # Converted here: the TIFF file is written around this call, and would be named instead.
            raise storage_error(self._final, error) from error


def read_preview(folder: Path) -> bytearray:
    """Return the content of a capture's preview, a PNG file.

    Raises:
        DataError: it is missing, no regular file, or larger than any preview
    """
    return read_own_file(folder / PREVIEW, _LARGEST_PREVIEW)
