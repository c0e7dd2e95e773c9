"""For tests of cameras and of programs that use them: conformance suite and pytest plugin.

`CameraConformance` checks a camera; see `camctl.testing.conformance`.  The fixture `camctl_camera`
is a simulated camera; see `camctl.testing.plugin`.  The package needs pytest.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from camctl.testing.conformance import CameraConformance as CameraConformance

__all__ = ["CameraConformance"]

if not TYPE_CHECKING:  # lazy, since pytest imports this package with the plugin, in every run

    def __getattr__(name: str) -> object:
        """Import the conformance suite, and numpy with it, when it is used (PEP 562)."""
        if name != "CameraConformance":
            raise AttributeError(f"module 'camctl.testing' has no attribute '{name}'")
        from camctl.testing.conformance import CameraConformance

        return CameraConformance
