"""A real camera, recorded: gphoto2's session with a Canon PowerShot SX200 IS, through our driver.

The recording is part of umockdev's source, which is fetched once from Debian's archive and kept in
the user's cache; nothing of it is committed.
"""

import hashlib
import io
import json
import shutil
import subprocess
import sys
import tarfile
import urllib.error
import urllib.request
from pathlib import Path

import pytest
from platformdirs import user_cache_dir

VERSION = "0.17.16"
SOURCE = f"http://deb.debian.org/debian/pool/main/u/umockdev/umockdev_{VERSION}.orig.tar.xz"
SHA256 = "4f405b8ce9219f8117d8605ecd815b8941cd829dae11b4a26b1a49ff7ea3ae26"
CAMERAS = f"umockdev-{VERSION}/devices/cameras"
NAME = "canon-powershot-sx200"
NODE = "/dev/bus/usb/001/011"
CLIENT = Path(__file__).parents[2] / "helpers" / "ptp_replay_client.py"


def archive():
    """Return the source of umockdev, from the cache or from the net."""
    kept = Path(user_cache_dir("camctl")) / "tests" / f"umockdev-{VERSION}.tar.xz"
    if not kept.exists() or hashlib.sha256(kept.read_bytes()).hexdigest() != SHA256:
        try:
            with urllib.request.urlopen(SOURCE, timeout=20) as answer:
                data = answer.read(16 << 20)
        except (urllib.error.URLError, OSError) as error:
            pytest.skip(f"the recorded PTP camera could not be fetched: {error}")
        assert hashlib.sha256(data).hexdigest() == SHA256, "not the source that was expected"
        kept.parent.mkdir(parents=True, exist_ok=True)
        part = kept.with_suffix(".part")
        part.write_bytes(data)
        part.replace(kept)
    return kept


@pytest.fixture(scope="module")
def replay(tmp_path_factory):
    """What came of the recorded session, and the two pictures on the recorded card."""
    if shutil.which("umockdev-run") is None:
        pytest.skip("the recorded PTP camera needs umockdev: apt-get install umockdev")
    folder = tmp_path_factory.mktemp("recording")
    with tarfile.open(archive()) as source:
        for name in (f"{NAME}.umockdev", f"{NAME}.ioctl", "test-photos.tar"):
            member = source.extractfile(f"{CAMERAS}/{name}")
            assert member is not None
            (folder / name).write_bytes(member.read())
    recording = folder / f"{NAME}.ioctl"
    command = ["umockdev-run", "-d", str(folder / f"{NAME}.umockdev"), "-i", f"{NODE}={recording}"]
    done = subprocess.run(
        [*command, "--", sys.executable, str(CLIENT), str(recording)],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    photos = {}
    with tarfile.open(fileobj=io.BytesIO((folder / "test-photos.tar").read_bytes())) as card:
        for member in card:
            if member.name.endswith(".JPG"):
                photos[Path(member.name).name] = card.extractfile(member).read()
    return json.loads(done.stdout.splitlines()[-1]), photos


def answers(replay, code):
    return [said for operation, said in replay[0]["operations"] if operation == code]


def test_the_recorded_camera_is_found_on_the_bus(replay):
    # Its serial number as sysfs has it: the recording holds no string descriptors.
    assert replay[0]["id"] == "ptp:C767F1C714174C309255F70E4A7B2EE2"


def test_the_whole_session_replays_without_a_recovery(replay):
    operations = [code for code, _ in replay[0]["operations"]]
    # Four runs of gphoto2: list, list, thumbnails, pictures.
    assert operations.count("1002") == operations.count("1003") == 4
    assert len(operations) == 72
    assert replay[0]["recovered"] == 0


def test_it_says_who_it_is(replay):
    assert set(answers(replay, "1001")) == {"Canon Inc., Canon PowerShot SX200 IS, 52 operations"}


def test_its_card_is_listed(replay):
    assert ["1900011", "1900021"] in answers(replay, "1007")
    assert "IMG_0001.JPG 640x480 68182" in answers(replay, "1008")


def test_its_pictures_come_byte_for_byte(replay):
    fetched = answers(replay, "1009")
    expected = [hashlib.sha256(replay[1][f"IMG_000{i}.JPG"]).hexdigest() for i in (1, 2)]
    assert [digest for _, digest in fetched] == expected
    assert [shape for shape, _ in fetched] == [[480, 640, 3], [480, 640, 3]]
