"""Pictures on the card of a CoolPix: which one is new, and incomplete downloads."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import pytest

from camctl.drivers.coolpix.pictures import CardPicture, download, is_next, wait_for_picture
from camctl.drivers.coolpix.sierra.packets import RefusedCommandError, Register
from camctl.drivers.coolpix.sierra.session import Sierra
from camctl.errors import CameraProtocolError
from camctl.interface.clock import VirtualClock
from camctl.interface.controls import Layout
from camctl.sim.devices.still_files import RawImage, encode

GREY = np.arange(64, dtype=np.uint8).reshape(8, 8)
JPEG = encode("jpeg", RawImage(GREY, Layout.MONO, 8, 0, 255, 0.5))
PICTURE = CardPicture(3, "DSCN0003.JPG")


class Registers:
    """A session in which each register answers the given values in turn, the last one for good."""

    class link:  # noqa: N801 - stands for an object
        url = "test://"

    def __init__(self, answers: dict[Register, list[Any]]) -> None:
        self.answers = {register: list(values) for register, values in answers.items()}

    def get(self, register: Register, *, picture: int | None = None) -> Any:
        values = self.answers[register]
        value = values.pop(0) if len(values) > 1 else values[0]
        if isinstance(value, Exception):
            raise value
        return value

    def read(self, register: Register, limit: int, *, picture: int | None = None) -> Any:
        return self.get(register)

    text = get


def session(answers: dict[Register, list[Any]]) -> Sierra:
    return cast(Sierra, Registers(answers))


class TestDownload:
    @pytest.mark.parametrize(
        "first",
        [JPEG[:-100], JPEG[:-2] + b"\0\0", b"", bytes(len(JPEG))],
        ids=["short", "without end", "empty", "zeros"],
    )
    def test_an_incomplete_file_is_requested_again(self, first: bytes) -> None:
        sierra = session(
            {Register.PICTURE_BYTES: [len(JPEG)], Register.PICTURE_DATA: [first, first, JPEG]}
        )
        data, still = download(sierra, PICTURE)
        assert data == JPEG
        assert still.pixels.shape == (8, 8)

    @pytest.mark.parametrize("size", [0, 1 << 27, 0xFFFF_FFFF])
    def test_an_impossible_size_is_an_error(self, size: int) -> None:
        sierra = session({Register.PICTURE_BYTES: [size], Register.PICTURE_DATA: [JPEG]})
        with pytest.raises(
            CameraProtocolError, match=rf"invalid size of {size} bytes for DSCN0003\.JPG"
        ) as caught:
            download(sierra, PICTURE)
        assert caught.value.hint

    def test_a_file_that_stays_incomplete_is_an_error(self) -> None:
        sierra = session({Register.PICTURE_BYTES: [len(JPEG)], Register.PICTURE_DATA: [JPEG[:9]]})
        with pytest.raises(CameraProtocolError, match=rf"sent 9 of {len(JPEG)} bytes of DSCN0003"):
            download(sierra, PICTURE)


class TestNewPictures:
    @pytest.mark.parametrize(
        ("later", "earlier", "expected"),
        [
            (CardPicture(4, "D4"), CardPicture(3, "D3"), True),
            (CardPicture(4, ""), CardPicture(3, ""), True),
            (CardPicture(1, "D1"), CardPicture(0, ""), True),
            (CardPicture(0, "DSCN0007.JPG"), CardPicture(0, ""), True),  # register 4 as written
            (CardPicture(12, "DSCN0012.JPG"), CardPicture(0, ""), True),
            (CardPicture(0, ""), CardPicture(0, ""), False),
            (CardPicture(1, "D1000"), CardPicture(999, "D999"), True),
            (CardPicture(3, "D3"), CardPicture(3, "D3"), False),
            (CardPicture(5, "D5"), CardPicture(3, "D3"), False),
            (CardPicture(4, "D3"), CardPicture(3, "D3"), False),
            (CardPicture(0, ""), CardPicture(3, "D3"), False),
            (CardPicture(2, "D2"), CardPicture(3, "D3"), False),
            (CardPicture(1, "DSCN0101.JPG"), CardPicture(1, "DSCN0100.JPG"), True),
            (CardPicture(0, "DSCN0000.JPG"), CardPicture(0, "DSCN9999.JPG"), True),
            (CardPicture(0, "DSCN0102.JPG"), CardPicture(0, "DSCN0100.JPG"), False),
            (CardPicture(3, ""), CardPicture(3, ""), False),
        ],
    )
    def test_only_the_very_next_picture_is_next(
        self, later: CardPicture, earlier: CardPicture, expected: bool
    ) -> None:
        assert is_next(later, earlier) is expected

    def test_a_camera_that_refuses_to_tell_is_asked_again(self) -> None:
        counts = [RefusedCommandError("busy"), 3, 3, 4]
        names = ["DSCN0003.JPG", "DSCN0003.JPG", "DSCN0004.JPG"]
        sierra = session({Register.PICTURE: counts, Register.PICTURE_NAME: names})
        found = wait_for_picture(sierra, PICTURE, VirtualClock(), 10.0)
        assert found == CardPicture(4, "DSCN0004.JPG")

    def test_waiting_ends(self) -> None:
        clock = VirtualClock()
        sierra = session({Register.PICTURE: [3], Register.PICTURE_NAME: [PICTURE.name]})
        assert wait_for_picture(sierra, PICTURE, clock, 10.0) is None
        assert clock.now() == pytest.approx(10.0, abs=0.1)
