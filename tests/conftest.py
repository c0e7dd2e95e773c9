"""Fixtures that all tests share, and the profiles of hypothesis."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# A deadline would measure the machine.  The default draws the same examples every time; "explore"
# (HYPOTHESIS_PROFILE=explore) draws new ones and more of them.
_ALWAYS = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("default", _ALWAYS, derandomize=True)
settings.register_profile("explore", _ALWAYS, max_examples=1000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "default"))


# Programs and helper modules: --doctest-modules would import them.
collect_ignore = ["bench", "example_driver", "helpers", "oracle"]


@pytest.fixture
def real_data() -> Path:
    """The folder of real data: $CAMCTL_DATA, else ../shared/data beside the project."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("CAMCTL_DATA", beside))
    if not folder.is_dir():
        pytest.skip("real data not present: set CAMCTL_DATA to its folder")
    return folder


@pytest.fixture(autouse=True, scope="session")
def own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep solved exposures and camera profiles of the tests in folders of their own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CAMCTL_PROFILES", str(tmp_path_factory.mktemp("profiles")))
        patch.setenv("CAMCTL_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
