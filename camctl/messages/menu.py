"""Findings and errors on a front panel: the plain sentence, and the entry of the menu that helps.

What the menu cannot do, such as a calibration, is in the sentence alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from camctl.errors import CamctlError

if TYPE_CHECKING:
    from camctl.findings import Finding

ENTRIES: Final[dict[str, str]] = {
    "accuracy": "Time / accuracy",
    "cameras": "Camera",
    "count": "Exposures",
    "dynamic_range": "Dynamic range",
    "mains_hz": "Settings, Lamps",
    "response": "Desired response",
    "resume": "Captures",
    "spend_shutter": "Settings, Shots for metering",
    "time_budget_s": "Time budget",
}
"""The list of the menu for each remedy that has one, see `camctl.findings.Finding.remedies`."""

VALUES: Final[dict[tuple[str, Any], str]] = {
    ("dynamic_range", "auto"): "Auto",
    ("response", "log"): "Constant contrast",
    ("response", "linear"): "Linear",
    ("response", "gamma"): "Gamma 1/2",
    ("response", "auto"): "Auto",
}
"""What these lists call the values of remedies that they have an entry for."""


def finding_text(finding: Finding) -> str:
    """Return the finding with the entries of the menu that help."""
    from camctl.messages.plain import sentence  # loads pydantic

    return with_entries(sentence(finding), finding.remedies)


def error_text(error: CamctlError) -> str:
    """Return what went wrong and what to do, with the entries of the menu that help."""
    return with_entries(str(error), error.remedies)


def with_entries(text: str, remedies: Mapping[str, Any]) -> str:
    """Return a text with the entries of the menu that remedy what it says."""
    found = [_entry(name, value) for name, value in remedies.items() if name in ENTRIES]
    return f"{text} (menu: {'; '.join(found)})" if found else text


def _entry(name: str, value: Any) -> str:
    label = VALUES.get((name, value)) if isinstance(value, str) else None
    return ENTRIES[name] if label is None else f"{ENTRIES[name]}, {label}"
