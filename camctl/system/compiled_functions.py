"""Functions that numba compiles (extra `fast`), loaded only where that pays."""

from __future__ import annotations

import importlib.util
import math
import threading
from collections.abc import Callable
from typing import Any, Generic, TypeVar

_Functions = TypeVar("_Functions")


def has_compiler() -> bool:
    """Return whether numba is installed."""
    return importlib.util.find_spec("numba") is not None


def compiler(
    *, are_joined: bool = False
) -> Callable[[Callable[..., Any]], Callable[..., Any]] | None:
    """Return what compiles a function when it is first called; None without numba.

    The functions release the lock of Python.  The machine code is kept beside their module, or in
    the user's cache where that can be written.

    Args:
        are_joined: all but the last one become part of what calls them.  They make no arrays, and
            count no references to those that they are given: that takes five times as long
    """
    try:
        import numba
    except ImportError:
        return None

    def compiled(function: Callable[..., Any]) -> Callable[..., Any]:
        options: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
        if are_joined:
            options |= {"_nrt": False, "inline": "always"}
        try:
            made: Callable[..., Any] = numba.njit(cache=True, **options)(function)
        except RuntimeError:  # no folder for the machine code can be written
            made = numba.njit(**options)(function)
        return made

    return compiled


class LoadedLater(Generic[_Functions]):
    """Whether compiled functions are used.

    Args:
        load: returns them, None without numba
        samples_worth_loading: samples after which they are loaded on their own, while the work goes
            on without them
        is_used: True for at once; False for never; None for after that many samples
    """

    def __init__(
        self,
        load: Callable[[], _Functions | None],
        samples_worth_loading: int,
        is_used: bool | None = None,
    ) -> None:
        self._load = load
        self._functions = load() if is_used else None
        self._samples_left: float = samples_worth_loading if is_used is None else math.inf

    def after(self, samples: int) -> _Functions | None:
        """Return the functions, or None for now, when `samples` more are to be worked on."""
        before, self._samples_left = self._samples_left, self._samples_left - samples
        if before > 0 >= self._samples_left:
            threading.Thread(target=self._load_now, name="camctl-compile").start()
        return self._functions

    def _load_now(self) -> None:
        self._functions = self._load()
