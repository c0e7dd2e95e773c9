"""The page of the web panel in headless Chromium: from the start to a result, by its buttons."""

from __future__ import annotations

import base64
import shutil
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from browser import Call, browser
from panel_fakes import FakeJob

from camctl.menu.app import run
from camctl.menu.panels.web import WebPanel

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        shutil.which("chromedriver") is None, reason="apt-get install chromium chromium-driver"
    ),
]
PHONE = "--window-size=420,800"


@pytest.fixture
def call() -> Iterator[Call]:
    """Return a function that sends a command to a browser of its own (W3C WebDriver)."""
    with browser(PHONE) as call:
        yield call


@pytest.fixture
def page(call: Call) -> tuple[FakeJob, threading.Thread]:
    """The job and the thread of a menu whose page the browser shows."""
    job, panel = FakeJob(), WebPanel("0", token="")
    menu = threading.Thread(target=run, args=(panel, lambda: job), daemon=True)
    menu.start()
    while not panel.is_open:
        time.sleep(0.01)
    call("POST", "url", url=panel.url)
    return job, menu


def test_capture_is_taken_with_the_buttons_of_the_page(
    call: Call, page: tuple[FakeJob, threading.Thread]
) -> None:
    job, menu = page

    def script(text: str) -> Any:
        return call("POST", "execute/sync", script=text, args=[])

    def wait_for(text: str) -> None:
        shown = "return document.getElementById('text').textContent"
        while text not in script(shown):
            time.sleep(0.02)

    def press(key: str) -> None:
        script(f"document.querySelector('[data-key={key}]').click()")

    wait_for("Ready")
    for title in ("Desired response", "Dynamic range", "Exposures", "Review", "Done"):
        press("enter")
        wait_for(title)
    picture = "const p = document.getElementById('screen'); return [p.complete, p.naturalWidth]"
    while script(picture) != [True, 640]:
        time.sleep(0.02)
    shot = base64.b64decode(call("GET", "screenshot"))
    assert shot.startswith(b"\x89PNG")
    width = script("return [document.body.scrollWidth, window.innerWidth]")
    assert width[0] <= width[1], "the page is wider than the screen of a phone"
    script("document.dispatchEvent(new KeyboardEvent('keydown', {key: 'Escape', bubbles: true}))")
    wait_for("[Set]")
    press("exit")
    wait_for("Quit the menu?")
    press("right")
    wait_for("[Quit]")
    press("enter")
    menu.join()
    assert len(job.shot) == 1


TIME_KEYS = """
const done = arguments[0], picture = document.getElementById("screen"), times = [];
const text = document.getElementById("text");
async function pressed(key) {
  const loaded = new Promise(resolve => picture.addEventListener("load", resolve, {once: true}));
  const began = performance.now();
  document.querySelector(`[data-key=${key}]`).click();
  await loaded;
  return performance.now() - began;
}
async function round_trip() {
  const began = performance.now();
  await fetch("key/none", {method: "POST"});
  return performance.now() - began;
}
const middle = values => values.sort((a, b) => a - b)[values.length >> 1];
(async () => {
  while (!text.textContent.includes("Ready")) { await new Promise(r => setTimeout(r, 50)); }
  document.querySelector("[data-key=enter]").click();
  while (!text.textContent.includes("Desired")) { await new Promise(r => setTimeout(r, 50)); }
  await new Promise(r => setTimeout(r, 500));  // the costs of the entries have come
  const keys = [], trips = [];
  for (let k = 0; k < 20; k++) {
    trips.push(await round_trip());
    keys.push(await pressed(k % 2 ? "up" : "down"));
  }
  done([middle(keys), keys[keys.length - 1], middle(trips)]);
})();
"""


@pytest.mark.serial
def test_picture_follows_a_key_at_once(call: Call, page: tuple[FakeJob, threading.Thread]) -> None:
    median, most, trip = call("POST", "execute/async", script=TIME_KEYS, args=[])
    print(f"key to picture: median {median:.0f} ms, at most {most:.0f} ms; request {trip:.1f} ms")
    # The key, the next screen, and its decoding: not 40 ms more for each acknowledgement.
    assert median < 60 + 5 * trip
