"""picture.jpg: the preview as JPEG, with a gain map from which displays make the whole range.

The file has the gain map's metadata twice: as ISO 21496-1:2025 (annex C) has them, and as XMP for
readers of the Ultra HDR Image Format 1.1, whose container (CIPA DC-007, a second JPEG after the
first one) it is.

The HDR rendition of a pixel is (preview + k) x 2^gain - k, in units of the white of a preview, with
linear light of each channel.  The gain is taken from the preview as the JPEG file has it, so that
errors of its compression do not stay in the HDR rendition.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from camctl.model.response.camera import srgb_to_linear
from camctl.pictures.details import PictureDetails
from camctl.pictures.metadata import exif_block
from camctl.pictures.preview import Renditions
from camctl.system.picture_operations import jpeg

#: The brightest light that is written, in stops above the white of a preview: 10,000 cd/m2, the
#: most that PQ has (SMPTE ST 2084), for a white of 203 cd/m2 (ITU-R BT.2408).
MOST_STOPS = math.log2(10_000 / 203)
#: k: added to both renditions, so that black has a gain; the darkest light that a preview lifts is
#: five times as bright.
_OFFSET = 2.0**-12
#: Qualities of the preview and of the gain map, of 100: compression changes the light of the
#: memorial scene by 3.4 % with 97, 2.1 % with 99, and 1.6 % with 100 (median), in files of 350, 500
#: and 590 kB.
_QUALITY, _GAIN_QUALITY = 92, 100
#: A gain map that has one value everywhere still needs a range, stops.
_LEAST_RANGE = 1e-3

_ISO = b"urn:iso:std:iso:ts:21496:-1\0"
_XMP = b"http://ns.adobe.com/xap/1.0/\0"
_APP1, _APP2 = 0xE1, 0xE2
_DENOMINATOR = 1 << 20
#: Flags of ISO 21496-1, C.2.2: the gain map has the primaries of the base rendition.
_BASE_PRIMARIES = 0x40
#: Type of the first image in CIPA DC-007, 5.2.3.3.1: baseline primary image.
_PRIMARY = 0x030000

_HEAD = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF '
    'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"><rdf:Description rdf:about="" '
    'xmlns:hdrgm="http://ns.adobe.com/hdr-gain-map/1.0/" '
)
_TAIL = "</rdf:RDF></x:xmpmeta>"
_DIRECTORY = (
    'xmlns:Container="http://ns.google.com/photos/1.0/container/" '
    'xmlns:Item="http://ns.google.com/photos/1.0/container/item/" hdrgm:Version="1.0">'
    '<Container:Directory><rdf:Seq><rdf:li rdf:parseType="Resource"><Container:Item '
    'Item:Semantic="Primary" Item:Mime="image/jpeg"/></rdf:li><rdf:li rdf:parseType="Resource">'
    '<Container:Item Item:Semantic="GainMap" Item:Mime="image/jpeg" Item:Length="{length}"/>'
    "</rdf:li></rdf:Seq></Container:Directory></rdf:Description>"
)


@dataclass(frozen=True)
class _Gains:
    """The range of a gain map.

    Attributes:
        least, most: stops of its values 0 and 255
        headroom: stops above the white of a preview from which a display shows the HDR rendition
    """

    least: float
    most: float
    headroom: float


def picture_with_gain_map(
    renditions: Renditions, details: PictureDetails, cv2: ModuleType
) -> bytes:
    """Return the content of picture.jpg.

    Args:
        renditions: the preview, and the light that it shows
        details: for the EXIF data
        cv2: OpenCV
    """
    channels = renditions.light.shape[2]
    # libultrahdr takes no grey base, but a grey gain map.
    codes = np.dstack((renditions.codes,) * (3 // channels))
    base = jpeg(codes, _QUALITY, full_colour=channels > 1)
    shown = _decoded(cv2, base)[..., :channels]
    every: NDArray[Any] = np.arange(256, dtype=np.float32)
    linear = srgb_to_linear(every / np.float32(255)).astype(np.float32).take(shown)
    gains, codes = _gain_map(linear, renditions.light)
    grey = codes[..., 0] if codes.shape[-1] == 1 else codes
    coded = jpeg(grey, _GAIN_QUALITY, full_colour=True)
    gain_map = _with_segments(
        coded, [(_APP1, _XMP + _xmp_of_gains(gains)), (_APP2, _ISO + _iso_metadata(gains))]
    )
    directory = (_HEAD + _DIRECTORY.format(length=len(gain_map)) + _TAIL).encode()
    segments = [
        (_APP1, b"Exif\0\0" + exif_block(details)),
        (_APP1, _XMP + directory),
        (_APP2, _ISO + struct.pack(">HH", 0, 0)),  # the versions alone
    ]
    return _with_index(base, segments, len(gain_map)) + gain_map


def _gain_map(
    shown: NDArray[np.float32], light: NDArray[np.float32]
) -> tuple[_Gains, NDArray[np.uint8]]:
    """Return the range of the gains from what is shown to the light, and their codes."""
    k = np.float32(_OFFSET)
    gains = np.minimum(light, np.float32(2.0**MOST_STOPS))
    gains += k
    gains /= shown + k
    np.log2(gains, out=gains)
    least, most = float(gains.min()), float(gains.max())
    # Metadata have fractions: the codes must be of what they say.
    least = math.floor(least * _DENOMINATOR) / _DENOMINATOR
    most = math.ceil(max(most, least + _LEAST_RANGE) * _DENOMINATOR) / _DENOMINATOR
    gains -= np.float32(least)
    gains *= np.float32(255 / (most - least))
    brightest = min(max(float(light.max()), 1.0), 2.0**MOST_STOPS)
    headroom = max(math.log2(brightest), _LEAST_RANGE)
    return _Gains(least, most, headroom), np.rint(gains).astype(np.uint8)


def _decoded(cv2: ModuleType, data: bytes) -> NDArray[Any]:
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return np.asarray(cv2.cvtColor(found, cv2.COLOR_BGR2RGB) if found.ndim == 3 else found)


def _with_segments(jpeg: bytes, segments: Sequence[tuple[int, bytes]]) -> bytes:
    """Return a JPEG file with application segments after its first one, of JFIF."""
    at = _end_of_jfif(jpeg)
    return jpeg[:at] + b"".join(map(_segment, segments)) + jpeg[at:]


def _segment(segment: tuple[int, bytes]) -> bytes:
    marker, content = segment
    return struct.pack(">BBH", 0xFF, marker, 2 + len(content)) + content


def _end_of_jfif(jpeg: bytes) -> int:
    return 4 + int(struct.unpack_from(">H", jpeg, 4)[0])


def _with_index(jpeg: bytes, segments: list[tuple[int, bytes]], length: int) -> bytes:
    """Return the first image with its segments, and an index of both (CIPA DC-007, 5.2).

    Places in the index count from its own header.
    """
    entries = 3
    header = struct.pack(">2sHIH", b"MM", 42, 8, entries)
    end = len(header) + 12 * entries + 4

    def index(size: int, place: int) -> bytes:
        tags = (
            struct.pack(">HHI4s", 0xB000, 7, 4, b"0100")
            + struct.pack(">HHII", 0xB001, 4, 1, 2)
            + struct.pack(">HHII", 0xB002, 7, 32, end)
        )
        images = struct.pack(">IIIHH", _PRIMARY, size, 0, 0, 0)
        images += struct.pack(">IIIHH", 0, length, place, 0, 0)
        return b"MPF\0" + header + tags + bytes(4) + images

    before = sum(len(_segment(each)) for each in segments)
    size = len(jpeg) + before + len(_segment((_APP2, index(0, 0))))
    header_at = _end_of_jfif(jpeg) + before + 8  # after marker, length and "MPF"
    return _with_segments(jpeg, [*segments, (_APP2, index(size, size - header_at))])


def _iso_metadata(gains: _Gains) -> bytes:
    """Return the metadata of ISO 21496-1, C.2: one channel's values stand for all."""
    found = struct.pack(">HHB", 0, 0, _BASE_PRIMARIES)
    found += _fraction(0.0, "I") + _fraction(gains.headroom, "I")
    found += _fraction(gains.least, "i") + _fraction(gains.most, "i")
    return found + _fraction(1.0, "I") + 2 * _fraction(_OFFSET, "i")


def _fraction(value: float, kind: str) -> bytes:
    ratio = Fraction(value).limit_denominator(_DENOMINATOR)
    return struct.pack(f">{kind}I", ratio.numerator, ratio.denominator)


def _xmp_of_gains(gains: _Gains) -> bytes:
    values = {
        "Version": "1.0",
        "GainMapMin": gains.least,
        "GainMapMax": gains.most,
        "Gamma": 1.0,
        "OffsetSDR": _OFFSET,
        "OffsetHDR": _OFFSET,
        "HDRCapacityMin": 0.0,
        "HDRCapacityMax": gains.headroom,
        "BaseRenditionIsHDR": False,
    }
    text = " ".join(f'hdrgm:{name}="{value}"' for name, value in values.items())
    return (_HEAD + text + "/>" + _TAIL).encode()
