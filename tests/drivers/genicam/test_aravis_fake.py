"""Aravis's own fake camera: a foreign device for this driver, behind both libraries.

It has no chunks and no sequencer; in free run it applies a setting to the frame that is being
exposed, and its light is logarithmic.
"""

from __future__ import annotations

import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing

import pytest
from filelock import FileLock
from gige_bench import installed

from camctl.calibration.delay import measure_delay
from camctl.drivers.genicam import GenicamCamera, GenicamOptions
from camctl.drivers.genicam.backend import GenicamBackend
from camctl.drivers.genicam.libraries import find_device
from camctl.errors import CameraError
from camctl.interface.controls import ExposureSetting

PROGRAM = "arv-fake-gv-camera-0.8"
SERIAL = "CAMCTLTEST"
IP = "127.0.0.1"  # it takes the address of a network interface

pytestmark = pytest.mark.skipif(
    shutil.which(PROGRAM) is None, reason=f"needs {PROGRAM}: apt-get install aravis-tools"
)


@pytest.fixture(scope="module", autouse=True)
def _fake(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Run it; it has one address, so that other workers of pytest wait."""
    with FileLock(tmp_path_factory.getbasetemp().parent / "aravis-fake.lock"):
        command = [PROGRAM, "-i", IP, "-s", SERIAL]
        quiet = subprocess.DEVNULL
        with subprocess.Popen(command, stdout=quiet, stderr=quiet) as process:
            time.sleep(0.3)
            assert process.poll() is None
            yield
            process.kill()


def mean_light(camera: GenicamCamera, times_s: list[float]) -> list[float]:
    wanted = [ExposureSetting(camera.controls.time_s.nearest(each)) for each in times_s]
    with closing(camera.shoot(wanted)) as frames:
        found = list(frames)
    assert [frame.applied for frame in found] == wanted
    return [float(frame.pixels.mean()) for frame in found]


@pytest.mark.parametrize("library", ["aravis", "viva"])
@pytest.mark.parametrize(
    ("trigger", "delay"),
    [
        pytest.param("software", 0, marks=pytest.mark.slow),
        pytest.param("off", -1, marks=pytest.mark.serial),
    ],
)
def test_frames_have_their_exposures(library: str, trigger: str, delay: int) -> None:
    using = installed(library)
    options = GenicamOptions.parse({"trigger": trigger, "fps": "15", "format": "mono8"})
    with GenicamCamera(using, find_device(using, IP), options, silence_s=3.0) as camera:
        assert (camera.info.make, camera.info.model) == ("Aravis", "Fake")
        assert measure_delay(camera, trials=2).frames == delay
        times_s = [0.004, 0.016, 0.008, 0.004, 0.016, 0.008]
        light = mean_light(camera, times_s)
        # The picture moves on with each frame, which its mean shows by 1 %.
        assert light[3:] == pytest.approx(light[:3], rel=0.02)
        assert light[0] < light[2] < light[1]


def test_backend_finds_it_and_opens_it_by_its_serial_number() -> None:
    installed("aravis")
    backend = GenicamBackend()
    assert f"genicam:{SERIAL}" in [each.id for each in backend.discover()]
    with backend.open(SERIAL, {"format": "mono8"}) as camera:
        assert camera.info.serial == SERIAL
        assert any("gain is held" in note for note in camera.controls.notes)
    with pytest.raises(CameraError):
        backend.open("NOT-THERE", {})
