"""Frames that are lost, late and stamped as those of real streams: none gets another's exposure."""

from __future__ import annotations

import random
from typing import Any

import numpy as np
import pytest

import camctl
from camctl.errors import DataError, UsageError
from camctl.interface.camera import Pixels
from camctl.interface.controls import ExposureSetting
from camctl.sim.backend import SimulatedBackend
from camctl.sim.camera import SimulatedCamera
from camctl.sim.data_files import built_in_files, read_text
from camctl.sim.recorded_stream import RecordedStream, load_stream
from camctl.sim.scenes.scene import load_scene
from camctl.sim.sensors.sensor import load_sensor
from camctl.sim.streaming_device import Buffer

STREAMS = tuple(built_in_files("streams"))


@pytest.mark.parametrize("name", STREAMS)
@pytest.mark.parametrize(("delay", "jitter"), [(-1, 0), (0, 0), (1, 0), (3, 0), (1, 1)])
def test_each_frame_has_the_exposure_that_it_states(name: str, delay: int, jitter: int) -> None:
    """The truth is the device's own; the driver knows times, and numbers where there are some."""
    changes = {"delay_frames": delay, "gain_delay_frames": None, "delay_jitter_frames": jitter}
    sensor = load_sensor("webcam").model_copy(update=changes)
    chance = random.Random(1)
    with SimulatedCamera(load_scene("ramp", (2, 4)), sensor, stream=load_stream(name)) as camera:
        exposed: list[ExposureSetting] = []
        read_out = camera.device.read_out

        def witnessed(buffer: Buffer, **given: Any) -> Pixels:
            exposed.append(buffer.exposed)
            return read_out(buffer, **given)

        camera.device.read_out = witnessed  # type: ignore[method-assign]
        for _ in range(40):
            shares = [chance.uniform(0.05, 1) for _ in range(chance.randint(1, 6))]
            wanted = [
                ExposureSetting(camera.controls.time_s.nearest(share * sensor.frame_interval_s))
                for share in shares
            ]
            count = 0
            for frame in camera.shoot(wanted):
                assert frame.applied == exposed[-1]
                assert frame.requested == wanted[count]
                count += 1
            assert count == len(wanted)


def test_frames_of_a_polled_webcam_cost_less_than_settling() -> None:
    """With a delay of 3 settling takes six frames for each exposure."""
    changes = {"delay_frames": 3, "gain_delay_frames": None}
    sensor = load_sensor("webcam").model_copy(update=changes)
    stream = load_stream("polled-webcam")
    with SimulatedCamera(load_scene("ramp", (2, 4)), sensor, stream=stream) as camera:
        before = camera.clock.now()
        for _ in range(20):
            list(camera.shoot([ExposureSetting(0.01), ExposureSetting(0.02)] * 2))
        frames = (camera.clock.now() - before) / sensor.frame_interval_s
    assert frames < 5 * 80


def test_frames_come_as_they_were_recorded() -> None:
    lossy = load_stream("lossy-board")
    assert lossy.arrival(lossy.numbers[-1] + 1) == lossy.arrival(0)  # it begins again
    present = [lossy.arrival(number) is not None for number in range(lossy.numbers[-1] + 1)]
    assert present.count(True) == len(lossy.numbers)
    assert "".join("_|"[each] for each in present[27:34]) == "||____|"  # 20.715 ms, four lost
    polled = [load_stream("polled-webcam").arrival(number) for number in range(37)]
    stamped = [number + each.stamped for number, each in enumerate(polled) if each is not None]
    gaps_ms = np.diff(stamped) * 70.23
    assert len(gaps_ms) == 36
    assert set(np.rint(gaps_ms / 32)) == {2, 3}  # the program looked every 32 ms
    first = load_stream("webcam-start").arrival(0)
    assert first is not None
    assert (first.arrived - first.stamped) * 34.39 == pytest.approx(56.301)


@pytest.mark.parametrize("name", STREAMS)
def test_a_picture_is_taken(name: str) -> None:
    options = {"size": "48x32", "stream": name, "sensor": "webcam"}
    with SimulatedBackend().open("", options) as camera:
        found = camctl.capture(camera, camctl.CaptureRequest(ratios=(1, 4, 16), base_s=0.002))
    assert len(found.frames) == 3
    assert {each.code for each in found.findings}.isdisjoint({"wrong_delay", "wrong_exposure"})


def test_unknown_streams_are_refused() -> None:
    with pytest.raises(UsageError, match="unknown stream 'lossy'"):
        SimulatedBackend().open("", {"stream": "lossy"})


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ('"numbers": [0, 1, 1]', "numbers must ascend"),
        ('"numbers": [0, 1]', "as many times as numbers"),
        ('"numbers": [0, -1, 2]', "numbers.1: input should be greater than or equal to 0"),
    ],
)
def test_a_record_that_contradicts_itself_is_refused(change: str, said: str) -> None:
    text = '{"about": "", "source": "", "interval_ms": 10, "is_numbered": true, '
    with pytest.raises(DataError, match=said):
        read_text(RecordedStream, text + '"times_ms": [0, 10, 20], ' + change + "}", source="x")
