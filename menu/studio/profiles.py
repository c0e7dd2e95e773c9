"""The section *Settings*: what is kept of the measurements of each camera, with plots."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

from camctl.errors import UsageError
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request
from camctl.menu.studio.studio import Studio

_DRAWING = threading.Lock()
"""matplotlib draws one plot at a time."""


def profiles(studio: Studio, request: Request) -> Answer:
    """Return the cameras that have a profile, and what was measured in each mode."""
    from camctl.profiles.folder import list_profiles

    return Answer.of(
        [
            {
                "name": each.name,
                "camera": f"{each.make} {each.model}".strip(),
                "response": sorted(each.responses),
                "noise": sorted(each.noises),
                "exposures": sorted(each.exposures),
                "control delay": sorted(each.delays),
            }
            for each in list_profiles()
        ]
    )


def plot(studio: Studio, request: Request) -> Answer:
    """Return the plots of a profile: ``settings/plot/NAME``."""
    from camctl.calibration.plots import draw_profile
    from camctl.profiles.folder import find_profile

    try:
        profile = find_profile(request.rest)
    except UsageError:
        raise RefusedError(NOT_FOUND, "there is no such profile") from None
    with _DRAWING, tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "profile.png"
        draw_profile(profile, path)
        return Answer(path.read_bytes(), "image/png")
