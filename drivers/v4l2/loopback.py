"""Writing to a video device that other programs read as a camera (v4l2loopback)."""

from __future__ import annotations

import ctypes
import errno
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from camctl.drivers.v4l2 import abi
from camctl.drivers.v4l2.kernel import Linux, WritingKernel
from camctl.errors import StorageError

#: V4L2_BUF_TYPE_VIDEO_OUTPUT, V4L2_FIELD_NONE and V4L2_COLORSPACE_SRGB of videodev2.h.
_OUTPUT, _PROGRESSIVE, _SRGB = 2, 1, 8
#: V4L2_CAP_VIDEO_OUTPUT of videodev2.h.
_CAN_OUTPUT = 0x00000002
#: Numbers of YUYV are of limited range (BT.601) unless a device says otherwise, and every program
#: that reads a webcam takes them so: from those of full range.
_LUMA = np.rint(16 + 219 / 255 * np.arange(256)).astype(np.uint8)
_CHROMA = np.rint(128 + 224 / 255 * (np.arange(256) - 128.0)).astype(np.uint8)
_HINT = "load it with: sudo modprobe v4l2loopback exclusive_caps=1 card_label=camctl"


class LoopbackDevice:
    """A video output; every program that takes webcams takes its YUYV.

    Args:
        path: such as /dev/video2
        shape: (rows, columns) of the pictures; of an odd number of columns the last is left out
        kernel: the system calls, replaced in tests

    Raises:
        StorageError: there is no such device, it is no output, is used by another program, or has
            another size
    """

    def __init__(
        self, path: str, shape: tuple[int, int], kernel: WritingKernel | None = None
    ) -> None:
        self._kernel: WritingKernel = kernel or Linux()
        self._path = path
        self._shape = shape[0], shape[1] & ~1
        try:
            self._descriptor: int | None = self._kernel.open(path)
        except OSError as error:
            raise StorageError(
                f"cannot open {path}: {error.strerror}", hint=_hint_for(error)
            ) from error
        try:
            self._set_format()
        except BaseException:
            self.close()
            raise

    def _set_format(self) -> None:
        assert self._descriptor is not None
        rows, columns = self._shape
        capability = abi.Capability()
        wanted = abi.Format(
            type=_OUTPUT,
            width=columns,
            height=rows,
            pixelformat=abi.fourcc("YUYV"),
            field=_PROGRESSIVE,
            bytesperline=2 * columns,
            sizeimage=2 * columns * rows,
            colorspace=_SRGB,
        )
        try:
            self._kernel.ioctl(self._descriptor, abi.Request.QUERYCAP, capability)
            if not (capability.capabilities | capability.device_caps) & _CAN_OUTPUT:
                raise StorageError(f"{self._path} is a camera, and takes no pictures", hint=_HINT)
            self._kernel.ioctl(self._descriptor, abi.Request.S_FMT, wanted)
        except OSError as error:
            raise StorageError(
                f"{self._path} takes no pictures: {error.strerror}", hint=_hint_for(error)
            ) from error
        found = int(wanted.width), int(wanted.height), int(wanted.pixelformat)
        if found != (columns, rows, abi.fourcc("YUYV")):
            raise StorageError(
                f"{self._path} is set to {found[0]}x{found[1]} {_name(found[2])}, and the "
                f"pictures are {columns}x{rows} YUYV",
                hint="close the program that reads it, or set the camera to that size",
            )

        # Version 0.12 with exclusive_caps=1 takes a program that only writes for no writer, and is
        # no output any more until it is loaded again; later versions need this not, and refuse it.
        with suppress(OSError):
            self._kernel.ioctl(self._descriptor, abi.Request.STREAMON, abi.BufferType(_OUTPUT))

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Show a picture, (rows, columns) or Y, Cb and Cr of full range (rows, columns, 3).

        Raises:
            StorageError: the device is gone
        """
        rows, columns = self._shape
        picture = picture[:rows, :columns]
        data = np.full((rows, columns, 2), 128, np.uint8)
        if picture.ndim == 2:
            data[..., 0] = _LUMA[picture]
        else:
            data[..., 0] = _LUMA[picture[..., 0]]
            for place in (0, 1):  # of each two pixels one Cb and one Cr
                data[:, place::2, 1] = _CHROMA[picture[:, ::2, 1 + place]]
        assert self._descriptor is not None
        try:
            self._kernel.write(self._descriptor, data)
        except BlockingIOError:
            return  # nobody has taken the last one yet
        except OSError as error:
            raise StorageError(
                f"cannot write to {self._path}: {error.strerror}", hint=_hint_for(error)
            ) from error

    def close(self) -> None:
        """Close the device."""
        descriptor, self._descriptor = self._descriptor, None
        if descriptor is not None:
            self._kernel.close(descriptor)


def _name(fourcc: int) -> str:
    return abi.text((ctypes.c_uint8 * 4)(*fourcc.to_bytes(4, "little")))


def _hint_for(error: OSError) -> str:
    if error.errno == errno.EBUSY:
        return "close the program that writes to it"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "add yourself to the group video"
    return _HINT
