"""`camctl calibrate all`: everything that can be measured of a camera, before one scene."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import ExitStack
from typing import TYPE_CHECKING

import click

from camctl.cli import options
from camctl.cli.commands import command
from camctl.cli.options import CameraOptions
from camctl.cli.output import (
    print_error,
    print_finding,
    print_json,
    print_text,
    progress_bar,
    without_stage,
)
from camctl.messages.calibration import COVERED, STILL_SCENE

if TYPE_CHECKING:
    from camctl.calibration.steps import StepResult
    from camctl.findings import Finding
    from camctl.profiles.noise import NoiseRecord

#: How a pattern of the pixels, which stays, is separated from the scene, which does not.
_TURN = (
    "Last step: uncover the lens, turn the camera a little, by about a tenth of the picture, and "
    "fix it again. What then stays in the pictures is how the pixels differ. Answer n if it cannot "
    "be turned."
)
#: What depends on the picture, so that no calibration can predict it.
_NEVER = "smear, blooming and glare"
_NO_PRNU = (
    "differences between the pixels (camctl calibrate noise --flat, or turn the camera when camctl "
    "calibrate all asks for it in a terminal)"
)
_NO_DARK = (
    "dark signal and hot pixels (camctl calibrate noise --dark, or cover the lens when camctl "
    "calibrate all asks for it in a terminal)"
)


@command(
    examples=(
        ("camctl calibrate all --camera v4l2:/dev/video0", "a webcam before any still scene"),
        (
            "camctl calibrate all --sensor consumer -O unknown=yes",
            "a simulated one",
        ),
    ),
)
@options.camera_options
@options.longest()
@options.as_json
def all(camera: CameraOptions, longest_s: float, as_json: bool) -> None:
    """Measure control delay, response, true exposures, noise and pixels, one after the other.

    Point the camera at a scene that does not move, with dark and bright parts and many shades
    between, in steady light. Each result is kept in the camera's profile, which later captures use
    without being asked. What cannot be measured is named with what to do; the rest is measured all
    the same. At the end, in a terminal, you are asked to cover the lens, for the dark signal, and
    then to uncover it and to turn the camera a little (one view cannot show how the pixels differ,
    two can). Otherwise measure these with camctl calibrate noise --flat and --dark.
    """
    from camctl.calibration.results import StepsResult
    from camctl.calibration.steps import StepOptions, calibrate
    from camctl.errors import CaptureError
    from camctl.profiles.exposures import exposure_mode
    from camctl.profiles.profile import load_profile

    with camera.open(profile="none") as opened:
        info, mode = opened.info, exposure_mode(opened.controls)
    for number, line in enumerate(() if as_json else STILL_SCENE, start=1):
        print_error(f"{number}. {line}")
    is_interactive = not as_json and sys.stdin.isatty() and sys.stderr.isatty()
    if is_interactive:
        click.pause("Press any key when all is ready ...", err=True)
    done: list[StepResult] = []
    findings: list[Finding] = []

    def warn(finding: Finding) -> None:
        print_finding(finding)
        findings.append(finding)

    with ExitStack() as bars:

        def begin(name: str) -> Callable[[float], None] | None:
            bars.close()
            return without_stage(bars.enter_context(progress_bar(name)))

        def asked(what: str, question: str) -> Callable[[], bool] | None:
            def ask() -> bool:
                bars.close()
                print_error(what)
                return click.confirm(question, default=True, err=True)

            return ask if is_interactive else None

        cover = asked(f"{COVERED} Answer n if it cannot be covered.", "Is the lens covered?")
        turn = asked(_TURN, "Is the lens uncovered, and has the camera been turned?")
        how = StepOptions(longest_s, begin, warn, cover, turn)
        for step in calibrate(lambda parts: camera.open(profile=parts), how):
            bars.close()
            done.append(step)
            if not as_json:
                print_text(_line(step))
    name = load_profile(info).name
    if as_json:
        result = StepsResult(
            camera=info, mode=mode, steps=tuple(done), name=name, findings=tuple(findings)
        )
        print_json(result.model_dump(mode="json", exclude={"file"}))
    elif any(step.result for step in done):
        print_text(f"kept in the profile {name} for the mode {mode}; see camctl profile show")
        print_text(_missing(load_profile(info).noises.get(mode)))
    if not any(step.result for step in done):
        raise CaptureError("nothing could be measured", hint="change the scene as said above")


def _missing(noise: NoiseRecord | None) -> str:
    """Return what is not in the predicted levels, and how it is measured."""
    missing = [_NEVER]
    if noise is None or noise.dark is None:
        missing.insert(0, _NO_DARK)
    if noise is None or noise.prnu is None:
        missing.insert(0, _NO_PRNU)
    return f"not in the predicted levels: {', '.join(missing)}"


def _line(step: StepResult) -> str:
    if step.result is not None:
        return f"{step.name}: {step.result}"
    from camctl.messages.command_line import with_remedies

    hint = with_remedies(step.hint, step.remedies)
    return f"{step.name}: not measured, because {step.problem}; {hint}"
