"""The DRM panel where there is no display; the virtual machine has one (--display)."""

from __future__ import annotations

import errno
import os
from pathlib import Path
from typing import Any

import pytest

from camctl.errors import CamctlError, UsageError
from camctl.menu.panels import drm, drm_kernel
from camctl.menu.panels.drm import DrmPanel
from camctl.menu.ports import PanelDisconnectedError


def test_device_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(
        CamctlError, match=r"cannot use .*/card0: No such file or directory; connect"
    ):
        DrmPanel(f"{tmp_path}/card0").__enter__()


def test_device_of_another_kind_is_refused() -> None:
    with pytest.raises(UsageError, match="/dev/null is no graphics device"):
        DrmPanel("/dev/null").__enter__()


@pytest.mark.parametrize(
    ("error", "kind", "message"),
    [
        (LookupError("none"), PanelDisconnectedError, "no display is connected to card"),
        (PermissionError(errno.EACCES, "Permission denied"), CamctlError, "end the desktop"),
        (OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP)), CamctlError, "not supported"),
    ],
)
def test_display_that_cannot_be_used_says_why(
    monkeypatch: pytest.MonkeyPatch, error: Exception, kind: type[CamctlError], message: str
) -> None:
    def fail(path: str) -> Any:
        raise error

    monkeypatch.setattr(drm, "DrmDisplay", fail)
    with pytest.raises(kind, match=message):
        DrmPanel("card").__enter__()


@pytest.mark.parametrize(
    ("structure", "size"),
    [
        ("_Resources", 64),
        ("_Crtc", 104),
        ("_Encoder", 20),
        ("_Connector", 80),
        ("_Mode", 68),
        ("_Fb", 28),
        ("_Dirty", 24),
        ("_Dumb", 32),
        ("_Map", 16),
    ],
)
def test_structures_have_the_sizes_of_the_kernel(structure: str, size: int) -> None:
    """The size is part of a request's number (drm/drm_mode.h)."""
    import ctypes

    assert ctypes.sizeof(getattr(drm_kernel, structure)) == size
