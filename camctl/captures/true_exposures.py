"""The exposures that a picture is computed with: stated by the camera, calibrated, or estimated."""

from __future__ import annotations

from collections.abc import Sequence

from camctl.captures.frame_record import ExposureRatio, StoredFrame
from camctl.controls import ExposureControls
from camctl.errors import DataError
from camctl.exposure.patches import LightScale, Patches
from camctl.exposure.ratios import RatioEstimates, estimate_ratios

#: An estimate with a wider 95 % interval, relative, is used only where the label lies outside it.
WIDEST_INTERVAL = 0.01


def estimate_exposures(
    frames: Sequence[StoredFrame],
    samples: Sequence[Patches],
    scale: LightScale,
    controls: ExposureControls,
) -> tuple[RatioEstimates | None, list[str]]:
    """Estimate the exposures of the frames of a capture; return warnings, too.

    The first result is None where the frames do not allow it.
    """
    settings = [frame.applied for frame in frames]
    labels = [setting.exposure for setting in settings]
    noise = None if controls.noise is None else controls.frame_noise(settings)
    try:
        found = estimate_ratios(samples, labels, scale, noise)
    except DataError as error:
        return None, [f"the exposure ratios could not be estimated: {error.what}"]
    wrong = [
        f"frame {k + 1} has {value / label * labels[found.reference] / reference:.4g} times the "
        f"exposure that the camera states, compared with frame {found.reference + 1} (95 %: "
        f"{low / label:.4g} to {high / label:.4g})"
        for reference in [found.exposures[found.reference]]
        for k, (label, value, low, high) in enumerate(
            zip(labels, found.exposures, found.low, found.high, strict=True)
        )
        if not low * (1 - 1e-9) <= label <= high * (1 + 1e-9)
    ]
    return found, wrong


def choose_exposures(
    frames: Sequence[StoredFrame], controls: ExposureControls, estimates: RatioEstimates | None
) -> list[ExposureRatio]:
    """Return the exposures of the frames, in the unit of `ExposureSetting.exposure`.

    An estimate comes before the profile, and the profile before the label.
    """
    chosen = []
    for k, frame in enumerate(frames):
        label = frame.applied.exposure
        known = controls.true_exposures
        correction = None if known is None else known.correction(frame.applied)
        ratio = ExposureRatio(label=label, used="label", exposure=label)
        if correction is not None:
            profile = label * correction.factor
            ratio = ratio.model_copy(
                update={
                    "profile": profile,
                    "low": label * correction.low,
                    "high": label * correction.high,
                    "used": "profile",
                    "exposure": profile,
                }
            )
        if estimates is not None:
            # The label of the reference frame, corrected by the profile, is the unit.
            reference = frames[estimates.reference].applied
            unit = controls.exposure(reference) / reference.exposure
            value, low, high = (
                unit * each[k] for each in (estimates.exposures, estimates.low, estimates.high)
            )
            ratio = ratio.model_copy(update={"estimate": value, "low": low, "high": high})
            if high - low <= WIDEST_INTERVAL * value or not low <= ratio.exposure <= high:
                ratio = ratio.model_copy(update={"used": "estimate", "exposure": value})
        chosen.append(ratio)
    return chosen


def relative(chosen: Sequence[ExposureRatio]) -> list[ExposureRatio]:
    """Return exposures relative to the smallest one that is used."""
    smallest = min(ratio.exposure for ratio in chosen)
    return [
        ratio.model_copy(
            update={name: value / smallest for name, value in ratio if isinstance(value, float)}
        )
        for ratio in chosen
    ]
