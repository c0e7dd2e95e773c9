"""The studio in headless Chromium: a capture, a cancel, a camera unplugged, a reload, contrast."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bracketed_photographs import film, photograph, save
from panel_fakes import FakeJob
from ptp_bench import bench
from studio_menu import MakeJob, job_with, start_menu

from camctl.errors import CameraDisconnectedError
from camctl.interface.camera import Camera
from camctl.menu.camera_job import CameraJob
from camctl.menu.data import CameraEntry
from camctl.sim.backend import SimulatedBackend

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="apt-get install chromium chromium-driver"),
]
SIZES = ((390, 844), (844, 390), (1280, 800))
WAIT_MS = 90_000
LEAST_CONTRAST = 4.5  # WCAG 2.2, criterion 1.4.3, level AA


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a browser."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as started:
        opened = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield opened
        opened.close()


Show = Callable[..., Any]


@pytest.fixture
def show(browser: Any, tmp_path: Path) -> Iterator[Show]:
    """Return a function that shows the studio of a job in a page of a size."""
    opened: list[Any] = []

    def begin(make_job: MakeJob, size: tuple[int, int] = SIZES[0]) -> Any:
        panel, _ = start_menu(tmp_path, make_job)
        page = browser.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(WAIT_MS)
        errors: list[Any] = []
        page.on("pageerror", lambda error: errors.append(error))  # a bound method is refused
        page.goto(panel.url)
        opened.append((page, errors))
        return page

    yield begin
    for page, errors in opened:
        assert errors == []
        page.close()


def simulated() -> Camera:
    """Return a small simulated camera."""
    return SimulatedBackend().open("", {"size": "96x64"})


@pytest.mark.parametrize("size", SIZES)
def test_capture_is_taken_judged_and_loaded(
    show: Show, size: tuple[int, int], tmp_path: Path
) -> None:
    page = show(job_with(simulated), size)
    page.wait_for_selector(".sight img[src]")
    page.click("[data-action=set]")
    page.wait_for_selector(".choice:nth-child(4) img")
    page.click("[data-section=time]")
    slider = page.wait_for_selector(".dials input")
    before = page.inner_text(".dials")
    slider.focus()
    page.keyboard.press("ArrowLeft")
    assert page.inner_text(".dials") != before
    # Once the pictures beside it have their size; what it says may be drawn anew at any time.
    page.wait_for_function(_IN_SIGHT, arg="effective levels")
    page.keyboard.press("Escape")
    page.wait_for_selector("[data-entry]:has-text('Recommended')")
    page.click("text=Time / accuracy")
    page.wait_for_selector(".dials input")
    page.focus(".dials input")
    page.keyboard.press("Enter")
    page.click("[data-action=shoot]")
    page.wait_for_selector(".picture")
    page.focus(".picture")
    page.keyboard.press("ArrowRight")
    page.wait_for_selector(".reading:has-text('±')")
    page.click("[data-layer=dark]")
    painted = page.wait_for_selector("[data-kind=dark]").evaluate(_COLOURS)
    sample = page.locator("[data-layer=dark] .sample").evaluate(
        "each => getComputedStyle(each).backgroundColor"
    )
    assert painted == [sample]
    with page.expect_download() as loaded:
        page.click("a:has-text('radiance.exr')")
    (folder,) = tmp_path.glob("capture-*")
    assert Path(loaded.value.path()).read_bytes() == (folder / "radiance.exr").read_bytes()
    page.click("[data-section=captures]")  # all of them, and not the one that is shown
    page.click(f".choice:has-text('{folder.name}')")
    page.wait_for_selector(".picture")
    width = page.evaluate("document.documentElement.scrollWidth")
    assert width <= size[0]
    page.click("[data-delete]")
    assert folder.exists()
    page.click("[data-delete]")
    page.wait_for_selector("text=No captures yet")
    assert not folder.exists()


def test_capture_is_taken_with_keys_alone(show: Show) -> None:
    page = show(job_with(simulated), SIZES[2])
    page.wait_for_selector("[data-action=shoot]")
    page.keyboard.press("ArrowRight")
    page.wait_for_selector("[data-action=shoot].main")
    page.keyboard.press("Enter")
    page.wait_for_selector("[data-action=timer]")
    page.keyboard.press("Enter")
    page.wait_for_selector(".picture")
    page.keyboard.press("5")
    page.keyboard.press("Escape")
    page.keyboard.press("1")
    page.wait_for_selector(".sight img[src]")


@pytest.mark.parametrize("size", SIZES)
def test_body_without_preview_takes_a_capture_once_it_may_meter(
    show: Show, size: tuple[int, int]
) -> None:
    pair = bench(vendor="nikon", scene="ramp")
    page = show(job_with(lambda: pair.camera()), size)
    page.wait_for_selector("text=mode dial at M, battery")
    assert page.evaluate("document.documentElement.scrollWidth") <= size[0]
    page.click("[data-action=set]")
    page.click(".next")
    page.click("button:has-text('Low 1:256')")
    page.click("[data-section=time]")
    page.click("button:has-text('Number')")
    page.wait_for_selector(".row:has-text('× the shortest exposure')")
    page.click("[data-section=live]")
    page.click("[data-action=shoot]")
    page.wait_for_selector("text=(menu: Settings, Shots for metering)")
    page.click("[data-section=settings]")
    page.click("button:has-text('No shots for metering')")
    page.click("[data-section=live]")
    page.click("[data-action=shoot]")
    page.wait_for_selector("[data-action=timer]")
    page.click("[data-action=shoot]")
    page.wait_for_selector(".picture")


def test_running_capture_is_seen_after_a_reload_and_cancelled(show: Show) -> None:
    job = FakeJob()
    job.frame_may_end.clear()
    page = show(lambda _: job)
    page.click("[data-action=shoot]")
    page.wait_for_selector("[data-action=timer]")
    page.click("[data-action=shoot]")
    page.wait_for_selector(".frames .now")
    page.reload()
    page.wait_for_selector(".frames .now")
    page.click("[data-section=captures]")
    page.click("[data-stop]")
    page.wait_for_selector("text=stopped after 0 frames")
    assert len(job.shot) == 1


def test_camera_that_is_unplugged_comes_back(show: Show) -> None:
    def unplug() -> None:
        raise CameraDisconnectedError("the camera was disconnected", hint="connect it again")

    job = FakeJob()
    page = show(lambda _: job)
    page.wait_for_selector("[data-action=shoot]")
    job.before["meter"] = job.before["open"] = unplug
    page.wait_for_selector("text=the camera was disconnected")
    del job.before["meter"], job.before["open"]
    page.wait_for_selector("[data-action=shoot]")


_COLOURS = """async image => {
  await image.decode();
  const canvas = new OffscreenCanvas(image.naturalWidth, image.naturalHeight);
  const context = canvas.getContext("2d");
  context.drawImage(image, 0, 0);
  const {data} = context.getImageData(0, 0, canvas.width, canvas.height), found = new Set();
  for (let at = 0; at < data.length; at += 4) {
    if (data[at + 3]) { found.add(`rgb(${data[at]}, ${data[at + 1]}, ${data[at + 2]})`); }
  }
  return [...found];
}"""
_IN_SIGHT = """words => [...document.querySelectorAll(".dials dd")].some(each => {
  const box = each.getBoundingClientRect(), seen = main.getBoundingClientRect();
  return each.textContent.includes(words) && box.top >= seen.top && box.bottom <= seen.bottom;
})"""
_CONTRASTS = """() => {
  const channels = text => text.match(/[\\d.]+/g).map(Number);
  const light = colour => channels(colour).slice(0, 3).map(each => {
    const share = each / 255;
    return share <= 0.04045 ? share / 12.92 : ((share + 0.055) / 1.055) ** 2.4;
  }).reduce((sum, each, at) => sum + each * [0.2126, 0.7152, 0.0722][at], 0);
  const ground = element => {
    for (let each = element; each; each = each.parentElement) {
      const found = channels(getComputedStyle(each).backgroundColor);
      if (found.length < 4 || found[3] > 0) { return getComputedStyle(each).backgroundColor; }
    }
    return "rgb(255, 255, 255)";
  };
  return [...document.querySelectorAll("body *")].filter(each => each.checkVisibility()
    && (each.placeholder
      || [...each.childNodes].some(node => node.nodeType === 3 && node.textContent.trim())))
    .map(each => {
      const style = getComputedStyle(each, each.placeholder ? "::placeholder" : null);
      const text = light(each instanceof SVGElement ? style.fill : style.color);
      const [low, high] = [text, light(ground(each))].sort((a, b) => a - b);
      return [(high + 0.05) / (low + 0.05), each.tagName, each.textContent.slice(0, 40)];
    });
}"""


def test_all_text_has_the_contrast_that_wcag_asks_for(show: Show) -> None:
    page = show(job_with(simulated), SIZES[2])
    page.wait_for_selector(".sight img[src]")
    for leave, arrived in (
        ("[data-action=set]", ".choice:nth-child(4) img"),
        ("[data-section=time]", ".dial text"),
        ("[data-take]", "[data-action=timer]"),
        ("[data-action=shoot]", ".picture"),
        ("[data-section=settings]", "[data-entry]"),
    ):
        found = page.evaluate(_CONTRASTS)
        assert len(found) > 5
        assert [each for each in found if each[0] < LEAST_CONTRAST] == []
        page.click(leave)
        page.wait_for_selector(arrived)


def test_photographs_that_are_dropped_are_merged_and_opened(show: Show, tmp_path: Path) -> None:
    page = show(job_with(simulated))
    page.wait_for_selector("[data-action=shoot]")
    page.click("[data-section=merge]")
    page.wait_for_selector("#times")
    assert [each for each in page.evaluate(_CONTRASTS) if each[0] < LEAST_CONTRAST] == []
    times = (1 / 60, 1 / 15, 1 / 4)
    names = [
        str(save(tmp_path / f"photograph{place}.png", film(photograph(time_s))))
        for place, time_s in enumerate(times)
    ]
    page.fill("#times", "1/60, 1/15, 1/4")
    page.set_input_files("#photographs", names)
    page.wait_for_selector(".picture")
    page.click("[data-section=merge]")
    page.wait_for_selector("#photographs")
    page.click("[data-section=settings]")
    page.wait_for_selector("text=Press an entry to change it.")


def test_calibration_shows_its_steps_and_what_each_has_measured(
    show: Show, own_profiles: Path
) -> None:
    def opened(_: str, profile: str = "all") -> tuple[Camera, dict[str, str]]:
        return SimulatedBackend().open("", {"size": "320x240"}), {}

    page = show(lambda panel: CameraJob(opened, panel.parent, panel.parent / "menu.json"))
    page.wait_for_selector("[data-action=shoot]")
    page.click("[data-section=settings]")
    page.click("button:has-text('Calibration')")
    page.wait_for_selector("text=Put the camera on a tripod")
    assert [each for each in page.evaluate(_CONTRASTS) if each[0] < LEAST_CONTRAST] == []
    page.click("button:has-text('Still scene')")
    page.wait_for_selector("text=Measuring response")
    page.wait_for_selector("text=noise: ", timeout=120_000)
    page.wait_for_selector("text=Kept in the camera's profile.")
    assert [each for each in page.evaluate(_CONTRASTS) if each[0] < LEAST_CONTRAST] == []
    page.click("[data-action=back]")
    page.click("button:has-text('Lens covered')")
    page.wait_for_selector("text=put the lens cap on")


def test_several_cameras_are_marked_and_take_one_picture(show: Show, tmp_path: Path) -> None:
    cameras = ("a", "b")

    class TwoCameras(CameraJob):
        def find_cameras(self) -> tuple[CameraEntry, ...]:
            return tuple(CameraEntry(each, f"camera {each}") for each in cameras)

    page = show(
        lambda panel: TwoCameras(
            lambda _: (simulated(), {}), panel.parent, panel.parent / "menu.json", sight=panel.sight
        )
    )
    page.wait_for_selector("[data-action=shoot]")
    page.click("[data-section=settings]")
    page.click("[role=group] button:has-text('Camera')")
    page.click("button:has-text('Several at once')")
    for name in cameras:
        page.click(f"button:has-text('[ ] camera {name}')")
        page.wait_for_selector(f"button:has-text('[x] camera {name}')")
    assert [each for each in page.evaluate(_CONTRASTS) if each[0] < LEAST_CONTRAST] == []
    page.click("button:has-text('Use these 2')")
    page.click("[data-action=shoot]")
    page.wait_for_selector("[data-action=timer]")
    page.click("[data-action=shoot]")
    page.wait_for_selector(".picture")
    page.wait_for_selector("text=levels, in capture-0002")
    assert len(list(tmp_path.glob("capture-*"))) == 2
