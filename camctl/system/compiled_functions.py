"""Functions that numba compiles (extra `fast`), loaded only where that pays."""

from __future__ import annotations

import importlib.util
import math
import os
import re
import threading
from collections.abc import Callable
from functools import cached_property, lru_cache, partial, update_wrapper
from types import FunctionType
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from camctl.system.machine_code import KeptCode, Kind, kind_of, machine_code, native

_Functions = TypeVar("_Functions")

_OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy"}
_JOINED: dict[str, Any] = _OPTIONS | {"_nrt": False, "inline": "always"}
#: Without what Python and C would call it by.
_BARE: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


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
        are_joined: all but those that Python calls become part of what calls them.  They make no
            arrays, and count no references to those that they are given: that takes five times as
            long.  Those that Python calls return nothing, and numba is loaded only where they are
            not compiled yet
    """
    if not has_compiler():
        return None
    return JoinedFunction if are_joined else partial(_compiled, options=dict(_OPTIONS))


def _compiled(function: Callable[..., Any], options: dict[str, Any]) -> Callable[..., Any]:
    """Return a function as numba compiles it, and keeps it."""
    import numba

    try:
        made: Callable[..., Any] = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the machine code can be written
        made = numba.njit(**options)(function)
    return made


class JoinedFunction:
    """A function without arrays of its own that is compiled when Python first calls it.

    Args:
        function: the function; others that it calls are of this class, too
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        assert isinstance(function, FunctionType)
        self.function = function
        self._made: dict[tuple[Kind, ...], Callable[..., Any]] = {}
        self._lock = threading.Lock()
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        """Do what the function does."""
        kinds = tuple(map(kind_of, arguments))
        if kinds not in self._made:
            with self._lock:
                if kinds not in self._made:
                    self._made[kinds] = self._loaded(kinds, arguments)
        return self._made[kinds](*arguments)

    def _loaded(self, kinds: tuple[Kind, ...], arguments: tuple[Any, ...]) -> Callable[..., Any]:
        """Return the machine code for arguments of such kinds, as it was kept or new."""
        kept = self._kept(kinds)
        found = None if kept is None else kept.read()
        if found is not None:
            return found
        import numba

        made = numba.njit(**_JOINED, **_BARE)(self._with_numba())
        # `made` is the function itself where numba is disabled (NUMBA_DISABLE_JIT).
        if kept is not None and hasattr(made, "compile") and _is_called_as_expected():
            text, symbol = _assembly(made, arguments)
            code = machine_code(text, symbol, kinds) if symbol else None
            if code is not None:
                kept.keep(code, symbol)
                return native(code, symbol, kinds)
        return _compiled(self._with_numba(), _JOINED)

    def _kept(self, kinds: tuple[Kind, ...]) -> KeptCode | None:
        """Return the file of the machine code; None where numba is to do all."""
        if os.name != "posix" or any(name.startswith("NUMBA_") for name in os.environ):
            return None  # settings of numba are followed by numba
        try:
            return KeptCode(self.function, _JOINED, kinds)
        except ImportError:
            return None

    def _with_numba(self) -> FunctionType:
        """Return the function; what it calls is as numba compiles it."""
        names = dict(self.function.__globals__)
        for name in self.function.__code__.co_names:
            if isinstance(called := names.get(name), JoinedFunction):
                names[name] = called.in_numba
        made = FunctionType(self.function.__code__, names, self.function.__name__)
        made.__qualname__ = self.function.__qualname__
        return made

    @cached_property
    def in_numba(self) -> Any:
        """The function as others that are compiled call it."""
        import numba

        return numba.njit(**_JOINED)(self._with_numba())


def _assembly(made: Any, arguments: tuple[Any, ...]) -> tuple[str, str]:
    """Return what numba has made of a function for LLVM, and its name there; empty: it returns."""
    import numba

    made.compile(tuple(map(numba.typeof, arguments)))
    (signature,) = made.nopython_signatures
    if signature.return_type != numba.types.none:
        return "", ""
    (text,) = made.inspect_llvm().values()
    (symbol,) = re.findall(r"^define [^@]*@(\S+?)\(", text, re.MULTILINE)
    return text, symbol


def _say_arguments(
    values: NDArray[Any], pair: tuple[NDArray[Any], int], number: float, flag: bool, found: Any
) -> None:
    """Write into `found` what the arguments are."""
    other, count = pair
    found[0], found[1] = values.shape
    found[2], found[3] = values.strides
    found[4], found[5], found[6] = values.size, values.itemsize, values[1, 2]
    found[7], found[8], found[9], found[10] = len(other), other[3], count, number
    found[11], found[12] = 1 if flag else 0, len(found)


@lru_cache(maxsize=1)
def _is_called_as_expected() -> bool:
    """Return whether this numba's machine code gets the arguments that `native` gives it."""
    import numba

    values = np.arange(60, dtype=np.float32).reshape(5, 12)[::-2, 1::3]
    pair = (np.arange(7, dtype=np.uint16), -3)
    found, expected = np.zeros((2, 13))
    arguments = (values, pair, 2.5, True, found)
    _say_arguments(values, pair, 2.5, True, expected)
    kinds = tuple(map(kind_of, arguments))
    text, symbol = _assembly(numba.njit(**_JOINED, **_BARE)(_say_arguments), arguments)
    code = machine_code(text, symbol, kinds)
    if code is None:
        return False
    native(code, symbol, kinds)(*arguments)
    return bool(np.array_equal(found, expected))


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
