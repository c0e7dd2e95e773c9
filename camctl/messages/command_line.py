"""Findings and errors on the command line: the plain sentence, and the options that help."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, Final

from camctl.errors import CamctlError

if TYPE_CHECKING:
    from camctl.findings import Finding

OPTIONS: Final[dict[str, str]] = {
    "accuracy": "--accuracy",
    "align": "--align",
    "base_s": "--base",
    "black": "--black",
    "clip_percent": "--clip",
    "compensation_stops": "--compensation",
    "count": "-n",
    "curve": "--curve",
    "deghost": "--deghost",
    "desired_curve": "--response",
    "directory": "-o",
    "dynamic_range": "--range",
    "estimate_ratios": "--estimate-ratios",
    "fps": "--fps",
    "gamma": "--gamma",
    "is_flat": "--flat",
    "keep": "--keep",
    "labels": "--labels",
    "levels_wanted": "--set levels=",
    "longest_s": "--longest",
    "mains_hz": "--set mains=",
    "mask": "--mask",
    "method": "--method",
    "methods": "--methods",
    "objective": "--set objective=",
    "overwrite": "--force",
    "patches": "--patches",
    "ratios": "--ratios",
    "response": "--response",
    "spend_shutter": "--meter",
    "table": "--set table=",
    "time_budget_s": "--time-budget",
    "times": "--times",
    "tolerance": "--set tolerance=",
    "white": "--white",
}
"""The option of each remedy that is one, see `camctl.findings.Finding.remedies`.

Fields of a request that are settings of --set are options of their own in some other commands."""

PLACEHOLDERS: Final[dict[str, str]] = {
    "accuracy": "LEVELS",
    "base_s": "SECONDS",
    "black": "DN",
    "clip_percent": "PERCENT",
    "compensation_stops": "STOPS",
    "count": "N",
    "curve": "FILE",
    "desired_curve": "FILE",
    "directory": "PATH",
    "dynamic_range": "NUMBER",
    "fps": "RATE",
    "gamma": "Q",
    "labels": "dial|exact",
    "levels_wanted": "G",
    "longest_s": "SECONDS",
    "mains_hz": "HZ",
    "mask": "FILE",
    "method": "NAME",
    "methods": "NAME,...",
    "objective": "NAME",
    "patches": "FILE",
    "ratios": "A,B,...",
    "response": "NAME",
    "table": "FILE",
    "time_budget_s": "SECONDS",
    "times": "SECONDS,...",
    "tolerance": "X",
    "white": "DN",
}
"""What stands for the value of these options, as in their help."""

COMMANDS: Final[dict[str, str]] = {
    "calibrate_all": "camctl calibrate all --camera {}",
    "calibrate_dark": "camctl calibrate noise --dark",
    "calibrate_delay": "camctl calibrate delay --camera {}",
    "calibrate_exposure": "camctl calibrate exposure --camera {}",
    "calibrate_flat": "camctl calibrate noise --flat",
    "calibrate_noise": "camctl calibrate noise --camera {}",
    "calibrate_response": "camctl calibrate response --camera {}",
    "cameras": "camctl cameras",
    "probe_ports": "camctl cameras --probe",
    "profile_remove": "camctl profile remove {}",
    "resume": "camctl resume {}",
    "shoot": "camctl shoot -o {}",
    "table_build": "camctl table build",
    "udev_rules": "camctl cameras --udev-rules | sudo tee /etc/udev/rules.d/70-camctl.rules"
    " && sudo udevadm control --reload",
}
"""The command of each remedy that is one; {} stands for its value, and an option that has none is
left out."""

CAMERA_OPTION: Final = "option:"
"""Beginning of the name of a remedy that is an option of the camera: "option:format"."""


def finding_line(finding: Finding) -> str:
    """Return the finding as one line with the options that help."""
    from camctl.messages.plain import sentence  # loads pydantic

    return with_remedies(sentence(finding), finding.remedies)


def finding_lines(findings: Iterable[Finding]) -> list[str]:
    """Return findings as lines, one for those that say the same of several files."""
    from camctl.messages.plain import sentences

    return [with_remedies(*each) for each in sentences(findings)]


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
        return f"{option}..." if value is None else option + word(_text(value))
    if name in COMMANDS:
        command = COMMANDS[name]
        if value is None:
            return command.partition(" --camera {}")[0]
        place, *camera = value if isinstance(value, tuple) else (value,)
        of = f" --camera {word(camera[0])}" if camera else ""
        return command.format(word(str(place))) + of
    option = OPTIONS[name]
    if value is False:
        return f"without {option.removesuffix('=')}"
    if value is None:
        text = PLACEHOLDERS.get(name, "")
    else:
        text = "" if value is True else word(_text(value))
    return f"{option}{'' if option.endswith('=') else ' '}{text}".rstrip()


def _text(value: Any) -> str:
    """Return a value as the command line takes it."""
    if isinstance(value, float):
        return f"{value:.6g}"
    return ",".join(map(_text, value)) if isinstance(value, tuple | list) else str(value)


def word(text: str) -> str:
    r"""Return a text as one word for a shell, also one that is not UTF-8 (in bash).

    >>> print(word("hall"), word("red hall"), word("caf\udce9"))
    hall 'red hall' $'caf\xe9'
    """
    if text.isprintable():
        return shlex.quote(text)
    codes = "".join(
        chr(byte) if 32 <= byte < 127 and byte not in b"\\'" else f"\\x{byte:02x}"
        for byte in os.fsencode(text)
    )
    return f"$'{codes}'"
