"""The effective camera as a camera: backend ``effective:ID``.

Each of its frames is the sum of one frame for each exposure of a plan, in the desired response.
Its shutter time is that of the shortest exposure; another one makes all exposures longer or shorter
by the same factor.  Every program that takes a camera takes it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from camctl.errors import CameraProtocolError, UsageError
from camctl.exposure.goal import CaptureRequest
from camctl.interface.backends import BackendOptions, LowerCase
from camctl.interface.camera import (
    Camera,
    CameraBase,
    CameraInfo,
    CyclePlace,
    Frame,
    PreviewingCamera,
)
from camctl.interface.controls import Choices, ExposureControls, ExposureSetting, ResponseOrigin
from camctl.interface.cycle import CycleMethod, CyclingCamera, FrameCycle, check_not_empty
from camctl.livestream.planning import LivePlanner
from camctl.livestream.tables import ExposureSet, SumTable, sum_tables
from camctl.livestream.window import OLDEST, Window
from camctl.model.noise import NoiseModel
from camctl.model.response.camera import CameraResponse
from camctl.profiles.calibrated import open_camera
from camctl.records.capture_plan import CapturePlan

DRIVER = "effective"
#: Stops by which its exposures are longer or shorter than the planned ones, at most.
_STOPS = 6
#: Lights at which the noise is fitted, evenly in their logarithm: 16 in each of 16 stops.
_NODES = 256


class EffectiveOptions(BackendOptions):
    """Options of the effective camera; all others are those of the camera below it.

    Attributes:
        response: desired response
        range: desired dynamic range; "auto": of the scene when it is opened
        n: number of exposures
        fps: exposures are no longer than the time that leaves so many frames a second of the camera
        bits: of a sample, 8 to 16
        base: shutter time of the planned shortest exposure, s; None: metered when it is opened
    """

    response: Annotated[Literal["linear", "gamma", "log"], LowerCase] = "log"
    range: Annotated[Literal["auto", "low", "medium", "high"], LowerCase] | float = "auto"
    n: int = Field(default=3, ge=1, le=16)
    fps: float | None = Field(default=None, gt=0, allow_inf_nan=False)
    bits: int = Field(default=12, ge=8, le=16)
    base: float | None = Field(default=None, gt=0, allow_inf_nan=False)


class EffectiveCamera(CameraBase):
    """A camera with the desired response and range; it previews where the one below it does not.

    Args:
        camera: the open camera below, which it closes
        options: see `EffectiveOptions`

    Raises:
        UsageError, CaptureError: as `camctl.plan_capture` does
    """

    def __init__(self, camera: Camera, options: EffectiveOptions | None = None) -> None:
        super().__init__(f"{DRIVER}:{camera.info.id}", camera.clock)
        self.camera, self._options = camera, options or EffectiveOptions()
        self._sets: dict[float, tuple[ExposureSetting, ...]] = {}
        self._codes: dict[float, list[NDArray[np.unsignedinteger]]] = {}
        self._planned: CapturePlan | None = None
        self.open()

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame; previews of the camera below have other exposures than its frames."""
        with closing(self.shoot([setting])) as frames:
            return next(frames)

    def _open(self) -> None:
        camera, options = self.camera.__enter__(), self._options
        request = CaptureRequest(
            response=options.response,
            dynamic_range=options.range,
            count=options.n,
            base_s=options.base,
            spend_shutter=not isinstance(camera, PreviewingCamera),
        )
        planner = LivePlanner(camera, request, options.fps)
        # Opened again, it is the same camera: a stream goes on with its exposures.
        self.plan = plan = self._planned = self._planned or planner.first()
        self._below = below = camera.controls
        self._sets = _scaled(plan, planner.controls)
        info = camera.info
        self._info = CameraInfo(
            f"{DRIVER}:{info.id}", info.make, f"effective {info.model}", info.serial, DRIVER
        )
        most = (1 << options.bits) - 1
        desired = plan.desired
        base = min(plan.settings, key=below.exposure)
        exposure_s = below.exposure(base) / base.time_s
        tables = self._tables(base.time_s)
        self._controls = ExposureControls(
            time_s=Choices(tuple(sorted(self._sets))),
            shape=below.shape,
            layout=below.layout,
            bits=options.bits,
            white=most,
            response=CameraResponse(
                desired.inverse(np.arange(1, most + 1) / (most + 1)),
                f"{plan.response}, 1:{plan.dynamic_range:g}",
            ),
            response_origin=ResponseOrigin.STATED,
            frame_interval_s=len(plan.settings) * below.frame_interval_s,
            sensitivity=None if below.sensitivity is None else below.sensitivity * exposure_s,
            noise=None if below.noise is None else _fitted_noise(tables[0], most),
            findings=plan.findings,
            exposures_exact=below.exposures_exact,
            repeatable=below.repeatable,
        )

    def _close(self) -> None:
        self._codes.clear()
        self.camera.close()

    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        sets = [self._set_of(each) for each in settings]
        flat = [each for one in sets for each in one]
        if not flat:
            return
        with closing(self.camera.shoot(flat)) as frames:
            for index, one in enumerate(sets):
                window = Window(self._below)
                for place in range(len(one)):
                    try:
                        frame = next(frames)
                    except StopIteration:
                        raise CameraProtocolError(
                            f"{self.camera.info.id} ended the sequence early"
                        ) from None
                    window.put(frame, place)
                    self._check_open()
                yield self._frame(window, settings[index], index, frame.timestamp_s)

    def _frame(
        self, window: Window, requested: ExposureSetting, index: int, timestamp_s: float
    ) -> Frame:
        controls = self.controls
        time_s = controls.time_s.nearest(requested.time_s)
        codes = self._codes_of(time_s)
        total = window.total
        if len(codes) == 1:
            pixels = codes[0].take(total)
        else:
            pixels = np.empty(total.shape, codes[0].dtype)
            layout = self._below.layout
            letters = "RGB" if layout == "rgb" else layout.value.upper()
            views = zip(letters, layout.planes(total), layout.planes(pixels), strict=True)
            for letter, sums, out in views:
                out[...] = codes["RGB".index(letter)].take(sums)
        return Frame(
            pixels=pixels,
            requested=requested,
            applied=replace(requested, time_s=time_s),
            timestamp_s=timestamp_s,
            index=index,
            black=0,
            white=controls.white,
            details={
                "exposures_s": [frame.applied.time_s for frame in window.frames],
                OLDEST: max(timestamp_s - frame.timestamp_s for frame in window.frames),
            },
        )

    def _set_of(self, setting: ExposureSetting) -> tuple[ExposureSetting, ...]:
        """Return the exposures of the camera below that a setting stands for."""
        return self._sets[self.controls.time_s.nearest(setting.time_s)]

    def _codes_of(self, time_s: float) -> list[NDArray[np.unsignedinteger]]:
        """Return the sample of each value of the sum."""
        if time_s not in self._codes:
            most, desired = self.controls.white, self.plan.desired
            dtype = np.uint8 if self._options.bits <= 8 else np.uint16
            self._codes[time_s] = []
            for table in self._tables(time_s):
                codes = np.minimum(np.floor(desired.u(table.E) * (most + 1) + 1e-9), most)
                codes[-1] = most  # every frame is saturated
                self._codes[time_s].append(codes.astype(dtype))
        return self._codes[time_s]

    def _tables(self, time_s: float) -> tuple[SumTable, ...]:
        settings = self._sets[time_s]
        base = min(map(self._below.exposure, settings))
        wanted = ExposureSet(settings, base, self.plan.desired)
        return sum_tables(self._below, wanted, is_exact=True)


