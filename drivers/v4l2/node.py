"""A video node, asked through its ioctls on a descriptor of our own.

Frames come through OpenCV on another descriptor.  Ours never sets a format: the kernel gives that
right to one descriptor, and it must be the one that streams.
"""

from __future__ import annotations

import ctypes
import errno
import fcntl
import os
from collections.abc import Callable, Iterator
from typing import Protocol, Self, TypeVar

from camctl.errors import CameraError, CameraNotFoundError, CameraProtocolError
from drivers.v4l2 import abi
from drivers.v4l2.errors import camera_error
from drivers.v4l2.modes import ControlRange, Identity, Size, SizeGrid

MOST_FORMATS, MOST_SIZES, MOST_INTERVALS = 64, 256, 128
_INTERRUPTED = 10

_Structure = TypeVar("_Structure", bound=ctypes.Structure)


class Kernel(Protocol):
    """The system calls of a node; raise `OSError` as Linux does."""

    def open(self, path: str) -> int:
        """Return a descriptor of the node."""
        ...

    def ioctl(self, descriptor: int, request: abi.Request, argument: ctypes.Structure) -> None:
        """Let the node read and change `argument`."""
        ...

    def close(self, descriptor: int) -> None:
        """Let go of the descriptor."""
        ...


class Linux:
    """The kernel that we run on."""

    def open(self, path: str) -> int:
        """Open without waiting for anything."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def ioctl(self, descriptor: int, request: abi.Request, argument: ctypes.Structure) -> None:
        """Call the node."""
        fcntl.ioctl(descriptor, int(request), argument, True)

    def close(self, descriptor: int) -> None:
        """Close it."""
        os.close(descriptor)


class Node:
    """An open video node; a context manager.

    Raises:
        CameraError: as `drivers.v4l2.errors.camera_error` says, here and from every method
        CameraNotFoundError: what is open captures no video

    """

    def __init__(self, path: str, kernel: Kernel | None = None) -> None:
        self.path = path
        self._kernel: Kernel = kernel or Linux()
        try:
            self._descriptor: int | None = self._kernel.open(path)
        except (OSError, ValueError) as error:  # ValueError: a NUL in the path
            raise camera_error(_as_os_error(error), path, "open") from error

    def close(self) -> None:
        """Close the descriptor; a second call does nothing."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            self._kernel.close(descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def identity(self) -> Identity:
        """Return what the node is."""
        found = self._ask(abi.Request.QUERYCAP, abi.Capability(), "ask")
        has_own = found.capabilities & abi.Caps.DEVICE_CAPS
        caps = found.device_caps if has_own else found.capabilities
        needed = abi.Caps.VIDEO_CAPTURE | abi.Caps.STREAMING
        return Identity(
            driver=abi.text(found.driver),
            card=abi.text(found.card),
            bus=abi.text(found.bus_info),
            is_capture=caps & needed == needed,
        )

    def check_capture(self) -> Identity:
        """Return what the node is, or raise `CameraNotFoundError` where it captures no video."""
        identity = self.identity()
        if not identity.is_capture:
            raise CameraNotFoundError(
                f"{self.path} ({identity.card or identity.driver}) captures no video",
                hint="camctl cameras lists the nodes that do",
            )
        return identity

    def formats(self) -> tuple[int, ...]:
        """Return the numbers of the pixel formats offered, `MOST_FORMATS` at most."""
        return tuple(dict.fromkeys(entry.pixelformat for entry in self._formats()))

    def _formats(self) -> Iterator[abi.FormatDescription]:
        return self._list(
            abi.Request.ENUM_FMT,
            lambda index: abi.FormatDescription(index=index, type=abi.CAPTURE_BUFFER),
            MOST_FORMATS,
        )

    def sizes(self, pixelformat: int) -> SizeGrid:
        """Return the sizes offered in one pixel format.

        Raises:
            CameraProtocolError: there is none, or the grid makes no sense

        """
        entries = list(
            self._list(
                abi.Request.ENUM_FRAMESIZES,
                lambda index: abi.SizeQuery(index=index, pixel_format=pixelformat),
                MOST_SIZES,
            )
        )
        grids = [list(entry.words) for entry in entries if entry.type != abi.Grid.DISCRETE]
        if grids:
            least_w, most_w, step_w, least_h, most_h, step_h = grids[0]
            if not (0 < least_w <= most_w and 0 < least_h <= most_h):
                raise self._nonsense("a range of sizes", grids[0])
            return SizeGrid(
                (Size(most_w, most_h),),
                Size(least_w, least_h),
                Size(max(step_w, 1), max(step_h, 1)),
            )
        listed = {Size(entry.words[0], entry.words[1]): None for entry in entries}
        usable = tuple(size for size in listed if size.width > 0 and size.height > 0)
        if not usable:
            raise self._nonsense("a list of sizes", [str(size) for size in listed])
        return SizeGrid(usable)

    def intervals(self, pixelformat: int, size: Size) -> tuple[float, ...]:
        """Return the frame intervals offered, s, ascending; of a range its two ends."""
        found: set[float] = set()
        for entry in self._list(
            abi.Request.ENUM_FRAMEINTERVALS,
            lambda index: abi.IntervalQuery(
                index=index, pixel_format=pixelformat, width=size.width, height=size.height
            ),
            MOST_INTERVALS,
        ):
            words = list(entry.words)
            fractions = 1 if entry.type == abi.Grid.DISCRETE else 2
            for numerator, denominator in zip(words[::2], words[1::2], strict=True):
                if fractions > 0 and numerator and denominator:
                    found.add(numerator / denominator)
                fractions -= 1
        return tuple(sorted(found))

    def picture(self) -> abi.Format:
        """Return the picture that is set."""
        return self._ask(abi.Request.G_FMT, abi.Format(type=abi.CAPTURE_BUFFER), "ask")

    def interval_s(self) -> float | None:
        """Return the frame interval that is set, s; None where the camera does not say."""
        try:
            found = self._ask(
                abi.Request.G_PARM, abi.StreamParameters(type=abi.CAPTURE_BUFFER), "ask"
            )
        except CameraProtocolError:
            return None
        if not (found.numerator and found.denominator):
            return None
        return float(found.numerator) / float(found.denominator)

    def control(self, control: int) -> ControlRange | None:
        """Return the range of a control; None where the camera does not have it.

        Raises:
            CameraProtocolError: the range makes no sense

        """
        try:
            found = self._call(abi.Request.QUERYCTRL, abi.ControlQuery(id=control))
        except OSError as error:
            if error.errno in (errno.EINVAL, errno.ENOTTY):
                return None
            raise camera_error(error, self.path, "ask for a control of") from error
        if found.flags & abi.ControlFlag.DISABLED:
            return None
        name = abi.text(found.name) or f"control {control:#x}"
        is_switch = found.type in (abi.ControlType.BOOLEAN, abi.ControlType.MENU)
        step = 1 if is_switch else found.step
        if found.minimum > found.maximum or step <= 0:
            said = f"{found.minimum}..{found.maximum} in steps of {found.step}"
            raise self._nonsense(f"a range of '{name}'", said)
        return ControlRange(
            id=control,
            name=name,
            kind=found.type,
            minimum=found.minimum,
            maximum=found.maximum,
            step=step,
            default=found.default_value,
            is_read_only=bool(found.flags & abi.ControlFlag.READ_ONLY),
        )

    def menu_has(self, control: int, index: int) -> bool:
        """Say whether a menu control has an entry of that number."""
        try:
            self._call(abi.Request.QUERYMENU, abi.MenuQuery(id=control, index=index))
        except OSError as error:
            if error.errno == errno.EINVAL:
                return False
            raise camera_error(error, self.path, "ask for a menu of") from error
        return True

    def get(self, control: int) -> int:
        """Return a control's value."""
        found = self._ask(abi.Request.G_CTRL, abi.ControlValue(id=control), "read a control of")
        return int(found.value)

    def set(self, control: int, value: int) -> int:
        """Set a control and return the value read back, which may be another."""
        try:
            self._call(abi.Request.S_CTRL, abi.ControlValue(id=control, value=value))
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EINVAL, errno.ERANGE):
                raise CameraProtocolError(
                    f"{self.path} does not let control {control:#x} be set to {value}",
                    hint="unplug it, plug it in again and try again",
                ) from error
            raise camera_error(error, self.path, "set a control of") from error
        return self.get(control)

    def _list(
        self,
        request: abi.Request,
        entry: Callable[[int], _Structure],
        most: int,
    ) -> Iterator[_Structure]:
        """Yield a list's entries, `most` at most; a list that never ends is cut there."""
        for index in range(most):
            try:
                found = self._call(request, entry(index))
            except OSError as error:
                if error.errno in (errno.EINVAL, errno.ENOTTY):
                    return
                raise camera_error(error, self.path, "list what is offered by") from error
            yield found
            if isinstance(found, abi.SizeQuery | abi.IntervalQuery) and _is_range(found):
                return

    def _ask(self, request: abi.Request, argument: _Structure, doing: str) -> _Structure:
        try:
            return self._call(request, argument)
        except OSError as error:
            raise camera_error(error, self.path, doing) from error

    def _call(self, request: abi.Request, argument: _Structure) -> _Structure:
        if self._descriptor is None:
            raise CameraError(f"{self.path} is closed", hint="open the camera again")
        for _ in range(_INTERRUPTED):
            try:
                self._kernel.ioctl(self._descriptor, request, argument)
            except InterruptedError:
                continue
            return argument
        raise OSError(errno.EINTR, os.strerror(errno.EINTR))

    def _nonsense(self, what: str, said: object) -> CameraProtocolError:
        return CameraProtocolError(
            f"{self.path} answers nonsense: {what} of {said}",
            hint="unplug it, plug it in again and try again",
        )


def _as_os_error(error: OSError | ValueError) -> OSError:
    if isinstance(error, OSError):
        return error
    return OSError(errno.ENOENT, os.strerror(errno.ENOENT))


def _is_range(entry: abi.SizeQuery | abi.IntervalQuery) -> bool:
    """Say whether an entry stands for all between two, and is then the last of its list."""
    return bool(entry.type != abi.Grid.DISCRETE)
