"""Options of the V4L2 backend, and paths that are no camera."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from camctl.drivers.v4l2.backend import V4l2Backend
from camctl.drivers.v4l2.camera import V4l2Camera, V4l2Options
from camctl.errors import CameraError, CameraNotFoundError, UsageError

NOBODY = 65534


@contextmanager
def unprivileged(folder: str) -> Iterator[None]:
    """Be a user who may write in `folder` and, unlike root, may not open every file."""
    if os.geteuid() != 0:
        yield
        return
    os.chown(folder, NOBODY, -1)
    os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(0)


class TestRealSystem:
    def test_no_such_node(self) -> None:
        with pytest.raises(CameraNotFoundError, match="there is no such device"):
            V4l2Camera("/dev/video-that-is-not-there").open()

    @pytest.mark.parametrize("path", ["/dev/null", "/", "a\0b", "/dev/null/x", ""])
    def test_path_that_is_not_a_camera(self, path: str) -> None:
        with pytest.raises(CameraNotFoundError) as caught:
            V4l2Camera(path).open()
        assert "\n" not in str(caught.value)

    def test_missing_permission(self) -> None:
        with tempfile.TemporaryDirectory() as folder, unprivileged(folder):
            node = Path(folder) / "video0"
            node.touch(mode=0)
            with pytest.raises(CameraError, match="you are not allowed to use it; join its group"):
                V4l2Camera(str(node)).open()


class TestBackend:
    def test_options_are_read_from_text(self) -> None:
        options = {
            "format": " Y16",
            "size": "640x480",
            "fps": "30",
            "bits": "12",
            "black": "64",
            "gain": "DB:0.1",
            "range": "Full",
            "response": "sRGB",
        }
        chosen = V4l2Options.parse(options)
        assert (chosen.format, chosen.range, chosen.response) == ("y16", "full", "srgb")
        assert chosen.size == (480, 640)
        assert (chosen.fps, chosen.bits, chosen.black) == (30.0, 12, 64)
        assert chosen.gain is not None
        assert chosen.gain.gain(200) == pytest.approx(10.0)

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"fsp": "30"}, "unknown camera option 'fsp'; did you mean fps"),
            ({"size": "big"}, "size=big; write WIDTHxHEIGHT, such as 640x480"),
            ({"size": "0x5"}, "size=0x5; write WIDTHxHEIGHT, such as 640x480"),
            ({"fps": "fast"}, "fps=fast; input should be a valid number"),
            ({"fps": "-1"}, "fps=-1; input should be greater than 0"),
            ({"fps": "nan"}, "fps=nan; input should be"),
            ({"bits": "1.5"}, "bits=1.5; input should be a valid integer"),
            ({"bits": "8"}, "bits=8; input should be greater than or equal to 9"),
            ({"black": "²"}, "black=²; input should be a valid integer"),
            ({"black": "-1"}, "black=-1; input should be greater than or equal to 0"),
            ({"range": "half"}, "range=half; input should be 'auto', 'full' or 'limited'"),
        ],
    )
    def test_invalid_options(self, options: dict[str, str], message: str) -> None:
        with pytest.raises(UsageError) as caught:
            V4l2Backend().open("/dev/null", options)
        assert message in str(caught.value)

    @pytest.mark.parametrize("text", ["", "2", "linear", "db:", "db:0", "db:-1", "iso:100", "db:x"])
    def test_invalid_gain(self, text: str) -> None:
        with pytest.raises(UsageError, match=r"gain=.*; give what one step .* linear:0\.0625 or"):
            V4l2Backend().open("/dev/null", {"gain": text})
