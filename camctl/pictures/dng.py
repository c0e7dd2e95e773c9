"""picture.dng: the light of a mosaic as one raw file, for raw developers (DNG 1.4, float16).

The samples are irradiance, 1 where every frame is saturated, before interpolation and without a
white balance; the file says the camera's matrix and white balance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

from camctl.interface.colour import CameraColour
from camctl.interface.controls import Layout
from camctl.pictures.details import PictureDetails
from camctl.pictures.metadata import tiff_tags
from camctl.pictures.mosaic import colour_of
from camctl.pictures.render import Rendering

#: Photometric interpretation of a mosaic (TIFF/EP).
_CFA = 32803
#: The illuminant of the matrix: D65 (EXIF, LightSource).
_D65 = 21
#: Fractions have this denominator.
_UNIT = 10_000
_VERSION = (1, 4, 0, 0)  # the first one with floating point numbers


def has_raw(rendering: Rendering) -> bool:
    """Return whether the frames are a mosaic of a camera whose matrix is known."""
    colour = rendering.colour
    return rendering.layout.is_mosaic and colour is not None and bool(colour.xyz_to_camera)


def dng_tags(
    details: PictureDetails, colour: CameraColour, full: float, layout: Layout
) -> dict[str, Any]:
    """Return the arguments of tifffile for a mosaic in float16.

    Args:
        details: camera, date and exposures
        colour: with the matrix from XYZ to R, G and B
        full: irradiance in the pictures that becomes 1
        layout: of the mosaic
    """
    tags = tiff_tags(details)
    neutral = [1 / factor for factor in colour.white_balance]
    matrix = [value for row in colour.xyz_to_camera for value in row]
    pattern = tuple(colour_of(layout, row, column) for row in (0, 1) for column in (0, 1))
    # As bright as the photograph in the middle.
    middle = details.frames[len(details.frames) // 2].highest
    baseline = math.log2(max(full / middle, 1.0))
    more = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, pattern, True),  # CFAPattern
        (50706, "B", 4, _VERSION, True),  # DNGVersion
        (50707, "B", 4, _VERSION, True),  # DNGBackwardVersion
        (
            50708,
            "s",
            0,
            details.camera.name.encode("ascii", "replace").decode(),
            True,
        ),  # UniqueCameraModel
        (50710, "B", 3, (0, 1, 2), True),  # CFAPlaneColor
        (50711, "H", 1, 1, True),  # CFALayout: rectangular
        (50714, "H", 1, 0, True),  # BlackLevel
        (50717, "H", 1, 1, True),  # WhiteLevel
        (50721, "2i", 9, _fractions(matrix), True),  # ColorMatrix1
        (50728, "2I", 3, _fractions(neutral), True),  # AsShotNeutral
        (50730, "2i", 1, _fractions([baseline]), True),  # BaselineExposure
        (50778, "H", 1, _D65, True),  # CalibrationIlluminant1
    ]
    return tags | {"photometric": _CFA, "extratags": [*tags["extratags"], *more]}


def _fractions(values: Iterable[float]) -> list[int]:
    found = [Fraction(round(value * _UNIT), _UNIT) for value in values]
    return [number for each in found for number in (each.numerator, each.denominator)]
