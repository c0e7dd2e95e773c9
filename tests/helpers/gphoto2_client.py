"""gphoto2 as a second, independent client of the virtual still cameras."""

import os
import shutil
import subprocess
from pathlib import Path

SOURCE = Path(__file__).with_name("modem_lines.c")
TIMEOUT_S = 120
SHUTTER_US = "/Camera Configuration/Picture Settings/Shutter Speed (microseconds, 0 auto)"

# For ("shutterspeed", ...): 1/60 s, by `vendor` of the virtual camera's configuration.
SIXTIETH = {"none": "0.0167s", "nikon": "1/60", "canon": "1/60", "sony": "1/60"}


def missing():
    """Return why gphoto2 cannot be run here; None where it can."""
    if shutil.which("gphoto2") is None:
        return "gphoto2 is not installed: apt-get install gphoto2"
    return None


def missing_for_pty():
    """Return why gphoto2 cannot be run on a pseudo-terminal here; None where it can."""
    if missing() is None and shutil.which("cc") is None:
        return "no C compiler, which gphoto2 needs on a pseudo-terminal: apt-get install gcc"
    return missing()


def modem_lines(folder):
    """Compile what makes gphoto2 take a pseudo-terminal, into `folder`; return its path."""
    library = Path(folder) / "modem_lines.so"
    command = ["cc", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"]
    subprocess.run(command, check=True, capture_output=True)
    return library


def gphoto2(*words, folder, preload=None):
    """Run gphoto2 in `folder` and return what it printed; AssertionError where it failed."""
    # A folder of its own for settings, that nobody's own are used or changed.
    environment = {**os.environ, "HOME": str(folder), "LC_ALL": "C.UTF-8"}
    if preload is not None:
        environment["LD_PRELOAD"] = str(preload)
    done = subprocess.run(
        ["gphoto2", *words],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=TIMEOUT_S,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def shoot(folder, *words, preload=None):
    """Take a picture and return the bytes of the file that was downloaded."""
    target = Path(folder) / "picture"
    target.unlink(missing_ok=True)
    said = gphoto2(
        *words,
        "--capture-image-and-download",
        "--force-overwrite",
        f"--filename={target.name}",
        folder=folder,
        preload=preload,
    )
    # It ends well even where it could not take the picture.
    assert target.exists(), said
    return target.read_bytes()


def coolpix_words(node, speed=19200):
    """Return the words for a CoolPix 990 at a serial node."""
    return ("--port", f"serial:{node}", "--speed", str(speed), "--camera", "Nikon CoolPix 990")


def shoot_coolpix(folder, node, *, shutter_us=None, speed=19200, preload=None):
    """Take a picture with a CoolPix 990 at a serial node and return the file's bytes."""
    words = coolpix_words(node, speed)
    if shutter_us is not None:
        value = f"{SHUTTER_US}={shutter_us}"
        gphoto2(*words, "--set-config", value, folder=folder, preload=preload)
    return shoot(folder, *words, preload=preload)


def detected(folder):
    """Return (model, port) of each camera on USB."""
    lines = gphoto2("--auto-detect", folder=folder).splitlines()[2:]
    return [
        tuple(part.strip() for part in line.rsplit(" usb:", 1)) for line in lines if line.strip()
    ]


def usb_port(device):
    """Return gphoto2's name for the port of a pyusb device."""
    return f"usb:{device.bus:03d},{device.address:03d}"


def shoot_ptp(folder, port, *, settings=()):
    """Take a picture with a PTP camera at `port`, as `usb_port` names it; return the file's bytes.

    `settings` are pairs of a configuration name and value, such as ("shutterspeed", "0.0100s").
    """
    words = ("--port", port)
    changes = [word for name, value in settings for word in ("--set-config", f"{name}={value}")]
    return shoot(folder, *words, *changes)
