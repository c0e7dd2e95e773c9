"""Codes of ISO 15740 (PTP) and of makers' extensions, and the error for each response code.

Standard codes: ISO 15740:2013, sections 10 to 13.  Makers do not publish their codes; these
were found by libgphoto2 and others.
"""

from __future__ import annotations

from enum import IntEnum

from camctl.errors import (
    CameraBusyError,
    CameraDisconnectedError,
    CameraError,
    CameraProtocolError,
    CameraTimeoutError,
)


class Op(IntEnum):
    """Operations."""

    GET_DEVICE_INFO = 0x1001
    OPEN_SESSION = 0x1002
    CLOSE_SESSION = 0x1003
    GET_STORAGE_IDS = 0x1004
    GET_STORAGE_INFO = 0x1005
    GET_OBJECT_HANDLES = 0x1007
    GET_OBJECT_INFO = 0x1008
    GET_OBJECT = 0x1009
    DELETE_OBJECT = 0x100B
    INITIATE_CAPTURE = 0x100E
    GET_PROPERTY_DESCRIPTION = 0x1014
    GET_PROPERTY = 0x1015
    SET_PROPERTY = 0x1016
    TERMINATE_OPEN_CAPTURE = 0x1018
    INITIATE_OPEN_CAPTURE = 0x101C

    NIKON_CAPTURE = 0x90C0
    NIKON_CAMERA_MODE = 0x90C2
    NIKON_EVENTS = 0x90C7
    NIKON_READY = 0x90C8
    NIKON_PROPERTY_CODES = 0x90CA
    NIKON_LIVE_VIEW = 0x9201
    NIKON_CAPTURE_TO = 0x9207
    NIKON_TERMINATE_CAPTURE = 0x920C
    NIKON_CODES = 0x9439

    EOS_RELEASE = 0x910F
    EOS_SET_PROPERTY = 0x9110
    EOS_REMOTE_MODE = 0x9114
    EOS_EVENT_MODE = 0x9115
    EOS_EVENTS = 0x9116
    EOS_KEEP_ON = 0x911D
    EOS_BULB_START = 0x9125
    EOS_BULB_END = 0x9126
    EOS_REQUEST_PROPERTY = 0x9127
    EOS_RELEASE_ON = 0x9128
    EOS_RELEASE_OFF = 0x9129

    SONY_CONNECT = 0x9201
    SONY_INFO = 0x9202
    SONY_SET_PROPERTY = 0x9205
    SONY_CONTROL = 0x9207
    SONY_PROPERTIES = 0x9209

    OLYMPUS_CAPTURE = 0x9481

    PANASONIC_OPEN = 0x9102
    PANASONIC_CLOSE = 0x9103
    PANASONIC_DESCRIPTION = 0x9108
    PANASONIC_ACKNOWLEDGE = 0x9401
    PANASONIC_GET = 0x9402
    PANASONIC_SET = 0x9403
    PANASONIC_CAPTURE = 0x9404


class Event(IntEnum):
    """Events; Canon's events are record types in the answer to EOS_EVENTS."""

    OBJECT_ADDED = 0x4002
    STORE_FULL = 0x400A
    CAPTURE_COMPLETE = 0x400D

    NIKON_OBJECT_IN_MEMORY = 0xC101
    EOS_OBJECT_ADDED = 0xC181
    EOS_OBJECT_ADDED_64 = 0xC1A7
    EOS_PROPERTY_CHANGED = 0xC189
    EOS_CHOICES_CHANGED = 0xC18A
    SONY_OBJECT_ADDED = 0xC201
    FUJI_OBJECT_ADDED = 0xC004
    OLYMPUS_OBJECT_ADDED = 0xC002
    OLYMPUS_OBJECT_ADDED_NEW = 0xC102
    PANASONIC_PROGRESS = 0xC101
    PANASONIC_OBJECT_ADDED = 0xC108
    PANASONIC_OBJECT_IN_MEMORY = 0xC109


