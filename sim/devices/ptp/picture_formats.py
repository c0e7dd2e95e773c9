"""Which files a camera makes of an exposure, and the numbers that stand for their formats."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

from sim.devices.ptp.config import COMPRESSIONS, PtpConfig, file_formats
from sim.devices.ptp.properties import PropertyTable
from sim.devices.ptp.protocol import Property
from sim.devices.ptp.store import FORMATS


class PictureFormats:
    """The formats of a camera's files; the makers' cameras override the numbers.

    Attributes:
        config: options of the camera
        properties: by code
    """

    config: PtpConfig
    properties: PropertyTable
    # Of the entries of `PtpConfig.files`, in property 5004.
    compressions: ClassVar[Mapping[str, int]] = COMPRESSIONS
    # Of the objects.
    object_formats: ClassVar[Mapping[str, int]] = FORMATS

    def selected_formats(self) -> tuple[str, ...]:
        """Return the formats of the files that an exposure gives, by the compression setting."""
        if Property.COMPRESSION not in self.properties:
            return file_formats(self.config.files[0])
        value = self.properties.number(Property.COMPRESSION)
        return next(file_formats(c) for c in self.config.files if self.compressions[c] == value)

    def formats_of_object(self, number: int) -> tuple[str, ...]:
        """Return the formats of the camera that have an object format's number."""
        return tuple(form for form in self._all_formats() if self.object_formats[form] == number)

    def listed_formats(self) -> list[int]:
        """Return the object formats in the device info."""
        return sorted(self.object_formats[form] for form in self._all_formats())

    def _all_formats(self) -> set[str]:
        return {form for each in self.config.files for form in file_formats(each)}
