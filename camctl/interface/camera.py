"""The camera interface: everything that the controller knows of a camera.

A camera has controls (`ExposureControls`), takes a whole list of settings at once (`Camera.shoot`)
and yields frames that carry the exposure they really had (`Frame`).  Values are in SI units:
seconds, linear gain, f-number; true times, never the labels on a dial.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self, TypeVar, runtime_checkable

from camctl.errors import CameraBusyError, CameraClosedError
from camctl.interface.clock import Clock, check_cancelled
from camctl.interface.controls import ExposureControls, ExposureSetting
from camctl.interface.layout import Pixels as Pixels
from camctl.system.interrupts import entering, uninterrupted

AnswerT = TypeVar("AnswerT")


@dataclass(frozen=True)
class CameraInfo:
    """Identity of a camera.

    Attributes:
        id: opens the camera: see `camctl.open_camera`
        make: maker, "" where unknown
        model: model
        serial: serial number, "" where unknown
        driver: name of the backend
        remark: for the choice among listed cameras, such as which backend suits it better
    """

    id: str
    make: str
    model: str
    serial: str
    driver: str
    remark: str = ""

    @property
    def name(self) -> str:
        """Maker and model as people write them: a model that begins with the maker's name has it.

        The id where both are unknown.
        """
        first = self.make.split()[0].lower() if self.make.strip() else ""
        has_make = bool(first) and self.model.lower().startswith(first)
        return self.model if has_make else f"{self.make} {self.model}".strip() or self.id


@dataclass(frozen=True)
class OriginalFile:
    """The file that a still camera made of a frame, byte for byte.

    Attributes:
        suffix: suffix of its name, with the dot
        data: its content
    """

    suffix: str
    data: bytes


@dataclass(frozen=True)
class CyclePlace:
    """Where a frame of `camctl.interface.cycle.CyclingCamera.cycle` is in its stream.

    Attributes:
        number: of its slot; the numbers of lost frames are skipped
        plan: how often the list of settings had been exchanged before
    """

    number: int
    plan: int


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame as the camera returned it.

    Attributes:
        pixels: (rows, columns) or, for RGB, (rows, columns, 3); uint8 up to 8 bits, else uint16
        requested: the setting given to `shoot`
        applied: the setting read back from the camera
        timestamp_s: when the exposure ended, on the camera's clock, s
        index: position of the setting in the list that `shoot` was given
        black: brightness without light in this frame, DN
        white: brightness from which samples of this frame are saturated, DN
        original: the camera's own file, where it made one
        details: what else the camera reports of the frame; kept as JSON in the capture's report
        place: where it is in an endless stream; None: it is one of a list
        lost: frames of its setting that the camera lost, or sent unreadable, before this one
    """

    pixels: Pixels
    requested: ExposureSetting
    applied: ExposureSetting
    timestamp_s: float
    index: int
    black: int
    white: int
    original: OriginalFile | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    place: CyclePlace | None = None
    lost: int = 0


class FrameStream(Iterator[Frame], Protocol):
    """Frames in the order of their settings; any generator of frames is one."""

    def close(self) -> None:
        """Cancel the remaining exposures."""


@runtime_checkable
class Camera(Protocol):
    """What every camera, real or simulated, implements.

    A camera is a context manager that closes it at the end.  `camctl.testing.CameraConformance`
    checks this contract.
    """

    @property
    def info(self) -> CameraInfo:
        """The identity of the camera."""

    @property
    def controls(self) -> ExposureControls:
        """What can be set, and the format of the frames."""

    @property
    def clock(self) -> Clock:
        """The clock of the timestamps."""

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Shoot the settings in their order; return an iterator with one frame for each.

        The whole list is checked before the first frame: a setting that cannot be met within
        `ExposureControls.tolerance` raises `RefusedSettingError` from this call, and nothing is
        shot.  A frame is yielded only if its exposure is known; its pixels are not overwritten
        later.  Closing the iterator cancels the remaining exposures.  With a constant control delay
        of d frames, n settings take n + d frames.

        Raises:
            RefusedSettingError: a setting cannot be met
            CameraBusyError, CameraDisconnectedError, CameraTimeoutError, CameraProtocolError
        """

    def close(self) -> None:
        """Disconnect from the camera; a second call does nothing."""

    def __enter__(self) -> Self:
        """Open the camera where it is not open, and return it."""

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the camera."""


@runtime_checkable
class PreviewingCamera(Camera, Protocol):
    """A camera that can take a frame without a shutter actuation."""

    def preview(self, setting: ExposureSetting) -> Frame:
        """Return one frame at `setting`, for metering; raises as `shoot` does."""


@runtime_checkable
class StreamingCamera(Camera, Protocol):
    """A camera that streams frames, so that its control delay can be measured."""

    @property
    def mode(self) -> str:
        """Pixel format, size and frame rate in one word; each mode has its own control delay."""

    def step(
        self, before: ExposureSetting, after: ExposureSetting, frames: int, *, early: int = 0
    ) -> Sequence[Frame]:
        """Settle at `before`, set `after`, and return the next `frames` frames of the stream.

        Frame 0 is the first whose exposure had not begun when `after` was set; with a control delay
        of d frames, frame d is the first that has it.  With `early` = 1 the frame before it, which
        was being exposed then, is returned before the others where it comes after the setting: a
        camera with a delay of -1 applies the setting to it.  The caller measures which exposure
        each frame had: `requested` and `applied` are `after` in all of them, and `index` is the
        number of the frame.  Raises as `shoot` does.
        """


