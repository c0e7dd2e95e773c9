"""The image sensor behind a video node, where its controls are in a node of their own.

On boards whose driver has a media controller (Rockchip, i.MX8 and others), the video node has no
exposure: the sensor is a subdevice of the same media device, and its node has the controls.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from camctl.drivers.v4l2.abi import Entity, PadFormat, Request, text
from camctl.drivers.v4l2.kernel import Kernel
from camctl.errors import CameraError

_NEXT = 1 << 31  # MEDIA_ENT_ID_FLAG_NEXT
_SENSOR = 0x00020001  # MEDIA_ENT_F_CAM_SENSOR
_ACTIVE = 1  # V4L2_SUBDEV_FORMAT_ACTIVE
#: More entities than any board has.
_MOST_ENTITIES = 256


def sensor_of(path: str, kernel: Kernel, root: Path = Path("/")) -> str | None:
    """Return the path of the node of the sensor behind a video node; None where there is none.

    Raises:
        CameraError: there are several, so that it is not known which one is seen
    """
    number = _number(root / "sys/class/video4linux" / Path(os.path.realpath(path)).name / "dev")
    for media in sorted(root.glob("dev/media*")):
        entities = list(_entities(str(media), kernel))
        if number is None or number not in [(each.major, each.minor) for each in entities]:
            continue
        sensors = [each for each in entities if each.type == _SENSOR]
        if len(sensors) > 1:
            names = ", ".join(text(each.name) for each in sensors)
            raise CameraError(
                f"{path} is behind several sensors ({names})",
                hint="unplug the others: which one it shows is not read from the media controller",
            )
        return _node(sensors[0], root) if sensors else None
    return None


def sensor_columns(descriptor: int, kernel: Kernel) -> int | None:
    """Return the columns that an open sensor reads; None where it does not say."""
    found = PadFormat(which=_ACTIVE)
    with suppress(OSError):
        kernel.ioctl(descriptor, Request.SUBDEV_G_FMT, found)
    return found.width or None


def _entities(path: str, kernel: Kernel) -> Iterator[Entity]:
    """Yield the parts of a media device; none where it cannot be asked."""
    try:
        descriptor = kernel.open(path)
    except OSError:
        return
    try:
        found = Entity()
        for _ in range(_MOST_ENTITIES):
            found = Entity(id=found.id | _NEXT)
            kernel.ioctl(descriptor, Request.ENUM_ENTITIES, found)
            yield found
    except OSError:
        return  # EINVAL: there are no more
    finally:
        kernel.close(descriptor)


def _node(entity: Entity, root: Path) -> str | None:
    """Return the path of a part's device node; None where there is none."""
    uevent = root / f"sys/dev/char/{entity.major}:{entity.minor}/uevent"
    with suppress(OSError):
        found = re.search(r"^DEVNAME=([\w.-]+)$", uevent.read_text("utf-8"), re.MULTILINE)
        return f"/dev/{found[1]}" if found else None
    return None


def _number(file: Path) -> tuple[int, int] | None:
    """Return the numbers of a device by its file in sysfs."""
    with suppress(OSError):
        found = re.fullmatch(r"(\d+):(\d+)\s*", file.read_text("utf-8"))
        return (int(found[1]), int(found[2])) if found else None
    return None
