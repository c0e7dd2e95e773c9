"""The job behind the menu, done with a camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from camctl.camera import Camera
from camctl.captures.plan import plan_capture
from camctl.captures.request import CapturePlan, CaptureRequest
from camctl.captures.sequencer import Progress, capture
from camctl.errors import CaptureError
from camctl.exposure.tradeoff import predict
from camctl.response.desired import desired_response
from menu.ports import Choice, Cost, Summary

COUNTS = range(1, 7)


class CameraJob:
    """A `menu.ports.Job` on an open camera.

    `new_folder` is asked for the folder of each capture; `request` holds what the menu does not
    ask, such as the frequency of the mains; `source` is what a report keeps so that the camera can
    be opened again.
    """

    def __init__(
        self,
        camera: Camera,
        new_folder: Callable[[], Path],
        *,
        request: CaptureRequest | None = None,
        source: Mapping[str, Any] | None = None,
    ) -> None:
        self._camera = camera
        self._new_folder = new_folder
        self._request = replace(request or CaptureRequest(), ratios=None)
        self._source = source

    def predict(self, response: str, dynamic_range: float) -> Iterator[Cost]:
        """Yield what one to six exposures cost, with the levels of this camera."""
        desired = desired_response(response, dynamic_range)
        for count in COUNTS:
            for row in predict(self._camera.controls.levels, desired, [count]):
                yield Cost(row.n, row.exposures, row.total_exposure, row.effective_levels)

    def plan(self, choice: Choice) -> CapturePlan:
        """Meter, look up, and choose among the settings that the camera has."""
        return plan_capture(
            self._camera, self._asked(choice.response, choice.dynamic_range, choice.count)
        )

    def shoot(
        self,
        plan: CapturePlan,
        on_progress: Callable[[Progress], None],
        cancelled: Callable[[], bool],
    ) -> Summary:
        """Shoot the settings of `plan` into a new folder."""
        folder = self._new_folder()
        report = capture(
            self._camera,
            self._asked(plan.response, plan.dynamic_range, len(plan.settings)),
            folder,
            plan=plan,
            source=self._source,
            progress=on_progress,
            cancelled=cancelled,
        )
        if report.achieved is None:
            raise CaptureError(
                f"{folder} holds no picture", hint=f"complete it: camctl shoot --resume {folder}"
            )
        return Summary(
            effective_levels=report.achieved.effective_levels,
            saturated=report.achieved.saturated_fraction,
            folder=str(folder),
            notes=tuple(report.warnings),
        )

    def _asked(self, response: str, dynamic_range: float, count: int) -> CaptureRequest:
        return replace(self._request, response=response, dynamic_range=dynamic_range, count=count)
