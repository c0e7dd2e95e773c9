"""The card of a PTP camera: folders, files and handles (ISO 15740, clauses 10.4 to 10.13)."""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import count

from camctl.sim.devices.ptp.protocol import Format, Reply, Response, Type, pack_list, pack_text
from camctl.sim.devices.still_body import CARD_BYTES, ImageFile

STORE = 0x0001_0001  # its id
ROOT_FOLDER, PICTURE_FOLDER = 0x1000_0001, 0x1000_0002  # handles
ALL = 0xFFFF_FFFF  # stores or handles
READ_ONLY = 1  # access to the card
_FREE_IMAGES = 999  # in the storage info; not computed
_FIRST_PICTURE = 0x2000_0001  # handle
FORMATS: Mapping[str, int] = {"jpeg": Format.JPEG, "tiff": Format.TIFF, "dng": Format.DNG}
_DATE = "20240101T120000"  # of all files


@dataclass(frozen=True, eq=False)
class StoredObject:
    """A file or a folder on the card.

    Attributes:
        name: file name
        format: see `Format`
        data: of a file
        parent: handle of its folder; 0 in the root
        rows, columns, bits: of the picture in it; bits per pixel
    """

    name: str
    format: int
    data: bytes = b""
    parent: int = 0
    rows: int = 0
    columns: int = 0
    bits: int = 0

    def info(self, storage: int) -> bytes:
        return (
            struct.pack("<IHHI", storage, self.format, 0, len(self.data))
            + bytes(14)  # there is no thumbnail
            + struct.pack(
                "<IIIIHII",
                self.columns,
                self.rows,
                self.bits,
                self.parent,
                self.format == Format.FOLDER,
                0,
                0,
            )
            + pack_text(self.name)
            + pack_text(_DATE)
            + pack_text(_DATE)
            + pack_text("")
        )


class Card:
    """The stored objects, and the operations that read and delete them.

    Args:
        formats: number of the object format of each file format
        access: see `camctl.sim.devices.ptp.config.PtpConfig`
        reuses: new pictures take the lowest free number and handle
        fetched: called with the name of a file whose last byte has been sent

    Attributes:
        objects: on the card, by handle
        memory: in the camera's memory, by handle; they are not listed
    """

    def __init__(
        self,
        fetched: Callable[[str], None],
        *,
        formats: Mapping[str, int] = FORMATS,
        access: int = 0,
        reuses: bool = False,
    ) -> None:
        self._access, self._reuses = access, reuses
        self._fetched, self._formats = fetched, formats
        self.objects = {
            ROOT_FOLDER: StoredObject("DCIM", Format.FOLDER),
            PICTURE_FOLDER: StoredObject("100VIRTL", Format.FOLDER, parent=ROOT_FOLDER),
        }
        self.memory: dict[int, StoredObject] = {}
        self._next = _FIRST_PICTURE

    @property
    def free_bytes(self) -> int:
        return max(0, CARD_BYTES - sum(len(item.data) for item in self.objects.values()))

    @property
    def count(self) -> int:
        return sum(item.format != Format.FOLDER for item in self.objects.values())

    def add(self, files: Sequence[ImageFile]) -> list[int]:
        """Store the files of an exposure and return their handles."""
        if self._reuses:
            stems = {item.name.split(".")[0] for item in self.objects.values()}
            stem = next(s for n in count(1) if (s := f"VIRT{n:04d}") not in stems)
            files = [replace(f, name=f"{stem}.{f.name.split('.')[-1]}") for f in files]
            self._next = _FIRST_PICTURE
        handles = []
        for file in files:
            while self._next in self.objects:
                self._next += 1
            handles.append(self._next)
            self.objects[self._next] = self.stored(file)
            self._next += 1
        return handles

    def stored(self, file: ImageFile, parent: int = PICTURE_FOLDER) -> StoredObject:
        """Return an image file as an object in a folder."""
        return StoredObject(
            file.name,
            self._formats[file.format],
            file.data,
            parent,
            file.rows,
            file.columns,
            file.bits,
        )

    def find(self, handle: int) -> StoredObject | None:
        """Return the object with this handle, on the card or in memory."""
        return self.objects.get(handle) or self.memory.get(handle)

    def packed(self) -> bytes:
        """Return the storage info dataset: a removable card with folders."""
        removable_ram, hierarchical = 4, 2
        kinds = struct.pack("<HHH", removable_ram, hierarchical, self._access)
        sizes = struct.pack("<QQI", CARD_BYTES, self.free_bytes, _FREE_IMAGES)
        return kinds + sizes + pack_text("card") + pack_text("VIRT")

    def get_storage_ids(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetStorageIDs: one card."""
        return Reply(data=pack_list([STORE], Type.UINT32))

    def get_storage_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetStorageInfo (storage)."""
        if tuple(parameters[:1]) != (STORE,):
            return Reply(Response.INVALID_STORAGE)
        return Reply(data=self.packed())

    def get_handles(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetObjectHandles (storage, format, folder)."""
        listed = self._listed(parameters)
        if isinstance(listed, Response):
            return Reply(listed)
        return Reply(data=pack_list(listed, Type.UINT32))

    def get_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetObjectInfo (handle)."""
        item = self.find(parameters[0]) if parameters else None
        if item is None:
            return Reply(Response.INVALID_HANDLE)
        return Reply(data=item.info(STORE))

    def get_object(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetObject (handle)."""
        return self.get_part((*parameters[:1], 0, ALL), data, is_whole=True)

    def get_part(self, parameters: Sequence[int], data: bytes, *, is_whole: bool = False) -> Reply:
        """GetPartialObject (handle, first byte, most bytes); the response has the bytes sent."""
        if len(parameters) < 3:
            return Reply(Response.INVALID_PARAMETER if parameters else Response.INVALID_HANDLE)
        handle, first, most = parameters[:3]
        item = self.find(handle)
        if item is None or item.format == Format.FOLDER:
            return Reply(Response.INVALID_HANDLE)
        part = item.data[first : first + most]
        is_end = first + len(part) >= len(item.data)
        sent = partial(self._fetched, item.name) if is_end else None
        return Reply(data=part, parameters=() if is_whole else (len(part),), sent=sent)

    def delete(self, parameters: Sequence[int], data: bytes) -> Reply:
        """DeleteObject (handle, format)."""
        if not parameters:
            return Reply(Response.INVALID_HANDLE)
        handle = parameters[0]
        if self.memory.pop(handle, None) is not None:
            return Reply()
        if handle in (ROOT_FOLDER, PICTURE_FOLDER):
            return Reply(Response.ACCESS_DENIED)
        return Reply() if self.objects.pop(handle, None) else Reply(Response.INVALID_HANDLE)

    def _listed(self, parameters: Sequence[int]) -> list[int] | Response:
        storage, form, folder = (*parameters, 0, 0, 0)[:3]
        if not parameters or storage not in (STORE, ALL):
            return Response.INVALID_STORAGE
        if folder not in (0, ALL) and folder not in self.objects:
            return Response.INVALID_PARENT
        parent = 0 if folder == ALL else folder
        return [
            handle
            for handle, item in self.objects.items()
            if (folder == 0 or item.parent == parent)
            and (form == 0 or item.format == form or (form == ALL and item.format != Format.FOLDER))
        ]
