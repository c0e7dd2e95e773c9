"""picture.avif, read by ffmpeg: what it says of its codes, and the light that they mean."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from bracketed_photographs import light as scene_light
from numpy.typing import NDArray

from camctl.pictures.hdr_avif import picture_in_pq

LIGHT: NDArray[np.float32] = (scene_light(90, 120) / 200).astype(np.float32)


def written(folder: Path, light: NDArray[np.float32]) -> Path:
    imagecodecs = pytest.importorskip("imagecodecs", reason="imagecodecs is missing")
    path = folder / "picture.avif"
    path.write_bytes(picture_in_pq(light, imagecodecs))
    return path


def run(*command: str | Path) -> bytes:
    if shutil.which(str(command[0])) is None:
        pytest.skip("ffmpeg is missing: apt-get install ffmpeg")
    return subprocess.run(command, check=True, capture_output=True, timeout=60).stdout


def luminance(codes: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return cd/m2 by ITU-R BT.2100, table 4, of codes of 0 to 1."""
    root = codes ** (32 / 2523)
    share = np.maximum(root - 107 / 128, 0) / (2413 / 128 - 2392 / 128 * root)
    return np.asarray(10_000 * share ** (8192 / 1305))


def decoded(path: Path, shape: tuple[int, ...]) -> NDArray[np.floating]:
    """Return the light that ffmpeg reads, 1 = a white of 203 cd/m2."""
    data = run("ffmpeg", "-v", "error", "-i", path, "-f", "rawvideo", "-pix_fmt", "rgb48le", "-")
    codes = np.frombuffer(data, "<u2").reshape(*shape[:2], 3) / 65535
    return luminance(codes) / 203


@pytest.mark.parametrize(("channels", "layout"), [(1, "gray10le"), (3, "yuv444p10le")])
def test_ffprobe_reads_pq_and_the_primaries_of_bt709(
    tmp_path: Path, channels: int, layout: str
) -> None:
    path = written(tmp_path, LIGHT[..., :channels])
    (stream,) = json.loads(run("ffprobe", "-v", "error", "-show_streams", "-of", "json", path))[
        "streams"
    ]
    assert stream["color_transfer"] == "smpte2084"
    assert stream["color_primaries"] == stream["color_space"] == "bt709"
    assert stream["color_range"] == "pc"
    assert stream["pix_fmt"] == layout


@pytest.mark.parametrize("channels", [1, 3])
def test_ffmpeg_reads_the_light(tmp_path: Path, channels: int) -> None:
    light = LIGHT[..., :channels]
    found = decoded(written(tmp_path, light), light.shape)
    expected = np.broadcast_to(light, found.shape)
    inside = expected > 0.001  # 0.2 cd/m2
    assert inside.mean() > 0.9
    wrong = np.abs(found[inside] / expected[inside] - 1)
    assert np.median(wrong) < 0.02
    assert np.percentile(wrong, 90) < 0.05


def test_light_beyond_the_codes_is_their_end(tmp_path: Path) -> None:
    light = np.zeros((32, 32, 3), np.float32)
    light[:16] = 1e9
    light[16:] = -1.0
    found = decoded(written(tmp_path, light), light.shape)
    assert found[4:12, 4:-4] == pytest.approx(10_000 / 203, rel=0.02)
    assert found[20:28, 4:-4].max() < 1e-4


@pytest.mark.parametrize("shape", [(1, 1, 3), (1, 9, 1), (7, 2, 3)])
def test_small_pictures_have_their_size(tmp_path: Path, shape: tuple[int, int, int]) -> None:
    path = written(tmp_path, np.ones(shape, np.float32))
    assert decoded(path, shape) == pytest.approx(1.0, rel=0.02)
