"""Machine code of compiled functions, kept in files and run without numba.

Loading numba takes half a second of processor time and 80 MB.  So what numba has compiled is kept
as an object file, which LLVM alone loads (llvmlite, on which numba depends) in a tenth of the time.
The functions take arrays, numbers and tuples of these, return nothing, and call nothing but the
mathematics of C: what does not keep to this is left to numba.

numba passes an argument as the numbers that it consists of, after places for the result and for an
exception.  How it does that is not documented, and its own C functions (`numba.cfunc`) need parts
of numba when they run: before machine code is kept, a function that says what it was given is
called in the same way (`camctl.system.compiled_functions`), and the key has the version of numba.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_dir

from camctl.errors import DataError, StorageError
from camctl.system.files import write_bytes
from camctl.system.input_files import open_input

Native: TypeAlias = Callable[..., None]
"""Calls machine code with the arguments of a function."""

Kind: TypeAlias = tuple[Any, ...]
"""What of an argument decides which machine code takes it."""

#: Types of C and of LLVM of a number as it is passed.
_NUMBERS: dict[type, tuple[Any, str]] = {
    bool: (ctypes.c_bool, "i8"),
    int: (ctypes.c_int64, "i64"),
    float: (ctypes.c_double, "double"),
    np.float32: (ctypes.c_float, "float"),
    np.uint8: (ctypes.c_uint8, "i8"),
    np.uint16: (ctypes.c_uint16, "i16"),
}
_CONSTANTS = (int, float, str, bytes, tuple, np.generic)
_POINTER = (ctypes.c_void_p, "ptr")
#: What machine code may call: LLVM's own functions are instructions or of C.
_MATHEMATICS = frozenset({"sqrtf", "sqrt", "erfc", "erfcf", "exp", "expf", "log", "logf"})


#: Largest file that is read: a hundred times the largest one of this program.
_MOST_BYTES = 4 << 20


def kind_of(argument: Any) -> Kind:
    """Return the kind of an argument: arrays of one kind differ in their lengths alone."""
    if isinstance(argument, np.ndarray):
        flags = argument.flags
        order = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return argument.dtype, argument.ndim, order, flags.writeable, flags.aligned
    if isinstance(argument, tuple):
        return type(argument), *map(kind_of, argument)
    if type(argument) is int and not -(2**63) <= argument < 2**63:
        return (object,)  # as int it would lose bits
    return (type(argument),)


def _passed(kind: Kind) -> Iterator[tuple[Any, str]]:
    """Yield the types of the numbers as which an argument is passed; `KeyError` if it is none."""
    if isinstance(kind[0], np.dtype):  # owners, samples, bytes of one, place, lengths, steps
        yield from (_POINTER, _POINTER, _NUMBERS[int], _NUMBERS[int], _POINTER)
        yield from [_NUMBERS[int]] * (2 * kind[1])
    elif issubclass(kind[0], tuple):
        for each in kind[1:]:
            yield from _passed(each)
    else:
        yield _NUMBERS[kind[0]]


def _flattened(arguments: tuple[Any, ...], found: list[Any]) -> list[Any]:
    """Return the numbers as which arguments are passed, added to those that are found."""
    for each in arguments:
        if isinstance(each, np.ndarray):
            place = _address(each)
            found += (None, None, each.size, each.itemsize, place, *each.shape, *each.strides)
        elif isinstance(each, tuple):
            _flattened(each, found)
        else:
            found.append(each)
    return found


def _address(array: NDArray[Any]) -> int:
    """Return where the samples of an array are."""
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array.data))  # in a fifth of the time
    except (BufferError, TypeError, ValueError):  # it has gaps or no samples, or is not writable
        return int(array.__array_interface__["data"][0])


def _content(function: FunctionType, seen: set[FunctionType]) -> Iterator[Any]:
    """Yield what machine code of a function depends on: its code, and the constants it names.

    Names of attributes may be those of other things that are global: these do no harm.
    """
    seen.add(function)
    codes = [function.__code__]
    for code in codes:
        yield code.co_code, code.co_names, code.co_varnames
        for value in code.co_consts:
            if isinstance(value, CodeType):
                codes.append(value)
            else:
                yield value
        for name in code.co_names:
            value = function.__globals__.get(name)
            called = getattr(value, "function", None)
            if isinstance(called, FunctionType) and called not in seen:
                yield from _content(called, seen)
            elif isinstance(value, np.ndarray):
                yield value.dtype, value.shape, value.tobytes()
            elif isinstance(value, type):
                yield value.__qualname__, getattr(value, "_fields", ())
            elif isinstance(value, _CONSTANTS):
                yield value


@lru_cache(maxsize=1)
def _machine() -> tuple[str, ...]:
    """Return what all machine code depends on; LLVM is ready then."""
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    features = llvm.get_host_cpu_features().flatten()
    packages = [version(name) for name in ("numba", "llvmlite", "numpy")]
    return (
        str(sys.implementation.cache_tag),
        *packages,
        llvm.get_process_triple(),
        llvm.get_host_cpu_name(),
        features,
    )


def _for_this_machine() -> Any:
    """Return what makes machine code, with the settings that numba has."""
    import llvmlite.binding as llvm

    target = llvm.Target.from_default_triple()
    return target.create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        reloc="static" if target.name.startswith("x86") else "default",
        codemodel="jitdefault",
    )


def machine_code(text: str, symbol: str, kinds: tuple[Kind, ...]) -> bytes | None:
    """Return the object file of what numba has made of a function.

    Args:
        text: for LLVM
        symbol: its name there
        kinds: of its arguments

    Returns:
        None where the function cannot do without numba, or takes its arguments otherwise
    """
    import llvmlite.binding as llvm

    module = llvm.parse_assembly(text)
    try:
        passed = [each for kind in kinds for each in _passed(kind)]
    except KeyError:
        return None
    expected = [kind for _, kind in (_POINTER, _POINTER, *passed)]
    called = [each.name for each in module.functions if each.is_declaration]
    taken = [str(each.type) for each in module.get_function(symbol).arguments]
    if taken != expected or not all(
        each.startswith("llvm.") or each in _MATHEMATICS for each in called
    ):
        return None
    code: bytes = _for_this_machine().emit_object(module)
    return code


def native(code: bytes, symbol: str, kinds: tuple[Kind, ...]) -> Native:
    """Return what calls the function of an object file, see `machine_code`."""
    import llvmlite.binding as llvm

    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), _for_this_machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(code))
    engine.finalize_object()
    passed = [_POINTER[0]] * 2 + [c for kind in kinds for c, _ in _passed(kind)]
    call = ctypes.CFUNCTYPE(ctypes.c_int, *passed)(engine.get_function_address(symbol))

    def called(*arguments: Any, _engine: Any = engine) -> None:
        """Call it; the engine has the code as long as this function is."""
        result, exception = ctypes.c_void_p(), ctypes.c_void_p()
        places = [ctypes.addressof(result), ctypes.addressof(exception)]
        if call(*_flattened(arguments, places)):
            raise RuntimeError(f"the machine code of {symbol} ended with an error")

    return called


class KeptCode:
    """The file of the machine code of one function for some kinds of arguments.

    Files of another version of Python or numba, or of another processor, have other names: those of
    several computers may share a folder.

    Args:
        function: the function, which calls others that have an attribute `function` with theirs
        options: with which it is compiled
        kinds: of its arguments

    Raises:
        ImportError: numba is not installed as a package whose version is known
    """

    def __init__(
        self, function: FunctionType, options: dict[str, Any], kinds: tuple[Kind, ...]
    ) -> None:
        self._kinds = kinds
        content = list(_content(function, set()))
        self._key = _digest(repr((content, sorted(options.items()), kinds, _machine())))
        place = _digest(repr((kinds, _machine())))[:16]
        name = f"{function.__module__}.{function.__name__}-{place}.o"
        beside = Path(function.__code__.co_filename).parent / "__pycache__"
        self._paths = [
            each / name for each in (beside, Path(user_cache_dir("camctl")) / "compiled")
        ]

    def read(self) -> Native | None:
        """Return what the file has; None where there is none, or an older or a damaged one."""
        for path in self._paths:
            with suppress(DataError, OSError, ValueError, KeyError, TypeError):
                head, code = _own_bytes(path).split(b"\n", 1)
                stated = json.loads(head)
                if stated["key"] == self._key and stated["sha256"] == _digest(code):
                    return native(code, stated["symbol"], self._kinds)
        return None

    def keep(self, code: bytes, symbol: str) -> None:
        """Write what `machine_code` has returned, where a file can be written."""
        head = {"key": self._key, "symbol": symbol, "sha256": _digest(code)}
        for path in self._paths:
            with suppress(OSError, StorageError):
                path.parent.mkdir(parents=True, exist_ok=True)
                write_bytes(path, json.dumps(head).encode() + b"\n" + code)
                break


def _own_bytes(path: Path) -> bytes:
    """Return the content of a file that this user or the system's administrator wrote.

    Whoever can write machine code decides what this process does.

    Raises:
        DataError: the file cannot be read, or is of somebody else
    """
    with open_input(path, "") as file:
        # Windows states no owner.
        owner = os.fstat(file.fileno()).st_uid
        if hasattr(os, "geteuid") and owner not in (0, os.geteuid()):
            raise DataError(f"{path} is of another user")
        return file.read(_MOST_BYTES)


def _digest(content: str | bytes) -> str:
    return hashlib.sha256(content.encode() if isinstance(content, str) else content).hexdigest()
