"""What a file says of its exposure, and downloads that are not what they should be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.clock import VirtualClock
from camctl.controls import Layout
from camctl.errors import CameraProtocolError
from drivers.common.exif import exposure_time_s
from drivers.coolpix.pictures import OnCard, download, follows, wait_for_picture
from drivers.coolpix.sierra.packets import RefusedCommandError, Register
from sim.devices.still_files import RawImage, encode

GREY = np.arange(64, dtype=np.uint8).reshape(8, 8)


def file_of(kind, time_s):
    return encode(kind, RawImage(GREY, Layout.MONO, 8, 0, 255, time_s))


class TestExposureTime:
    @pytest.mark.parametrize("kind", ["jpeg", "tiff"])
    @pytest.mark.parametrize("time_s", [0.001, 0.016666, 0.3, 8.0])
    def test_it_is_what_the_file_says(self, kind, time_s):
        assert exposure_time_s(file_of(kind, time_s)) == pytest.approx(time_s, rel=1e-6)

    def test_a_file_that_does_not_say(self):
        jpeg = file_of("jpeg", 0.5)
        length = int.from_bytes(jpeg[4:6], "big")
        assert exposure_time_s(jpeg[:2] + jpeg[4 + length :]) is None

    @given(st.sampled_from(["jpeg", "tiff"]), st.integers(0, 200), st.binary(max_size=40))
    def test_a_damaged_one_is_a_number_or_nothing(self, kind, at, rubbish):
        data = file_of(kind, 0.5)
        found = exposure_time_s(data[:at] + rubbish + data[at + len(rubbish) :])
        assert found is None or 0 < found < float("inf")


class Registers:
    """A session whose registers are lists of answers, the last of which stays."""

    class link:  # noqa: N801
        url = "test://"

    def __init__(self, **answers):
        self.answers = {Register[name]: list(values) for name, values in answers.items()}

    def get(self, register, *, picture=None):
        values = self.answers[register]
        value = values.pop(0) if len(values) > 1 else values[0]
        if isinstance(value, Exception):
            raise value
        return value

    def read(self, register, limit, *, picture=None, progress=None):
        return self.get(register)

    def text(self, register, *, picture=None):
        return self.get(register)


JPEG = file_of("jpeg", 0.5)
PICTURE = OnCard(3, "DSCN0003.JPG")


class TestDownload:
    @pytest.mark.parametrize("first", [JPEG[:-100], JPEG[:-2] + b"\0\0", b"", bytes(len(JPEG))])
    def test_what_is_not_whole_is_asked_for_again(self, first):
        sierra = Registers(PICTURE_BYTES=[len(JPEG)], PICTURE_DATA=[first, first, JPEG])
        data, still = download(sierra, PICTURE, None)
        assert data == JPEG
        assert still.pixels.shape == (8, 8)

    @pytest.mark.parametrize("size", [0, 1 << 27, 0xFFFF_FFFF])
    def test_an_impossible_size_is_not_believed(self, size):
        sierra = Registers(PICTURE_BYTES=[size], PICTURE_DATA=[JPEG])
        with pytest.raises(CameraProtocolError, match=r"DSCN0003.JPG is said to have") as caught:
            download(sierra, PICTURE, None)
        assert caught.value.hint

    def test_it_is_given_up_in_the_end(self):
        sierra = Registers(PICTURE_BYTES=[len(JPEG)], PICTURE_DATA=[JPEG[:9]])
        with pytest.raises(CameraProtocolError, match=r"came with 9 bytes of"):
            download(sierra, PICTURE, None)


class TestNewest:
    @pytest.mark.parametrize(
        ("later", "earlier", "does"),
        [
            (OnCard(4, "D4"), OnCard(3, "D3"), True),
            (OnCard(4, ""), OnCard(3, ""), True),
            (OnCard(1, "D1"), OnCard(0, ""), True),
            (OnCard(1, "D1000"), OnCard(999, "D999"), True),
            (OnCard(3, "D3"), OnCard(3, "D3"), False),
            (OnCard(5, "D5"), OnCard(3, "D3"), False),
            (OnCard(4, "D3"), OnCard(3, "D3"), False),
            (OnCard(0, ""), OnCard(3, "D3"), False),
            (OnCard(2, "D2"), OnCard(3, "D3"), False),
        ],
    )
    def test_only_the_very_next_picture_follows(self, later, earlier, does):
        assert follows(later, earlier) is does

    def test_a_camera_that_is_still_writing_is_waited_for(self):
        sierra = Registers(
            PICTURES=[RefusedCommandError("busy"), 3, 3, 4], PICTURE_NAME=["DSCN0004.JPG"]
        )
        found = wait_for_picture(sierra, PICTURE, VirtualClock(), 10.0)
        assert found == OnCard(4, "DSCN0004.JPG")

    def test_waiting_ends(self):
        clock = VirtualClock()
        assert wait_for_picture(Registers(PICTURES=[3]), PICTURE, clock, 10.0) is None
        assert clock.now() == pytest.approx(10.0, abs=0.1)
