"""Real and desired responses, under one name."""

from camctl.exposure.curves import read_curve, read_desired, tabulated_response
from camctl.exposure.desired import (
    RANGES,
    RESPONSES,
    DesiredResponse,
    desired_response,
    tabulated_desired,
)
from camctl.exposure.real import FloatArray, RealResponse, linear_response

__all__ = [
    "RANGES",
    "RESPONSES",
    "DesiredResponse",
    "FloatArray",
    "RealResponse",
    "desired_response",
    "linear_response",
    "read_curve",
    "read_desired",
    "tabulated_desired",
    "tabulated_response",
]
