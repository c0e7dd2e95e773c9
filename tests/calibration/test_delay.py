"""The measured control delay is the true one, or the measurement says why there is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from camctl.calibration.delay import FRAMES, MOST_FRAMES, Landing, Spoiled, measure_delay, read_step
from camctl.camera import Frame
from camctl.controls import Choices, ExposureSetting
from camctl.errors import CameraDisconnectedError, CameraProtocolError, CaptureError, UsageError
from sim.camera import Faults, SimulatedCamera
from sim.scenes.scene import Scene, load_scene
from sim.sensors.sensor import Sensor, load_sensor


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


@pytest.mark.parametrize("sensor", ["ideal-4", "ideal-12", "standard", "webcam", "phone", "mobile"])
@pytest.mark.parametrize("scene", ["tile-floor", "ramp", "ball"])
def test_a_constant_delay_is_found_with_every_sensor(sensor: str, scene: str) -> None:
    for delay in range(6):
        with camera(delay, sensor=sensor, scene=scene) as under_test:
            record = measure_delay(under_test)
        assert (record.frames, record.smallest, record.largest) == (delay, delay, delay)
        assert record.trials == 12


@given(
    delay=st.integers(0, 5),
    jitter=st.integers(0, 3),
    sensor=st.sampled_from(["ideal-6", "standard", "webcam", "consumer", "machine-vision"]),
    level=st.floats(0.3, 20.0),
    noise=st.floats(0, 40),
    gain=st.sampled_from([1.0, 8.0]),
    seed=st.integers(0, 1000),
)
@settings(max_examples=60)
def test_what_is_measured_holds(
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


def test_a_delay_that_varies_is_not_called_constant() -> None:
    with camera(1, 2) as under_test:
        record = measure_delay(under_test, trials=24)
    assert (record.frames, record.smallest, record.largest) == (None, 1, 3)


def test_a_long_delay_is_found_although_few_frames_are_looked_at() -> None:
    with camera(FRAMES + 5) as under_test:
        assert measure_delay(under_test, trials=4).frames == FRAMES + 5


def test_the_gain_is_stepped_as_well() -> None:
    class LateGain(SimulatedCamera):
        """Its gain takes a frame longer than its shutter time."""

        def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Frame]:
            shown = super().step(before, after, frames + 1)
            late = before.gain != after.gain
            old = super().step(before, before, 1) if late else []
            return ([*old, *shown] if late else shown)[:frames]

    with camera(2, kind=LateGain, gain_maximum=8.0) as under_test:
        record = measure_delay(under_test)
    assert (record.frames, record.smallest, record.largest) == (None, 2, 3)


def test_a_camera_with_choices_of_times_only() -> None:
    class Coarse(SimulatedCamera):
        @property
        def controls(self):  # type: ignore[no-untyped-def]
            times = Choices(tuple(1e-5 * round(1e5 * 2.0 ** (k / 3 - 12)) for k in range(40)))
            return replace(super().controls, time_s=times)

    with camera(3, kind=Coarse) as under_test:
        assert measure_delay(under_test).frames == 3


class Tampering(SimulatedCamera):
    """What comes after a step is changed before anybody sees it."""

    tamper: Callable[[list[Frame], ExposureSetting, ExposureSetting, int], list[Frame]]
    calls = 0

    def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Frame]:
        shown = super().step(before, after, frames)
        if before == after:
            return shown
        self.calls += 1
        return self.tamper(shown, before, after, self.calls)


def tampering(tamper: Callable[..., list[Frame]]) -> type[Tampering]:
    return type("Tampered", (Tampering,), {"tamper": staticmethod(tamper)})


def test_a_frame_between_two_exposures_makes_the_delay_not_constant() -> None:
    def mix(frames: list[Frame], _before: object, _after: object, _call: int) -> list[Frame]:
        mixed = (frames[1].pixels // 2 + frames[2].pixels // 2).astype(frames[2].pixels.dtype)
        return [*frames[:2], replace(frames[2], pixels=mixed), *frames[3:]]

    told: list[str] = []
    with camera(2, kind=tampering(mix)) as under_test:
        record = measure_delay(under_test, tell=told.append)
    assert (record.frames, record.smallest, record.largest) == (None, 2, 3)
    assert len(told) == 1
    assert "mixes exposures" in told[0]


def go_back(frames: list[Frame], _before: object, _after: object, _call: int) -> list[Frame]:
    return [*frames[:5], frames[0], *frames[6:]]


def test_a_frame_that_goes_back_is_no_measurement() -> None:
    with (
        camera(2, kind=tampering(go_back)) as under_test,
        pytest.raises(CameraProtocolError, match=r"goes back .*; keep scene and light still"),
    ):
        measure_delay(under_test)


def test_one_spoiled_step_is_taken_again_and_said() -> None:
    def once(frames: list[Frame], before: object, after: object, call: int) -> list[Frame]:
        return go_back(frames, before, after, call) if call == 3 else frames

    told: list[str] = []
    with camera(2, kind=tampering(once)) as under_test:
        record = measure_delay(under_test, tell=told.append)
    assert record.frames == 2
    assert len(told) == 1
    assert "taken again: frame 5 goes back" in told[0]


def test_a_scene_that_changes_is_said() -> None:
    def flash(frames: list[Frame], _before: object, _after: object, _call: int) -> list[Frame]:
        white = np.full_like(frames[0].pixels, frames[0].white)
        return [*frames[:-1], replace(frames[-1], pixels=white)]

    with (
        camera(2, kind=tampering(flash)) as under_test,
        pytest.raises(CameraProtocolError, match="light of neither exposure"),
    ):
        measure_delay(under_test)


def test_light_that_flickers_is_said() -> None:
    class Flickering(SimulatedCamera):
        number = 0

        def step(self, before: ExposureSetting, after: ExposureSetting, frames: int) -> list[Frame]:
            shown = []
            for frame in super().step(before, after, frames):
                self.number += 1
                factor = 1.0 if self.number % 2 else 0.6
                pixels = (frame.pixels * factor).astype(frame.pixels.dtype)
                shown.append(replace(frame, pixels=pixels))
            return shown

    with (
        camera(2, kind=Flickering) as under_test,
        pytest.raises(CaptureError, match=r"not steady.*does not flicker"),
    ):
        measure_delay(under_test)


@pytest.mark.parametrize(("light", "said"), [(1e-6, "too dark.*lens cap"), (1e9, "too bright")])
def test_black_and_white_are_said(light: float, said: str) -> None:
    with (
        camera(scene=Scene("flat", np.full((8, 8), light), photons_per_unit=1e6)) as under_test,
        pytest.raises(CaptureError, match=said),
    ):
        measure_delay(under_test)


def test_an_exposure_that_never_shows_up_is_said() -> None:
    def stuck(frames: list[Frame], before: object, _after: object, _call: int) -> list[Frame]:
        return [replace(frame, pixels=frames[0].pixels) for frame in frames]

    with (
        camera(2, kind=tampering(stuck)) as under_test,
        pytest.raises(CameraProtocolError, match=f"within {MOST_FRAMES} frames.*automatic"),
    ):
        measure_delay(under_test)


def test_a_camera_without_stream_needs_none() -> None:
    class Still:
        pass

    with pytest.raises(UsageError, match="no stream; a still camera needs no delay"):
        measure_delay(Still())  # type: ignore[arg-type]


def test_a_camera_with_one_exposure_has_no_step() -> None:
    one = {"time_minimum_s": 1e-3, "time_maximum_s": 1e-3, "line_s": 1e-3}
    with camera(**one) as under_test, pytest.raises(UsageError, match="no two exposures"):
        measure_delay(under_test)


def test_faults_of_the_camera_pass_through() -> None:
    with (
        camera(faults=Faults(unplug_after=20)) as under_test,
        pytest.raises(CameraDisconnectedError),
    ):
        measure_delay(under_test)
    with camera() as under_test, pytest.raises(UsageError, match="at least 2"):
        measure_delay(under_test, trials=1)


def test_progress_rises_and_the_same_seed_gives_the_same() -> None:
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
def test_a_step_is_read_where_it_landed(
    first: int, mixed: int, tail: int, levels: tuple[float, float], random: object
) -> None:
    old, new = levels
    shares = [0.0] * first + [0.5] * mixed + [1.0] * tail
    light = [
        old + (share + random.uniform(-0.1, 0.1)) * (new - old)  # type: ignore[attr-defined]
        for share in shares
    ]
    assert read_step(light, old, new) == Landing(first, first + mixed)
    assert read_step(light[: first + mixed + 1], old, new) is None
    assert isinstance(read_step([*light, old, new], old, new), Spoiled)
    assert isinstance(read_step([*light, 2 * new - old], old, new), Spoiled)
