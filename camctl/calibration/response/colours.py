"""Whether a curve for each colour explains an exposure series better than one for all colours.

Estimated colour by colour, curves of one camera differ where frames say little: in the dark parts,
and where JPEG files keep less of the colours.  Grey would then change its colour with brightness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from camctl.calibration.response.series import Series
from camctl.model.response.camera import FloatArray

AS_WELL = 1.2
"""A simpler response explains frames as well up to this multiple of the other's disagreement."""


def disagreement(
    series: Series, lights: Sequence[FloatArray], exposures: Sequence[Sequence[float]]
) -> float:
    """Return the median relative difference of the light of patches from frame to frame.

    Patches of neighbouring exposures are compared, colour by colour, that are well exposed in both;
    infinite where there are none.

    Args:
        series: patches of the frames
        lights: of each channel, (M + 1,) light of each brightness above black, in any unit
        exposures: of the frames by each channel, in any unit
    """
    errors = [np.zeros(0)]
    for name, light, exposure in zip(series.channels, lights, exposures, strict=True):
        for pair in series.neighbours(name):
            found = light[pair.levels].mean(axis=2)
            ratio = exposure[pair.short] / exposure[pair.long]
            errors.append(np.abs(np.log(found[1] / found[0] * ratio)))
    together = np.concatenate(errors)
    return float(np.median(together)) if together.size else math.inf


def green_explains_all(
    series: Series, lights: Sequence[FloatArray], exposures: Sequence[Sequence[float]]
) -> bool:
    """Return whether the curve of green explains the frames as well as one of each colour.

    Green is estimated best: most of a brightness is green, and JPEG files keep green best.

    Args:
        series: patches of the frames
        lights: of R, G and B, as for `disagreement`
        exposures: of R, G and B, as for `disagreement`
    """
    found = disagreement(series, (lights[1],) * 3, (exposures[1],) * 3)
    return found < math.inf and found <= AS_WELL * disagreement(series, lights, exposures)
