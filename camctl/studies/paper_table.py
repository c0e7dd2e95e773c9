"""The table printed in figure 4(a) of Grossberg and Nayar."""

from __future__ import annotations

PRINTED_TABLE: dict[tuple[str, int], tuple[float, ...]] = {
    ("linear", 2): (1, 1.003),
    ("linear", 3): (1, 1.003, 2.985),
    ("linear", 4): (1, 1.015, 1.019, 3.672),
    ("linear", 5): (1, 1.003, 1.007, 1.166, 4.975),
    ("linear", 6): (1, 1.003, 1.007, 1.031, 1.078, 5.636),
    ("gamma", 2): (1, 3.094),
    ("gamma", 3): (1, 1.003, 5.146),
    ("gamma", 4): (1, 1.003, 3.019, 11.23),
    ("gamma", 5): (1, 1.003, 1.006, 5.049, 18.56),
    ("gamma", 6): (1, 1.003, 1.006, 2.866, 8.564, 33.7),
    ("log", 2): (1, 20.24),
    ("log", 3): (1, 9.91, 88.38),
    ("log", 4): (1, 4.689, 37.23, 280),
    ("log", 5): (1, 4.831, 29.18, 144.9, 763.5),
    ("log", 6): (1, 3.979, 16.01, 64.22, 305.4, 1130),
}
"""Printed exposures by desired response (gamma is 1/2) and number of exposures."""
