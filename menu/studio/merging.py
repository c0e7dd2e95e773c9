"""The section *Merge*: photographs of one scene are taken in, and merged into a capture."""

from __future__ import annotations

import re
import secrets
import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import datetime
from fractions import Fraction
from http import HTTPStatus
from pathlib import Path

from camctl.errors import CamctlError
from camctl.menu.capture_list import next_folder
from camctl.menu.entries import RESPONSES
from camctl.menu.studio.section import NOT_FOUND, Answer, RefusedError, Request
from camctl.menu.studio.studio import Studio
from camctl.messages.menu import error_text
from camctl.system.files import check_space, storage_error
from camctl.system.number_text import time_of

_PREFIX = ".photographs-"
_MOST_FILES = 64
"""Photographs of a set at most: more than the exposures of any one."""
_PART_BYTES = 1 << 20
_MERGING = threading.Lock()


def begin(studio: Studio, request: Request) -> Answer:
    """Return the name of a new set of photographs; what was left of others is removed."""
    with _alone():
        remove_sets(studio.parent)
    folder = studio.parent / f"{_PREFIX}{secrets.token_hex(8)}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise storage_error(folder, error) from error
    return Answer.of({"set": folder.name.removeprefix(_PREFIX)})


def remove_sets(parent: Path) -> None:
    """Remove all photographs that were taken in; those who sent them have them."""
    for folder in parent.glob(f"{_PREFIX}*"):
        shutil.rmtree(folder, ignore_errors=True)


def _set(studio: Studio, name: str) -> Path:
    folder = studio.parent / f"{_PREFIX}{name}"
    if not name.isalnum() or not folder.is_dir():
        raise RefusedError(NOT_FOUND, "there is no such set; drop the photographs again")
    return folder


@contextmanager
def _alone() -> Iterator[None]:
    """Hold off other sets; raises `RefusedError` while one is merged."""
    if not _MERGING.acquire(blocking=False):
        raise RefusedError(HTTPStatus.CONFLICT, "photographs are being merged; wait until they are")
    try:
        yield
    finally:
        _MERGING.release()


def responses(studio: Studio, request: Request) -> Answer:
    """Return the responses that can be requested, each with its label."""
    return Answer.of([[each.value, each.labels[0]] for each in RESPONSES])


def file(studio: Studio, request: Request) -> Answer:
    """Take a photograph in: ``merge/file/SET/NAME``, the file as the body."""
    set_name, _, name = request.rest.partition("/")
    folder = _set(studio, set_name)
    if not name or Path(name).name != name or name.startswith(".") or "\0" in name:
        raise RefusedError(HTTPStatus.BAD_REQUEST, "a photograph needs a plain name")
    if len(list(folder.iterdir())) >= _MOST_FILES:
        raise RefusedError(
            HTTPStatus.BAD_REQUEST, f"a set has {_MOST_FILES} photographs at most; drop fewer"
        )
    path = folder / name
    try:
        check_space(name, request.length, shutil.disk_usage(folder).free)
        with path.open("xb") as taken:
            left = request.length
            while left and (part := request.body.read(min(left, _PART_BYTES))):
                taken.write(part)
                left -= len(part)
    except FileExistsError:
        raise RefusedError(HTTPStatus.CONFLICT, f"{name} is there twice; rename one") from None
    except OSError as error:
        with suppress(OSError):
            path.unlink(missing_ok=True)
        raise storage_error(path, error) from error
    if left:
        path.unlink(missing_ok=True)
        raise RefusedError(HTTPStatus.BAD_REQUEST, f"{name} was not sent whole")
    return Answer.of({})


def merge(studio: Studio, request: Request) -> Answer:
    """Merge a set and return the name of the capture: ``merge/merge/SET``.

    The body has `files`, their names in order, `response`, and `times`, the exposure times in s in
    one text; "": the files state them.
    """
    from camctl.exposure.goal import CaptureRequest
    from camctl.photographs.merge import merge as merge_photographs
    from camctl.photographs.photograph_set import PhotographOptions

    folder, given = _set(studio, request.rest), request.json()
    try:
        names = [str(name) for name in given["files"]]
        wanted, times = str(given["response"]), _times(str(given["times"]))
    except (TypeError, KeyError):
        raise RefusedError(HTTPStatus.BAD_REQUEST, "there is no such choice") from None
    if wanted not in {each.value for each in RESPONSES}:
        raise RefusedError(HTTPStatus.BAD_REQUEST, "there is no such response")
    if set(names) != {path.name for path in folder.iterdir()}:
        raise RefusedError(HTTPStatus.BAD_REQUEST, "these are not the photographs of the set")
    with _alone():
        result = next_folder(studio.parent, datetime.now())
        try:
            files, options = [folder / name for name in names], PhotographOptions(times)
            merge_photographs(files, CaptureRequest(wanted), result, options=options)
        except CamctlError as error:
            # Without its photographs it cannot be continued, and it may fill the disk.
            shutil.rmtree(result, ignore_errors=True)
            text = error_text(error).replace(f"{folder}/", "")
            raise RefusedError(HTTPStatus.UNPROCESSABLE_ENTITY, text) from None
        finally:
            shutil.rmtree(folder, ignore_errors=True)
    return Answer.of({"capture": result.name})


def _times(text: str) -> tuple[float | Fraction, ...] | None:
    """Return exposure times in s; None: there are none.

    >>> _times("1/60, 0.25")
    (Fraction(1, 60), 0.25)
    """
    parts = re.split(r"[,;\s]+", text.strip())
    if parts == [""]:
        return None
    found = [time_of(each) for each in parts]
    times = tuple(each for each in found if each is not None)
    if len(times) < len(found):
        raise RefusedError(
            HTTPStatus.BAD_REQUEST, "exposure times are in seconds, such as 1/60, 1/15, 0.25"
        )
    return times
