"""The registers of a Nikon CoolPix 990, as far as a host asks for them over a serial line.

Numbers and meanings are those of the lists that libgphoto2 and photopc publish for the Sierra
protocol.  Which shutter times the real camera takes, and which f-numbers its three apertures are,
is documented nowhere: here the times are those listed for its sister, the CoolPix 880, and the
f-numbers those of its data sheet at the wide end of the zoom.
"""

from __future__ import annotations

from enum import IntEnum


class Register(IntEnum):
    """Registers that mean something to the camera; `KEPT` holds the others."""

    QUALITY = 1
    SHUTTER = 3
    PICTURE = 4
    APERTURE = 5
    TAKEN = 10
    LEFT = 11
    SIZE = 12
    THUMBNAIL_SIZE = 13
    IMAGE = 14
    THUMBNAIL = 15
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
    """Second byte of an action packet."""

    DELETE_ALL = 1
    CAPTURE = 2
    END = 4
    DELETE = 7
    SCREEN = 8


# Register 17: number to speed in bits a second.
SPEEDS = {1: 9600, 2: 19200, 3: 38400, 4: 57600, 5: 115200}
START_SPEED = 19200

# Register 3: shutter times, microseconds; 0 is automatic.
SHUTTER_US = (
    *(1000, 2000, 4000, 8000, 16666, 33333, 66666, 125_000, 250_000, 500_000),
    *(1_000_000, 2_000_000, 3_000_000, 4_000_000, 5_000_000, 6_000_000, 7_000_000, 8_000_000),
)
AUTOMATIC_US = 33333  # what the camera takes by itself, whatever the scene

# Register 5: f-numbers; 0 is automatic, which takes the widest.
APERTURES = {1: 2.5, 2: 4.0, 3: 7.0}

# Register 1: what kind of file, with which JPEG quality.
QUALITIES = {0x11: ("jpeg", 75), 0x12: ("jpeg", 85), 0x13: ("jpeg", 95), 0x23: ("tiff", 95)}
QUALITY_OF = {"jpeg": 0x13, "tiff": 0x23}

# Registers that keep what is written to them and do nothing: number to value at first.
KEPT = {
    2: 946_684_800,  # date, seconds since 1970
    6: 1,  # colour
    7: 2,  # flash: off
    19: 0,  # brightness and contrast
    20: 0,  # white balance
    23: 30,  # switches off by itself, seconds: with a host
    24: 30,  # .. and without
    33: 2,  # focus: normal
    34: 1,  # screen
    35: 4,  # its brightness
    38: 30,  # when it switches off
    40: 0,  # read by libgphoto2; what it says is not published
    53: 3,  # language
    69: 0,  # exposure compensation
    70: 5,  # metering
    71: 8,  # zoom
    72: 0,
}
CHARGE, LOW_CHARGE = 90, 3  # register 16, per cent
CARD_THERE = 0  # register 51; 1: no card
FOLDER_PATH = ("DCIM", "100NIKON")
