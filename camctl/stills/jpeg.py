"""Structure of JPEG files (ITU-T T.81): their size, and where their data are damaged.

libjpeg, which decodes them within OpenCV, fills what is missing with grey and decodes on after
damaged data, whose blocks are then of other colours and shifted.  It only prints the first thing
that it finds wrong.
"""

from __future__ import annotations

import math
import re
import struct
from bisect import bisect_left
from collections.abc import Callable
from dataclasses import dataclass, field

# Table B.1: frame headers are these without DHT, JPG and DAC.  A marker in entropy-coded data is
# FF, not followed by a stuffed zero, a restart marker or a fill byte.
_FRAME_HEADERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_SEQUENTIAL = (0xC0, 0xC1)
_START_OF_SCAN, _END_OF_IMAGE, _RESTART_INTERVAL, _HUFFMAN_TABLES = 0xDA, 0xD9, 0xDD, 0xC4
_QUANTISATION_TABLES = 0xDB
#: What begins with one literal byte is looked for in a tenth of the time.
_MARKER = re.compile(rb"\xff\xff*[\x01-\xcf\xd8-\xfe]")
_RESTART = re.compile(rb"\xff[\xd0-\xd7]")
_END = b"\xff\xd9"
_BLOCK = 8
#: Places of frequencies, row by row, in the order of a file (figure A.6): along diagonals, every
#: other one upwards.
_ORDER = sorted(
    range(_BLOCK * _BLOCK),
    key=lambda at: (sum(divmod(at, _BLOCK)), divmod(at, _BLOCK)[sum(divmod(at, _BLOCK)) % 2 == 0]),
)
CUT_SHORT = "it ends too early"
"""What is wrong with the markers of a file whose end is missing."""

#: What libjpeg prints of damaged data; the rest of its warnings is about headers that it can read.
_DAMAGE = re.compile(r"Corrupt JPEG data: (.+)|(Premature end of JPEG file)")
_EXTRANEOUS = re.compile(r"(\d+) extraneous bytes before marker 0x([0-9a-f]+)")
#: Bytes beside the data of a segment that the encoders of some cameras write.
_SPARE = 4
#: Bytes that a decoder reads ahead, and so many that it does not say them to be extraneous.
_AHEAD = 8
#: With the usual tables so many zeros stand for 170 coefficients of -1, which no picture has.
_ZEROS = bytes(64)
_CODE_LENGTHS, _OF_BLOCK_END = 16, 0


