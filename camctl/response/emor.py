"""The empirical model of response: a mean curve plus components, 1,024 samples each.

Grossberg and Nayar, "What is the Space of Camera Response Functions?", CVPR 2003.  The model's file
holds blocks of numbers under headings: ``E =``, ``f0 =`` (the mean), ``h(1) =``, ``h(2) =`` ...
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from camctl.errors import DataError, UsageError
from camctl.response.camera import CameraResponse, FloatArray
from camctl.response.measured import measured_response

_HEADING = re.compile(r"^\s*(E|f0|h\s*\(\s*(\d+)\s*\))\s*=(.*)$")


@dataclass(frozen=True, eq=False)
class ResponseModel:
    """A space of responses.

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
        levels: int | None = None,
        name: str = "EMoR",
    ) -> CameraResponse:
        """Return the camera whose curve is the mean plus the weighted first components.

        A sum of components need not rise everywhere: what is repaired stands in the notes.
        """
        if len(weights) > len(self.components):
            raise UsageError(
                f"{len(weights)} weights", hint=f"the model has {len(self.components)} components"
            )
        curve = self.mean + np.array(weights, dtype=float) @ self.components[: len(weights)]
        return measured_response(
            self.irradiance, curve, bits=bits, phase=phase, levels=levels, name=name
        )


def read_response_model(path: str | Path) -> ResponseModel:
    """Read the model's file; raises `DataError` with the line that is wrong."""
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"response model {path}: {error}") from error
    blocks: dict[str, list[float]] = {}
    current: list[float] | None = None
    for number, line in enumerate(text.splitlines(), 1):
        rest = line
        if heading := _HEADING.match(line):
            key = f"h{heading[2]}" if heading[2] else heading[1]
            current = blocks.setdefault(key, [])
            rest = heading[3]
        try:
            values = [float(word) for word in rest.split()]
        except ValueError as error:
            raise DataError(
                f"response model {path}, line {number}: '{rest.strip()[:30]}' is not numbers"
            ) from error
        if values and current is None:
            raise DataError(f"response model {path}, line {number}: numbers before a heading")
        if current is not None:
            current.extend(values)
    for key in ("E", "f0"):
        if not blocks.get(key):
            raise DataError(f"response model {path}: no block '{key} ='")
    size = len(blocks["E"])
    names = sorted((k for k in blocks if k.startswith("h")), key=lambda k: int(k[1:]))
    for key in ("f0", *names):
        if len(blocks[key]) != size:
            raise DataError(
                f"response model {path}: block '{key}' has {len(blocks[key])} numbers, not {size}"
            )
    components = np.array([blocks[key] for key in names]).reshape(len(names), size)
    return ResponseModel(np.array(blocks["E"]), np.array(blocks["f0"]), components)
