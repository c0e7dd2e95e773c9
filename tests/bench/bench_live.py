"""The live effective camera: results a second, the sum against memcpy, latency, truth, memory.

    OMP_NUM_THREADS=1 python tests/bench/bench_live.py [speed|sum|truth|memory]

speed: 1920 x 1080, three exposures, 8 bits, mono, YUYV (whose luma the V4L2 driver takes; its noise
is not known) and RGB, frames that a camera in memory has ready: results a second with irradiance,
mask and a picture of 960 x 540 as JPEG; and from a camera of 30 frames a second: results a second,
added latency (at most a frame interval + 15 ms).  sum: S += new - old
alone, by numpy and compiled (extra `fast`), against a copy (memcpy) that moves as many bytes.
truth: 10^6 frames of a stream that loses frames, sets exposures late and exchanges lists; each sum
is compared with that of the frames' true exposures, and the marks of older slots with the true
slots: a wrong sum, or an older slot without a mark, is an error.  memory: of 10^5 results.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from random import Random
from typing import Any, Self
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "helpers"))

from cycle_stream import CycleStream

import camctl
from camctl.drivers.v4l2.packing import FIRST_OF_TWO
from camctl.exposure.goal import CaptureRequest
from camctl.interface.camera import CameraInfo, CyclePlace, Frame
from camctl.interface.clock import Clock, RealClock, VirtualClock
from camctl.interface.controls import (
    ExposureControls,
    ExposureSetting,
    Layout,
    ResponseOrigin,
    Steps,
)
from camctl.interface.cycle import CycleMethod
from camctl.livestream.display import Display
from camctl.livestream.window import Window
from camctl.model.noise import NoiseModel
from camctl.pictures import accumulator
from camctl.pictures.accumulator import Accumulator
from camctl.pictures.compiled_sum import load
from camctl.streaming import ControlDelay, DelayOrigin, ExposureCycle
from camctl.system.compiled_functions import LoadedLater
from camctl.system.picture_operations import required_opencv

SHAPE = 1080, 1920
SETTINGS = tuple(ExposureSetting(time_s) for time_s in (0.001, 0.005, 0.03))
KINDS = "mono", "yuyv", "rgb"
REQUEST = CaptureRequest(base_s=0.001, ratios=(1, 5, 30), dynamic_range=256)


class FastCamera:
    """A camera whose frames are ready: each exposure has some, made before.

    Args:
        kind: mono, yuyv or rgb
        interval_s: between two frames, s; 0: as fast as they are taken, in virtual time
    """

    def __init__(self, kind: str, interval_s: float, shape: tuple[int, int] = SHAPE) -> None:
        layout = Layout.RGB if kind == "rgb" else Layout.MONO
        self.info = CameraInfo("fast", "", "fast", "", "bench")
        self.clock: Clock = RealClock() if interval_s else VirtualClock()
        self.interval_s = interval_s
        self.controls = ExposureControls(
            time_s=Steps(1e-4, 1.0, 1e-4),
            shape=shape,
            layout=layout,
            bits=8,
            white=255,
            response_origin=ResponseOrigin.STATED,
            frame_interval_s=interval_s or 1 / 30,
            noise=None if kind == "yuyv" else NoiseModel(40.0, ((1.0, 8.0),)),
            delay_frames=2,
            sensitivity=1000.0,
        )
        random = np.random.default_rng(0)
        colours = (3,) if layout is Layout.RGB else ()
        light = np.geomspace(0.01, 0.9, shape[0] * shape[1], dtype=np.float32).reshape(shape)
        light = np.repeat(light[..., None], 3, axis=2) if colours else light
        self.frames = {
            each: [self._made(light * each.time_s * 1000, random) for _ in range(3)]
            for each in SETTINGS
        }
        self._packing = FIRST_OF_TWO if kind == "yuyv" else None
        if self._packing is not None:  # bytes of luma and chroma, as the camera sends them
            for each, made in self.frames.items():
                packed = [np.stack([luma, np.full_like(luma, 128)], axis=-1) for luma in made]
                self.frames[each] = [frame.reshape(-1) for frame in packed]

    def pixels(self, setting: ExposureSetting, number: int) -> Any:
        """Return the samples of a frame, as its driver makes them."""
        found = self.frames[setting][number % 3]
        if self._packing is None:
            return found
        return self._packing.samples(found, self.controls.shape)

    def _made(self, light: Any, random: Any) -> Any:
        electrons = random.poisson(np.minimum(light, 1.2) * 256 * 40).astype(np.float32)
        electrons += random.normal(0, 8, light.shape).astype(np.float32)
        return np.clip(electrons / 40, 0, 255).astype(np.uint8)

    def shoot(self, settings: Sequence[ExposureSetting]) -> Any:
        raise NotImplementedError

    def cycle(self, settings: Sequence[ExposureSetting]) -> FastCycle:
        return FastCycle(self, settings)

    def close(self) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class FastCycle:
    method = CycleMethod.SEQUENCER

    def __init__(self, camera: FastCamera, settings: Sequence[ExposureSetting]) -> None:
        self._camera, self._settings, self._number = camera, tuple(settings), 0
        self._next_s = camera.clock.now()

    def __iter__(self) -> Iterator[Frame]:
        return self

    def __next__(self) -> Frame:
        camera, number = self._camera, self._number
        index = number % len(self._settings)
        setting = self._settings[index]
        self._next_s += camera.interval_s or 1 / 30
        camera.clock.sleep_until(self._next_s)
        late = int((camera.clock.now() - self._next_s) / (camera.interval_s or 1))
        self._next_s += late * camera.interval_s  # lost, as in the queue of a driver
        self._number += 1 + late
        nearest = min(camera.frames, key=lambda each: abs(each.time_s - setting.time_s))
        pixels = camera.pixels(nearest, number // len(self._settings))
        place = CyclePlace(number, 0)
        return Frame(pixels, setting, setting, self._next_s, index, 0, 255, place=place)

    def exchange(self, settings: Sequence[ExposureSetting]) -> int:
        raise NotImplementedError

    def close(self) -> None:
        pass


def speed() -> None:
    cv2 = required_opencv("the bench")
    for kind in KINDS:
        for interval_s in (0.0, 1 / 30):
            camera = FastCamera(kind, interval_s)
            display, latencies, count = Display(look=True, most=960), [], 0
            with camctl.live(camera, REQUEST, reuse=True) as live:
                for _ in range(20):  # tables and limits are made
                    one = next(live)
                    _ = one.irradiance, one.mask
                began = time.perf_counter()
                processor = time.process_time()
                while time.perf_counter() - began < 6:
                    one = next(live)
                    _ = one.irradiance, one.mask
                    picture = display.picture(one)
                    cv2.imencode(".jpg", picture)
                    latencies.append(camera.clock.now() - one.time_s)
                    count += 1
                seconds = time.perf_counter() - began
                busy = (time.process_time() - processor) / seconds
                lost = live.lost
            source = "frames ready" if interval_s == 0 else "30 frames a second"
            late = "" if interval_s == 0 else f", latency {np.median(latencies) * 1e3:.0f} ms"
            late += (
                "" if interval_s == 0 else f" (95 %: {np.percentile(latencies, 95) * 1e3:.0f} ms)"
            )
            print(
                f"{kind}, {source}: {count / seconds:.1f} results a second on "
                f"{busy:.2f} processors, {lost} frames lost{late}",
                flush=True,
            )


def sum_against_copy() -> None:
    for name, is_compiled in (("numpy", False), ("compiled", True)):
        with mock.patch.object(accumulator, "CHOICE", LoadedLater(load, 1, is_compiled)):
            _sum_against_copy(name)


def _sum_against_copy(name: str) -> None:
    random = np.random.default_rng(0)
    # More than a cache holds: the frames of a stream come from memory.
    frames = [random.integers(0, 256, SHAPE, np.uint8) for _ in range(16)]
    total = Accumulator(SHAPE, np.dtype(np.uint8), 16, 255)
    total.accumulate(frames[0])
    # Two frames and the sum are read, the sum is written: as many bytes as a copy of half of them.
    half = (2 * frames[0].nbytes + 2 * total.total.nbytes) // 2
    buffers = [np.full(half, k, np.uint8) for k in range(16)]
    sums, copies = [], []
    for number in range(160):
        old, new = frames[number % 16], frames[(number + 1) % 16]
        began = time.perf_counter()
        total.exchange(old, new)
        sums.append(time.perf_counter() - began)
        began = time.perf_counter()
        np.copyto(buffers[(number + 1) % 16], buffers[number % 16])
        copies.append(time.perf_counter() - began)
    sum_s, copy_s = min(sums), min(copies)
    times = f"{sum_s * 1e3:.2f} ms, copy {copy_s * 1e3:.2f} ms"
    print(f"sum by {name} {times}: {copy_s / sum_s:.2f} of it")


def truth(frames: int = 1_000_000) -> None:
    """Compare sums of one pixel whose value is the true exposure of its frame."""
    random = Random(1)
    controls = ExposureControls(
        time_s=Steps(1.0, 255.0, 1.0),
        shape=(1, 1),
        layout=Layout.MONO,
        bits=8,
        white=255,
        response_origin=ResponseOrigin.STATED,
    )
    settings = [ExposureSetting(float(time_s)) for time_s in (3, 17, 40, 71, 120)]
    wrong = results = stale = exchanged = unmarked = needless = 0
    received = 0
    while received < frames:
        stream = CycleStream(
            random.randint(-1, 4), random, lost=0.02, damaged=0.005, missed=0.03, spanning=0.02,
            uncertain=0.001,
        )  # fmt: skip
        delay = stream._delay
        known = ControlDelay(delay, delay, DelayOrigin.GUARANTEED)
        lists = {0: random.sample(settings, 3)}
        cycle = ExposureCycle(stream, known, None, lists[0])
        window = Window(controls)
        shots = cycle.shots()
        while stream.received < min(50_000, frames):
            if random.random() < 0.002:
                chosen = random.sample(settings, random.randint(1, 5))
                lists[cycle.exchange(chosen)] = chosen
                exchanged += 1
            shot, requested = next(shots)
            place = shot.place
            assert place is not None
            slot, true = shot.data  # which the driver does not know
            pixels = np.full((1, 1), int(true.time_s), np.uint8)
            frame = Frame(
                pixels, requested, shot.applied, float(slot), shot.index, 0, 255, place=place
            )
            window.add(frame, len(lists[place.plan]))
            if not window.is_complete:
                continue
            results += 1
            states = window.states(controls)
            held = window.frames
            is_older = [slot - each.timestamp_s >= len(held) for each in held]
            marks = [each.is_old for each in states]
            stale += any(is_older)
            unmarked += any(old > mark for old, mark in zip(is_older, marks, strict=True))
            needless += any(old < mark for old, mark in zip(is_older, marks, strict=True))
            stated = sum(int(each.setting.time_s) for each in states)
            wrong += int(window.total[0, 0]) != stated
        received += stream.received
    print(
        f"{received} frames, {results} results, {exchanged} lists exchanged, {stale} results with "
        f"an older slot, of which {stale - unmarked} are marked and {unmarked} not; {needless} "
        f"with a mark too many, after numbers that were wrong; {wrong} wrong sums"
    )
    if unmarked or wrong:
        sys.exit("some results do not state what they are")


def memory(results: int = 100_000) -> None:
    camera = FastCamera("mono", 0.0, (48, 64))
    used = []
    with camctl.live(camera, REQUEST, reuse=True) as live:
        for number in range(results):
            one = next(live)
            _ = one.irradiance, one.mask, one.sd
            if number % (results // 10) == results // 10 - 1:
                used.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
    print(
        f"{results} results: peak memory {used[0]:.1f} MB after a tenth, {used[-1]:.1f} at the end"
    )


PARTS = {
    "speed": speed,
    "sum": sum_against_copy,
    "truth": truth,
    "memory": memory,
}

if __name__ == "__main__":
    for name in sys.argv[1:] or PARTS:
        PARTS[name]()
