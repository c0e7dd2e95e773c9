"""The road to the simulated camera, as the command line takes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from camctl.backends import look_for_cameras, open_camera
from camctl.clock import RealClock, VirtualClock
from camctl.controls import ExposureSetting, Layout
from camctl.errors import CamctlError, CameraNotFoundError, DataError, UsageError
from sim.backend import SimulatedBackend, SimulatedOptions


def test_it_is_found_through_its_entry_point() -> None:
    cameras = [camera for look in look_for_cameras() for camera in look.cameras]
    assert "sim" in [camera.id for camera in cameras]
    with open_camera("sim") as camera:
        assert camera.info.id == "sim"
        assert camera.info in cameras


def test_defaults_are_the_tile_floor_and_the_standard_sensor() -> None:
    with SimulatedBackend().open("", {}) as camera:
        assert (camera.scene.name, camera.sensor.name) == ("tile-floor", "standard")
        assert camera.controls.shape == camera.sensor.shape
        assert isinstance(camera.clock, VirtualClock)


def test_options() -> None:
    options = {
        "scene": "room",
        "sensor": "phone",
        "seed": "7",
        "size": "64x48",
        "time": "real",
    }
    with SimulatedBackend().open("", options) as camera:
        assert camera.controls.shape == (48, 64)
        assert camera.controls.layout is Layout.RGGB
        assert isinstance(camera.clock, RealClock)


def test_the_tolerance_is_what_a_shot_may_lose() -> None:
    for text, allowed in (("0.4", 0.2), ("0", 0.0)):
        words = {"sensor": "complete", "size": "64x48", "tolerance": text}
        with SimulatedBackend().open("", words) as camera:
            for _ in camera.shoot([ExposureSetting(0.001), ExposureSetting(0.01)]):
                assert camera.last_plan is not None
                assert camera.last_plan.tolerance_dn == allowed


def test_the_seed_is_the_seed() -> None:
    def picture(seed: str) -> np.ndarray:
        with SimulatedBackend().open("", {"size": "32x24", "seed": seed}) as camera:
            return next(
                camera.shoot([ExposureSetting(camera.controls.time_s.nearest(0.01))])
            ).pixels

    assert np.array_equal(picture("1"), picture("1"))
    assert not np.array_equal(picture("1"), picture("2"))


def test_a_map_gives_the_frame_its_size(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.ones((11, 13)))
    with SimulatedBackend().open("", {"scene": str(tmp_path / "map.npy")}) as camera:
        assert camera.controls.shape == (11, 13)


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"scence": "room"}, UsageError, "did you mean scene"),
        ({"scene": "rooom"}, UsageError, "did you mean room"),
        ({"sensor": "fone"}, UsageError, "did you mean phone"),
        ({"time": "fast"}, UsageError, "known: real, virtual"),
        ({"size": "640"}, UsageError, "WIDTHxHEIGHT"),
        ({"size": "0x5"}, UsageError, "WIDTHxHEIGHT"),
        ({"size": "999999x999999"}, DataError, "GiB"),
        ({"seed": "-1"}, UsageError, "seed"),
        ({"seed": "x"}, UsageError, "seed"),
        ({"tolerance": "-1"}, UsageError, "0 DN or more"),
        ({"tolerance": "nan"}, UsageError, "0 DN or more"),
        ({"tolerance": "x"}, UsageError, "a tolerance of 'x'"),
        ({"scene": "no-such.hdr"}, DataError, "no such file"),
        ({"sensor": "no-such.json"}, DataError, "no such file"),
    ],
)
def test_bad_options_are_one_line(
    options: dict[str, str], kind: type[CamctlError], message: str
) -> None:
    with pytest.raises(kind, match=message) as error:
        SimulatedBackend().open("", options)
    assert "\n" not in str(error.value)


def test_an_address_is_refused() -> None:
    with pytest.raises(CameraNotFoundError, match="its id is sim"):
        open_camera("sim:3")


def test_sizes() -> None:
    assert parse_size("640x480") == (480, 640)
    assert parse_size(" 12 X 7 ") == (7, 12)
