"""Read the facts of real camera bodies from recorded summaries, and write the data files of them.

    python docs/read_body_dumps.py FOLDER

FOLDER holds the text files of libgphoto2's `camlibs/ptp2/cameras`.  Written are numbers only: codes
of operations and properties, types, choices, values and the access to the card.
"""

from __future__ import annotations

import json
import math
import re
import sys
from pathlib import Path
from typing import Any

MAKERS = {
    "nikon": ("nikon",),
    "canon": ("canon",),
    "sony": ("sony",),
    "fuji": ("fuji",),
    "olympus": ("olympus", "om-system"),
    "panasonic": ("panasonic",),
    "pentax": ("pentax", "ricoh"),
}
OUTPUT = Path(__file__).parents[1] / "camctl" / "sim" / "devices" / "bodies"

# The properties that matter for an exposure.
_STANDARD = (0x5001, 0x5007, 0x500D, 0x500E, 0x500F, 0x5013)
_OF_MAKER = {
    "nikon": (0xD054, 0xD100),
    "canon": (0xD101, 0xD102, 0xD103, 0xD105, 0xD11C),
    "sony": (0xD20D, 0xD218, 0xD21E, 0xD226, 0xD229, 0xD25A),
    "fuji": (0xD207, 0xD208, 0xD209),
    "olympus": (0xD002, 0xD007, 0xD00C, 0xD01C, 0xD052),
}
# Bodies of each maker that take no pictures over USB, which are refused.
_OTHERS = 4
_CAPTURES = ("100E", "90C0", "9207", "9116", "9404", "9481")
_TYPES = {"i8": 1, "u8": 2, "i16": 3, "u16": 4, "i32": 5, "u32": 6, "str": 0xFFFF}
_LONG = re.compile(r"\(?0x([0-9a-fA-F]{4})\)?: ?\(read ?(only|write)\) \(type=0x([0-9a-f]+)\)(.*)")
_SHORT = re.compile(r"\(([0-9a-f]{4}) (ro|rw) ([iu]\d+|str) *\):(.*)")
_ACCESS = (("with object", 2), ("read-write", 0), ("read-only", 1), ("read only", 1))
_OPERATIONS = re.compile(r"^(?:\s*|.*\): )Supported operations:", re.M)
_PROPERTIES = re.compile(r"^(?:\s*|.*\): )Device Properties Supported:", re.M)


def _property(line: str) -> tuple[int, dict[str, Any]] | None:
    """Return the code of a described property, and its type, access, value and choices."""
    if found := _LONG.search(line):
        code, access, kind, rest = found.groups()
        data_type, is_writable = int(kind, 16), access == "write"
    elif found := _SHORT.search(line):
        code, access, kind, rest = found.groups()
        data_type, is_writable = _TYPES.get(kind, 0), access == "rw"
    else:
        return None
    fact: dict[str, Any] = {"type": data_type, "writable": is_writable}
    if choices := re.search(r"Enumeration \[([-\d,]*)\]", rest):
        fact["choices"] = [int(number) for number in choices[1].split(",") if number]
    elif limits := re.search(r"Range \[(-?\d+) - (-?\d+), step (-?\d+)\]", rest):
        fact["range"] = [int(number) for number in limits.groups()]
    value = re.search(r"\((-?\d+)\)\s*$", rest) or re.search(r"(-?\d+)\s*$", rest)
    if value is None or data_type not in range(1, 7):
        return None
    fact["value"] = int(value[1])
    return int(code, 16), fact


def _listed(text: str, section: re.Pattern[str]) -> list[int]:
    """Return the codes in the lines below the headings of a section, in their order."""
    found: list[int] = []
    for start in section.finditer(text):
        for line in text[start.end() :].splitlines()[1:]:
            code = re.search(r"(?:^|\s|:)\(?0x([0-9a-f]{4})\b", line)
            if code is None:
                break
            found.append(int(code[1], 16))
    return list(dict.fromkeys(found))


def _first(pattern: str, text: str) -> str:
    found = re.search(pattern, text, re.M | re.I)
    return found[1].strip() if found else ""


