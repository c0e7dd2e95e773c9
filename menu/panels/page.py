"""What panels that are pages of a browser have in common."""

from __future__ import annotations

import sys
import threading
from typing import Any

from camctl.system.interrupts import uninterrupted
from camctl.system.web_server import Site, SiteHandler

_POLL_S = 20.0
"""A request for what is shown next is answered after this time, s, even if it is the same."""


class PagePanel:
    """A panel whose page is served while it is open.

    Attributes:
        version: of what is shown; it grows with each change
        changed: held while that changes, and notified then
    """

    def __init__(self, site: Site) -> None:
        self._site = site
        self.changed = threading.Condition()
        self.version = 0
        self.is_open = False

    @property
    def url(self) -> str:
        return self._site.url

    def _open(self, what: str, handler: type[SiteHandler], **attributes: Any) -> None:
        """Start the server, and print where `what` is; raises `UsageError` if it cannot listen."""
        self._site.start(handler, **attributes)
        self.is_open = True
        print(f"{what} is at {self._site.shown_url}", file=sys.stderr, flush=True)

    @uninterrupted
    def __exit__(self, *_: object) -> None:
        """Stop the server."""
        self.is_open = False
        with self.changed:
            self.changed.notify_all()
        self._site.stop()

    def _wait_for_change(self, version: int) -> None:
        """Return once what is shown is not `version`; `changed` is held."""
        self.changed.wait_for(lambda: self.version != version or not self.is_open, _POLL_S)
