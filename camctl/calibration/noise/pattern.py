"""How much the sensitivity of the pixels differs (PRNU), from two views of any scene.

In one view the pattern of the pixels cannot be distinguished from the scene: both are in proportion
to the light.  Where the camera has been turned a little, the pattern is where it was and the scene
is not, so that what the deviations of both views from smooth shades have in common is the pattern
alone.
The patterns of offsets and of dark current (DSNU, DCNU) stay, too: where they are known, they are
subtracted.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.intervals import root_of_ratio
from camctl.calibration.light import probes
from camctl.calibration.limits import DIM, LEAST_PATCHES
from camctl.errors import CaptureError, DataError
from camctl.evidence.patches import sample_patches
from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.model.response.camera import FloatArray
from camctl.model.sensor import SensorModel
from camctl.profiles.noise import DarkRecord, Figure, NoiseRecord

#: Frames of a view with each time, and the number of times, a factor of 2 apart.
_REPEATS, _TIMES = 4, 3
#: Smooth shades of a patch: terms of a polynomial along rows and columns, up to this degree.
_DEGREE = 2
HOT = 8.0
"""A pixel is hot if it deviates by so many standard deviations of noise and pattern in both of two
pictures: of 1e8 normal pixels none does."""

#: Relative difference that half of the patches exceed where a camera was turned.
_TURNED = 0.005


@dataclass(eq=False)
class View:
    """Frames of one view, reduced to the deviations of samples from smooth shades.

    Attributes:
        controls: of the camera, with its response
    """

    controls: ExposureControls
    _mean: FloatArray | float = field(default=0.0, repr=False)
    _sum: FloatArray | None = field(default=None, repr=False)
    _weight: FloatArray | None = field(default=None, repr=False)
    _frames: FloatArray | float = field(default=0.0, repr=False)
    _time_s: FloatArray | float = field(default=0.0, repr=False)

    def add(self, pixels: NDArray[Any], time_s: float) -> None:
        """Add a frame of this shutter time; its pixels are not kept."""
        controls = self.controls
        scales = [SensorModel(each, controls.black) for each in controls.plane_levels]
        planes = controls.layout.planes(pixels)
        patches = np.split(sample_patches(planes, controls.white), len(planes))
        light = np.concatenate(
            [scale.light[part] / scale.full for scale, part in zip(scales, patches, strict=True)]
        )
        mean = light.mean(axis=1)
        highest = scales[0].highest(None)
        is_used = (mean > DIM) & (np.concatenate(patches).max(axis=1) <= highest)
        # Photon noise, relative to the light, has a variance in inverse proportion to it.
        weight = np.where(is_used, mean, 0.0)
        relative = light / np.maximum(mean, DIM)[:, None] * weight[:, None]
        self._sum = relative if self._sum is None else self._sum + relative
        self._weight = weight if self._weight is None else self._weight + weight
        self._mean = self._mean + mean
        self._frames = self._frames + is_used
        self._time_s = self._time_s + is_used * time_s

    @property
    def share_used(self) -> float:
        """Share of the patches that are well exposed in a frame."""
        assert self._weight is not None
        return float(np.mean(self._weight > 0))

    @property
    def mean(self) -> FloatArray:
        """Light of the patches, (patches,), in any unit."""
        return np.asarray(self._mean)

    def dark_pattern(self, dark: DarkRecord, full_e: float) -> tuple[FloatArray, FloatArray]:
        """Return the deviations of offsets and of dark current over the light, (patches,) each.

        Args:
            dark: of the camera
            full_e: electrons of full scale in the frames
        """
        light_e = np.maximum(np.asarray(self._weight), DIM) * full_e
        rate = 0.0 if dark.dcnu_e_s is None else dark.dcnu_e_s.value
        return dark.dsnu_e.value * self._frames / light_e, rate * self._time_s / light_e

    def deviations(self) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return relative deviations from smooth shades, (patches, samples), and which count."""
        assert self._sum is not None
        assert self._weight is not None
        relative = self._sum / np.maximum(self._weight, DIM)[:, None]
        smooth = _smooth_shades(math.isqrt(relative.shape[1]))
        return relative - (relative @ smooth) @ smooth.T, self._weight > 0


