"""The exposures that a picture is computed with: stated by the camera, calibrated, or estimated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from camctl.captures.plan import NOTABLE_DIFFERENCE
from camctl.errors import DataError
from camctl.evidence.patches import Patches
from camctl.evidence.ratios import estimate_comparable
from camctl.findings import Finding
from camctl.interface.controls import ExposureControls
from camctl.model.sensor import SensorModel
from camctl.records.frame import ExposureRatio, StoredFrame


@dataclass(frozen=True)
class Estimates:
    """Estimated exposures of the frames of a capture that can be compared.

    Attributes:
        reference: position of the frame that the others are compared with
        exposures: by position: exposure and its 95 % interval, in units of the reference's label
    """

    reference: int
    exposures: Mapping[int, tuple[float, float, float]]


def estimate_exposures(
    frames: Sequence[StoredFrame],
    samples: Sequence[Patches],
    scale: SensorModel,
    controls: ExposureControls,
) -> tuple[Estimates | None, list[Finding]]:
    """Estimate the exposures of the frames of a capture; return findings, too.

    Frames that have no light in common with the others, as where one is saturated everywhere, have
    no estimate.  The first result is None where the frames do not allow any.
    """
    settings = [frame.applied for frame in frames]
    noise = None if controls.noise is None else controls.frame_noise(settings)
    try:
        every = [each.exposure for each in settings]
        used, found = estimate_comparable(samples, every, scale, noise)
    except DataError as error:
        return None, [Finding(code="not_estimated", details={"what": error.what})]
    labels = [every[k] for k in used]
    unit, label = found.exposures[found.reference], labels[found.reference]
    notes = [
        Finding(code="not_estimated", frames=(k,)) for k in range(len(frames)) if k not in used
    ]
    rows = zip(used, labels, found.exposures, found.low, found.high, strict=True)
    exposures = {}
    for k, stated, value, low, high in rows:
        exposures[k] = value, low, high
        if not low * (1 - 1e-9) <= stated <= high * (1 + 1e-9):
            notes.append(
                Finding(
                    code="exposure_estimated",
                    frames=(k, used[found.reference]),
                    value=value / stated * label / unit,
                    low=low / stated,
                    high=high / stated,
                )
            )
    return Estimates(used[found.reference], exposures), notes


def choose_exposures(
    frames: Sequence[StoredFrame], controls: ExposureControls, estimates: Estimates | None
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
        if estimates is not None and k in estimates.exposures:
            # The label of the reference frame, corrected by the profile, is the unit.
            reference = frames[estimates.reference].applied
            unit = controls.exposure(reference) / reference.exposure
            value, low, high = (unit * each for each in estimates.exposures[k])
            ratio = ratio.model_copy(update={"estimate": value, "low": low, "high": high})
            # A wide interval that holds the label says nothing against it.
            if high - low <= NOTABLE_DIFFERENCE * value or not low <= ratio.exposure <= high:
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
