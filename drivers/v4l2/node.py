"""A video node: its lists, formats and controls, through ioctls on its file descriptor.

The kernel grants format and stream of a node to one descriptor at a time.  A `Node` therefore sets
neither by itself: `camctl.drivers.v4l2.capture` does.
"""

from __future__ import annotations

import ctypes
import errno
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Self, TypeAlias, TypeVar

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.kernel import Kernel, Linux, Memory
from camctl.drivers.v4l2.media import sensor_columns, sensor_of
from camctl.drivers.v4l2.system import camera_error
from camctl.errors import CameraError, CameraNotFoundError, CameraProtocolError
from camctl.interface.clock import wait_for

#: (rows, columns) of a frame.
Shape: TypeAlias = tuple[int, int]

#: Entries of a list that are read at most, for devices whose lists never end.
MOST_FORMATS, MOST_SIZES, MOST_INTERVALS = 256, 256, 128
#: Frame intervals are set in units of 100 ns, as USB cameras have them.
_INTERVALS_PER_S = 10_000_000
#: Attempts at a system call that signals interrupt.
_ATTEMPTS = 10
_REPLUG = "unplug it, plug it in again and try again"
_CAPTURES = abi.Caps.VIDEO_CAPTURE | abi.Caps.VIDEO_CAPTURE_PLANES

_StructureT = TypeVar("_StructureT", bound=ctypes.Structure)


def size_text(shape: Shape) -> str:
    """Return (rows, columns) as WIDTHxHEIGHT."""
    return f"{shape[1]}x{shape[0]}"


@dataclass(frozen=True)
class Identity:
    """What a node reports of itself.

    Attributes:
        driver, card: names of its driver and of its card
        is_capture: it captures video
        has_planes: its buffers are multi-planar alone
    """

    driver: str
    card: str
    is_capture: bool
    has_planes: bool = False


@dataclass(frozen=True)
class ControlRange:
    """The values that a control accepts."""

    name: str
    minimum: int
    maximum: int
    step: int
    default: int
    is_read_only: bool

    def nearest(self, value: int) -> int:
        """Return the accepted value nearest to `value`."""
        inside = min(max(value, self.minimum), self.maximum)
        count = round((inside - self.minimum) / self.step)
        return min(self.minimum + count * self.step, self.maximum)


@dataclass(frozen=True)
class SizeGrid:
    """The frame sizes of one pixel format: a list, or a grid from the smallest to the largest.

    Attributes:
        listed: the sizes of a list; of a grid the largest
        smallest, step: of a grid; `smallest` is None for a list
    """

    listed: tuple[Shape, ...]
    smallest: Shape | None = None
    step: Shape = (1, 1)

    @property
    def largest(self) -> Shape:
        """The size with the most pixels; of several the widest."""
        return max(self.listed, key=lambda shape: (shape[0] * shape[1], shape[1]))

    def has(self, shape: Shape) -> bool:
        """Return whether the camera offers this size."""
        if shape in self.listed:
            return True
        if self.smallest is None:
            return False
        bounds = zip(shape, self.smallest, self.largest, self.step, strict=True)
        return all(
            low <= value <= high and (value - low) % step == 0 for value, low, high, step in bounds
        )


class StreamBuffer:
    """A buffer of a stream with one plane, in the form that its node needs.

    Attributes:
        raw: as the kernel has it
        place: has `offset`, `length` and `bytesused`: of the buffer, or of its only plane
    """

    def __init__(self, index: int, buffer_type: int) -> None:
        self.raw = abi.Buffer(index=index, type=buffer_type, memory=abi.MAPPED_MEMORY)
        self.place: abi.Buffer | abi.Plane = self.raw
        if buffer_type == abi.PLANES_BUFFER:
            self._planes = (abi.Plane * abi.MOST_PLANES)()  # kept: the kernel has its address
            self.raw.offset, self.raw.length = ctypes.addressof(self._planes), abi.MOST_PLANES
            self.place = self._planes[0]

    @property
    def filled(self) -> slice:
        """The bytes of the frame in it; in a plane they may begin behind a header."""
        begin = self.place.data_offset if isinstance(self.place, abi.Plane) else 0
        return slice(begin, self.place.bytesused)


