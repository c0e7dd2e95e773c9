"""The functions of Aravis 0.8, a C library for GenICam cameras, and their types.

They are called directly (https://github.com/AravisProject/aravis).  The Python package for it, gi,
belongs to the system's own Python and cannot be seen from a virtual environment; the shared library
can.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from contextlib import suppress
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint64
from ctypes import c_void_p as pointer
from ctypes.util import find_library
from functools import cache
from typing import Any

_FILES = ("libaravis-0.8.so.0", "libaravis-0.8.0.dylib", "libaravis-0.8.dylib")
_GOBJECT_FILES = ("libgobject-2.0.so.0", "libgobject-2.0.0.dylib", "libgobject-2.0.dylib")


class _Error(ctypes.Structure):
    """GError of GLib."""

    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


_ErrorPointer = POINTER(_Error)

#: Result and arguments of each function that is called, without the last one, GError **, of those
#: that are in `_WITH_ERROR`.
_FUNCTIONS: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (c_uint, ()),
    "arv_get_device_id": (c_char_p, (c_uint,)),
    "arv_get_device_vendor": (c_char_p, (c_uint,)),
    "arv_get_device_model": (c_char_p, (c_uint,)),
    "arv_get_device_serial_nbr": (c_char_p, (c_uint,)),
    "arv_get_device_address": (c_char_p, (c_uint,)),
    "arv_get_device_protocol": (c_char_p, (c_uint,)),
    "arv_open_device": (pointer, (c_char_p,)),
    "arv_gv_device_is_controller": (c_int, (pointer,)),
    "arv_gv_device_set_stream_options": (None, (pointer, c_int)),
    "arv_gc_float_get_type": (c_size_t, ()),
    "arv_gc_integer_get_type": (c_size_t, ()),
    "arv_gc_enumeration_get_type": (c_size_t, ()),
    "arv_gc_boolean_get_type": (c_size_t, ()),
    "arv_gc_command_get_type": (c_size_t, ()),
    "arv_gc_string_get_type": (c_size_t, ()),
    "arv_gc_float_get_unit": (c_char_p, (pointer,)),
    "arv_device_get_feature": (pointer, (pointer, c_char_p)),
    "arv_device_is_feature_available": (c_int, (pointer, c_char_p)),
    "arv_device_execute_command": (None, (pointer, c_char_p)),
    "arv_device_get_boolean_feature_value": (c_int, (pointer, c_char_p)),
    "arv_device_set_boolean_feature_value": (None, (pointer, c_char_p, c_int)),
    "arv_device_get_string_feature_value": (c_char_p, (pointer, c_char_p)),
    "arv_device_set_string_feature_value": (None, (pointer, c_char_p, c_char_p)),
    "arv_device_get_integer_feature_value": (c_int64, (pointer, c_char_p)),
    "arv_device_set_integer_feature_value": (None, (pointer, c_char_p, c_int64)),
    "arv_device_get_integer_feature_bounds": (
        None,
        (pointer, c_char_p, POINTER(c_int64), POINTER(c_int64)),
    ),
    "arv_device_get_integer_feature_increment": (c_int64, (pointer, c_char_p)),
    "arv_device_get_float_feature_value": (c_double, (pointer, c_char_p)),
    "arv_device_set_float_feature_value": (None, (pointer, c_char_p, c_double)),
    "arv_device_get_float_feature_bounds": (
        None,
        (pointer, c_char_p, POINTER(c_double), POINTER(c_double)),
    ),
    "arv_device_get_float_feature_increment": (c_double, (pointer, c_char_p)),
    "arv_device_dup_available_enumeration_feature_values_as_strings": (
        POINTER(c_char_p),
        (pointer, c_char_p, POINTER(c_uint)),
    ),
    "arv_device_get_genicam_xml": (pointer, (pointer, POINTER(c_size_t))),
    "arv_device_create_chunk_parser": (pointer, (pointer,)),
    "arv_chunk_parser_get_float_value": (c_double, (pointer, pointer, c_char_p)),
    "arv_chunk_parser_get_integer_value": (c_int64, (pointer, pointer, c_char_p)),
    "arv_device_create_stream": (pointer, (pointer, pointer, pointer)),
    "arv_stream_push_buffer": (None, (pointer, pointer)),
    "arv_stream_timeout_pop_buffer": (pointer, (pointer, c_uint64)),
    "arv_stream_get_info_uint64_by_name": (c_uint64, (pointer, c_char_p)),
    "arv_buffer_new": (pointer, (c_size_t, pointer)),
    "arv_buffer_get_status": (c_int, (pointer,)),
    "arv_buffer_get_data": (pointer, (pointer, POINTER(c_size_t))),
    "arv_buffer_get_frame_id": (c_uint64, (pointer,)),
    "arv_buffer_get_system_timestamp": (c_uint64, (pointer,)),
    "arv_buffer_get_timestamp": (c_uint64, (pointer,)),
    "arv_buffer_get_image_pixel_format": (ctypes.c_uint32, (pointer,)),
    "arv_buffer_get_image_width": (c_int, (pointer,)),
    "arv_buffer_get_image_height": (c_int, (pointer,)),
    "arv_buffer_get_image_padding": (None, (pointer, POINTER(c_int), POINTER(c_int))),
    "arv_buffer_has_chunks": (c_int, (pointer,)),
}
_WITHOUT_ERROR = (
    "arv_device_get_feature",
    "arv_device_create_chunk_parser",
    "arv_device_get_genicam_xml",
)
_WITH_ERROR = frozenset(
    name
    for name in _FUNCTIONS
    if name.startswith(("arv_device_", "arv_chunk_parser_")) and name not in _WITHOUT_ERROR
) | {"arv_open_device"}


class AravisError(Exception):
    """An error that Aravis reports.

    Attributes:
        code: of ArvDeviceError where a function of a device has failed
    """

    def __init__(self, text: str, code: int) -> None:
        super().__init__(text)
        self.code = code


class Functions:
    """The functions of the shared libraries, with their types; errors of Aravis are raised."""

    def __init__(self, library: ctypes.CDLL, gobject: ctypes.CDLL) -> None:
        self._calls: dict[str, Callable[..., Any]] = {}
        for name, (result, arguments) in _FUNCTIONS.items():
            function = getattr(library, name)
            has_error = name in _WITH_ERROR
            function.restype = result
            function.argtypes = (*arguments, POINTER(_ErrorPointer)) if has_error else arguments
            self._calls[name] = function
        self.unref = gobject.g_object_unref
        self.unref.argtypes = (pointer,)
        self.is_a = gobject.g_type_check_instance_is_a
        self.is_a.restype, self.is_a.argtypes = c_int, (pointer, c_size_t)
        glib = gobject  # the symbols of GLib, on which it depends, are found through it
        self._free_error = glib.g_error_free
        self._free_error.argtypes = (_ErrorPointer,)
        self.free = glib.g_free
        self.free.argtypes = (pointer,)

    def __call__(self, name: str, *arguments: Any) -> Any:
        """Return the result of a function.

        Raises:
            AravisError: Aravis reports an error
        """
        if name not in _WITH_ERROR:
            return self._calls[name](*arguments)
        error = _ErrorPointer()
        result = self._calls[name](*arguments, byref(error))
        if error:
            code, message = error.contents.code, error.contents.message or b""
            self._free_error(error)
            raise AravisError(message.decode("utf-8", "replace"), code)
        return result


@cache
def load() -> Functions | None:
    """Return the functions of Aravis; None where the library is not installed."""
    found = find_library("aravis-0.8")
    for file in (*_FILES, *([found] if found else [])):
        with suppress(OSError, AttributeError):
            library = ctypes.CDLL(file)
            for other in _GOBJECT_FILES:
                with suppress(OSError):
                    return Functions(library, ctypes.CDLL(other))
    return None
