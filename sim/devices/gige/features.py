"""The features of a virtual GigE Vision camera, and their GenICam description.

Names are from the "GenICam Standard Features Naming Convention" (SFNC) 2.7, pixel formats from the
"GenICam Pixel Format Naming Convention" (PFNC) 2.4.  One table gives both the registers and the XML
file that describes them.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from types import MappingProxyType
from xml.sax.saxutils import quoteattr

from camctl.interface.controls import Layout

BASE = 0x10000  # address of the first feature's register; each has SLOT bytes
SLOT = 8
XML_ADDRESS = 0x100000

#: Identifiers of the chunks; the first is the picture itself, which is a chunk, too.
IMAGE_CHUNK = 0x1000
CHUNKS: Mapping[str, int] = {
    "ExposureTime": 0x1001,
    "Gain": 0x1002,
    "Timestamp": 0x1003,
    "FrameID": 0x1004,
    "SequencerSetActive": 0x1005,
}


class Kind(StrEnum):
    """What a feature holds."""

    FLOAT = "Float"
    INTEGER = "Integer"
    ENUMERATION = "Enumeration"
    BOOLEAN = "Boolean"
    COMMAND = "Command"


@dataclass(frozen=True)
class Feature:
    """A feature: a register of `SLOT` bytes, big-endian; a float has 8 bytes, the others 4.

    Attributes:
        name, kind: of the feature
        category: under which it is listed
        minimum, maximum: of a number
        entries: of an enumeration
        unit: of a number
        selector: feature that selects which value it shows
        is_read_only: it cannot be written
    """

    name: str
    kind: Kind
    category: str
    minimum: float = 0
    maximum: float = 2**31 - 1
    entries: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))
    unit: str = ""
    selector: str = ""
    is_read_only: bool = False

    def pack(self, value: float) -> bytes:
        """Return its register."""
        if self.kind is Kind.FLOAT:
            return struct.pack(">d", value)
        return struct.pack(">I", int(value)) + bytes(4)

    def unpack(self, data: bytes) -> float:
        """Return the value in a register that was written."""
        if self.kind is Kind.FLOAT:
            return float(struct.unpack(">d", data[:8])[0])
        return int(struct.unpack(">I", data[:4])[0])

    def allows(self, value: float) -> bool:
        """Return whether the value can be written."""
        if self.kind is Kind.ENUMERATION:
            return value in self.entries.values()
        if self.kind in (Kind.BOOLEAN, Kind.COMMAND):
            return value in (0, 1)
        return self.minimum <= value <= self.maximum


_ORDER = (Layout.GRBG, Layout.RGGB, Layout.GBRG, Layout.BGGR)
_LETTERS = {Layout.GRBG: "GR", Layout.RGGB: "RG", Layout.GBRG: "GB", Layout.BGGR: "BG"}


@dataclass(frozen=True)
class StreamFormat:
    """A pixel format: its number in PFNC, bits of a sample, and packing.

    `packing` is "": bytes or little-endian words; "p": a stream of bits, lowest first; "Packed":
    the upper 8 bits of two samples, with their lower bits in a byte between them.
    """

    code: int
    bits: int
    packing: str = ""


def formats(layout: Layout, bits: int) -> dict[str, StreamFormat]:
    """Return the pixel formats, by name, that a sensor of this layout and bit depth offers."""
    if layout is Layout.RGB:
        return {"RGB8": StreamFormat(0x02180014, 8), "BGR8": StreamFormat(0x02180015, 8)}
    if layout is Layout.MONO:
        every = {
            "Mono8": StreamFormat(0x01080001, 8),
            "Mono10": StreamFormat(0x01100003, 10),
            "Mono10p": StreamFormat(0x010A0046, 10, "p"),
            "Mono10Packed": StreamFormat(0x010C0004, 10, "Packed"),
            "Mono12": StreamFormat(0x01100005, 12),
            "Mono12p": StreamFormat(0x010C0047, 12, "p"),
            "Mono12Packed": StreamFormat(0x010C0006, 12, "Packed"),
            "Mono14": StreamFormat(0x01100025, 14),
            "Mono16": StreamFormat(0x01100007, 16),
        }
    else:
        place, name = _ORDER.index(layout), f"Bayer{_LETTERS[layout]}"
        p10, p12 = (0x56, 0x58, 0x54, 0x52)[place], (0x57, 0x59, 0x55, 0x53)[place]
        every = {
            f"{name}8": StreamFormat(0x01080008 + place, 8),
            f"{name}10": StreamFormat(0x0110000C + place, 10),
            f"{name}10p": StreamFormat(0x010A0000 + p10, 10, "p"),
            f"{name}12": StreamFormat(0x01100010 + place, 12),
            f"{name}12p": StreamFormat(0x010C0000 + p12, 12, "p"),
            f"{name}12Packed": StreamFormat(0x010C002A + place, 12, "Packed"),
            f"{name}16": StreamFormat(0x0110002E + place, 16),
        }
    return {name: each for name, each in every.items() if each.bits in (8, bits)}


def camera_features(
    size: tuple[int, int], pixel_formats: Mapping[str, StreamFormat], *, sets: int
) -> list[Feature]:
    """Return the features of a camera.

    Args:
        size: (rows, columns) of its frames
        pixel_formats: that it offers
        sets: of its sequencer
    """
    rows, columns = size
    on_off = {"Off": 0, "On": 1}
    automatic = {"Off": 0, "Once": 1, "Continuous": 2}
    image, acquisition = "ImageFormatControl", "AcquisitionControl"
    analog, chunk, sequencer = "AnalogControl", "ChunkDataControl", "SequencerControl"
    number, choice, switch = Kind.INTEGER, Kind.ENUMERATION, Kind.BOOLEAN
    codes = {name: each.code for name, each in pixel_formats.items()}
    return [
        Feature("Width", number, image, columns, columns),
        Feature("Height", number, image, rows, rows),
        Feature("PixelFormat", choice, image, entries=codes),
        Feature("PayloadSize", number, "TransportLayerControl", is_read_only=True),
        Feature("TLParamsLocked", number, "TransportLayerControl", 0, 1),
        Feature("GevTimestampTickFrequency", number, "TransportLayerControl", is_read_only=True),
        Feature("AcquisitionMode", choice, acquisition, entries={"Continuous": 0}),
        Feature("AcquisitionStart", Kind.COMMAND, acquisition),
        Feature("AcquisitionStop", Kind.COMMAND, acquisition),
        Feature("AcquisitionFrameRateEnable", switch, acquisition),
        Feature("AcquisitionFrameRate", Kind.FLOAT, acquisition, 1, 1000, unit="Hz"),
        Feature("TriggerSelector", choice, acquisition, entries={"FrameStart": 0}),
        Feature("TriggerMode", choice, acquisition, entries=on_off, selector="TriggerSelector"),
        Feature("TriggerSource", choice, acquisition, entries={"Software": 0, "Line1": 1}),
        Feature("TriggerSoftware", Kind.COMMAND, acquisition),
        Feature("ExposureMode", choice, acquisition, entries={"Timed": 0, "TriggerWidth": 1}),
        Feature("ExposureAuto", choice, acquisition, entries=automatic),
        Feature("ExposureTime", Kind.FLOAT, acquisition, 10, 10e6, unit="us"),
        Feature("GainSelector", choice, analog, entries={"All": 0}),
        Feature("GainAuto", choice, analog, entries=automatic),
        Feature("Gain", Kind.FLOAT, analog, 0, 24, unit="dB", selector="GainSelector"),
        Feature("BlackLevel", Kind.FLOAT, analog, 0, 1023, unit="DN"),
        Feature("GammaEnable", switch, analog),
        Feature("ChunkModeActive", switch, chunk),
        Feature("ChunkSelector", choice, chunk, entries=_numbered(CHUNKS)),
        Feature("ChunkEnable", switch, chunk, selector="ChunkSelector"),
        Feature("SequencerMode", choice, sequencer, entries=on_off),
        Feature("SequencerConfigurationMode", choice, sequencer, entries=on_off),
        Feature("SequencerSetSelector", number, sequencer, 0, sets - 1),
        Feature("SequencerSetSave", Kind.COMMAND, sequencer, selector="SequencerSetSelector"),
        Feature("SequencerSetLoad", Kind.COMMAND, sequencer, selector="SequencerSetSelector"),
        Feature("SequencerSetActive", number, sequencer, is_read_only=True),
        Feature("SequencerSetStart", number, sequencer, 0, sets - 1),
        Feature("SequencerPathSelector", number, sequencer, 0, 0),
        Feature(
            "SequencerSetNext", number, sequencer, 0, sets - 1, selector="SequencerPathSelector"
        ),
        Feature("SequencerTriggerSource", choice, sequencer, entries={"Off": 0, "ExposureEnd": 1}),
    ]


def _numbered(names: Iterable[str]) -> dict[str, int]:
    return {name: number for number, name in enumerate(names)}


def describe(features: Sequence[Feature], make: str, model: str) -> bytes:
    """Return the XML file that describes the features; their registers follow each other."""
    categories: dict[str, list[str]] = {"DeviceControl": [name for name, *_ in _STRINGS]}
    nodes = [_string(*each) for each in _STRINGS]
    for index, feature in enumerate(features):
        categories.setdefault(feature.category, []).append(feature.name)
        nodes.append(_node(feature, features, BASE + SLOT * index))
    if "ChunkDataControl" in categories:
        for name, number in CHUNKS.items():
            categories["ChunkDataControl"].append(f"Chunk{name}")
            nodes.append(_chunk(name, number))
    root = "".join(f"<pFeature>{name}</pFeature>" for name in categories)
    listed = "".join(
        f'<Category Name="{name}" NameSpace="Standard">'
        + "".join(f"<pFeature>{each}</pFeature>" for each in members)
        + "</Category>\n"
        for name, members in categories.items()
    )
    text = (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        f"<RegisterDescription ModelName={quoteattr(model)} VendorName={quoteattr(make)} "
        'StandardNameSpace="GEV" SchemaMajorVersion="1" SchemaMinorVersion="1" '
        'SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0" '
        'ToolTip="" ProductGuid="0" VersionGuid="0" '
        'xmlns="http://www.genicam.org/GenApi/Version_1_1">\n'
        f'<Category Name="Root" NameSpace="Standard">{root}</Category>\n{listed}'
        + "\n".join(nodes)
        + '\n<Port Name="Device" NameSpace="Standard"/>\n</RegisterDescription>\n'
    )
    return text.encode()


#: Name, address and bytes of what the bootstrap registers hold as text (GigE Vision 2.0, 27.1).
_STRINGS = (
    ("DeviceVendorName", 0x48, 32),
    ("DeviceModelName", 0x68, 32),
    ("DeviceVersion", 0x88, 32),
    ("DeviceSerialNumber", 0xD8, 16),
)


def _string(name: str, address: int, length: int) -> str:
    return (
        f'<StringReg Name="{name}" NameSpace="Standard"><Address>0x{address:X}</Address>'
        f"<Length>{length}</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>"
    )


def _node(feature: Feature, features: Sequence[Feature], address: int) -> str:
    """Return the nodes of a feature and of its register."""
    name, kind = feature.name, feature.kind
    selected = "".join(
        f"<pSelected>{each.name}</pSelected>" for each in features if each.selector == name
    )
    value = f"<pValue>{name}Reg</pValue>"
    if kind is Kind.COMMAND:
        body = f"{value}<CommandValue>1</CommandValue>"
    elif kind is Kind.ENUMERATION:
        entries = "".join(
            f'<EnumEntry Name="{each}" NameSpace="Standard"><Value>{number}</Value></EnumEntry>'
            for each, number in feature.entries.items()
        )
        body = entries + value + selected
    elif kind is Kind.BOOLEAN:
        body = f"{value}<OnValue>1</OnValue><OffValue>0</OffValue>{selected}"
    elif feature.is_read_only:
        body = value
    else:
        limits = f"<Min>{feature.minimum:g}</Min><Max>{feature.maximum:.10g}</Max>"
        unit = f"<Unit>{feature.unit}</Unit>" if feature.unit else ""
        body = f"{value}{limits}{unit}{selected}"
    access = "RO" if feature.is_read_only else "WO" if kind is Kind.COMMAND else "RW"
    is_float = kind is Kind.FLOAT
    register, length = ("FloatReg", 8) if is_float else ("IntReg", 4)
    sign = "" if is_float else "<Sign>Unsigned</Sign>"
    return (
        f'<{kind} Name="{name}" NameSpace="Standard">{body}</{kind}>'
        f'<{register} Name="{name}Reg"><Address>0x{address:X}</Address><Length>{length}</Length>'
        f"<AccessMode>{access}</AccessMode><pPort>Device</pPort><Cachable>NoCache</Cachable>{sign}"
        f"<Endianess>BigEndian</Endianess></{register}>"
    )


def _chunk(name: str, number: int) -> str:
    is_float = name in ("ExposureTime", "Gain")
    register = "FloatReg" if is_float else "IntReg"
    sign = "" if is_float else "<Sign>Unsigned</Sign>"
    return (
        f'<{register} Name="Chunk{name}" NameSpace="Standard"><Address>0x0</Address>'
        f"<Length>8</Length><AccessMode>RO</AccessMode><pPort>Chunk{name}Port</pPort>"
        f"<Cachable>NoCache</Cachable>{sign}<Endianess>BigEndian</Endianess></{register}>"
        f'<Port Name="Chunk{name}Port"><ChunkID>{number:X}</ChunkID></Port>'
    )
