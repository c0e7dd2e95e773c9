"""A Nikon CoolPix 990: its registers, and the options and faults of the virtual one.

Numbers and meanings of registers are from the lists that libgphoto2 and photopc publish for the
Sierra protocol.  The real camera's shutter times and f-numbers are not documented: the times here
are listed for the CoolPix 880, and the f-numbers are from the data sheet at the wide end of the
zoom.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from camctl.sim.devices.common import Controllable, DeviceConfig, as_tuple


class Register(IntEnum):
    """Registers that the virtual camera implements; `STORED` are the others."""

    QUALITY = 1
    SHUTTER = 3
    PICTURE = 4
    APERTURE = 5
    TAKEN = 10
    LEFT = 11
    SIZE = 12
    IMAGE = 14
    BATTERY = 16
    SPEED = 17
    CAMERA_ID = 22
    SERIAL = 25
    VERSION = 26
    MODEL = 27
    MEMORY_LEFT = 28
    LOCKED = 39
    PICTURE_INFO = 47
    MAKE = 48
    CARD = 51
    FILE_NAME = 79
    FOLDERS = 83
    FOLDER = 84


class Action(IntEnum):
    """Actions: the second byte of an action command."""

    DELETE_ALL = 1
    CAPTURE = 2
    END = 4
    DELETE = 7
    SCREEN = 8


# Register 17: speed in bits per second, by number.
SPEEDS = {1: 9600, 2: 19200, 3: 38400, 4: 57600, 5: 115200}
START_SPEED = 19200

# Register 3: shutter times, us; 0 is automatic.
SHUTTER_US = (
    *(1000, 2000, 4000, 8000, 16666, 33333, 66666, 125_000, 250_000, 500_000),
    *(1_000_000, 2_000_000, 3_000_000, 4_000_000, 5_000_000, 6_000_000, 7_000_000, 8_000_000),
)
AUTOMATIC_US = 33333  # the automatic shutter time, whatever the scene

# Register 5: f-numbers by number; 0 is automatic, which is the widest.
APERTURES = {1: 2.5, 2: 4.0, 3: 7.0}

# Register 1: file format and JPEG quality, by number.
QUALITIES = {0x11: ("jpeg", 75), 0x12: ("jpeg", 85), 0x13: ("jpeg", 95), 0x23: ("tiff", 95)}
QUALITY_OF = {"jpeg": 0x13, "tiff": 0x23}

# Registers that store what is written to them and have no effect: initial value by number.
STORED = {
    2: 946_684_800,  # date, seconds since 1970
    6: 1,  # colour mode
    7: 2,  # flash: off
    19: 0,  # brightness and contrast
    20: 0,  # white balance
    23: 30,  # power-off delay with a host, seconds
    24: 30,  # power-off delay without a host
    33: 2,  # focus: normal
    34: 1,  # screen mode
    35: 4,  # screen brightness
    38: 30,  # screen-off delay
    40: 0,  # read by libgphoto2, meaning unpublished
    53: 3,  # language
    69: 0,  # exposure compensation
    70: 5,  # metering
    71: 8,  # zoom
    72: 0,
}
CHARGE, LOW_CHARGE = 90, 3  # register 16, per cent
CARD_PRESENT = 0  # register 51; 1: no card
FOLDER_PATH = ("DCIM", "100NIKON")


class SierraConfig(DeviceConfig):
    """The options of a virtual CoolPix 990.

    Attributes:
        serial: serial number
        line: "pty", a device node, or "memory": a line inside this process
        link: path of a symbolic link to the host's end of a pseudo-terminal
        files: formats that it can write, jpeg or tiff; register 1 selects one
        delay_s: from the end of an exposure until its file is on the card
        times_us: shutter times, us
        speed_limit: highest speed that it accepts, bits per second
        is_paced: bytes take as long as on a real line
        silence_s: after so long without a byte the session ends and the speed is 19,200 again
        folder_pictures: most pictures in a folder; the next one is put into another folder, where
            numbers begin with 1 again, and which the host has not opened; 0: there is no limit
    """

    serial: str = Field(default="CP990001", min_length=1, max_length=32, pattern=r"^[ -~]+$")
    line: str = "pty"
    link: str | None = None
    files: Annotated[tuple[Literal["jpeg", "tiff"], ...], BeforeValidator(as_tuple)] = Field(
        default=("jpeg", "tiff"), min_length=1
    )
    delay_s: float = Field(default=0.0, ge=0, le=60)
    times_us: tuple[Annotated[int, Field(ge=1, le=0x7FFF_FFFF)], ...] = Field(
        default=SHUTTER_US, min_length=1
    )
    speed_limit: int = 115200
    is_paced: bool = False
    silence_s: float = Field(default=5.0, gt=0)
    folder_pictures: int = Field(default=0, ge=0)


@dataclass
class LineFaults:
    """Faults of the serial line and of the protocol.

    Attributes:
        naks: so many packets are answered NAK
        garbage: so many answers are random bytes
        truncations: of so many data packets only half is sent
        is_hanging: nothing is answered
        is_speed_fixed: speed changes are refused
    """

    naks: int = 0
    garbage: int = 0
    truncations: int = 0
    is_hanging: bool = False
    is_speed_fixed: bool = False


class LineFaultCommands(Controllable):
    """Control commands that set `LineFaults`."""

    faults: LineFaults

    def do_nak(self, count: int = 1) -> None:
        """Answer the next `count` packets with NAK."""
        self.faults.naks = count

    def do_garbage(self, count: int = 1) -> None:
        """Send random bytes instead of the next `count` answers."""
        self.faults.garbage = count

    def do_truncate(self, count: int = 1) -> None:
        """Send half of the next `count` data packets."""
        self.faults.truncations = count

    def do_hang(self) -> None:
        """Answer nothing."""
        self.faults.is_hanging = True

    def do_no_speed(self) -> None:
        """Refuse speed changes."""
        self.faults.is_speed_fixed = True
