"""What the sections of the page have in common: the menu's state, and the way to change it."""

from __future__ import annotations

import queue
from collections import deque
from pathlib import Path
from typing import Any

from camctl.menu.model import Model
from camctl.menu.panels.page import PagePanel
from camctl.menu.ports import Key, Screen
from camctl.menu.studio.commands import Command, keys_for
from camctl.menu.studio.sight import Sight
from camctl.menu.studio.state import state_of
from camctl.system.web_server import Site

_MOST_COMMANDS = 64


class Studio(PagePanel):
    """The state of the menu for browsers, and their commands for the menu.

    Args:
        parent: folder of the captures
        site: of the page

    Attributes:
        model: the state that the menu is in
        sight: what the camera sees, for browsers that look
    """

    def __init__(self, parent: Path, site: Site) -> None:
        super().__init__(site)
        self.parent = parent
        self.model = Model()
        self.sight = Sight()
        self._state: dict[str, Any] = {}
        self._commands: queue.Queue[Command] = queue.Queue(_MOST_COMMANDS)
        self._keys: deque[Key] = deque()

    def show(self, screen: Screen) -> int:
        """Make `screen` the one that browsers get, unless keys lead on from it.

        Pages of a browser scroll by themselves.
        """
        if self._keys:
            return 0
        state = state_of(self.model, screen, self.parent)
        with self.changed:
            self._state = state
            self.version += 1
            self.changed.notify_all()
        return 0

    def show_model(self, model: Model) -> None:
        """Take the state whose screen is shown next."""
        self.model = model

    def key(self, timeout_s: float) -> Key | None:
        """Return the next key on the way to what was asked for."""
        if not self._keys:
            try:
                command = self._commands.get(timeout_s > 0, timeout_s)
            except queue.Empty:
                return None
            self._keys.extend(keys_for(self.model, command))
        return self._keys.popleft() if self._keys else None

    def command(self, command: Command) -> bool:
        """Take a command; return whether there is room for it."""
        try:
            self._commands.put_nowait(command)
        except queue.Full:
            return False
        return True

    def wait_for(self, version: int) -> dict[str, Any]:
        """Return what the page shows, for JSON, once it is not `version`."""
        with self.changed:
            self._wait_for_change(version)
            return {"version": self.version, **self._state}
