"""Dumb buffers of a Linux graphics device (drm/drm_mode.h): structures, requests, and a display."""

from __future__ import annotations

import array
import ctypes
import fcntl
import mmap
import os
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeVar


def _structure(**fields: str) -> type[ctypes.Structure]:
    """Return a structure of fields, which are listed by their types, in their order."""
    kinds = {"u64": ctypes.c_uint64, "u32": ctypes.c_uint32}
    listed = [(n, kinds[kind]) for kind, names in fields.items() for n in names.split()]
    return type("Structure", (ctypes.Structure,), {"_fields_": listed})


class _Mode(ctypes.Structure):
    _fields_ = (
        ("clock", ctypes.c_uint32),
        ("columns", ctypes.c_uint16),
        ("_horizontal", ctypes.c_uint16 * 4),
        ("rows", ctypes.c_uint16),
        ("_vertical", ctypes.c_uint16 * 4),
        ("_other", ctypes.c_uint32 * 3),
        ("name", ctypes.c_char * 32),
    )


class _Crtc(ctypes.Structure):
    _fields_ = (
        ("connectors", ctypes.c_uint64),
        *((n, ctypes.c_uint32) for n in ("connector_count", "crtc", "fb", "x", "y", "gamma")),
        ("has_mode", ctypes.c_uint32),
        ("mode", _Mode),
    )


_Resources = _structure(
    u64="fbs crtcs connectors encoders",
    u32="fb_count crtc_count connector_count encoder_count least_x most_x least_y most_y",
)
_Encoder = _structure(u32="encoder kind crtc crtcs clones")
_Connector = _structure(
    u64="encoders modes properties values",
    u32="mode_count property_count encoder_count encoder connector kind number state width_mm "
    "height_mm subpixel _pad",
)
_Dumb = _structure(u32="rows columns bits flags handle line_bytes", u64="bytes")
_Map = _structure(u32="handle _pad", u64="offset")
_Fb = _structure(u32="fb columns rows line_bytes bits depth handle")
_Dirty = _structure(u32="fb flags colour count", u64="clips")

_NUMBERS: dict[type[ctypes.Structure], int] = {
    _Resources: 0xA0,
    _Encoder: 0xA6,
    _Connector: 0xA7,
    _Fb: 0xAE,
    _Dirty: 0xB1,
    _Dumb: 0xB2,
    _Map: 0xB3,
}
"""Requests that are known by their structure; all read and write it."""

_Record = TypeVar("_Record", bound=ctypes.Structure)
_Data = TypeVar("_Data", bound=ctypes.Structure | ctypes.c_uint32)

_GET_CRTC, _SET_CRTC, _REMOVE_FB, _DESTROY_DUMB = 0xA1, 0xA2, 0xAF, 0xB4
_CONNECTED = 1


@dataclass(frozen=True)
class Output:
    """A connector with a display, a source of pictures for it, and the mode to use."""

    connector: int
    crtc: int
    mode: _Mode


