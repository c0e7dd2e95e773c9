"""A detector of ophyd-async: bluesky's RunEngine takes single captures, or results of a stream.

Radiance, its standard deviation and the mask are streamed assets in a file of HDF5; their mean, the
deviation of it, and what is out of range are readings.  Needs the extra ``bluesky``.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import h5py
import numpy as np
from bluesky.protocols import Reading
from event_model import DataKey
from numpy.typing import NDArray
from ophyd_async.core import (
    DEFAULT_TIMEOUT,
    AsyncStatus,
    DetectorAcquireLogic,
    DetectorDataLogic,
    DetectorTriggerLogic,
    DeviceMock,
    NotConnectedError,
    PathProvider,
    ReadableDataProvider,
    SignalRW,
    StandardDetector,
    StreamableDataProvider,
    StreamResourceDataProvider,
    StreamResourceInfo,
    TriggerInfo,
    WatchableAsyncStatus,
    soft_signal_r_and_setter,
)

import camctl
from camctl.messages.plain import sentence

#: What is in the file, by the suffix of its data key: name of the dataset, type of its samples.
_DATASETS: Final[dict[str, tuple[str, np.dtype[Any]]]] = {
    "": ("radiance", np.dtype("<f4")),
    "-sd": ("sd", np.dtype("<f4")),
    "-mask": ("mask", np.dtype("u1")),
}


@dataclass(frozen=True)
class _Picture:
    """Radiance, standard deviation and mask in one shape, and sentences on them."""

    radiance: NDArray[np.float32]
    sd: NDArray[np.float32]
    mask: NDArray[np.uint8]
    findings: tuple[str, ...]


@dataclass
class _Pictures:
    """The camera: opened with the detector, and asked for one picture after the other.

    Its methods block, and are called in threads, by one at a time; `cancel` by any.
    """

    camera_id: str
    options: Mapping[str, Any]
    request: camctl.CaptureRequest
    is_live: bool
    fps: float | None
    count = 0  # of pictures for the next start
    livetime_s = 0.0

    def __post_init__(self) -> None:
        self._camera: camctl.Camera | None = None
        self._live: camctl.Live | None = None
        self.is_cancelled = threading.Event()

    @property
    def camera(self) -> camctl.Camera:
        """The open camera; raises `CameraDisconnectedError` before `open`."""
        if self._camera is None:
            raise camctl.CameraDisconnectedError(
                f"{self.camera_id} is not open", hint="connect the detector"
            )
        return self._camera

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the radiance: single captures give R, G and B of a mosaic, too."""
        controls = self.camera.controls
        is_colour = controls.layout is camctl.Layout.RGB or (
            controls.layout.is_mosaic and not self.is_live
        )
        return (*controls.shape, 3) if is_colour else tuple(controls.shape)

    def open(self) -> None:
        """Open the camera, again where it is open."""
        self.close()
        self._camera = camctl.open_camera(self.camera_id, self.options).__enter__()

    def close(self) -> None:
        """End the stream and close the camera."""
        self.cancel()
        camera, self._camera = self._camera, None
        if camera is not None:
            camera.close()

    def cancel(self) -> None:
        """End what runs as soon as the camera lets it; the next picture begins another stream."""
        self.is_cancelled.set()
        live, self._live = self._live, None
        if live is not None:
            live.close()

    def next(self, *, is_first: bool) -> _Picture:
        """Return a picture.

        Args:
            is_first: after a trigger: nothing in it was exposed earlier than this call
        """
        picture = self._result(is_first) if self.is_live else self._captured()
        if self.is_cancelled.is_set():
            raise camctl.InterruptedCaptureError("the exposure was stopped")
        return picture

    def _captured(self) -> _Picture:
        request = self.request
        if self.livetime_s:
            request = replace(request, time_budget_s=self.livetime_s)
        report = camctl.capture(self.camera, request, cancelled=self.is_cancelled.is_set)
        radiance, sd = report.radiance(), report.standard_deviation()
        return _Picture(radiance, sd, report.mask(), tuple(report.warnings))

    def _result(self, is_first: bool) -> _Picture:
        camera = self.camera
        if self._live is None:
            fps = 1 / self.livetime_s if self.livetime_s else self.fps
            self._live = camctl.live(camera, self.request, fps=fps)
        triggered_s = camera.clock.now()
        for result in self._live:
            begun = (each.timestamp_s - each.setting.time_s for each in result.exposures)
            if is_first and min(begun) < triggered_s:
                continue  # a thing that was moved before the trigger must not lag in it
            findings = tuple(map(sentence, result.findings))
            return _Picture(result.irradiance, result.sd, result.mask, findings)
        raise camctl.InterruptedCaptureError("the stream was stopped")


