"""The exposures printed by Grossberg and Nayar, and the best sets known for the same cells.

Figure 4a of the paper, an 8-bit linear camera with G = n * 255 and DR = 2^(7 + n).  Each cell:
response, printed exposures, their xi, the best known xi, its exposures, xi of 1, 2, 4, ...
"""

from __future__ import annotations

from typing import NamedTuple

from camctl.model.response.desired import DesiredResponse, desired_response


class Cell(NamedTuple):
    """One response and number of exposures of the paper's table."""

    response: str
    printed: tuple[float, ...]
    printed_xi: float
    best_xi: float
    best: tuple[float, ...]
    doubling_xi: float

    @property
    def n(self) -> int:
        return len(self.printed)

    @property
    def desired(self) -> DesiredResponse:
        return desired_response(self.response, 2.0 ** (7 + self.n))

    @property
    def levels_wanted(self) -> float:
        return self.n * 255.0


# fmt: off
CELLS = [
    Cell("linear", (1, 1.003), 106.21, 105.13, (1, 1.00278), 127.50),
    Cell("linear", (1, 1.003, 2.985), 177.51, 175.60, (1, 1.00277, 2.98497), 318.31),
    Cell("linear", (1, 1.015, 1.019, 3.672), 305.57, 237.07,
         (1, 1.00308, 1.00617, 3.96265), 509.37),
    Cell("linear", (1, 1.003, 1.007, 1.166, 4.975), 379.43, 300.43,
         (1, 1.002, 1.003413, 1.005418, 4.949504), 731.90),
    Cell("linear", (1, 1.003, 1.007, 1.031, 1.078, 5.636), 473.85, 365.21,
         (1, 1.001846, 1.003531, 1.005219, 1.007082, 5.980678), 954.91),
    Cell("gamma", (1, 3.094), 114.79, 114.74, (1, 3.0926), 144.72),
    Cell("gamma", (1, 1.003, 5.146), 175.92, 175.86, (1, 1.00305, 5.14514), 267.41),
    Cell("gamma", (1, 1.003, 3.019, 11.23), 244.08, 236.39, (1, 1.0031, 1.00622, 7.82399), 401.03),
    Cell("gamma", (1, 1.003, 1.006, 5.049, 18.56), 299.13, 298.10,
         (1, 1.0029, 1.0058, 4.0375, 17.1949), 545.44),
    Cell("gamma", (1, 1.003, 1.006, 2.866, 8.564, 33.7), 395.00, 370.62,
         (1, 1.00199, 1.00355, 1.00555, 4.03479, 18.47144), 705.87),
    Cell("log", (1, 20.24), 179.98, 179.92, (1, 21.7329), 279.26),
    Cell("log", (1, 9.91, 88.38), 219.84, 219.81, (1, 9.9099, 88.3854), 409.77),
    Cell("log", (1, 4.689, 37.23, 280), 270.41, 262.24, (1, 6.045, 42.6326, 257.7143), 522.60),
    Cell("log", (1, 4.831, 29.18, 144.9, 763.5), 318.82, 308.12,
         (1, 4.0262, 20.2624, 104.0075, 523.438), 628.49),
    Cell("log", (1, 3.979, 16.01, 64.22, 305.4, 1130), 379.28, 354.89,
         (1, 3.0177, 15.1776, 61.0687, 307.1448, 1235.8301), 733.94),
]
# fmt: on