class Node:
    """An open video node; a context manager.

    Raises:
        CameraError: see `camctl.drivers.v4l2.system.camera_error`; so does every method
    """

    def __init__(self, path: str, kernel: Kernel | None = None) -> None:
        self.path = path
        self._kernel: Kernel = kernel or Linux()
        try:
            self._descriptor: int | None = self._kernel.open(path)
        except OSError as error:
            raise camera_error(error, path, "open") from error
        except ValueError as error:  # a NUL in the path
            missing = OSError(errno.ENOENT, os.strerror(errno.ENOENT))
            raise camera_error(missing, path, "open") from error

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
        """Return what the node reports of itself."""
        found = self.query(abi.Request.QUERYCAP, abi.Capability(), "query")
        has_own = found.capabilities & abi.Caps.DEVICE_CAPS
        caps = found.device_caps if has_own else found.capabilities
        return Identity(
            driver=abi.text(found.driver),
            card=abi.text(found.card),
            is_capture=bool(caps & _CAPTURES and caps & abi.Caps.STREAMING),
            has_planes=caps & _CAPTURES == abi.Caps.VIDEO_CAPTURE_PLANES,
        )

    @cached_property
    def buffer_type(self) -> int:
        """The type of its buffers: of one plane, or multi-planar (Rockchip, i.MX8 and others)."""
        return abi.PLANES_BUFFER if self.identity().has_planes else abi.CAPTURE_BUFFER

    def capture_identity(self) -> Identity:
        """Return what the node reports; raise `CameraNotFoundError` unless it captures video."""
        identity = self.identity()
        if not identity.is_capture:
            raise CameraNotFoundError(
                f"{self.path} ({identity.card or identity.driver}) does not capture video",
                hint="choose a node that does: list the cameras",
                remedies={"cameras": None},
            )
        return identity

    def formats(self) -> tuple[int, ...]:
        """Return the numbers of the pixel formats offered, `MOST_FORMATS` at most."""
        entries = self._list(
            abi.Request.ENUM_FMT,
            lambda index: abi.FormatDescription(index=index, type=self.buffer_type),
            MOST_FORMATS,
        )
        return tuple(dict.fromkeys(entry.pixelformat for entry in entries))

    def sizes(self, pixelformat: int) -> SizeGrid:
        """Return the sizes offered in one pixel format.

        Raises:
            CameraProtocolError: there are none, or a contradictory range
        """
        entries = list(
            self._list(
                abi.Request.ENUM_FRAMESIZES,
                lambda index: abi.SizeQuery(index=index, pixel_format=pixelformat),
                MOST_SIZES,
            )
        )
        ranges = [list(entry.words) for entry in entries if entry.type != abi.Grid.DISCRETE]
        if ranges:
            least_w, most_w, step_w, least_h, most_h, step_h = ranges[0]
            if not (0 < least_w <= most_w and 0 < least_h <= most_h):
                raise self.invalid("a range of sizes", ranges[0])
            steps = (max(step_h, 1), max(step_w, 1))
            return SizeGrid(((most_h, most_w),), (least_h, least_w), steps)
        listed = {(entry.words[1], entry.words[0]): None for entry in entries}
        usable = tuple(shape for shape in listed if min(shape) > 0)
        if not usable:
            raise self.invalid("a list of sizes", [size_text(shape) for shape in listed])
        return SizeGrid(usable)

    def intervals(self, pixelformat: int, shape: Shape) -> tuple[float, ...]:
        """Return the frame intervals offered, s, ascending; of a range its two ends."""
        rows, columns = shape
        found: set[float] = set()
        for entry in self._list(
            abi.Request.ENUM_FRAMEINTERVALS,
            lambda index: abi.IntervalQuery(
                index=index, pixel_format=pixelformat, width=columns, height=rows
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

    def current_format(self) -> abi.Format:
        """Return the pixel format and size that are set."""
        return self._format(abi.Request.G_FMT, abi.Format(), "query")

    def set_format(self, pixelformat: int, shape: Shape) -> abi.Format:
        """Set pixel format and size; return what the driver has set instead, or the same."""
        rows, columns = shape
        requested = abi.Format(width=columns, height=rows, pixelformat=pixelformat)
        return self._format(abi.Request.S_FMT, requested, "set the format of")

    def _format(self, request: abi.Request, format_: abi.Format, action: str) -> abi.Format:
        """Get or set the format; of a multi-planar node in the form of a single plane."""
        format_.type = self.buffer_type
        if self.buffer_type == abi.CAPTURE_BUFFER:
            return self.query(request, format_, action)
        wanted = abi.PlanesFormat(
            type=self.buffer_type,
            width=format_.width,
            height=format_.height,
            pixelformat=format_.pixelformat,
            num_planes=1,
        )
        found = self.query(request, wanted, action)
        if found.num_planes > 1:
            raise CameraProtocolError(
                f"{self.path} sends its frames in {found.num_planes} planes apart",
                hint="choose another pixel format",
                remedies={"option:format": None},
            )
        return abi.Format(
            type=found.type,
            width=found.width,
            height=found.height,
            pixelformat=found.pixelformat,
            bytesperline=found.planes[0].bytesperline,
            sizeimage=found.planes[0].sizeimage,
            colorspace=found.colorspace,
            quantization=found.quantization,
        )

    def buffer(self, index: int) -> StreamBuffer:
        """Return a buffer of the stream, for requests."""
        return StreamBuffer(index, self.buffer_type)

    def set_interval(self, interval_s: float) -> float | None:
        """Set the frame interval; return the one that the driver chose, None where unknown."""
        rate = abi.StreamParameters(
            type=self.buffer_type,
            numerator=round(interval_s * _INTERVALS_PER_S),
            denominator=_INTERVALS_PER_S,
        )
        found = self._query_or_none(abi.Request.S_PARM, rate, "set the frame rate of")
        if found is None or not (found.numerator and found.denominator):
            return None
        return float(found.numerator / found.denominator)

    def control(self, control: int) -> ControlRange | None:
        """Return the range of a control; None where the camera does not have it.

        Raises:
            CameraProtocolError: the range is contradictory
        """
        query = abi.ControlQuery(id=control)
        found = self._query_or_none(abi.Request.QUERYCTRL, query, "query a control of")
        if found is None or found.flags & abi.ControlFlag.DISABLED:
            return None
        name = abi.text(found.name) or f"control {control:#x}"
        is_switch = found.type in (abi.ControlType.BOOLEAN, abi.ControlType.MENU)
        step = 1 if is_switch else found.step
        if found.minimum > found.maximum or step <= 0:
            reported = f"{found.minimum}..{found.maximum} in steps of {found.step}"
            raise self.invalid(f"a range of '{name}'", reported)
        return ControlRange(
            name=name,
            minimum=found.minimum,
            maximum=found.maximum,
            step=step,
            default=found.default_value,
            is_read_only=bool(found.flags & abi.ControlFlag.READ_ONLY),
        )

    def menu_has(self, control: int, index: int) -> bool:
        """Return whether a menu control has an entry of that number."""
        query = abi.MenuQuery(id=control, index=index)
        absent = (errno.EINVAL,)
        found = self._query_or_none(abi.Request.QUERYMENU, query, "query a menu of", absent)
        return found is not None

    def get(self, control: int) -> int:
        """Return the value of a control."""
        found = self.query(abi.Request.G_CTRL, abi.ControlValue(id=control), "read a control of")
        return int(found.value)

    def sensor(self, root: Path) -> Node | None:
        """Return the node of the sensor behind this one, opened; None where there is none.

        Raises:
            CameraError: there are several, or it cannot be opened
        """
        found = sensor_of(self.path, self._kernel, root)
        return None if found is None else Node(found, self._kernel)

    def columns(self) -> int | None:
        """Return the columns that the sensor of this node reads; None where it does not say."""
        return sensor_columns(self._opened(), self._kernel)

    def long_value(self, control: int) -> int | None:
        """Return the value of a control of up to 64 bits; None where the camera has none."""
        value = abi.LongValue(id=control)
        values = abi.LongValues(count=1, controls=ctypes.pointer(value))
        found = self._query_or_none(abi.Request.G_EXT_CTRLS, values, "read a control of")
        return None if found is None else int(value.value)

    def set(self, control: int, value: int) -> int:
        """Set a control and return the value read back, which may be another one."""
        try:
            self._call(abi.Request.S_CTRL, abi.ControlValue(id=control, value=value))
        except OSError as error:
            if error.errno in (errno.EACCES, errno.EINVAL, errno.ERANGE):
                raise CameraProtocolError(
                    f"{self.path} refused to set control {control:#x} to {value}", hint=_REPLUG
                ) from error
            raise camera_error(error, self.path, "set a control of") from error
        return self.get(control)

    def _list(
        self,
        request: abi.Request,
        entry: Callable[[int], _StructureT],
        most: int,
    ) -> Iterator[_StructureT]:
        """Yield the entries of a list, `most` at most."""
        for index in range(most):
            found = self._query_or_none(request, entry(index), "list the formats of")
            if found is None:
                return
            yield found
            # A range is the last entry of its list.
            if (
                isinstance(found, abi.SizeQuery | abi.IntervalQuery)
                and found.type != abi.Grid.DISCRETE
            ):
                return

    def query(self, request: abi.Request, argument: _StructureT, action: str) -> _StructureT:
        """Return `argument` as the node's driver fills it in; errors name the `action`."""
        try:
            return self._call(request, argument)
        except OSError as error:
            raise camera_error(error, self.path, action) from error

    def _query_or_none(
        self,
        request: abi.Request,
        argument: _StructureT,
        action: str,
        absent: tuple[int, ...] = (errno.EINVAL, errno.ENOTTY),
    ) -> _StructureT | None:
        """Return as `query`; None where the driver answers with one of the errors `absent`."""
        try:
            return self._call(request, argument)
        except OSError as error:
            if error.errno in absent:
                return None
            raise camera_error(error, self.path, action) from error

    def map(self, buffer: StreamBuffer) -> Memory:
        """Return the memory of a buffer of the stream."""
        place = buffer.place
        try:
            return self._kernel.map(self._opened(), place.offset, place.length)
        except (OSError, ValueError, OverflowError) as error:
            reported = f"{place.length} bytes at {place.offset}"
            raise self.invalid("a buffer", reported) from error

    def wait(self, timeout_s: float) -> bool:
        """Wait for a frame or an error of the stream; return False where none comes in time."""
        return wait_for(partial(self._kernel.wait, self._opened()), timeout_s)

    def _opened(self) -> int:
        if self._descriptor is None:
            raise CameraError(f"{self.path} is closed", hint="open the camera again")
        return self._descriptor

    def _call(self, request: abi.Request, argument: _StructureT) -> _StructureT:
        descriptor = self._opened()
        for _ in range(_ATTEMPTS):
            try:
                self._kernel.ioctl(descriptor, request, argument)
            except InterruptedError:
                continue
            return argument
        raise OSError(errno.EINTR, os.strerror(errno.EINTR))

    def invalid(self, what: str, reported: object) -> CameraProtocolError:
        """Return the error for a response that contradicts itself."""
        return CameraProtocolError(
            f"{self.path} sent an invalid response: {what} of {reported}", hint=_REPLUG
        )
