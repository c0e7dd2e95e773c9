"""The section *Captures*: files, masks, the light at a place, and deletion of captures."""

from __future__ import annotations

import shutil
import threading
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.errors import DataError
from camctl.interface.orientation import UPRIGHT, Orientation
from camctl.menu.model import State
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request
from camctl.menu.studio.studio import Studio
from camctl.records import REPORT
from camctl.system.files import storage_error
from camctl.system.picture_operations import dilated, opencv

_SHOWN = {".png": "image/png", ".jpg": "image/jpeg"}
"""Files that a browser shows, by suffix; it keeps the others."""
_BUSY = {State.SHOOTING, State.SERIES_SHOOTING, State.RESUMING, State.CANCELLING, State.STOPPING}
_LAYERS = {
    "dark": ("Too dark", (80, 120, 255)),
    "saturated": ("Saturated", (255, 60, 60)),
    "moved": ("Moved", (255, 200, 60)),
    "hot": ("Hot pixels", (90, 255, 140)),
}
"""The layers of the mask, what they are called, and the colours in which they are painted."""
_MASK_SIDE = 1600
"""Pixels of the longest side of a mask at most: a page shows no more of it."""


def _found(studio: Studio, address: str) -> tuple[Path, str, str]:
    """Return the folder of the capture that an address begins with, its name, and what follows.

    A picture of a series has the name ``SERIES/SET``.  Raises `RefusedError` where there is none.
    """
    parts = address.split("/")
    for length in (1, 2):
        folder = studio.parent.joinpath(*parts[:length])
        is_plain = all(
            each and Path(each).name == each and not each.startswith(".") for each in parts[:length]
        )
        if len(parts) < length or not is_plain or folder.is_symlink():
            break
        if (folder / REPORT).is_file():
            return folder, "/".join(parts[:length]), "/".join(parts[length:])
    raise RefusedError(NOT_FOUND, "there is no such capture")


def _folder(studio: Studio, address: str) -> Path:
    """Return the folder of a capture; raises `RefusedError` where there is none."""
    folder, _, rest = _found(studio, address)
    if rest:
        raise RefusedError(NOT_FOUND, "there is no such capture")
    return folder


def _files(folder: Path) -> list[str]:
    """Return the files of a capture and of its frames, by name."""
    found = [
        path for part in (folder, folder / "frames") if part.is_dir() for path in part.iterdir()
    ]
    names = [
        str(path.relative_to(folder))
        for path in found
        if path.is_file() and not path.is_symlink() and not path.name.startswith(".")
    ]
    return sorted(names, key=lambda name: ("/" in name, name))


def files(studio: Studio, request: Request) -> Answer:
    """Return the files of a capture with their sizes: ``captures/files/NAME``."""
    folder = _folder(studio, request.rest)
    return Answer.of(
        [{"name": name, "bytes": (folder / name).stat().st_size} for name in _files(folder)]
    )


def file(studio: Studio, request: Request) -> Answer:
    """Return a file: ``captures/file/NAME/FILE``; a picture is shown without ``keep``."""
    folder, capture, name = _found(studio, request.rest)
    if name not in _files(folder):
        raise RefusedError(NOT_FOUND, "the capture has no such file")
    kind = _SHOWN.get(Path(name).suffix)
    if kind is not None and "keep" not in request.query:
        return Answer(folder / name, kind)
    return Answer(
        folder / name,
        kind or "application/octet-stream",
        f"{capture}-{name}".replace("/", "-"),
    )


def small(studio: Studio, request: Request) -> Answer:
    """Return a small picture of a capture: ``captures/small/NAME``."""
    from camctl.menu.thumbnails import preview_picture

    return Answer.of_picture(preview_picture(_folder(studio, request.rest)))


