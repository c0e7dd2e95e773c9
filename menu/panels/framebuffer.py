"""A Linux frame buffer, such as a small display at a single-board computer, with its keys."""

from __future__ import annotations

import fcntl
import mmap
import os
import struct
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.errors import CamctlError, UsageError
from camctl.interface.clock import Clock
from camctl.menu.drawing import Pixels
from camctl.menu.panels.address import parse_address
from camctl.menu.panels.input_keys import InputKeys
from camctl.menu.panels.keyed import KEY_OPTIONS, keys_of
from camctl.menu.panels.pixels import PixelPanel

_VARIABLE, _FIXED = 0x4600, 0x4602
"""FBIOGET_VSCREENINFO and FBIOGET_FSCREENINFO of linux/fb.h."""

_VARIABLE_INFO = struct.Struct("@8I12I")
"""The beginning of `struct fb_var_screeninfo`: size, bits, and (offset, length, most significant
bit on the right) of red, green, blue and transparency."""

_FIXED_INFO = struct.Struct("@16sL4I3HI")
"""The beginning of `struct fb_fix_screeninfo`, up to line_length."""

_INFO_BYTES = 256  # more than either structure has


@dataclass(frozen=True)
class FrameBufferFormat:
    """How a frame buffer holds pixels.

    Attributes:
        columns, rows: visible size, pixels
        bits: bits of a pixel: 16, 24 or 32
        line_bytes: bytes from one row to the next
        first_byte: where the visible part begins
        channels: (first bit, number of bits) of red, green and blue
    """

    columns: int
    rows: int
    bits: int
    line_bytes: int
    first_byte: int
    channels: tuple[tuple[int, int], tuple[int, int], tuple[int, int]]

    @classmethod
    def parse(cls, variable: bytes, fixed: bytes) -> FrameBufferFormat:
        """Return the format from the kernel's two structures.

        Raises:
            UsageError: the menu cannot draw in this format
        """
        columns, rows, _, _, left, top, bits, _, *fields = _VARIABLE_INFO.unpack_from(variable)
        line_bytes = _FIXED_INFO.unpack_from(fixed)[-1]
        channels = tuple((fields[3 * i], fields[3 * i + 1]) for i in range(3))
        is_usable = all(0 < size <= 8 and first + size <= bits for first, size in channels)
        if bits not in (16, 24, 32) or not is_usable:
            raise UsageError(
                f"the frame buffer has {bits} bits a pixel in a format that the menu cannot draw",
                hint="set 16, 24 or 32 bits, such as with fbset -depth 16",
            )
        first_byte = top * line_bytes + left * bits // 8
        return cls(columns, rows, bits, line_bytes, first_byte, channels)  # type: ignore[arg-type]  # three channels

    def encoded(self, pixels: Pixels) -> NDArray[np.uint8]:
        """Return the bytes of a picture, (rows, columns x bytes of a pixel)."""
        value = np.zeros(pixels.shape[:2], np.uint32)
        for channel, (first, size) in enumerate(self.channels):
            value |= (pixels[..., channel].astype(np.uint32) >> (8 - size)) << first
        whole = value.view(np.uint8).reshape(*value.shape, 4)
        return whole[..., : self.bits // 8].reshape(pixels.shape[0], -1)


class FramebufferPanel(PixelPanel):
    """A display that the kernel offers as a frame buffer; a context manager.

    Args:
        address: the device, and after a comma a pattern of its input devices, as
            ``/dev/fb0,/dev/input/event*``, or the options of `camctl.menu.panels.keyed`
        clock: the clock in which input devices are looked for
    """

    def __init__(self, address: str = "/dev/fb0", *, clock: Clock | None = None) -> None:
        parsed = parse_address(address, KEY_OPTIONS)
        self._path, *pattern = parsed.words
        super().__init__(InputKeys(pattern[0]) if pattern else keys_of(parsed), clock)
        self._memory: mmap.mmap | None = None
        self._before = b""
        self._format: FrameBufferFormat | None = None

    def _open(self) -> tuple[int, int]:
        try:
            descriptor = os.open(self._path, os.O_RDWR)
        except OSError as error:
            is_denied = isinstance(error, PermissionError)
            raise CamctlError(
                f"cannot open {self._path}: {error.strerror}",
                hint="add the user to the group video, or run as root"
                if is_denied
                else "connect a display, or choose another panel",
            ) from error
        try:
            variable, fixed = self._infos(descriptor)
            self._format = found = FrameBufferFormat.parse(variable, fixed)
            length = found.first_byte + found.rows * found.line_bytes
            try:
                self._memory = mmap.mmap(descriptor, length)
            except (OSError, ValueError) as error:
                raise CamctlError(
                    f"cannot map {self._path}: {error}", hint="choose another panel"
                ) from error
            self._before = self._memory[:]
        finally:
            os.close(descriptor)
        return found.columns, found.rows

    def _infos(self, descriptor: int) -> tuple[bytes, bytes]:
        """Return the kernel's two structures; raises `UsageError` for another device."""
        try:
            return (
                fcntl.ioctl(descriptor, _VARIABLE, bytes(_INFO_BYTES)),
                fcntl.ioctl(descriptor, _FIXED, bytes(_INFO_BYTES)),
            )
        except OSError as error:
            raise UsageError(
                f"{self._path} is no frame buffer", hint="use framebuffer:/dev/fb0"
            ) from error

    def _release(self) -> None:
        memory, self._memory = self._memory, None
        if memory is not None:
            memory[:] = self._before
            memory.close()

    def _paint(self, pixels: Pixels, *, is_dark: bool) -> None:
        assert self._memory is not None  # it is open
        assert self._format is not None
        found, encoded = self._format, self._format.encoded(pixels)
        lines = np.frombuffer(
            self._memory, np.uint8, found.rows * found.line_bytes, found.first_byte
        )
        lines.reshape(found.rows, found.line_bytes)[:, : encoded.shape[1]] = encoded
