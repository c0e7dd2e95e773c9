"""The response that is estimated from the memorial scene beside OpenCV's.

$CAMCTL_DATA/memorial holds Debevec and Malik's exposure series and their radiance map.  Errors are
medians of abs(ln(radiance / map)) at the best scale of each channel.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "helpers"))

from opencv_levels import levels_of, opencv_curves

from camctl.calibration.response.estimate import estimate_response
from camctl.calibration.response.series import Series
from camctl.interface.controls import Layout
from camctl.messages.plain import sentence
from camctl.model.response.camera import FloatArray
from camctl.profiles.response import ChannelResponse


def memorial(folder: Path) -> None:
    from camctl.stills.radiance_map import read_map

    rows = [line.split() for line in (folder / "image_list.txt").read_text().splitlines()]
    listed = [(row[0], 1 / float(row[2])) for row in rows if row and row[0].endswith(".png")]
    frames = []
    for name, _ in listed:
        frame = cv2.imread(str(folder / name))
        assert frame is not None, name
        frames.append(frame[..., ::-1])
    exposures = tuple(time_s for _, time_s in listed)
    truth = np.asarray(read_map(folder / "memorial.hdr")[0], np.float64)
    valid = np.ones(truth.shape[:2], bool)
    for frame in frames:
        valid &= ~((frame[..., 2] == 255) & (frame[..., 0] == 0) & (frame[..., 1] == 0))
    good_rows = np.flatnonzero(valid.mean(axis=1) > 0.85)
    good_columns = np.flatnonzero(valid.mean(axis=0) > 0.85)
    part = np.ix_(
        np.arange(good_rows[0], good_rows[-1] + 1), np.arange(good_columns[0], good_columns[-1] + 1)
    )
    print(
        f"memorial: {len(frames)} frames, {valid[part].mean():.1%} of the part used is valid",
        flush=True,
    )
    parts = [np.ascontiguousarray(frame[part]) for frame in frames]
    series = Series(Layout.RGB, 8)
    for (name, time_s), frame in zip(listed, parts, strict=True):
        series.add(frame, time_s, name)
    estimate = estimate_response(series)
    print("  " + "; ".join(map(sentence, estimate.findings)), flush=True)
    ours_ = []
    for channel in estimate.record.channels:
        levels = channel_levels(channel)
        below = np.full(channel.black + 1, levels[0] / 2)
        ours_.append(np.concatenate([below, levels_of(levels), levels[-1:]]))
    well = np.any([np.all((frame > 20) & (frame < 235), axis=2) for frame in parts], axis=0)
    usable = valid[part] & well & np.all(truth[part] > 0, axis=2)
    curves = {"camctl": np.stack(ours_, axis=1)} | {
        name: opencv_curves(parts, exposures, name) for name in ("debevec", "robertson")
    }
    places = np.arange(256.0)
    hat = np.minimum(places + 1, 256 - places)
    own = np.stack([each.sample_weights() for each in estimate.record.channels], axis=1)
    exposed = np.maximum(np.minimum(places - 20, 235 - places), 0)
    for weights, used in (
        (np.pad(own, ((0, 256 - len(own)), (0, 0))), "the weights of the record of camctl"),
        (np.stack([exposed] * 3, axis=1), "samples of 20 to 235"),
        (np.stack([hat] * 3, axis=1), "OpenCV's weights, black ones, too"),
    ):
        for name, curve in curves.items():
            found = []
            for colour in range(3):
                log_E = np.log(np.maximum(curve[:, colour], 1e-12))
                samples = np.array([frame[..., colour][usable] for frame in parts])
                weight = np.maximum(weights[samples, colour], 1e-12)
                light = (weight * (log_E[samples] - np.log(exposures)[:, None])).sum(axis=0)
                found.append(light / weight.sum(axis=0))
            print(f"  {used:34s} {name:10s} {compared(found, truth[part][usable])}", flush=True)
    merged = cv2.createMergeDebevec().process(
        parts, np.array(exposures, np.float32), curves["debevec"][:, None].astype(np.float32)
    )
    found = list(np.log(np.maximum(merged[usable], 1e-12)).T)
    print(
        f"  {'merged by OpenCV':34s} {'debevec':10s} {compared(found, truth[part][usable])}",
        flush=True,
    )


def compared(found: list[FloatArray], truth: FloatArray) -> str:
    """Return errors of ln(radiance) and the exponents of the radiance, R, G, B."""
    errors, exponents = [], []
    for logs, true in zip(found, np.log(truth).T, strict=True):
        difference = logs - true
        errors.append(f"{np.median(np.abs(difference - np.median(difference))):.4f}")
        exponents.append(f"{np.polyfit(true, logs, 1)[0]:.3f}")
    return f"median |ln error| {', '.join(errors)}; exponent {', '.join(exponents)}"


def channel_levels(channel: ChannelResponse) -> FloatArray:
    """Return the levels of a channel without a black level's phase."""
    count = channel.white - channel.black
    phase = 0.5 if channel.black else 0.0
    places = (np.arange(1, count + 1) - phase) / (count + 1)
    return np.asarray(np.interp(places, channel.brightness, channel.irradiance))


if __name__ == "__main__":
    memorial(Path(os.environ["CAMCTL_DATA"]) / "memorial")
