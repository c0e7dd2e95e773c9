"""The process of a camera (`camctl.drivers.gphoto2.worker`), and the errors of libgphoto2."""

from __future__ import annotations

import json
import logging
import os
import re
import select
import subprocess
import sys
from collections.abc import Mapping
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path
from typing import Any, TypeAlias

from camctl.drivers.common.device_holders import holding
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
)
from camctl.interface.clock import Clock, cancelled_by, wait_for

#: Silence after which the process counts as hanging, s: longer than all time-outs of libgphoto2
#: but its time-out of a capture.
SILENCE_S = 60.0
#: A busy camera is asked again after the first pause, then after twice that, and so on, s.
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.05, 2.0
_END_S = 5.0
_log = logging.getLogger(__name__)
_TO_SHOOTING = "turn the mode dial to M, and leave playback, menus and movie mode on the camera"
_AGAIN = "switch the camera off and on again, then resume"
_LIST_CAMERAS = "list the cameras that are connected"
_RELEASE_IT = (
    "desktops mount cameras by themselves: unmount it there, or end gvfs-gphoto2-volume-monitor, "
    "and try again"
)
_LOOK = (
    "look at its display: mode dial at M and no playback or movie mode, lens on manual focus and "
    "without cap, card in, battery charged; then try again"
)


class FullError(CameraError):
    """The camera has no room for another picture."""


#: Error class, what happened, what to do.
_Meaning: TypeAlias = tuple[type[CameraError], str, str]

#: A camera that is not opened without a reason of libgphoto2; in the network it gives none for
#: a wrong address, a camera that is not there, and one that refuses this computer.
_CANNOT_OPEN: _Meaning = (
    CameraError,
    "cannot be opened",
    "end other programs that use it; else switch the camera off and on again, and try again",
)
_CANNOT_REACH: _Meaning = (
    CameraNotFoundError,
    "is not to be reached in the network, or refuses this computer",
    "check the address, switch its network remote control on, pair this computer in its menu, and "
    "end other programs that use it",
)


#: Words in the reason that libgphoto2 gives for an error whose number says nothing: error class,
#: what happened, what to do on the body.
_REASONS: Mapping[str, _Meaning] = {
    r"\blens\b|fnumber": (
        CameraError,
        "has its lens covered or not in working position",
        "take the lens cap off, extend a retractable lens, turn an aperture ring to its highest "
        "number, mount the lens firmly",
    ),
    r"focus": (
        CameraError,
        "cannot focus",
        "set the lens to manual focus (MF), and take the lens cap off",
    ),
    r"store not available": (CameraError, "has no card", "put a card in and close the lid"),
    r"store read only": (CameraError, "has a write-protected card", "unlock the card"),
    r"store full": (
        FullError,
        "has no memory left for a picture",
        "delete pictures, or change its card",
    ),
    r"invalid status|access denied|refused": (
        CameraError,
        "cannot do that in its present mode",
        _TO_SHOOTING,
    ),
}
#: libgphoto2's error numbers (gphoto2-port-result.h, gphoto2-result.h): error class, what
#: happened, what to do.
_UNEXPLAINED, _BUSY = -1, -110
_TRANSFER_FAILED, _SILENT = -7, -10
_MEANINGS: Mapping[int, _Meaning] = {
    -3: (FullError, "has no memory left for a picture", "delete pictures, or change its card"),
    -5: (CameraNotFoundError, "has no such port", _LIST_CAMERAS),
    _TRANSFER_FAILED: (CameraDisconnectedError, "failed a transfer", "plug it in again and resume"),
    _SILENT: (CameraTimeoutError, "does not answer", _AGAIN),
    -34: (CameraDisconnectedError, "failed a transfer", "plug it in again and resume"),
    -35: (CameraDisconnectedError, "failed a transfer", "plug it in again and resume"),
    -52: (CameraDisconnectedError, "is not connected", "plug it in, switch it on and try again"),
    -53: (CameraBusyError, "is in use by another program", _RELEASE_IT),
    -60: (CameraBusyError, "is locked by another program", _RELEASE_IT),
    -105: (CameraNotFoundError, "is not connected, or not known to libgphoto2", _LIST_CAMERAS),
    -108: (CameraProtocolError, "does not have the file that it made", "shoot it again"),
    _BUSY: (CameraBusyError, "is busy", "wait until it has stored its pictures, then resume"),
    -113: (
        CameraError,
        "refused",
        "look at its display: mode dial at M, lens on manual focus, card in, battery charged",
    ),
    -115: (FullError, "has no memory left for a picture", "delete pictures, or change its card"),
}


class UnexplainedError(CameraError):
    """libgphoto2 gives no reason for an error."""