class _FileLogic(DetectorDataLogic):
    """Pictures one after the other in a file of HDF5, which others read while it grows."""

    def __init__(self, pictures: _Pictures, paths: PathProvider) -> None:
        self._pictures, self._paths = pictures, paths
        self.count, self.set_count = soft_signal_r_and_setter(int)
        self._file: h5py.File | None = None

    async def prepare_unbounded(self, datakey_name: str) -> StreamableDataProvider:
        """Begin a file; raises `StorageError` where it exists, or cannot be made."""
        info, shape = self._paths(datakey_name), self._pictures.shape
        name, folder = f"{info.filename}.h5", Path(info.directory_path)
        for parent in reversed([folder, *folder.parents][: info.create_dir_depth]):
            parent.mkdir(exist_ok=True)
        await asyncio.to_thread(self._open, folder / name, shape)
        resources = [
            StreamResourceInfo(
                data_key=datakey_name + suffix,
                shape=shape,
                chunk_shape=(1, *shape),
                dtype_numpy=dtype.str,
                parameters={"dataset": f"/{dataset}"},
            )
            for suffix, (dataset, dtype) in _DATASETS.items()
        ]
        return StreamResourceDataProvider(
            f"{info.directory_uri}{name}", resources, "application/x-hdf5", self.count
        )

    def _open(self, path: Path, shape: tuple[int, ...]) -> None:
        try:
            self._file = file = h5py.File(path, "x", libver="latest")
        except OSError as error:
            raise camctl.StorageError(
                f"cannot make {path}: {error.strerror or error}", hint="name another file"
            ) from error
        for name, dtype in _DATASETS.values():
            most = (None, *shape)
            file.create_dataset(name, (0, *shape), dtype, maxshape=most, chunks=(1, *shape))
        file.swmr_mode = True
        self.set_count(0)

    def write(self, picture: _Picture) -> int:
        """Add a picture; return how many there are."""
        assert self._file is not None  # it was opened when the detector was prepared
        for name, _ in _DATASETS.values():
            dataset = self._file[name]
            count = len(dataset) + 1
            dataset.resize(count, axis=0)
            dataset[-1] = getattr(picture, name)
            dataset.flush()
        return count

    async def stop(self) -> None:
        """End the file."""
        file, self._file = self._file, None
        if file is not None:
            await asyncio.to_thread(file.close)


class _TriggerLogic(DetectorTriggerLogic):
    def __init__(self, pictures: _Pictures) -> None:
        self._pictures = pictures

    async def prepare_internal(self, num: int, livetime: float, deadtime: float) -> None:
        """Note how many pictures are wanted, and how long each may take."""
        if deadtime:
            raise ValueError("a deadtime cannot be chosen: pictures follow one another at once")
        self._pictures.livetime_s, self._pictures.count = livetime, num

    async def default_trigger_info(self) -> TriggerInfo:
        """Return one picture, as long as the light asks for."""
        return TriggerInfo()


class _ReadingLogic(DetectorDataLogic, ReadableDataProvider):
    """What a picture says in a few numbers, as children of the detector."""

    def __init__(self) -> None:
        types = dict.fromkeys(("mean", "rms_sd", "saturated", "dark"), float) | {"findings": str}
        made = {name: soft_signal_r_and_setter(type_) for name, type_ in types.items()}
        self.signals = {name: signal for name, (signal, _) in made.items()}
        self._setters = {name: setter for name, (_, setter) in made.items()}

    def show(self, picture: _Picture) -> None:
        """Set the readings."""
        is_good = (picture.mask & 3) == 0  # neither dark nor saturated
        values = {
            "mean": _mean(picture.radiance[is_good].astype(float)),
            "rms_sd": _mean(picture.sd[is_good].astype(float) ** 2) ** 0.5,
            "saturated": _mean((picture.mask & 2) != 0),
            "dark": _mean((picture.mask & 1) != 0),
            "findings": "; ".join(picture.findings),
        }
        for name, value in values.items():
            self._setters[name](value)

    async def prepare_single(self, datakey_name: str) -> ReadableDataProvider:
        """Return the numbers of the last picture."""
        return self

    async def make_datakeys(self) -> dict[str, DataKey]:
        """Describe them."""
        return {k: v for each in self.signals.values() for k, v in (await each.describe()).items()}

    async def make_readings(self) -> dict[str, Reading[Any]]:
        """Read them."""
        return {k: v for each in self.signals.values() for k, v in (await each.read()).items()}

    def get_hinted_fields(self, datakey_name: str) -> Sequence[str]:
        """Return the reading that tables and plots show."""
        return [self.signals["mean"].name]


def _mean(values: NDArray[Any]) -> float:
    """Return the mean; NaN of no values."""
    return float(values.mean()) if values.size else float("nan")


