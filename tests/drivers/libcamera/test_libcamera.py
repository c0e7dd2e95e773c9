"""The backend `libcamera` through picamera2 itself, on a fake module `libcamera`.

None of this has been on a board: what libcamera does is what its documentation says.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fake_libcamera import FakePi, install, uninstall

from camctl.drivers.libcamera import camera as driver
from camctl.drivers.libcamera import requests
from camctl.drivers.libcamera.backend import LibcameraBackend
from camctl.drivers.libcamera.camera import LibcameraCamera, LibcameraOptions
from camctl.errors import (
    CameraBusyError,
    CameraError,
    CameraNotFoundError,
    CameraProtocolError,
    CameraTimeoutError,
    UsageError,
)
from camctl.interface.camera import Camera, Frame
from camctl.interface.controls import ExposureSetting, Layout
from camctl.interface.cycle import CycleMethod
from camctl.testing.conformance import CameraConformance

needs_picamera2 = pytest.mark.skipif(
    find_spec("picamera2") is None, reason="picamera2 is not installed"
)
# picamera2 uses an old name of threading.
pytestmark = [
    pytest.mark.serial,
    pytest.mark.filterwarnings("ignore:.*setDaemon:DeprecationWarning"),
]
Opened = Callable[..., LibcameraCamera]


@pytest.fixture(autouse=True)
def _module(request: pytest.FixtureRequest) -> Iterator[None]:
    yield
    uninstall()


@pytest.fixture
def opened() -> Iterator[Opened]:
    """A function that opens a camera on a board with these properties."""
    cameras: list[LibcameraCamera] = []

    def open_on(board: FakePi, **options: Any) -> LibcameraCamera:
        install(board)
        parsed = LibcameraOptions.parse(options)
        cameras.append(LibcameraCamera("", parsed, clock=board))
        return cameras[-1].open()

    yield open_on
    for each in cameras:
        each.close()


def shot(camera: Camera, *times_s: float) -> list[Any]:
    settings = [ExposureSetting(camera.controls.time_s.nearest(each)) for each in times_s]
    with closing(camera.shoot(settings)) as frames:
        return list(frames)


def light(frame: Any) -> float:
    return float(frame.pixels.mean() - frame.black)


@needs_picamera2
class TestConformance(CameraConformance):
    longest_s = 1.0  # time is virtual, but the sensor's noise takes time
    run_length = 60
    board: FakePi
    ends_s: list[float]

    def open_camera(self) -> Camera:
        self.board = FakePi()
        install(self.board)
        return LibcameraCamera("0", clock=self.board).open()

    def open_second(self, camera: Camera) -> Camera:
        return LibcameraCamera("0", clock=self.board).open()

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.006)

    def silence(self, camera: Camera) -> None:
        self.board.is_silent = True

    def shoot(self, camera: Camera, settings: Sequence[ExposureSetting]) -> list[Frame]:
        frames = super().shoot(camera, settings)
        self.ends_s = [frame.timestamp_s for frame in frames]
        return frames

    def in_force(self, camera: Camera) -> ExposureSetting:
        """Of the last frame that was shot: the camera runs on, and has its setting at rest."""
        return ExposureSetting(*self.board.exposed_until(self.ends_s[-1]))

    @pytest.fixture(autouse=True)
    def _short_silence(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(requests, "SILENCE_S", 1.0)


@needs_picamera2
def test_a_sensor_is_found_with_its_lines_and_gains(opened: Opened) -> None:
    board = FakePi()
    camera = opened(board)
    time, gain = camera.controls.time_s, camera.controls.gain
    assert time.step == pytest.approx(board.line_us / 1e6, rel=2e-5)  # type: ignore[union-attr]
    assert time.minimum == pytest.approx(4 * board.line_us / 1e6, rel=2e-5)
    assert len(gain.between(1, 10, 99)) == 7
    assert gain.minimum == 1
    assert camera.controls.layout is Layout.RGGB
    assert (camera.controls.bits, camera.controls.black) == (12, board.black)
    assert (camera.controls.white, camera.controls.pixel_format) == (4095, "SRGGB12")
    assert LibcameraBackend().discover()[0].model == "imx219"


@needs_picamera2
def test_everything_automatic_is_off_and_the_whole_sensor_is_used(opened: Opened) -> None:
    board = FakePi()
    opened(board)
    found = board.controls
    assert not found["AeEnable"]
    assert not found["AwbEnable"]
    for name in ("NoiseReductionMode", "AfMode", "HdrMode", "AeFlickerMode"):
        assert found[name] == 0, name
    assert found["ScalerCrop"].to_tuple() == (0, 0, 3280, 2464)
    assert found["FrameDurationLimits"] == (board.interval_us, 11_767_556)
    assert (found["ExposureTimeMode"], found["AnalogueGainMode"]) == (1, 1)


@needs_picamera2
@pytest.mark.parametrize(
    ("options", "board", "name"),
    [
        ({"format": "SRGGB12_CSI2P"}, {}, "SRGGB12_CSI2P"),
        ({"format": "SRGGB10_CSI2P"}, {"bits": 10}, "SRGGB10_CSI2P"),
        ({}, {"bits": 10}, "SRGGB10"),
        # The Pi 5 stores samples in 16 bits, or compresses them where it is not asked for 16.
        ({}, {"converts": {"SRGGB12": "SRGGB16"}}, "SRGGB16"),
        ({}, {"converts": {"SRGGB12": "RGGB_PISP_COMP1", "SRGGB16": "SRGGB16"}}, "SRGGB16"),
    ],
)
def test_all_formats_have_the_same_samples(
    opened: Opened, options: dict[str, Any], board: dict[str, Any], name: str
) -> None:
    bits = board.get("bits", 12)
    boards = FakePi(bits=bits), FakePi(**board)
    frames = []
    for each, chosen in zip(boards, ({}, options), strict=True):
        camera = opened(each, **chosen)
        frames.append(shot(camera, 0.006, 0.001))
        formats = camera.controls.pixel_format
        assert camera.controls.bits == bits
        camera.close()
        uninstall()
    assert formats == name
    for one, other in zip(*frames, strict=True):
        assert light(one) == pytest.approx(light(other), rel=0.02)
        assert int(other.pixels.max()) < 2**bits


@needs_picamera2
@pytest.mark.parametrize("delay", [0, 1, 3, 6])
@pytest.mark.parametrize("loses_a_frame", [False, True])
def test_frames_are_their_own_whenever_settings_take_effect(
    opened: Opened, delay: int, *, loses_a_frame: bool
) -> None:
    board = FakePi(delay=delay)
    camera = opened(board)
    board.lost = (board.frame + 9,) if loses_a_frame else ()
    times_s, began = (0.006, 0.001, 0.003, 0.0005) * 2, board.frame
    frames = shot(camera, *times_s)
    for frame, time_s in zip(frames, times_s, strict=True):
        assert frame.applied.time_s == pytest.approx(time_s, rel=0.04)
        assert light(frame) / light(frames[0]) == pytest.approx(
            frame.applied.time_s / frames[0].applied.time_s, rel=0.03
        )
    if not loses_a_frame:  # the requests that wait in the camera, and those of its delay
        assert board.frame - began <= len(times_s) + 2 * 6 + delay


@needs_picamera2
def test_lost_frames_and_lost_settings_are_sent_again(opened: Opened) -> None:
    board = FakePi()
    camera = opened(board)
    board.lost = tuple(range(board.frame + 8, board.frame + 200, 5))
    board.ignored = tuple(range(board.request, board.request + 300, 7))
    times_s = (0.006, 0.001, 0.003, 0.006, 0.0005, 0.004)
    frames = shot(camera, *times_s)
    for frame, time_s in zip(frames, times_s, strict=True):
        assert frame.applied.time_s == pytest.approx(time_s, rel=0.04)
        assert light(frame) / light(frames[0]) == pytest.approx(
            frame.applied.time_s / frames[0].applied.time_s, rel=0.03
        )


@needs_picamera2
def test_a_sensor_that_does_not_follow_is_an_error(opened: Opened) -> None:
    board = FakePi()
    camera = opened(board)
    board.ignored = range(10**6)  # type: ignore[assignment]
    with pytest.raises(CameraProtocolError):
        shot(camera, 0.001, 0.002)
    board.ignored = ()
    assert len(shot(camera, 0.001, 0.002)) == 2


@needs_picamera2
def test_a_board_that_changes_nothing_is_not_opened(opened: Opened) -> None:
    with pytest.raises(CameraProtocolError):
        opened(FakePi(ignored=range(10**6)))  # type: ignore[arg-type]


@needs_picamera2
def test_a_silent_board_is_not_opened(opened: Opened, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "SILENCE_S", 0.3)
    with pytest.raises(CameraTimeoutError):
        opened(FakePi(is_silent=True))


@needs_picamera2
@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"format": "MJPEG"}, UsageError),
        ({"format": "SGRBG12"}, UsageError),  # not the order of this sensor
        ({"size": "640x480"}, UsageError),
    ],
)
def test_what_the_sensor_has_not_is_a_usage_error(
    opened: Opened, options: dict[str, str], kind: type[Exception]
) -> None:
    with pytest.raises(kind) as error:
        opened(FakePi(), **options)
    assert "\n" not in str(error.value)


@needs_picamera2
def test_addresses() -> None:
    board = FakePi()
    install(board)
    for address in ("", "0", "/base/soc/i2c0mux/i2c@1/imx219@10"):
        with LibcameraCamera(address, clock=board) as camera:
            assert camera.info.id == "libcamera:/base/soc/i2c0mux/i2c@1/imx219@10"
            with pytest.raises(CameraBusyError):
                LibcameraCamera("0", clock=board).open()
    with pytest.raises(CameraNotFoundError):
        LibcameraCamera("1", clock=board).open()


@needs_picamera2
def test_a_camera_that_cannot_be_opened_leaves_no_pipe_open(opened: Opened) -> None:
    board = FakePi()
    opened(board)

    def pipes() -> set[str]:
        found = set()
        for each in Path("/proc/self/fd").iterdir():
            with contextlib.suppress(FileNotFoundError):  # other threads close files
                found.add(str(each.readlink()))
        return {each for each in found if each.startswith("pipe:")}

    before = pipes()
    with pytest.raises(CameraBusyError):
        LibcameraCamera("0", clock=board).open()
    assert pipes() == before


def test_without_picamera2_there_are_no_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(driver, "find_spec", lambda _: None)
    assert LibcameraBackend().discover() == []
    with pytest.raises(CameraError) as error:
        LibcameraBackend().open("0", {})
    assert "picamera2" in str(error.value)


def test_options_are_checked() -> None:
    with pytest.raises(UsageError):
        LibcameraBackend().open("0", {"colour": "red"})


@needs_picamera2
def test_pixels_are_those_of_the_sensor(opened: Opened) -> None:
    board = FakePi()
    camera = opened(board)
    (frame,) = shot(camera, 0.006)
    time_s, gain = board.in_force()
    same = [board.seen.expose(time_s, gain, number) for number in range(board.frame)]
    assert any(np.array_equal(frame.pixels, each) for each in same)


@needs_picamera2
@pytest.mark.parametrize(
    "board",
    [
        *({"delay": delay} for delay in (0, 1, 3, 6)),
        {"lost": (230, 231, 250)},
        {"ignored": (240, 255)},
        {"states_late": True},
    ],
    ids=str,
)
def test_frames_of_a_cycle_have_the_exposures_that_they_state(
    opened: Opened, board: dict[str, Any]
) -> None:
    """Those of metadata that state another frame's, too: there each setting is waited for."""
    states_late = board.pop("states_late", False)
    pi = FakePi(**board)
    camera = opened(pi)
    pi.states_late = states_late
    times_s = [camera.controls.time_s.nearest(each) for each in (0.001, 0.002, 0.004)]
    settings = [ExposureSetting(each) for each in times_s]
    expected = shot(camera, times_s[1])[0] if not states_late else None
    with closing(camera.cycle(settings)) as cycle:
        frames = [next(cycle) for _ in range(30)]
        begun = pi.frame
        later = [next(cycle) for _ in range(9)]
        used = pi.frame - begun
        plan = cycle.exchange(settings[:2])
        frames += [*later, *(next(cycle) for _ in range(12))]
    rates = [light(frame) / frame.applied.time_s for frame in frames]
    assert rates == pytest.approx([np.median(rates)] * len(rates), rel=0.02)
    if expected is not None:
        assert np.median(rates) == pytest.approx(light(expected) / times_s[1], rel=0.02)
    for frame in frames:
        assert frame.requested.time_s == pytest.approx(frame.applied.time_s, rel=1e-6)
        assert frame.place is not None
    numbers = [frame.place.number for frame in frames if frame.place is not None]
    assert numbers == sorted(set(numbers))
    assert {frame.index for frame in frames[-6:]} == {0, 1}
    assert frames[-1].place is not None
    assert frames[-1].place.plan == plan
    # All frames are used once the metadata are believed; else some pass at each setting.
    assert used > 2 * len(later) if states_late else used <= len(later) + 6


@needs_picamera2
def test_a_cycle_ends_and_the_camera_shoots_again(opened: Opened) -> None:
    camera = opened(FakePi())
    with closing(camera.cycle([ExposureSetting(camera.controls.time_s.nearest(0.002))])) as cycle:
        assert cycle.method is CycleMethod.REQUEST
        next(cycle)
        with pytest.raises(CameraError):
            list(camera.shoot([]))
    assert len(shot(camera, 0.001, 0.004)) == 2
