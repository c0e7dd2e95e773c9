"""From the sum to the pictures that are handed over, strip by strip.

One pass over the sum gives all of them: a table turns each value of the sum into irradiance,
another one into the desired response.  A mosaic is turned into irradiance first and into colours
afterwards, so that interpolation works on light.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.captures.demosaic import demosaic, spread
from camctl.captures.metering import GLINTS, NOTHING
from camctl.captures.plan import relative
from camctl.captures.report import Achieved, CaptureReport, Irradiance
from camctl.controls import ExposureControls, Layout
from camctl.exposure.effective import EffectiveCamera
from camctl.exposure.objective import Objective, evaluate
from camctl.files import storage_error, whole, write_bytes
from camctl.response.desired import DesiredResponse

#: Marks in the mask channels of radiance.exr.
GOOD, DARK, SATURATED = 0, 1, 2
_STRIP_SAMPLES = 1 << 20
_PREVIEW_SIDE = 1600
_FULL = 65535


@dataclass(frozen=True)
class Tables:
    """What each value of the sum means, black included: arrays indexed by the sum.

    Attributes:
        irradiance: float32, E / full-scale exposure; what lies outside the levels is clamped
        code: uint16, the desired response, 0 to 65,535
        mask: uint8, `GOOD`, `DARK` (below the first level) or `SATURATED` (in every frame)

    """

    irradiance: NDArray[np.float32]
    code: NDArray[np.uint16]
    mask: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        effective: EffectiveCamera,
        desired: DesiredResponse,
        black_total: int,
        full_scale_exposure: float,
    ) -> Tables:
        """Tabulate the inverse of the effective camera for sums of frames with their black in."""
        inverse = effective.irradiance_table()
        top = inverse.size - 1
        signed = np.arange(top + black_total + 1) - black_total
        E = inverse[np.clip(signed, 0, top)]
        mask = np.full(signed.size, GOOD, np.uint8)
        mask[signed <= 0] = DARK
        mask[signed >= top] = SATURATED
        return cls(
            irradiance=(E / full_scale_exposure).astype(np.float32),
            code=encode(desired, E),
            mask=mask,
        )


def encode(desired: DesiredResponse, E: NDArray[Any]) -> NDArray[np.uint16]:
    """Return the desired response to irradiance, 0 to 65,535."""
    return np.rint(desired.u(E) * _FULL).astype(np.uint16)


@dataclass(frozen=True)
class Shares:
    """Share of the samples of a sum that every frame saturated, and that no frame reached."""

    saturated: float
    dark: float


def shares(total: NDArray[np.unsignedinteger], tables: Tables) -> Shares:
    """Count what lies outside the effective camera's levels."""
    counts = np.zeros(3, np.int64)
    flat = total.reshape(-1)
    for start in range(0, flat.size, _STRIP_SAMPLES):
        marks = tables.mask[flat[start : start + _STRIP_SAMPLES]]
        counts += np.bincount(marks, minlength=3)
    return Shares(
        saturated=int(counts[SATURATED]) / flat.size,
        dark=int(counts[DARK]) / flat.size,
    )


@dataclass(frozen=True)
class _Strip:
    irradiance: NDArray[np.float32]
    code: NDArray[np.uint16]
    mask: NDArray[np.uint8]


def _strips(
    total: NDArray[np.unsignedinteger],
    layout: Layout,
    tables: Tables,
    desired: DesiredResponse,
    full_scale_exposure: float,
    rows: int,
) -> Iterator[_Strip]:
    height = total.shape[0]
    for start in range(0, height, rows):
        stop = min(start + rows, height)
        if not layout.is_mosaic:
            sums = total[start:stop]
            yield _Strip(tables.irradiance[sums], tables.code[sums], tables.mask[sums])
            continue
        first, last = max(0, start - 2), min(height, stop + 2)
        sums = total[first:last]
        inner = slice(start - first, stop - first)
        irradiance = demosaic(tables.irradiance[sums], layout, first)[inner]
        yield _Strip(
            irradiance,
            encode(desired, irradiance * full_scale_exposure),
            spread(tables.mask[sums])[inner],
        )


def write_sum(total: NDArray[np.unsignedinteger], path: Path) -> None:
    """Write the integer sum as it is, black included."""
    import tifffile

    with whole(path) as part:
        tifffile.imwrite(part, total, photometric="rgb" if total.ndim == 3 else "minisblack")


