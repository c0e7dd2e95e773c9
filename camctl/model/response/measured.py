"""Measured response curves: conversion to levels with every repair reported, and text files.

Besides single curves there is the empirical model of response of Grossberg and Nayar ("What is the
Space of Camera Response Functions?", CVPR 2003): a mean curve plus weighted components.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from camctl.errors import DataError, UsageError
from camctl.model.response.camera import CameraResponse, FloatArray, check_quantiser, quantiser_name
from camctl.model.response.desired import DesiredResponse
from camctl.model.response.tabulated import tabulated_desired
from camctl.system.input_files import read_input_text

MAX_REPAIR = 0.05
"""Largest change that the isotonic fit may make to a point, as a share of the curve's range.

Noise in a measured curve is far below it; columns in the wrong order are far above it.
"""


def isotonic(values: FloatArray) -> FloatArray:
    """Return the non-decreasing sequence nearest to `values` (N,) in least squares.

    Pool adjacent violators: decreasing neighbours are replaced by their mean until none decreases.
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
    """Return the curve sorted, non-decreasing and from 0 to 1, and a note for each change."""
    notes: list[str] = []
    if np.any(np.diff(E) < 0):
        order = np.argsort(E, kind="stable")
        E, B = E[order], B[order]
        notes.append("rows were not in order of irradiance: sorted")
    if (repeated := int(np.count_nonzero(np.diff(E) == 0))) > 0:
        distinct, where = np.unique(E, return_inverse=True)
        B = np.bincount(where, weights=B) / np.bincount(where)
        E = distinct
        notes.append(f"{repeated} repeated irradiances: the brightness of each was averaged")
    if E.size < 2 or B.max() <= B.min():
        raise DataError(
            f"{name}: the brightness is constant", hint="it must increase with irradiance"
        )
    fit = isotonic(B)
    moved = float(np.max(np.abs(fit - B)))
    if moved > MAX_REPAIR * float(B.max() - B.min()):
        raise DataError(
            f"{name}: brightness decreases with irradiance (a non-decreasing fit changes it by "
            f"{moved:.3g})",
            hint="check the order of the columns: irradiance first, brightness second",
        )
    if moved > 0:
        decreases = int(np.count_nonzero(np.diff(B) < 0))
        notes.append(
            f"brightness decreases at {decreases} of {B.size} points: isotonic fit, which changed "
            f"it by at most {moved:.2g}"
        )
    B = fit
    if E[0] > 0:
        if B[0] > 0:
            notes.append(f"no sample below irradiance {E[0]:.3g}: a line to the origin was added")
        E, B = np.concatenate([[0.0], E]), np.concatenate([[min(0.0, B[0])], B])
    if B[0] != 0:
        notes.append(f"brightness {B[0]:.3g} without light was subtracted")
        B = B - B[0]
    if B[-1] != 1:
        notes.append(f"largest brightness {B[-1]:.6g} was scaled to 1")
        B = B / B[-1]
    saturation = float(E[np.argmax(B >= 1)])
    if saturation != 1:
        notes.append(f"irradiance {saturation:.6g}, where brightness reaches 1, was scaled to 1")
        E = E / saturation
    if (flat := int(np.count_nonzero(np.diff(B) == 0))) > 0:
        notes.append(f"brightness is constant over {flat} of {B.size - 1} steps")
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
    """Return the response of a measured curve: E_k = B^-1((k - phase) / (M + 1)), k = 1..M.

    The curve is linear between samples.  B^-1 is the smallest irradiance that reaches a brightness,
    so that it exists on flat runs, too.

    Args:
        irradiance: (N,) >= 0, N >= 2, any unit
        brightness: (N,) any unit
        bits: bit depth, 1 to 16
        phase: phase of the quantiser, in [0, 1): 0 truncates, 0.5 rounds
        levels: M, the white level minus the black level; None: 2^bits - 1
        name: name shown to people

    Returns:
        the response; its `notes` list the repairs

    Raises:
        UsageError: bits, phase or levels are out of range
        DataError: the samples are too few, negative, not finite, constant, or decrease too much
    """
    count = check_quantiser(bits, phase, levels)
    E = np.array(irradiance, dtype=np.float64)
    B = np.array(brightness, dtype=np.float64)
    if E.ndim != 1 or E.shape != B.shape or E.size < 2:
        raise DataError(f"{name}: expected two or more rows of irradiance and brightness")
    bad = np.flatnonzero(~(np.isfinite(E) & np.isfinite(B)))
    if bad.size:
        raise DataError(f"{name}: row {bad[0] + 1} contains a number that is not finite")
    if E.min() < 0:
        raise DataError(f"{name}: irradiance {E.min():.3g} is negative")
    E, B, notes = _repaired(E, B, name)
    if B.size < count:
        notes.append(f"{B.size} samples for {count} levels: interpolated linearly")
    target = (np.arange(1, count + 1, dtype=np.float64) - phase) / (count + 1)
    right = np.searchsorted(B, target, side="left")
    left = right - 1
    share = (target - B[left]) / (B[right] - B[left])
    crossed = np.maximum.accumulate(E[left] + share * (E[right] - E[left]))
    return CameraResponse(crossed, quantiser_name(name, bits, phase, count), tuple(notes))


