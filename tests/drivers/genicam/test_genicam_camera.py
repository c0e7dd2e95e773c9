"""GenICam cameras: a virtual GigE Vision camera behind two foreign libraries."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
from gige_bench import BLACK, exposed, found, installed, opened, settings, virtual_camera

from camctl.calibration.delay import measure_delay
from camctl.drivers.genicam import GenicamCamera, GenicamOptions
from camctl.drivers.genicam.port import Library
from camctl.errors import (
    CameraBusyError,
    CameraClosedError,
    CameraError,
    UsageError,
)
from camctl.interface.camera import Frame, MeasuredDelay
from camctl.interface.controls import ExposureSetting, Layout, Steps
from camctl.interface.cycle import CycleMethod
from camctl.sim.devices.gige.camera import GigeCamera

TIMES_S = (0.004, 0.001, 0.008, 0.002)
#: A free run has frames at its own times, for which a busy computer is too late.
WAYS = ["software", pytest.param("off", marks=pytest.mark.serial)]


@pytest.fixture(params=["aravis", "viva"])
def library(request: pytest.FixtureRequest) -> Library:
    return installed(request.param)


@pytest.fixture
def aravis() -> Library:
    return installed("aravis")


@pytest.fixture
def device() -> Iterator[GigeCamera]:
    with virtual_camera() as device:
        yield device


def shot(camera: GenicamCamera, wanted: list[ExposureSetting]) -> list[Frame]:
    with closing(camera.shoot(wanted)) as frames:
        return list(frames)


def check(device: GigeCamera, frames: list[Frame], wanted: list[ExposureSetting]) -> None:
    """Check by the virtual camera's own record that each frame has the exposure it states."""
    assert [frame.requested for frame in frames] == wanted
    true_s = [exposed(device, frame.details["frame_id"]) for frame in frames]
    assert [frame.applied.time_s for frame in frames] == pytest.approx(true_s, rel=1e-6)


def test_each_frame_has_its_exposure(library: Library, device: GigeCamera) -> None:
    with opened(device, library) as camera:
        wanted = settings(camera, *TIMES_S)
        frames = shot(camera, wanted)
        check(device, frames, wanted)
        assert [frame.applied for frame in frames] == wanted
        controls = camera.controls
        assert (controls.layout, controls.bits, controls.shape) == (Layout.MONO, 12, (48, 64))
        assert camera.mode == "mono12p-64x48-software"
        assert camera.info.serial == device.config.serial
        light = [float(frame.pixels.mean() - BLACK) / frame.applied.time_s for frame in frames]
        assert light == pytest.approx([light[0]] * 4, rel=0.03)
        stated_us = [frame.details["chunks"]["ExposureTime"] for frame in frames]
        assert stated_us == pytest.approx([time_s * 1e6 for time_s in TIMES_S])
    assert device.state()["has_controller"] is False


@pytest.mark.parametrize(("delay", "frames"), [(0, 1), (1, 2)])
def test_frames_that_state_their_exposure_end_the_wait(
    aravis: Library, delay: int, frames: int
) -> None:
    with virtual_camera(delay=delay) as device, opened(device, aravis) as camera:
        assert camera.controls.delay_frames is None
        shot(camera, settings(camera, *(0.003, 0.001) * 3))  # the pixels agree with what is stated
        before = device.do("log")["frames"][-1]["slot"]
        wanted = settings(camera, *TIMES_S)
        check(device, shot(camera, wanted), wanted)
        assert device.do("log")["frames"][-1]["slot"] - before == frames * len(wanted)


def test_what_changes_pictures_is_turned_off(library: Library, device: GigeCamera) -> None:
    with opened(device, library) as camera:
        assert any("automatic exposure" in each for each in camera.controls.notes)
        assert camera.device.read("ExposureAuto") == "Off"
        assert camera.device.read("GammaEnable") is False
        assert not camera.controls.has_assumed_response


def test_times_have_the_steps_to_which_the_camera_rounds(library: Library) -> None:
    with (
        virtual_camera(time_step_us=14.25) as device,
        opened(device, library) as camera,
    ):
        times = camera.controls.time_s
        assert isinstance(times, Steps)
        assert times.step == pytest.approx(14.25e-6, rel=1e-6)
        wanted = settings(camera, 0.0031, 0.0013)
        assert [each.applied for each in shot(camera, wanted)] == wanted