class StreamingEffectiveCamera(EffectiveCamera):
    """An effective camera over one that streams: each frame of that one completes one of it."""

    def cycle(self, settings: Sequence[ExposureSetting]) -> FrameCycle:
        """Return frames without end; see `camctl.interface.cycle.CyclingCamera`.

        The first frame of a list, and of one that it is exchanged for, is there when each of its
        exposures was taken once.
        """
        check_not_empty(settings)
        checked = self._checked(settings)
        found = EffectiveCycle(self, checked)
        self._is_shooting = True
        return found

    def settings_below(self, settings: Sequence[ExposureSetting]) -> list[ExposureSetting]:
        """Return the exposures of all settings: the first of each, the second of each, and so on.

        Each frame then completes one of the next setting.
        """
        sets = [self._set_of(each) for each in settings]
        return [each for same in zip(*sets, strict=True) for each in same]


class EffectiveCycle:
    """A `camctl.interface.cycle.FrameCycle` over the frames of the camera below.

    Args:
        camera: whose frames they are
        settings: the list, which was checked
    """

    def __init__(
        self, camera: StreamingEffectiveCamera, settings: tuple[ExposureSetting, ...]
    ) -> None:
        assert isinstance(camera.camera, CyclingCamera)  # as the class says
        self._camera = camera
        self._lists = {0: settings}
        self._cycle = camera.camera.cycle(camera.settings_below(settings))
        self._plan: int | None = None
        self._windows: list[Window] = []
        self._filling = 0  # frames that completed none
        self._is_open = True

    @property
    def method(self) -> CycleMethod:
        """How the camera below sets its exposures."""
        return self._cycle.method

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> Frame:
        while True:
            self._camera._check_open()
            frame = next(self._cycle)
            assert frame.place is not None  # a frame of a cycle has one
            settings = self._lists[frame.place.plan]
            if frame.place.plan != self._plan:
                self._plan = frame.place.plan
                self._windows = [Window(self._camera._below) for _ in settings]
            position, index = divmod(frame.index, len(settings))
            window = self._windows[index]
            window.put(frame, position)
            if len(window.frames) == len(self._camera.plan.settings):
                made = self._camera._frame(window, settings[index], index, frame.timestamp_s)
                number = frame.place.number - self._filling
                return replace(made, place=CyclePlace(number, frame.place.plan))
            self._filling += 1

    def exchange(self, settings: Sequence[ExposureSetting]) -> int:
        """See `FrameCycle.exchange`."""
        check_not_empty(settings)
        for setting in settings:
            self._camera.controls.check(setting)
        number = self._cycle.exchange(self._camera.settings_below(settings))
        self._lists[number] = tuple(settings)
        return number

    def close(self) -> None:
        """See `FrameCycle.close`."""
        if self._is_open:
            self._is_open = False
            self._camera._is_shooting = False
            self._cycle.close()