@dataclass(frozen=True, eq=False)
class ResponseModel:
    """The empirical model of response: curves that are a mean plus weighted components.

    Attributes:
        irradiance: (S,) float64, 0..1
        mean: (S,) float64, brightness of the mean response
        components: (C, S) float64
    """

    irradiance: FloatArray
    mean: FloatArray
    components: FloatArray

    def response(
        self,
        weights: Sequence[float] = (),
        *,
        bits: int = 8,
        phase: float = 0.0,
        name: str = "EMoR",
    ) -> CameraResponse:
        """Return the response of the mean plus the first components times `weights`.

        Such a curve need not increase everywhere; its repairs are listed in `notes`.

        Raises:
            UsageError: more weights than components
            DataError: the curve cannot be repaired; see `measured_response`
        """
        if len(weights) > len(self.components):
            raise UsageError(
                f"the response model has {len(self.components)} components, not {len(weights)}",
                hint=f"give at most {len(self.components)} weights",
            )
        curve = self.mean + np.array(weights, dtype=float) @ self.components[: len(weights)]
        return measured_response(self.irradiance, curve, bits=bits, phase=phase, name=name)


def read_columns(path: str | Path, second: str) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the two columns of a text file, irradiance and the column that `second` names.

    Columns are separated by blanks, tabs, commas or semicolons; ``#`` starts a comment.

    Raises:
        DataError: the file cannot be read or a line is not two numbers; names file and line
    """
    path = Path(path)
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(read_input_text(path, "curve").splitlines(), 1):
        fields = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if not fields:
            continue
        where = f"curve {path}, line {number}"
        if len(fields) != 2:
            raise DataError(
                f"{where}: expected 2 columns, found {len(fields)}",
                hint=f"each line holds irradiance and {second}",
            )
        try:
            rows.append((float(fields[0]), float(fields[1])))
        except ValueError as error:
            raise DataError(
                f"{where}: '{line.strip()[:40]}' is not two numbers",
                hint="start a comment with #",
            ) from error
    if not rows:
        raise DataError(f"curve {path}: the file contains no numbers")
    irradiance, other = zip(*rows, strict=True)
    return irradiance, other


def read_curve(
    path: str | Path, *, bits: int = 8, phase: float = 0.0, levels: int | None = None
) -> CameraResponse:
    """Return a measured response from a text file of two columns, irradiance and brightness.

    Columns are separated by blanks, tabs, commas or semicolons; ``#`` starts a comment.  `bits`,
    `phase` and `levels` as in `measured_response`.

    Raises:
        UsageError: bits or phase are out of range
        DataError: the file cannot be read, or its curve cannot be used; names file and line
    """
    path = Path(path)
    irradiance, brightness = read_columns(path, "brightness")
    return measured_response(
        irradiance,
        brightness,
        bits=bits,
        phase=phase,
        levels=levels,
        name=f"curve {path.name}",
    )


def read_desired(path: str | Path) -> DesiredResponse:
    """Return a desired response from a text file of two columns, irradiance and brightness.

    The file has the format of `read_curve`; its dynamic range is the last irradiance over the
    first.

    Raises:
        DataError: the file cannot be read, or does not meet the conditions of `tabulated_desired`
    """
    path = Path(path)
    irradiance, brightness = read_columns(path, "desired brightness")
    return tabulated_desired(irradiance, brightness, name=path.name)


_HEADING = re.compile(r"^\s*(E|f0|h\s*\(\s*(\d{1,4})\s*\))\s*=(.*)$")


def read_response_model(path: str | Path) -> ResponseModel:
    """Return the empirical model of response from its published text file.

    The file contains blocks of numbers under the headings ``E =``, ``f0 =`` (the mean),
    ``h(1) =``, ``h(2) =`` ...

    Raises:
        DataError: the file cannot be read or is damaged; names file and line
    """
    path = Path(path)
    blocks: dict[str, list[float]] = {}
    current: list[float] | None = None
    for number, line in enumerate(read_input_text(path, "response model").splitlines(), 1):
        rest = line
        if heading := _HEADING.match(line):
            key = f"h{heading[2]}" if heading[2] else heading[1]
            current = blocks.setdefault(key, [])
            rest = heading[3]
        try:
            values = [float(field) for field in rest.split()]
        except ValueError as error:
            raise DataError(
                f"response model {path}, line {number}: '{rest.strip()[:30]}' is not a row of "
                "numbers"
            ) from error
        if values and current is None:
            raise DataError(
                f"response model {path}, line {number}: numbers come before the first heading"
            )
        if current is not None:
            current.extend(values)
    for key in ("E", "f0"):
        if not blocks.get(key):
            raise DataError(f"response model {path}: the block '{key} =' is missing")
    size = len(blocks["E"])
    names = sorted((k for k in blocks if k.startswith("h")), key=lambda k: int(k[1:]))
    for key in ("f0", *names):
        if len(blocks[key]) != size:
            raise DataError(
                f"response model {path}: block '{key}' has {len(blocks[key])} numbers, "
                f"expected {size}"
            )
    components = np.array([blocks[key] for key in names]).reshape(len(names), size)
    return ResponseModel(np.array(blocks["E"]), np.array(blocks["f0"]), components)