def write_pictures(
    total: NDArray[np.unsignedinteger],
    layout: Layout,
    tables: Tables,
    desired: DesiredResponse,
    full_scale_exposure: float,
    directory: Path,
) -> None:
    """Write image.tiff, radiance.exr and preview.png from one pass over the sum.

    Raises:
        StorageError: one of them could not be written; it is then not there at all

    """
    import tifffile

    height, width = total.shape[:2]
    colours = 1 if layout is Layout.MONO else 3
    rows = max(2, _STRIP_SAMPLES // (width * colours) & ~1)
    step = -(-max(height, width) // _PREVIEW_SIDE)
    preview: list[NDArray[np.uint16]] = []
    names = "Y" if colours == 1 else "RGB"
    with ExitStack() as stack:
        exr = stack.enter_context(_radiance(directory / "radiance.exr", width, height, names))
        tiff = stack.enter_context(whole(directory / "image.tiff"))

        def codes() -> Iterator[NDArray[np.uint16]]:
            row = 0
            for strip in _strips(total, layout, tables, desired, full_scale_exposure, rows):
                exr.write(strip.irradiance, strip.mask)
                # A copy: a view would keep the whole strip.
                preview.append(strip.code[-row % step :: step, ::step].copy())
                row += strip.code.shape[0]
                yield strip.code

        tifffile.imwrite(
            tiff,
            codes(),
            shape=(height, width, 3) if colours == 3 else (height, width),
            dtype=np.uint16,
            rowsperstrip=rows,
            photometric="rgb" if colours == 3 else "minisblack",
        )
    write_bytes(directory / "preview.png", _png(np.concatenate(preview), desired))


def _png(code: NDArray[np.uint16], desired: DesiredResponse) -> bytes:
    import cv2

    shown = code.astype(np.float32) / _FULL
    if desired.name == "linear":
        # Displays expect encoded light; the other responses are near enough to an encoding.
        shown = np.where(shown <= 0.0031308, 12.92 * shown, 1.055 * shown ** (1 / 2.4) - 0.055)
    eight = np.rint(shown * 255).astype(np.uint8)
    return cv2.imencode(".png", eight[..., ::-1] if eight.ndim == 3 else eight)[1].tobytes()


@contextmanager
def _radiance(path: Path, width: int, height: int, names: str) -> Iterator[_RadianceFile]:
    with whole(path) as part:
        file = _RadianceFile(part, path, width, height, names)
        try:
            yield file
        finally:
            file.close()


class _RadianceFile:
    """An OpenEXR file written strip by strip: light in float32, marks in unsigned integers."""

    def __init__(self, path: Path, named: Path, width: int, height: int, names: str) -> None:
        import Imath
        import OpenEXR

        header = OpenEXR.Header(width, height)
        kinds = {"": Imath.PixelType.FLOAT, "mask.": Imath.PixelType.UINT}
        header["channels"] = {
            prefix + name: Imath.Channel(Imath.PixelType(kind))
            for prefix, kind in kinds.items()
            for name in names
        }
        self._names, self._named = names, named
        self._file = OpenEXR.OutputFile(str(path), header)
        self.close = self._file.close

    def write(self, irradiance: NDArray[np.float32], mask: NDArray[np.uint8]) -> None:
        """Append a strip, (rows, columns) or (rows, columns, 3)."""
        channels = {}
        for index, name in enumerate(self._names):
            part = (..., index) if irradiance.ndim == 3 else ...
            channels[name] = np.ascontiguousarray(irradiance[part]).tobytes()
            channels["mask." + name] = mask[part].astype(np.uint32).tobytes()
        try:
            self._file.writePixels(channels, irradiance.shape[0])
        except OSError as error:
            # Told here, since the file that is written around this one would claim it.
            raise storage_error(self._named, error) from error


#: A picture with more than this share of it saturated shows nothing.
_NOTHING_LEFT = 0.99


def write_outputs(
    report: CaptureReport,
    total: NDArray[np.unsignedinteger],
    controls: ExposureControls,
    directory: Path,
) -> None:
    """Write the sum and the pictures into `directory`, and complete the report.

    The effective camera is that of the applied exposures, not of the wanted ones.

    Args:
        report: of a capture that has all its frames; changed in place and written
        total: sum of its frames, black included
        controls: of the camera
        directory: the capture's folder

    Raises:
        StorageError: a file could not be written

    """
    began = time.perf_counter()
    plan = report.plan
    records = [record for record in report.frames if record is not None]
    applied = [record.applied for record in records]
    exposures = relative(applied)
    for record, exposure in zip(records, exposures, strict=True):
        record.exposure = exposure
    effective = EffectiveCamera.of(controls.levels, exposures)
    desired = plan.desired
    full_scale_exposure = min(setting.exposure for setting in applied)
    if controls.sensitivity is not None:
        full_scale_exposure *= controls.sensitivity
    tables = Tables.of(effective, desired, report.black_total, full_scale_exposure)
    outside = shares(total, tables)
    quality = evaluate(controls.levels, exposures, desired, objective=Objective(plan.levels_wanted))
    report.achieved = Achieved(
        xi=quality.xi,
        effective_levels=quality.effective_levels,
        levels=quality.levels,
        levels_distinct=quality.levels_distinct,
        saturated_fraction=outside.saturated,
        dark_fraction=outside.dark,
    )
    report.warnings += _blind(total, report.black_total, controls.levels.M, outside.saturated)
    report.irradiance = Irradiance(
        unit="full scales per second" if controls.sensitivity is None else "as the scene",
        full_scale_exposure=full_scale_exposure,
    )
    write_sum(total, directory / "sum.tiff")
    write_pictures(total, controls.layout, tables, desired, full_scale_exposure, directory)
    report.files = {
        "sum": "sum.tiff",
        "image": "image.tiff",
        "radiance": "radiance.exr",
        "preview": "preview.png",
    }
    report.warnings = [*plan.warnings, *report.warnings]
    report.timing["writing_s"] = time.perf_counter() - began
    report.status = "complete"
    report.write(directory)


def _blind(
    total: NDArray[np.unsignedinteger], black_total: int, levels: int, saturated: float
) -> list[str]:
    """Return a line for a picture that holds no light, or nothing but too much of it.

    Read noise around a black level lights half of the samples: light is what rises above
    `metering.NOTHING` of one frame's levels.
    """
    lit = np.count_nonzero(total > black_total + NOTHING * levels) / total.size
    if lit <= GLINTS:
        return [
            "there is nothing to see: all is black in every exposure; take the lens cap off, or "
            "expose longer (--base)"
        ]
    if saturated > _NOTHING_LEFT:
        return [
            f"{saturated:.2%} of the picture is white in every exposure; expose shorter (--base), "
            f"close the aperture, or put a filter before the lens"
        ]
    return []