@dataclass(frozen=True)
class MeasuredDelay:
    """Bounds of a measured control delay, counted as in `StreamingCamera.step`.

    Attributes:
        smallest, largest: of all controls, frames
        time, gain: (smallest, largest) of a change of this control alone; None: not measured
        readout_s: from the end of an exposure until its frame is here; 0: not measured
    """

    smallest: int
    largest: int
    time: tuple[int, int] | None = None
    gain: tuple[int, int] | None = None
    readout_s: float = 0.0


@dataclass(frozen=True)
class CameraCondition:
    """What a camera states of itself before it shoots; None: it does not.

    Attributes:
        battery_percent: charge of its battery
        free_images: pictures for which its card has room
        lens: the name of the lens, or its focal lengths and apertures
        mode: where the mode dial stands, such as "M"
    """

    battery_percent: int | None = None
    free_images: int | None = None
    lens: str | None = None
    mode: str | None = None


@runtime_checkable
class StatingCamera(Camera, Protocol):
    """A camera that states its battery, card, lens and mode dial, or some of them."""

    def condition(self) -> CameraCondition:
        """Return what the camera states now; raises `CameraError` where it does not answer."""


def use_delay(camera: Camera, delay: MeasuredDelay | None) -> bool:
    """Let a camera use a measured control delay from now on; return whether it can.

    A driver has a method `use_delay` for this.  With None the delay counts as unknown: the stream
    settles at each exposure.
    """
    use = getattr(camera, "use_delay", None)
    if use is not None:
        use(delay)
    return use is not None


class CameraBase(ABC):
    """Base of camera drivers: open and close, one sequence at a time, settings checked.

    A driver implements `_open`, which sets `_info` and `_controls`, `_frames` and `_close`.  The
    constructor does no I/O; the camera opens with `open` or at the start of its ``with`` block.  A
    driver whose controls are known only later overrides the property `controls`.

    Args:
        name: name of the camera in error messages, such as its device path
        clock: the clock of the timestamps and of everything that the driver waits for
    """

    _info: CameraInfo | None = None
    _controls: ExposureControls | None = None

    def __init__(self, name: str, clock: Clock) -> None:
        self._name = name
        self._clock = clock
        self._is_open = False
        self._is_shooting = False

    @abstractmethod
    def _open(self) -> None:
        """Connect to the device; where this raises, nothing is left open."""

    @abstractmethod
    def _frames(self, settings: tuple[ExposureSetting, ...]) -> Iterator[Frame]:
        """Yield one frame for each setting; all of them have been checked."""

    @abstractmethod
    def _close(self) -> None:
        """Disconnect from the device; called once for each `_open` that succeeded."""

    @property
    def info(self) -> CameraInfo:
        """The identity of the camera; raises `CameraClosedError` before it was opened."""
        if self._info is None:
            raise self._not_open()
        return self._info

    @property
    def controls(self) -> ExposureControls:
        """What can be set; raises `CameraClosedError` before the camera was opened."""
        if self._controls is None:
            raise self._not_open()
        return self._controls

    @property
    def clock(self) -> Clock:
        """The clock of the timestamps."""
        return self._clock

    @entering
    def open(self) -> Self:
        """Connect to the device and return the camera; an open camera stays as it is."""
        if not self._is_open:
            self._open()
            self._is_open = True
        return self

    def shoot(self, settings: Sequence[ExposureSetting]) -> FrameStream:
        """Shoot the settings in their order; see `Camera.shoot`."""
        return self._shoot(self._checked(settings))

    @uninterrupted
    def close(self) -> None:
        """Disconnect from the device; a second call does nothing."""
        if self._is_open:
            self._is_open = False
            self._close()

    @entering
    def __enter__(self) -> Self:
        """Open the camera and return it."""
        return self.open()

    @uninterrupted
    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the camera."""
        self.close()

    def _checked(self, settings: Sequence[ExposureSetting]) -> tuple[ExposureSetting, ...]:
        """Return settings that the camera has, which is ready to shoot them."""
        self._check_ready()
        controls = self.controls
        for setting in settings:
            controls.check(setting)
        return tuple(settings)

    def _shoot(self, settings: tuple[ExposureSetting, ...]) -> Generator[Frame, None, None]:
        self._check_ready()
        self._is_shooting = True
        try:
            yield from self._frames(settings)
        finally:
            self._is_shooting = False

    def _check_open(self) -> None:
        if not self._is_open:
            raise self._not_open()

    def _check_ready(self) -> None:
        self._check_open()
        if self._is_shooting:
            raise CameraBusyError(
                f"{self._name} is still shooting", hint="finish or close that sequence first"
            )

    def _not_open(self) -> CameraClosedError:
        return CameraClosedError(f"{self._name} is not open", hint="open it first")


_BUSY_PAUSES_S = (0.1, 0.2, 0.4, 0.8, 1.6)
"""Pauses before a busy camera is asked again: together longer than a raw file is being saved."""


def shoot_when_ready(camera: Camera, settings: Sequence[ExposureSetting]) -> Generator[Frame]:
    """Yield the frames of `camera.shoot(settings)`; a camera that is busy is asked again.

    Raises:
        CameraBusyError: it is still busy after 3 s
    """
    frames, first = when_ready(camera.clock, lambda: _begun(camera, settings))
    with closing(frames):
        yield first
        yield from frames


def when_ready(clock: Clock, ask: Callable[[], AnswerT]) -> AnswerT:
    """Return what `ask` returns; it is called again for 3 s while it raises `CameraBusyError`."""
    for pause_s in _BUSY_PAUSES_S:
        try:
            return ask()
        except CameraBusyError:
            check_cancelled()
            clock.sleep_until(clock.now() + pause_s)
    return ask()


def _begun(camera: Camera, settings: Sequence[ExposureSetting]) -> tuple[FrameStream, Frame]:
    frames = camera.shoot(settings)
    return frames, next(frames)
