"""How far the colours of previews are from those of the camera's own pictures, in hue and stops.

    camctl merge PHOTOGRAPHS -o FOLDER
    python tests/bench/bench_preview_colours.py FOLDER... [--profile-of PHOTOGRAPH]

Photographs in another colour space than sRGB are shown as programs with colour management show
them: LittleCMS converts them by the ICC profile of one of them.

The preview changes brightness, for the whole picture and place by place, so that no photograph is
as bright as it everywhere.  So 8 x 8 pixels are compared with the two photographs between whose
luminances their own lies: the camera's picture of that luminance is interpolated between them.
The remaining difference is that of colour: the hue in CIELAB, degrees, and the light of R, G and B
at one luminance, stops, of the channel that differs most.

A patch counts where the preview and both photographs expose it well: nothing moved there, and the
photographs have no sample at an end of the scale.  The errors of its means (noise of the samples,
and 0.3 levels that they share, from rounding and JPEG) leave the light of each channel known within
a third of 0.1 stops; for the hue, that within a third of 3 degrees.  `itself` is the same between a
photograph and the ones before and after it, interpolated at its luminance: what the camera's own
pictures differ by.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageCms

from camctl import read_report
from camctl.model.response.camera import linear_to_srgb, srgb_to_linear
from camctl.pictures.colour import LUMINANCE
from camctl.pictures.render import CONTRADICTING

SIDE, STOPS, HUE = 8, 0.1, 3.0
SHARED_LEVELS = 0.3
#: Shows noise, of the standard deviation that a sample has, and no light that changes evenly
#: (Immerkaer, Fast Noise Variance Estimation, 1996).
NOISE = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6

Floats = NDArray[np.float64]


def blocks(picture: NDArray[Any]) -> NDArray[Any]:
    """Return (patches, samples, channels) of (rows, columns, channels)."""
    rows, columns = picture.shape[0] // SIDE, picture.shape[1] // SIDE
    cut = picture[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE, -1)
    return cut.swapaxes(1, 2).reshape(rows * columns, SIDE * SIDE, -1)


def in_srgb(picture: NDArray[np.uint8], profile: bytes) -> NDArray[np.uint8]:
    """Return codes of sRGB of those of an ICC profile."""
    found = ImageCms.profileToProfile(
        Image.fromarray(picture),
        ImageCms.ImageCmsProfile(BytesIO(profile)),
        ImageCms.createProfile("sRGB"),
        renderingIntent=ImageCms.Intent.RELATIVE_COLORIMETRIC,
    )
    return np.asarray(found)


def lab(codes: Floats) -> Floats:
    """Return L*, a*, b* of sRGB codes, (..., 3)."""
    flat = np.asarray(codes.reshape(1, -1, 3) / 255, np.float32)
    return np.asarray(cv2.cvtColor(flat, cv2.COLOR_RGB2LAB), float).reshape(codes.shape)


@dataclass(frozen=True, eq=False)
class Patches:
    """Means of the patches of a picture, codes of sRGB, (patches, 3).

    Attributes:
        codes: the means
        errors: their standard deviations
        whole: no sample is at an end of the scale
    """

    codes: Floats
    errors: Floats
    whole: NDArray[np.bool_]

    @classmethod
    def of(
        cls, picture: NDArray[np.uint8], black: int, white: int, profile: bytes | None = None
    ) -> Patches:
        samples = blocks(picture).astype(float)
        whole = ((samples > black) & (samples < white)).all(axis=(1, 2))
        if profile is not None:
            picture = in_srgb(picture, profile)
            samples = blocks(picture).astype(float)
            whole &= ((samples > 0) & (samples < 255)).all(axis=(1, 2))
        noise = np.square(cv2.filter2D(picture.astype(np.float32), -1, NOISE))
        scatter = np.sqrt(blocks(noise).mean(axis=1)) / SIDE
        return cls(samples.mean(axis=1), np.hypot(scatter, SHARED_LEVELS), np.asarray(whole))

    @property
    def luminance(self) -> Floats:
        return np.asarray(srgb_to_linear(self.codes / 255) @ LUMINANCE)

    @property
    def knows_light(self) -> NDArray[np.bool_]:
        """Return where the light of each channel is known within a third of the tolerance."""
        lights = [
            np.log2(np.maximum(srgb_to_linear(np.maximum(each, 0) / 255), 1e-9))
            for each in (self.codes - self.errors, self.codes + self.errors)
        ]
        return np.asarray(((lights[1] - lights[0]) / 2 < STOPS / 3).all(axis=1))

    @property
    def knows_hue(self) -> NDArray[np.bool_]:
        """Return where the hue is known within a third of the tolerance."""
        own = lab(self.codes)[:, 1:]
        square = np.zeros(len(own))
        for channel in range(3):
            moved = self.codes.copy()
            moved[:, channel] += self.errors[:, channel]
            change = lab(moved)[:, 1:] - own
            square += np.square(own[:, 0] * change[:, 1] - own[:, 1] * change[:, 0])
        chroma = np.sum(own**2, axis=1)
        return np.asarray(np.sqrt(square) < np.radians(HUE / 3) * np.maximum(chroma, 1e-9))


def compare(shown: Patches, use: NDArray[np.bool_], taken: list[Patches]) -> tuple[Floats, Floats]:
    """Return how far hues are turned, degrees, and the light of channels is changed, stops.

    Args:
        shown: patches of the picture
        use: which of them
        taken: patches of the photographs, from the shortest exposure on
    """
    turns, stops = [], []
    found = srgb_to_linear(shown.codes / 255)
    for lower, upper in pairwise(taken):
        low, high, own = lower.luminance, upper.luminance, shown.luminance
        fits = use & (low <= own) & (own < high)
        fits &= lower.whole & upper.whole & lower.knows_light & upper.knows_light
        share = ((own - low) / np.where(fits, high - low, 1))[:, np.newaxis]
        lights = [srgb_to_linear(each.codes / 255) for each in (lower, upper)]
        camera = lights[0] + np.where(fits[:, np.newaxis], share, 0) * (lights[1] - lights[0])
        apart = np.log2(np.maximum(found, 1e-9) / np.maximum(camera, 1e-9))
        stops.append(apart[fits])
        fits &= lower.knows_hue & upper.knows_hue
        pair = lab(shown.codes), lab(255 * linear_to_srgb(camera))
        one, other = (np.arctan2(each[:, 2], each[:, 1]) for each in pair)
        turns.append(np.degrees((one - other + np.pi) % (2 * np.pi) - np.pi)[fits])
    return np.concatenate(turns), np.concatenate(stops)


def text(turns: Floats, stops: Floats) -> str:
    """Return the median and the 90th percentile of both, and how many patches they are of."""
    parts = []
    for values in (np.abs(turns), np.abs(stops).max(axis=1) if len(stops) else stops):
        if len(values):
            middle, high = np.percentile(values, (50, 90))
            parts.append(f"{middle:6.3f} {high:6.3f} {len(values):6d}")
        else:
            parts.append(f"{'-':>20}")
    return "   ".join(parts)


def measure(folder: Path, profile: bytes | None) -> None:
    """Print the differences of a merged folder."""
    report = read_report(folder)
    preview = np.asarray(Image.open(folder / "preview.png").convert("RGB"))
    if preview.shape != report.frame(0).shape:
        raise SystemExit(f"{folder}: the preview is smaller than the picture")
    still = ~(blocks(report.mask()) & CONTRADICTING).any(axis=(1, 2))
    order = np.argsort([each.applied_s for each in report.frames])
    frames = [np.asarray(report.frame(place), np.uint8) for place in order.tolist()]
    taken = [Patches.of(each, report.frames[0].black, report.white, profile) for each in frames]
    shown = Patches.of(preview, -1, 255)
    found = compare(shown, shown.whole & still, taken)
    own = [
        compare(each, each.whole & still, [before, after])
        for before, each, after in zip(taken, taken[1:], taken[2:], strict=False)
    ]
    itself = [np.concatenate(each) for each in zip(*own, strict=True)]
    print(f"{folder.name:18}", text(*found), " itself", text(*itself))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--profile-of", type=Path)
    options = parser.parse_args()
    profile = options.profile_of and Image.open(options.profile_of).info["icc_profile"]
    print(f"{'':18} {'hue, degrees':^20}   {'light, stops':^20}")
    for folder in options.folders:
        measure(folder, profile)


if __name__ == "__main__":
    main()
