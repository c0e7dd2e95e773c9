"""Write exposure_oracle.json: xi and effective levels to 30 digits, from their definitions.

Levels are exact fractions of the float64 exposures; roots and logarithms are computed by mpmath
with 50 digits.  No code of camctl is used.  Run: python tests/oracle/make_exposure_oracle.py
"""

from __future__ import annotations

import itertools
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import mpmath as mp

mp.mp.dps = 50

# name, bits, phase, exposures, response, gamma, dynamic range, G, p, allowed relative error
CASES: list[tuple[Any, ...]] = [
    ("1, 2, 4 coincide", 8, 0.0, (1, 2, 4), "linear", 1, 1000.0, 765, 1, 1e-14),
    ("printed linear 5", 8, 0.0, (1, 1.003, 1.007, 1.166, 4.975), "linear", 1, 4096.0, 1275, 1,
     1e-14),
    ("1.1 and 1.21", 8, 0.0, (1, 1.1, 1.21), "gamma", 0.5, 1024.0, 765, 1, 1e-14),
    ("gaps of 1e-15", 8, 0.0, (1, 1 + 1e-15, 1 + 2e-15), "log", 1, 1000.0, 765, 1, 1e-14),
    ("gaps of 0 and 4e-3", 8, 0.0, (1, 1, 1), "linear", 1, 1000.0, 765, 1, 1e-14),
    ("1e6 apart", 8, 0.0, (1, 1000.5, 1e6), "log", 1, 1e7, 765, 1, 1e-14),
    ("gamma, range 1e7", 8, 0.0, (1, 50.3, 2000.7), "gamma", 0.5, 1e7, 765, 1, 1e-14),
    ("gamma, infinite range", 8, 0.0, (1, 3.3), "gamma", 0.5, None, 510, 1, 1e-14),
    ("linear, infinite range", 4, 0.0, (1, 1.05, 1.11), "linear", 1, None, 45, 1, 1e-14),
    ("range 1.001", 8, 0.0, (1, 1.003), "log", 1, 1.001, 510, 1, 3e-13),
    ("range 1.001 gamma", 10, 0.0, (1, 1.0001), "gamma", 0.5, 1.001, 2046, 1, 3e-13),
    ("gamma 0.1", 8, 0.0, (1, 7.7), "gamma", 0.1, 1e5, 510, 1, 1e-14),
    ("gamma 3", 8, 0.0, (1, 1.003, 1.7), "gamma", 3, 1000.0, 765, 1, 1e-14),
    ("rounding", 8, 0.5, (1, 9.91, 88.38), "log", 1, 16000.0, 765, 1, 1e-14),
    ("fractional black", 8, 0.28125, (1, 1.003, 2.985), "linear", 1, 1000.0, 765, 1, 1e-14),
    ("1 bit", 1, 0.0, (1, 2.7, 14.8), "gamma", 0.5, 1e7, 3, 1, 1e-14),
    ("16 exposures", 4, 0.0, tuple(1.37**k for k in range(16)), "log", 1, 1000.0, 240, 1, 1e-14),
    ("16 bit, n = 2", 16, 0.0, (1, 1.0000107), "linear", 1, 1e5, 131070, 1, 1e-13),
    ("16 bit, n = 8", 16, 0.0, (1, 1.001, 3, 5, 9, 20, 40, 90), "log", 1, 1e7, 524280, 1, 1e-13),
    ("p = 2 linear", 8, 0.0, (1, 1.003, 2.985), "linear", 1, 1024.0, 765, 2, 1e-14),
    ("p = 2 gamma", 6, 0.0, (1, 3.1), "gamma", 0.5, 256.0, 126, 2, 1e-14),
    ("p = 2 log", 6, 0.0, (1, 20.24), "log", 1, 512.0, 126, 2, 1e-14),
    ("p = 1.5 log", 4, 0.0, (1, 5.3), "log", 1, 100.0, 30, 1.5, 1e-14),
    ("p = 3 gamma", 4, 0.5, (1, 5.3), "gamma", 0.5, 100.0, 30, 3, 1e-14),
]  # fmt: skip