class LibraryError(Exception):
    """An error of libgphoto2: its number and its text."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code, self.text = code, text


def is_installed() -> bool:
    """Return whether the package gphoto2 is installed; it is not imported."""
    return find_spec("gphoto2") is not None


class CameraProcess:
    """A running process for one camera; a context manager.

    Args:
        name: of the camera in error messages
        clock: for pauses while the camera is busy

    Raises:
        CameraError: the package gphoto2 is not installed
    """

    def __init__(self, name: str, clock: Clock) -> None:
        if not is_installed():
            raise CameraError(
                "the backend gphoto2 needs the package gphoto2",
                hint="pip install 'camctl[gphoto2]'",
            )
        self.name = name
        self._clock = clock
        script = Path(__file__).with_name("worker.py")
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Control-C is the controller's to handle
        )
        self._rest = b""
        #: Until when the answer may come that a cancelled capture has not waited for.
        self._owed_until_s: float | None = None

    @property
    def process_id(self) -> int:
        return self._process.pid

    def close(self) -> None:
        """Disconnect from the camera and end the process, by force if it hangs."""
        process = self._process
        with suppress(OSError, ValueError):
            assert process.stdin is not None
            process.stdin.close()
        try:
            process.wait(_END_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.stdout is not None:
            process.stdout.close()

    def __enter__(self) -> CameraProcess:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def ask(
        self,
        do: str,
        *,
        silence_s: float = SILENCE_S,
        cancelled_s: float = SILENCE_S,
        busy_s: float = 0.0,
        **arguments: Any,
    ) -> Any:
        """Return the result of a request; a file as bytes.

        Args:
            do: name of a method of `camctl.drivers.gphoto2.worker.Worker`
            silence_s: the process is ended after so long without an answer
            cancelled_s: likewise, if the capture was cancelled meanwhile
            busy_s: how long a busy camera is asked again, with growing pauses
            arguments: of the method

        Raises:
            CameraError: as libgphoto2 reports, or the process has ended
        """
        began_s, pause_s = self._clock.now(), _FIRST_PAUSE_S
        while True:
            try:
                return self._ask_once(do, arguments, silence_s, cancelled_s)
            except LibraryError as error:
                waited_s = self._clock.now() - began_s
                if error.code != _BUSY or waited_s >= busy_s:
                    raise self._camera_error(error, do) from None
            self._clock.sleep_until(self._clock.now() + pause_s)
            pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)

    def _ask_once(
        self, do: str, arguments: dict[str, Any], silence_s: float, cancelled_s: float
    ) -> Any:
        if self._owed_until_s is not None:
            left_s = max(0.0, self._owed_until_s - self._clock.now())
            _log.info(
                "waiting for the end of what %s does, for up to %.0f s: libgphoto2 cannot end it",
                self.name,
                left_s,
            )
            with cancelled_by(None):
                self._answer(left_s)
        line = json.dumps({"do": do, **arguments}).encode() + b"\n"
        try:
            assert self._process.stdin is not None
            self._process.stdin.write(line)
            self._process.stdin.flush()
        except (OSError, ValueError):
            raise self._ended() from None
        self._owed_until_s = self._clock.now() + cancelled_s
        answer, data = self._answer(silence_s)
        if "code" in answer:
            raise LibraryError(answer["code"], answer["text"])
        return data or answer["result"]

    def _answer(self, silence_s: float) -> tuple[dict[str, Any], bytes]:
        """Return the next answer, and the file that comes with it.

        Raises:
            InterruptedCaptureError: the capture was cancelled; the answer is still to come
        """
        answer = json.loads(self._line(silence_s))
        with cancelled_by(None):  # a file that has begun is read to its end
            data = self._bytes(answer.get("bytes", 0), silence_s)
        self._owed_until_s = None
        return answer, data

    def _line(self, silence_s: float) -> bytes:
        while b"\n" not in self._rest:
            self._rest += self._read(silence_s)
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _bytes(self, count: int, silence_s: float) -> bytes:
        parts, missing = [self._rest[:count]], count - len(self._rest[:count])
        self._rest = self._rest[count:]
        while missing > 0:
            parts.append(self._read(silence_s))
            missing -= len(parts[-1])
        return b"".join(parts)

    def _read(self, silence_s: float) -> bytes:
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        poll = select.poll()
        poll.register(descriptor, select.POLLIN)
        if not wait_for(lambda limit_s: bool(poll.poll(limit_s * 1000)), silence_s):
            self._process.kill()
            raise CameraTimeoutError(
                f"{self.name} does not answer for {silence_s:.0f} s", hint=_AGAIN
            )
        data = os.read(descriptor, 1 << 20)
        if not data:
            raise self._ended()
        return data

    def _ended(self) -> CameraDisconnectedError:
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_END_S)
        return CameraDisconnectedError(
            f"libgphoto2's process for {self.name} ended with status {self._process.returncode}",
            hint=_AGAIN,
        )

    def _camera_error(self, error: LibraryError, do: str) -> CameraError:
        text = " ".join(error.text.split())
        # libgphoto2 reports a port without a camera as a missing file
        code = -5 if do == "open" and error.code == -108 else error.code
        reasons = (
            meaning for word, meaning in _REASONS.items() if re.search(word, text, re.IGNORECASE)
        )
        if do == "open":
            is_remote = ":ptpip:" in self.name
            general = _CANNOT_REACH if is_remote else _CANNOT_OPEN
            if is_remote and code in (_TRANSFER_FAILED, _SILENT):
                code = _UNEXPLAINED
        elif do == "apply":
            general = CameraError, "does not accept a setting", _TO_SHOOTING
        else:
            general = UnexplainedError, f"failed to {do}", _LOOK
        kind, what, hint = _MEANINGS.get(code) or next(reasons, general)
        users = self._users() if kind is CameraBusyError else ""
        by = f": {users}" if users else ""
        remedies = {"cameras": None} if hint == _LIST_CAMERAS else None
        what = f"{self.name} {what}{by} (libgphoto2: {text}, {error.code})"
        return kind(what, hint=hint, remedies=remedies)

    def _users(self) -> str:
        """Return the other programs that have the camera's USB device open."""
        place = re.search(r"usb:(\d+),(\d+)$", self.name)
        if place is None:
            return ""
        found = holding(f"/dev/bus/usb/{place[1]}/{place[2]}")
        own = (os.getpid(), self.process_id)
        return ", ".join(
            f"{each.program} (process {each.process})" for each in found if each.process not in own
        )
