"""GenICam devices through viva-genicam, a Python package with wheels."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np

from camctl.drivers.genicam.port import (
    CHUNKS,
    FeatureError,
    FoundDevice,
    Kind,
    Limits,
    PacketCounts,
    Received,
    Value,
    in_use,
    lost_control,
)
from camctl.errors import CameraError, CameraNotFoundError

_SEARCH_MS = 500  # of the network
_TAKING_MS = 20  # that it waits for a frame before it looks whether the stream is to stop
#: Of a camera's clock: ns in GigE Vision 2 and USB3 Vision, while GigE Vision 1 states it.
_TICKS_PER_S, _TICK_RATE = 1e9, "GevTimestampTickFrequency"
#: By the first word of its names of kinds of nodes.
_KINDS = {
    "Integer": Kind.INTEGER,
    "IntConverter": Kind.INTEGER,
    "Float": Kind.FLOAT,
    "Converter": Kind.FLOAT,
    "SwissKnife": Kind.FLOAT,
    "Enumeration": Kind.ENUMERATION,
    "Boolean": Kind.BOOLEAN,
    "Command": Kind.COMMAND,
    "String": Kind.TEXT,
    "StringReg": Kind.TEXT,
}
#: Words in its errors after which the device is gone: nothing else tells them apart.
_GONE = (
    "timeout",
    "timed out",
    "failed: io:",
    "not held",
    "lost control",
    "disconnected",
    "no device",
)


class VivaLibrary:
    """Finds and opens devices; a `camctl.drivers.genicam.port.Library`.

    Args:
        package: the module viva_genicam
    """

    name = "viva"

    def __init__(self, package: Any) -> None:
        self._package = package
        self._handles: dict[str, Any] = {}

    def search(self) -> Sequence[FoundDevice]:
        package = self._package
        found = []
        for each in package.discover(timeout_ms=_SEARCH_MS, all=True):
            self._handles[each.ip] = each
            found.append(
                FoundDevice(
                    each.ip, each.manufacturer or "", each.model or "", "", each.ip, "GigE Vision"
                )
            )
        with suppress(package.GenicamError):  # this system has no USB
            for each in package.discover_u3v():
                name = f"usb-{each.bus}-{each.address}"
                self._handles[name] = each
                make, model, serial = each.manufacturer or "", each.model or "", each.serial or ""
                found.append(FoundDevice(name, make, model, serial, "", "USB3 Vision"))
        return found

    def open(self, device: FoundDevice) -> VivaDevice:
        package = self._package
        if device.name not in self._handles:
            self.search()
        handle = self._handles.get(device.name)
        if handle is None:
            raise CameraNotFoundError(
                f"{device.name} does not answer", hint="check its cable and its power"
            )
        connect = (
            package.connect_u3v if device.transport.startswith("USB") else package.connect_gige
        )
        try:
            return VivaDevice(package, connect(handle), device.name)
        except package.GenicamError as error:
            if "denied" in str(error).lower():
                raise in_use(device.name) from error
            raise CameraNotFoundError(
                f"{device.name} cannot be opened: {error}", hint="check its cable and its power"
            ) from error


class VivaDevice:
    """An open device; a `camctl.drivers.genicam.port.OpenDevice`."""

    def __init__(self, package: Any, camera: Any, name: str) -> None:
        self._package = package
        self._camera = camera
        self._name = name
        self._stream: Any = None
        self._arrived: queue.Queue[tuple[Any, float]] = queue.Queue()
        self._taking = threading.Event()
        self._missing = self._resent = 0  # of the streams before
        self._counts = PacketCounts(0, 0)
        self._ticks_per_s = _TICKS_PER_S

    # ---- features

    def kind(self, name: str) -> Kind | None:
        try:
            state = self._camera.feature_state(name)
        except self._package.GenicamError as error:
            self._check_gone(error)
            return None
        return _KINDS.get(state.kind) if state.is_available and state.is_implemented else None

    def read(self, name: str) -> Value:
        value = self._state(name).value
        if value is None:
            raise FeatureError(f"{self._name} does not state {name}", hint="choose another camera")
        return value  # type: ignore[no-any-return]

    def write(self, name: str, value: Value) -> None:
        kind, camera = _KINDS.get(self._state(name).kind), self._camera
        with self._errors(name):
            if kind is Kind.INTEGER:
                camera.set_integer(name, round(float(value)))
            elif kind is Kind.FLOAT:
                camera.set_float(name, float(value))
            elif kind is Kind.BOOLEAN:
                camera.set_bool(name, bool(value))
            elif kind is Kind.ENUMERATION:
                camera.set_enum(name, str(value))
            else:
                camera.set_string(name, str(value))

    def execute(self, name: str) -> None:
        with self._errors(name):
            self._camera.execute(name, wait=False)

    def limits(self, name: str) -> Limits:
        state = self._state(name)
        if state.range is None:
            raise FeatureError(f"{self._name} states no range of {name}", hint="choose another")
        is_integer = _KINDS.get(state.kind) is Kind.INTEGER
        step = state.range.inc or (1.0 if is_integer else 0.0)
        return Limits(state.range.min, state.range.max, step)

    def entries(self, name: str) -> Sequence[str]:
        with self._errors(name):
            return list(self._camera.available_enum_entries(name))

    def unit(self, name: str) -> str:
        return self._state(name).unit or ""

    def description(self) -> str:
        return str(self._camera.xml)

    def _state(self, name: str) -> Any:
        with self._errors(name):
            return self._camera.feature_state(name)

    @contextmanager
    def _errors(self, name: str) -> Iterator[None]:
        try:
            yield
        except self._package.GenicamError as error:
            self._check_gone(error)
            raise FeatureError(
                f"{self._name} refuses {name}: {error}", hint="its present state does not allow it"
            ) from error

    def _check_gone(self, error: Exception) -> None:
        if any(word in str(error).lower() for word in _GONE):
            raise lost_control(self._name, str(error)) from error

    # ---- frames

    def start(self, buffers: int) -> None:
        if self.kind(_TICK_RATE) is Kind.INTEGER:
            self._ticks_per_s = float(self.read(_TICK_RATE)) or _TICKS_PER_S
        with self._errors("a stream"):
            self._stream = self._camera.stream(deliver_incomplete=True)
            self._stream.__enter__()
        self._arrived = queue.Queue(buffers)
        self._taking.set()
        self._taker = threading.Thread(target=self._take, args=(self._stream,), daemon=True)
        self._taker.start()

    def stop(self) -> None:
        stream, self._stream = self._stream, None
        if stream is None:
            return
        self._taking.clear()
        self._taker.join()
        self._missing, self._resent = self._counts.missing, self._counts.resent
        with self._errors("AcquisitionStop"):
            stream.__exit__(None, None, None)

    def _take(self, stream: Any) -> None:
        """Take frames from the package, which keeps a few and drops others, until the stop."""
        while self._taking.is_set():
            try:
                found = stream.next_frame(_TAKING_MS)
            except self._package.GenicamError as error:
                if "waiting for frame" in str(error):
                    continue
                found = error
            self._counts = PacketCounts(*self._totals(stream))
            with suppress(queue.Full):  # the newest is lost, and its number is missing
                self._arrived.put_nowait((found, time.monotonic()))
            if found is None or isinstance(found, Exception):
                return

    def receive(self, timeout_s: float) -> Received | None:
        try:
            frame, arrived_s = self._arrived.get(timeout=timeout_s)
        except queue.Empty:
            return None
        if frame is None:
            raise lost_control(self._name, "the stream has ended")
        if isinstance(frame, Exception):
            raise lost_control(self._name, str(frame)) from frame
        is_complete = bool(frame.is_complete)
        return Received(
            data=np.frombuffer(frame.payload() if is_complete else b"", np.uint8),
            shape=(frame.height, frame.width),
            code=frame.pixel_format_code,
            line_padding=frame.padding_x,
            number=frame.block_id,
            arrived_s=arrived_s,
            stamp_s=(frame.ts_dev or 0) / self._ticks_per_s,
            is_complete=is_complete,
            chunks=self._chunks(frame) if is_complete else {},
        )

    def packets(self) -> PacketCounts:
        return self._counts

    def close(self) -> None:
        with suppress(CameraError):  # it is gone, or stops without the command
            self.stop()
        with suppress(self._package.GenicamError):
            self._camera.close()

    def _totals(self, stream: Any) -> tuple[int, int]:
        found = stream.stats()
        missing = self._missing + found.packets_missing
        return missing, self._resent + found.resend_recovered

    def _chunks(self, frame: Any) -> dict[str, float]:
        if not frame.chunks:
            return {}
        found = {}
        for name, value in self._camera.chunk_features(frame).items():
            with suppress(ValueError, TypeError):  # text, or an error of this chunk
                if name.removeprefix("Chunk") in CHUNKS:
                    found[name.removeprefix("Chunk")] = float(value)
        return found
