"""Takes pictures with libgphoto2's virtual camera until its store is full; prints a JSON object.

    python vusb_client.py FOLDER

FOLDER holds the picture that the camera sends.  A process of its own: vusb ends a process that it
finds in error, and reads its environment once.
"""

from __future__ import annotations

import json
import sys
from contextlib import closing
from pathlib import Path
from typing import Any

from vusb_backend import VusbBackend

from camctl.drivers.ptp.backend import PtpBackend
from camctl.errors import CameraError, RefusedSettingError
from camctl.interface.camera import OriginalFile
from camctl.interface.controls import Choices, ExposureSetting

MOST_SHOTS = 60


def main(store: Path) -> None:
    """Print what happened."""
    port = VusbBackend(store)
    found: dict[str, Any] = {}
    with PtpBackend(port).open("", {"response": "linear"}) as camera:
        controls = camera.controls
        assert isinstance(controls.time_s, Choices)
        assert isinstance(controls.f_number, Choices)
        found |= {"id": camera.info.id, "shape": controls.shape, "times": controls.time_s.values}
        found["f_numbers"] = controls.f_number.values
        settings = [ExposureSetting(t, f_number=4.0) for t in (0.01, 0.0025, 0.1)]
        try:
            camera.shoot([ExposureSetting(0.03, f_number=4.0)])
        except RefusedSettingError as error:
            found["refused"] = str(error)
        found["frames"], found["full"], found["pictures"] = [], "", []
        while not found["full"] and len(found["frames"]) < MOST_SHOTS:
            try:
                with closing(camera.shoot(settings)) as frames:
                    for frame in frames:
                        assert isinstance(frame.original, OriginalFile)
                        found["frames"].append([frame.applied.time_s, frame.details["object"]])
                        found["pictures"].append(frame.original.data == _picture(store))
            except CameraError as error:
                found["full"] = str(error)
    port.close()
    print(json.dumps(found))


def _picture(store: Path) -> bytes:
    (file,) = store.glob("*.JPG")
    return file.read_bytes()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
