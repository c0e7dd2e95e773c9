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
from camctl.model.sensor import RESPONSE_ERROR

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
# Blocks in each direction by which the error of a ratio is measured: what a file's compression adds
# is alike in the 8 x 8 samples of a block of it.
_PARTS = 8

#: How far quantisation may move the mean of samples of low brightness, levels.
QUANTISATION = 0.3
#: How many standard errors a mean may be wrong: a normal distribution has 6e-7 beyond.
STANDARD_ERRORS = 5.0


@dataclass(frozen=True)
class Comparison:
    """The light of two frames compared, on samples that are usable in both frames.

    Attributes:
        ratio: mean irradiance of the second over mean irradiance of the first
        level: mean brightness of the darker frame, levels
        error: standard error of the ratio, relative, by what parts of the frames scatter
    """

    ratio: float
    level: float
    error: float


class CameraSuite:
    """What the checks of a camera need; `camctl.testing.CameraConformance` describes it.

    Attributes:
        light_tolerance: largest relative error of exposures that are not exact, and of light whose
            response is only assumed or measured
        exact_tolerance: the same of cameras that state exact exposures and their response; noise,
            rounding and compression are measured, and allowed beside it
        longest_s: longest exposure that the checks take, s
        run_length: frames of the long sequence
        range_length: most settings of a check over the whole range of a control
        silence_s: how long a camera that is silent may keep its caller waiting, s
    """

    light_tolerance = 0.04
    exact_tolerance = 2 * RESPONSE_ERROR
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

    def is_lossy(self, camera: Camera, frame: Frame) -> bool:
        """Return whether the samples of a frame were compressed with loss.

        Files and formats of the stream say it; a driver of network streams does not know.
        """
        suffix = "" if frame.original is None else frame.original.suffix
        return camera.controls.pixel_format == "mjpg" or suffix in (".jpg", ".jpeg")

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
        light = [self.irradiance(camera, frame) for frame in (first, second)]
        ratio = float(light[1][both].mean() / light[0][both].mean())
        level = min(self.brightness(camera, frame)[both].mean() for frame in (first, second))
        return Comparison(
            ratio,
            float(level),
            _ratio_error(light[1] - ratio * light[0], both) / float(light[1][both].mean()),
        )

    def response_tolerance(self, camera: Camera) -> float:
        """Return the largest relative error of light by the stated exposures and response."""
        controls = camera.controls
        is_exact = controls.response_origin is ResponseOrigin.STATED and controls.exposures_exact
        return self.exact_tolerance if is_exact else self.light_tolerance

    def check_light(self, camera: Camera, known: Frame, other: Frame) -> bool:
        """Check that the light of two frames differs as their exposures do.

        Returns False if too few samples are usable in both.
        """
        expected = other.applied.exposure / known.applied.exposure
        found = self.compare(camera, known, other)
        if found is None:
            return False
        tolerance = (
            self.response_tolerance(camera)
            + STANDARD_ERRORS * found.error
            + QUANTISATION / found.level
        )
        assert abs(found.ratio / expected - 1) <= tolerance, (
            f"from {known.applied} to {other.applied} the light changes by {found.ratio:.4g}, "
            f"not by {expected:.4g}"
        )
        return True


def _ratio_error(rest: NDArray[np.float64], usable: NDArray[np.bool_]) -> float:
    """Return the standard error of the mean of a difference, by what its parts scatter."""
    rows, columns = (np.arange(size) * min(_PARTS, size) // size for size in rest.shape[:2])
    parts = rows[:, np.newaxis] * _PARTS + columns
    number = np.broadcast_to(parts.reshape(*parts.shape, *[1] * (rest.ndim - 2)), rest.shape)[
        usable
    ]
    count = np.bincount(number).astype(np.float64)
    total = np.bincount(number, rest[usable])
    used = count > 0
    if used.sum() < 2:
        return 0.0
    return float(np.sqrt(np.square(total[used]).sum()) / count.sum())


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
