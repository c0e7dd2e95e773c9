"""What the tests in the guest share: the devices, a limit for each test, results for the host."""

import signal
from pathlib import Path

import pytest

OUT = Path("/lab_out")
LIMIT_S = 90


def _note(word, count=1):
    """Write `word` where the host reads it, at once: the guest may not live long."""
    with (OUT / "results").open("a") as results:
        results.write(f"{word}\n" * count)


def pytest_collection_finish(session):
    _note("collected", len(session.items))


def pytest_runtest_logreport(report):
    # Of a test's three phases, that of the call counts, and any other that did not pass.
    if report.when == "call" or report.failed or (report.skipped and report.when == "setup"):
        _note(report.outcome)


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
