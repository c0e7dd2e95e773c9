"""Errors of xi and effective levels against 50 digits, and the bounds that the tests check.

python tests/bench/bench_solver_numerics.py

Prints a table in Markdown, one row for each hard case of tests/oracle/exposure_oracle.json.
"""

from __future__ import annotations

import json
import math
from fractions import Fraction
from pathlib import Path

from camctl.exposure.objective import xi
from camctl.model.effective import EffectiveCamera, effective_levels
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import desired_response

ORACLE = Path(__file__).parents[1] / "oracle" / "exposure_oracle.json"


def relative_error(measured: float, exact: str) -> float:
    """Return the relative error."""
    return float(abs(Fraction(measured) / Fraction(exact) - 1))


def main() -> None:
    """Print the table."""
    print("| case | bits | n | xi | error of xi | bound | error of effective levels |")
    print("|---|---|---|---|---|---|---|")
    for row in json.loads(ORACLE.read_text(encoding="utf-8")):
        gamma = row["q"] if row["response"] == "gamma" else None
        dynamic_range = row["dynamic_range"] or math.inf
        desired = desired_response(row["response"], dynamic_range, gamma=gamma)
        response = linear_response(row["bits"], phase=row["phase"])
        camera = EffectiveCamera.of(response, row["exposures"])
        score = xi(camera, desired, row["levels_wanted"], p=row["p"])
        levels = effective_levels(camera, desired)
        print(
            f"| {row['name']} | {row['bits']} | {len(row['exposures'])} | {score:.6g} "
            f"| {relative_error(score, row['xi']):.0e} | {row['bound']:.0e} "
            f"| {relative_error(levels, row['effective_levels']):.0e} |"
        )


if __name__ == "__main__":
    main()
