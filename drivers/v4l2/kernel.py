"""The interface of the system calls for a video node, and the running Linux."""

from __future__ import annotations

import ctypes
import os
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from camctl.drivers.v4l2.abi import Request

#: The bytes of a buffer that the kernel fills.
Memory: TypeAlias = NDArray[np.uint8]


class Kernel(Protocol):
    """The system calls for a node; they raise `OSError` as Linux does."""

    def open(self, path: str) -> int:
        """Return a descriptor of the node."""

    def ioctl(self, descriptor: int, request: Request, argument: ctypes.Structure) -> None:
        """Let the node read and change `argument`."""

    def map(self, descriptor: int, offset: int, length: int) -> Memory:
        """Return the memory of a buffer; it is unmapped when the array is no longer used."""

    def wait(self, descriptor: int, timeout_s: float) -> bool:
        """Wait until there is a frame or an error; return False after `timeout_s` without one."""

    def close(self, descriptor: int) -> None:
        """Close the descriptor."""


class WritingKernel(Kernel, Protocol):
    """The same, with what a video output needs."""

    def write(self, descriptor: int, data: NDArray[np.uint8]) -> None:
        """Write the bytes of a picture."""


class Linux:
    """The running kernel.

    fcntl, mmap with these arguments, and poll exist on POSIX systems only; they are imported where
    they are used, so that this module can be imported on any system.
    """

    def open(self, path: str) -> int:
        """Open the node without blocking."""
        return os.open(path, os.O_RDWR | os.O_NONBLOCK | os.O_CLOEXEC)

    def ioctl(self, descriptor: int, request: Request, argument: ctypes.Structure) -> None:
        import fcntl

        fcntl.ioctl(descriptor, int(request), argument, True)

    def map(self, descriptor: int, offset: int, length: int) -> Memory:
        import mmap

        mapped = mmap.mmap(descriptor, length, mmap.MAP_SHARED, mmap.PROT_READ, offset=offset)
        return np.frombuffer(mapped, np.uint8)

    def wait(self, descriptor: int, timeout_s: float) -> bool:
        """Wait for the descriptor; a signal does not end the wait."""
        import select

        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        return bool(poll.poll(timeout_s * 1000))

    def write(self, descriptor: int, data: NDArray[np.uint8]) -> None:
        os.write(descriptor, data.data)

    def close(self, descriptor: int) -> None:
        os.close(descriptor)