def _scaled(
    plan: CapturePlan, controls: ExposureControls
) -> dict[float, tuple[ExposureSetting, ...]]:
    """Return the plan's settings and those that are whole stops longer or shorter, by base."""
    times = controls.time_s
    found = {}
    for stops in range(-_STOPS, _STOPS + 1):
        wanted = [(each, each.time_s * 2.0**stops) for each in plan.settings]
        if all(times.minimum <= time_s <= times.maximum for _, time_s in wanted):
            settings = tuple(replace(each, time_s=times.nearest(t)) for each, t in wanted)
            found[min(settings, key=controls.exposure).time_s] = settings
    return found


def _fitted_noise(table: SumTable, most: int) -> NoiseModel | None:
    """Return photon and read noise with about the standard deviations of a table.

    With the light fewer of the exposures count, so that its noise is no photon noise of one frame:
    the fit is relative, and within a factor of 2 for three exposures over 1:256.
    """
    scale = table.irradiance[-1] / table.E[-1]
    within = np.isfinite(table.sd) & (table.E > 0) & (table.E < 1)
    E, sd = table.E[within], table.sd[within] / scale
    if E.size < 2:
        return None
    light = np.geomspace(max(float(E[0]), 1e-6), float(E[-1]), _NODES)
    variance = np.interp(light, E, sd.astype(np.float64)) ** 2
    # a light + b = variance, each equation over the variance: relative errors count.
    terms = np.stack([light, np.ones_like(light)], axis=1) / variance[:, np.newaxis]
    (a, b), *_ = np.linalg.lstsq(terms, np.ones_like(light), rcond=None)
    levels = most + 1.0
    a, b = max(float(a), 1e-12), max(float(b), 0.0)
    electrons = 1 / (a * levels)
    return NoiseModel(electrons, ((1.0, float(np.sqrt(b)) * levels * electrons),))


class EffectiveBackend:
    """Opens ``effective:ID``; see `EffectiveOptions`."""

    about = "another camera with the desired response and range, such as effective:v4l2:/dev/video0"

    def discover(self, *, probe: bool = False) -> Sequence[CameraInfo]:
        """Return nothing: each camera has one, which `effective:` before its id opens."""
        return ()

    def open(self, address: str, options: Mapping[str, Any]) -> EffectiveCamera:
        """Open the camera at `address`, and meter the scene."""
        if not address:
            raise UsageError("no camera is named", hint=f"name one, such as {DRIVER}:sim")
        own = {name: options[name] for name in options if name in EffectiveOptions.model_fields}
        chosen = EffectiveOptions.parse(own)
        others = {name: value for name, value in options.items() if name not in own}
        camera = open_camera(address, others)
        kind = StreamingEffectiveCamera if isinstance(camera, CyclingCamera) else EffectiveCamera
        try:
            return kind(camera, chosen)
        except BaseException:
            camera.close()
            raise
