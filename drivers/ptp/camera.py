"""A still camera on USB that speaks PTP, as a `camctl.Camera`.

While one exposure runs, the file of the one before is fetched if the camera allows it.  Each
setting is read back before the shutter is released.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from typing import Any

from pydantic import Field

from camctl.drivers.common.known_format import FORMATS, KnownFormat, has_size, saved_format
from camctl.drivers.common.still_camera import TEST_PICTURE_S, StillCamera, StillOptions
from camctl.drivers.common.usb import device_name, usb_identity
from camctl.drivers.ptp.body import Body
from camctl.drivers.ptp.dialects import STANDARD
from camctl.drivers.ptp.sequence import Dials, ExposureSequence
from camctl.drivers.ptp.session import Session
from camctl.drivers.ptp.shooting import Shooter
from camctl.drivers.ptp.still_formats import (
    CardPicture,
    format_of,
    is_of_model,
    key_of,
    newest_pictures,
)
from camctl.drivers.ptp.transport import CAPTURE_S, NORMAL_S, Transport
from camctl.drivers.ptp.usb_transport import UsbTransport
from camctl.errors import CameraError, CameraProtocolError, UsageError
from camctl.interface.camera import CameraCondition, CameraInfo, Frame
from camctl.interface.clock import Clock, RealClock
from camctl.interface.controls import Choices, Control, ExposureSetting, Steps
from camctl.stills.decoding import Still, read_still
from camctl.stills.exif import stated_exposure

# Pictures of the card that are fetched to learn the format before a test picture is taken.
_MAX_PICTURES_READ = 2
# How long `close` waits for a cancelled exposure beyond its exposure time.
_CLOSE_S = 5.0


class PtpOptions(StillOptions):
    """Options of a PTP camera, besides `StillOptions`.

    Attributes:
        delete: True to delete files from the card once their frames were taken
        bulb: longest bulb exposure, held by this computer, s; None: the camera's own times only
    """

    delete: bool = False
    bulb: float | None = Field(default=None, ge=1, le=3600, allow_inf_nan=False)


class PtpCamera(StillCamera):
    """A still camera on USB; `open` connects to it.

    `open` raises `CameraNotFoundError` if the device is no still camera or may not be used,
    `CameraBusyError` if another program holds it, `UsageError` if it has no bulb exposure and
    `options` ask for it, and `CameraError` if it chooses the exposure itself.

    Args:
        device: a pyusb `Device` of any backend
        options: see `PtpOptions`
        clock: of timestamps, and for all waiting
        silence_s: how long the camera may send nothing
        capture_s: how long a picture may take beyond its exposure
    """

    def __init__(
        self,
        device: Any,
        options: PtpOptions | None = None,
        *,
        clock: Clock | None = None,
        silence_s: float = NORMAL_S,
        capture_s: float = CAPTURE_S,
    ) -> None:
        self._options = options or PtpOptions()
        super().__init__(
            f"the camera at {self._place(device)}", clock or RealClock(), self._options
        )
        self._device = device
        self._silence_s, self._capture_s = silence_s, capture_s

    @classmethod
    def _place(cls, device: Any) -> str:
        return f"USB {device.bus:03d}:{device.address:03d}"

    def _open(self) -> None:
        self._forget()
        with ExitStack() as undo:
            transport = self._connect()
            undo.callback(transport.close)
            name = self._name
            silence_s = self._silence_s
            session = Session(transport, name, self._clock, silence_s=silence_s, busy_s=silence_s)
            session.open()
            undo.callback(session.close)
            self._body = Body(session, name)
            undo.callback(self._body.close)
            self._dials = self._find_dials()
            self._check_bulb()
            self._sequence = ExposureSequence(
                self._body,
                Shooter(self._body, name, silence_s=self._capture_s),
                self._dials,
                name,
                delete=self._options.delete,
            )
            self._info = self._identity()
            self._closing = undo.pop_all()

    def _connect(self) -> Transport:
        """Return the connection to the camera, whose name is then known."""
        self._name = device_name(self._device)
        return UsbTransport(self._device, self._name, self._clock)

    def condition(self) -> CameraCondition:
        """Return what it states of battery, cards, lens and mode dial."""
        self._check_ready()
        return self._body.condition()

    def _close(self) -> None:
        with self._closing, suppress(CameraError):
            self._sequence.finish_pending(_CLOSE_S)

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        known = self._known_format()
        with self._following_format(known):
            yield from self._sequence.run(settings, known, self._times_taken)
            self._save_times(overlaps=self._sequence.overlaps)

    def _identity(self) -> CameraInfo:
        descriptors = usb_identity(self._device)
        info = self._body.session.info
        return CameraInfo(
            descriptors.id,
            info.make or descriptors.make,
            info.model or descriptors.model,
            descriptors.serial or info.serial,
            "ptp",
        )

    # ---- controls

    def _dial_controls(self) -> tuple[Control, Control | None, Control | None]:
        gain, f_number = self._dials.gain, self._dials.f_number
        return (
            self._times(),
            gain.control if gain is not None else None,
            f_number.control if f_number is not None else None,
        )

    def _times(self) -> Control:
        control = self._dials.time_s.control
        first = math.floor(control.maximum) + 1
        last = math.floor(self._options.bulb or 0.0)
        bulbs = tuple(float(time_s) for time_s in range(first, last + 1))
        if not bulbs:
            return control
        assert not isinstance(control, Steps)  # bulb is one of a list of choices
        return Choices((*control.values, *bulbs))

    def _find_dials(self) -> Dials:
        dialect, properties = self._body.dialect, self._body.properties
        note = self._body.check_card()
        self._notes.extend([note] if note else [])
        dial = properties.dial("time_s", dialect.times)
        if dial is None:
            properties.check_mode(dialect.times[0].code)
            raise CameraError(
                f"{self._name} has no shutter time that can be set over USB",
                hint="turn the mode dial to M; if it is at M, its model is not supported",
            )
        self._body.take_control(dial)
        properties.check_mode(dial.code)
        dial = properties.dial("time_s", dialect.times) or dial
        if dialect is not STANDARD:
            self._notes.append(
                f"the operations of {dialect.name} have not been tested on a real body: check the "
                "first frames"
            )
        self._notes.append(
            "shutter times are the labels of the camera's dial, where 1/60 may mean 1/64 s: "
            "compare the ratios measured in the report"
        )
        gain = properties.dial("gain", dialect.gains)
        if gain is None and properties.has_any(dialect.gains):
            raise CameraError(
                f"{self._name} chooses its sensitivity itself", hint="set its ISO to a number"
            )
        return Dials(dial, gain, properties.dial("f_number", dialect.f_numbers))

    def _check_bulb(self) -> None:
        if self._options.bulb is None:
            return
        if not self._body.has_bulb(self._dials.time_s):
            raise UsageError(
                f"{self._name} has no bulb exposure that a computer can hold",
                hint="leave the option bulb out",
            )
        self._notes.append("bulb times are held by this computer, to about 0.1 s")

    # ---- the format of its files

    def _find_format(self) -> KnownFormat:
        """Return the format from the newest picture on the card, the profile, or a test picture.

        The newest picture may be older than the camera's quality setting: one that is not raw
        decides what the camera makes only where such files of it are known.
        """
        size = self._body.image_size()
        for picture in newest_pictures(self._body, self._format_name)[:_MAX_PICTURES_READ]:
            known = saved_format(self.info, picture.format)
            if known is None and self._format_name is None and picture.format != FORMATS[0]:
                return self._format_of_test()
            if known is None or not has_size(known, size):
                known = self._format_in(picture)
            if known is not None and has_size(known, size):
                return known
        known = saved_format(self.info, self._format_name)
        if known is not None and has_size(known, size):
            return known
        return self._format_of_test()

    def _format_of_test(self) -> KnownFormat:
        picture = self._take_test_picture()
        return self._learnt(picture.format, self._read(picture))

    def _format_in(self, picture: CardPicture) -> KnownFormat | None:
        """Return the format of a picture on the card.

        None if it is damaged, incomplete, or of another model: the card may have been elsewhere.
        """
        try:
            still = self._read(picture, of_model=self.info.model)
        except CameraProtocolError:
            return None
        return self._learnt(picture.format, still)

    def _read(self, picture: CardPicture, of_model: str = "") -> Still:
        data = self._body.session.object(picture.handle, picture.info.size)
        if not is_of_model(stated_exposure(data).model, of_model):
            raise CameraProtocolError(
                f"{picture.info.name} is not a picture of {self._name}", hint="use another card"
            )
        return read_still(data, picture.info.name)

    def _take_test_picture(self) -> CardPicture:
        self._notes.append("one picture was taken to learn the format of the files")
        time_s = self._dials.time_s.control.nearest(TEST_PICTURE_S)
        gain = self._dials.gain
        setting = ExposureSetting(time_s, gain.control.nearest(1.0) if gain is not None else 1.0)
        shot = self._sequence.take(setting, self._format_name)
        if self._format_name is None:  # of raw and JPEG, the raw file may be saved last
            for best in newest_pictures(self._body, None):
                if key_of(best.info) == key_of(shot.info):
                    return best
        name = format_of(shot.info)
        assert name is not None  # the shooter ignores other objects
        return CardPicture(shot.handle, shot.info, name)
