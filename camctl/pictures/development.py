"""How a camera developed its pictures: the same colours again, in any exposure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from camctl.interface.colour import CameraColour
from camctl.model.response.camera import linear_to_srgb, srgb_to_linear
from camctl.system.picture_operations import channels_apart

Floats = NDArray[np.float32]

#: Roots of light in tables: a step is less than 1 of 255 in the encoding of sRGB.
_ROOTS = 4096


@dataclass(frozen=True, eq=False)
class Development:
    """What made codes of the light, channel by channel, in the primaries of the camera's files.

    Attributes:
        curves: light of each brightness, black included, of R, G and B
        colour: of the files
    """

    curves: tuple[NDArray[np.float64], ...]
    colour: CameraColour

    def codes(self, colours: Floats, shown: Floats) -> NDArray[np.uint8]:
        """Return the sRGB codes that the camera would give, (rows, columns, 3).

        It is in the exposure in which the largest channel is as bright as it is shown.  Below black
        all is grey.

        Args:
            colours: linear BT.709, the largest channel 1, (rows, columns, 3)
            shown: light of that channel, (rows, columns)
        """
        place = _at(np.sqrt(shown))
        light, less = self._root_of_light.take(place), self._darker.take(place)
        if not self.colour.is_identity:
            colours = np.maximum(colours @ self._to_files, 0)
        channels = zip(self._tables, channels_apart(np.sqrt(colours)), strict=True)
        found = [table.take(_at(root * light)) for table, root in channels]
        codes = np.stack([each - np.minimum(each, less) for each in found], axis=-1)
        if self.colour.is_identity and not self.colour.encoding:
            return np.rint(codes).astype(np.uint8)
        linear = np.clip(self._linear.take(_at(codes / np.float32(255))) @ self._to_bt709, 0, 1)
        return self._srgb.take(_at(np.sqrt(linear)))

    @cached_property
    def _codes(self) -> NDArray[np.float64]:
        """The code of each brightness, 0 to 255."""
        return np.linspace(0, 255, self.curves[0].size)

    @cached_property
    def _shown_codes(self) -> NDArray[np.float64]:
        """The code in the files of each light in the tables."""
        light = np.linspace(0, 1, _ROOTS) ** 2
        if not self.colour.encoding:
            return np.asarray(255 * linear_to_srgb(light))
        encoding = self.colour.encoding
        return np.interp(light, encoding, np.linspace(0, 255, len(encoding)))

    @cached_property
    def _root_of_light(self) -> Floats:
        """Root of the light that has the code of each light in the tables."""
        light = np.interp(self._shown_codes, self._codes, np.mean(self.curves, axis=0))
        return np.asarray(np.sqrt(np.maximum(light, 0)), np.float32)

    @cached_property
    def _tables(self) -> list[Floats]:
        """The code of each light in the tables, of R, G and B."""
        light = np.linspace(0, 1, _ROOTS) ** 2
        return [np.interp(light, each, self._codes).astype(np.float32) for each in self.curves]

    @cached_property
    def _darker(self) -> Floats:
        """What codes are above those that are to be shown, since they begin at black."""
        return np.asarray(np.maximum(self._tables[0][0] - self._shown_codes, 0).astype(np.float32))

    @cached_property
    def _linear(self) -> Floats:
        """Linear light of codes in the files."""
        codes = np.linspace(0, 1, _ROOTS)
        encoding = self.colour.encoding
        light = (
            np.interp(codes, np.linspace(0, 1, len(encoding)), encoding)
            if encoding
            else srgb_to_linear(codes)
        )
        return np.asarray(light, np.float32)

    @cached_property
    def _srgb(self) -> NDArray[np.uint8]:
        """The sRGB code of each light in the tables."""
        light = np.linspace(0, 1, _ROOTS) ** 2
        return np.asarray(np.rint(255 * linear_to_srgb(light)), np.uint8)

    @property
    def _to_bt709(self) -> Floats:
        return np.asarray(np.array(self.colour.matrix).T, np.float32)

    @cached_property
    def _to_files(self) -> Floats:
        return np.asarray(np.linalg.inv(self._to_bt709), np.float32)


def _at(values: Floats) -> NDArray[np.intp]:
    """Return the places of values from 0 to 1 in the tables."""
    return np.asarray(np.minimum(np.rint(values * np.float32(_ROOTS - 1)), _ROOTS - 1), np.intp)
