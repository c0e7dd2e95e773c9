"""The colours of a camera, as a calibration has measured them with a chart."""

from __future__ import annotations

from typing import Self

import numpy as np
from pydantic import Field, FiniteFloat, model_validator

from camctl.interface.colour import BT709_PRIMARIES, D65, CameraColour, Triple, rgb_to_xyz
from camctl.profiles.record import Record

_Row = tuple[FiniteFloat, FiniteFloat, FiniteFloat]


class ColourRecord(Record):
    """How R, G and B of a camera become linear BT.709: `matrix` @ (`white_balance` x (R, G, B)).

    Attributes:
        matrix: its rows, each of which adds up to 1
        white_balance: factors of R, G and B in the light of the chart, 1 of green
        mean_difference: of the chart's patches from their reference, CIEDE2000
        largest_difference: the same of the worst patch
        patches: number of patches that were measured
        measured_at: date and time, ISO 8601
    """

    matrix: tuple[_Row, _Row, _Row]
    white_balance: tuple[FiniteFloat, FiniteFloat, FiniteFloat]
    mean_difference: float = Field(ge=0, allow_inf_nan=False)
    largest_difference: float = Field(ge=0, allow_inf_nan=False)
    patches: int = Field(ge=1)
    measured_at: str

    @model_validator(mode="after")
    def _agree(self) -> Self:
        matrix = np.array(self.matrix)
        if not np.allclose(matrix.sum(axis=1), 1, atol=1e-3) or np.linalg.cond(matrix) > 1e6:
            raise ValueError("the matrix is no matrix of colours")
        if min(self.white_balance) <= 0:
            raise ValueError("a white balance is not positive")
        return self

    def camera_colour(self, white_balance: Triple | None = None) -> CameraColour:
        """Return the colours of frames, with another white balance where one is given.

        The light of the chart stands for D65 in the matrix from XYZ.
        """
        to_camera = np.linalg.inv(np.array(self.matrix)) / np.array(self.white_balance)[:, None]
        from_xyz = to_camera @ np.linalg.inv(rgb_to_xyz(BT709_PRIMARIES, D65))
        one, two, three = (tuple(row) for row in from_xyz.tolist())
        return CameraColour(self.matrix, white_balance or self.white_balance, (one, two, three))
