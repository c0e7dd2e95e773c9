"""Signals that end a command: Control-C, SIGTERM and SIGHUP, each as an exception.

Within `run_interruptible` a signal raises `Interrupt` in the main thread, so that ``with`` and
``finally`` clean up.  Two things are never left half done by a signal:

- a function decorated with `uninterrupted`, such as closing a camera: `Interrupt` is raised when
  it ends
- what cleans up after an `Interrupt`: signals that arrive meanwhile are ignored

A signal that finds a function decorated with `entering` at its own code, such as ``__enter__`` of a
camera that is open already, waits 0.1 s: raised there, `Interrupt` would come before the ``with``
statement is bound to close the camera.  So does a signal that finds contextlib at its own code: the
generator of a context manager would stay at its ``yield``, with what it holds, such as a lock.  And
one that finds a wait for futures while it takes their locks: a pool could not end any more.

All of this follows from the frames and the exception that the signal finds, and not from a counter:
there is no moment in between at which a signal would get through.

A signal that the parent process ignores stays ignored: nohup does so with SIGHUP, and shells do so
with SIGINT for commands in the background.  The library installs no handlers by itself.
"""

from __future__ import annotations

import _thread
import contextlib
import functools
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import CodeType, FrameType
from typing import Any, ParamSpec, TypeAlias, TypeVar

_Arguments = ParamSpec("_Arguments")
_Result = TypeVar("_Result")
Handler: TypeAlias = Callable[[int, FrameType | None], Any]
"""A handler of signals."""

#: Windows has no SIGHUP.
_SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)


class Interrupt(KeyboardInterrupt):
    """A signal that ends the command; code that handles Control-C handles it, too.

    Attributes:
        number: the signal's number; the exit status of the command is 128 more
    """

    def __init__(self, number: int) -> None:
        by = "" if number == signal.SIGINT else f" by {signal.Signals(number).name}"
        super().__init__(f"interrupted{by}")
        self.number = number


@contextlib.contextmanager
def signal_handlers(afterwards: Handler | None = None) -> Iterator[None]:
    """Handle the signals while the block runs; do nothing in a thread other than the main one.

    Their handler is `afterwards` then; None: the one before.
    """
    global _last, _waiting, _ended
    previous: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        _last, _waiting, _ended = None, None, threading.Event()
        for number in _SIGNALS:
            handler = signal.getsignal(number)
            if handler not in (signal.SIG_IGN, None):  # None: installed by a library in C
                previous[number] = handler if afterwards is None else afterwards
                signal.signal(number, _handle)
    try:
        yield
    finally:
        with _sending:
            _ended.set()
        for number, handler in previous.items():
            signal.signal(number, handler)


def run_interruptible(function: Callable[[], _Result]) -> _Result:
    """Call `function`; within `signal_handlers`, a signal during the call raises `Interrupt`.

    A signal between the begin of `signal_handlers` and the call raises it at the call's begin; one
    after the call is ignored.
    """
    _raise_waiting(sys._getframe())
    result = function()
    if _last is not None:  # a library dropped it
        raise _last
    return result


def uninterrupted(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return `function` so that a signal during a call raises `Interrupt` at the call's end."""

    @functools.wraps(function)
    def call(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Result:
        try:
            return function(*arguments, **named)
        finally:
            is_over = True  # noqa: F841  # for `_region`: from here on a signal need not wait
            _raise_waiting(sys._getframe().f_back)

    return call


def entering(function: Callable[_Arguments, _Result]) -> Callable[_Arguments, _Result]:
    """Return `function` so that a signal at its own code, not in what it calls, waits 0.1 s."""
    _entering.add(function.__code__)
    return function


def last_interrupt() -> Interrupt | None:
    """Return the `Interrupt` raised last within `signal_handlers`; None: there was none.

    A command that ends with another error may have failed because a library dropped the interrupt.
    """
    return _last


def _is_handled(error: BaseException | None) -> bool:
    """Return whether `error` is an `Interrupt`, or was raised while one was being handled."""
    while error is not None and not isinstance(error, Interrupt):
        error = error.__context__
    return error is not None


#: Time after which a signal is sent again, s.
_REPEAT_S = 0.1

#: Code of the functions decorated with `entering`, and of those that take and release locks.
_entering: set[CodeType] = {
    threading.Condition.__enter__.__code__,
    threading.Condition.__exit__.__code__,
}
#: Modules whose code takes locks, or opens contexts, that what follows an exception releases.
_BETWEEN = {"contextlib", "concurrent.futures._base"}
_last: Interrupt | None = None
#: Set when the handlers are removed; then no signal is sent again.
_ended = threading.Event()
_sending = threading.Lock()
#: The signal that arrived during an uninterrupted call of the main thread.
_waiting: int | None = None

_INTERRUPTIBLE = run_interruptible.__code__
_UNINTERRUPTED = uninterrupted(lambda: None).__code__  # the code of `call`


def _handle(number: int, frame: FrameType | None) -> None:
    global _waiting
    region = _region(frame)
    if _is_handled(sys.exc_info()[1]):
        return
    if region is not _INTERRUPTIBLE:  # None: before or after the call, see `run_interruptible`
        _waiting = number
        return
    interrupt = _arrived(number)
    if frame is None or not _is_between(frame):
        raise interrupt


def _is_between(frame: FrameType) -> bool:
    """Return whether `frame` is at the beginning or end of a ``with`` block, outside of it."""
    return frame.f_code in _entering or frame.f_globals.get("__name__") in _BETWEEN


def _raise_waiting(frame: FrameType | None) -> None:
    """Raise `Interrupt` for the signal that waits, if `frame` may be interrupted."""
    global _waiting
    if _waiting is not None and _region(frame) is _INTERRUPTIBLE:
        number, _waiting = _waiting, None
        if not _is_handled(sys.exc_info()[1]):
            raise _arrived(number)


def _arrived(number: int) -> Interrupt:
    """Return the `Interrupt` to be raised; the signal is sent again until it takes effect.

    Python drops an exception that is raised in a destructor, and numpy one that is raised while it
    looks for the methods of an object.
    """
    global _last
    if _last is None:
        # `threading.Thread` takes locks, which the interrupted code may hold.
        _thread.start_new_thread(_send_again, (number, _ended))
    _last = Interrupt(number)
    return _last


def _send_again(number: int, ended: threading.Event) -> None:
    while not ended.wait(_REPEAT_S):
        with _sending:
            if not ended.is_set():
                _send_to_main_thread(number)


def _send_to_main_thread(number: int) -> None:
    main = threading.main_thread().ident
    if sys.platform == "win32" or main is None:
        signal.raise_signal(number)
    else:  # to another thread it would not end a call of the system in which the main one waits
        signal.pthread_kill(main, number)


def _region(frame: FrameType | None) -> CodeType | None:
    """Return the innermost of `_INTERRUPTIBLE` and `_UNINTERRUPTED` around a frame.

    None: the frame is not within `run_interruptible`, or it belongs to another thread.
    """
    innermost: CodeType | None = None
    while frame is not None:
        if frame.f_code is _INTERRUPTIBLE:
            return innermost or _INTERRUPTIBLE
        if frame.f_code is _UNINTERRUPTED and "is_over" not in frame.f_locals:
            innermost = _UNINTERRUPTED
        frame = frame.f_back
    return None