class Desired:
    """A desired response in 50 digits."""

    def __init__(self, response: str, q: float, dynamic_range: float | None, G: int) -> None:
        self.response, self.q, self.G = response, mp.mpf(q), mp.mpf(G)
        self.e_min = mp.mpf(0) if dynamic_range is None else 1 / mp.mpf(dynamic_range)

    def g(self, E: Any) -> Any:
        if self.response == "linear":
            return self.G * (E - self.e_min) / (1 - self.e_min)
        if self.response == "gamma":
            return self.G * (E**self.q - self.e_min**self.q) / (1 - self.e_min**self.q)
        return self.G * mp.log(E / self.e_min) / -mp.log(self.e_min)

    def slope(self, E: Any) -> Any:
        if self.response == "linear":
            return self.G / (1 - self.e_min)
        if self.response == "gamma":
            if E == 0:
                return mp.inf if self.q < 1 else mp.mpf(0)
            return self.G * self.q * E ** (self.q - 1) / (1 - self.e_min**self.q)
        return self.G / (E * -mp.log(self.e_min))

    def inverse_slope(self, slope: Any) -> Any:
        if self.response == "gamma":
            return (slope * (1 - self.e_min**self.q) / (self.G * self.q)) ** (1 / (self.q - 1))
        return self.G / (slope * -mp.log(self.e_min))


def integral_over_gap(desired: Desired, a: Any, b: Any, p: float) -> Any:
    """Return the integral of max(0, g' - 1 / (b - a))^p over the gap (a, b) above e_min."""
    low, high = max(a, desired.e_min), min(b, mp.mpf(1))
    if not low < high:
        return mp.mpf(0)
    density = 1 / (b - a)
    start, stop = low, high
    if desired.response == "linear":
        if desired.slope(low) <= density:
            return mp.mpf(0)
    elif desired.response == "gamma" and desired.q > 1:
        if desired.slope(high) <= density:
            return mp.mpf(0)
        start = min(max(desired.inverse_slope(density), low), high)
    else:
        if desired.slope(low) <= density:
            return mp.mpf(0)
        stop = min(max(desired.inverse_slope(density), low), high)
    if p == 1:
        return desired.g(stop) - desired.g(start) - (stop - start) * density
    if desired.response == "linear":
        return (desired.slope(start) - density) ** p * (stop - start)
    return mp.quad(lambda E: (desired.slope(E) - density) ** p, [start, stop])


def count_distinct(bits: int, phase: float, exposures: tuple[float, ...]) -> int:
    """Count levels of the decimal exposures; levels within 1e-12 of a first one count once."""
    M = 2**bits - 1
    levels = sorted(
        (Fraction(k) - Fraction(phase)) / (M + 1) / Fraction(str(e))
        for e in exposures
        for k in range(1, M + 1)
    )
    count, first = 0, Fraction(0)
    for level in levels:
        if level - first > first / 10**12:
            count, first = count + 1, level
    return count


def row(case: tuple[Any, ...]) -> dict[str, Any]:
    name, bits, phase, exposures, response, q, dynamic_range, G, p, bound = case
    M = 2**bits - 1
    levels = sorted(
        (Fraction(k) - Fraction(phase)) / (M + 1) / Fraction(e)
        for e in exposures
        for k in range(1, M + 1)
    )
    distinct = [level for level, _ in itertools.groupby(levels)]
    desired = Desired(response, q, dynamic_range, G)
    edges = [mp.mpf(x.numerator) / x.denominator for x in [Fraction(0), *distinct, Fraction(1)]]
    xi = mp.fsum(integral_over_gap(desired, a, b, p) for a, b in itertools.pairwise(edges))
    inside = [E for E in edges if desired.e_min < E < 1]
    heights = [desired.g(E) / G for E in [desired.e_min, *inside, mp.mpf(1)]]
    cubes = mp.fsum((b - a) ** 3 for a, b in itertools.pairwise(heights))
    return {
        "name": name, "bits": bits, "phase": phase, "exposures": list(exposures),
        "response": response, "q": q, "dynamic_range": dynamic_range, "levels_wanted": G, "p": p,
        "bound": bound, "xi": mp.nstr(xi, 30), "effective_levels": mp.nstr(1 / mp.sqrt(cubes), 30),
        "levels_distinct": count_distinct(bits, phase, exposures),
    }  # fmt: skip


if __name__ == "__main__":
    lines = ",\n".join(json.dumps(row(case)) for case in CASES)
    Path(__file__).with_name("exposure_oracle.json").write_text(f"[\n{lines}\n]\n")
