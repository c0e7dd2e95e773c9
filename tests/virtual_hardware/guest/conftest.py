"""What the tests in the guest share: the devices, and a line of output for each test."""

from collections.abc import Callable, Iterator
from pathlib import Path

import guest_processes as guest
import pytest
import virtual_devices as rig


class Lines:
    """A line of output for each test, which run.py reads."""

    def __init__(self, session: pytest.Session) -> None:
        self._terminal = session.config.get_terminal_writer()

    def pytest_collection_finish(self, session: pytest.Session) -> None:
        self._terminal.write(f"collected {len(session.items)}\n", flush=True)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        # Of a test's three phases, that of the call counts, and any other that did not pass.
        if report.when == "call" or report.failed or (report.skipped and report.when == "setup"):
            name = report.nodeid.removeprefix("tests/virtual_hardware/guest/")
            line = f"{report.outcome:8}{report.duration:6.1f} s  {name}\n"
            self._terminal.write(line, flush=True)


def pytest_sessionstart(session: pytest.Session) -> None:
    if not session.config.option.collectonly:
        guest.spawner()  # before any thread runs
    session.config.pluginmanager.register(Lines(session))


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report: pytest.TestReport) -> tuple[str, str, str] | None:
    """Keep pytest's own letters from between the lines."""
    if report.when == "call" or not report.passed:
        return (report.outcome, "", report.outcome.upper())
    return None


@pytest.fixture(scope="session")
def own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep solved exposures and camera profiles in folders of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
        patch.setenv("CAMCTL_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session")
def running_hub(own_folders: None) -> Iterator[rig.RecordingHub]:
    """All devices, running; the control delays of the streaming cameras are in their profiles."""
    with rig.running_hub() as hub:
        for device in rig.DEVICES:
            if device.kind == "uvc":
                rig.record_delay(device, *device.delays)
        yield hub


@pytest.fixture
def hub(running_hub: rig.RecordingHub) -> Iterator[rig.RecordingHub]:
    """All devices, connected and without faults."""
    yield running_hub
    rig.restore(running_hub)


@pytest.fixture
def camctl(
    capfd: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., guest.CommandResult]:
    """Run a command line in an empty folder."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    return lambda *words: guest.camctl(capfd, *words)
