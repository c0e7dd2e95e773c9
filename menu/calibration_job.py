"""Calibration from the menu: the steps of ``camctl calibrate all``, and the dark signal."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing

from camctl.calibrate import dark
from camctl.calibration.steps import OpenCamera, StepOptions, StepResult, calibrate, dark_text
from camctl.errors import InterruptedCaptureError
from camctl.findings import Finding
from camctl.interface.clock import cancelled_by
from camctl.menu.data import Calibrated, Progress
from camctl.messages.menu import finding_text, with_entries


def measure(
    open_camera: OpenCamera,
    scene: str,
    on_progress: Callable[[Progress], None],
    cancelled: Callable[[], bool],
) -> Calibrated:
    """Measure a camera before a "still" scene, or with its lens "covered"; keep the results.

    Args:
        open_camera: opens the camera with parts of its profile
        scene: "still": delay, response, exposures and noise; "covered": the dark signal
        on_progress: called with the step, the share of it that is done, and the results so far
        cancelled: returns True once the calibration is to end

    Raises:
        InterruptedCaptureError: it was cancelled; what was measured until then is kept
        CamctlError: as `camctl.calibration.steps.calibrate` and `camctl.calibrate.dark` raise
    """
    lines: list[str] = []

    def stop_if_cancelled() -> None:
        if cancelled():
            raise InterruptedCaptureError("the calibration was cancelled")

    def begin(name: str) -> Callable[[float], None]:
        def tell(share: float) -> None:
            stop_if_cancelled()
            on_progress(Progress(0, 1, name, share, tuple(lines)))

        tell(0.0)
        return tell

    def warn(finding: Finding) -> None:
        lines.append(finding_text(finding))

    with cancelled_by(cancelled):
        if scene == "covered":
            with open_camera("none") as camera:
                found = dark(camera, progress=begin("dark signal")).save()
            assert found.dark is not None  # it was measured
            return Calibrated((f"dark signal: {dark_text(found.dark)}",))
        steps = calibrate(open_camera, StepOptions(begin=begin, warn=warn))
        with closing(steps):  # type: ignore[type-var]  # it is a generator
            for step in steps:
                stop_if_cancelled()  # a step that was cancelled says that it failed
                lines.append(_text(step))
    stop_if_cancelled()
    return Calibrated(tuple(lines))


def _text(step: StepResult) -> str:
    """Return what a step has measured, or why it has not."""
    if step.result is not None:
        return f"{step.name}: {step.result}"
    text = f"{step.name}: not measured, because {step.problem}; {step.hint}"
    return with_entries(text, step.remedies)