class Prop(IntEnum):
    """Device properties."""

    BATTERY_LEVEL = 0x5001
    IMAGE_SIZE = 0x5003
    F_NUMBER = 0x5007
    FOCUS_MODE = 0x500A
    EXPOSURE_TIME = 0x500D
    EXPOSURE_PROGRAM = 0x500E
    EXPOSURE_INDEX = 0x500F
    STILL_CAPTURE_MODE = 0x5013

    NIKON_ISO_AUTO = 0xD054
    NIKON_RETRACTABLE_LENS = 0xD09C
    # Of the lens: focal lengths and the largest aperture at both, in hundredths.
    NIKON_SHORTEST_FOCAL = 0xD0E3
    NIKON_LONGEST_FOCAL = 0xD0E4
    NIKON_APERTURE_AT_SHORTEST = 0xD0E5
    NIKON_APERTURE_AT_LONGEST = 0xD0E6
    NIKON_EXPOSURE_TIME = 0xD100

    EOS_APERTURE = 0xD101
    EOS_SHUTTER = 0xD102
    EOS_ISO = 0xD103
    EOS_PROGRAM = 0xD105
    EOS_DESTINATION = 0xD11C
    EOS_OUTPUT = 0xD1B0
    EOS_LENS_NAME = 0xD1D8

    FUJI_PRIORITY = 0xD207
    FUJI_BUTTON = 0xD208
    FUJI_FOCUS_STATE = 0xD209

    OLYMPUS_APERTURE = 0xD002
    OLYMPUS_ISO = 0xD007
    OLYMPUS_PROGRAM = 0xD00C
    OLYMPUS_SHUTTER = 0xD01C
    OLYMPUS_CONTROL_MODE = 0xD052

    # Panasonic's codes have 32 bits: what is set, and its description.
    PANASONIC_ISO = 0x0200_0020
    PANASONIC_SHUTTER = 0x0200_0030
    PANASONIC_APERTURE = 0x0200_0040

    SONY_SHUTTER = 0xD20D
    SONY_FOCUS_STATE = 0xD213
    SONY_OBJECT_IN_MEMORY = 0xD215
    SONY_BATTERY = 0xD218
    SONY_ISO = 0xD21E
    SONY_ISO_SET = 0xD226
    SONY_SHUTTER_SET = 0xD229
    SONY_PRIORITY = 0xD25A
    SONY_BUTTON_FOCUS = 0xD2C1
    SONY_BUTTON_SHUTTER = 0xD2C2


# Responses; the format of a folder; all stores, as a parameter.
OK = 0x2001
SESSION_NOT_OPEN = 0x2003
DEVICE_BUSY = 0x2019
SESSION_ALREADY_OPEN = 0x201E
FOLDER = 0x3001
ALL_STORES = 0xFFFFFFFF

_UNSUPPORTED = "its model is not supported"
M_DIAL = "turn the mode dial to M"
TO_SHOOTING = f"{M_DIAL}, and leave playback, menus and movie mode on the camera"
#: Nikon's response where the lens or its aperture ring forbids what was asked for.
NIKON_LENS = 0xA00A
_LENS = (
    CameraError,
    "its lens is not in working position",
    "extend a retractable lens, turn an aperture ring to its highest number, mount the lens firmly",
)

