"""gphoto2 as a second, independent client of the virtual still cameras."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any

SOURCE = Path(__file__).with_name("modem_lines.c")
TIMEOUT_S = 120
SHUTTER_US = "/Camera Configuration/Picture Settings/Shutter Speed (microseconds, 0 auto)"


def missing() -> str | None:
    """Return why gphoto2 cannot be run here; None if it can."""
    if shutil.which("gphoto2") is None:
        return "gphoto2 is not installed: apt-get install gphoto2"
    return None


def missing_for_pty() -> str | None:
    """Return why gphoto2 cannot be run on a pseudo-terminal here; None if it can."""
    if missing() is None and shutil.which("cc") is None:
        return "no C compiler, which gphoto2 needs on a pseudo-terminal: apt-get install gcc"
    return missing()


def modem_lines(folder: Path) -> Path:
    """Compile a library that lets gphoto2 use a pseudo-terminal, into `folder`; return its path."""
    library = folder / "modem_lines.so"
    command: list[str | Path] = ["cc", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"]
    subprocess.run(command, check=True, capture_output=True)
    return library


def gphoto2(*arguments: str, folder: Path, preload: Path | None = None) -> str:
    """Run gphoto2 in `folder` and return its output; AssertionError if it fails."""
    # HOME is `folder`, so that gphoto2 neither uses nor changes the user's own settings.
    environment = {**os.environ, "HOME": str(folder), "LC_ALL": "C.UTF-8"}
    if preload is not None:
        environment["LD_PRELOAD"] = str(preload)
    ended = subprocess.run(
        ["gphoto2", *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout + ended.stderr


def shoot(folder: Path, *arguments: str, preload: Path | None = None) -> bytes:
    """Take a picture and return the bytes of the downloaded file."""
    target = folder / "picture"
    target.unlink(missing_ok=True)
    output = gphoto2(
        *arguments,
        "--capture-image-and-download",
        "--force-overwrite",
        f"--filename={target.name}",
        folder=folder,
        preload=preload,
    )
    # gphoto2 exits with 0 even if it has taken no picture.
    assert target.exists(), output
    return target.read_bytes()


def coolpix_arguments(node: str | Path, speed: int = 19200) -> tuple[str, ...]:
    """Return gphoto2's arguments for a CoolPix 990 at a serial node."""
    return ("--port", f"serial:{node}", "--speed", str(speed), "--camera", "Nikon CoolPix 990")


def shoot_coolpix(
    folder: Path,
    node: str | Path,
    *,
    shutter_us: int | None = None,
    speed: int = 19200,
    preload: Path | None = None,
) -> bytes:
    """Take a picture with a CoolPix 990 at a serial node and return the file's bytes."""
    arguments = coolpix_arguments(node, speed)
    if shutter_us is not None:
        value = f"{SHUTTER_US}={shutter_us}"
        gphoto2(*arguments, "--set-config", value, folder=folder, preload=preload)
    return shoot(folder, *arguments, preload=preload)


def usb_port(device: Any) -> str:
    """Return gphoto2's name for the port of a pyusb device."""
    return f"usb:{device.bus:03d},{device.address:03d}"


def shoot_ptp(folder: Path, port: str, *, settings: Sequence[tuple[str, str]] = ()) -> bytes:
    """Take a picture with a PTP camera and return the file's bytes.

    Args:
        folder: where gphoto2 runs
        port: of the camera, as `usb_port` returns it
        settings: names and values of gphoto2's configuration, such as ("shutterspeed", "0.0100s")
    """
    changes = [word for name, value in settings for word in ("--set-config", f"{name}={value}")]
    return shoot(folder, "--port", port, *changes)
