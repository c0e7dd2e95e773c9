"""Fixtures that all tests share, and the profiles of hypothesis."""

import gc
import os
import signal
import sys
from collections.abc import Generator, Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

# A deadline would measure the machine.  The default draws the same 20 examples every time, and
# "more", with which .ci/run runs slow tests and again those with random examples, the same 100;
# "explore" (HYPOTHESIS_PROFILE=explore) draws new ones.
_ALWAYS = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("default", _ALWAYS, derandomize=True, max_examples=20)
settings.register_profile("more", _ALWAYS, derandomize=True)
settings.register_profile("explore", _ALWAYS, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))

# Tests run beside each other, and OpenBLAS's threads wait for one another in busy loops: on a busy
# machine that costs up to four times the processor time.  It is read when numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A device may do without OpenCV: with this variable the tests run as if it was not installed, and
# those skip that cannot.  Programs that tests start see it all the same.
if os.environ.get("CAMCTL_TEST_WITHOUT_OPENCV"):
    if "cv2" in sys.modules:
        raise pytest.UsageError("OpenCV was imported before it could be blocked")
    sys.modules["cv2"] = None  # type: ignore[assignment]  # an import of it raises ImportError

# nohup and a shell's background jobs ignore these signals, and what the tests start would, too.
for _name in ("SIGINT", "SIGQUIT", "SIGHUP"):  # the last two are POSIX signals
    _number = getattr(signal, _name, None)
    if _number is not None and signal.getsignal(_number) is signal.SIG_IGN:
        is_interrupt = _name == "SIGINT"
        signal.signal(_number, signal.default_int_handler if is_interrupt else signal.SIG_DFL)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Collect without garbage collection, a quarter of the time: what is made then mostly stays."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.enable()
        gc.freeze()


LONG = {
    "test_a_study_continues_after_its_cluster_was_killed",
    "test_all_figures_are_drawn_and_none_is_flat",
    "test_broken_orders_of_the_writes_are_noticed",
    "test_capture_is_taken_judged_and_loaded",
    "test_every_reader_keeps_to_500_mb_and_5_s",
    "test_frames_have_their_exposures",
    "test_light_of_colours_is_that_of_numpy_where_it_is_compiled",
    "test_many_sets_neither_drift_nor_grow",
    "test_project_that_uses_camctl_passes_mypy_strict",
    "test_rows_can_be_run_again",
    "test_several_cameras_are_marked_and_take_one_picture",
    "test_silent_camera_is_an_error",
    "test_silent_camera_raises_an_error_after_a_limited_time",
    "test_the_memorial_photographs_come_out_with_one_warning",
    "test_unplugged_camera_raises_an_error_of_one_line",
}
"""Tests of ten seconds and more, beside those with a time limit of their own; without those that
measure control delays, which need a core to themselves now and then."""


def takes_long(item: pytest.Item) -> bool:
    name = getattr(item, "originalname", item.name)
    return name in LONG or item.get_closest_marker("timeout") is not None


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Run first what takes long, and would run alone at the end.

    pytest-xdist cuts the list in parts, one for each of its processes; each begins with its share.
    """
    given: dict[str, int] = getattr(config, "workerinput", {})
    parts = given.get("workercount", 1)
    long = [item for item in items if takes_long(item)]
    others = iter([item for item in items if not takes_long(item)])
    ends = [len(items) * (part + 1) // parts for part in range(parts)]
    items.clear()
    for part, end in enumerate(ends):
        items += long[part::parts]
        items += islice(others, max(0, end - len(items)))


@pytest.fixture
def real_data() -> Path:
    """The folder of real data: $CAMCTL_DATA, else ../shared/data beside the project."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CAMCTL_DATA", beside))
    if not folder.is_dir():
        pytest.skip("real data not present: set CAMCTL_DATA to its folder")
    return folder


_SYNCHRONISE = os.fsync


@pytest.fixture(autouse=True, scope="session")
def quick_disk() -> Iterator[None]:
    """Do not wait for the disk: no test survives a power failure.

    `crash_witness`, which shows what is synchronised, does wait, and so does each other program.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", os.fstat)  # it refuses what is no open file, too
        yield


@pytest.fixture
def slow_disk(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wait for the disk all the same, where that is tested."""
    monkeypatch.setattr(os, "fsync", _SYNCHRONISE)


@pytest.fixture(autouse=True, scope="session")
def own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep profiles, settings and solved exposures in folders of the tests.

    All workers share the solved exposures.
    """
    base = tmp_path_factory.getbasetemp()
    of_run = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
        patch.setenv("CAMCTL_CACHE", str(of_run / "solved-exposures"))
        patch.setenv("XDG_STATE_HOME", str(tmp_path_factory.mktemp("state")))
        patch.setenv("CAMCTL_CONFIG", str(base / "no-configuration.toml"))
        patch.delenv("CAMCTL_CAMERA", raising=False)
        yield


@pytest.fixture
def cv2() -> Any:
    """OpenCV, which reads pictures independently; without it the test is skipped."""
    return pytest.importorskip("cv2", reason="OpenCV is blocked")


@pytest.fixture
def own_profiles(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder of camera profiles for this test alone."""
    folder = tmp_path / "profiles"
    monkeypatch.setenv("CAMCTL_PROFILES", str(folder))
    return folder


@pytest.fixture(scope="class")
def profiles_of_class(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """An empty folder of camera profiles for a class, whose first test learns a camera's format."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
        yield


@pytest.fixture
def dask_cluster(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A Dask cluster of two workers in this process, named in the environment."""
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=False, dashboard_address=":0"
    ) as cluster:
        monkeypatch.setenv("DASK_SCHEDULER_ADDRESS", cluster.scheduler_address)
        yield
