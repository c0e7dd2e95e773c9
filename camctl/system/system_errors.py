"""What the operating system refuses, as errors of camctl: memory, threads, files."""

from __future__ import annotations

import errno
import math

from camctl.errors import OutOfMemoryError, ResourceError

#: What to do about error numbers of the system.
_ADVICE = {
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
    errno.ENFILE: "close other programs",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EACCES: "check its permissions",
    errno.EPERM: "check its permissions",
    errno.ENOENT: "check that it exists",
    errno.ENOSPC: "free some space",
    errno.EDQUOT: "free some space",
    errno.EFBIG: "raise the limit of file sizes (ulimit -f)",
    errno.EIO: "check the disk or the device",
}
_MEMORY_HINT = "choose a smaller picture, close other programs, or raise the limit (ulimit -v)"

#: Messages of the dynamic linker where memory does not suffice to load a library.
_LOADING = ("failed to map segment", "annot allocate memory", "annot create shared object")

#: cv2.error.code of OpenCV for memory that it cannot allocate (StsNoMem), and the message where the
#: C++ library cannot.
_OPENCV_NO_MEMORY, _NO_MEMORY = -4, "std::bad_alloc"


def advice(number: int | None) -> str | None:
    """Return what to do about an error of the system, by its number; None: it says nothing."""
    return _ADVICE.get(number or 0)


def resource_error(error: BaseException) -> ResourceError | None:
    """Return the error of camctl for what the system refused; None: `error` is something else.

    Python and libraries raise it as MemoryError, OSError and others.  An OSError counts only if it
    names a file, or if its number alone says what to do.
    """
    if isinstance(error, ResourceError):
        return error
    if isinstance(error, MemoryError):
        return OutOfMemoryError(f"not enough memory{_array_text(error)}", hint=_MEMORY_HINT)
    if type(error).__module__ == "cv2" and (
        getattr(error, "code", 0) == _OPENCV_NO_MEMORY or _NO_MEMORY in str(error)
    ):
        return OutOfMemoryError("not enough memory for a picture", hint=_MEMORY_HINT)
    if isinstance(error, ImportError) and any(text in str(error) for text in _LOADING):
        return OutOfMemoryError("not enough memory to load a library", hint=_MEMORY_HINT)
    if isinstance(error, RuntimeError) and "can't start new thread" in str(error):
        return ResourceError(
            "the system starts no more threads",
            hint="raise the limits of processes and of memory (ulimit -u, ulimit -v)",
        )
    return _file_error(error) if isinstance(error, OSError) else None


def _array_text(error: MemoryError) -> str:
    """Return the array that numpy could not make, such as: for an array of 7.5 GiB (...)."""
    shape, dtype = getattr(error, "shape", None), getattr(error, "dtype", None)
    if shape is None or dtype is None:
        return ""
    size = math.prod(shape) * dtype.itemsize / 2**20
    text = f"{size:.3g} MiB" if size < 1000 else f"{size / 1024:,.3g} GiB"
    return f" for an array of {text} ({' x '.join(map(str, shape))}, {dtype})"


def _file_error(error: OSError) -> ResourceError | None:
    if error.errno == errno.ENOMEM:
        return OutOfMemoryError("not enough memory", hint=_MEMORY_HINT)
    reason = (error.strerror or "").lower()
    if error.filename is not None and reason:
        what = f"cannot use {error.filename}: {reason}"
        return ResourceError(what, hint=advice(error.errno) or "check the file")
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return ResourceError(reason, hint=_ADVICE[error.errno])
    return None
