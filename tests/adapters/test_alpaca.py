"""The Alpaca camera server, judged by alpyca, the client of the ASCOM initiative."""

from __future__ import annotations

import json
import time
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import camctl
from camctl.adapters.alpaca import AlpacaServer

if TYPE_CHECKING:
    from alpaca.camera import Camera

pytestmark = pytest.mark.skipif(find_spec("alpaca") is None, reason="alpyca is not installed")

GIVEN = camctl.CaptureRequest(ratios=(1, 4, 16), dynamic_range=256)


@contextmanager
def server(**options: Any) -> Iterator[AlpacaServer]:
    chosen = {"scene": "ramp", "size": "64x48", **options}
    with camctl.open_camera("sim", chosen) as camera:
        made = AlpacaServer(camera, GIVEN, "0")
        try:
            yield made
        finally:
            made.close()


def client(served: AlpacaServer) -> Camera:
    from alpaca.camera import Camera

    camera = Camera(f"127.0.0.1:{served.site.served_port}", 0)
    camera.Connected = True
    return camera


def wait(camera: Camera) -> None:
    until = time.monotonic() + 30
    while not camera.ImageReady:
        assert time.monotonic() < until
        time.sleep(0.01)


def ask(served: AlpacaServer, path: str, body: str | None = None) -> tuple[int, str]:
    url = f"{served.site.url}{path}"
    data = None if body is None else body.encode()
    request = urllib.request.Request(url, data, method="GET" if body is None else "PUT")
    try:
        with urllib.request.urlopen(request, timeout=10) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def raises(name: str, do: Callable[[], Any]) -> None:
    """Check that a client sees an error of ASCOM, in one line."""
    from alpaca import exceptions

    with pytest.raises(getattr(exceptions, name)) as caught:
        do()
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(("sensor", "rank"), [("standard", 2), ("webcam", 3)])
def test_a_client_takes_a_picture_of_the_light(sensor: str, rank: int) -> None:
    with server(sensor=sensor) as served:
        camera = client(served)
        camera.StartExposure(0.002, True)
        wait(camera)
        # ImageArray of alpyca 3.1.3 repeats the first column of pictures in colour.
        picture = np.array(camera.ImageArrayRaw)
        info = camera.ImageArrayInfo
        picture = picture.reshape(info.Dimension1, info.Dimension2, *[info.Dimension3][: rank - 2])
        assert picture.shape == (64, 48, 3)[:rank]
        if rank == 2:
            np.testing.assert_array_equal(camera.ImageArray, picture)
        assert camera.LastExposureDuration == pytest.approx(0.002, rel=0.01)
        assert camera.SensorType == rank - 2
        assert (camera.CameraXSize, camera.CameraYSize, camera.MaxADU) == (64, 48, 65535)
        whole = camera.LastExposureDuration
        # The same as numbers in JSON.
        path = f"api/v1/camera/0/imagearray?clientid={camera._client_id}"
        values = json.loads(ask(served, path)[1])
        assert values["Type"] == 2
        assert values["Rank"] == rank
        np.testing.assert_array_equal(values["Value"], picture)
    with camctl.open_camera("sim", scene="ramp", size="64x48", sensor=sensor) as other:
        report = camctl.capture(other, replace(GIVEN, base_s=whole))
    light = report.radiance() * report.irradiance.full_scale_exposure * 65535
    found = np.swapaxes(picture, 0, 1)
    sd = report.standard_deviation() * report.irradiance.full_scale_exposure * 65535
    known = np.isfinite(sd) & (report.mask() == 0)
    # Another picture of the same light, rounded to whole numbers.
    score = (found - light)[known] / np.hypot(sd[known], 0.5)
    assert np.sqrt(np.mean(score**2)) < 2


def test_a_window_is_cut_from_the_picture() -> None:
    with server() as served:
        camera = client(served)
        camera.StartX, camera.StartY, camera.NumX, camera.NumY = 10, 5, 20, 8
        camera.StartExposure(0.002, True)
        wait(camera)
        assert np.array(camera.ImageArray).shape == (20, 8)
        camera.NumX = 60
        raises("InvalidValueException", lambda: camera.StartExposure(0.002, True))


