"""picture.jpg, decoded by other programs: a JPEG decoder, libultrahdr, and Chromium."""

from __future__ import annotations

import base64
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from bracketed_photographs import light as scene_light
from numpy.typing import NDArray
from picture_parts import details, light_of

from camctl.pictures.colour import LUMINANCE
from camctl.pictures.gain_map import MOST_STOPS, picture_with_gain_map
from camctl.pictures.preview import Renditions, renditions

_ISO = b"urn:iso:std:iso:ts:21496:-1\0"
_XMP = b"http://ns.adobe.com/hdr-gain-map/1.0/"
#: Light that is in range: eight bits of a preview show nothing darker.
_LEAST = 0.004


def shown(grey: bool) -> Renditions:
    scene = scene_light(90, 120) / 200
    return renditions(light_of(scene[..., 1] if grey else scene, noise=0.01))


def written(of: Renditions) -> bytes:
    return picture_with_gain_map(of, details(), cv2)


def decoded(data: bytes) -> NDArray[Any]:
    found = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert found is not None
    return np.asarray(found)


def errors(found: NDArray[np.floating], of: Renditions) -> NDArray[np.floating]:
    light = np.broadcast_to(of.light, found.shape)
    inside = (light > _LEAST) & (light < 2**MOST_STOPS)
    assert inside.mean() > 0.9
    return np.asarray(np.abs(found[inside] / light[inside] - 1))


@pytest.mark.parametrize("grey", [False, True])
def test_a_jpeg_decoder_shows_the_preview(grey: bool) -> None:
    of = shown(grey)
    found = decoded(written(of))
    picture = found[..., 0] if grey else cv2.cvtColor(found, cv2.COLOR_BGR2RGB)
    assert picture.shape == of.codes.shape
    assert np.abs(picture.astype(int) - of.codes).mean() < 2


@pytest.mark.parametrize("grey", [False, True])
@pytest.mark.parametrize("metadata", ["both", "ISO 21496-1", "Ultra HDR"])
def test_libultrahdr_shows_the_light(grey: bool, metadata: str) -> None:
    imagecodecs = pytest.importorskip("imagecodecs", reason="imagecodecs is missing")
    of = shown(grey)
    data = written(of)
    if metadata == "Ultra HDR":
        data = data.replace(_ISO, b"x" * len(_ISO))
    elif metadata == "ISO 21496-1":
        data = data.replace(_XMP, b"x" * len(_XMP))
    linear = imagecodecs.ULTRAHDR.CT.LINEAR
    found = imagecodecs.ultrahdr_decode(data, dtype="float16", transfer=linear)[..., :3]
    wrong = errors(found.astype(float), of)
    assert np.median(wrong) < 0.03
    assert np.percentile(wrong, 90) < 0.05


def test_the_light_is_the_radiance_where_its_stated_error_is_no_noise() -> None:
    """Leaves, and errors of a response and of JPEG: neighbours have these in common."""
    imagecodecs = pytest.importorskip("imagecodecs", reason="imagecodecs is missing")
    rng = np.random.default_rng(1)
    leaves = np.exp(rng.normal(0, 0.2, (150, 200, 1))) * np.geomspace(0.03, 1, 200)[:, np.newaxis]
    light = leaves * (0.8, 1.0, 0.5) * np.exp(rng.normal(0, 0.01, (150, 200, 3)))
    of = renditions(light_of(light, noise=0.08))
    linear = imagecodecs.ULTRAHDR.CT.LINEAR
    found = imagecodecs.ultrahdr_decode(written(of), dtype="float16", transfer=linear)[..., :3]
    luminance = (found @ LUMINANCE) / (light @ LUMINANCE)
    assert np.percentile(np.abs(luminance / np.median(luminance) - 1), 95) < 0.05


_PAGE = """<!doctype html><body><pre id=o></pre><script>(async () => {
const image = new Image(); image.src = "data:image/jpeg;base64,DATA"; await image.decode();
const canvas = document.createElement("canvas");
canvas.width = image.width; canvas.height = image.height;
const format = {colorType: "float16", colorSpace: "srgb-linear"};
const context = canvas.getContext("2d", format); context.globalHDRHeadroom = 8;
context.drawImage(image, 0, 0);
const data = context.getImageData(0, 0, image.width, image.height,
    {pixelFormat: "rgba-float16", colorSpace: "srgb-linear"}).data;
document.getElementById("o").textContent = "light " + Array.from(data).join(" ") + " end";
})();</script></body>"""


@pytest.mark.slow
def test_chromium_shows_the_light(tmp_path: Path) -> None:
    program = shutil.which("chromium")
    if program is None:
        pytest.skip("chromium is missing: apt-get install chromium")
    of = shown(grey=False)
    page = tmp_path / "page.html"
    page.write_text(_PAGE.replace("DATA", base64.b64encode(written(of)).decode()))
    command = [program, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom"]
    command += ["--enable-experimental-web-platform-features", "--virtual-time-budget=10000"]
    done = subprocess.run([*command, page.as_uri()], capture_output=True, text=True, timeout=120)
    numbers = re.search("light (.*) end", done.stdout)
    assert numbers is not None
    found = np.array(numbers[1].split(), float).reshape(*of.codes.shape[:2], 4)[..., :3]
    wrong = errors(found, of)
    assert np.median(wrong) < 0.03
    assert np.percentile(wrong, 90) < 0.05


def test_light_beyond_what_displays_have_is_cut_to_it() -> None:
    of = shown(grey=False)
    bright = Renditions(of.codes, of.light.copy())
    bright.light[:10, :10] = 1e6
    imagecodecs = pytest.importorskip("imagecodecs", reason="imagecodecs is missing")
    linear = imagecodecs.ULTRAHDR.CT.LINEAR
    found = imagecodecs.ultrahdr_decode(written(bright), dtype="float16", transfer=linear)
    assert found[2:8, 2:8, :3] == pytest.approx(2**MOST_STOPS, rel=0.1)


def test_a_black_picture_has_a_gain_map_too() -> None:
    black = Renditions(np.zeros((16, 16, 3), np.uint8), np.zeros((16, 16, 3), np.float32))
    assert decoded(written(black)).max() == 0
