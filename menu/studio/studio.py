"""What the sections of the page have in common: the menu's state, and the way to change it."""

from __future__ import annotations

import queue
import threading
from collections import deque
from pathlib import Path
from typing import Any

from camctl.menu.model import Model
from camctl.menu.ports import Key, Screen
from camctl.menu.studio.sight import Sight
from camctl.menu.studio.state import state_of
from camctl.menu.studio.wishes import Wish, keys_for

_POLL_S = 20.0
"""A request for the next state is answered after this time, s, even if it is the same."""
_MOST_WISHES = 64


class Studio:
    """The state of the menu for browsers, and their wishes for the menu.

    Args:
        parent: folder of the captures

    Attributes:
        model: the state that the menu is in
        sight: what the camera sees, for browsers that look
    """

    def __init__(self, parent: Path) -> None:
        self.parent = parent
        self.model = Model()
        self.sight = Sight()
        self.changed = threading.Condition()
        self.version = 0
        self.is_open = False
        self._state: dict[str, Any] = {}
        self._wishes: queue.Queue[Wish] = queue.Queue(_MOST_WISHES)
        self._keys: deque[Key] = deque()

    def show(self, screen: Screen) -> int:
        """Make `screen` the one that browsers get, unless keys lead on from it.

        Pages of a browser scroll by themselves.
        """
        if self._keys:
            return 0
        state = state_of(self.model, screen)
        with self.changed:
            self._state = state
            self.version += 1
            self.changed.notify_all()
        return 0

    def show_model(self, model: Model) -> None:
        """Take the state whose screen is shown next."""
        self.model = model

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key on the way to what was wished."""
        if not self._keys:
            try:
                wish = self._wishes.get(timeout=timeout_s) if timeout_s else self._wishes.get(False)
            except queue.Empty:
                return None
            self._keys.extend(keys_for(self.model, wish))
        return self._keys.popleft() if self._keys else None

    def wish(self, wish: Wish) -> bool:
        """Take a wish; return whether there is room for it."""
        try:
            self._wishes.put_nowait(wish)
        except queue.Full:
            return False
        return True

    def wait_for(self, version: int) -> dict[str, Any]:
        """Return what the page shows, for JSON, once it is not `version`."""
        with self.changed:
            self.changed.wait_for(lambda: self.version != version or not self.is_open, _POLL_S)
            return {"version": self.version, **self._state}
