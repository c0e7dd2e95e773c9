"""The card of a PTP camera: folders, files, handles; ISO 15740, clause 10.4 to 10.13."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

from sim.devices.ptp.codes import Format, Response, Type
from sim.devices.ptp.datasets import Reply, StoredObject, pack_list, pack_storage_info
from sim.devices.still_body import Picture

STORE = 0x0001_0001
ROOT_FOLDER, PICTURE_FOLDER = 0x1000_0001, 0x1000_0002
ALL = 0xFFFF_FFFF
_FREE_IMAGES = 999  # a number for people: it counts nothing
_FIRST_PICTURE = 0x2000_0001
FORMATS = {"jpeg": Format.JPEG, "tiff": Format.TIFF, "dng": Format.DNG}


def stored(picture: Picture, parent: int = PICTURE_FOLDER) -> StoredObject:
    """Return a picture as an object of PTP."""
    return StoredObject(
        picture.name,
        FORMATS[picture.kind],
        picture.data,
        parent,
        picture.rows,
        picture.columns,
        picture.bits,
        picture.thumbnail,
    )


class Card:
    """What is stored, and the operations that ask for it.

    Args:
        capacity: bytes
        fetched: called with the name of a file that was sent to its end

    Attributes:
        objects: by handle; what is on the card
        memory: by handle; what waits in the camera's memory and is in no list
    """

    def __init__(self, capacity: int, fetched: Callable[[str], None]) -> None:
        self.capacity = capacity
        self._fetched = fetched
        self.objects = {
            ROOT_FOLDER: StoredObject("DCIM", Format.FOLDER),
            PICTURE_FOLDER: StoredObject("100VIRTL", Format.FOLDER, parent=ROOT_FOLDER),
        }
        self.memory: dict[int, StoredObject] = {}
        self._next = _FIRST_PICTURE

    @property
    def free_bytes(self) -> int:
        """Room that is left."""
        return max(0, self.capacity - sum(len(item.data) for item in self.objects.values()))

    @property
    def count(self) -> int:
        """How many pictures it has."""
        return sum(item.format != Format.FOLDER for item in self.objects.values())

    def add(self, picture: Picture) -> int:
        """Store a picture and return its handle."""
        handle = self._next
        self._next += 1
        self.objects[handle] = stored(picture)
        return handle

    def find(self, handle: int) -> StoredObject | None:
        """Return what has this handle, be it on the card or in memory."""
        return self.objects.get(handle) or self.memory.get(handle)

    def packed(self) -> bytes:
        """Return the storage info dataset."""
        return pack_storage_info(self.capacity, self.free_bytes, _FREE_IMAGES)

    def get_storage_ids(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetStorageIDs: one."""
        return Reply(data=pack_list([STORE], Type.UINT32))

    def get_storage_info(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetStorageInfo (storage)."""
        if tuple(parameters[:1]) != (STORE,):
            return Reply(Response.INVALID_STORAGE)
        return Reply(data=self.packed())

    def get_number(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetNumObjects (storage, format, folder): in the response's parameter."""
        listed = self._listed(parameters)
        return Reply(listed) if isinstance(listed, Response) else Reply(parameters=(len(listed),))

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
        """GetPartialObject (handle, first byte, most bytes); says how many it sends."""
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

    def get_thumb(self, parameters: Sequence[int], data: bytes) -> Reply:
        """GetThumb (handle)."""
        item = self.find(parameters[0]) if parameters else None
        if item is None:
            return Reply(Response.INVALID_HANDLE)
        return Reply(data=item.thumbnail) if item.thumbnail else Reply(Response.NO_THUMBNAIL)

    def delete(self, parameters: Sequence[int], data: bytes) -> Reply:
        """DeleteObject (handle, format); handle FFFFFFFF: all pictures."""
        if not parameters:
            return Reply(Response.INVALID_HANDLE)
        handle = parameters[0]
        if handle == ALL:
            for each in [h for h, item in self.objects.items() if item.format != Format.FOLDER]:
                del self.objects[each]
            return Reply()
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
