"""Draw the views of `camctl studio` in headless Chromium, at three sizes.

    python docs/draw_studio.py [FOLDER]

Writes docs/pictures/studio/VIEW-WIDTHxHEIGHT.jpg, or into FOLDER.  It needs Playwright and
Chromium, and uses the simulated camera.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from served_page import chromium, served

QUALITY = 80  # of the JPEG files, 1 to 100
SIZES = ((390, 844), (844, 390), (1280, 800))


def tour(page: Any, take: Any) -> None:
    """Go through the views, and take each."""
    page.wait_for_selector("[data-action=set]")
    page.wait_for_selector(".sight img[src]")
    page.wait_for_timeout(500)
    take("camera")
    page.click("[data-action=set]")
    page.wait_for_selector(".choice:nth-child(4) img")
    page.wait_for_timeout(500)
    take("response")
    page.click(".next")
    page.wait_for_selector("text=Low 1:256")
    page.wait_for_selector(".choice:nth-child(4) img")
    page.wait_for_selector("text=computing", state="detached")
    page.wait_for_timeout(500)
    take("range")
    page.click("[data-section=time]")
    page.wait_for_selector(".dial", timeout=60000)
    page.wait_for_timeout(500)
    take("time")
    page.click("[data-take]")
    page.wait_for_selector("[data-action=timer]", timeout=60000)
    page.wait_for_timeout(200)
    take("plan")
    page.click("[data-action=shoot]")
    page.wait_for_selector(".picture", timeout=60000)
    page.wait_for_timeout(500)
    page.focus(".picture")
    page.keyboard.press("ArrowRight")
    page.click("[data-layer=dark]")
    page.wait_for_timeout(1000)
    take("result")
    page.click("[data-section=captures]")
    page.wait_for_selector(".choice")
    page.wait_for_timeout(500)
    take("captures")
    page.click("[data-section=merge]")
    page.wait_for_timeout(300)
    take("merge")
    page.click("[data-section=settings]")
    page.wait_for_timeout(300)
    take("settings")
    page.click("button:has-text('Calibration')")
    page.wait_for_selector("text=Put the camera on a tripod")
    take("calibration")
    page.click("button:has-text('Still scene')")
    page.wait_for_selector("text=Kept in the camera's profile.", timeout=240000)
    take("calibrated")
    page.click("[data-profiles]")
    page.wait_for_selector(".plot")
    while not page.locator(".plot").evaluate("image => image.complete"):
        page.wait_for_timeout(100)
    take("profile")


def main(target: Path) -> None:
    """Draw all."""
    with tempfile.TemporaryDirectory() as profiles, chromium() as browser:
        os.environ["CAMCTL_PROFILES"] = profiles
        calibrate = [sys.executable, "-m", "camctl", "calibrate", "all", "--camera", "sim"]
        subprocess.run(calibrate, check=True, capture_output=True)
        for width, height in SIZES:
            with tempfile.TemporaryDirectory() as folder:
                settings = ("--menu-settings", f"{folder}/menu.json")
                with served("studio", "--address", "0", "-o", folder, *settings) as url:
                    draw(browser, url, (width, height), target)


def draw(browser: Any, url: str, size: tuple[int, int], target: Path) -> None:
    """Draw the views of a studio at one size."""
    width, height = size
    page = browser.new_page(viewport={"width": width, "height": height})
    page.on("pageerror", lambda error: print(error, file=sys.stderr))
    page.goto(url)

    def take(view: str) -> None:
        path = target / f"{view}-{width}x{height}.jpg"
        page.screenshot(path=path, type="jpeg", quality=QUALITY)

    tour(page, take)
    page.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the views of camctl studio.")
    pictures = Path(__file__).parent / "pictures" / "studio"
    parser.add_argument("folder", nargs="?", type=Path, default=pictures)
    main(parser.parse_args().folder)
