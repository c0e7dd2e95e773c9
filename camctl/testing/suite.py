"""The base of the conformance suite: what a driver's test module overrides, and measurements."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import ExposureSetting, ResponseOrigin

#: Message of a check that could not compare anything.
UNUSABLE = "no two frames could be compared: choose another scene or middle_s"

# Blocks of samples count as usable if their mean brightness lies between these shares of the white
# level, black removed, and from two levels above black on, and if hardly a sample is clipped at
# either end.  (Samples chosen one by one would have high or low noise.)
_DARKEST, _BRIGHTEST = 0.04, 0.9
_LEAST_LEVEL = 2.0
_MOST_CLIPPED = 0.01
# Samples of a block in each direction, and the most blocks; and how many samples, or which share of
# all, a comparison needs.
_BLOCK, _MOST_BLOCKS = 4, 16
_LEAST_SAMPLES, _LEAST_SHARE = 32, 0.02
# How far quantisation may move the mean of samples of low brightness, levels.
_QUANTISATION = 0.3


@dataclass(frozen=True)
class Comparison:
    """The light of two frames compared, on samples that are usable in both frames.

    Attributes:
        ratio: mean irradiance of the second over mean irradiance of the first
        level: mean brightness of the darker frame, levels
    """

    ratio: float
    level: float


class CameraSuite:
    """What the checks of a camera need; `camctl.testing.CameraConformance` describes it.

    Attributes:
        light_tolerance: largest relative error of measured ratios of light
        exact_tolerance: the same of frames without loss whose response is stated
        longest_s: longest exposure that the checks take, s
        run_length: frames of the long sequence
        range_length: most settings of a check over the whole range of a control
        silence_s: how long a camera that is silent may keep its caller waiting, s
    """

    light_tolerance = 0.04
    exact_tolerance = 0.015
    longest_s = math.inf
    run_length = 300
    range_length = 25
    silence_s = 130.0

    # ---- a driver's test module overrides these

    def open_camera(self) -> Camera:
        """Return an open camera in front of a steady scene."""
        raise NotImplementedError

    def middle_s(self, camera: Camera) -> float:
        """Return a shutter time, s, at which the scene is neither black nor white."""
        time = camera.controls.time_s
        return time.nearest((time.minimum * time.maximum) ** 0.5)

    def open_second(self, camera: Camera) -> Camera:
        """Open the same device once more, while `camera` has it open."""
        pytest.skip("open_second is not overridden: a second opener was not tried")

    def unplug(self, camera: Camera) -> None:
        """Disconnect the device, as if its cable were pulled."""
        pytest.skip("unplug is not overridden: the camera was not disconnected")

    def silence(self, camera: Camera) -> None:
        """Let the device answer nothing any more, and stay connected."""
        pytest.skip("silence is not overridden: the camera was not silenced")

    def in_force(self, camera: Camera) -> ExposureSetting:
        """Return the device's own settings, read in another way than the driver reads them."""
        pytest.skip("in_force is not overridden: the device's own settings were not compared")

    # ---- the checks use these

    @pytest.fixture
    def camera(self) -> Iterator[Camera]:
        """The camera under test, closed afterwards."""
        with self.open_camera() as camera:
            yield camera

    def shoot(self, camera: Camera, settings: Sequence[ExposureSetting]) -> list[Frame]:
        """Return all frames of one call."""
        with closing(camera.shoot(settings)) as frames:
            return list(frames)

    def times(self, camera: Camera, factors: Sequence[float]) -> list[ExposureSetting]:
        """Return settings of the camera near these multiples of `middle_s`."""
        control, gain = camera.controls.time_s, camera.controls.gain.nearest(1.0)
        middle = self.middle_s(camera)
        return [ExposureSetting(control.nearest(middle * factor), gain) for factor in factors]

    def irradiance(self, camera: Camera, frame: Frame) -> NDArray[np.float64]:
        """Return the relative irradiance of each sample of a frame, black removed."""
        levels = camera.controls.levels
        low, high = levels.gaps
        middle = (np.asarray(low) + np.asarray(high)) / 2
        found: NDArray[np.float64] = middle[self.brightness(camera, frame)]
        return found

    def brightness(self, camera: Camera, frame: Frame) -> NDArray[np.intp]:
        """Return the level of each sample of a frame, black removed."""
        pixels = frame.pixels.astype(np.intp) - frame.black
        return np.clip(pixels, 0, camera.controls.levels.M)

    def light(self, camera: Camera, frame: Frame) -> float:
        """Return the mean irradiance of the samples of a frame, relative, black removed."""
        return float(self.irradiance(camera, frame).mean())

    def usable(self, camera: Camera, frame: Frame) -> NDArray[np.bool_]:
        """Return which samples of a frame are in parts that are neither too dark nor near white."""
        top = camera.controls.levels.M
        brightness = self.brightness(camera, frame)
        usable = np.zeros(brightness.shape, np.bool_)
        layout = camera.controls.layout
        for plane, found in zip(layout.planes(brightness), layout.planes(usable), strict=True):
            mean = block_means(plane)
            clipped = block_means((plane <= 0) | (plane >= top))
            least = max(_DARKEST * top, _LEAST_LEVEL)
            good = (mean >= least) & (mean <= _BRIGHTEST * top) & (clipped <= _MOST_CLIPPED)
            found[:] = good
        return usable

    def compare(self, camera: Camera, first: Frame, second: Frame) -> Comparison | None:
        """Return how the light of two frames compares; None if too few samples are usable."""
        both = self.usable(camera, first) & self.usable(camera, second)
        if both.sum() < max(_LEAST_SAMPLES, _LEAST_SHARE * both.size):
            return None
        light = [float(self.irradiance(camera, frame)[both].mean()) for frame in (first, second)]
        level = min(self.brightness(camera, frame)[both].mean() for frame in (first, second))
        return Comparison(light[1] / light[0], float(level))

    def exact_or_light_tolerance(self, camera: Camera, frame: Frame) -> float:
        """Return the tolerance of ratios at one gain: less where nothing is lost or assumed."""
        controls = camera.controls
        is_exact = (
            controls.response_origin is ResponseOrigin.STATED
            and controls.exposures_exact
            and not is_lossy(camera, frame)
        )
        return self.exact_tolerance if is_exact else self.light_tolerance

    def check_light(
        self, camera: Camera, known: Frame, other: Frame, tolerance: float | None = None
    ) -> bool:
        """Check that the light of two frames differs as their exposures do, by `light_tolerance`.

        Returns False if too few samples are usable in both.
        """
        expected = other.applied.exposure / known.applied.exposure
        found = self.compare(camera, known, other)
        if found is None:
            return False
        tolerance = self.light_tolerance if tolerance is None else tolerance
        tolerance += _QUANTISATION / found.level
        assert abs(found.ratio / expected - 1) <= tolerance, (
            f"from {known.applied} to {other.applied} the light changes by {found.ratio:.4g}, "
            f"not by {expected:.4g}"
        )
        return True


def is_lossy(camera: Camera, frame: Frame) -> bool:
    """Return whether the samples of a frame were compressed with loss."""
    suffix = "" if frame.original is None else frame.original.suffix
    return camera.controls.pixel_format == "mjpg" or suffix in (".jpg", ".jpeg")


def block_means(plane: NDArray[Any]) -> NDArray[np.float64]:
    """Return for each sample of a plane the mean of its block."""
    means = plane.astype(np.float64)
    for axis, size in enumerate(plane.shape):
        count = min(max(size // _BLOCK, 1), _MOST_BLOCKS)
        starts = np.linspace(0, size, count, endpoint=False).astype(int)
        sizes = np.diff([*starts, size])
        sums = np.add.reduceat(means, starts, axis=axis)
        shape = (-1, 1) if axis == 0 else (1, -1)
        means = np.repeat(sums / sizes.reshape(shape), sizes, axis=axis)
    return means
