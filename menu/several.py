"""The same plan on several cameras at once: a thread each, and the first frames together."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from camctl.errors import CamctlError, CameraError, CaptureError, UsageError
from camctl.exposure.goal import AUTO, CaptureRequest
from camctl.interface.camera import Camera
from camctl.menu.capture_list import next_folder
from camctl.menu.data import Progress, Summary
from camctl.menu.views import progress_view, summary_view

if TYPE_CHECKING:  # the idle menu does not load what captures are made with
    from camctl.captures.sequence import Progress as CaptureProgress
    from camctl.records.capture_plan import CapturePlan


@dataclass(frozen=True)
class Take:
    """What one camera shoots."""

    camera: Camera
    source: Mapping[str, Any]
    plan: CapturePlan
    request: CaptureRequest


class _OtherFailedError(CaptureError):
    """A camera did not begin, since another one could not."""


class Others:
    """The cameras beside the first one, whose plan they follow."""

    def __init__(self) -> None:
        self._opened: list[tuple[Camera, Mapping[str, Any]]] = []

    @property
    def cameras(self) -> tuple[Camera, ...]:
        return tuple(camera for camera, _ in self._opened)

    def open(
        self,
        camera_ids: Sequence[str],
        open_camera: Callable[..., tuple[Camera, Mapping[str, Any]]],
    ) -> None:
        for each in camera_ids:
            self._opened.append(open_camera(each))

    def close(self) -> None:
        """Close all; errors of one that was unplugged are left out."""
        opened, self._opened = self._opened, []
        for camera, _ in opened:
            with suppress(CameraError):
                camera.close()

    def takes(self, made: CapturePlan, request: CaptureRequest) -> tuple[Take, ...]:
        """Return what each has to shoot: the exposures that the first one was planned for.

        Raises:
            UsageError: a camera cannot shoot them, or the response follows the light of each
        """
        if not self._opened:
            return ()
        if request.response == AUTO:
            raise UsageError(
                "an automatic response follows the light of one camera",
                hint="choose a response for several",
                remedies={"response": "log"},
            )
        same = CaptureRequest(
            made.response,
            made.dynamic_range,
            gamma=made.gamma,
            ratios=made.exposures,
            base_s=made.base_s,
            use_aperture=request.use_aperture,
            estimate_ratios=request.estimate_ratios,
            deghost=request.deghost,
        )
        return tuple(_take(camera, source, same) for camera, source in self._opened)


def _take(camera: Camera, source: Mapping[str, Any], request: CaptureRequest) -> Take:
    from camctl.captures.plan import plan_capture

    try:
        return Take(camera, source, plan_capture(camera, request), request)
    except (UsageError, CaptureError) as error:
        raise UsageError(
            f"{camera.info.name} cannot shoot this plan: {error.what}", hint=error.hint
        ) from error


def take_together(
    takes: Sequence[Take],
    parent: Path,
    on_progress: Callable[[Progress], None],
    cancelled: Callable[[], bool],
) -> Summary:
    """Shoot with all cameras at once, each into a folder of its own.

    No camera begins before all are ready, and none where one of them fails until then.  What fails
    later ends its own capture alone.

    Returns:
        the result of the first camera that has one, with what became of the others as notes

    Raises:
        CamctlError: all failed; that of the first camera
    """
    from camctl.captures.sequencer import capture

    now = datetime.now()
    folders = [next_folder(parent, now, place=place) for place in range(len(takes))]
    ready = threading.Barrier(len(takes))
    latest: dict[int, Progress] = {}

    def shoot(index: int) -> Summary | CamctlError:
        take, is_ready = takes[index], False

        def report(progress: CaptureProgress) -> None:
            nonlocal is_ready
            latest[index] = progress_view(progress)
            if len(latest) == len(takes):
                on_progress(min(latest.values(), key=lambda each: each.share))
            if progress.stage == "shooting" and not is_ready:
                is_ready = True
                try:
                    ready.wait()  # nothing that takes time comes between it and the first frame
                except threading.BrokenBarrierError:
                    raise _OtherFailedError("another camera has failed") from None

        try:
            made = capture(
                take.camera,
                take.request,
                folders[index],
                plan=take.plan,
                source=take.source,
                progress=report,
                cancelled=cancelled,
            )
        except CamctlError as error:
            return error
        finally:
            if not is_ready:
                ready.abort()
        return summary_view(made, folders[index])

    with ThreadPoolExecutor(len(takes), thread_name_prefix="camctl-camera") as threads:
        results = list(threads.map(shoot, range(len(takes))))
    done = [each for each in results if isinstance(each, Summary)]
    failed = [each for each in results if isinstance(each, CamctlError)]
    if not done:
        raise next(each for each in failed if not isinstance(each, _OtherFailedError))
    notes = [
        f"{take.camera.info.name}: {result}"
        if isinstance(result, CamctlError)
        else f"{take.camera.info.name}: {result.effective_levels:.0f} levels, in {folder.name}"
        for take, result, folder in zip(takes, results, folders, strict=True)
        if result is not done[0]
    ]
    return replace(done[0], notes=(*notes, *done[0].notes))
