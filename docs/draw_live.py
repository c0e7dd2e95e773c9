"""Draw the page of `camctl live` in headless Chromium, as the how-to page shows it.

    python docs/draw_live.py [FILE]

Writes docs/pictures/live.png, or FILE, and prints how many frames were lost: take it on a machine
that has nothing else to do.  It needs Playwright and Chromium.
"""

from __future__ import annotations

import json
import sys
import urllib.request
from pathlib import Path

from served_page import chromium, served

#: The example of docs/how-to/live.md.
COMMAND = ("--scene", "moving-target", "-O", "size=320x240", "--fps", "15")
SEEN_MS = 8000  # results that the page has shown before it is drawn


def main(target: Path) -> None:
    """Draw the page."""
    with served("live", *COMMAND, "--output", "http:0") as url, chromium() as browser:
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(url)
        page.wait_for_timeout(SEEN_MS)
        page.screenshot(path=target)
        with urllib.request.urlopen(f"{url}state") as answer:
            print(f"frames lost: {json.load(answer)['lost']}")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "pictures/live.png")
