"""Virtual cameras of several makes in the network, through libgphoto2."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from network_bench import camera_on_tcp

import camctl
from camctl.drivers.gphoto2.process import FullError
from camctl.errors import CameraError, CameraNotFoundError
from camctl.interface.camera import Camera
from camctl.interface.controls import ExposureSetting
from camctl.sim.devices.ptp.network import NetworkCamera as VirtualCamera

#: From one end of the dial to the other, which libgphoto2 does in steps on a Sony.
TIMES_S = (1 / 8000, 1 / 8, 1 / 1000)


@pytest.fixture(autouse=True)
def _without_the_virtual_port(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("VCAMERADIR", raising=False)
    monkeypatch.setenv("CAMCTL_PROFILES", str(tmp_path))


@contextmanager
def virtual_camera(vendor: str) -> Iterator[tuple[VirtualCamera, str]]:
    """Yield a virtual camera in the network, and its id with the backend `ptpip`."""
    with camera_on_tcp(vendor=vendor, files="dng", repeat_noise=True) as (device, port):
        yield device, f"ptpip:127.0.0.1:{port}"


def opened(address: str) -> Camera:
    """Return the camera through libgphoto2."""
    return camctl.open_camera(f"gphoto2:{address}", format="raw")


@pytest.mark.parametrize(
    "vendor", ["nikon", *(pytest.param(each, marks=pytest.mark.slow) for each in ("canon", "sony"))]
)
def test_frames_are_those_of_ptpip_bit_for_bit(vendor: str) -> None:
    with virtual_camera(vendor) as (_, address):
        with opened(address) as camera:
            dial = camera.controls.time_s
            settings = [ExposureSetting(dial.nearest(time_s)) for time_s in TIMES_S]
            frames = list(camera.shoot(settings))
        with camctl.open_camera(address, format="raw") as camera:
            others = list(camera.shoot(settings))
    assert [frame.applied for frame in frames] == [other.applied for other in others]
    assert all(
        np.array_equal(frame.pixels, other.pixels)
        for frame, other in zip(frames, others, strict=True)
    )


@pytest.mark.parametrize("vendor", ["nikon", "canon", "sony"])
def test_a_mode_dial_that_forbids_manual_exposure(vendor: str) -> None:
    with virtual_camera(vendor) as (device, address):
        device.do("mode", dial="auto")
        with pytest.raises(CameraError) as error:
            opened(address)
    assert "turn the mode dial to M" in error.value.hint


@pytest.mark.parametrize(
    ("vendor", "state", "message"),
    [
        ("nikon", "playback", "does not accept a setting .*leave playback, menus and"),
        ("canon", "lens", "has its lens covered or not in working position .*lens cap off"),
        *(
            pytest.param(*each, marks=pytest.mark.slow)
            for each in (
                ("nikon", "no card", "has no card .*put a card in"),
                ("nikon", "lens", "has its lens covered or not in working position"),
                ("canon", "movie", "cannot do that in its present mode .*movie mode on the camera"),
                ("canon", "no card", "has no card .*put a card in"),
                ("canon", "retracted lens", "general error.*lens on manual focus"),
            )
        ),
    ],
)
def test_the_reason_that_libgphoto2_gives_says_what_to_do(
    vendor: str, state: str, message: str
) -> None:
    with virtual_camera(vendor) as (device, address), opened(address) as camera:
        settings = [ExposureSetting(camera.controls.time_s.nearest(1 / 125))]
        device.do("body_state", state=state)
        with pytest.raises(CameraError, match=f"(?i){message}") as error:
            list(camera.shoot(settings))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("vendor", ["nikon", "canon"])
def test_a_full_card(vendor: str) -> None:
    with virtual_camera(vendor) as (device, address), opened(address) as camera:
        settings = [ExposureSetting(camera.controls.time_s.nearest(1 / 125))]
        device.do("card_full")
        with pytest.raises(
            FullError, match=r"no memory left .*delete pictures, or change its card"
        ):
            list(camera.shoot(settings))


@pytest.mark.parametrize(
    "vendor", ["nikon", *(pytest.param(each, marks=pytest.mark.slow) for each in ("canon", "sony"))]
)
def test_an_empty_battery_is_the_reason_where_none_is_given(vendor: str) -> None:
    with virtual_camera(vendor) as (device, address):
        device.do("battery_low")  # before opening: libgphoto2 keeps for 2 s what it has read
        with opened(address) as camera, pytest.raises(CameraError) as error:
            camera.controls  # noqa: B018  # a picture is taken to learn the format
    assert "failed to capture" in error.value.what
    assert error.value.what.endswith("its battery has 3 % of its charge")
    assert error.value.hint == "charge it or use a mains adapter"


@pytest.mark.parametrize("host", ["127.0.0.1:9", "nowhere.invalid"])
def test_a_camera_that_is_not_there(host: str) -> None:
    with pytest.raises(CameraNotFoundError, match=r"not to be reached in the network.*check the"):
        opened(f"ptpip:{host}")


def test_a_camera_that_another_program_uses() -> None:
    with (
        virtual_camera("nikon") as (_, address),
        camctl.open_camera(address, format="raw"),
        pytest.raises(CameraNotFoundError, match=r"refuses this computer.*end other programs"),
    ):
        opened(address)
