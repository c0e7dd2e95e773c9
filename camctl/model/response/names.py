"""Names of desired responses and of dynamic ranges; they are imported without any mathematics."""

from __future__ import annotations

RESPONSES: tuple[str, ...] = ("linear", "gamma", "log")
RANGES: dict[str, float] = {"low": 256.0, "medium": 1000.0, "high": 16000.0}
