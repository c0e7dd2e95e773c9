"""GenICam devices through Aravis 0.8; see `camctl.drivers.genicam.aravis_calls`."""

from __future__ import annotations

import ctypes
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import suppress
from ctypes import byref, c_double, c_int, c_int64, c_size_t, c_uint
from typing import Any, NoReturn

import numpy as np

from camctl.drivers.genicam.aravis_calls import AravisError, Functions
from camctl.drivers.genicam.port import (
    CHUNKS,
    FeatureError,
    FoundDevice,
    Kind,
    Limits,
    PacketCounts,
    Received,
    Value,
    in_use,
    lost_control,
)
from camctl.errors import CameraError, CameraNotFoundError, CameraProtocolError

#: Codes of ArvDeviceError (arvdevice.h) after which the device is gone: not connected, time-out,
#: another program controls it.
_NOT_CONTROLLER, _GONE = 10, (2, 5, 10)
_DENIED = 17  # the camera denies access: its state does not allow it, or control was lost
_SUCCESS = 0  # of ArvBufferStatus
#: ArvGvStreamOption: no packet socket, which Aravis takes where a process may (root).  With it, on
#: a busy computer, 11 of 444 streams never had a frame, whose packets lay in the UDP socket.
_NO_PACKET_SOCKET = 1
#: A frame that seems to have waited longer, s, has no valid stamp: there are few buffers.
_OLDEST_S = 60.0
_NAMES = {b"GigEVision": "GigE Vision", b"USB3Vision": "USB3 Vision"}


class AravisLibrary:
    """Finds and opens devices; a `camctl.drivers.genicam.port.Library`."""

    name = "aravis"

    def __init__(self, functions: Functions) -> None:
        self._call = functions

    def search(self) -> Sequence[FoundDevice]:
        call = self._call
        call("arv_update_device_list")

        def text(function: str, index: int) -> str:
            found: bytes | None = call(function, index)
            return (found or b"").decode("utf-8", "replace").strip()

        found = []
        for index in range(call("arv_get_n_devices")):
            protocol = call("arv_get_device_protocol", index)
            if protocol not in _NAMES:
                continue
            found.append(
                FoundDevice(
                    name=text("arv_get_device_id", index),
                    make=text("arv_get_device_vendor", index),
                    model=text("arv_get_device_model", index),
                    serial=text("arv_get_device_serial_nbr", index),
                    address=text("arv_get_device_address", index) if protocol[:1] == b"G" else "",
                    transport=_NAMES[protocol],
                )
            )
        return found

    def open(self, device: FoundDevice) -> AravisDevice:
        call = self._call
        try:
            handle = call("arv_open_device", device.name.encode())
        except AravisError as error:
            if error.code == _NOT_CONTROLLER:
                raise in_use(device.name) from error
            raise CameraNotFoundError(
                f"{device.name} cannot be opened: {error}", hint="check its cable and its power"
            ) from error
        is_network = device.transport == _NAMES[b"GigEVision"]
        if is_network and not call("arv_gv_device_is_controller", handle):
            call.unref(handle)
            raise in_use(device.name)
        return AravisDevice(call, handle, device.name, is_network=is_network)