def test_gain_multiplies_the_light(library: Library, device: GigeCamera) -> None:
    with opened(device, library) as camera:
        plain, more = settings(camera, 0.002)[0], settings(camera, 0.002, gain=2.0)[0]
        assert more.gain == pytest.approx(2.0, rel=0.01)
        first, second = shot(camera, [plain, more])
        ratio = (second.pixels.mean() - BLACK) / (first.pixels.mean() - BLACK)
        assert ratio == pytest.approx(more.gain, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("trigger", WAYS)
@pytest.mark.parametrize("delay", [-1, 0, 2])
def test_delay_is_measured_and_then_costs_n_plus_d_frames(
    aravis: Library, trigger: str, delay: int
) -> None:
    with (
        virtual_camera(delay=delay) as device,
        opened(device, aravis, trigger=trigger, fps="30") as camera,
    ):
        wanted = settings(camera, *TIMES_S, 0.006, 0.003)
        camera.use_delay(None)
        # What is exposed after a trigger was set before it: there is no running frame then.
        expected = max(delay, 0) if trigger == "software" else delay
        record = measure_delay(camera, trials=2)
        assert record.frames == expected
        before = len(device.do("log")["frames"])
        frames = shot(camera, wanted)
        check(device, frames, wanted)
        if trigger == "software":
            assert len(device.do("log")["frames"]) - before == len(wanted) + expected


@pytest.mark.slow
@pytest.mark.parametrize("trigger", WAYS)
@pytest.mark.parametrize(("delay", "gain"), [(0, 2), (2, 0), (-1, 3), (5, -1)])
def test_delays_of_time_and_gain_are_used_apart(
    aravis: Library, trigger: str, delay: int, gain: int
) -> None:
    """What is true of each frame is known from the virtual camera; chunks are off."""
    with (
        virtual_camera(delay=delay, gain_delay=gain, has_chunks=False) as device,
        opened(device, aravis, trigger=trigger, fps="30") as camera,
    ):
        record = measure_delay(camera, trials=4)
        least = 0 if trigger == "software" else -1
        assert record.time == (max(delay, least),) * 2
        assert record.gain == (max(gain, least),) * 2
        plans = [(0.004, 1), (0.002, 1)], [(0.001, 4), (0.001, 2)], [(0.004, 1), (0.001, 4)]
        for plan in plans:
            wanted = [settings(camera, time_s, gain=more)[0] for time_s, more in plan]
            frames = shot(camera, wanted)
            check(device, frames, wanted)
            log = {each["block"]: each["gain"] for each in device.do("log")["frames"]}
            true = [log[frame.details["frame_id"]] for frame in frames]
            assert [frame.applied.gain for frame in frames] == pytest.approx(true, rel=1e-6)


def test_late_chunks_are_not_believed(aravis: Library) -> None:
    with virtual_camera(chunk_delay=1) as device, opened(device, aravis) as camera:
        camera.use_delay(MeasuredDelay(0, 0))
        wanted = settings(camera, *TIMES_S)
        frames = shot(camera, wanted)
        check(device, frames, wanted)
        camera.use_delay(None)  # and frames of two exposures come several times
        for _ in range(3):
            check(device, shot(camera, wanted), wanted)


def test_frame_whose_delay_is_wrong_is_said_to_have_its_own_exposure(aravis: Library) -> None:
    with virtual_camera(delay=1) as device, opened(device, aravis) as camera:
        shot(camera, settings(camera, 0.002, 0.004))  # the pixels agree with what is stated
        camera.use_delay(MeasuredDelay(0, 0))
        frames = shot(camera, settings(camera, 0.004, 0.001, 0.008, 0.002))
        true_s = [exposed(device, frame.details["frame_id"]) for frame in frames]
        assert [frame.applied.time_s for frame in frames] == pytest.approx(true_s)
        assert true_s == pytest.approx([0.004, 0.004, 0.001, 0.008])


def test_conflict_in_the_dark_is_decided_by_the_measured_delay(aravis: Library) -> None:
    with virtual_camera(chunk_delay=1) as device:
        device.do("light", factor=0.0)
        with opened(device, aravis) as camera:
            camera.use_delay(MeasuredDelay(0, 0))
            wanted = settings(camera, 0.004, 0.001)
            frames = shot(camera, wanted)
            check(device, frames, wanted)


def test_lost_packets_are_sent_again_and_counted(library: Library) -> None:
    with virtual_camera() as device, opened(device, library) as camera:
        device.do("lose", frames=3)
        wanted = settings(camera, *TIMES_S)
        frames = shot(camera, wanted)
        check(device, frames, wanted)
        assert frames[-1].details["packets"]["resent"] >= 1
        assert device.state()["lost_packets"] == 3


def test_frame_without_all_its_packets_is_taken_again(library: Library) -> None:
    with virtual_camera(resend=False) as device, opened(device, library) as camera:
        camera.use_delay(MeasuredDelay(0, 0))
        device.do("lose", frames=2)
        wanted = settings(camera, *TIMES_S)
        check(device, shot(camera, wanted), wanted)


def test_frames_that_nobody_takes_yet_are_kept(library: Library) -> None:
    with (
        virtual_camera(has_trigger=False, fps=20) as device,
        opened(device, library, fps="20") as camera,
    ):
        camera.device.stop()
        camera.device.start(8)
        time.sleep(0.4)
        newest = device.do("log")["frames"][-1]["block"]
        frames = [camera.device.receive(1.0) for _ in range(5)]
        numbers = [frame.number for frame in frames if frame is not None]
        assert numbers == list(range(numbers[0], numbers[0] + 5))
        assert numbers[0] <= newest - 4


@pytest.mark.parametrize("lead", [0, 2])
@pytest.mark.parametrize("trigger", WAYS)
def test_uploaded_cycle_takes_one_frame_for_each_setting(
    library: Library, trigger: str, lead: int
) -> None:
    with (
        # At 100 frames a second a busy computer is too late for some: the cycle is then the next.
        virtual_camera(lead=lead, fps=20) as device,
        opened(device, library, sequencer="on", trigger=trigger, fps="15") as camera,
    ):
        wanted = settings(camera, *TIMES_S)
        before = device.do("log")["frames"][-1]["slot"]
        frames = shot(camera, wanted)
        numbers = [frame.details["frame_id"] for frame in frames]
        assert numbers == [lead + 1, lead + 2, lead + 3, lead + 4]
        run = [each for each in device.do("log")["frames"] if each["slot"] > before]
        cycle = [each["time_s"] for each in run if each["block"] in numbers][:4]
        if trigger == "software":  # in free run the frames after the cycle have the same numbers
            assert cycle == pytest.approx(TIMES_S)
        light = [float(frame.pixels.mean() - BLACK) / frame.applied.time_s for frame in frames]
        assert light == pytest.approx([light[0]] * 4, rel=0.03)
        # And afterwards the camera takes single frames as before.
        (again,) = shot(camera, wanted[:1])
        assert again.applied == wanted[0]


def test_camera_repeats_an_uploaded_cycle(aravis: Library) -> None:
    with (
        virtual_camera(lead=1, fps=100) as device,
        opened(device, aravis, sequencer="on") as camera,
    ):
        first, second = settings(camera, *TIMES_S), settings(camera, 0.002, 0.006)
        cycle = camera.cycle(first)
        frames = [next(cycle) for _ in range(6)]
        assert cycle.exchange(second) == 1
        frames += [next(cycle) for _ in range(6)]
        cycle.close()
        assert cycle.method is CycleMethod.SEQUENCER
        assert [frame.applied for frame in frames] == [*first, *first, *second, *second]
        assert [frame.place.plan for frame in frames if frame.place] == [0] * 8 + [1] * 4
        light = [float(frame.pixels.mean() - BLACK) / frame.applied.time_s for frame in frames]
        assert light == pytest.approx([light[0]] * 12, rel=0.03)
        with pytest.raises(UsageError):
            camera.cycle([])
        (again,) = shot(camera, first[:1])
        assert again.applied == first[0]


def test_a_camera_that_its_owner_closed_ends_its_uploaded_cycle(aravis: Library) -> None:
    with virtual_camera(fps=100) as device, opened(device, aravis, sequencer="on") as camera:
        cycle = camera.cycle(settings(camera, *TIMES_S))
        next(cycle)
        camera.close()
        with pytest.raises(CameraClosedError):
            next(cycle)
        cycle.close()
        (frame,) = shot(camera.open(), settings(camera, 0.004))
        assert frame.applied.time_s == pytest.approx(0.004)


@pytest.mark.parametrize(("chunk_delay", "is_used"), [(0, True), (1, False)])
@pytest.mark.parametrize("trigger", WAYS)
def test_a_cycle_uses_what_frames_state_once_the_pixels_agree(
    aravis: Library, trigger: str, chunk_delay: int, is_used: bool
) -> None:
    with (
        virtual_camera(delay=1, chunk_delay=chunk_delay) as device,
        opened(device, aravis, trigger=trigger, fps="15") as camera,
    ):
        cycle = camera.cycle(settings(camera, *TIMES_S))
        frames = [next(cycle) for _ in range(40)]
        true_s = [exposed(device, frame.details["frame_id"]) for frame in frames]
        cycle.close()
    assert [frame.applied.time_s for frame in frames] == pytest.approx(true_s, rel=1e-6)
    assert cycle._cycle.is_stated == is_used  # type: ignore[attr-defined]


def test_uploaded_cycle_whose_begin_is_not_seen_is_refused(aravis: Library) -> None:
    with virtual_camera() as device:
        device.do("light", factor=0.0)
        with opened(device, aravis, sequencer="on") as camera:
            with pytest.raises(CameraError) as error:
                shot(camera, settings(camera, *TIMES_S))
            assert error.value.remedies == {"option:sequencer": "off"}


@pytest.mark.serial
def test_camera_without_triggers_chunks_or_sequencer_runs_free(aravis: Library) -> None:
    with virtual_camera(has_trigger=False, has_chunks=False, sets=0) as device:
        with opened(device, aravis, fps="15") as camera:
            assert camera.mode == "mono12p-64x48-15"
            assert camera.controls.time_s.maximum <= 1 / 15
            wanted = settings(camera, 0.004, 0.001)
            check(device, shot(camera, wanted), wanted)
        with pytest.raises(UsageError), opened(device, aravis, trigger="software"):
            pass
        with pytest.raises(UsageError), opened(device, aravis, sequencer="on"):
            pass


def test_refused_features_are_said(aravis: Library) -> None:
    with (
        virtual_camera(refused=["GammaEnable"]) as device,
        opened(device, aravis) as camera,
    ):
        assert camera.controls.has_assumed_response
        assert any("gamma cannot be turned off" in each for each in camera.controls.notes)
    with (
        virtual_camera(refused=["ExposureTime"]) as device,
        pytest.raises(CameraError),
        opened(device, aravis),
    ):
        pass


def test_second_program_is_refused(library: Library, device: GigeCamera) -> None:
    with opened(device, library) as camera:
        with pytest.raises(CameraBusyError):
            GenicamCamera(library, found(device), GenicamOptions()).open()
        wanted = settings(camera, 0.002)
        check(device, shot(camera, wanted), wanted)


def test_lost_control_is_an_error(library: Library, device: GigeCamera) -> None:
    with opened(device, library) as camera:
        device.do("seize")
        with pytest.raises(CameraError) as error:
            shot(camera, settings(camera, 0.002, 0.004))
        assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("sensor", "format_", "layout", "bits"),
    [
        ("machine-vision", "mono8", Layout.MONO, 8),
        ("machine-vision", "mono12", Layout.MONO, 12),
        ("machine-vision", "mono12packed", Layout.MONO, 12),
        ("phone", "auto", Layout.RGGB, 10),
    ],
)
def test_formats(aravis: Library, sensor: str, format_: str, layout: Layout, bits: int) -> None:
    with (
        virtual_camera(sensor=sensor) as device,
        opened(device, aravis, format=format_) as camera,
    ):
        assert (camera.controls.layout, camera.controls.bits) == (layout, bits)
        (frame,) = shot(camera, settings(camera, 0.004))
        assert frame.pixels.dtype == (np.uint8 if bits == 8 else np.uint16)
        assert frame.pixels.max() < 2**bits
