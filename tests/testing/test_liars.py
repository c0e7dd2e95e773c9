"""Cameras that report what is not true: each is found by the check that is named here."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from liars import (
    AddsToLongExposures,
    HasAGammaBelow3Percent,
    HasAGammaNearBlack,
    HasAKneeNearWhite,
    Liar,
)
from ptp_bench import Bench, bench, in_force
from still_scene import open_before, waves

from camctl.errors import CameraDisconnectedError, CameraTimeoutError
from camctl.interface.camera import Camera, Frame, FrameStream
from camctl.interface.controls import ExposureControls, ExposureSetting, Layout, ResponseOrigin
from camctl.interface.cycle import CyclingCamera, FrameCycle
from camctl.sim.camera import SimulatedCamera
from camctl.testing.conformance import CameraConformance

Change = Callable[[ExposureSetting], ExposureSetting]


class Honest(CameraConformance):
    """A streaming camera in front of a picture with structure."""

    sensor = "standard"
    simulated: SimulatedCamera

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(0.02)

    def open_camera(self) -> Camera:
        self.simulated = open_before(waves(), self.sensor)
        return self.simulated

    def unplug(self, camera: Camera) -> None:
        self.simulated.device.unplug()

    def silence(self, camera: Camera) -> None:
        self.simulated.device.freeze()


class HonestGain(Honest):
    """A streaming camera whose gain can be set."""

    sensor = "machine-vision"


@pytest.mark.usefixtures("own_profiles")
class HonestStill(CameraConformance):
    """A still camera with an aperture."""

    pair: Bench

    def middle_s(self, camera: Camera) -> float:
        return camera.controls.time_s.nearest(1 / 125)

    def open_camera(self) -> Camera:
        self.pair = bench()
        return self.pair.camera()

    def open_second(self, camera: Camera) -> Camera:
        return self.pair.camera()

    def in_force(self, camera: Camera) -> ExposureSetting:
        return in_force(self.pair.device)


class HonestTiff(HonestStill):
    """A still camera whose files lose nothing."""

    def open_camera(self) -> Camera:
        self.pair = bench(files=("tiff",))
        return self.pair.camera()


class HonestNoisyJpeg(HonestStill):
    """A still camera whose files lose something, before a sensor with noise."""

    def open_camera(self) -> Camera:
        self.pair = bench("standard")
        return self.pair.camera()


class TestHonestTiff(HonestTiff):
    run_length = 30


class TestHonestNoisyJpeg(HonestNoisyJpeg):
    run_length = 30


class TestHonest(Honest):
    pass


class TestHonestGain(HonestGain):
    pass


class TestHonestStill(HonestStill):
    run_length = 30


class IsOneFrameAhead(Liar):
    """In an endless stream it states the exposure of the frame before."""

    def cycle(self, settings: Sequence[ExposureSetting]) -> FrameCycle:
        assert isinstance(self.camera, CyclingCamera)
        return _Ahead(self.camera.cycle(settings))


class _Ahead:
    def __init__(self, cycle: FrameCycle) -> None:
        self._cycle, self._before = cycle, next(cycle)
        self.method, self.exchange, self.close = cycle.method, cycle.exchange, cycle.close

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        stated, self._before = self._before, next(self._cycle)
        return replace(stated, pixels=self._before.pixels)


class IgnoresGain(Liar):
    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, gain=1.0)


class IgnoresFNumber(Liar):
    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, f_number=2.8)


class ExposesLongTimesTooLong(Liar):
    """Times from 20 ms on last 8 % longer."""

    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, time_s=setting.time_s * (1.08 if setting.time_s >= 0.02 else 1))


class RepeatsEveryThirtiethFrame(Liar):
    last: Frame | None = None

    def returned(self, frame: Frame) -> Frame:
        number, before = self.__dict__.get("number", 0) + 1, self.last
        self.__dict__["number"], self.last = number, frame
        if number % 30 == 0 and before is not None:
            return replace(frame, pixels=before.pixels)
        return frame


class MirrorsTheLowerHalf(Liar):
    """In every second frame."""

    def returned(self, frame: Frame) -> Frame:
        if frame.index % 2 == 0:
            return frame
        pixels = frame.pixels.copy()
        half = len(pixels) // 2
        pixels[half:] = pixels[half:, ::-1]
        return replace(frame, pixels=pixels)


class ClampsLongTimes(Liar):
    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, time_s=min(setting.time_s, 0.5 * self.controls.time_s.maximum))


class FailsOnLongLists(Liar):
    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        if len(settings) > 40:
            raise RuntimeError("list index out of range")
        return super().shoot(settings)


class AppliesTheFNumberOnce(Liar):
    """The light changes by the ratio of the f-numbers, not by its square."""

    def returned(self, frame: Frame) -> Frame:
        return frame

    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        assert setting.f_number is not None
        assert self.controls.f_number is not None
        wide = self.controls.f_number.minimum
        number = self.controls.f_number.nearest((setting.f_number * wide) ** 0.5)
        return replace(setting, f_number=number)


class SetsFullStopsOnly(Liar):
    """It states thirds of a stop, which its shutter does not have."""

    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, time_s=2.0 ** round(np.log2(setting.time_s)))


class ClipsBelowItsWhiteLevel(Liar):
    def returned(self, frame: Frame) -> Frame:
        top = frame.black + (frame.white - frame.black) * 4 // 5
        return replace(frame, pixels=np.minimum(frame.pixels, top).astype(np.uint8))


class HasHighGainsWrong(Liar):
    """Gains from 4 on give 8 % more light than stated."""

    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        longer_s = setting.time_s * (1.08 if setting.gain >= 4 else 1)
        return replace(setting, time_s=longer_s)


class SwapsPairsOfFrames(Liar):
    def _frames(
        self, frames: FrameStream, settings: Sequence[ExposureSetting]
    ) -> Generator[Frame, None, None]:
        made = list(super()._frames(frames, settings))
        for index, frame in enumerate(made):
            other = made[index ^ 1] if index ^ 1 < len(made) and len(made) > 40 else frame
            yield replace(frame, pixels=other.pixels)


class InventsTimestamps(Liar):
    def returned(self, frame: Frame) -> Frame:
        return replace(frame, timestamp_s=frame.timestamp_s + 60.0)


class HidesItsBlackLevel(Liar):
    """Adds a pedestal of 12 levels that it does not state."""

    def returned(self, frame: Frame) -> Frame:
        pixels = np.minimum(frame.pixels.astype(np.int64) + 12, frame.white)
        return replace(frame, pixels=pixels.astype(np.uint8))


class RepeatsItsLastFrame(Liar):
    """It goes on without its device."""

    last: Frame | None = None

    def _frames(
        self, frames: FrameStream, settings: Sequence[ExposureSetting]
    ) -> Generator[Frame, None, None]:
        made = super()._frames(frames, settings)
        for setting in settings:
            try:
                self.last = next(made)
            except (CameraDisconnectedError, CameraTimeoutError):
                assert self.last is not None
                self.last = replace(self.last, requested=setting)
            yield self.last


class StatesTheRequestedTime(Liar):
    """It exposes for half of it, always, which no ratio of light shows."""

    def changed(self, setting: ExposureSetting) -> ExposureSetting:
        return replace(setting, time_s=setting.time_s / 2)


class AssumesTheResponseOfRawSamples(Liar):
    @property
    def controls(self) -> ExposureControls:
        return replace(
            self.camera.controls,
            layout=Layout.RGGB,
            response_origin=ResponseOrigin.ASSUMED,
        )


class StatesItsResponseInWords(Liar):
    @property
    def controls(self) -> ExposureControls:
        return replace(self.camera.controls, response_origin="the response is assumed")  # type: ignore[arg-type]


class HasAlternateThirdsWrong(Liar):
    """Every other third of a stop lasts 3 % longer."""

    def returned(self, frame: Frame) -> Frame:
        if round(3 * np.log2(frame.applied.time_s)) % 2:
            return frame
        brighter = np.minimum(np.rint(1.03 * frame.pixels), frame.white)
        return replace(frame, pixels=brighter.astype(frame.pixels.dtype))


class RepeatsWhereTheSettingStays(Liar):
    last: Frame | None = None

    def returned(self, frame: Frame) -> Frame:
        before, self.last = self.last, self.last
        if before is not None and before.applied == frame.applied:
            return replace(frame, pixels=before.pixels)
        self.last = frame
        return frame


class IsNotQuiteWhiteAtHighGain(Liar):
    def returned(self, frame: Frame) -> Frame:
        if frame.applied.gain < 4:
            return frame
        return replace(frame, pixels=np.minimum(frame.pixels, frame.white - 1))


class StampsFramesLate(Liar):
    late_s = 0.02

    def returned(self, frame: Frame) -> Frame:
        return replace(frame, timestamp_s=frame.timestamp_s + self.late_s)


class StampsFramesEarly(StampsFramesLate):
    late_s = -0.02


class HasNoLowestBit(Liar):
    bit = 0

    def returned(self, frame: Frame) -> Frame:
        pixels: Any = frame.pixels
        return replace(frame, pixels=pixels - (pixels & 1 << self.bit))


class HasNoBit2(HasNoLowestBit):
    bit = 2


class IsStaleFromFrame120On(Liar):
    def _frames(
        self, frames: FrameStream, settings: Sequence[ExposureSetting]
    ) -> Generator[Frame, None, None]:
        kept = None
        for frame in super()._frames(frames, settings):
            if kept is not None and frame.index >= 120:
                yield replace(frame, pixels=kept.pixels)
            else:
                yield frame
            kept = frame


class HasADarkBorderAtHighGain(Liar):
    def returned(self, frame: Frame) -> Frame:
        if frame.applied.gain < 4:
            return frame
        rows, columns = frame.pixels.shape[:2]
        inside = np.zeros((rows, columns), bool)
        inside[2:-2, 2:-2] = True
        dark = (0.9 * (frame.pixels - float(frame.black)) + frame.black).astype(frame.pixels.dtype)
        mask = inside if frame.pixels.ndim == 2 else inside[..., None]
        return replace(frame, pixels=np.where(mask, frame.pixels, dark))


Suite = type[Honest] | type[HonestStill]
# What a check raises: its own assertion, pytest's if an error did not come, or the liar's error.
_FOUND = (AssertionError, pytest.fail.Exception, RuntimeError)
RANGE, CONTROL = "test_light_follows_the_control_over_its_whole_range", "control"
EQUAL = "test_equal_settings_in_a_row_have_frames_of_their_own"
ENDS = "test_the_response_holds_near_black_and_near_white"
ADDED = "test_nothing_is_added_to_the_light"
THIRDS = "test_neighbouring_times_differ_in_light"
ORIGIN = "test_the_response_is_known_or_said_to_be_assumed"
LONG = "test_long_sequences_have_the_right_frames"

LIARS: list[tuple[type[Liar], Suite, str, dict[str, str]]] = [
    (IgnoresGain, HonestGain, RANGE, {CONTROL: "gain"}),
    (IgnoresFNumber, HonestStill, RANGE, {CONTROL: "f_number"}),
    (ExposesLongTimesTooLong, Honest, RANGE, {CONTROL: "time_s"}),
    (RepeatsEveryThirtiethFrame, Honest, LONG, {}),
    (MirrorsTheLowerHalf, Honest, "test_frames_show_the_same_picture", {}),
    (ClampsLongTimes, Honest, "test_long_exposures_last_as_long_as_they_state", {}),
    (ClampsLongTimes, HonestStill, "test_long_exposures_last_as_long_as_they_state", {}),
    (FailsOnLongLists, Honest, LONG, {}),
    (AppliesTheFNumberOnce, HonestStill, RANGE, {CONTROL: "f_number"}),
    (SetsFullStopsOnly, HonestStill, "test_neighbouring_times_differ_in_light", {}),
    (ClipsBelowItsWhiteLevel, Honest, RANGE, {CONTROL: "time_s"}),
    (HasHighGainsWrong, HonestGain, RANGE, {CONTROL: "gain"}),
    (SwapsPairsOfFrames, Honest, LONG, {}),
    (InventsTimestamps, Honest, "test_timestamps_increase", {}),
    (HidesItsBlackLevel, Honest, RANGE, {CONTROL: "time_s"}),
    (RepeatsItsLastFrame, Honest, "test_unplugged_camera_raises_an_error_of_one_line", {}),
    (RepeatsItsLastFrame, Honest, "test_silent_camera_raises_an_error_after_a_limited_time", {}),
    (HasAlternateThirdsWrong, HonestTiff, THIRDS, {}),
    (HasAlternateThirdsWrong, HonestStill, THIRDS, {}),
    (HasAlternateThirdsWrong, HonestNoisyJpeg, THIRDS, {}),
    (RepeatsWhereTheSettingStays, Honest, EQUAL, {}),
    (IsNotQuiteWhiteAtHighGain, HonestGain, "test_white_is_exact_at_every_gain", {}),
    (StampsFramesLate, Honest, "test_time_stamps_are_not_later_than_the_frames", {}),
    (StampsFramesEarly, Honest, "test_time_stamps_are_not_earlier_than_the_exposures", {}),
    (StampsFramesEarly, HonestGain, "test_time_stamps_are_not_earlier_than_the_exposures", {}),
    (HasNoLowestBit, Honest, "test_every_bit_of_the_samples_is_used", {}),
    (HasNoBit2, Honest, "test_every_bit_of_the_samples_is_used", {}),
    (HasNoBit2, HonestTiff, "test_every_bit_of_the_samples_is_used", {}),
    (IsStaleFromFrame120On, Honest, LONG, {}),
    (HasADarkBorderAtHighGain, HonestGain, "test_gains_do_not_change_the_shading", {}),
    (HasAGammaNearBlack, HonestGain, ENDS, {}),
    (HasAGammaNearBlack, Honest, "test_no_dark_code_is_missing", {}),
    (HasAGammaBelow3Percent, HonestGain, ENDS, {}),
    (HasAGammaBelow3Percent, Honest, ENDS, {}),
    (HasAKneeNearWhite, Honest, ENDS, {}),
    (HasAKneeNearWhite, HonestGain, ENDS, {}),
    (AddsToLongExposures, Honest, ADDED, {}),
    (AddsToLongExposures, HonestGain, ADDED, {}),
    (AssumesTheResponseOfRawSamples, Honest, ORIGIN, {}),
    (StatesItsResponseInWords, Honest, ORIGIN, {}),
    (IsOneFrameAhead, Honest, "test_a_cycle_repeats_its_list", {}),
    (StatesTheRequestedTime, HonestStill, "test_applied_is_what_the_device_itself_states", {}),
]


@pytest.mark.usefixtures("own_profiles")
@pytest.mark.parametrize(
    ("liar", "kind", "check", "arguments"),
    LIARS,
    ids=[f"{liar.__name__}-{check}" for liar, _, check, _ in LIARS],
)
def test_liar_is_found_by_the_named_check(
    liar: type[Liar], kind: Suite, check: str, arguments: dict[str, str]
) -> None:
    suite = kind()
    with suite.open_camera() as camera:
        try:
            getattr(suite, check)(camera, **arguments)
        except pytest.skip.Exception as reason:
            pytest.fail(f"the check was left out: {reason}")
    with suite.open_camera() as camera, pytest.raises(_FOUND):
        getattr(suite, check)(liar(camera), **arguments)


@pytest.mark.usefixtures("own_profiles")
def test_a_camera_that_lets_a_second_program_in_is_found() -> None:
    class Shared(HonestStill):
        def open_second(self, camera: Camera) -> Camera:
            return bench().camera()

    suite = Shared()
    with suite.open_camera() as camera, pytest.raises(pytest.fail.Exception):
        suite.test_second_opener_does_not_disturb_the_first(camera)
