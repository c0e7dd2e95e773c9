"""The picture files of a capture: sum.tiff, image.tiff, radiance.exr and preview.png."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.captures.pictures import FULL_CODE, Rendering
from camctl.errors import DataError
from camctl.files import atomic_file, storage_error, write_bytes
from camctl.response.desired import DesiredResponse

SUM, IMAGE, RADIANCE, PREVIEW = "sum.tiff", "image.tiff", "radiance.exr", "preview.png"

#: Longest side of the preview, pixels.
_PREVIEW_SIDE = 1600
_MASK_PREFIX = "mask."


def write_picture_files(
    total: NDArray[np.unsignedinteger], rendering: Rendering, directory: Path
) -> dict[str, str]:
    """Write all four files from one pass over the sum; return their names by kind.

    Raises:
        StorageError: one of them could not be written; a file is complete or missing
    """
    import tifffile

    with atomic_file(directory / SUM) as part:
        tifffile.imwrite(part, total, photometric="rgb" if total.ndim == 3 else "minisblack")
    height, width = total.shape[:2]
    step = -(-max(height, width) // _PREVIEW_SIDE)
    preview: list[NDArray[np.uint16]] = []
    with ExitStack() as stack:
        exr = stack.enter_context(
            _radiance_file(directory / RADIANCE, width, height, rendering.channels)
        )
        tiff = stack.enter_context(atomic_file(directory / IMAGE))

        def codes() -> Iterator[NDArray[np.uint16]]:
            row = 0
            for strip in rendering.strips(total):
                exr.write(strip.irradiance, strip.mask)
                # A copy: a view would keep the whole strip in memory.
                preview.append(strip.code[-row % step :: step, ::step].copy())
                row += strip.code.shape[0]
                yield strip.code

        tifffile.imwrite(
            tiff,
            codes(),
            shape=rendering.picture_shape(total),
            dtype=np.uint16,
            rowsperstrip=rendering.strip_rows(total),
            photometric="minisblack" if rendering.channels == "Y" else "rgb",
        )
    write_bytes(directory / PREVIEW, _png(np.concatenate(preview), rendering.desired))
    return {"sum": SUM, "image": IMAGE, "radiance": RADIANCE, "preview": PREVIEW}


def read_tiff(path: Path) -> NDArray[Any]:
    """Return the samples of a TIFF file, (rows, columns) or (rows, columns, 3).

    Raises:
        DataError: the file is missing or damaged
    """
    import tifffile

    with _readable(path):
        samples = np.asarray(tifffile.imread(path))
        if samples.ndim not in (2, 3):
            raise ValueError("the file holds no picture")
        return samples


def read_radiance(path: Path) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Return irradiance and mask of radiance.exr, each (rows, columns) or (rows, columns, 3).

    Raises:
        DataError: the file is missing or damaged
    """
    import OpenEXR

    with _readable(path):
        with OpenEXR.File(str(path), separate_channels=True) as file:
            channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
        names = "Y" if "Y" in channels else "RGB"
        irradiance = [channels[name] for name in names]
        mask = [channels[_MASK_PREFIX + name].astype(np.uint8) for name in names]
    if len(names) == 1:
        return irradiance[0], mask[0]
    return np.stack(irradiance, axis=-1), np.stack(mask, axis=-1)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn what a library raises for a missing or damaged file into `DataError`."""
    try:
        yield
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise DataError(f"cannot read {path}: {error}", hint="shoot the capture again") from error


def _png(code: NDArray[np.uint16], desired: DesiredResponse) -> bytes:
    import cv2

    shown = code.astype(np.float32) / FULL_CODE
    if desired.name == "linear":
        # Displays expect encoded light; the other responses are close enough to an encoding.
        shown = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    eight = np.rint(shown * 255).astype(np.uint8)
    return cv2.imencode(".png", eight[..., ::-1] if eight.ndim == 3 else eight)[1].tobytes()


@contextmanager
def _radiance_file(path: Path, width: int, height: int, names: str) -> Iterator[_RadianceFile]:
    with atomic_file(path) as part:
        file = _RadianceFile(part, path, width, height, names)
        try:
            yield file
        finally:
            file.close()


class _RadianceFile:
    """An OpenEXR file written strip by strip: irradiance in float32, masks in uint32.

    It is written at `path` and will be called `final`, which errors name.
    """

    def __init__(self, path: Path, final: Path, width: int, height: int, names: str) -> None:
        import Imath
        import OpenEXR

        header = OpenEXR.Header(width, height)
        kinds = {"": Imath.PixelType.FLOAT, _MASK_PREFIX: Imath.PixelType.UINT}
        header["channels"] = {
            prefix + name: Imath.Channel(Imath.PixelType(kind))
            for prefix, kind in kinds.items()
            for name in names
        }
        self._names, self._final = names, final
        self._file = OpenEXR.OutputFile(str(path), header)
        self.close = self._file.close

    def write(self, irradiance: NDArray[np.float32], mask: NDArray[np.uint8]) -> None:
        """Append a strip, (rows, columns) or (rows, columns, 3)."""
        channels = {}
        for index, name in enumerate(self._names):
            part = (..., index) if irradiance.ndim == 3 else ...
            channels[name] = np.ascontiguousarray(irradiance[part]).tobytes()
            channels[_MASK_PREFIX + name] = mask[part].astype(np.uint32).tobytes()
        try:
            self._file.writePixels(channels, irradiance.shape[0])
        except OSError as error:
            # Converted here: the TIFF file is written around this call, and would be named instead.
            raise storage_error(self._final, error) from error