def read_dump(path: Path, maker: str) -> dict[str, Any] | None:
    """Return the facts of one body; None if the file has no operations and no shutter time."""
    text = path.read_text(encoding="utf-8", errors="replace")
    requested = {*_STANDARD, *_OF_MAKER.get(maker, ())}
    properties: dict[str, Any] = {}
    order: list[int] = []
    for line in text.splitlines():
        found = _property(line)
        if found is None:
            continue
        code, fact = found
        if code not in order:
            order.append(code)
            if code in requested:
                properties[f"{code:04X}"] = fact
    access = next(
        (
            number
            for line in re.findall(r"Access Capability:.*", text, re.I)
            for word, number in _ACCESS
            if word in line.lower()
        ),
        None,
    )
    operations = sorted(set(_listed(text, _OPERATIONS)))
    listed = [code for code in _listed(text, _PROPERTIES) if code in requested]
    # What a maker's operation adds comes after the last codes of the device information.
    order = order or _listed(text, _PROPERTIES)
    last = max(
        (order.index(code) for code in (0xD303, 0xD406, 0xD407) if code in order), default=-1
    )
    hidden = [f"{code:04X}" for code in order[last + 1 :] if last >= 0 and code in requested]
    capabilities = _first(r"^\s*(.*Image Capture, .*)$", text)
    if maker == "canon":
        properties.update(_canon_dials(text))
    facts = {
        "source": path.name,
        "make": _first(r"^\s*Manufacturer:\s*(.+)$", text),
        "model": _first(r"^\s*Model:\s*(.+)$", text),
        "version": _first(r"^\s*(?:device )?version:\s*(.+)$", text),
        "extension": int(_first(r"Vendor Extension ID:\s*0x([0-9a-f]+)", text) or "0", 16),
        "operations": " ".join(f"{code:04X}" for code in operations),
        "captures": [w for w in capabilities.split(", ") if w and not w.startswith("No ")],
        "listed": " ".join(f"{code:04X}" for code in dict.fromkeys(listed)),
        "hidden": " ".join(hidden if maker == "nikon" else []),
        "access": access,
        "properties": properties,
    }
    return facts if facts["model"] and (operations or _can_set_times(facts)) else None


def _can_set_times(facts: dict[str, Any]) -> bool:
    return any(code in facts["properties"] for code in ("500D", "D100", "D102", "D20D", "D01C"))


def _takes_pictures(facts: dict[str, Any]) -> bool:
    """Return whether the body has an operation that takes a picture in one of the dialects."""
    words = set(facts["operations"].split())
    return _can_set_times(facts) or not words.isdisjoint(_CAPTURES)


def _seconds(label: str) -> float | None:
    parts = label.split("/")
    try:
        return float(parts[0]) / float(parts[1] if len(parts) > 1 else 1)
    except ValueError:
        return None


def _canon_code(stops: float, zero: int) -> int:
    """Return Canon's code of a number of stops from `zero`: eighths, 3 and 5 for thirds."""
    whole = math.floor(stops + 1 / 12)
    parts = {0: 0.0, 3: 1 / 3, 4: 0.5, 5: 2 / 3}
    return zero + 8 * whole + min(parts, key=lambda part: abs(parts[part] - (stops - whole)))


def _canon_dials(text: str) -> dict[str, Any]:
    """Return the properties of Canon's dials, whose choices are recorded as labels."""
    found: dict[str, Any] = {}
    for name, code in (("shutterspeed", "D102"), ("iso", "D103"), ("aperture", "D101")):
        block = re.search(rf"^/main/\w+/{name}\s*\n(.*?)^(?:/main|END)", text, re.M | re.S)
        labels = re.findall(r"^Choice: \d+ (\S+)", block[1], re.M) if block else []
        numbers = []
        for value in filter(None, map(_seconds, labels)):
            if code == "D102":
                numbers.append(_canon_code(-math.log2(value), 0x38))
            elif code == "D103":
                numbers.append(_canon_code(math.log2(value / 100), 0x48))
            else:
                numbers.append(_canon_code(2 * math.log2(value), 0x08))
        if len(numbers) > 1:
            choices = sorted(set(numbers))
            value = choices[len(choices) // 2]
            found[code] = {"type": 4, "writable": True, "choices": choices, "value": value}
    return found


def main(folder: Path) -> None:
    """Write one file for each maker."""
    OUTPUT.mkdir(exist_ok=True)
    for maker, prefixes in MAKERS.items():
        bodies, others = {}, 0
        for path in sorted(path for name in prefixes for path in folder.glob(f"{name}-*")):
            if facts := read_dump(path, maker):
                others += not _takes_pictures(facts)
                if _takes_pictures(facts) or others <= _OTHERS:
                    bodies[path.stem] = facts
        print(maker, len(bodies))
        lines = ",\n".join(f'"{name}": {json.dumps(facts)}' for name, facts in bodies.items())
        (OUTPUT / f"{maker}.json").write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
