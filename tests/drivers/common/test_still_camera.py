"""Exposure times in files of still cameras."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from camctl.controls import Layout
from drivers.common.still_camera import exposure_time_s
from sim.devices.still_files import RawImage, encode

GREY = np.arange(64, dtype=np.uint8).reshape(8, 8)


def file_of(kind: str, time_s: float) -> bytes:
    return encode(kind, RawImage(GREY, Layout.MONO, 8, 0, 255, time_s))


@pytest.mark.parametrize("kind", ["jpeg", "tiff"])
@pytest.mark.parametrize("time_s", [0.001, 0.016666, 0.3, 8.0])
def test_the_time_is_read_from_the_file(kind: str, time_s: float) -> None:
    assert exposure_time_s(file_of(kind, time_s)) == pytest.approx(time_s, rel=1e-6)


def test_a_file_without_the_tag_has_no_time() -> None:
    jpeg = file_of("jpeg", 0.5)
    length = int.from_bytes(jpeg[4:6], "big")
    assert exposure_time_s(jpeg[:2] + jpeg[4 + length :]) is None


@given(st.sampled_from(["jpeg", "tiff"]), st.integers(0, 200), st.binary(max_size=40))
def test_a_damaged_file_has_a_positive_time_or_none(kind: str, at: int, noise: bytes) -> None:
    data = file_of(kind, 0.5)
    found = exposure_time_s(data[:at] + noise + data[at + len(noise) :])
    assert found is None or 0 < found < float("inf")