class AravisDevice:
    """An open device; a `camctl.drivers.genicam.port.OpenDevice`."""

    def __init__(self, functions: Functions, handle: int, name: str, *, is_network: bool) -> None:
        self._call = functions
        self._is_network = is_network
        self._handle: int | None = handle
        self._name = name
        self._stream: int | None = None
        self._parser: int | None = None
        self._has_failed: set[str] = set()
        self._missing = self._resent = 0
        self._types = {
            each: functions(f"arv_gc_{each}_get_type")
            for each in ("enumeration", "boolean", "command", "integer", "float", "string")
        }

    # ---- features

    def kind(self, name: str) -> Kind | None:
        node = self._call("arv_device_get_feature", self._handle, name.encode())
        if not node or not self._is_available(name):
            return None
        # In this order: an enumeration is an integer and a text, too.
        order = (
            ("enumeration", Kind.ENUMERATION),
            ("boolean", Kind.BOOLEAN),
            ("command", Kind.COMMAND),
            ("integer", Kind.INTEGER),
            ("float", Kind.FLOAT),
            ("string", Kind.TEXT),
        )
        for each, found in order:
            if self._call.is_a(node, self._types[each]):
                return found
        return None

    def read(self, name: str) -> Value:
        kind = self._known_kind(name)
        if kind is Kind.INTEGER:
            return int(self._feature("get_integer_feature_value", name))
        if kind is Kind.FLOAT:
            return float(self._feature("get_float_feature_value", name))
        if kind is Kind.BOOLEAN:
            return bool(self._feature("get_boolean_feature_value", name))
        text: bytes | None = self._feature("get_string_feature_value", name)
        return (text or b"").decode("utf-8", "replace")

    def write(self, name: str, value: Value) -> None:
        kind = self._known_kind(name)
        if kind is Kind.INTEGER:
            self._feature("set_integer_feature_value", name, round(float(value)))
        elif kind is Kind.FLOAT:
            self._feature("set_float_feature_value", name, float(value))
        elif kind is Kind.BOOLEAN:
            self._feature("set_boolean_feature_value", name, bool(value))
        else:
            self._feature("set_string_feature_value", name, str(value).encode())

    def execute(self, name: str) -> None:
        self._feature("execute_command", name)

    def limits(self, name: str) -> Limits:
        if self._known_kind(name) is Kind.INTEGER:
            least, most = c_int64(), c_int64()
            self._feature("get_integer_feature_bounds", name, byref(least), byref(most))
            step = int(self._feature("get_integer_feature_increment", name))
            return Limits(least.value, most.value, max(step, 1))
        low, high = c_double(), c_double()
        self._feature("get_float_feature_bounds", name, byref(low), byref(high))
        return Limits(low.value, high.value, self._increment(name))

    def entries(self, name: str) -> Sequence[str]:
        count = c_uint()
        found = self._feature(
            "dup_available_enumeration_feature_values_as_strings", name, byref(count)
        )
        texts = [(found[i] or b"").decode() for i in range(count.value)]
        self._call.free(ctypes.cast(found, ctypes.c_void_p))
        return texts

    def unit(self, name: str) -> str:
        node = self._call("arv_device_get_feature", self._handle, name.encode())
        if not node or not self._call.is_a(node, self._types["float"]):
            return ""
        return (self._call("arv_gc_float_get_unit", node) or b"").decode("utf-8", "replace")

    def description(self) -> str:
        size = c_size_t()
        found = self._call("arv_device_get_genicam_xml", self._handle, byref(size))
        return ctypes.string_at(found, size.value).decode("utf-8", "replace") if found else ""

    def _increment(self, name: str) -> float:
        """Return the step of a float; 0 where the camera states none."""
        try:
            step = float(self._feature("get_float_feature_increment", name))
        except FeatureError:
            return 0.0
        return step if step > sys.float_info.min else 0.0  # what Aravis gives for none

    def _is_available(self, name: str) -> bool:
        try:
            return bool(self._call("arv_device_is_feature_available", self._handle, name.encode()))
        except AravisError as error:
            if error.code in _GONE:
                self._refused(name, error)
            return False

    def _known_kind(self, name: str) -> Kind:
        kind = self.kind(name)
        if kind is None:
            raise FeatureError(f"{self._name} has no feature {name}", hint="choose another camera")
        return kind

    def _feature(self, function: str, name: str, *arguments: Any) -> Any:
        try:
            return self._call(f"arv_device_{function}", self._handle, name.encode(), *arguments)
        except AravisError as error:
            self._refused(name, error)

    def _refused(self, name: str, error: AravisError) -> NoReturn:
        is_denied = error.code == _DENIED and self._is_network
        if error.code in _GONE or (is_denied and not self._is_controller()):
            raise lost_control(self._name, str(error)) from error
        raise FeatureError(
            f"{self._name} refuses {name}: {error}", hint="its present state does not allow it"
        ) from error

    def _is_controller(self) -> bool:
        return bool(self._call("arv_gv_device_is_controller", self._handle))

    # ---- frames

    def start(self, buffers: int) -> None:
        call, handle = self._call, self._handle
        if self._parser is None:
            self._parser = call("arv_device_create_chunk_parser", handle)
        payload = int(float(self.read("PayloadSize")))
        if self._is_network:
            # Larger frames would overflow a UDP socket where they come faster than they are read.
            options = _NO_PACKET_SOCKET if payload <= _room_of_socket() else 0
            call("arv_gv_device_set_stream_options", handle, options)
        try:
            self._stream = call("arv_device_create_stream", handle, None, None)
        except AravisError as error:
            self._refused("a stream", error)
        if not self._stream:
            raise CameraProtocolError(f"{self._name} has no stream", hint="choose another camera")
        for _ in range(buffers):
            call("arv_stream_push_buffer", self._stream, call("arv_buffer_new", payload, None))
        self.execute("AcquisitionStart")

    def stop(self) -> None:
        stream, self._stream = self._stream, None
        if stream is None:
            return
        try:
            self.execute("AcquisitionStop")
        finally:
            self._missing += self._counted(stream, b"n_missing_packets")
            self._resent += self._counted(stream, b"n_resent_packets")
            self._call.unref(stream)

    def receive(self, timeout_s: float) -> Received | None:
        call, stream = self._call, self._stream
        buffer = call("arv_stream_timeout_pop_buffer", stream, max(0, round(timeout_s * 1e6)))
        if not buffer:
            return None
        try:
            return self._received(buffer)
        finally:
            call("arv_stream_push_buffer", stream, buffer)

    def packets(self) -> PacketCounts:
        missing, resent = self._missing, self._resent
        if self._stream is not None:
            missing += self._counted(self._stream, b"n_missing_packets")
            resent += self._counted(self._stream, b"n_resent_packets")
        return PacketCounts(missing, resent)

    def close(self) -> None:
        handle = self._handle
        if handle is None:
            return
        with suppress(CameraError):  # it is gone, or stops without the command
            self.stop()
        self._handle = None
        if self._parser is not None:
            self._call.unref(self._parser)
        self._call.unref(handle)

    def _counted(self, stream: int, name: bytes) -> int:
        return int(self._call("arv_stream_get_info_uint64_by_name", stream, name))

    def _received(self, buffer: int) -> Received:
        call = self._call
        # The library stamps by the system's clock for civil time; a frame without its first packet
        # may have no stamp.
        age_s = time.time() - call("arv_buffer_get_system_timestamp", buffer) / 1e9
        number = call("arv_buffer_get_frame_id", buffer)
        arrived_s = time.monotonic() - (age_s if 0 <= age_s < _OLDEST_S else 0.0)
        if call("arv_buffer_get_status", buffer) != _SUCCESS:
            return Received(np.empty(0, np.uint8), (0, 0), 0, 0, number, arrived_s, 0.0, False)
        size, across, below = c_size_t(), c_int(), c_int()
        data = call("arv_buffer_get_data", buffer, byref(size))
        call("arv_buffer_get_image_padding", buffer, byref(across), byref(below))
        return Received(
            data=np.frombuffer(ctypes.string_at(data, size.value), np.uint8),
            shape=(
                call("arv_buffer_get_image_height", buffer),
                call("arv_buffer_get_image_width", buffer),
            ),
            code=call("arv_buffer_get_image_pixel_format", buffer),
            line_padding=across.value,
            number=number,
            arrived_s=arrived_s,
            stamp_s=call("arv_buffer_get_timestamp", buffer) / 1e9,
            is_complete=True,
            chunks=self._chunks(buffer),
        )

    def _chunks(self, buffer: int) -> dict[str, float]:
        """Return the chunks of a frame; the camera may have none of them, or some."""
        if self._parser is None or not self._call("arv_buffer_has_chunks", buffer):
            return {}
        found = {}
        for name in CHUNKS:
            if name in self._has_failed:
                continue
            value = self._chunk(buffer, f"Chunk{name}".encode())
            if value is None:
                self._has_failed.add(name)
            else:
                found[name] = value
        return found

    def _chunk(self, buffer: int, name: bytes) -> float | None:
        node = self._call("arv_device_get_feature", self._handle, name)
        if not node:
            return None
        is_integer = self._call.is_a(node, self._types["integer"])
        kind = "integer" if is_integer else "float"
        try:
            return float(
                self._call(f"arv_chunk_parser_get_{kind}_value", self._parser, buffer, name)
            )
        except AravisError:
            return None


def _room_of_socket() -> int:
    """Return how many bytes of data a UDP socket holds: half of it is for Linux itself."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        return one.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
