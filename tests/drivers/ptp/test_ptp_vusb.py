"""Our PTP on a virtual camera that others wrote: libgphoto2's vusb, over a small pyusb backend."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import vusb_backend

from camctl.interface.controls import Layout
from camctl.sim.devices.still_files import RawImage, encode

CLIENT = Path(vusb_backend.__file__).with_name("vusb_client.py")


@pytest.mark.skipif(vusb_backend.missing() is not None, reason=str(vusb_backend.missing()))
def test_libgphoto2s_own_virtual_camera_takes_pictures_until_its_store_is_full(
    tmp_path: Path,
) -> None:
    store = tmp_path / "store"
    store.mkdir()
    grey = np.tile(np.linspace(0, 255, 64, dtype=np.uint8), (48, 1))
    image = RawImage(grey, Layout.MONO, 8, 0, 255, 0.5)
    (store / "GPH_0001.JPG").write_bytes(encode("jpeg", image).replace(b"Exif\0\0", b"None\0\0"))
    environment = {**os.environ, "CAMCTL_PROFILES": str(tmp_path / "profiles")}
    environment["PYTHONPATH"] = os.pathsep.join(path for path in sys.path if path)
    done = subprocess.run(
        [sys.executable, str(CLIENT), str(store)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["shape"] == [48, 64]
    assert found["times"] == [0.0012, 0.0025, 0.005, 0.01, 0.02, 0.05, 0.1, 1.0]
    assert (len(found["f_numbers"]), found["f_numbers"][0]) == (18, 2.8)
    assert "cannot set time_s to 0.03; the nearest it can do is 0.02" in found["refused"]
    assert len(found["frames"]) >= 20
    assert [time_s for time_s, _ in found["frames"][:3]] == [0.01, 0.0025, 0.1]
    assert len({name for _, name in found["frames"]}) == len(found["frames"])
    assert all(found["pictures"])
    assert "is full; make room on it or put another one in" in found["full"]
