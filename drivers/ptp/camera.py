"""A PTP still camera behind the interface of `camctl.camera`.

While one exposure runs, the file of the one before is fetched, where the camera allows it.  No
setting is taken on trust: each is read back before the shutter is released.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from contextlib import ExitStack, suppress
from functools import cached_property
from typing import Any

from camctl.camera import CameraInfo, Closing, Frame, FrameStream
from camctl.clock import Clock, RealClock
from camctl.controls import Choices, Control, ExposureControls, ExposureSetting, Steps
from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    UsageError,
    unknown_name,
)
from camctl.response.camera import STANDARDS, standard_response
from drivers.common.still_file import read_still
from drivers.common.usb import device_name, usb_identity
from drivers.ptp.body import Body
from drivers.ptp.datasets import ObjectInfo
from drivers.ptp.dialects import STANDARD
from drivers.ptp.sequence import Dials, ExposureSequence
from drivers.ptp.session import Session
from drivers.ptp.shooting import Shooter
from drivers.ptp.still_formats import (
    FORMATS,
    KnownFormat,
    format_of,
    from_profile,
    newest,
    remember,
)
from drivers.ptp.transport import CAPTURE_S, NORMAL_S, UsbTransport

_TRY_S = 0.01
_CLOSING_S = 5.0
MOST_BULB_S = 3600.0


class PtpCamera(Closing):
    """A still camera on USB.

    Args:
        device: a pyusb `Device` of any backend
        format: raw, tiff, jpeg, or auto for the best that the camera makes
        response: of JPEG and TIFF files: srgb, rec709, linear, or power (1/2.2)
        bulb_s: offer shutter times up to this, held by this computer; None: the camera's own alone
        delete: delete files from the card once they have been fetched
        clock: of timestamps
        silence_s: how long the camera may say nothing
        capture_s: how long a picture may take beyond its exposure

    Raises:
        CameraNotFoundError: not a still camera, or no permission
        CameraBusyError: another program holds it
        CameraError: it is in a mode in which it chooses the exposure itself
        UsageError: a format, response or bulb time that makes no sense
    """

    def __init__(
        self,
        device: Any,
        *,
        format: str = "auto",
        response: str = "srgb",
        bulb_s: float | None = None,
        delete: bool = False,
        clock: Clock | None = None,
        silence_s: float = NORMAL_S,
        capture_s: float = CAPTURE_S,
    ) -> None:
        if format not in (*FORMATS, "auto"):
            raise unknown_name("format of a PTP camera", format, (*FORMATS, "auto"))
        if response not in STANDARDS:
            raise unknown_name("camera response", response, STANDARDS)
        if bulb_s is not None and not 1 <= bulb_s <= MOST_BULB_S:
            raise UsageError(f"bulb times up to {bulb_s:g} s", hint="give 1 to 3600 s")
        self._who = device_name(device)
        self._wanted = None if format == "auto" else format
        self._response = response
        self._clock = clock if clock is not None else RealClock()
        self._notes: list[str] = []
        self._is_shooting = False
        with ExitStack() as undo:
            transport = UsbTransport(device, self._who)
            undo.callback(transport.close)
            self._session = Session(transport, self._who, silence_s=silence_s, busy_s=silence_s)
            self._session.open()
            undo.callback(self._session.close)
            self._body = Body(self._session, self._who)
            self._dials = self._find_dials()
            self._bulb_s = self._check_bulb(bulb_s)
            shooter = Shooter(self._body, self._who, self._clock, silence_s=capture_s)
            self._sequence = ExposureSequence(
                self._body, shooter, self._dials, self._who, self._clock, delete=delete
            )
            self._info = self._identity(device)
            # From here on closing is `close`'s work.
            self._closing = undo.pop_all()
        self._is_open = True

    # ---- who and what

    @property
    def info(self) -> CameraInfo:
        """Who it is."""
        return self._info

    @property
    def clock(self) -> Clock:
        """The clock of its timestamps."""
        return self._clock

    @cached_property
    def controls(self) -> ExposureControls:
        """What it can set, and what its files are.

        The latter comes from the camera's profile, from the newest picture on its card, or from one
        exposure taken for that; it is looked up when first asked for.

        Raises:
            CameraError: none of the three worked
        """
        self._check_open()
        record = self._known.record
        notes: list[str] = []
        response = None
        if self._known.format != "raw":
            response = standard_response(
                self._response, record.bits, levels=record.white - record.black
            )
            notes.append(f"the response {self._response} is assumed until it is measured")
        gain = self._dials.gain
        return ExposureControls(
            time_s=self._times(),
            shape=(record.rows, record.columns),
            layout=record.layout,
            bits=record.bits,
            gain=gain.control if gain is not None else Choices((1.0,)),
            f_number=self._dials.f_number.control if self._dials.f_number is not None else None,
            black=record.black,
            white=record.white,
            response=response,
            notes=(*notes, *self._notes),
        )

    def _identity(self, device: Any) -> CameraInfo:
        found = usb_identity(device, "ptp")
        info = self._session.info
        return CameraInfo(
            found.id,
            info.make or found.make,
            info.model or found.model,
            found.serial or info.serial,
            "ptp",
        )

    def _find_dials(self) -> Dials:
        dialect, properties = self._body.dialect, self._body.properties
        self._body.check_card()
        dial = properties.dial("time_s", dialect.times)
        if dial is None:
            properties.check_mode(dialect.times[0].code)
            raise CameraError(
                f"{self._who} has no shutter time that can be set over USB",
                hint="turn the mode dial to M; else its model is not supported",
            )
        properties.check_mode(dial.code)
        dial = properties.dial("time_s", dialect.times) or dial
        if dialect is not STANDARD:
            self._notes.append(
                f"the operations of {dialect.name} are unproven on real bodies: check the first "
                "frames"
            )
        self._notes.append(
            "shutter times are what the camera calls them; a dial's 1/60 may be 1/64 s: compare "
            "the ratios that the report has measured"
        )
        gain = properties.dial("gain", dialect.gains)
        if gain is None and properties.has_any(dialect.gains):
            raise CameraError(
                f"{self._who} chooses its sensitivity itself", hint="set its ISO to a number"
            )
        return Dials(dial, gain, properties.dial("f_number", dialect.f_numbers))

    def _check_bulb(self, bulb_s: float | None) -> float:
        if bulb_s is None:
            return 0.0
        if not self._body.has_bulb(self._dials.time_s):
            raise UsageError(
                f"{self._who} has no bulb exposure that a computer can hold", hint="leave bulb out"
            )
        self._notes.append("bulb times are held by this computer, to about 0.1 s")
        return bulb_s

    def _times(self) -> Control:
        control = self._dials.time_s.control
        first = math.floor(control.maximum) + 1
        bulbs = tuple(float(t) for t in range(first, math.floor(self._bulb_s) + 1))
        if not bulbs:
            return control
        assert not isinstance(control, Steps)  # bulb is a choice of a list
        return Choices((*control.values, *bulbs))

    # ---- what its files are

    @cached_property
    def _known(self) -> KnownFormat:
        """Its format, from the profile, the newest picture on the card, or a try."""
        on_card = newest(self._body, self._wanted)
        known = from_profile(self._info, self._wanted or (on_card[2] if on_card else None))
        if known is not None:
            return known
        if on_card is None:
            on_card = self._try_one()
        handle, info, name = on_card
        still = read_still(self._session.object(handle, info.size), info.name)
        known = KnownFormat(name, still.record)
        problem = remember(self._info, known)
        self._notes.extend((*still.notes, *((problem,) if problem else ())))
        return known

    def _try_one(self) -> tuple[int, ObjectInfo, str]:
        """Take one picture to see what the files are."""
        self._notes.append("one picture was taken to see what its files are")
        control = self._dials.time_s.control
        gain = self._dials.gain
        setting = ExposureSetting(
            control.nearest(_TRY_S), gain.control.nearest(1.0) if gain is not None else 1.0
        )
        shot = self._sequence.take(setting, self._wanted)
        if self._wanted is None and (best := newest(self._body, None)) is not None:
            return best  # of raw and JPEG the raw file may come last
        name = format_of(shot.info)
        assert name is not None  # the shooter passes over what is no picture
        return shot.handle, shot.info, name

    # ---- shooting

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Take the settings in their order; see `camctl.camera.Camera.shoot`."""
        wanted = tuple(settings)
        self._check_ready()
        for setting in wanted:
            self.controls.check(setting)
        return self._shoot(wanted)

    def _shoot(self, settings: tuple[ExposureSetting, ...]) -> Generator[Frame, None, None]:
        self._check_ready()
        self._is_shooting = True
        try:
            yield from self._sequence.run(settings, self._known)
        finally:
            self._is_shooting = False

    def _check_ready(self) -> None:
        self._check_open()
        if self._is_shooting:
            raise CameraBusyError(
                f"{self._who} is still shooting", hint="finish or close that shot first"
            )

    def _check_open(self) -> None:
        if not self._is_open:
            raise CameraDisconnectedError(f"{self._who} is closed", hint="open it again")

    def close(self) -> None:
        """Let go of the device; a second call does nothing."""
        if not self._is_open:
            return
        self._is_open = False
        with self._closing, suppress(CameraError):
            self._sequence.settle(_CLOSING_S)
