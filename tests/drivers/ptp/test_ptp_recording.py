"""A real camera, recorded: gphoto2's session with a Canon PowerShot SX200 IS, with our driver.

The recording is part of umockdev's source, which is fetched once from Debian's archive and kept in
the user's cache; it is not part of this repository.
"""

from __future__ import annotations

import hashlib
import io
import json
import shutil
import subprocess
import sys
import tarfile
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from platformdirs import user_cache_dir

VERSION = "0.17.16"
SOURCE = f"http://deb.debian.org/debian/pool/main/u/umockdev/umockdev_{VERSION}.orig.tar.xz"
SHA256 = "4f405b8ce9219f8117d8605ecd815b8941cd829dae11b4a26b1a49ff7ea3ae26"
CAMERAS = f"umockdev-{VERSION}/devices/cameras"
NAME = "canon-powershot-sx200"
NODE = "/dev/bus/usb/001/011"
CLIENT = Path(__file__).parents[2] / "helpers" / "ptp_replay_client.py"


@dataclass(frozen=True)
class Replay:
    """Results of the replayed session, and the files on the recorded card by name."""

    result: dict[str, Any]
    photos: dict[str, bytes]

    def answers(self, code: str) -> list[Any]:
        """Return the results of all operations of a code."""
        return [answer for operation, answer in self.result["operations"] if operation == code]


def archive() -> Path:
    """Return the source of umockdev, from the cache or from the net."""
    kept = Path(user_cache_dir("camctl")) / "tests" / f"umockdev-{VERSION}.tar.xz"
    if not kept.exists() or hashlib.sha256(kept.read_bytes()).hexdigest() != SHA256:
        try:
            with urllib.request.urlopen(SOURCE, timeout=20) as answer:
                data = answer.read(16 << 20)
        except (urllib.error.URLError, OSError) as error:
            pytest.skip(f"the recorded PTP camera could not be fetched: {error}")
        assert hashlib.sha256(data).hexdigest() == SHA256, "the fetched source has changed"
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part")
        part.write_bytes(data)
        part.replace(kept)
    return kept


def extracted(source: tarfile.TarFile, name: str | tarfile.TarInfo) -> bytes:
    member = source.extractfile(name)
    assert member is not None
    return member.read()


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> Replay:
    if shutil.which("umockdev-run") is None:
        pytest.skip("the recorded PTP camera needs umockdev: apt-get install umockdev")
    folder = tmp_path_factory.mktemp("recording")
    with tarfile.open(archive()) as source:
        for name in (f"{NAME}.umockdev", f"{NAME}.ioctl", "test-photos.tar"):
            (folder / name).write_bytes(extracted(source, f"{CAMERAS}/{name}"))
    recording = folder / f"{NAME}.ioctl"
    command = ["umockdev-run", "-d", str(folder / f"{NAME}.umockdev"), "-i", f"{NODE}={recording}"]
    done = subprocess.run(
        [*command, "--", sys.executable, str(CLIENT), str(recording)],
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    with tarfile.open(fileobj=io.BytesIO((folder / "test-photos.tar").read_bytes())) as card:
        photos = {
            Path(member.name).name: extracted(card, member)
            for member in card
            if member.name.endswith(".JPG")
        }
    return Replay(json.loads(done.stdout.splitlines()[-1]), photos)


def test_the_recorded_camera_is_found_on_the_bus(replay: Replay) -> None:
    # Its serial number as sysfs has it: the recording holds no string descriptors.
    assert replay.result["id"] == "ptp:C767F1C714174C309255F70E4A7B2EE2"


def test_the_whole_session_replays_without_a_recovery(replay: Replay) -> None:
    operations = [code for code, _ in replay.result["operations"]]
    # Four runs of gphoto2: list, list, thumbnails, pictures.
    assert operations.count("1002") == operations.count("1003") == 4
    assert len(operations) == 72
    assert replay.result["recovered"] == 0


def test_device_information(replay: Replay) -> None:
    assert set(replay.answers("1001")) == {"Canon Inc., Canon PowerShot SX200 IS, 52 operations"}


def test_the_files_on_the_card_are_listed(replay: Replay) -> None:
    assert ["1900011", "1900021"] in replay.answers("1007")
    assert "IMG_0001.JPG 640x480 68182" in replay.answers("1008")


def test_pictures_are_fetched_byte_for_byte(replay: Replay) -> None:
    fetched = replay.answers("1009")
    expected = [hashlib.sha256(replay.photos[f"IMG_000{i}.JPG"]).hexdigest() for i in (1, 2)]
    assert [digest for _, digest in fetched] == expected
    assert [shape for shape, _ in fetched] == [[480, 640, 3], [480, 640, 3]]
