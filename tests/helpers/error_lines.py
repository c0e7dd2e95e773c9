"""What every error of a camera has in common."""

from __future__ import annotations

from camctl.errors import CamctlError


def one_line(error: CamctlError) -> str:
    """Return the text of an error that is one line with a next step."""
    assert error.hint
    assert "\n" not in str(error)
    return str(error)
