"""Measured response curves turned into levels, every repair said aloud."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError
from camctl.response.camera import CameraResponse, FloatArray, check_quantiser, quantiser_name
from camctl.response.desired import DesiredResponse, tabulated_desired

LARGEST_REPAIR = 0.05
"""A curve whose isotonic fit moves a point by more than this share of full scale is refused."""


def isotonic(values: FloatArray) -> FloatArray:
    """Return the non-decreasing sequence nearest to `values` (N,) in least squares.

    Pool adjacent violators: neighbours that fall are replaced by their mean until none falls.
    """
    means: list[float] = []
    sizes: list[int] = []
    for value in values.tolist():
        mean, size = value, 1
        while means and means[-1] > mean:
            mean = (means[-1] * sizes[-1] + mean * size) / (sizes[-1] + size)
            size += sizes.pop()
            means.pop()
        means.append(mean)
        sizes.append(size)
    return np.repeat(np.array(means), sizes)


def _repaired(E: FloatArray, B: FloatArray, name: str) -> tuple[FloatArray, FloatArray, list[str]]:
    """Return the curve sorted, non-decreasing and from 0 to 1, and what was done to it."""
    notes: list[str] = []
    if np.any(np.diff(E) < 0):
        order = np.argsort(E, kind="stable")
        E, B = E[order], B[order]
        notes.append("rows were not in order of irradiance: sorted")
    if (repeated := int(np.count_nonzero(np.diff(E) == 0))) > 0:
        distinct, where = np.unique(E, return_inverse=True)
        B = np.bincount(where, weights=B) / np.bincount(where)
        E = distinct
        notes.append(f"{repeated} repeated irradiances: their brightness was averaged")
    if E.size < 2 or B.max() <= B.min():
        raise DataError(f"{name}: the curve is constant", hint="brightness must rise with light")
    fit = isotonic(B)
    moved = float(np.max(np.abs(fit - B)))
    if moved > LARGEST_REPAIR * float(B.max() - B.min()):
        raise DataError(
            f"{name}: brightness falls with irradiance (a rising fit would move it by {moved:.3g})",
            hint="check the order of the columns: irradiance first, brightness second",
        )
    if moved > 0:
        falls = int(np.count_nonzero(np.diff(B) < 0))
        notes.append(
            f"brightness falls at {falls} of {B.size} points: isotonic fit, moved by <= {moved:.2g}"
        )
    B = fit
    if E[0] > 0:
        if B[0] > 0:
            notes.append(f"no sample below irradiance {E[0]:.3g}: a line to the origin was added")
        E, B = np.concatenate([[0.0], E]), np.concatenate([[min(0.0, B[0])], B])
    if B[0] != 0:
        notes.append(f"brightness {B[0]:.3g} without light was taken off")
        B = B - B[0]
    if B[-1] != 1:
        notes.append(f"largest brightness {B[-1]:.6g} was scaled to 1")
        B = B / B[-1]
    saturation = float(E[np.argmax(B >= 1)])
    if saturation != 1:
        notes.append(f"irradiance {saturation:.6g}, where brightness reaches 1, was scaled to 1")
        E = E / saturation
    if (flat := int(np.count_nonzero(np.diff(B) == 0))) > 0:
        notes.append(f"flat over {flat} of {B.size - 1} steps: light does not change it there")
    return E, B, notes


def measured_response(
    irradiance: ArrayLike,
    brightness: ArrayLike,
    *,
    bits: int = 8,
    phase: float = 0.0,
    levels: int | None = None,
    name: str = "curve",
) -> CameraResponse:
    """Return a measured camera: E_k = B^-1((k - phase) / (M + 1)), k = 1..M.

    `irradiance` (>= 0) and `brightness` are (N,) in any unit; the curve is linear between samples.
    B^-1 is the least irradiance that reaches a brightness, so that flat runs are harmless.  What
    had to be repaired stands in `CameraResponse.notes`.  Raises `DataError` for what cannot be.
    """
    count = check_quantiser(bits, phase, levels)
    E = np.array(irradiance, dtype=np.float64)
    B = np.array(brightness, dtype=np.float64)
    if E.ndim != 1 or E.shape != B.shape or E.size < 2:
        raise DataError(f"{name}: a curve needs two or more rows of irradiance and brightness")
    bad = np.flatnonzero(~(np.isfinite(E) & np.isfinite(B)))
    if bad.size:
        raise DataError(f"{name}: row {bad[0] + 1} holds a number that is not finite")
    if E.min() < 0:
        raise DataError(f"{name}: irradiance {E.min():.3g} is negative")
    E, B, notes = _repaired(E, B, name)
    if B.size < count:
        notes.append(f"{B.size} samples for {count} levels: a line between neighbouring samples")
    wanted = (np.arange(1, count + 1, dtype=np.float64) - phase) / (count + 1)
    right = np.searchsorted(B, wanted, side="left")
    left = right - 1
    share = (wanted - B[left]) / (B[right] - B[left])
    ladder = np.maximum.accumulate(E[left] + share * (E[right] - E[left]))
    return CameraResponse(ladder, quantiser_name(name, bits, phase, count), tuple(notes))


def read_columns(path: str | Path, second: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the two columns of a text file: irradiance, and what `second` calls the other.

    Columns are parted by blanks, tabs, commas or semicolons; ``#`` starts a comment.  Raises
    `DataError` with the file's name and the line that is wrong.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise DataError(f"curve {path}: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise DataError(
            f"curve {path}: not a text file", hint="give two columns of text"
        ) from error
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(text.splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not words:
            continue
        where = f"curve {path}, line {number}"
        if len(words) != 2:
            raise DataError(
                f"{where}: {len(words)} column{'s' * (len(words) != 1)}",
                hint=f"each line holds irradiance and {second}",
            )
        try:
            rows.append((float(words[0]), float(words[1])))
        except ValueError as error:
            raise DataError(
                f"{where}: '{line.strip()[:40]}' is not two numbers",
                hint="start a comment with #",
            ) from error
    if not rows:
        raise DataError(f"curve {path}: no numbers in it")
    irradiance, other = zip(*rows, strict=True)
    return irradiance, other


def read_curve(
    path: str | Path, *, bits: int = 8, phase: float = 0.0, levels: int | None = None
) -> CameraResponse:
    """Return a measured camera from a text file of two columns; see `read_columns`."""
    irradiance, brightness = read_columns(path, "brightness")
    return measured_response(
        irradiance,
        brightness,
        bits=bits,
        phase=phase,
        levels=levels,
        name=f"curve {Path(path).name}",
    )


def read_desired(path: str | Path) -> DesiredResponse:
    """Return a wanted response from a text file of two columns, irradiance and brightness.

    Its dynamic range is the last irradiance over the first.  See `read_columns` for the file, and
    `tabulated_desired` for what must hold.
    """
    irradiance, brightness = read_columns(path, "wanted brightness")
    return tabulated_desired(irradiance, brightness, name=Path(path).name)