@dataclass
class JpegStructure:
    """What the markers of a file say.

    Attributes:
        rows, columns: size of the picture; 0 before a frame header
        end: offset of the end of the image; None where the file is cut short
        why: what is wrong with the markers; empty: nothing
        is_cmyk: it has four inks
        few_chroma_samples: it has fewer samples of the differences of colours than of brightness
    """

    rows: int = 0
    columns: int = 0
    end: int | None = None
    why: str = ""
    is_cmyk: bool = False
    few_chroma_samples: bool = False
    _tables: dict[int, tuple[int, ...]] = field(default_factory=dict)
    _table_of_brightness: int = 0
    _rows_at: int = 0
    _unit: tuple[int, int] = (_BLOCK, _BLOCK)
    _restart_interval: int = 0
    _scans: list[int] = field(default_factory=list)
    _channels: int = 0
    _is_one_scan: bool = False
    _is_header_filled: bool = False
    _is_zero_flat: bool = True

    @property
    def brightness_steps(self) -> tuple[int, ...]:
        """What the frequencies of brightness are multiples of, row by row; empty: not stated."""
        return self._tables.get(self._table_of_brightness, ())

    @property
    def is_colour(self) -> bool:
        """Whether it has Y, Cb and Cr, or R, G and B."""
        return self._channels == 3

    @classmethod
    def of(cls, data: bytes) -> JpegStructure:
        """Return the structure of a file from its first marker up to the end of the first image."""
        found, at = cls(), 2
        while (match := _MARKER.search(data, at)) is not None:
            if not found._scans and match.start() != at:
                found._is_header_filled = True
            marker, at = data[match.end() - 1], match.end()
            if marker == _END_OF_IMAGE:
                found.end = match.end() - len(_END)
                found.why = "" if found.rows else "it has no frame header"
                return found
            if at + 2 > len(data):
                break
            (length,) = struct.unpack_from(">H", data, at)
            segment = data[at + 2 : at + max(length, 2)]
            try:
                found._add(marker, segment, at + 2)
            except (struct.error, IndexError):
                break
            if found.why:
                return found
            at += max(length, 2)
            if marker == _START_OF_SCAN:
                found._scans.append(at)
        found.why = CUT_SHORT
        return found

    def _add(self, marker: int, segment: bytes, at: int) -> None:
        if marker in _FRAME_HEADERS:
            precision, self.rows, self.columns, channels = struct.unpack_from(">BHHB", segment)
            self.is_cmyk = channels == 4
            if precision != 8 or channels not in (1, 3):
                self.why = f"a JPEG of {channels} x {precision} bits is not supported"
                return
            self._rows_at, self._channels = at + 1, channels
            self._is_one_scan = marker in _SEQUENTIAL
            self._table_of_brightness = segment[8]
            factors = [segment[7 + 3 * channel] for channel in range(channels)]
            if channels > 1:  # else a unit is one block (section A.2.2)
                down, across = ([each >> bits & 15 for each in factors] for bits in (0, 4))
                self._unit = _BLOCK * max(down), _BLOCK * max(across)
                self.few_chroma_samples = min(down) < down[0] or min(across) < across[0]
        elif marker == _RESTART_INTERVAL:
            (self._restart_interval,) = struct.unpack_from(">H", segment)
        elif marker == _HUFFMAN_TABLES:
            self._add_tables(segment)
        elif marker == _QUANTISATION_TABLES and not self._scans:
            self._add_steps(segment)
        elif marker == _START_OF_SCAN:
            self._is_one_scan &= not self._scans and segment[0] == self._channels

    def _add_tables(self, segment: bytes) -> None:
        """Find whether all blocks without contrast are coded as zeros (section B.2.4.2)."""
        at = 0
        while at + _CODE_LENGTHS < len(segment):
            is_of_contrast = segment[at] >> 4 == 1
            symbols = at + 1 + _CODE_LENGTHS
            # The first symbol has the code of zeros.
            self._is_zero_flat &= not is_of_contrast or segment[symbols] == _OF_BLOCK_END
            at = symbols + sum(segment[at + 1 : symbols])

    def _add_steps(self, segment: bytes) -> None:
        """Add the tables of a segment (section B.2.4.1)."""
        at = 0
        while at < len(segment):
            kind, number = divmod(segment[at], 16)
            values = struct.unpack_from(f">{len(_ORDER)}{'H' if kind else 'B'}", segment, at + 1)
            of_place = dict(zip(_ORDER, values, strict=True))
            self._tables[number] = tuple(of_place[place] for place in range(len(_ORDER)))
            at += 1 + len(_ORDER) * (1 + kind)

    def zeros(self, data: bytes) -> int | None:
        """Return where zeros stand in place of data, as on a damaged disk; None: nowhere."""
        if not (self._is_one_scan and self._scans) or self._is_zero_flat or self.end is None:
            return None
        at = data.find(_ZEROS, self._scans[0], self.end)
        is_filling = at < 0 or not data[at : self.end].strip(b"\0")
        return None if is_filling else at

    def damage(self, data: bytes, text: str) -> str:
        """Return what a decoder's text says of damaged data; empty: nothing.

        Bytes between the last row and the end of the image are damage only where pixels were
        decoded from the same filling: see `remaining_bytes`.
        """
        extra = _EXTRANEOUS.search(text)
        if extra is not None:
            count, is_end = int(extra[1]), int(extra[2], 16) == _END_OF_IMAGE
            if self._is_header_filled or count <= _SPARE:
                return ""
            if is_end and self._equal_bytes(data) <= count + _AHEAD:
                return ""
        found = _DAMAGE.search(text)
        return "" if found is None else found[1] or found[2]

    def remaining_bytes(self, data: bytes, text: str) -> int:
        """Return how many bytes a decoder leaves between the last row and the end of the image.

        Cameras fill the end with equal bytes, which are not counted, and some write data of their
        own there; else the data are damaged, and these bytes were pixels.
        """
        extra = _EXTRANEOUS.search(text)
        if extra is None or self._is_header_filled or int(extra[2], 16) != _END_OF_IMAGE:
            return 0
        count = int(extra[1])
        return 0 if count <= max(_SPARE, self._equal_bytes(data)) else count

    def _equal_bytes(self, data: bytes) -> int:
        """Return how many equal bytes precede the end of the image."""
        last = data[: self.end][-1:]
        return len(data[: self.end]) - len(data[: self.end].rstrip(last))

    def undamaged_rows(self, data: bytes, printed: Callable[[bytes], str]) -> int | None:
        """Return the rows at the top in whose data a decoder finds nothing wrong; None: unknown.

        Damage above them may go unnoticed, since data after it can be decoded as other pixels.

        Args:
            data: the file
            printed: decodes a file, and returns the text that the decoder prints
        """
        if not (self._is_one_scan and self._scans and self.rows and min(self._unit)):
            return None
        lines = math.ceil(self.rows / self._unit[0])

        def is_damaged(count: int) -> bool:
            text = printed(self._top(data, count))
            extra = _EXTRANEOUS.search(text)
            is_rest = extra is not None and (
                not self._restart_interval or int(extra[2], 16) == _END_OF_IMAGE
            )
            return _DAMAGE.search(text) is not None and not is_rest

        first = bisect_left(range(1, lines + 1), True, key=is_damaged)
        return min(first * self._unit[0], self.rows)

    def _top(self, data: bytes, lines: int) -> bytes:
        """Return a file of the first lines of units, with the data of all, or of these."""
        end = len(data) if self.end is None else self.end
        if self._restart_interval:
            units = lines * math.ceil(self.columns / self._unit[1])
            segments = math.ceil(units / self._restart_interval)
            for count, match in enumerate(_RESTART.finditer(data, self._scans[0], end), 1):
                if count == segments:
                    end = match.start()
                    break
        rows = struct.pack(">H", min(lines * self._unit[0], self.rows))
        return data[: self._rows_at] + rows + data[self._rows_at + 2 : end] + _END
