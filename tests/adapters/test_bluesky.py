"""The detector of ophyd-async, judged by bluesky's RunEngine, and its files by h5py."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import pytest

import camctl

if TYPE_CHECKING:
    from bluesky.run_engine import RunEngine

    from camctl.adapters.bluesky import CamctlDetector

pytestmark = pytest.mark.skipif(
    find_spec("ophyd_async") is None, reason="ophyd-async is not installed"
)

GIVEN = camctl.CaptureRequest(base_s=0.002, ratios=(1, 4, 16), dynamic_range=256)
DATASETS = {"camera": "/radiance", "camera-sd": "/sd", "camera-mask": "/mask"}

Documents = list[tuple[str, dict[str, Any]]]


@pytest.fixture(scope="module")
def engine() -> Iterator[RunEngine]:
    from bluesky.run_engine import RunEngine

    # Without handlers of signals: pytest has its own.
    made = RunEngine(context_managers=[])
    yield made
    made.loop.call_soon_threadsafe(made.loop.stop)


@pytest.fixture
def detector(engine: RunEngine, tmp_path: Path) -> Iterator[Callable[..., CamctlDetector]]:
    from bluesky import plan_stubs as bps
    from ophyd_async.core import StaticPathProvider, UUIDFilenameProvider, init_devices

    from camctl.adapters.bluesky import CamctlDetector

    made: list[CamctlDetector] = []

    def make(is_live: bool = False, **options: Any) -> CamctlDetector:
        chosen = {"scene": "ramp", "size": "64x48", **options}
        paths = StaticPathProvider(UUIDFilenameProvider(), tmp_path)
        with init_devices():
            camera = CamctlDetector("sim", paths, GIVEN, is_live=is_live, options=chosen)
        made.append(camera)
        return camera

    yield make

    def disconnect() -> Iterator[Any]:
        for each in made:
            yield from bps.wait_for([each.disconnect])

    engine(disconnect())


def run(engine: RunEngine, plan: Any) -> Documents:
    documents: Documents = []
    engine(plan, lambda name, document: documents.append((name, document)))
    return documents


def assets(documents: Documents) -> dict[str, Any]:
    """Return the arrays that the streamed documents name, as a reader of them does."""
    import h5py

    resources = {each["uid"]: each for name, each in documents if name == "stream_resource"}
    found: dict[str, list[Any]] = {}
    for name, datum in documents:
        if name != "stream_datum":
            continue
        resource = resources[datum["stream_resource"]]
        assert resource["mimetype"] == "application/x-hdf5"
        with h5py.File(urlsplit(resource["uri"]).path) as file:
            rows = slice(datum["indices"]["start"], datum["indices"]["stop"])
            dataset = file[resource["parameters"]["dataset"]]
            assert dataset.chunks == tuple(resource["parameters"]["chunk_shape"])
            found.setdefault(resource["data_key"], []).append(dataset[rows])
    return {key: np.concatenate(rows) for key, rows in found.items()}


@pytest.mark.parametrize("is_live", [False, True])
def test_a_count_has_radiance_and_deviation_of_each_picture(
    engine: RunEngine, detector: Callable[..., CamctlDetector], is_live: bool
) -> None:
    from bluesky import plans as bp

    camera = detector(is_live)
    documents = run(engine, bp.count([camera], num=3))
    events = [each["data"] for name, each in documents if name == "event"]
    assert len(events) == 3
    (descriptor,) = (each for name, each in documents if name == "descriptor")
    found = assets(documents)
    assert found.keys() == DATASETS.keys()
    for key, values in found.items():
        described = descriptor["data_keys"][key]
        assert described["external"] == "STREAM:"
        assert values.shape == (3, *described["shape"][1:])
        assert values.dtype == np.dtype(described["dtype_numpy"])
    for number, event in enumerate(events):
        is_good = found["camera-mask"][number] & 3 == 0
        mean = found["camera"][number][is_good].mean(dtype=float)
        assert event["camera-mean"] == pytest.approx(mean)
        variances = found["camera-sd"][number][is_good].astype(float) ** 2
        assert event["camera-rms_sd"] == pytest.approx(np.sqrt(variances.mean()))
    with camctl.open_camera("sim", scene="ramp", size="64x48") as other:
        light = camctl.capture(other, GIVEN).radiance()
    # Another capture of the same light: it differs by the noise that is stated.
    difference = (found["camera"] - light) / np.hypot(1e-9, found["camera-sd"])
    assert np.sqrt(np.nanmean(difference[np.isfinite(difference)] ** 2)) < 2
    assert descriptor["hints"]["camera"]["fields"] == ["camera-mean"]


def test_pictures_of_a_stream_have_no_exposure_from_before_the_trigger(
    engine: RunEngine, detector: Callable[..., CamctlDetector]
) -> None:
    from bluesky import plan_stubs as bps

    camera = detector(is_live=True)
    opened = camera._pictures.camera
    triggered: list[float] = []

    def plan() -> Iterator[Any]:
        yield from bps.stage(camera, wait=True)
        for _ in range(3):
            triggered.append(opened.clock.now())
            yield from bps.trigger(camera, wait=True)
        yield from bps.unstage(camera, wait=True)

    engine(plan())
    # Three whole exposures lie between two triggers; by default any new frame gives a result.
    assert (np.diff(triggered) > 0.002 * (1 + 4 + 16)).all()


def test_a_fly_scan_has_a_picture_of_each_frame(
    engine: RunEngine, detector: Callable[..., CamctlDetector]
) -> None:
    from bluesky import plan_stubs as bps
    from ophyd_async.core import TriggerInfo

    camera = detector(is_live=True)

    def plan() -> Iterator[Any]:
        yield from bps.stage(camera, wait=True)
        yield from bps.open_run()
        yield from bps.prepare(camera, TriggerInfo(number_of_events=8), wait=True)
        yield from bps.declare_stream(camera, name="main")
        yield from bps.kickoff(camera, wait=True)
        yield from bps.collect_while_completing([camera], [camera], 0.1, "main")
        yield from bps.close_run()
        yield from bps.unstage(camera, wait=True)

    assert {
        key: len(values) for key, values in assets(run(engine, plan())).items()
    } == dict.fromkeys(DATASETS, 8)


def test_a_camera_unplugged_in_an_exposure_is_one_line_and_opened_again(
    engine: RunEngine, detector: Callable[..., CamctlDetector]
) -> None:
    from bluesky import plans as bp
    from bluesky.utils import FailedStatus

    camera = detector(faults="unplug@4")
    with pytest.raises(FailedStatus) as caught:
        run(engine, bp.count([camera], num=3))
    cause = caught.value.__cause__
    assert isinstance(cause, camctl.CameraDisconnectedError)
    assert "\n" not in str(cause)
    assert len(assets(run(engine, bp.count([camera], num=1)))["camera"]) == 1


def test_a_fly_scan_fails_when_the_camera_does(
    engine: RunEngine, detector: Callable[..., CamctlDetector]
) -> None:
    from bluesky import plan_stubs as bps
    from bluesky.utils import FailedStatus
    from ophyd_async.core import TriggerInfo

    camera = detector(faults="unplug@4")

    def plan() -> Iterator[Any]:
        yield from bps.stage(camera, wait=True)
        yield from bps.open_run()
        yield from bps.prepare(camera, TriggerInfo(number_of_events=8), wait=True)
        yield from bps.kickoff(camera, wait=True)
        yield from bps.complete(camera, wait=True)

    with pytest.raises(FailedStatus) as caught:
        engine(plan())
    assert isinstance(caught.value.__cause__, camctl.CameraDisconnectedError)


@pytest.mark.parametrize("is_live", [False, True])
def test_unstage_ends_what_runs(
    engine: RunEngine, detector: Callable[..., CamctlDetector], is_live: bool
) -> None:
    from bluesky import plan_stubs as bps
    from ophyd_async.core import TriggerInfo

    camera = detector(is_live)

    def plan(events: int) -> Iterator[Any]:
        yield from bps.stage(camera, wait=True)
        yield from bps.open_run()
        yield from bps.prepare(camera, TriggerInfo(number_of_events=events), wait=True)
        yield from bps.declare_stream(camera, name="main")
        yield from bps.kickoff(camera, wait=True)
        if events == 2:
            yield from bps.collect_while_completing([camera], [camera], 0.1, "main")
        yield from bps.unstage(camera, wait=True)
        yield from bps.close_run()

    engine(plan(10**6))
    assert len(assets(run(engine, plan(2)))["camera"]) == 2


@pytest.mark.parametrize("livetime", [1e-8, 1e-30])
def test_a_livetime_that_no_exposure_fits_in_is_refused(
    engine: RunEngine, detector: Callable[..., CamctlDetector], livetime: float
) -> None:
    from bluesky import plan_stubs as bps
    from bluesky.utils import FailedStatus
    from ophyd_async.core import TriggerInfo

    camera = detector()

    def plan() -> Iterator[Any]:
        yield from bps.stage(camera, wait=True)
        yield from bps.prepare(camera, TriggerInfo(livetime=livetime), wait=True)
        yield from bps.trigger(camera, wait=True)

    with pytest.raises(FailedStatus) as caught:
        engine(plan())
    assert isinstance(caught.value.__cause__, camctl.CamctlError)


def test_no_such_camera_is_an_error_of_connecting(tmp_path: Path) -> None:
    from ophyd_async.core import NotConnectedError, StaticPathProvider, UUIDFilenameProvider

    from camctl.adapters.bluesky import CamctlDetector

    paths = StaticPathProvider(UUIDFilenameProvider(), tmp_path)
    camera = CamctlDetector("sim", paths, options={"scene": "no-such-scene"})
    with pytest.raises(NotConnectedError) as caught:
        asyncio.run(camera.connect())
    assert len(str(caught.value).strip().splitlines()) == 1
