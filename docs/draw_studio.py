"""Draw the views of `camctl studio` in headless Chromium, at three sizes.

    python docs/draw_studio.py [FOLDER]

Writes docs/pictures/studio/VIEW-WIDTHxHEIGHT.jpg, or into FOLDER.  It needs Playwright and
Chromium, and uses the simulated camera.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

QUALITY = 80  # of the JPEG files, 1 to 100
SIZES = ((390, 844), (844, 390), (1280, 800))


@contextmanager
def studio(folder: str, *options: str) -> Iterator[str]:
    """Yield the address of a studio whose captures are in a folder."""
    command = [sys.executable, "-m", "camctl", "studio", "--address", "0", "-o", folder]
    command += ["--menu-settings", f"{folder}/menu.json", *options]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        yield process.stderr.readline().split()[-1]
    finally:
        process.terminate()
        process.wait()


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
    page.wait_for_timeout(300)
    page.keyboard.press("Escape")
    page.wait_for_timeout(300)
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
    page.click("[data-profiles]")
    page.wait_for_selector(".plot")
    while not page.locator(".plot").evaluate("image => image.complete"):
        page.wait_for_timeout(100)
    take("profile")


def main(target: Path) -> None:
    """Draw all."""
    with tempfile.TemporaryDirectory() as profiles, sync_playwright() as playwright:
        os.environ["CAMCTL_PROFILES"] = profiles
        calibrate = [sys.executable, "-m", "camctl", "calibrate", "all", "--camera", "sim"]
        subprocess.run(calibrate, check=True, capture_output=True)
        browser = playwright.chromium.launch(
            executable_path=shutil.which("chromium"), args=["--no-sandbox"]
        )
        for width, height in SIZES:
            with tempfile.TemporaryDirectory() as folder, studio(folder) as url:
                page = browser.new_page(viewport={"width": width, "height": height})
                page.on("pageerror", lambda error: print(error, file=sys.stderr))
                page.goto(url)

                def take(view: str, page: Any = page, size: str = f"{width}x{height}") -> None:
                    page.screenshot(
                        path=target / f"{view}-{size}.jpg", type="jpeg", quality=QUALITY
                    )

                tour(page, take)
                page.close()
        browser.close()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the views of camctl studio.")
    pictures = Path(__file__).parent / "pictures" / "studio"
    parser.add_argument("folder", nargs="?", type=Path, default=pictures)
    main(parser.parse_args().folder)
