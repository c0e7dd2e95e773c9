"""Any input is read or refused: damaged samples of every reader, and random bytes.

`HYPOTHESIS_PROFILE=explore python -m pytest tests/fuzz` tries ten times as many inputs, new ones
each time.
"""

from __future__ import annotations

import random
import resource
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

import pytest
from capture_readers import CAPTURES
from device_readers import DEVICES, SESSIONS
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from input_readers import FILES
from mutations import mutated

from camctl.errors import CamctlError

READERS = {**FILES, **CAPTURES, **DEVICES}

samples_of = cache(lambda name: READERS[name].samples())

MOST_BYTES = 500 << 20
"""Memory that reading one input may take beyond what the process has."""


@pytest.fixture(autouse=True)
def limited_memory() -> Iterator[None]:
    """Let allocations beyond `MOST_BYTES` fail."""
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + MOST_BYTES, hard))
    yield
    resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@pytest.mark.parametrize("name", READERS)
def test_samples_are_read(tmp_path: Path, name: str) -> None:
    samples = samples_of(name)
    assert samples
    for sample in samples:
        READERS[name].read(sample, tmp_path)


# The examples share a folder: each writes its file anew.
MANY = settings(
    max_examples=settings().max_examples // 2,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@MANY
@pytest.mark.parametrize("name", READERS)
@given(rng=st.randoms(use_true_random=False))
def test_damaged_input_is_read_or_refused(tmp_path: Path, name: str, rng: random.Random) -> None:
    samples = samples_of(name)
    data = mutated(rng.choice(samples), rng, samples)
    with suppress(CamctlError):
        READERS[name].read(data, tmp_path)


@MANY
@pytest.mark.parametrize("name", READERS)
@given(data=st.binary(max_size=300))
def test_random_bytes_are_read_or_refused(tmp_path: Path, name: str, data: bytes) -> None:
    with suppress(CamctlError):
        READERS[name].read(data, tmp_path)


@pytest.mark.parametrize("rate", [0.02, 0.5])
@pytest.mark.parametrize("name", SESSIONS)
@settings(max_examples=settings().max_examples // 3)
@given(seed=st.integers(0, 2**32))
def test_damaged_replies_of_a_device_end_in_an_error_of_camctl(
    name: str, rate: float, seed: int
) -> None:
    with suppress(CamctlError):
        SESSIONS[name](random.Random(seed), rate)