class _Radiance:
    """The light of the capture that was looked at last."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._key: tuple[Path, int] | None = None
        self._kept: tuple[NDArray[Any], NDArray[Any], NDArray[Any], Orientation] | None = None

    def of(self, folder: Path) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], Orientation]:
        """Return light, its standard deviation, the mask, and how they lie; raises `DataError`.

        The picture that people see is upright.
        """
        from camctl.pictures.files import RADIANCE, read_deviation, read_mask, read_radiance
        from camctl.records.report_file import read_report_file

        path = folder / RADIANCE
        try:
            key = (path, path.stat().st_mtime_ns)
        except OSError:
            raise DataError(f"{folder.name} has no {RADIANCE}", hint="resume it") from None
        with self._lock:
            if self._kept is None or self._key != key:
                self._kept = None
                first = read_report_file(folder).frames[0]
                lies = UPRIGHT if first is None else first.orientation
                self._kept = read_radiance(path), read_deviation(path), read_mask(path), lies
                self._key = key
            return self._kept


_RADIANCE = _Radiance()


def layers(_: Studio, request: Request) -> Answer:
    """Return the layers of a mask: ``captures/layers``."""
    return Answer.of(
        [
            {"name": name, "title": title, "colour": "rgb({}, {}, {})".format(*colour)}
            for name, (title, colour) in _LAYERS.items()
        ]
    )


def _bits() -> dict[str, int]:
    """Return the bit of each layer in the mask."""
    from camctl.pictures.render import CONTRADICTING, DARK, HOT, SATURATED

    return dict(zip(_LAYERS, (DARK, SATURATED, CONTRADICTING, HOT), strict=True))


def light(studio: Studio, request: Request) -> Answer:
    """Return what is known of a place: ``captures/light/NAME?x=..&y=..``, shares of the picture.

    Light and standard deviation have a value for each channel; null where it is not finite.
    """
    folder = _folder(studio, request.rest)
    radiance, deviation, mask, lies = _RADIANCE.of(folder)
    try:
        shares = [float(request.query[name]) for name in ("y", "x")]
    except (KeyError, ValueError):
        shares = [-1.0]
    if not all(0 <= share <= 1 for share in shares):
        raise RefusedError(HTTPStatus.BAD_REQUEST, "there is no such place")
    for _ in range(lies.quarter_turns):
        shares = [shares[1], 1 - shares[0]]
    if lies.mirrored:
        shares[1] = 1 - shares[1]
    row, column = (
        min(int(share * length), length - 1)
        for share, length in zip(shares, radiance.shape[:2], strict=True)
    )
    bits = int(np.bitwise_or.reduce(np.atleast_1d(mask[row, column])))
    return Answer.of(
        {
            "row": row,
            "column": column,
            "light": _numbers(radiance[row, column]),
            "deviation": _numbers(deviation[row, column]),
            "layers": [name for name, bit in _bits().items() if bits & bit],
        }
    )


def _numbers(values: Any) -> list[float | None]:
    found = np.atleast_1d(values).astype(float).tolist()
    return [each if np.isfinite(each) else None for each in found]


def layer(studio: Studio, request: Request) -> Answer:
    """Return a layer of the mask as a picture to lay over: ``captures/layer/NAME/LAYER``."""
    folder, _, name = _found(studio, request.rest)
    if name not in _LAYERS or (cv2 := opencv()) is None:
        raise RefusedError(NOT_FOUND, "there is no such layer")
    bit, colour = _bits()[name], _LAYERS[name][1]
    *_, mask, lies = _RADIANCE.of(folder)
    found = np.asarray(np.atleast_3d((mask & bit) > 0).any(axis=2))
    step = max(1, -(-max(found.shape) // _MASK_SIDE))
    # A single pixel must not be lost where the layer is reduced.
    wide = dilated(found.astype(np.uint8), (step, step))[::step, ::step] > 0
    painted = np.zeros((*wide.shape, 4), np.uint8)
    painted[wide] = (*colour[::-1], 255)
    _, data = cv2.imencode(".png", np.ascontiguousarray(lies.upright(painted)))
    return Answer(bytes(data), "image/png")


def delete(studio: Studio, request: Request) -> Answer:
    """Delete a capture with all its files: ``captures/delete/NAME``."""
    folder = _folder(studio, request.rest)
    if studio.model.state in _BUSY:
        raise RefusedError(HTTPStatus.CONFLICT, "a capture is running; delete when it has ended")
    try:
        shutil.rmtree(folder)
    except OSError as error:
        raise storage_error(folder, error) from error
    return Answer.of({})
