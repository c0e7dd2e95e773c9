"""The light of a capture as people see it on an sRGB display: the picture of preview.png.

Reinhard's photographic operator (Reinhard, Stark, Shirley and Ferwerda, Photographic Tone
Reproduction for Digital Images, 2002) with five changes:

- What surrounds a pixel is found by a guided filter (He, Sun and Tang, Guided Image Filtering,
  2010), which stops at edges, instead of by Gaussian surrounds: no halos.
- It maps the largest of a pixel's channels, and scales the others with it: no channel clips by
  itself, so that hues stay.
- Of developed pictures the other channels are what the curve of the camera makes of them beside the
  largest: colours are those of the camera's own pictures.
- The predicted noise of each pixel is known.  Where it hides the light, the light is the mean of
  the dark pixels around.  Elsewhere it is filtered out where the picture around shows no more
  variation than it (Lee, Digital Image Enhancement and Noise Filtering by Use of Local Statistics,
  1980), see `camctl.pictures.preview_noise`.  Where noise is as large as the light, the colour is
  removed.
- The darkest light that the frames show is raised to a brightness that a display still shows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.interface.orientation import Orientation
from camctl.model.response.camera import linear_to_srgb
from camctl.pictures.colour import LUMINANCE
from camctl.pictures.preview_light import ALL, NO_LIGHT, Floats, Light, channels_of, largest_channel
from camctl.pictures.preview_noise import BORDER, LEAST_VARIANCE, NoiseFilter, moments
from camctl.system.picture_operations import box_means
from camctl.system.threads import in_threads

#: Brightness of the mean light (of its logarithms) in the preview, 1 = white, where the scene is
#: neither mostly dark nor mostly bright; up to a factor of 2 less or more where it is.
_KEY = 0.22
#: Share of the light, in per cent, that is no darker than the darkest, and no brighter than white.
_DARKEST, _WHITE = 1.0, 99.5
#: The darkest light has this brightness at least, 1 = white, or 4 of 255: what is below the second
#: brightness, or 25 of 255, is lifted for it, the more the darker it is.
_LEAST_SHOWN, LIFTED = 0.0012, 0.01
#: Radius of the surround, as a share of the longer side.
_SURROUND = 1 / 40
#: Variance of log2 of the light up to which the surround is smooth: half a stop, squared.
_EDGE = 0.25
#: Radii of the windows over which light that noise hides is averaged, pixels.
_DARK_WINDOWS = (2, 6, 18)
#: Noise as a share of the light from which a pixel counts in averages, from which it is replaced
#: by the average, and from which it is so entirely.
_HIDDEN = 0.1, 0.45, 0.9
#: Samples beside those without light count as noisier by up to this factor, plus 1.
_UNLIT_DOUBT = 4.0
#: Where no frame shows light the picture has this share of the brightness of the least light.
_UNLIT = 0.15
#: Brightness is set by samples whose noise is less than this share of the light, of at most so
#: many rows and columns.
_READABLE, _MOST_READ = 0.5, 1024
#: Rows of a band: what is made of them is small beside the picture.
_ROWS = 64
#: Pixels of a band out of which noise is filtered, about: those around them are, too.
_CLEANED = 1 << 19


@dataclass(frozen=True, eq=False)
class Renditions:
    """A picture for displays of usual range, and for those of a larger one.

    Attributes:
        codes: sRGB, uint8, (rows, columns) or (rows, columns, 3)
        light: linear, in the scale of the codes' darker half, 1 = their white; float32, (rows,
            columns, 1 or 3)
    """

    codes: NDArray[np.uint8]
    light: NDArray[np.float32]

    def upright(self, orientation: Orientation) -> Renditions:
        """Return them upright, where they lie like this."""
        return Renditions(
            np.ascontiguousarray(orientation.upright(self.codes)),
            np.ascontiguousarray(orientation.upright(self.light)),
        )


def tone_map(light: Light) -> NDArray[np.uint8]:
    """Return the preview in sRGB, (rows, columns) or (rows, columns, 3)."""
    return renditions(light).codes


def renditions(light: Light) -> Renditions:
    """Return the preview, and the light that it shows, without noise."""
    largest, colours, pixel_noise, unlit = _cleaned(light)
    exposure, white, power = _exposure(largest, colours, pixel_noise, light)
    surround = _surround(largest)
    around = box_means(pixel_noise, 2) if colours.shape[2] > 1 else pixel_noise
    darkest = np.float32(_UNLIT if (light.unlit < ALL).any() else 0.0)
    codes: NDArray[np.uint8] = np.empty(colours.shape, np.uint8)
    linear = np.empty(colours.shape, np.float32)

    def encode(rows: slice) -> None:
        # The operator, x (1 + S / white^2) / (1 + S) for light x in the surround S.
        shown, near = np.exp2(largest[rows] + exposure), np.exp2(surround[rows] + exposure)
        dimmed = 1 + (darkest - 1) * np.square(unlit[rows])
        bright = shown * dimmed
        shown *= (1 + near / white**2) / (1 + near)
        np.minimum(shown, 1, out=shown)
        if power < 1:
            lifted = np.float32(LIFTED)
            shown = np.where(shown < lifted, lifted * (shown / lifted) ** power, shown)
        shown *= dimmed
        # A pixel of which one channel is saturated keeps the colour of its neighbours that are not.
        full = light.white[rows] / np.float32(ALL)
        shown += full * (1 - shown)
        colour = colours[rows]
        if colour.shape[2] > 1:
            # Where a channel shows no light, the colour is not known.
            known = (1 - full) * (1 - np.sqrt(unlit[rows])) / (1 + np.square(around[rows]))
            colour = 1 + (colour - 1) * known[..., np.newaxis]
        if light.development is None:
            codes[rows] = srgb_codes(colour * shown[..., np.newaxis])
        else:
            codes[rows] = light.development.codes(colour, shown)
        np.multiply(colour, bright[..., np.newaxis], out=linear[rows])

    _in_bands(encode, len(codes), _ROWS)
    return Renditions(codes[..., 0] if codes.shape[-1] == 1 else codes, linear)


def srgb_codes(light: NDArray[Any]) -> NDArray[np.uint8]:
    """Return linear light, 0 to 1, in the encoding of sRGB (IEC 61966-2-1), 0 to 255."""
    encoded = linear_to_srgb(np.clip(light, 0, 1))
    return np.asarray(np.rint(encoded * 255).astype(np.uint8))


def _exposure(
    largest: Floats, colours: Floats, noise: Floats, light: Light
) -> tuple[np.float32, np.float32, np.float32]:
    """Return log2 of the factor before the operator, its white, and the power of what is lifted.

    Reinhard, Parameter Estimation for Photographic Tone Reproduction, 2002: a scene of mostly dark
    light stays dark.
    """
    weights = LUMINANCE if colours.shape[2] == 3 else np.ones(1, np.float32)
    some = (slice(None, None, -(-max(noise.shape) // _MOST_READ)),) * 2
    largest, colours = largest[some], colours[some]
    readable = (noise[some] < _READABLE) & (light.unlit[some] < ALL)
    if not readable.any():
        readable = np.ones_like(readable)
    return exposure_of((largest + np.log2(colours @ weights))[readable], largest[readable])


def exposure_of(logs: Floats, largest: Floats) -> tuple[np.float32, np.float32, np.float32]:
    """Return log2 of the factor before the operator, its white, and the power of what is lifted.

    Args:
        logs: log2 of the light of some pixels
        largest: of the largest of their channels
    """
    low, high = np.percentile(logs, [_DARKEST, _WHITE]).tolist()
    mean = float(logs.mean())
    span = max(high - low, 1.0)
    key = _KEY * 4.0 ** np.clip((2 * mean - low - high) / span, -0.5, 0.5)
    exposure = np.float32(np.log2(key) - mean)
    brightest = float(np.percentile(largest, _WHITE))
    white = max(1.0, 2.0 ** (brightest + float(exposure)))
    # The operator leaves dark light as it is.
    darkest = min(2.0 ** (low + float(exposure)), _LEAST_SHOWN)
    power = math.log(LIFTED / _LEAST_SHOWN) / math.log(LIFTED / darkest)
    return exposure, np.float32(white), np.float32(power)


def _cleaned(light: Light) -> tuple[Floats, Floats, Floats, Floats]:
    """Return the light without its noise, band by band.

    Returns:
        log2 of the largest channel; the channels relative to it; noise of a pixel, relative to its
        light; share without light
    """
    border = sum(_DARK_WINDOWS) + BORDER
    noise_filter = NoiseFilter.of(light)
    shape = light.unlit.shape
    largest, noise, unlit = (np.empty(shape, np.float32) for _ in range(3))
    colours = np.empty_like(light.irradiance)

    def clean(rows: slice) -> None:
        first = max(0, rows.start - border)
        around, inner = slice(first, rows.stop + border), slice(rows.start - first, None)
        light_around = light.irradiance[around]
        places = noise_filter.places(light_around)
        own = noise_filter.own_noise(light.noise[around], places)
        logs, errors, dark = _averaged_in_the_dark(light_around, own, light.unlit[around])
        np.log2(np.maximum(logs, NO_LIGHT, out=logs), out=logs)
        logs = noise_filter.without_noise(logs, errors, places)
        count = len(largest[rows])
        logs, errors, dark = (each[inner][:count] for each in (logs, errors, dark))
        largest[rows] = brightest = largest_channel(logs)
        np.exp2(logs - brightest[..., np.newaxis], out=colours[rows])
        noise[rows] = sum(channels_of(errors)) / np.float32(errors.shape[2])
        unlit[rows] = dark

    bands = -(-largest.size // _CLEANED)
    _in_bands(clean, len(largest), -(-len(largest) // bands))
    return largest, colours, noise, unlit


def _averaged_in_the_dark(
    irradiance: Floats, noise: Floats, without: NDArray[np.uint8]
) -> tuple[Floats, Floats, Floats]:
    """Return irradiance, noise, and the share without light; each averaged where noise is large.

    Only such pixels are averaged, so that no bright light comes into the dark beside it, and only
    where half of those around are: others are few far from each other, of any light.  The noise is
    changed in place.
    """
    irradiance = irradiance.copy()
    unlit = np.asarray(without / np.float32(ALL), np.float32)
    least, low, high = map(np.float32, _HIDDEN)
    has_unlit = bool(without.any())
    dark: Floats = np.ones((), np.float32)
    for radius in _DARK_WINDOWS:
        # Beside samples without light the noise of the others decides which of them have some.
        doubt = largest_channel(noise)
        if has_unlit:
            factor = box_means(unlit, radius)
            factor *= np.float32(_UNLIT_DOUBT)
            factor += 1
            doubt = np.multiply(doubt, factor, out=factor)
        if doubt.max() <= low:
            continue
        hidden, counts = _share(doubt, low, high), _share(doubt, least, low)
        hidden *= dark
        area = box_means(counts, radius)
        dark = _share(area, np.float32(0), np.float32(0.5))
        np.maximum(area, LEAST_VARIANCE, out=area)
        for place in range(noise.shape[2]):
            values, errors = irradiance[..., place], noise[..., place]
            # Sums over windows are running ones, and may round to just below 0.
            error = box_means(np.square(values * errors) * counts, radius)
            np.maximum(error, 0, out=error)
            error /= area
            average = box_means(values * counts, radius)
            average /= area
            np.maximum(average, NO_LIGHT, out=average)
            error /= area * (2 * radius + 1) ** 2  # the samples
            np.sqrt(error, out=error)
            error /= average
            values += np.multiply(np.subtract(average, values, out=average), hidden, out=average)
            np.minimum(error, errors, out=error)
            error -= errors
            error *= hidden
            errors += error
        if has_unlit:
            unlit += (box_means(unlit * counts, radius) / area - unlit) * hidden
    return irradiance, noise, np.clip(unlit, 0, 1)


def _share(values: Floats, low: np.float32, high: np.float32) -> Floats:
    """Return how far values are on the way from `low` to `high`, 0 to 1."""
    found = values - low
    found /= high - low
    return np.clip(found, 0, 1, out=found)


def _in_bands(work: Callable[[slice], None], rows: int, step: int) -> None:
    """Call `work` with each band of so many rows; two threads share them."""
    for _ in in_threads(work, (slice(top, top + step) for top in range(0, rows, step))):
        pass


def _surround(logs: Floats) -> Floats:
    """Return the guided filter of log2 of the light, with itself as the guide."""
    radius = max(2, round(max(logs.shape) * _SURROUND))
    offset, slope = moments(logs, radius)
    slope /= np.maximum(slope, 0, out=slope) + np.float32(_EDGE)
    offset -= slope * offset
    surround = box_means(slope, radius)
    del slope
    surround *= logs
    surround += box_means(offset, radius)
    return surround
