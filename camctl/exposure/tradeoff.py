"""What each number of exposures would give and cost, before anything is shot."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from camctl.exposure.lookup import look_up
from camctl.response.camera import CameraResponse
from camctl.response.desired import DesiredResponse


@dataclass(frozen=True)
class Choice:
    """One point of accuracy against time.

    Attributes:
        n: number of exposures
        exposures: relative, ascending from 1
        total_exposure: their sum: shutter time in units of the shortest
        xi: wanted levels that are missing, of n * M
        effective_levels: L, how many equal steps would be as accurate
    """

    n: int
    exposures: tuple[float, ...]
    total_exposure: float
    xi: float
    effective_levels: float


def predict(
    real: CameraResponse,
    desired: DesiredResponse,
    counts: Iterable[int] = range(1, 7),
    *,
    progress: Callable[[float], None] | None = None,
) -> tuple[Choice, ...]:
    """Return a row for each number of exposures, from the table or solved and cached.

    `progress` is called with the share done, 0 to 1.  Raises what `look_up` raises.
    """
    numbers = list(counts)
    rows: list[Choice] = []
    for n in numbers:
        entry = look_up(real, desired, n)
        rows.append(
            Choice(n, entry.exposures, entry.total_exposure, entry.xi, entry.effective_levels)
        )
        if progress is not None:
            progress(len(rows) / len(numbers))
    return tuple(rows)
