"""The raw formats of libcamera: samples of a colour filter or a monochrome sensor."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from camctl.drivers.common.packed_samples import mipi
from camctl.interface.camera import Pixels
from camctl.interface.controls import Layout

#: Samples of a group of packed bytes, by the bits of a sample (MIPI CSI-2).
_GROUP = {10: 4, 12: 2, 14: 4}


@dataclass(frozen=True)
class RawFormat:
    """A raw format by its name, such as SRGGB10_CSI2P.

    Attributes:
        name: as libcamera spells it
        layout: of the samples
        bits: of a sample as it is stored
        is_packed: whether samples share bytes; False: each takes whole ones, low bits used
    """

    name: str
    layout: Layout
    bits: int
    is_packed: bool

    @classmethod
    def parse(cls, name: str) -> RawFormat | None:
        """Return the format of a name; None: it is compressed or no raw format."""
        found = re.fullmatch(r"(?:S(RGGB|GRBG|GBRG|BGGR)|R)(8|10|12|14|16)(_CSI2P)?", name)
        if found is None:
            return None
        layout = Layout(found[1].lower()) if found[1] else Layout.MONO
        bits = int(found[2])
        return cls(name, layout, bits, found[3] is not None and bits in _GROUP)

    def samples(self, data: NDArray[np.uint8], shape: tuple[int, int], shift: int) -> Pixels:
        """Return the samples of a frame, a copy.

        Args:
            data: its bytes, (rows, bytes of a line), which may be padded
            shape: (rows, columns)
            shift: bits below the samples that are not used
        """
        columns = shape[1]
        if self.is_packed:
            count = _GROUP[self.bits]
            used = -(-columns // count) * count * self.bits // 8
            return mipi(self.bits, count, np.ascontiguousarray(data[:, :used]), shape)
        if self.bits == 8:
            return data[:, :columns].copy()
        words = np.ascontiguousarray(data[:, : 2 * columns]).view("<u2")
        pixels: Pixels = (words >> shift).astype(np.uint16)
        return pixels
