"""The measured control delay is the true one, or an error states why it cannot be measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from itertools import product
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sampling import some

from camctl.calibration.delay import (
    FIRST_FRAMES,
    MOST_FRAMES,
    InvalidStep,
    StepResponse,
    find_step,
    measure_delay,
)
from camctl.errors import CameraDisconnectedError, CameraProtocolError, CaptureError, UsageError
from camctl.findings import Detail, Finding
from camctl.interface.camera import Frame
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting
from camctl.profiles.profile import change_profile, load_profile
from camctl.sim.camera import Faults, SimulatedCamera
from camctl.sim.scenes.scene import Scene, load_scene
from camctl.sim.sensors.sensor import Sensor, load_sensor
from camctl.sim.streaming_device import Buffer


def camera(
    delay: int = 2,
    jitter: int = 0,
    *,
    sensor: str = "standard",
    scene: str | Scene = "tile-floor",
    seed: int = 0,
    faults: Faults | None = None,
    kind: type[SimulatedCamera] = SimulatedCamera,
    **changes: object,
) -> SimulatedCamera:
    model = load_sensor(sensor)
    model = Sensor.model_validate(
        {**model.model_dump(), "delay_frames": delay, "delay_jitter_frames": jitter, **changes}
    )
    if isinstance(scene, str):
        scene = load_scene(scene, (30, 40))
    return kind(scene, model, seed=seed, faults=faults)


SENSORS = ("ideal-4", "ideal-12", "standard", "webcam", "phone", "mobile")
SCENES = ("tile-floor", "ramp", "ball")


def check_constant_delay(delay: int, sensor: str, scene: str) -> None:
    with camera(delay, sensor=sensor, scene=scene) as under_test:
        record = measure_delay(under_test)
    assert (record.frames, record.smallest, record.largest) == (delay, delay, delay)
    assert record.trials == 12


# "mobile" is slow: below, with all of them.
@pytest.mark.parametrize("sensor", some(SENSORS[:-1], every=3))
def test_constant_delay_is_measured_with_every_sensor(sensor: str) -> None:
    """Each delay before one of the scenes, another one for the next sensor."""
    for delay in range(6):
        check_constant_delay(delay, sensor, SCENES[(delay + SENSORS.index(sensor)) % 3])


@given(
    delay=st.integers(0, 5),
    jitter=st.integers(0, 3),
    sensor=st.sampled_from(["ideal-6", "standard", "webcam", "consumer", "machine-vision"]),
    level=st.floats(0.3, 20.0),
    noise=st.floats(0, 40),
    gain=st.sampled_from([1.0, 8.0]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=settings().max_examples // 6)
def test_measured_delay_is_within_the_true_bounds(
    delay: int, jitter: int, sensor: str, level: float, noise: float, gain: float, seed: int
) -> None:
    light = np.geomspace(level, level / 100, 600, dtype=np.float32).reshape(20, 30)
    with camera(
        delay,
        jitter,
        sensor=sensor,
        scene=Scene("gradient", light, photons_per_unit=1e6),
        seed=seed,
        read_noise_e=noise,
        gain_maximum=gain,
        black=0,
    ) as under_test:
        record = measure_delay(under_test, seed=seed)
    assert delay <= record.smallest <= record.largest <= delay + jitter
    if jitter == 0:
        assert record.frames == delay


def test_varying_delay_is_not_constant() -> None:
    with camera(1, 2) as under_test:
        record = measure_delay(under_test, trials=24)
    assert (record.frames, record.smallest, record.largest) == (None, 1, 3)


def test_delay_longer_than_the_frames_looked_at_first() -> None:
    with camera(FIRST_FRAMES + 5) as under_test:
        assert measure_delay(under_test, trials=4).frames == FIRST_FRAMES + 5


def test_camera_with_a_list_of_times() -> None:
    class Coarse(SimulatedCamera):
        @property
        def controls(self) -> ExposureControls:
            times = Choices(tuple(1e-5 * round(1e5 * 2.0 ** (k / 3 - 12)) for k in range(40)))
            return replace(super().controls, time_s=times)

    with camera(3, kind=Coarse) as under_test:
        assert measure_delay(under_test).frames == 3


Change = Callable[[list[Frame], int], list[Frame]]


class ChangedFrames(SimulatedCamera):
    """The frames after a step are changed by a function of them and of the number of the step."""

    change: Change
    steps = 0

    def step(
        self, before: ExposureSetting, after: ExposureSetting, frames: int, *, early: int = 0
    ) -> list[Frame]:
        shown = super().step(before, after, frames)
        if before == after:
            return shown
        self.steps += 1
        return self.change(shown, self.steps)


def changed(change: Change) -> type[ChangedFrames]:
    return type("Changed", (ChangedFrames,), {"change": staticmethod(change)})


def test_mixed_exposures_make_the_delay_not_constant() -> None:
    def mix(frames: list[Frame], _step: int) -> list[Frame]:
        mixed: Any = (frames[1].pixels // 2 + frames[2].pixels // 2).astype(frames[2].pixels.dtype)
        return [*frames[:2], replace(frames[2], pixels=mixed), *frames[3:]]

    warnings: list[Finding] = []
    with camera(2, kind=changed(mix)) as under_test:
        record = measure_delay(under_test, warn=warnings.append)
    assert (record.frames, record.smallest, record.largest) == (None, 2, 3)
    assert [(each.code, each.value) for each in warnings] == [("delay_irregular", 12)]


def return_to_old(frames: list[Frame], _step: int) -> list[Frame]:
    return [*frames[:5], frames[0], *frames[6:]]


def test_return_to_the_earlier_exposure_is_an_error() -> None:
    message = r"4 steps were invalid, the last because frame 5 returns to the earlier exposure; "
    with (
        camera(2, kind=changed(return_to_old)) as under_test,
        pytest.raises(CameraProtocolError, match=message + "keep scene and light steady"),
    ):
        measure_delay(under_test)


def test_one_invalid_step_is_repeated_with_a_warning() -> None:
    def once(frames: list[Frame], step: int) -> list[Frame]:
        return return_to_old(frames, step) if step == 3 else frames

    warnings: list[Finding] = []
    with camera(2, kind=changed(once)) as under_test:
        record = measure_delay(under_test, warn=warnings.append)
    assert record.frames == 2
    why: dict[str, Detail] = {"why": "frame 5 returns to the earlier exposure"}
    assert warnings == [Finding(code="delay_irregular", details=why)]


def test_changing_scene_is_an_error() -> None:
    def flash(frames: list[Frame], _step: int) -> list[Frame]:
        white = np.full_like(frames[0].pixels, frames[0].white)
        return [*frames[:-1], replace(frames[-1], pixels=white)]

    with (
        camera(2, kind=changed(flash)) as under_test,
        pytest.raises(CameraProtocolError, match="has the brightness of neither exposure"),
    ):
        measure_delay(under_test)


def test_flickering_light_is_an_error() -> None:
    class Flickering(SimulatedCamera):
        number = 0

        def step(
            self, before: ExposureSetting, after: ExposureSetting, frames: int, *, early: int = 0
        ) -> list[Frame]:
            shown = []
            for frame in super().step(before, after, frames):
                self.number += 1
                factor = 1.0 if self.number % 2 else 0.6
                pixels: Any = (frame.pixels * factor).astype(frame.pixels.dtype)
                shown.append(replace(frame, pixels=pixels))
            return shown

    with (
        camera(2, kind=Flickering) as under_test,
        pytest.raises(
            CaptureError, match=r"the light is not steady: .*; point .* does not flicker"
        ),
    ):
        measure_delay(under_test)


@pytest.mark.parametrize(
    ("light", "message"),
    [
        (
            1e-6,
            "the scene is too dark: its brightness changes by 0.0% of full scale, up to .* at .*; "
            "take the lens cap off",
        ),
        (1e9, "the scene is too bright: it is white even at .*; close the aperture"),
    ],
)
def test_black_and_white_scenes_are_errors(light: float, message: str) -> None:
    with (
        camera(scene=Scene("flat", np.full((8, 8), light), photons_per_unit=1e6)) as under_test,
        pytest.raises(CaptureError, match=message),
    ):
        measure_delay(under_test)


def test_exposure_that_never_takes_effect_is_an_error() -> None:
    def stuck(frames: list[Frame], _step: int) -> list[Frame]:
        return [replace(frame, pixels=frames[0].pixels) for frame in frames]

    with (
        camera(2, kind=changed(stuck)) as under_test,
        pytest.raises(
            CameraProtocolError,
            match=f"did not take effect within {MOST_FRAMES} frames; turn .* automatic exposure",
        ),
    ):
        measure_delay(under_test)


def test_still_camera_has_no_delay() -> None:
    class Still:
        pass

    with pytest.raises(UsageError, match="this camera does not stream; a still camera has no"):
        measure_delay(Still())  # type: ignore[arg-type]


def test_camera_with_a_single_exposure_time() -> None:
    with (
        camera(time_minimum_s=1e-3, time_maximum_s=1e-3, line_s=1e-3) as under_test,
        pytest.raises(UsageError, match="no two exposures far enough apart"),
    ):
        measure_delay(under_test)


def test_errors_of_the_camera_and_of_the_caller() -> None:
    with (
        camera(faults=Faults(unplug_after=20)) as under_test,
        pytest.raises(CameraDisconnectedError),
    ):
        measure_delay(under_test)
    with (
        camera() as under_test,
        pytest.raises(UsageError, match="invalid number of trials 1; take at least 2"),
    ):
        measure_delay(under_test, trials=1)


def test_progress_rises_and_the_seed_determines_the_result() -> None:
    shares: list[float] = []
    with camera(1, 2, seed=5) as under_test:
        first = measure_delay(under_test, progress=shares.append, seed=4)
    with camera(1, 2, seed=5) as under_test:
        second = measure_delay(under_test, seed=4)
    assert shares == sorted(shares)
    assert len(shares) == 12
    assert first.model_copy(update={"measured_at": second.measured_at}) == second


@given(
    st.integers(0, 20),
    st.integers(0, 3),
    st.integers(2, 20),
    st.sampled_from([(0.2, 0.8), (0.9, 0.1)]),
    st.randoms(use_true_random=False),
)
def test_step_is_found_in_the_brightness(
    first: int, mixed: int, tail: int, levels: tuple[float, float], random: Random
) -> None:
    old, new = levels
    shares = [0.0] * first + [0.5] * mixed + [1.0] * tail
    light = [old + (share + random.uniform(-0.1, 0.1)) * (new - old) for share in shares]
    assert find_step(light, old, new) == StepResponse(first, first + mixed)
    assert find_step(light[: first + mixed + 1], old, new) is None
    assert isinstance(find_step([*light, old, new], old, new), InvalidStep)
    assert isinstance(find_step([*light, 2 * new - old], old, new), InvalidStep)


@pytest.mark.parametrize("sensor", ["standard", "webcam", "machine-vision"])
def test_setting_that_acts_on_the_running_exposure_has_the_delay_minus_one(sensor: str) -> None:
    with camera(-1, sensor=sensor, gain_maximum=8.0) as under_test:
        record = measure_delay(under_test)
    assert (record.frames, record.time, record.gain) == (-1, (-1, -1), (-1, -1))


@pytest.mark.usefixtures("own_profiles")
@pytest.mark.parametrize("delay", some(range(-1, 4), every=3))
def test_measured_delay_is_stored_and_used(delay: int) -> None:
    """The camera does not know its delay; each frame of a random bracket has its own exposure."""
    scene = load_scene("tile-floor", (30, 40))
    model = Sensor.model_validate({**load_sensor("standard").model_dump(), "delay_frames": delay})
    with SimulatedCamera(scene, model, is_unknown=True) as unknown:
        record, mode = measure_delay(unknown), unknown.mode
        assert unknown.controls.delay_frames == delay  # used at once
        change_profile(unknown.info, lambda profile: profile.delays.update({mode: record}))
    assert load_profile(unknown.info).delays[mode] == record
    with SimulatedCamera(scene, model, is_unknown=True) as known:
        assert known.controls.delay_frames == delay
        times = [known.controls.time_s.nearest(t) for t in (0.002, 0.02, 0.004, 0.01, 0.03, 0.005)]
        before = known.device._running
        with closing(known.shoot([ExposureSetting(t) for t in times])) as stream:
            frames = list(stream)
        assert known.device._running - before <= len(times) + delay + 2  # n + d, and at rest
        true = [known.device.read_out(shot_buffer(known, t)) for t in times]
    for frame, expected in zip(frames, true, strict=True):
        assert float(frame.pixels.mean()) == pytest.approx(float(expected.mean()), rel=0.02)


def shot_buffer(of: SimulatedCamera, time_s: float) -> Buffer:
    setting, now_s = ExposureSetting(time_s), of.clock.now()
    return Buffer(0, now_s, now_s, now_s, setting, setting)


def test_delay_that_a_random_series_contradicts_is_refused() -> None:
    """It was measured between trials that were all alike: the proof has others."""

    class Deceptive(SimulatedCamera):
        def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
            self.device._late = (3, 3)
            return super()._frames(settings)

    with (
        camera(2, kind=Deceptive) as under_test,
        pytest.raises(CameraProtocolError, match="a random series has not the exposure"),
    ):
        measure_delay(under_test)


@pytest.mark.parametrize(("time", "gain"), some(product(range(-1, 6), repeat=2), every=6))
def test_delays_of_time_and_gain_are_measured_and_used_apart(time: int, gain: int) -> None:
    """Whatever changes, each frame has its own exposure, by its pixels."""
    changes = {"delay_frames": time, "gain_delay_frames": gain, "gain_maximum": 8.0}
    model = Sensor.model_validate({**load_sensor("ideal-12").model_dump(), **changes})
    with SimulatedCamera(load_scene("tile-floor", (30, 40)), model, is_unknown=True) as camera:
        record = measure_delay(camera)
        assert (record.time, record.gain) == ((time, time), (gain, gain))
        assert record.frames == (time if time == gain else None)
        exposures = [(0.002, 1), (0.004, 1), (0.001, 1), (0.001, 4), (0.001, 2), (0.004, 1)]
        plans = [exposures[:3], exposures[3:5], exposures]
        for plan, delay in zip(plans, (time, gain, record.frames), strict=True):
            wanted = [ExposureSetting(camera.controls.time_s.nearest(t), g) for t, g in plan]
            list(camera.shoot(wanted[-1:]))
            before = camera.device._running
            frames = list(camera.shoot(wanted))
            light = [float(frame.pixels.mean()) / frame.applied.exposure for frame in frames]
            # Exposures differ by a factor of 2 at least.
            assert light == pytest.approx([light[0]] * len(plan), rel=0.05)
            if delay is not None:  # n + d frames, and one at rest
                assert camera.device._running - before <= len(plan) + delay + 2