# Response code: error type, reason, what to do.
_STANDARD: dict[int, tuple[type[CameraError], str, str]] = {
    0x2002: (
        CameraProtocolError,
        "it reports a general error",
        "see the camera's own display: focus, lens, cap, card and battery are the usual causes",
    ),
    0x2003: (CameraDisconnectedError, "its session is closed", "open it again"),
    0x2004: (CameraProtocolError, "transaction numbers do not match", "open it again"),
    0x2005: (CameraProtocolError, "it does not support this operation", _UNSUPPORTED),
    0x2006: (CameraProtocolError, "it does not support a parameter", _UNSUPPORTED),
    0x2007: (CameraProtocolError, "a transfer was incomplete", "try again"),
    0x2008: (CameraProtocolError, "it has no such storage", "put a card in"),
    0x2009: (CameraProtocolError, "it has no such object", "shoot it again"),
    0x200A: (CameraProtocolError, "it does not support this property", _UNSUPPORTED),
    0x200C: (CameraError, "its card is full", "make room on the card or put another one in"),
    0x200E: (CameraError, "its card is write-protected", "unlock the card"),
    0x200F: (CameraError, "it denies access", TO_SHOOTING),
    0x2013: (CameraError, "it has no card", "put a card in and close the lid"),
    0x2019: (CameraBusyError, "it is busy", "wait until its lamp is off, then try again"),
    0x201B: (CameraProtocolError, "the format of the value is wrong", _UNSUPPORTED),
    0x201C: (
        CameraProtocolError,
        "it does not accept this value now",
        f"{M_DIAL}, and check the lens",
    ),
    0x201D: (CameraProtocolError, "a parameter is wrong", _UNSUPPORTED),
    0x201E: (CameraBusyError, "its session is already open", "switch it off and on again"),
    0x201F: (CameraTimeoutError, "it cancelled the transaction", "try again"),
}

_OUT_OF_FOCUS = (
    CameraError,
    "it cannot focus",
    "set the lens to manual focus (MF), and take the lens cap off",
)
_BATTERY = (CameraError, "its battery is low", "charge it or use a mains adapter")

# By maker, since makers use the same code with different meanings.
_MAKERS: dict[str, dict[int, tuple[type[CameraError], str, str]]] = {
    "nikon": {
        0xA001: (CameraError, "it reports a hardware error", "switch it off and on again"),
        0xA002: _OUT_OF_FOCUS,
        0xA003: (CameraError, "it does not change to remote control", TO_SHOOTING),
        0xA004: (CameraError, "it cannot do that in its present mode", TO_SHOOTING),
        0xA005: (CameraError, "the property cannot be set now", M_DIAL),
        0xA008: (CameraError, "its shutter is set to bulb", "set another shutter time"),
        0xA009: (CameraError, "its mirror is up", "set the release mode to single"),
        NIKON_LENS: _LENS,
        0xA200: (CameraBusyError, "a bulb exposure is running", "wait until it has ended"),
        0xA201: (CameraBusyError, "a silent exposure is running", "wait until it has ended"),
        0xA202: (CameraBusyError, "it is recording a movie", "stop that, and leave movie mode"),
    },
    "canon": {
        0xA001: (CameraProtocolError, "it does not support this command", _UNSUPPORTED),
        0xA005: (CameraError, "it refuses that in its present mode", TO_SHOOTING),
        0xA006: (CameraError, "its lens is covered", "take the lens cap off"),
        0xA101: _BATTERY,
        0xA102: (CameraBusyError, "the picture is not ready", "try again"),
        0xA104: (CameraError, "it cannot write the file", "check its card"),
        0xA105: (CameraError, "its card is not ready", "check its card"),
        0xA106: (CameraError, "its card is not ready", "check its card"),
    },
    "sony": {
        0xA101: (
            CameraError,
            "it does not accept control by a computer",
            "set USB connection to 'PC Remote' in its menu",
        ),
        0xA105: (CameraError, "its memory is full", "wait until its lamp is off, then try again"),
        0xA106: (
            CameraError,
            "it cannot do that in its present state",
            f"{TO_SHOOTING}; see its display: lens, cap, card and battery are other causes",
        ),
    },
}


def response_error(code: int, task: str, name: str, maker: str = "") -> CameraError:
    """Return the error for a response code.

    Args:
        code: the response of the camera
        task: what the camera was to do, such as "take a picture"
        name: of the camera
        maker: whose vendor codes it uses: nikon, canon or sony; "": none
    """
    meaning = _MAKERS.get(maker, {}).get(code) or _STANDARD.get(code)
    if meaning is None:
        return CameraProtocolError(
            f"{name} did not {task}: response code 0x{code:04X}",
            hint="see the camera's own display",
        )
    kind, reason, hint = meaning
    return kind(f"{name} did not {task}: {reason}", hint=hint)
