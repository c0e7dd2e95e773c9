"""Findings and errors on the command line: the plain sentence, and the options that help."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from typing import Any, Final

from camctl.errors import CamctlError
from camctl.findings import Finding
from camctl.messages.plain import sentence

OPTIONS: Final[dict[str, str]] = {
    "accuracy": "--accuracy",
    "base_s": "--base",
    "clip_percent": "--clip",
    "compensation_stops": "--compensation",
    "count": "-n",
    "dynamic_range": "--range",
    "estimate_ratios": "--estimate-ratios",
    "levels_wanted": "--levels",
    "objective": "--objective",
    "ratios": "--ratios",
    "response": "--response",
    "spend_shutter": "--meter",
    "table": "--table",
    "time_budget_s": "--time-budget",
}
"""The option of each remedy that is one, see `camctl.findings.Finding.remedies`."""

COMMANDS: Final[dict[str, str]] = {
    "calibrate_delay": "camctl calibrate delay",
}
"""The command of each remedy that is one; its value, if any, is the id of the camera."""

CAMERA_OPTION: Final = "option:"
"""Beginning of the name of a remedy that is an option of the camera: "option:format"."""


def finding_line(finding: Finding) -> str:
    """Return the finding as one line with the options that help."""
    return with_remedies(sentence(finding), finding.remedies)


def error_hint(error: CamctlError) -> str:
    """Return what to do after an error, with the options that help; empty where nothing is."""
    return with_remedies(error.hint, error.remedies)


def with_remedies(text: str, remedies: Mapping[str, Any]) -> str:
    """Return a sentence with options in brackets behind it."""
    found = ", ".join(_remedy(name, value) for name, value in remedies.items())
    return f"{text} ({found})".strip() if found else text


def _remedy(name: str, value: Any) -> str:
    """Return the option or the command of a remedy, as it is typed."""
    if name.startswith(CAMERA_OPTION):
        option = f"-O {name.removeprefix(CAMERA_OPTION)}="
        return f"{option}..." if value is None else option + shlex.quote(_text(value))
    if name in COMMANDS:
        camera = "" if value is None else f" --camera {shlex.quote(str(value))}"
        return COMMANDS[name] + camera
    option = OPTIONS[name]
    return option if value is None or value is True else f"{option} {shlex.quote(_text(value))}"


def _text(value: Any) -> str:
    """Return a value as the command line takes it."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return ",".join(map(_text, value)) if isinstance(value, tuple | list) else str(value)