class _AcquireLogic(DetectorAcquireLogic):
    """Takes pictures in a thread of its own; the task fails with what the camera says."""

    def __init__(
        self,
        pictures: _Pictures,
        file: _FileLogic,
        readings: _ReadingLogic,
        events: SignalRW[int],
    ) -> None:
        self._pictures, self._events = pictures, events
        self._file, self._readings = file, readings
        self.task: asyncio.Task[None] | None = None
        self._needs_opening = False

    async def ensure_ready(self) -> None:
        """End what runs; open a camera again that was unplugged."""
        await self.ensure_stopped()
        if self._needs_opening:
            await asyncio.to_thread(self._pictures.open)
            self._needs_opening = False

    async def start_acquiring(self) -> None:
        """Begin to take pictures; in a step scan, wait for them: a capture has no time limit."""
        self._pictures.is_cancelled.clear()
        self.task = asyncio.create_task(self._take(self._pictures.count))
        if await self._events.get_value() == 1:
            await asyncio.shield(self.task)

    async def while_taking(self, status: WatchableAsyncStatus[int]) -> None:
        """Wait for a status while pictures are taken; raises at once where that fails."""
        if self.task is not None:
            await asyncio.wait([self.task, status.task], return_when=asyncio.FIRST_EXCEPTION)
            if self.task.done() and (error := self.task.exception()) is not None:
                status.task.cancel()
                raise error
        await status

    async def _take(self, count: int) -> None:
        try:
            for number in range(count):
                picture = await asyncio.to_thread(self._pictures.next, is_first=number == 0)
                written = await asyncio.to_thread(self._file.write, picture)
                self._readings.show(picture)
                self._file.set_count(written)
        except camctl.CameraDisconnectedError:
            self._needs_opening = True
            raise

    async def wait_for_idle(self) -> None:
        """Wait for the last picture; raises what the camera says."""
        if self.task is not None:
            await self.task

    async def ensure_stopped(self) -> None:
        """Abort the exposure that runs, and end the stream."""
        task, self.task = self.task, None
        if task is not None:
            self._pictures.cancel()
            await asyncio.gather(task, return_exceptions=True)  # its error was raised by trigger
        await asyncio.to_thread(self._pictures.cancel)  # a stream that began meanwhile


class CamctlDetector(StandardDetector):
    """A camera of camctl as a detector of bluesky's RunEngine.

    The data keys ``NAME``, ``NAME-sd`` and ``NAME-mask`` are streamed assets; ``NAME-mean`` (of
    the samples in range), ``NAME-rms_sd``, ``NAME-saturated`` and ``NAME-dark`` (shares) and
    ``NAME-findings`` are readings of step scans.  The livetime of a `TriggerInfo` is the longest
    time that a picture may take.  A picture of a stream after a trigger has no exposure that began
    before it; those of a fly scan overlap.

    Args:
        camera_id: see `camctl.open_camera`; `connect` opens it
        path_provider: names the file
        request: what the pictures are to be; None: the defaults
        is_live: results of `camctl.live`, instead of captures
        fps: results a second at least, of a stream
        options: of the camera
        name: of the detector
    """

    def __init__(
        self,
        camera_id: str,
        path_provider: PathProvider,
        request: camctl.CaptureRequest | None = None,
        *,
        is_live: bool = False,
        fps: float | None = None,
        options: Mapping[str, Any] | None = None,
        name: str = "",
    ) -> None:
        request = request or camctl.CaptureRequest()
        self._pictures = _Pictures(camera_id, options or {}, request, is_live, fps)
        file, readings = _FileLogic(self._pictures, path_provider), _ReadingLogic()
        events = self.events_to_kickoff
        self._acquire = _AcquireLogic(self._pictures, file, readings, events)
        self.count = file.count
        for each, signal in readings.signals.items():
            setattr(self, each, signal)
        self.camera_id, _ = soft_signal_r_and_setter(str, camera_id)
        self.response, _ = soft_signal_r_and_setter(str, request.response)
        self.add_detector_logics(_TriggerLogic(self._pictures), self._acquire, file, readings)
        self.add_config_signals(self.camera_id, self.response)
        super().__init__(name=name)

    async def connect(
        self,
        mock: bool | DeviceMock[Any] = False,
        timeout: float = DEFAULT_TIMEOUT,
        force_reconnect: bool = False,
    ) -> None:
        """Open the camera; a mock opens none."""
        if not mock:
            try:
                await asyncio.to_thread(self._pictures.open)
            except camctl.CamctlError as error:
                raise NotConnectedError(str(error)) from error
        await super().connect(mock, timeout, force_reconnect)

    async def disconnect(self) -> None:
        """Close the camera."""
        await self._acquire.ensure_stopped()
        await asyncio.to_thread(self._pictures.close)

    def complete(self) -> Any:
        """Wait for the pictures of a fly scan; fails at once with what the camera says."""
        return AsyncStatus(self._acquire.while_taking(super().complete()), self.name)
