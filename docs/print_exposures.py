"""Print the paper's table of exposures beside the solver's: the table of docs/exposures.md.

    python docs/print_exposures.py

8-bit linear camera, G = n * 255 wanted levels, dynamic range 2^(8 + n - 1).  Takes about a minute.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from camctl.exposure.effective import EffectiveCamera, effective_levels
from camctl.exposure.lower_bound import certify
from camctl.exposure.objective import xi
from camctl.exposure.solver import solve
from camctl.response.camera import linear_response
from camctl.response.desired import DesiredResponse

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "exposure"))
from cells import CELLS

CAMERA = linear_response(8)


def worth(exposures: Sequence[float], desired: DesiredResponse, wanted: float) -> str:
    """Return xi and effective levels as two columns."""
    camera = EffectiveCamera.of(CAMERA, exposures)
    return f"{xi(camera, desired, wanted):.2f} | {effective_levels(camera, desired):.0f}"


def main() -> None:
    """Print the rows; the first exposure, 1, is left out of each set."""
    print("| response | n | printed | xi | eff. | found | xi | eff. | no set is below | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for cell in CELLS:
        desired, wanted, n = cell.desired, cell.levels_wanted, cell.n
        found = solve(CAMERA, desired, n)
        bound = certify(CAMERA, desired, n).lower_bound if n == 2 else 0.0
        printed_set = ", ".join(f"{e:g}" for e in cell.printed[1:])
        found_set = ", ".join(f"{e:.6g}" for e in found.exposures[1:])
        print(
            f"| {cell.response} | {n} | {printed_set} | {worth(cell.printed, desired, wanted)} "
            f"| {found_set} | {worth(found.exposures, desired, wanted)} "
            f"| {f'{bound:.2f}' if bound else ''} | {found.seconds:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