def sensitivity_pattern(first: View, second: View, noise: NoiseRecord | None = None) -> Figure:
    """Return the PRNU: the standard deviation of the sensitivity of the pixels, relative.

    Args:
        first: view of a scene
        second: view of the same camera after it was turned
        noise: of the camera; the dark signal, if it has one, is no part of the result.  The
            interval does not contain the error of the dark signal, which is far smaller

    Raises:
        DataError: the views are too dark, or the camera was not turned
    """
    (a, in_a), (b, in_b) = first.deviations(), second.deviations()
    both = in_a & in_b
    if np.count_nonzero(both) < LEAST_PATCHES:
        raise DataError(
            f"only {np.count_nonzero(both)} of {both.size} parts of the picture are well exposed "
            "in both views",
            hint="uncover the lens, and point the camera at a scene with more bright parts",
        )
    change = np.log(first.mean[both] / second.mean[both])
    if np.median(np.abs(change - np.median(change))) < _TURNED:
        raise DataError(
            "both views show the same",
            hint="turn the camera by a few degrees between the views, before a scene with many "
            "shades; or measure before an evenly lit surface",
            remedies={"calibrate_flat": None},
        )
    side = math.isqrt(a.shape[1])
    # One half of the samples, as the fields of a chessboard, says how much the other half counts:
    # with weights of their own, samples of large deviations would count too little.
    fields = np.indices((side, side)).sum(axis=0).ravel() % 2 == 0
    freedom = 1 - _smooth_shades(side).shape[1] / a.shape[1]
    sums = np.zeros((a.shape[0], 2))
    usual = _usual(a, b)
    dark = _dark_covariance(first, second, noise)
    for half, other in ((fields, ~fields), (~fields, fields)):
        weight = both / np.prod(
            [np.square(each[:, other]).mean(axis=1) + 1e-12 for each in (a, b)], axis=0
        )
        products = np.where(usual, a * b, 0)[:, half].sum(axis=1)
        count = np.maximum(usual[:, half].sum(axis=1), 1)
        sums[:, 0] += weight * (products / count / freedom - dark)
        sums[:, 1] += weight
    return root_of_ratio(np.split(sums, len(first.controls.plane_levels)))


def _dark_covariance(first: View, second: View, noise: NoiseRecord | None) -> FloatArray | float:
    """Return what offsets and dark current add to the product of deviations, (patches,)."""
    if noise is None or noise.dark is None:
        return 0.0
    at = noise.reference
    full_e = noise.full_well_e.value
    full_e *= at.conversion_e_per_dn.value / noise.gains[0].conversion_e_per_dn.value
    offsets, rates = zip(
        *(view.dark_pattern(noise.dark, full_e) for view in (first, second)), strict=True
    )
    return np.asarray(np.prod(offsets, axis=0) + np.prod(rates, axis=0))


def _usual(a: FloatArray, b: FloatArray) -> NDArray[np.bool_]:
    """Return which samples, (patches, samples), are no hot pixels: these are so in both views."""
    sizes = [np.median(np.abs(each), axis=1, keepdims=True) for each in (a, b)]
    return np.asarray(np.abs(a * b) <= HOT**2 * sizes[0] * sizes[1])


def view_settings(camera: Camera, longest_s: float) -> list[ExposureSetting]:
    """Return settings that expose as much of the picture well as one time can, and its neighbours.

    Raises:
        CaptureError: the scene is too dark or too bright
        CameraError: as `Camera.shoot` raises
    """
    controls = camera.controls
    gain = controls.gain.nearest(1.0)
    times, shares = [], []
    for frame in probes(camera, longest_s, step=2.0):
        view = View(controls)
        view.add(frame.pixels, frame.applied.time_s)
        times.append(frame.requested.time_s)
        shares.append(view.share_used)
    best = int(np.argmax(shares))
    if not shares[best]:
        raise CaptureError(
            "no shutter time exposes a part of the picture well",
            hint="point the camera at a scene with bright parts, or change the light",
        )
    first = max(0, min(best - 1, len(times) - _TIMES))
    return [ExposureSetting(time_s, gain) for time_s in times[first : first + _TIMES]]


def shoot_view(camera: Camera, settings: Sequence[ExposureSetting]) -> View:
    """Shoot frames of one view.

    Raises:
        CameraError: as `Camera.shoot` raises
    """
    view = View(camera.controls)
    for frame in camera.shoot([each for each in settings for _ in range(_REPEATS)]):
        view.add(frame.pixels, frame.applied.time_s)
    return view


def _smooth_shades(side: int) -> FloatArray:
    """Return an orthonormal basis of smooth shades over a patch."""
    place = np.linspace(-1, 1, side)
    terms = [
        np.outer(place**row, place**column).ravel()
        for row in range(_DEGREE + 1)
        for column in range(_DEGREE + 1 - row)
    ]
    basis, _ = np.linalg.qr(np.stack(terms, axis=1))
    return np.asarray(basis)
