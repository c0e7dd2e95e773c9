"""The figures of EMVA 1288 of a camera whose noise was measured, and their report.

European Machine Vision Association, Standard 1288, release 4.0 (linear): symbols and units are its
own.  Photons are not counted, since the light is not known in any unit: the quantum efficiency and
figures in photons are missing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from camctl.profiles.noise import Figure, NoiseRecord


@dataclass(frozen=True)
class EmvaFigure:
    """One figure.

    Attributes:
        name: in the standard
        symbol: in the standard
        unit: of the values
        value: the estimate
        low: lower end of its 95 % confidence interval
        high: upper end
    """

    name: str
    symbol: str
    unit: str
    value: float
    low: float
    high: float


def figures(record: NoiseRecord) -> tuple[EmvaFigure, ...]:
    """Return the figures at the lowest gain, as far as they were measured."""
    lowest, ratios = record.gains[0], record.emva()
    conversion, noise = lowest.conversion_e_per_dn, lowest.read_noise_e
    gain = Figure(value=1 / conversion.value, low=1 / conversion.high, high=1 / conversion.low)
    rows: list[tuple[str, str, str, Figure]] = [
        ("overall system gain", "K", "DN/e-", gain),
        ("temporal dark noise", "sigma_d", "e-", noise),
        ("temporal dark noise", "sigma_d", "DN", noise.times(gain)),
        ("saturation capacity", "mu_e.sat", "e-", record.full_well_e),
        ("absolute sensitivity threshold", "mu_e.min", "e-", ratios["sensitivity_threshold_e"]),
    ]
    for name, symbol, figure in (
        ("dynamic range", "DR", ratios["dynamic_range"]),
        ("maximum signal-to-noise ratio", "SNR_max", ratios["snr_max"]),
    ):
        rows += [(name, symbol, unit, _converted(figure, factor)) for unit, factor in _UNITS]
    if record.prnu is not None:
        rows.append(("photo-response nonuniformity", "PRNU", "%", record.prnu.scaled(100)))
    if (dark := record.dark) is not None:
        rows.append(("dark signal nonuniformity", "DSNU", "e-", dark.dsnu_e))
        rows.append(("dark current", "mu_I.mean", "e-/s", dark.dark_current_e_s))
        if dark.dcnu_e_s is not None:
            rows.append(("dark current nonuniformity", "DCNU", "e-/s", dark.dcnu_e_s))
    return tuple(
        EmvaFigure(name, symbol, unit, each.value, each.low, each.high)
        for name, symbol, unit, each in rows
    )


#: Units of a ratio of amplitudes, and their value for a factor e.
_UNITS: Final = (("dB", 20 / math.log(10)), ("bit", 1 / math.log(2)))


def _converted(ratio: Figure, factor: float) -> Figure:
    value, low, high = (
        factor * math.log(max(1.0, each)) for each in (ratio.value, ratio.low, ratio.high)
    )
    return Figure(value=value, low=low, high=high)


def report(record: NoiseRecord, camera: str, mode: str) -> str:
    """Return figures and photon transfer curves in Markdown."""
    lines = [
        f"# EMVA 1288: {camera or 'camera not known'}",
        "",
        f"Mode {mode or 'not known'}, measured {record.measured_at}, at gain "
        f"{record.gains[0].gain:g} unless stated. Intervals are 95 %.",
        "",
        "| figure | symbol | value | interval | unit |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {each.name} | {each.symbol} | {each.value:.4g} | {each.low:.4g} to {each.high:.4g} "
        f"| {each.unit} |"
        for each in figures(record)
    ]
    missing = ["quantum efficiency and figures in photons (the light is not known in any unit)"]
    missing += ["PRNU (needs an evenly lit surface)"] * (record.prnu is None)
    missing += ["DSNU and dark current (need frames without light)"] * (record.dark is None)
    lines += ["", f"Not measured: {'; '.join(missing)}."]
    if not record.saturates:
        lines += ["", "No saturated samples were seen: the stated white level is the saturation."]
    for each in record.gains:
        conversion = each.conversion_e_per_dn
        lines += [
            "",
            f"## Photon transfer at gain {each.gain:g}",
            "",
            f"{conversion.value:.4g} electrons per DN, misfit {each.misfit:.2f}, "
            f"{each.patches:,} patches of 64 samples.",
            "",
            "| mean, DN | variance, DN squared | fitted |",
            "|---|---|---|",
            *(
                f"| {point.mean:.4g} | {point.variance:.4g} | {point.fitted:.4g} |"
                for point in sorted(each.curve, key=lambda point: point.mean)
            ),
        ]
    return "\n".join([*lines, ""])
