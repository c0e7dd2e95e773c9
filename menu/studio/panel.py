"""The studio as a panel of the menu: a server of the page.

Without a token the server listens on the loopback interface only.  A token is set in the
environment variable CAMCTL_STUDIO_TOKEN, and given once as ``http://HOST:PORT/?token=TOKEN``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Self

from camctl.menu.studio.merging import remove_sets
from camctl.menu.studio.server import PAGE, StudioHandler
from camctl.menu.studio.studio import Studio
from camctl.system.interrupts import uninterrupted
from camctl.system.web_server import DEFAULT_PORT, Site

TOKEN_VARIABLE = "CAMCTL_STUDIO_TOKEN"


class StudioPanel(Studio):
    """The panel; a context manager that serves the page while it is open.

    Args:
        parent: folder of the captures
        address: ``PORT`` or ``HOST:PORT``; a host other than the loopback interface needs a token
        token: what a browser must know; None: the token in the environment, "": no token
    """

    def __init__(
        self, parent: Path, address: str = str(DEFAULT_PORT), *, token: str | None = None
    ) -> None:
        site = Site(address, token, TOKEN_VARIABLE, "", "the studio", PAGE, has_files=True)
        super().__init__(parent, site)

    def __enter__(self) -> Self:
        """Start the server and return the panel; raises `UsageError` where it cannot listen."""
        remove_sets(self.parent)  # of a studio that was killed
        self._open("the studio", StudioHandler, studio=self)
        return self

    @uninterrupted
    def __exit__(self, *_: object) -> None:
        """Stop the server."""
        self.sight.end()
        super().__exit__()
        remove_sets(self.parent)