def test_what_a_camera_does_not_have_is_not_implemented() -> None:
    with server() as served:
        camera = client(served)
        for name in ("Gain", "CCDTemperature", "PixelSizeX", "CoolerOn", "ElectronsPerADU"):
            raises("NotImplementedException", lambda name=name: getattr(camera, name))  # type: ignore[misc]
        raises("ActionNotImplementedException", lambda: camera.Action("none"))
        raises("InvalidValueException", lambda: setattr(camera, "BinX", 2))
        names = {each["Name"] for each in camera.DeviceState}
        assert names == {"CameraState", "ImageReady", "PercentCompleted", "TimeStamp"}


@pytest.mark.parametrize("duration", [-1.0, 0.0, 1e9, float("nan"), float("inf")])
def test_a_duration_out_of_range_is_an_invalid_value(duration: float) -> None:
    with server() as served:
        camera = client(served)
        raises("InvalidValueException", lambda: camera.StartExposure(duration, True))
        raises("InvalidOperationException", lambda: camera.ImageArray)
        camera.StartExposure(camera.ExposureMin, True)
        wait(camera)
        camera.StartExposure(camera.ExposureMax, True)
        wait(camera)


def test_a_second_client_waits_and_an_abort_ends_an_exposure() -> None:
    from alpaca.camera import CameraStates

    with server(time="real") as served:
        first = client(served)
        first.StartExposure(first.ExposureMax, True)
        answer = ask(
            served, "api/v1/camera/0/startexposure", "ClientID=77&Duration=0.01&Light=true"
        )
        assert json.loads(answer[1])["ErrorNumber"] == 0x407
        ask(served, "api/v1/camera/0/connected", "ClientID=77&Connected=True")
        answer = ask(
            served, "api/v1/camera/0/startexposure", "ClientID=77&Duration=0.01&Light=true"
        )
        assert json.loads(answer[1])["ErrorNumber"] == 0x40B
        assert first.CameraState == CameraStates.cameraExposing
        first.AbortExposure()
        assert first.CameraState == CameraStates.cameraIdle
        assert not first.ImageReady
        first.StartExposure(0.002, True)
        wait(first)
        first.Connected = False
        raises("NotConnectedException", lambda: first.ImageReady)


def test_a_camera_unplugged_in_an_exposure_is_an_error_and_the_next_opens_it_again() -> None:
    with server(faults="unplug@2") as served:
        camera = client(served)
        camera.StartExposure(0.002, True)
        raises("DriverException", lambda: wait(camera))
        camera.StartExposure(0.002, True)
        wait(camera)


def test_the_server_is_found_and_says_what_it_is() -> None:
    from alpaca import discovery, management

    with server() as served:
        address = f"127.0.0.1:{served.site.served_port}"
        found = (discovery.search_ipv4(numquery=1, timeout=0.2) for _ in range(20))
        assert any(address in each for each in found)  # answers may come late
        assert management.apiversions(address) == [1]
        assert management.description(address)["ServerName"] == "camctl"
        (device,) = management.configureddevices(address)
        assert (device["DeviceType"], device["DeviceNumber"]) == ("Camera", 0)
        assert ask(served, "setup/v1/camera/0/setup")[0] == 200


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("api/v1/camera/1/name", None),
        ("api/v1/camera/0/nosuch", None),
        ("api/v1/camera/0/connected", "Connected=perhaps"),
        ("api/v1/camera/0/connected", "connected=true"),
        ("api/v1/camera/0/connected?ClientID=-1", None),
        ("api/v1/camera/0/startexposure", "Duration=&Light=true"),
        ("management/v2/description", None),
        ("nothing", None),
        ("api/v1/camera/0/startexposure", "x" * 100_000),
    ],
)
def test_requests_that_are_not_of_the_protocol_are_refused(path: str, body: str | None) -> None:
    with server() as served:
        ask(served, "api/v1/camera/0/connected", "Connected=true")
        status, text = ask(served, path, body)
        assert (status, len(text.splitlines())) == (400, 1)


def test_other_sites_cannot_ask() -> None:
    with server() as served:
        request = urllib.request.Request(f"{served.site.url}management/apiversions")
        request.add_header("Host", "example.org")
        with pytest.raises(urllib.error.HTTPError) as caught, urllib.request.urlopen(request):
            pass
        assert caught.value.code == 403
        caught.value.close()