class DrmDisplay:
    """A display with a dumb buffer of 32 bits a pixel, blue in the lowest byte (XRGB8888).

    Drivers of displays with other formats convert this one.

    Args:
        path: the device, such as /dev/dri/card0

    Attributes:
        columns, rows: size of the display in its preferred mode, pixels
        line_bytes: bytes from one row to the next
        memory: the buffer; `flush` brings it to the display

    Raises:
        OSError: it is not there, it is no graphics device (ENOTTY), it has no dumb buffers
            (EOPNOTSUPP), it may not be opened, or another program shows pictures on it (EACCES)
        LookupError: no display is connected to it
    """

    def __init__(self, path: str) -> None:
        self._device = os.open(path, os.O_RDWR | os.O_CLOEXEC)
        self._fb = self._handle = 0
        self._before: _Crtc | None = None
        try:
            output = next(self._outputs(), None)
            if output is None:
                raise LookupError("no display is connected")
            self._output = output
            self.columns, self.rows = output.mode.columns, output.mode.rows
            dumb = _Dumb(rows=self.rows, columns=self.columns, bits=32)
            self._request(dumb)
            self._handle, self.line_bytes = dumb.handle, dumb.line_bytes
            self._fb = self._request(
                _Fb(
                    columns=self.columns,
                    rows=self.rows,
                    line_bytes=self.line_bytes,
                    bits=32,
                    depth=24,
                    handle=self._handle,
                )
            ).fb
            place = self._request(_Map(handle=self._handle)).offset
            self.memory = mmap.mmap(self._device, dumb.bytes, offset=place)
            self._before = self._call(_GET_CRTC, _Crtc(crtc=output.crtc))
            self._set(self._fb, output.mode)
        except BaseException:
            self.close()
            raise

    def flush(self) -> None:
        """Bring the buffer to the display; raises OSError where it is gone.

        Displays on a serial bus show nothing without it; drivers that scan the buffer out answer
        that they need it not.
        """
        try:
            self._request(_Dirty(fb=self._fb))
        except OSError as error:
            if error.errno not in (38, 95, 22):  # ENOSYS, EOPNOTSUPP, EINVAL
                raise

    def close(self) -> None:
        """Show again what was shown before, and release the buffer."""
        memory = getattr(self, "memory", None)
        if memory is not None:
            memory.close()
        for number, argument in (
            (_SET_CRTC, self._restored()),
            (_REMOVE_FB, ctypes.c_uint32(self._fb) if self._fb else None),
            (_DESTROY_DUMB, ctypes.c_uint32(self._handle) if self._handle else None),
        ):
            if argument is not None:
                try:
                    self._call(number, argument)
                except OSError:
                    continue  # the device is gone, or closing it releases the rest
        os.close(self._device)

    def _restored(self) -> _Crtc | None:
        before = self._before
        if before is None or not before.fb:
            return None
        self._connectors = (ctypes.c_uint32 * 1)(self._output.connector)
        before.connectors, before.connector_count = ctypes.addressof(self._connectors), 1
        return before

    def _set(self, fb: int, mode: _Mode) -> None:
        connectors = (ctypes.c_uint32 * 1)(self._output.connector)
        self._call(
            _SET_CRTC,
            _Crtc(
                connectors=ctypes.addressof(connectors),
                connector_count=1,
                crtc=self._output.crtc,
                fb=fb,
                has_mode=1,
                mode=mode,
            ),
        )

    def _outputs(self) -> Iterator[Output]:
        """Yield each connected display with the first source that can serve it."""
        counts = self._request(_Resources())
        crtcs = array.array("I", bytes(4 * counts.crtc_count))
        connectors = array.array("I", bytes(4 * counts.connector_count))
        self._request(
            _Resources(
                crtcs=crtcs.buffer_info()[0],
                crtc_count=len(crtcs),
                connectors=connectors.buffer_info()[0],
                connector_count=len(connectors),
            )
        )
        for number in connectors:
            sizes = self._request(_Connector(connector=number))
            if sizes.state != _CONNECTED or not sizes.mode_count:
                continue
            modes = (_Mode * sizes.mode_count)()
            encoders = array.array("I", bytes(4 * sizes.encoder_count))
            self._request(
                _Connector(
                    connector=number,
                    modes=ctypes.addressof(modes),
                    mode_count=len(modes),
                    encoders=encoders.buffer_info()[0],
                    encoder_count=len(encoders),
                )
            )
            for encoder in encoders:
                possible = self._request(_Encoder(encoder=encoder)).crtcs
                for index, crtc in enumerate(crtcs):
                    if possible >> index & 1:
                        yield Output(number, crtc, modes[0])

    def _request(self, argument: _Record) -> _Record:
        return self._call(_NUMBERS[type(argument)], argument)

    def _call(self, number: int, argument: _Data) -> _Data:
        """Make the request `DRM_IOWR(number, argument)`; return the argument, as it was written."""
        size = ctypes.sizeof(argument)
        fcntl.ioctl(self._device, 3 << 30 | size << 16 | ord("d") << 8 | number, argument)
        return argument
