"""The noise of a camera from pairs of frames of whatever is in view (photon transfer, EMVA 1288).

Two frames of each setting, from dark to nearly saturated, are compared in patches
(`camctl.calibration.noise.pairs`); variance against brightness gives conversion gain and read noise
(`camctl.calibration.noise.fit`).  An evenly lit surface also gives the PRNU; frames without light
are examined by `camctl.calibration.noise.dark`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.calibration.intervals import certain, root_of_ratio
from camctl.calibration.light import all_saturated, moved
from camctl.calibration.limits import DIM, FEW, LEAST_PATCHES, MOST_MOVED
from camctl.calibration.noise.curve import NoiseCurve
from camctl.calibration.noise.fit import NoiseFit, combine_fits, fit_noise
from camctl.calibration.noise.pairs import FramePair, PairPatches, channel_names, reduce_pair
from camctl.errors import DataError
from camctl.findings import Finding
from camctl.interface.controls import ExposureSetting, Layout
from camctl.model.response.camera import CameraResponse
from camctl.model.sensor import SensorModel
from camctl.profiles.noise import CurvePoint, Figure, GainNoise, NoiseRecord

#: A change of the light within a pair that is noted, and one from which a pair is not used.
_NOTED_CHANGE, _MOST_CHANGE = 0.02, 0.2
#: Misfit of the photon transfer curve that is noted.
_NOTED_MISFIT = 3.0
#: Correlation of neighbouring samples from which the camera is said to filter its pictures.
_CORRELATED = 0.05
#: Channels differ if their conversion gains certainly do, and by this share.
_APART_SHARE = 0.03
#: Standard deviation of brightness, of the noise and over the picture together, from which light is
#: spread over a level, DN: where it is not, as on a flat field with little noise, the variance
#: depends on where in a level the light is.
_LEAST_SPREAD = 0.65


@dataclass(eq=False)
class NoiseFrames:
    """Frames of one scene and one camera mode, paired by setting as they come, in any order.

    Attributes:
        layout: pixel layout
        black: brightness without light, DN
        white: brightness from which samples are saturated, DN
        responses: response of each channel (R, G and B, or Y) as levels
        is_flat: an evenly lit surface is in view, so that the fixed pattern can be measured
        findings: what the user should know
        pairs: of two frames with one setting
    """

    layout: Layout
    black: int
    white: int
    responses: Mapping[str, CameraResponse]
    is_flat: bool = False
    findings: list[Finding] = field(default_factory=list)
    pairs: list[FramePair] = field(default_factory=list)
    _single: dict[ExposureSetting, NDArray[Any]] = field(default_factory=dict)

    def add(self, pixels: NDArray[Any], setting: ExposureSetting) -> None:
        """Add a frame; the second one of a setting is compared with the first, and dropped.

        Raises:
            DataError: the frames of a pair have different sizes
        """
        first = self._single.pop(setting, None)
        if first is None:
            self._single[setting] = pixels
            return
        self.pairs.append(
            reduce_pair(first, pixels, setting, self.layout, (self.black, self.white))
        )

    def note_format(self, suffix: str) -> None:
        """Note what the format of a file, by its suffix, does to the noise."""
        found = Finding(code="noise_filtered")
        if suffix.lower() in (".jpg", ".jpeg") and found not in self.findings:
            self.findings.append(found)

    @property
    def unpaired(self) -> int:
        """Number of frames without a second one of the same setting."""
        return len(self._single)


def same_response(response: CameraResponse, layout: Layout) -> dict[str, CameraResponse]:
    """Return `response` for each channel of a layout."""
    return dict.fromkeys(channel_names(layout), response)


def estimate_noise(frames: NoiseFrames) -> NoiseRecord:
    """Return the noise that pairs of frames show.

    Raises:
        DataError: the frames are not suitable; says why and what to do
    """
    pairs = _usable_pairs(frames)
    findings = list(frames.findings)
    correlation = _correlation(pairs)
    if correlation is not None and abs(correlation) > _CORRELATED:
        findings.append(Finding(code="noise_filtered", value=correlation))
    changes = [abs(pair.change) for pair in pairs]
    if max(changes) > _NOTED_CHANGE:
        findings.append(
            Finding(code="light_varies", value=max(changes), details={"within": "pair"})
        )
    gains = sorted({pair.setting.gain for pair in pairs})
    fits: dict[float, NoiseFit] = {}
    channel = None
    failures = []
    for gain in sorted(gains, key=lambda each: abs(math.log(each))):
        some = [pair for pair in pairs if pair.setting.gain == gain]
        try:
            if fits:
                fits[gain] = _fit_gain(frames, some, channel)[0]
            else:
                fits[gain], channel = _fit_gain(frames, some, None, findings)
        except DataError as error:
            failures.append(error)
            findings.append(
                Finding(
                    code="not_measured", value=gain, details={"what": "gain", "why": error.what}
                )
            )
    if not fits:
        raise failures[0]
    measured = tuple(_gain_noise(gain, fits[gain]) for gain in sorted(fits))
    if (misfit := max(each.misfit for each in measured)) > _NOTED_MISFIT:
        remedies = {"calibrate_response": None}
        findings.append(Finding(code="noise_misfit", value=misfit, remedies=remedies))
    saturates = max(pair.saturated_share for pair in frames.pairs) > FEW
    lowest = measured[0]
    response = frames.responses[channel or channel_names(frames.layout)[-1]]
    return NoiseRecord(
        gains=measured,
        full_well_e=lowest.conversion_e_per_dn.scaled(
            float(response.levels[-1]) * (response.M + 1)
        ),
        saturates=saturates,
        prnu=_prnu(frames, pairs) if frames.is_flat else None,
        correlation=correlation,
        findings=tuple(findings),
        measured_at=datetime.now(UTC).isoformat(timespec="seconds"),
    )


def _usable_pairs(frames: NoiseFrames) -> list[FramePair]:
    if not frames.pairs:
        raise DataError(
            f"no two of the {frames.unpaired} frames have the same exposure",
            hint="give two frames of each exposure: the noise is what differs between them",
        )
    pairs = [pair for pair in frames.pairs if pair.saturated_share < 1 - 2 * FEW]
    if not pairs:
        raise all_saturated()
    span = frames.white - frames.black
    bright = [
        max(float(np.quantile(each.mean, 1 - FEW)) for each in pair.channels.values())
        for pair in pairs
    ]
    if max(bright) < FEW * span:
        raise DataError(
            "all frames are black",
            hint="take the lens cap off, light the scene, or expose longer; frames without light "
            "show the dark signal",
            remedies={"calibrate_dark": None},
        )
    for pair in pairs:
        if all(not each.variance.any() for each in pair.channels.values()) and max(bright) > 0:
            raise DataError(
                f"the two frames of {pair.setting.time_s:.4g} s are the same picture",
                hint="give two separate frames; a camera whose noise is far below one level shows "
                "none: raise its gain",
            )
    if (share := float(np.median([pair.moved_share for pair in pairs]))) > MOST_MOVED:
        raise moved(f"{share:.0%} of the picture differs between the two frames of a pair")
    steady = [pair for pair in pairs if abs(pair.change) <= _MOST_CHANGE]
    if not steady:
        raise DataError(
            f"the light changes by {max(abs(pair.change) for pair in pairs):.0%} between the two "
            "frames of a pair",
            hint="use daylight or a lamp that does not flicker",
        )
    return steady


def _correlation(pairs: Sequence[FramePair]) -> float | None:
    found = [pair.correlation for pair in pairs if pair.correlation is not None]
    return float(np.median(found)) if found else None


def _fit_gain(
    frames: NoiseFrames,
    pairs: Sequence[FramePair],
    channel: str | None,
    findings: list[Finding] | None = None,
) -> tuple[NoiseFit, str | None]:
    """Return the fit of all channels that agree, or of one; and that channel's name.

    Raises:
        DataError: no channel can be fitted
    """
    fits: dict[str, NoiseFit] = {}
    failure = None
    left_out: list[Finding] = []
    for name in dict.fromkeys(channel_names(frames.layout)) if channel is None else (channel,):
        curve = NoiseCurve(frames.responses[name], frames.black)
        patches = PairPatches.joined([_spread(pair.channels[name]) for pair in pairs])
        try:
            fits[name] = fit_noise(curve, patches, float(frames.white - frames.black))
        except DataError as error:
            failure = failure or error
            left_out.append(
                Finding(
                    code="not_measured",
                    details={"what": "channel", "channel": name, "why": error.what},
                )
            )
    if not fits:
        assert failure is not None
        raise failure
    if findings is not None:
        findings += left_out
    if len(fits) == 1:
        return next(iter(fits.values())), channel
    joined = combine_fits(list(fits.values()))
    differ = [
        abs(fit.inverse_k / joined.inverse_k - 1)
        for fit in fits.values()
        if abs(fit.inverse_k - joined.inverse_k)
        > certain(len(fits)) * math.sqrt(fit.covariance[0, 0])
    ]
    if not differ or max(differ) < _APART_SHARE:
        return joined, None
    main = "G" if "G" in fits else next(iter(fits))
    if findings is not None:
        each = ", ".join(f"{name} {fit.conversion[0]:.4g}" for name, fit in fits.items())
        findings.append(Finding(code="channels_differ", details={"each": each, "channel": main}))
    return fits[main], main


def _spread(patches: PairPatches) -> PairPatches:
    """Return the patches of a pair; none where rounding does not average out over them."""
    noise = float(np.mean(patches.variance)) - 1 / 12
    keeps = noise + float(np.var(patches.mean)) >= _LEAST_SPREAD**2
    return patches.part(np.full(patches.mean.size, keeps))


def _gain_noise(gain: float, fit: NoiseFit) -> GainNoise:
    if not np.all(np.isfinite([*fit.conversion, *fit.read_noise])):
        raise DataError(
            f"the noise at gain {gain:g} does not grow with the light, so that its electrons "
            "cannot be counted",
            hint="use a scene with dark and bright parts, and check the response of the camera",
        )
    names = ("value", "low", "high")
    points = zip(fit.means.tolist(), fit.variances.tolist(), fit.expected.tolist(), strict=True)
    return GainNoise(
        gain=gain,
        conversion_e_per_dn=Figure(**dict(zip(names, fit.conversion, strict=True))),
        read_noise_e=Figure(**dict(zip(names, fit.read_noise, strict=True))),
        patches=fit.patches,
        misfit=fit.misfit,
        curve=tuple(CurvePoint(mean=m, variance=v, fitted=f) for m, v, f in points),
    )


def _prnu(frames: NoiseFrames, pairs: Sequence[FramePair]) -> Figure | None:
    """Return the PRNU from the covariance of the frames of a flat field, without smooth shading.

    The sum over pairs of a patch is one observation, since its pixels are the same in all of them.
    """
    low = DIM * (frames.white - frames.black)
    sums = []
    for name, response in frames.responses.items():
        full = response.M + 1.0
        highest = SensorModel(response, frames.black).highest(None) - frames.black
        height = np.arange(1.0, full)
        total: NDArray[np.float64] | float = 0.0
        for pair in pairs:
            patches = pair.channels[name]
            light = np.interp(patches.mean + 0.5, height, response.levels) * full
            used = (patches.mean > low) & (patches.mean < highest)
            slope = response.slope(light / full) / full
            total = total + np.stack(
                [np.where(used, patches.pattern / slope**2, 0), np.where(used, light**2, 0)]
            )
        sums.append(total)
    colours = [np.atleast_2d(each).T for each in sums]
    if sum(np.count_nonzero(each[:, 1]) for each in colours) < LEAST_PATCHES:
        return None
    return root_of_ratio(colours)
