"""What `camctl solve` prints: the exposures, those on a camera's settings, the certificate."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from camctl.cli.output import (
    format_duration,
    format_effective,
    format_fields,
    format_number,
    format_objective,
    format_request,
)

if TYPE_CHECKING:
    from camctl.cli.real_camera import KnownCamera
    from camctl.exposure.accuracy import AccuracySolution
    from camctl.exposure.evaluation import Evaluation
    from camctl.exposure.grid_search import SettingsSolution
    from camctl.exposure.lower_bound import Certificate
    from camctl.exposure.solver import Solution
    from camctl.model.response.desired import DesiredResponse

PROOF_GAP = 1.01e-4
"""Relative gap up to which a bound counts as a proof: the search for it stops at 1e-4."""

_CHOSEN_BY = {
    "accuracy": "accuracy with this camera's noise",
    "xi": "missing levels (xi), without noise; shoot counts it, as --objective accuracy does",
}


@dataclass(frozen=True)
class SettingsResult:
    """The best exposures among a camera's settings, with the time, s, and gain of each."""

    solution: SettingsSolution | AccuracySolution
    times_s: tuple[float, ...]
    gains: tuple[float, ...]


@dataclass(frozen=True)
class SolveResult:
    """Exposures found for any times, and where asked a certificate or those on a camera's grid."""

    camera: KnownCamera
    desired: DesiredResponse
    found: Solution
    certificate: Certificate | None = None
    restricted: SettingsResult | None = None
    objective: str = "xi"

    @property
    def best(self) -> Solution:
        """The exposures to use."""
        return self.found if self.restricted is None else self.restricted.solution

    @property
    def noise_known(self) -> bool:
        """Whether effective levels count noise."""
        return self.camera.noise is not None

    @cached_property
    def quality(self) -> Evaluation:
        """The quality of the best exposures with the camera's noise."""
        if self.restricted is None:
            return self.camera.rate(self.desired, self.best.exposures)
        restricted = self.restricted
        return self.camera.rate(
            self.desired, self.best.exposures, restricted.gains, restricted.times_s
        )

    def to_json(self, seed: int) -> dict[str, Any]:
        """Return the JSON output."""
        keys = ("exposures", "xi", "levels_wanted", "total_exposure")
        result: dict[str, Any] = {
            **_attributes(self.best, (*keys, "seconds", "evaluations")),
            "effective_levels": self.quality.effective_levels,
            "effective_levels_noise_free": self.quality.effective_levels_noise_free,
            "noise": self.camera.noise,
            "objective": self.objective,
            "response": self.desired.name,
            "dynamic_range": self.desired.dynamic_range,
            "camera": self.camera.response.name,
            "seed": seed,
        }
        if self.certificate is not None:
            result["certificate"] = _certificate_json(self.certificate)
        if self.restricted is not None:
            result["times_s"] = self.restricted.times_s
            result["gains"] = self.restricted.gains
            result["shutter_s"] = sum(self.restricted.times_s)
            result["exhaustive"] = self.restricted.solution.enumerated
            rated = self.camera.rate(self.desired, self.found.exposures)
            result["unrestricted"] = {
                **_attributes(self.found, ("exposures", "xi")),
                "effective_levels": rated.effective_levels,
                "effective_levels_noise_free": rated.effective_levels_noise_free,
            }
        return result

    def to_text(self, seed: int, *, counts_levels: bool) -> str:
        """Return the text output."""
        best, restricted = self.best, self.restricted
        request = format_request(self.desired.name, self.desired.dynamic_range, len(best.exposures))
        rows = [("desired", request), ("camera", self.camera.response.name)]
        if self.noise_known:
            rows.append(("chosen by", _CHOSEN_BY[self.objective]))
        if restricted is not None:
            rows.append(("settings", _settings_text(restricted)))
        rows += [
            ("exposures", "  ".join(map(format_number, best.exposures))),
            format_objective(best.xi, best.levels_wanted, counts_levels=counts_levels),
            ("effective levels", format_effective(self.quality, noise_known=self.noise_known)),
        ]
        if restricted is None:
            total = f"{format_number(best.total_exposure)} x the shortest exposure"
        else:
            total = format_duration(sum(restricted.times_s))
        rows.append(("total exposure time", total))
        if self.certificate is None:
            rows.append(("search", _search_text(best, restricted, seed)))
        if restricted is not None:
            rows += self._comparison()
        text = format_fields(rows)
        if self.certificate is None:
            return text
        return f"{text}\n\n{certificate_text(self.certificate)}"

    def _comparison(self) -> list[tuple[str, str]]:
        """Return rows that compare exposures on a camera's settings with exposures of any times."""
        unrestricted = self.camera.rate(self.desired, self.found.exposures)
        share = self.quality.effective_levels / unrestricted.effective_levels
        kept = f"the camera's settings reach {format_number(100 * share, 3)} % of these levels"
        if share > 1:
            kept = "the camera's settings give as many effective levels or more"
        effective = format_effective(unrestricted, noise_known=self.noise_known)
        exposures = "  ".join(map(format_number, self.found.exposures))
        return [
            ("with any times", exposures),
            ("", f"{format_number(self.found.xi, 5)} missing levels (xi)"),
            ("", f"effective levels: {effective}"),
            ("", kept),
        ]


def _attributes(solution: Solution, names: Iterable[str]) -> dict[str, Any]:
    return {name: getattr(solution, name) for name in names}


def _settings_text(restricted: SettingsResult) -> str:
    shows_gain = any(gain != 1 for gain in restricted.gains)
    return "  ".join(
        format_duration(time_s) + (f" x {format_number(gain)}" if shows_gain else "")
        for time_s, gain in zip(restricted.times_s, restricted.gains, strict=True)
    )


def _search_text(best: Solution, restricted: SettingsResult | None, seed: int) -> str:
    exhaustive = ", all there are" if restricted and restricted.solution.enumerated else ""
    return (
        f"{format_number(best.seconds, 3)} s, {best.evaluations:,} sets of exposures{exhaustive}, "
        f"seed {seed}"
    )


def _certificate_json(certificate: Certificate) -> dict[str, Any]:
    """Return the certificate for JSON output."""
    return {
        "proven": certificate.gap <= PROOF_GAP,
        "best_known_xi": certificate.xi,
        "lower_bound": certificate.lower_bound,
        "relative_gap": certificate.gap,
        "evaluations": certificate.evaluations,
        "seconds": certificate.seconds,
    }


def certificate_text(certificate: Certificate) -> str:
    """Return the certificate as text."""
    n = len(certificate.exposures)
    if certificate.gap <= PROOF_GAP:
        title = "certificate: proof that no other exposures are better"
    elif certificate.lower_bound > 0:
        title = "certificate: a lower bound, no proof; better exposures may or may not exist"
    else:
        title = "certificate: no bound above 0 was found"
    gap = certificate.xi - certificate.lower_bound
    rows = [
        ("  best known xi", format_number(certificate.xi, 8)),
        (
            "  lower bound",
            f"{format_number(certificate.lower_bound, 8)} for any {n} exposure{'s' * (n > 1)}",
        ),
        (
            "  gap",
            f"{format_number(gap, 3)}, {format_number(100 * certificate.gap, 2)} % of the best "
            "known xi",
        ),
        (
            "  search",
            f"{certificate.evaluations:,} set{'s' * (certificate.evaluations > 1)} evaluated in "
            f"{format_number(certificate.seconds, 3)} s",
        ),
    ]
    return f"{title}\n{format_fields(rows)}"
