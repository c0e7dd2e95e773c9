"""What the tests in the guest share: the devices, a limit for each test, results for the host."""

import signal
from pathlib import Path

import pytest
import virtual_devices as rig

OUT = Path("/lab_out")
LIMIT_S = 90


def _note(word, count=1):
    """Write `word` where the host reads it, at once: the guest may not live long."""
    with (OUT / "results").open("a") as results:
        results.write(f"{word}\n" * count)


def pytest_collection_finish(session):
    _note("collected", len(session.items))


class Lines:
    """One line a test, in one piece: two processes share the console."""

    def __init__(self, terminal):
        self._terminal = terminal

    def pytest_runtest_logreport(self, report):
        # Of a test's three phases, that of the call counts, and any other that did not pass.
        if report.when == "call" or report.failed or (report.skipped and report.when == "setup"):
            _note(report.outcome)
            name = report.nodeid.removeprefix("tests/virtual_hardware/guest/")
            line = f"{report.outcome:8}{report.duration:6.1f} s  {name}\n"
            self._terminal.write(line, flush=True)


def pytest_sessionstart(session):
    session.config.pluginmanager.register(Lines(session.config.get_terminal_writer()))


@pytest.hookimpl(tryfirst=True)
def pytest_report_teststatus(report):
    """Keep pytest's own letters from between the lines."""
    if report.when == "call" or not report.passed:
        return (report.outcome, "", report.outcome.upper())
    return None


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item, nextitem):
    """End a test that hangs, so that the others get their turn."""

    def too_long(signum, frame):
        raise TimeoutError(f"{item.name} took longer than {LIMIT_S} s")

    signal.signal(signal.SIGALRM, too_long)
    signal.alarm(LIMIT_S)
    try:
        return (yield)
    finally:
        signal.alarm(0)


@pytest.fixture(scope="session")
def own_profiles(tmp_path_factory):
    """What is measured of the laboratory's cameras goes to a folder of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
        yield


@pytest.fixture(scope="session")
def running():
    """The process of all devices, and the hub to speak to them."""
    process, hub = rig.start_devices()
    try:
        yield hub
    finally:
        process.terminate()
        process.wait(10)


@pytest.fixture(scope="session")
def measured(running, own_profiles):
    """The delays of all streaming cameras are known, in their first mode."""
    for device in rig.DEVICES:
        if device.kind == "uvc":
            rig.know_delay(device, *device.delays)


@pytest.fixture
def hub(running, measured):
    """All devices, plugged in and well."""
    yield running
    for device in rig.DEVICES:
        rig.make_well(running, device)


@pytest.fixture
def camctl(capfd, tmp_path, monkeypatch):
    """Run a command line in an empty folder."""
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    return lambda *words: rig.camctl(capfd, *words)
