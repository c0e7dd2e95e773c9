"""Print the paper's table of exposures beside the exposures that camctl finds.

    python docs/print_exposures.py

This is the table of docs/explanation/exposures.md: an 8-bit linear camera, G = n * 255 desired
levels, dynamic range 2^(8 + n - 1).  Takes about 15 s.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from camctl.exposure.evaluation import evaluate
from camctl.exposure.lower_bound import certify
from camctl.exposure.solver import solve
from camctl.model.response.camera import linear_response
from camctl.model.response.desired import DesiredResponse

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "helpers"))
from cells import CELLS

CAMERA = linear_response(8)


def quality(exposures: Sequence[float], desired: DesiredResponse) -> str:
    """Return xi and effective levels as two columns."""
    found = evaluate(CAMERA, desired, exposures)
    return f"{found.xi:.2f} | {found.effective_levels:.0f}"


def main() -> None:
    """Print the rows; the first exposure of each set, 1, is left out."""
    print("| response | n | printed | xi | eff. | found | xi | eff. | lower bound | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for cell in CELLS:
        desired, n = cell.desired, cell.n
        found = solve(CAMERA, desired, n)
        bound = f"{certify(CAMERA, desired, n).lower_bound:.2f}" if n == 2 else ""
        printed_set = ", ".join(f"{e:g}" for e in cell.printed[1:])
        found_set = ", ".join(f"{e:.6g}" for e in found.exposures[1:])
        print(
            f"| {cell.response} | {n} | {printed_set} | {quality(cell.printed, desired)} "
            f"| {found_set} | {quality(found.exposures, desired)} "
            f"| {bound} | {found.seconds:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
