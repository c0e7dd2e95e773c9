"""A studio whose menu runs in a thread."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import Camera
from camctl.menu.app import run
from camctl.menu.camera_job import CameraJob
from camctl.menu.ports import Job
from camctl.menu.studio.panel import StudioPanel

MakeJob = Callable[[StudioPanel], Job]


def start_menu(parent: Path, make_job: MakeJob) -> tuple[StudioPanel, threading.Thread]:
    """Return a studio that serves its page, and the thread of its menu."""
    panel = StudioPanel(parent, "0", token="")
    menu = threading.Thread(target=run, args=(panel, lambda: make_job(panel)), daemon=True)
    menu.start()
    while not panel.is_open:
        time.sleep(0.005)
    return panel, menu


def job_with(open_camera: Callable[[], Camera], **request: Any) -> MakeJob:
    """Return what makes a job with a camera."""

    def make(panel: StudioPanel) -> Job:
        settings, wanted = panel.parent / "menu.json", CaptureRequest(**request)
        return CameraJob(
            lambda _: (open_camera(), {}), panel.parent, settings, request=wanted, sight=panel.sight
        )

    return make
