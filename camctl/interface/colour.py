"""How R, G and B of a camera's frames become linear light of the primaries of ITU-R BT.709."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

BT709_PRIMARIES = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
"""Chromaticities x and y of red, green and blue (ITU-R BT.709, 1.3), which are those of sRGB."""
D65 = (0.3127, 0.3290)
"""The same of its white."""

Matrix = NDArray[np.float64]
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class CameraColour:
    """Colours of the frames of a camera.

    Light in linear BT.709 is `matrix` @ (`white_balance` x (R, G, B)).

    Attributes:
        matrix: the rows of it; each adds up to 1, so that grey stays grey
        white_balance: factors of R, G and B in neutral light, that of green is 1
        xyz_to_camera: rows of the matrix from CIE XYZ to R, G and B in the light of D65, as the tag
            ColorMatrix of DNG has it; none: the frames are no raw ones
        encoding: linear light of evenly spaced codes from 0 to 1 of developed frames; none: as sRGB
    """

    matrix: tuple[Triple, ...]
    white_balance: Triple = (1.0, 1.0, 1.0)
    xyz_to_camera: tuple[Triple, ...] = ()
    encoding: tuple[float, ...] = ()

    @classmethod
    def of_raw(cls, xyz_to_camera: Matrix, white_balance: Matrix) -> CameraColour:
        """Return the colours of raw frames.

        The rows of the matrix from BT.709 to the camera are scaled so that white becomes equal
        R, G and B, and then it is inverted, as dcraw and LibRaw do.

        Args:
            xyz_to_camera: (3, 3), from CIE XYZ to the camera's R, G, B
            white_balance: (3,) factors of R, G and B, in any scale

        Raises:
            ValueError: they are no colours of a camera
        """
        to_camera = np.asarray(xyz_to_camera, np.float64) @ rgb_to_xyz(BT709_PRIMARIES, D65)
        factors = np.asarray(white_balance, np.float64)
        sums = to_camera.sum(axis=1, keepdims=True)
        if not (np.isfinite(to_camera).all() and (sums > 0).all() and (factors > 0).all()):
            raise ValueError("invalid matrix or white balance")
        try:
            matrix = np.linalg.inv(to_camera / sums)
        except np.linalg.LinAlgError as error:
            raise ValueError("the matrix has no inverse") from error
        return cls(
            _triples(matrix), _triple(factors / factors[1]), _triples(np.asarray(xyz_to_camera))
        )

    @classmethod
    def of_primaries(cls, rgb_to_xyz_d65: Matrix, encoding: tuple[float, ...] = ()) -> CameraColour:
        """Return the colours of developed frames.

        Args:
            rgb_to_xyz_d65: (3, 3) from their linear R, G, B to CIE XYZ, with D65 as their white
            encoding: of their codes
        """
        matrix = np.linalg.inv(rgb_to_xyz(BT709_PRIMARIES, D65)) @ rgb_to_xyz_d65
        return cls(_triples(matrix / matrix.sum(axis=1, keepdims=True)), encoding=encoding)

    @property
    def is_identity(self) -> bool:
        """Whether the frames have the primaries of BT.709 already, to 0.5 %."""
        matrix = np.array(self.matrix) * np.array(self.white_balance)
        return bool(np.abs(matrix - np.eye(3)).max() < 0.005)

    @property
    def of_samples(self) -> Matrix:
        """The matrix with the white balance: (3, 3), of R, G and B as they are in the frames."""
        return np.asarray(np.array(self.matrix) * np.array(self.white_balance))


BT709 = CameraColour(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
"""Colours of frames with the primaries of BT.709, such as those of a JPEG in sRGB."""


def rgb_to_xyz(primaries: tuple[tuple[float, float], ...], white: tuple[float, float]) -> Matrix:
    """Return the matrix from linear R, G, B to CIE XYZ, white with Y = 1 (SMPTE RP 177).

    >>> rgb_to_xyz(BT709_PRIMARIES, D65)[1].round(4).tolist()
    [0.2126, 0.7152, 0.0722]
    """
    columns = np.array([(x / y, 1.0, (1 - x - y) / y) for x, y in primaries]).T
    x, y = white
    return np.asarray(columns * np.linalg.solve(columns, (x / y, 1.0, (1 - x - y) / y)))


def _triple(values: Matrix) -> Triple:
    one, two, three = np.asarray(values, np.float64).tolist()
    return one, two, three


def _triples(matrix: Matrix) -> tuple[Triple, ...]:
    return tuple(map(_triple, matrix))
